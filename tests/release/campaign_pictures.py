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
from .campaign_network import with_comment
from .campaign_processes import ADDRESS, Setting, now


class PictureFaults(Faults):
    """A camera of pictures, a receiver of messages and the service, and the faults done to them.

    Parameters
    ----------
    folder, port, seed, setting : of `Faults`.
    source : how the pictures come.
    """

    def __init__(self, folder: Path, *, port: int, seed: int, setting: Setting, source: Source) -> None:
        super().__init__(folder, port=port, seed=seed, setting=setting, source=source)
        self.camera_port = free_port()
        self.other.camera = f"http://{ADDRESS}:{self.camera_port}/record/current.jpg"
        self.made, self.followed = folder / "made", folder / "followed"
        self.followed.mkdir(exist_ok=True)
        self.given: set[str] = set()
        self.alter: Callable[[bytes], bytes] | None = None
        self.holds = False
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
        common = ("--start", start, "--speed", str(self.setting.speed), "--cadence", str(self.setting.cadence_s))
        command = [sys.executable, "-m", "sunarc", "simulate", *place, *common, "--truth", str(truth)]
        with (self.folder / "imager.log").open("ab") as log:
            self.imager = subprocess.Popen(command, stdin=subprocess.PIPE, text=True, stdout=log, stderr=log)
        self.wait_for(truth.exists, what="the camera")

    def tend(self) -> None:
        """Hand the pictures on that the camera has made, as an upload does."""
        super().tend()
        for path in sorted(self.made.rglob("image-*.jpg")):
            content = path.read_bytes()
            if content.endswith(b"\xff\xd9"):
                self._held.append((path.relative_to(self.made).as_posix(), content))
                path.unlink()
        with self.held("moving"):
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
            self.given.add(name)

    def forgotten(self, since: float) -> list[str]:
        """Return the whole pictures by day that were handed on and have no sighting."""
        stored = {time for time, _ in self.stored_sightings()}
        given = {name: _time_us(name) for name in self.given}
        return sorted(f"no sighting of {n}" for n, time in given.items() if time < 1e6 * since and time not in stored)

    def end(self) -> list[str]:
        """Hand no more pictures on, and see what comes of the others."""
        self.holds = True
        return super().end()

    # Faults of uploads.

    def _late_uploads(self) -> None:
        self.holds = True
        self.wait(self.random.uniform(5.0, 20.0) * self.slot_s)
        self.holds = False

    def _altered(self, alter: Callable[[bytes], bytes]) -> None:
        self.alter = alter
        self.wait(self.random.uniform(3.0, 10.0) * self.slot_s)
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

        begin, starts = self.frame_time() or self._known[0], self.n_starts
        self._altered(same)
        self._note_copies(begin, starts)

    def _frozen_under_text(self) -> None:
        """Give one picture again and again, under a text that changes and with the times of new ones."""
        begin, starts = self.frame_time() or self._known[0], self.n_starts
        if self.source == "http":
            self._answers("frozen")
        else:
            first: list[bytes] = []

            def same(content: bytes) -> bytes:
                first.append(content)
                return with_comment(first[0], f"picture {len(first)}")

            self._altered(same)
        self._note_copies(begin, starts)

    def _strange_files(self) -> None:
        """Put files of strange names, and what is no file, into the folder; take them away again."""
        folder = os.fsencode(self.followed)
        stem = f"image-{datetime.fromtimestamp(self.latest_time(), UTC):%Y%m%d%H%M%S}".encode()
        names = (
            b"\xff\xfe" + stem,
            stem + b"\n\x1b[31m",
            stem + b"x" * 200,
            "\u0061\u0308".encode(),
            b"image-0001" * 2,
        )
        made = [os.path.join(folder, name + b".jpg") for name in names]  # noqa: PTH118 - bytes
        for path in made:
            with open(path, "wb") as file:  # noqa: PTH123 - bytes
                file.write(b"\xff\xd8 no picture")
        inner = os.path.join(folder, b"\xe9t\xe9")  # noqa: PTH118 - bytes
        os.mkdir(inner)  # noqa: PTH102 - bytes
        pipe, link = os.path.join(folder, stem + b"p.jpg"), os.path.join(inner, stem + b"z.jpg")  # noqa: PTH118 - bytes
        os.mkfifo(pipe)
        os.symlink("/dev/zero", link)  # noqa: PTH211 - bytes
        self.wait(self.random.uniform(3.0, 8.0) * self.slot_s)
        for path in (*made, pipe, link):
            os.unlink(path)  # noqa: PTH108 - bytes
        os.rmdir(inner)  # noqa: PTH106 - bytes

    def _junk(self) -> None:
        for content in (b"", b"<html>401</html>", bytes(1 << 16), os.urandom(5000)):
            (self.followed / f"image-{datetime.fromtimestamp(self.latest_time(), UTC):%Y%m%d%H%M%S}x.jpg").write_bytes(
                content
            )
            self.wait(self.slot_s)

    def _copies(self) -> None:
        given = sorted(self.given.copy())
        for name in self.random.sample(given, min(3, len(given))):
            copy = self.followed / "copies" / Path(name).name
            copy.parent.mkdir(exist_ok=True)
            shutil.copyfile(self.followed / name, copy)
        self.wait(self.slot_s)

    def _folder_away(self) -> None:
        away = self.followed.with_name("away")
        with self.held("moving"):
            self.followed.rename(away)
        self.wait(self.random.uniform(1.0, 10.0) * self.slot_s)
        with self.held("moving"):
            if self.random.random() < 0.5:  # another file system, with the same files
                shutil.copytree(away, self.followed)
                shutil.rmtree(away)
            else:
                away.rename(self.followed)

    # Faults of an address.

    def _answers(self, mode: str) -> None:
        self.other.mode = mode
        self.wait(self.random.uniform(2.0, 8.0) * self.slot_s)
        self.other.mode = "picture"

    _unavailable = partialmethod(_answers, "unavailable")
    _page = partialmethod(_answers, "page")
    _drip = partialmethod(_answers, "drip")
    _endless = partialmethod(_answers, "endless")
    _stale = partialmethod(_answers, "stale")
    _redirect = partialmethod(_answers, "redirect")
    _strange_answers = partialmethod(_answers, "strange")

    def _refused(self) -> None:
        assert self.imager is not None
        self.imager.send_signal(signal.SIGSTOP)
        self.wait(self.random.uniform(2.0, 8.0) * self.slot_s)
        self.imager.send_signal(signal.SIGCONT)


def _time_us(name: str) -> int:
    stated = datetime.strptime(Path(name).stem, "image-%Y%m%d%H%M%S").replace(tzinfo=UTC)
    return round(1e6 * stated.timestamp())
