"""The campaign's cameras of pictures: a folder that another program fills, an address that gives the present one."""

from __future__ import annotations

import contextlib
import os
import shutil
import signal
import subprocess
import sys
import threading
import urllib.request
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from datetime import UTC, datetime
from functools import partialmethod
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Literal

from tests.fixtures.ports import free_port

from .campaign_faults import NEEDS_OWN_DISK, Faults
from .campaign_processes import ADDRESS, CADENCE_S, Setting, now, pause

Source = Literal["folder", "http"]
_COMMON = (
    *("kill", "stop", "stop_while_solving", "pause", "imager_killed", "locked", "backup", "damaged_calibration"),
    *("deleted_database", "disk_full", "second_service", "flipped_bit", "receiver_drips", "receiver_refuses"),
)
FAULTS: dict[str, tuple[str, ...]] = {
    "folder": (
        *_COMMON,
        *("late_uploads", "truncated", "flipped_picture", "copies", "one_picture", "folder_away", "junk"),
    ),
    "http": (*_COMMON, "unavailable", "page", "drip", "endless", "stale", "redirect", "refused"),
}
SPEED = 60.0
"""Pictures cost more than exposures of the sun: each is coded and decoded."""
SLOT_S = CADENCE_S / SPEED
_WRITTEN = ("sunarc.sqlite", "sunarc.sqlite-wal", "sunarc.sqlite-shm")
_CLEAN_ENDS = frozenset({0, 1, 2, 3})
_SECRET = "c2VjcmV0IG9mIHRoZSBjYW1wYWlnbiBvZiBmYXVsdHM="  # noqa: S105 - of a receiver on loopback


@dataclass
class Other:
    """What answers on loopback beside the service: the camera's address, and a receiver of messages.

    Attributes
    ----------
    camera : where the picture of now is, as the simulated camera gives it.
    mode : what a request for the picture gets.
    drips, refuses : how the receiver takes messages.
    received : the ids of the messages that it has taken.
    """

    camera: str = ""
    mode: str = "picture"
    drips: bool = False
    refuses: bool = False
    received: list[str] = field(default_factory=list)
    _last: tuple[dict[str, str], bytes] | None = None

    def picture(self) -> tuple[int, dict[str, str], bytes]:
        """Return status, headers and body of the answer to a request for the picture."""
        if self.mode == "unavailable":
            return 503, {}, b"busy"
        if self.mode == "page":
            return 200, {"Content-Type": "text/html"}, b"<html>please log in</html>"
        if self.mode == "redirect":
            return 302, {"Location": "http://192.0.2.1/current.jpg"}, b""
        if self.mode != "stale" or self._last is None:
            with urllib.request.urlopen(self.camera, timeout=5.0) as answer:  # noqa: S310 - loopback
                kept = {name: answer.headers[name] for name in ("Content-Type", "Date", "Last-Modified")}
                self._last = kept, answer.read()
        return 200, *self._last

    def give(self, request: BaseHTTPRequestHandler) -> None:
        """Answer a request for the picture."""
        try:
            status, headers, body = self.picture()
        except OSError:
            status, headers, body = 504, {}, b""
        request.send_response_only(status)
        length = len(body) if self.mode != "endless" else 1 << 40
        for name, value in {**headers, "Content-Length": str(length)}.items():
            request.send_header(name, value)
        request.end_headers()
        with contextlib.suppress(OSError):  # the service waits no longer
            for part in self._parts(body):
                request.wfile.write(part)

    def _parts(self, body: bytes) -> Iterator[bytes]:
        if self.mode == "drip":
            for at in range(0, len(body), 64):
                yield body[at : at + 64]
                pause(0.5)
        elif self.mode == "endless":
            yield from (bytes(1 << 16) for _ in range(4000))
        else:
            yield body

    def take(self, request: BaseHTTPRequestHandler) -> None:
        """Take a message, or not."""
        request.rfile.read(int(request.headers["content-length"]))
        with contextlib.suppress(OSError):  # the service waits no longer
            for _ in range(40 if self.drips else 0):
                request.wfile.write(b"H")
                pause(0.5)
            taken = not (self.drips or self.refuses)
            if taken:
                self.received.append(request.headers["webhook-id"])
            request.send_response(204 if taken else 500)
            request.end_headers()

    def handler(self) -> type[BaseHTTPRequestHandler]:
        """Return what answers a request."""
        other = self

        class Handler(BaseHTTPRequestHandler):
            def do_GET(self) -> None:
                other.give(self)

            def do_POST(self) -> None:
                other.take(self)

            def log_message(self, *_: object) -> None:
                pass

        return Handler


class PictureFaults(Faults):
    """A camera of pictures, a receiver of messages and the service, and the faults done to them.

    Parameters
    ----------
    folder, port, seed : of `Faults`.
    source : how the pictures come.
    """

    def __init__(self, folder: Path, *, port: int, seed: int, source: Source) -> None:
        super().__init__(folder, port=port, seed=seed, setting=Setting(speed=SPEED))
        self.source: str = source
        self.made, self.followed = folder / "made", folder / "followed"
        self.followed.mkdir(exist_ok=True)
        self.camera_port = free_port()
        self.other = Other(camera=f"http://{ADDRESS}:{self.camera_port}/record/current.jpg")
        self.given: dict[str, bytes] = {}
        self.alter: Callable[[bytes], bytes] | None = None
        self.holds = False
        self._taken: set[str] = set()
        self._held: list[tuple[str, bytes]] = []
        self.server = ThreadingHTTPServer((ADDRESS, 0), self.other.handler())
        self.server.daemon_threads = True
        threading.Thread(target=self.server.serve_forever, daemon=True).start()

    def __exit__(self, *error: object) -> None:
        super().__exit__(*error)
        self.server.shutdown()
        self.server.server_close()

    def drawn(self) -> Iterator[str]:
        """Yield faults without end, each kind once before any comes again."""
        possible = [fault for fault in FAULTS[self.source] if self.has_own_disk or fault not in NEEDS_OWN_DISK]
        while True:
            yield from self.random.sample(possible, len(possible))

    def source_section(self) -> str:
        """Return the settings of the source and of the receiver."""
        secret = self.folder / "secret"
        secret.write_text(_SECRET + "\n")
        address = f"http://{ADDRESS}:{self.server.server_address[1]}"
        sections = {
            "folder": f'[folder]\npath = "{self.followed}"\nutc_offset = "0"\n',
            "http": f'[http]\nurl = "{address}/current.jpg"\n',
        }
        push = f'[push]\nwebhooks = ["{address}/hook"]\nwebhook_secret_file = "{secret}"\n'
        return sections[self.source] + push

    def start_imager(self) -> None:
        """Start the simulated camera a slot after the latest time that it can have shown, by day."""
        truth = self.folder / "truth.json"
        truth.unlink(missing_ok=True)
        began = self._next_start()
        self._known = (began, now())
        start = datetime.fromtimestamp(began, UTC).isoformat()
        place = ("--folder", str(self.made)) if self.source == "folder" else ("--http", f"{ADDRESS}:{self.camera_port}")
        common = ("--start", start, "--speed", str(SPEED), "--cadence", str(self.setting.cadence_s))
        command = [sys.executable, "-m", "sunarc", "simulate", *place, *common, "--truth", str(truth)]
        with (self.folder / "imager.log").open("ab") as log:
            self.imager = subprocess.Popen(command, stdin=subprocess.PIPE, text=True, stdout=log, stderr=log)
        self.wait_for(truth.exists, what="the camera")

    def tend(self) -> None:
        """Hand the pictures on that the camera has made, as an upload does."""
        for path in sorted(self.made.rglob("image-*.jpg")):
            name = path.relative_to(self.made).as_posix()
            content = path.read_bytes()
            if name in self._taken or not content.endswith(b"\xff\xd9"):
                continue
            self._taken.add(name)
            self._held.append((name, content))
        if self.holds or not self.followed.is_dir():
            return
        self.random.shuffle(self._held)
        while self._held:
            self._give(*self._held.pop())

    def _give(self, name: str, content: bytes) -> None:
        changed = content if self.alter is None else self.alter(content)
        path = self.followed / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(changed)
        if changed is content:
            self.given[name] = content

    def end(self) -> list[str]:
        """Return the whole pictures by day that were handed on and have no sighting."""
        if self.source != "folder":
            return []
        self.holds = True
        forgotten: list[str] = []
        for _ in range(60):
            self.wait(1.0)
            stored = self._stored_times()
            forgotten = sorted(name for name in self.given if _time_us(name) not in stored)
            if not forgotten:
                break
        return forgotten

    def _stored_times(self) -> set[int]:
        stored = set() if self.judge is None else self.judge.stored() or set()
        return {time for time, _ in stored}

    # Faults of uploads.

    def _late_uploads(self) -> None:
        self.holds = True
        self.wait(self.random.uniform(5.0, 20.0) * SLOT_S)
        self.holds = False
        self.tend()

    def _altered(self, alter: Callable[[bytes], bytes]) -> None:
        self.alter = alter
        self.wait(self.random.uniform(3.0, 10.0) * SLOT_S)
        self.alter = None

    def _truncated(self) -> None:
        self._altered(lambda content: content[: self.random.randrange(len(content) - 2)])

    def _flipped_picture(self) -> None:
        self._altered(lambda content: _flipped(content, self.random.randrange(8 * len(content))))

    def _one_picture(self) -> None:
        first: list[bytes] = []

        def same(content: bytes) -> bytes:
            first.append(content)
            return bytes(first[0])

        begin = self.frame_time() or self._known[0]
        self._altered(same)
        if self.judge is not None:
            self.judge.repeated(begin, self.latest_time())

    def _junk(self) -> None:
        for content in (b"", b"<html>401</html>", bytes(1 << 16), os.urandom(5000)):
            (self.followed / f"image-{datetime.fromtimestamp(self.latest_time(), UTC):%Y%m%d%H%M%S}x.jpg").write_bytes(
                content
            )
            self.wait(SLOT_S)

    def _copies(self) -> None:
        for name in self.random.sample(sorted(self.given), min(3, len(self.given))):
            copy = self.followed / "copies" / Path(name).name
            copy.parent.mkdir(exist_ok=True)
            copy.write_bytes(self.given[name])
        self.wait(SLOT_S)

    def _folder_away(self) -> None:
        away = self.followed.with_name("away")
        self.followed.rename(away)
        self.wait(self.random.uniform(1.0, 10.0) * SLOT_S)
        if self.random.random() < 0.5:  # another file system, with the same files
            shutil.copytree(away, self.followed)
            shutil.rmtree(away)
        else:
            away.rename(self.followed)

    # Faults of an address, and of a receiver.

    def _answers(self, mode: str) -> None:
        self.other.mode = mode
        self.wait(self.random.uniform(2.0, 8.0) * SLOT_S)
        self.other.mode = "picture"

    _unavailable = partialmethod(_answers, "unavailable")
    _page = partialmethod(_answers, "page")
    _drip = partialmethod(_answers, "drip")
    _endless = partialmethod(_answers, "endless")
    _stale = partialmethod(_answers, "stale")
    _redirect = partialmethod(_answers, "redirect")

    def _refused(self) -> None:
        assert self.imager is not None
        self.imager.send_signal(signal.SIGSTOP)
        self.wait(self.random.uniform(2.0, 8.0) * SLOT_S)
        self.imager.send_signal(signal.SIGCONT)

    def _receiver_drips(self) -> None:
        self.other.drips = True
        self.get("/v1/refits", method="POST")
        self.wait(self.random.uniform(2.0, 10.0) * SLOT_S)
        self.other.drips = False

    def _receiver_refuses(self) -> None:
        self.other.refuses = True
        self.get("/v1/refits", method="POST")
        self.wait(self.random.uniform(2.0, 10.0) * SLOT_S)
        self.other.refuses = False

    def _flipped_bit(self) -> None:
        """Flip a bit of a file that the service writes; it has to start, or to end with a reason. Then put it back."""
        self.stop_service(self.random.choice([signal.SIGTERM, signal.SIGKILL]))
        kept, judge, self.judge = self.folder / "kept", self.judge, None
        shutil.copytree(self.state, kept, ignore=shutil.ignore_patterns("reserve", "lock", "ballast"))
        files = sorted(one for one in kept.rglob("*") if one.is_file() and one.stat().st_size)
        chosen = self.random.choice(files).relative_to(kept)
        content = (self.state / chosen).read_bytes()
        (self.state / chosen).write_bytes(_flipped(content, self.random.randrange(8 * len(content))))
        self._log(f"a bit of {chosen}")
        self._starts_or_says_why(chosen)
        for name in _WRITTEN:
            (self.state / name).unlink(missing_ok=True)
        shutil.copytree(kept, self.state, dirs_exist_ok=True)
        shutil.rmtree(kept)
        self.judge = judge
        self.start_service()

    def _starts_or_says_why(self, chosen: Path) -> None:
        try:
            self.start_service()
            pause(3.0 * SLOT_S)
        except RuntimeError as error:
            code = None if self.service is None else self.service.poll()
            if code not in _CLEAN_ENDS:
                self.exits.append(f"a bit of {chosen}: {error}, code {code}")
        if self.service is not None and self.service.poll() is None:
            self.stop_service(signal.SIGTERM)
        self.service = None


def _flipped(content: bytes, bit: int) -> bytes:
    changed = bytearray(content)
    changed[bit // 8] ^= 1 << bit % 8
    return bytes(changed)


def _time_us(name: str) -> int:
    stated = datetime.strptime(Path(name).stem, "image-%Y%m%d%H%M%S").replace(tzinfo=UTC)
    return round(1e6 * stated.timestamp())
