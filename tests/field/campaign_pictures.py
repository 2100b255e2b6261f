"""The campaign's cameras of pictures: a folder that another program fills, an address that gives the present one."""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import sys
from collections.abc import Callable
from datetime import UTC, datetime
from functools import partialmethod
from pathlib import Path

from tests.fixtures.ports import free_port

from .campaign_faults import Faults, Source, flipped
from .campaign_processes import ADDRESS, CADENCE_S, Setting, now

SPEED = 60.0
"""Pictures cost more than exposures of the sun: each is coded and decoded."""
SLOT_S = CADENCE_S / SPEED


class PictureFaults(Faults):
    """A camera of pictures, a receiver of messages and the service, and the faults done to them.

    Parameters
    ----------
    folder, port, seed : of `Faults`.
    source : how the pictures come.
    """

    def __init__(self, folder: Path, *, port: int, seed: int, source: Source) -> None:
        super().__init__(folder, port=port, seed=seed, setting=Setting(speed=SPEED), source=source)
        self.camera_port = free_port()
        self.other.camera = f"http://{ADDRESS}:{self.camera_port}/record/current.jpg"
        self.made, self.followed = folder / "made", folder / "followed"
        self.followed.mkdir(exist_ok=True)
        self.given: dict[str, bytes] = {}
        self.alter: Callable[[bytes], bytes] | None = None
        self.holds = False
        self._taken: set[str] = set()
        self._held: list[tuple[str, bytes]] = []

    def source_section(self) -> str:
        """Return the settings of the source."""
        sections = {
            "folder": f'[folder]\npath = "{self.followed}"\nutc_offset = "0"\n',
            "http": f'[http]\nurl = "{self.address}/current.jpg"\n',
        }
        return sections[self.source]

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
        super().tend()
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
            return super().end()
        self.holds = True
        forgotten: list[str] = []
        for _ in range(60):
            self.wait(1.0)
            stored = self._stored_times()
            forgotten = sorted(name for name in self.given if _time_us(name) not in stored)
            if not forgotten:
                break
        return forgotten + super().end()

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
        self._altered(lambda content: flipped(content, self.random.randrange(8 * len(content))))

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

    # Faults of an address.

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


def _time_us(name: str) -> int:
    stated = datetime.strptime(Path(name).stem, "image-%Y%m%d%H%M%S").replace(tzinfo=UTC)
    return round(1e6 * stated.timestamp())
