"""The source of images that is a camera's picture at an address: asked for at every slot, checked, stored."""

from __future__ import annotations

import io
import logging
import ssl
import string
import threading
import urllib.parse
from collections.abc import Callable, Mapping
from dataclasses import KW_ONLY, dataclass
from datetime import datetime, timedelta
from email.utils import parsedate_to_datetime
from pathlib import Path
from typing import NamedTuple, Protocol

import cv2
from PIL import Image as Pictures

from sunarc.common.errors import ConfigurationError, InputError, OutsideError
from sunarc.common.findings import Finding, FindingError
from sunarc.common.foreign_files import name_text
from sunarc.imager.archive.images import ImageStore, write_atomically
from sunarc.imager.cameras.frame import Frame
from sunarc.imager.cameras.options import SnapshotOptions
from sunarc.imager.live.file_frames import make_file_frame
from sunarc.imager.live.live_images import LiveImage, LiveImages
from sunarc.imager.runtime import http_exchange
from sunarc.imager.runtime.clock import Clock
from sunarc.imager.runtime.loop import DropOldestQueue, Loop
from sunarc.imager.runtime.status import CameraStatus, CaptureStatus, Reason, StatusRegistry, condition
from sunarc.imager.workers.clock_watch import FrameTime
from sunarc.imager.workers.compose import NOT_WRITTEN
from sunarc.imager.workers.options import CaptureOptions, read_login
from sunarc.sky.sun import DARK_ZENITH_DEG
from sunarc.sources.image_files import FORMATS, checked_image, image_size, read_one_image
from sunarc.sources.image_times import exif_time
from sunarc.sources.name_times import is_plausible_time
from sunarc.sources.source_files import MOST_PIXELS
from sunarc.sources.sources import Folder, content_hash

_log = logging.getLogger(__name__)
_MOST_BYTES = 32_000_000
_MOST_REDIRECTS = 3
_KEPT = {"JPEG": "jpg", "MPO": "jpg", "PNG": "png"}
"""Formats of pictures that are kept as they come, with their suffixes; others become PNG."""
_REDIRECTS = frozenset({301, 302, 303, 307, 308})
_STALE_S = 60.0
"""A picture that is older is not one of the moment of the request."""
_SHOWN_CHARACTERS = 200
_AGE_DIGITS = 12
"""Of an Age, seconds; more digits would be infinite."""


class Snapshot(NamedTuple):
    """Picture of a camera: content, file kind ("jpg", "png"), middle of the request, and half its duration."""

    content: bytes
    suffix: str
    time: datetime
    within_s: float


class SnapshotClient:
    """Client that asks a camera for its picture by HTTP, and refuses other answers.

    Parameters
    ----------
    options : the address, and how it is asked.
    clock : dates the request, and limits it.
    dated_by_camera : take a picture's time from its Last-Modified: a simulated camera's time is the only one there is.

    Raises
    ------
    ConfigurationError : a file of the options cannot be read, or is invalid.
    """

    def __init__(self, options: SnapshotOptions, clock: Clock, *, dated_by_camera: bool = False) -> None:
        self._options, self._clock, self._dated_by_camera = options, clock, dated_by_camera
        self._url = urllib.parse.urlsplit(options.url)
        self._login = read_login(options.token_file, setting="http.token_file")
        self._trust = _trust(options) if self._url.scheme == "https" else None
        self.host = self._url.hostname or ""

    def picture(self, heartbeat: Callable[[], None] = lambda: None) -> Snapshot | Finding:
        """Return the present picture, or the finding why it is missing."""
        requested, began_s = self._clock.now(), self._clock.monotonic()
        limit = http_exchange.Limit(self._options.timeout_s, monotonic=self._clock.monotonic, heartbeat=heartbeat)
        try:
            answer = self._fetch_picture(limit)
        except ssl.SSLCertVerificationError as error:
            return Finding("http_certificate", {"host": self.host, "error": error.verify_message})
        except (OSError, http_exchange.UnfinishedError) as error:
            return Finding("http_unreachable", {"host": self.host, "error": str(error) or type(error).__name__})
        if isinstance(answer, Finding):
            return answer
        half_s = (self._clock.monotonic() - began_s) / 2.0
        return self._check_picture(answer, requested + timedelta(seconds=half_s), half_s)

    def _fetch_picture(self, limit: http_exchange.Limit) -> http_exchange.HttpAnswer | Finding:
        """Return the answer with the picture: after the camera's challenge, and redirects on the same host."""
        url, login = self._url, dict[str, str]()
        asked = False
        for _ in range(_MOST_REDIRECTS + 2):
            request = http_exchange.HttpRequest(method="GET", url=url, headers={"accept": "image/*", **login}, body=b"")
            context = None if self._trust is None else self._trust.context()
            answer = http_exchange.fetch(request, context=context, limit=limit, most_bytes=_MOST_BYTES + 1)
            if answer.status == 401 and self._login is not None and not asked:
                challenges = http_exchange.challenges_in(answer.headers.get("www-authenticate", "").split("\n"))
                answered = http_exchange.authorization(
                    self._login, challenges, method="GET", uri=http_exchange.request_target(url)
                )
                if answered is None:
                    return Finding("http_login", {"host": self.host, "offers": http_exchange.offers(challenges)})
                login, asked = {"authorization": answered}, True
            elif answer.status in _REDIRECTS:
                target = _resolve_redirect(url, answer.headers.get("location", ""))
                if isinstance(target, str):
                    return Finding("http_redirected", {"host": self.host, "location": target})
                url, asked = target, False
            else:
                return self._accept_answer(answer)
        return Finding("http_status", {"host": self.host, "status": answer.status})

    def _accept_answer(self, answer: http_exchange.HttpAnswer) -> http_exchange.HttpAnswer | Finding:
        if answer.status in {401, 403}:
            return Finding("http_denied", {"host": self.host, "status": answer.status})
        if answer.status != 200:
            return Finding("http_status", {"host": self.host, "status": answer.status})
        if len(answer.body) > _MOST_BYTES:
            return Finding("http_too_large", {"host": self.host, "most": _MOST_BYTES})
        return answer

    def _check_picture(self, answer: http_exchange.HttpAnswer, time: datetime, half_s: float) -> Snapshot | Finding:
        content = answer.body
        try:
            with Pictures.open(io.BytesIO(content), formats=(*FORMATS, "PPM")) as picture:
                (width, height), suffix = picture.size, _KEPT.get(str(picture.format), "")
            if not suffix and width * height <= MOST_PIXELS:
                content, suffix = encode_png(checked_image(content, self.host)), "png"
        except Pictures.DecompressionBombError:
            width = height = 1 << 16
            suffix = ""
        except (OSError, ValueError, SyntaxError, FindingError):
            kind = answer.headers.get("content-type", "no content type").partition(";")[0]
            return Finding("http_no_picture", {"host": self.host, "why": f"{len(content)} bytes of {kind}"})
        if width * height > MOST_PIXELS:
            return Finding("http_too_many_pixels", {"width": width, "height": height, "most": MOST_PIXELS})
        age_s = _age_s(answer.headers, answer.body, time)
        if age_s > _STALE_S:
            return Finding("http_stale", {"age_s": age_s})
        if not self._dated_by_camera:
            return Snapshot(content, suffix, time, half_s)
        stated = _parse_http_date(answer.headers.get("last-modified"))
        if stated is None:
            why = "no Last-Modified, which dates it where capture.speed is set"
            return Finding("http_no_picture", {"host": self.host, "why": why})
        return Snapshot(content, suffix, stated, 0.0)


def encode_png(image: cv2.typing.MatLike) -> bytes:
    """Return an image as a lossless PNG, compressed little, for speed."""
    return cv2.imencode(".png", image, [cv2.IMWRITE_PNG_COMPRESSION, 1])[1].tobytes()


def _resolve_redirect(url: urllib.parse.SplitResult, location: str) -> urllib.parse.SplitResult | str:
    """Return the address on the same host to which an answer redirects; as text another host, or an invalid address."""
    written = urllib.parse.quote(location, safe=string.punctuation, encoding="latin-1")
    try:
        target = urllib.parse.urlsplit(urllib.parse.urljoin(url.geturl(), written))
    except ValueError:
        return written[:_SHOWN_CHARACTERS]
    if (target.scheme, target.netloc) != (url.scheme, url.netloc):
        return f"{target.scheme}://{target.hostname}"[:_SHOWN_CHARACTERS]
    return target


def _trust(options: SnapshotOptions) -> http_exchange.Trust:
    try:
        return http_exchange.Trust(options.ca_file)
    except OSError as error:
        raise ConfigurationError(f"http.ca_file {options.ca_file}: {error}") from error


def _age_s(headers: Mapping[str, str], content: bytes, now: datetime) -> float:
    """Return the age of a picture by a cache's Age, Last-Modified, or EXIF: the largest of them.

    Last-Modified is compared with Date, which is of the same clock; EXIF counts where it has a zone.
    """
    ages = [0.0]
    age = headers.get("age", "")
    if age.isdecimal():
        ages.append(float(age[:_AGE_DIGITS]))
    date, modified = _parse_http_date(headers.get("date")), _parse_http_date(headers.get("last-modified"))
    if date is not None and modified is not None:
        ages.append((date - modified).total_seconds())
    taken = exif_time(io.BytesIO(content))
    if taken is not None and taken.tzinfo is not None:
        ages.append(((date or now) - taken).total_seconds())
    return max(ages)


def _parse_http_date(text: str | None) -> datetime | None:
    try:
        found = None if text is None else parsedate_to_datetime(text)
    except (ValueError, TypeError, IndexError, OverflowError):  # of what is no date the parser raises each of them
        return None
    return found if found is not None and found.tzinfo is not None and is_plausible_time(found) else None


CODES = (
    *("http_unreachable", "http_certificate", "http_denied", "http_login", "http_redirected", "http_status"),
    *("http_no_picture", "http_too_large", "http_too_many_pixels", "http_stale", "http_refused", "rtsp_unreachable"),
    *("rtsp_denied", "rtsp_login", "rtsp_status", "rtsp_no_frame", "rtsp_too_many_pixels", "rtsp_refused"),
)
"""Conditions of a camera that gives no picture, one at a time."""
_REFUSED = {"http": "http_refused", "rtsp": "rtsp_refused"}


class PictureClient(Protocol):
    """Client that gets a camera's present picture; `host` is the camera's."""

    host: str

    def picture(self, heartbeat: Callable[[], None] = ...) -> Snapshot | Finding:
        """Return the picture, or the finding why it is missing."""
        ...


@dataclass(eq=False)
class SnapshotWorker:
    """Worker that takes a picture at every slot, by day each `capture.cadence_s`, else each `capture.night_cadence_s`.

    Parameters
    ----------
    client : gets the pictures.
    kind : what the conditions' codes begin with: "http" or "rtsp".
    keep_images : keep the pictures in the store where its disk has room; otherwise the last one alone.
    capture : the cadences, and down to where the sun is looked for.
    name : the camera's, on the board.
    images : looks for the sun.
    clock, frame_time : the host's, which date the pictures; a simulated camera's are dated by it.
    apparent_zenith : the sun's, degrees.
    store : keeps pictures where they are to be kept.
    last : folder of the last picture, where they are not.
    board : where the camera's state is shown.
    night : takes the pictures of the night; None: they are a sign of life.
    """

    client: PictureClient
    _: KW_ONLY
    kind: str
    keep_images: bool
    capture: CaptureOptions
    name: str
    images: LiveImages
    clock: Clock
    frame_time: FrameTime
    apparent_zenith: Callable[[datetime], float]
    store: ImageStore
    last: Path
    board: StatusRegistry
    night: DropOldestQueue[Frame] | None = None

    def __post_init__(self) -> None:
        """Begin without a picture."""
        self._n_frames = 0
        self.within_s = 0.0
        self.newest_picture: Path | None = None

    def run(self, stop: threading.Event, heartbeat: Callable[[], None]) -> None:
        """Take pictures until stopped."""
        loop = Loop(self.clock, stop, heartbeat)
        for _ in loop.turns():
            daylight = self.apparent_zenith(self.frame_time.now()) < self.capture.sun_zenith_deg
            slot = self.frame_time.next_slot(
                every_s=self.capture.cadence_s if daylight else self.capture.night_cadence_s
            )
            if not loop.wait(self.frame_time.real_seconds_until(slot)):
                self.take(heartbeat)

    def take(self, heartbeat: Callable[[], None] = lambda: None) -> None:
        """Take a picture, look for the sun in it and store the sighting."""
        found = self.client.picture(heartbeat)
        if isinstance(found, Finding):
            self._set_condition(found)
            self.board.note(camera=CameraStatus(name=self.name, connected=False, address=self.client.host))
            return
        self.board.note(camera=CameraStatus(name=self.name, connected=True, address=self.client.host))
        if self.frame_time.follows_camera:
            self.frame_time.note(found.time)
        try:
            left_out = self._take_picture(found)
        except OutsideError as error:
            stored = condition("sightings_not_stored", waiting=0, lost=1, error=str(error))
            self.board.set_condition("sightings_not_stored", stored)
            return
        self.board.set_condition("sightings_not_stored", None)
        repeated = left_out is not None and left_out.code == "frame_repeated"
        self._set_condition(None if left_out is None or repeated else self._make_refusal(left_out))

    def _take_picture(self, found: Snapshot) -> Finding | None:
        """Process a picture, and return the finding if it is left out; None where it is used."""
        path = self._write_picture(found)
        self._n_frames += 1
        self.within_s = found.within_s
        self.board.note(last_frame_at=found.time, capture=CaptureStatus(frames=self._n_frames))
        self.newest_picture = path
        source, zenith = Folder(name_text(path.parent)), self.apparent_zenith(found.time)
        if zenith < self.capture.sun_zenith_deg:
            content = content_hash(found.content)
            try:
                size = image_size(source, path.name)
                self.images.register([] if size is None else [size])
                return self.images.take(source.address, [LiveImage(path.name, found.time, None, content)])[0]
            except InputError as error:
                return Finding("file_not_image", {"error": str(error)})
        if self.night is not None and zenith >= DARK_ZENITH_DEG:
            pixels = read_one_image(source, path.name, size=self.images.size)
            if isinstance(pixels, Finding):
                return pixels
            self.night.put(make_file_frame(pixels, found.time.timestamp(), None, self._n_frames))
        return None

    def _write_picture(self, found: Snapshot) -> Path:
        """Write a picture where pictures are kept, or where the next one replaces it; return its path.

        A disk without room costs the kept picture alone: the sun is found in it all the same.
        """
        kind = f"hdr.{found.suffix}"
        if self.keep_images:
            try:
                kept = self.store.write(found.time, found.content, kind=kind)
            except OutsideError as error:
                self.board.set_condition(NOT_WRITTEN, condition(NOT_WRITTEN, error=str(error)))
            else:
                self.board.set_condition(NOT_WRITTEN, None)
                return kept
        path = self.last / self.store.path(found.time, kind=kind).name
        try:
            write_atomically(path, found.content)
            for one in self.last.iterdir():
                if one != path:
                    one.unlink(missing_ok=True)
        except OSError as error:
            raise OutsideError(f"picture {path.name} could not be written: {error.strerror or error}") from error
        return path

    def _set_condition(self, finding: Finding | None) -> None:
        self.board.set_one_condition(CODES, None if finding is None else Reason.of(finding))

    def _make_refusal(self, finding: Finding) -> Finding:
        why, remedy = finding.text, finding.remedy
        return Finding(_REFUSED[self.kind], {"why": why, "remedy": remedy})
