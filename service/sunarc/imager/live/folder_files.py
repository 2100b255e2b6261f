"""The files of a folder that grows: which are new or were written over, and which of them are complete."""

from __future__ import annotations

import fnmatch
import logging
import os
import threading
from collections.abc import Generator, Iterator
from contextlib import suppress
from pathlib import Path, PurePosixPath
from typing import NamedTuple

import watchfiles

from sunarc.common.foreign_files import name_path, name_text, require_regular
from sunarc.imager.runtime.clock import Clock
from sunarc.imager.runtime.loop import Loop
from sunarc.sources.file_kinds import DERIVED_FOLDERS, ONE_IMAGE, find_kind, is_derived
from sunarc.sources.source_files import SourceFile

_log = logging.getLogger(__name__)
logging.getLogger("watchfiles").setLevel(logging.WARNING)  # else each image is a line of the journal
_WITHOUT_EVENTS = frozenset(
    {"nfs", "nfs4", "cifs", "smb3", "smbfs", "9p", "afs", "ncpfs", "fuse.sshfs", "fuse.rclone", "fuse.s3fs", "virtiofs"}
)
"""File systems of which another machine's changes are not reported."""
_NEWEST_FOLDERS = 3
"""Folders whose files are read again though no name in them is new: one may have been written over."""
_COARSE_NS = 2_000_000_000
"""Of the time of a folder's last change: FAT and some servers have 2 s."""
_EVENTS_MS = 500
_LIST_S = 60.0


def is_image(name: str, pattern: str) -> bool:
    """Return whether a file, by its path below the folder, is an image of the camera's."""
    return find_kind(name) in ONE_IMAGE and not is_derived(name) and fnmatch.fnmatch(PurePosixPath(name).name, pattern)


class _FolderState(NamedTuple):
    """State of a subfolder: the time of its last change when it was listed, and its own subfolders."""

    changed_ns: int
    subfolders: tuple[str, ...]


class DeniedFolder(NamedTuple):
    """A subfolder that may not be read, when it last changed, and the system's message."""

    name: str
    changed_ns: int
    error: str


class FolderListing:
    """Listing of a folder which, after the first time, reads only its changed and newest subfolders.

    `denied` is what the last listing could not read.

    Parameters
    ----------
    root : the folder.
    pattern : of the names of images.
    """

    def __init__(self, root: Path, pattern: str) -> None:
        self._root, self._pattern = root, pattern
        self._known: dict[str, _FolderState] = {}
        self._device: tuple[int, int] | None = None
        self.denied: DeniedFolder | None = None

    def files(self, *, now_ns: int) -> Iterator[SourceFile]:
        """Yield files that may be new or changed, with their stamps; all of them the first time and after a remount.

        Raises
        ------
        OSError : the folder itself cannot be read.
        """
        state = self._root.stat()
        if self._device != (state.st_dev, state.st_ino):
            self._known, self._device = {}, (state.st_dev, state.st_ino)
        os.scandir(self._root).close()
        self.denied = None
        newest = sorted(self._known, key=lambda name: self._known[name].changed_ns)[-_NEWEST_FOLDERS:]
        yield from self._list_changed("", {"", *newest}, set(), now_ns)

    def forget(self) -> None:
        """Have the next listing read the whole folder."""
        self._known = {}

    def _list_changed(
        self, folder: str, again: set[str], above: set[tuple[int, int]], now_ns: int
    ) -> Iterator[SourceFile]:
        try:
            state = (self._root / name_path(folder)).stat()
            here = (state.st_dev, state.st_ino)
            if here in above:  # a link to a folder above it
                return
            known = self._known.get(folder)
            if known is None or known.changed_ns != state.st_mtime_ns or folder in again:
                with os.scandir(self._root / name_path(folder)) as entries:
                    found = sorted(entries, key=lambda one: one.name)
                subfolders = tuple(f"{folder}{name_text(one.name)}/" for one in found if _is_folder(one))
                yield from self._list_images(folder, found)
                # a name may be added within the resolution of the folder's own time: it is listed again then
                is_settled = now_ns - state.st_mtime_ns > _COARSE_NS
                self._known[folder] = known = _FolderState(state.st_mtime_ns if is_settled else -1, subfolders)
        except OSError as error:
            if not folder:
                raise
            if isinstance(error, PermissionError):
                self._note_denied(folder, error)
            _log.warning("%s/%s cannot be listed: %s", name_text(self._root), folder, error.strerror)
            return
        for one in known.subfolders:
            yield from self._list_changed(one, again, above | {here}, now_ns)

    def _note_denied(self, folder: str, error: PermissionError) -> None:
        """Keep the subfolder that changed last of those that may not be read."""
        with suppress(OSError):
            changed_ns = (self._root / name_path(folder)).stat().st_mtime_ns
            if self.denied is None or changed_ns > self.denied.changed_ns:
                self.denied = DeniedFolder(folder, changed_ns, error.strerror or str(error))

    def _list_images(self, folder: str, entries: list[os.DirEntry[str]]) -> Iterator[SourceFile]:
        for entry in entries:
            name = folder + name_text(entry.name)
            if is_image(name, self._pattern):
                try:
                    found = source_file(name, entry.stat())
                except PermissionError as error:  # its folder may be listed and not entered
                    self._note_denied(folder, error)
                    return
                except OSError:  # it is gone again, or no file
                    continue
                yield found


def _is_folder(entry: os.DirEntry[str]) -> bool:
    with suppress(OSError):
        return entry.is_dir() and not entry.name.startswith(".") and entry.name.lower() not in DERIVED_FOLDERS
    return False


def source_file(name: str, state: os.stat_result) -> SourceFile:
    """Return a file with its size, and a stamp that changes when it is written over; UnfitFileError for others."""
    require_regular(state, name)
    return SourceFile(name, state.st_size, f"{state.st_size}-{state.st_mtime_ns}")


def changed_s(file: SourceFile) -> float:
    """Return when a file of a folder was last changed, s since 1970-01-01; at most that of the year 2200.

    File systems keep times that no date can state.
    """
    return min(max(int(file.stamp.partition("-")[2]) / 1e9, 0.0), _LATEST_CHANGE_S)


_LATEST_CHANGE_S = 7.258e9


class Settling:
    """Files that arrived, kept until they have not changed for a while.

    Parameters
    ----------
    root : the folder.
    settle_s : how long a file must not have changed, s.
    """

    def __init__(self, root: Path, settle_s: float) -> None:
        self._root, self._settle_s = root, settle_s
        self._waiting: dict[str, tuple[str, float]] = {}

    def __len__(self) -> int:
        return len(self._waiting)

    def __contains__(self, name: str) -> bool:
        return name in self._waiting

    def add(self, file: SourceFile, now_s: float) -> None:
        """Take note of a file as it is now."""
        before = self._waiting.get(file.name)
        if before is None or before[0] != file.stamp:
            self._waiting[file.name] = (file.stamp, now_s)

    def settled(self, now_s: float) -> list[SourceFile]:
        """Return the files that have not changed for long enough, in the order of their names; they wait no longer."""
        ready = []
        for name in sorted(self._waiting):
            stamp, since_s = self._waiting[name]
            if now_s - since_s < self._settle_s:
                continue
            try:
                file = source_file(name, (self._root / name_path(name)).stat())
            except OSError:  # renamed, or removed
                del self._waiting[name]
                continue
            if file.stamp != stamp:
                self._waiting[name] = (file.stamp, now_s)
                continue
            del self._waiting[name]
            ready.append(file)
        return ready


def reports_changes(root: Path) -> bool:
    """Return whether the file system of a folder reports the changes of whoever writes to it."""
    try:
        mounts = Path("/proc/self/mountinfo").read_text(encoding="utf-8", errors="replace").splitlines()
        path = root.resolve()
    except OSError:
        return False
    kinds = dict[str, str]()
    for line in mounts:
        before, _, after = line.partition(" - ")
        kinds[before.split()[4].replace("\\040", " ")] = after.split()[0]
    nearest = max((one for one in kinds if path.is_relative_to(one)), key=len, default="/")
    return kinds.get(nearest, "") not in _WITHOUT_EVENTS


class FolderWatch:
    """Waits until something changes in a folder: by events, or so many seconds without them.

    Parameters
    ----------
    root : the folder.
    clock : real time.
    poll_s : seconds from look to look without events.
    polling : not to use events.
    """

    def __init__(self, root: Path, clock: Clock, *, poll_s: float, polling: bool) -> None:
        self._root, self._clock, self._poll_s = root, clock, poll_s
        self._polling = polling or not reports_changes(root)
        self._events: Generator[set[tuple[watchfiles.Change, str]], None, None] | None = None
        self._stop = threading.Event()

    @property
    def list_every_s(self) -> float:
        """Seconds between two listings: with events these find the changes that no event reported."""
        return self._poll_s if self._polling else _LIST_S

    def close(self) -> None:
        """Stop the reports of changes."""
        self._stop.set()
        if self._events is not None:
            self._events.close()
            self._events = None

    def restart(self) -> None:
        """Begin the reports anew: those of a folder that was replaced never come."""
        self.close()
        self._stop = threading.Event()

    def wait(self, loop: Loop, seconds: float) -> set[str]:
        """Wait so many seconds at most, less where something changes; return the names that were reported."""
        if self._polling:
            loop.wait(min(seconds, self._poll_s))
            return set()
        try:
            if self._events is None:
                self._events = watchfiles.watch(
                    self._root, watch_filter=None, debounce=200, step=50, stop_event=self._stop,
                    rust_timeout=_EVENTS_MS, yield_on_timeout=True, raise_interrupt=False,
                    force_polling=False, ignore_permission_denied=True,
                )  # fmt: skip
            changed = next(self._events, set())
        except (OSError, RuntimeError) as error:
            _log.warning(
                "%s cannot be watched and is listed every %g s instead: %s", name_text(self._root), self._poll_s, error
            )
            self.close()
            self._polling = True
            return set()
        root = str(self._root)
        return {name_text(path.removeprefix(root).lstrip("/")) for _, path in changed}
