"""A camera that streams by RTSP: a key frame is taken from its stream, and dated by when it arrived."""

from __future__ import annotations

import math
import os
import socket
import urllib.parse
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing, contextmanager
from dataclasses import dataclass
from datetime import timedelta
from time import thread_time

import cv2

from sunarc.common.findings import Finding
from sunarc.imager.cameras.options import RtspOptions, SnapshotOptions
from sunarc.imager.live.snapshots import PictureClient, Snapshot, SnapshotClient, encode_png
from sunarc.imager.runtime import http_exchange
from sunarc.imager.runtime.clock import Clock
from sunarc.imager.workers.options import read_login
from sunarc.sources.source_files import MOST_PIXELS

os.environ.setdefault("OPENCV_FFMPEG_LOGLEVEL", "-8")  # frames that are joined in the middle are no errors
_PORT = 554
_MOST_HEAD_BYTES = 65_536
_SETTLE_S = 0.5
_IDLE_SHARE = 0.5
"""Share of the time since a stream is open: frames that came while it was opened are decoded without waiting."""


@dataclass(eq=False)
class RtspClient:
    """Client that takes one key frame from a camera's stream at each call; decoding all would occupy a processor.

    Parameters
    ----------
    options : the address, and how long it may take.
    clock : dates the frames.

    Raises
    ------
    ConfigurationError : the file of user and password cannot be read, or is invalid.
    """

    options: RtspOptions
    clock: Clock

    def __post_init__(self) -> None:
        """Read the user and password."""
        self._url = urllib.parse.urlsplit(self.options.url)
        self._login = read_login(self.options.token_file, setting="rtsp.token_file")
        self.host = self._url.hostname or ""

    def picture(self, heartbeat: Callable[[], None] = lambda: None) -> Snapshot | Finding:
        """Return the next key frame, or the finding why it is missing.

        The camera is asked for the stream's description first: the decoder does not say why it opens nothing, and
        would follow the camera to another host with the password.
        """
        try:
            limit = http_exchange.Limit(self.options.timeout_s, monotonic=self.clock.monotonic, heartbeat=heartbeat)
            with http_exchange.exchange_errors():
                status = self._describe_stream(limit)
        except (OSError, http_exchange.UnfinishedError) as error:
            return Finding("rtsp_unreachable", {"host": self.host, "error": str(error) or type(error).__name__})
        if isinstance(status, Finding):
            return status
        if status in {401, 403}:
            return Finding("rtsp_denied", {"host": self.host, "status": status})
        if status != 200:
            return Finding("rtsp_status", {"host": self.host, "status": status})
        with _open_stream(self._make_login_address(), self.options.timeout_s) as stream:
            heartbeat()
            return self._read_key_frame(stream, heartbeat)

    def _describe_stream(self, limit: http_exchange.Limit) -> int | Finding:
        """Return the status of the answer to DESCRIBE, with the login where the camera asks for it."""
        status, lines = self._send_describe(limit, "")
        if status == 401 and self._login is not None:
            challenges = http_exchange.challenges_in(lines)
            answer = http_exchange.authorization(self._login, challenges, method="DESCRIBE", uri=self._url.geturl())
            if answer is None or not _decoder_answers(lines):
                return Finding("rtsp_login", {"host": self.host, "offers": http_exchange.offers(challenges)})
            status, _ = self._send_describe(limit, f"Authorization: {answer}\r\n")
        return status

    def _send_describe(self, limit: http_exchange.Limit, header: str) -> tuple[int, list[str]]:
        """Send DESCRIBE on a connection of its own; return the status, and the camera's challenge."""
        text = f"DESCRIBE {self._url.geturl()} RTSP/1.0\r\nCSeq: 1\r\nAccept: application/sdp\r\n{header}\r\n"
        address = (self.host, self._url.port or _PORT)
        with closing(socket.create_connection(address, timeout=limit.left_s())) as channel:
            limit.write(channel, text.encode("latin-1"))
            head = b""
            while b"\r\n\r\n" not in head:
                part = limit.read(channel)
                if not part or len(head) > _MOST_HEAD_BYTES:
                    raise http_exchange.UnfinishedError("its answer has no end")
                head += part
        first, *lines = head.partition(b"\r\n\r\n")[0].decode("latin-1").split("\r\n")
        words = first.split()
        if len(words) < 2 or not words[0].startswith("RTSP/") or not words[1].isdecimal():
            raise http_exchange.UnfinishedError("its answer is not RTSP")
        fields = [line.partition(":") for line in lines]
        asked = [value.strip() for name, _, value in fields if name.strip().lower() == "www-authenticate"]
        return int(words[1]), asked

    def _make_login_address(self) -> str:
        """Return the address as the decoder takes it, with user and password."""
        if self._login is None:
            return self._url.geturl()
        user, password = (urllib.parse.quote(part, safe="") for part in self._login)
        return self._url._replace(netloc=f"{user}:{password}@{self._url.netloc}").geturl()

    def _read_key_frame(self, stream: cv2.VideoCapture, heartbeat: Callable[[], None]) -> Snapshot | Finding:
        """Return the first key frame after those that waited while the stream was opened.

        The frame came while it was waited for: its time is the middle of that.
        """
        if not stream.isOpened():
            return self._make_missing_finding("nothing that can be decoded")
        width, height = stream.get(cv2.CAP_PROP_FRAME_WIDTH), stream.get(cv2.CAP_PROP_FRAME_HEIGHT)
        if width * height > MOST_PIXELS:
            return Finding("rtsp_too_many_pixels", {"width": int(width), "height": int(height), "most": MOST_PIXELS})
        opened_s, worked_s = self.clock.monotonic(), thread_time()
        while (began_s := self.clock.monotonic()) - opened_s < self.options.timeout_s:
            heartbeat()
            if not stream.grab():
                return self._make_missing_finding("no frame")
            ended_s = self.clock.monotonic()
            open_s, work_s = ended_s - opened_s, thread_time() - worked_s
            is_live = open_s > _SETTLE_S and work_s < (1.0 - _IDLE_SHARE) * open_s
            if not is_live:
                continue
            is_whole, frame = stream.retrieve()
            if is_whole and stream.get(cv2.CAP_PROP_LRF_HAS_KEY_FRAME) > 0.0:
                half_s = (ended_s - began_s) / 2.0
                return Snapshot(encode_png(frame), "png", self.clock.now() - timedelta(seconds=half_s), half_s)
        return self._make_missing_finding("no key frame")

    def _make_missing_finding(self, why: str) -> Finding:
        return Finding("rtsp_no_frame", {"host": self.host, "why": why, "within_s": self.options.timeout_s})


def _decoder_answers(lines: Sequence[str]) -> bool:
    """Return whether the decoder can log in as safely as the DESCRIBE request did.

    FFmpeg takes the last line that begins with Digest, of MD5 alone; without one the password goes as Basic, even where
    a line that begins with Basic offers Digest behind it.
    """
    if not any(one.scheme == "digest" for one in http_exchange.challenges_in(lines)):
        return True
    digests = [line for line in lines if line.lower().startswith("digest ")]
    taken = http_exchange.challenges_in(digests[-1:])[:1]
    return any(one.parameters.get("algorithm", "").lower() in {"", "md5", "md5-sess"} for one in taken)


def make_client(
    options: SnapshotOptions | RtspOptions, clock: Clock, *, dated_by_camera: bool = False
) -> PictureClient:
    """Return the client of the camera of a section of the settings; see `SnapshotClient`."""
    if isinstance(options, RtspOptions):
        return RtspClient(options, clock)
    return SnapshotClient(options, clock, dated_by_camera=dated_by_camera)


@contextmanager
def _open_stream(address: str, timeout_s: float) -> Iterator[cv2.VideoCapture]:
    """Open a stream over TCP; opening it and waiting for a frame take no longer than the timeout."""
    timeout_ms = math.ceil(1000.0 * timeout_s)
    stream = cv2.VideoCapture(
        address,
        cv2.CAP_FFMPEG,
        [
            *(cv2.CAP_PROP_OPEN_TIMEOUT_MSEC, timeout_ms),
            *(cv2.CAP_PROP_READ_TIMEOUT_MSEC, timeout_ms),
            *(cv2.CAP_PROP_N_THREADS, 1),  # several would hold frames back
        ],
    )
    try:
        yield stream
    finally:
        stream.release()
