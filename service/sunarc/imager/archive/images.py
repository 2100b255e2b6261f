"""Composites on disk: written whole or not at all, in folders by UTC date, the oldest removed when room is needed."""

from __future__ import annotations

import errno
import os
import re
import shutil
import threading
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated, BinaryIO

from annotated_types import Ge, Gt, Le

from sunarc.common.bounds import require_bounds
from sunarc.common.errors import InputError, OutsideError

_STAMP = "%Y%m%dT%H%M%S"
_OURS = re.compile(r"(\d{8}T\d{6})\.\d{3}Z_(?:hdr\.png|hdr\.jpg|night\.jpg|night\.json)")
_DAYS = "[0-9]*/[0-9]*/[0-9]*"
_FULL = frozenset({errno.ENOSPC, errno.EDQUOT})
_MB = 1e6
_LEAST_FREE_FILES = 16
"""Inodes: a cycle's images, their folders, and the database's own files."""


@dataclass(frozen=True, slots=True, kw_only=True)
class DiskOptions:
    """Limits of the images' disk space.

    Attributes
    ----------
    keep_days : images older than this are removed.
    keep_free_mb : megabytes (10⁶ bytes) that images leave free; the oldest go first.
    reserve_mb : megabytes held in a file, and given to the database when the disk is full all the same.
    """

    keep_days: Annotated[float, Gt(0.0), Le(36_500.0)] = 30.0
    keep_free_mb: Annotated[float, Ge(1.0), Le(1e9)] = 1200.0
    reserve_mb: Annotated[float, Ge(0.0), Le(1e6)] = 32.0

    def __post_init__(self) -> None:
        """Refuse options that leave the database no room."""
        require_bounds(self, section_path="disk")
        if self.keep_free_mb < 2.0 * self.reserve_mb:
            raise InputError(
                field="disk.keep_free_mb", problem="less than twice the reserve", remedy="raise it, or lower reserve_mb"
            )


@dataclass(frozen=True, slots=True, kw_only=True)
class DiskUsage:
    """Space that is free and is to be kept free, space of the images, time of the oldest one, lack of inodes."""

    free_bytes: int
    keep_free_bytes: int
    images_bytes: int
    oldest_image_at: datetime | None
    out_of_files: bool = False


class ImageStore:
    """Writes images under `images/YYYY/MM/DD/`, and removes the oldest; any thread may do either.

    Parameters
    ----------
    folder : the root of the dated folders. Files in it that are not named as ours are left alone.
    options : how much of the disk it may have.
    free_bytes : asks how much of the disk is free.
    """

    def __init__(
        self,
        folder: Path,
        *,
        options: DiskOptions | None = None,
        free_bytes: Callable[[Path], int] = lambda folder: shutil.disk_usage(folder).free,
    ) -> None:
        self.folder = folder
        self._keep_free_bytes = int((options or DiskOptions()).keep_free_mb * _MB)
        self._free_bytes = free_bytes
        self._lock = threading.RLock()
        self._bytes: int | None = None
        self._oldest: deque[Path] = deque()

    def path(self, captured_at: datetime, *, kind: str) -> Path:
        """Return where an image of this moment and kind ("hdr.png", "hdr.jpg") stands."""
        time = captured_at.astimezone(UTC)
        return self.folder / f"{time:%Y/%m/%d}" / f"{time:{_STAMP}}.{time.microsecond // 1000:03d}Z_{kind}"

    def write(self, captured_at: datetime, encoded: bytes, *, kind: str) -> Path:
        """Write an encoded image atomically and return its path; older images make room for it.

        Raises
        ------
        OutsideError : when the disk refuses, or what would be left free is less than is to be kept.
        """
        target = self.path(captured_at, kind=kind)
        while True:
            # Free space of the file system may not be available to this user (quota, reserved blocks): when the write
            # itself fails because the disk is full, the oldest image is removed and the write is repeated.
            if not self.make_room(len(encoded)):
                raise OutsideError(f"image {target.name} was not written: the disk has too little room")
            try:
                write_atomically(target, encoded)
            except OSError as error:
                if error.errno in _FULL and self._remove_oldest():
                    continue
                why = "no inodes are left" if self._lacks_inodes() else error.strerror or str(error)
                raise OutsideError(f"image {target.name} could not be written: {why}") from error
            with self._lock:
                self._bytes = None if self._bytes is None else self._bytes + len(encoded)
            return target

    def newest(self, *, kind: str, until: datetime | None = None) -> Path | None:
        """Return the newest image of a kind that is not dated later than `until`, or None."""
        last = "" if until is None else self.path(until, kind=kind).name
        with self._require_readable():
            for folder in sorted(self.folder.glob(_DAYS), reverse=True):
                images = [path for path in folder.glob(f"*_{kind}") if not last or path.name <= last]
                if images:
                    return max(images)
        return None

    def newest_at(self, *, kind: str, until: datetime | None = None) -> datetime | None:
        """Return when the newest image of a kind was captured, or None; see `newest`."""
        path = self.newest(kind=kind, until=until)
        return None if path is None or not _OURS.fullmatch(path.name) else _captured_at(path)

    def between(
        self, *, kind: str, since: datetime | None = None, until: datetime | None = None, limit: int
    ) -> list[tuple[datetime, Path]]:
        """Return times and files of the images of a kind with since <= time < until, the newest first.

        Parameters
        ----------
        kind : as `path` takes it.
        since, until : aware times; None is open. The folders of other days are not read.
        limit : so many at most.
        """
        found: list[tuple[datetime, Path]] = []
        with self._require_readable():
            for folder in self._list_day_folders(since, until):
                for path in sorted(folder.glob(f"*_{kind}"), reverse=True):
                    if not _OURS.fullmatch(path.name):
                        continue
                    time = _captured_at(path)
                    if since is not None and time < since:
                        return found
                    if until is None or time < until:
                        found.append((time, path))
                    if len(found) == limit:
                        return found
        return found

    def _list_day_folders(self, since: datetime | None, until: datetime | None) -> Iterator[Path]:
        """Yield the folders of the dates that an interval touches, the newest first."""
        first, last = ("" if one is None else f"{one.astimezone(UTC):%Y/%m/%d}" for one in (since, until))
        for folder in sorted(self.folder.glob(_DAYS), reverse=True):
            date = folder.relative_to(self.folder).as_posix()
            if date >= first and (not last or date <= last):
                yield folder

    def make_room(self, needed_bytes: int = 0) -> bool:
        """Remove the oldest images until this much can be written; return whether it can."""
        with self._require_readable():
            while self._measure_free_bytes() - needed_bytes < self._keep_free_bytes:
                if not self._remove_oldest():
                    return False
        return True

    def expire(self, before: datetime, *, keep_newest_days: int = 0) -> int:
        """Remove the images from before a time, and return how many.

        Parameters
        ----------
        before : images of this time and later stay.
        keep_newest_days : so many of the newest dates with images stay whatever their age: a clock that is years ahead
            makes all others old, and then each day of new images removes one day of old ones at most.
        """
        removed = 0
        with self._require_readable():
            while (folder := self._find_expirable_folder(before, keep_newest_days)) is not None:
                removed_before = removed
                while self._remove_oldest(before=before, within=folder):
                    removed += 1
                if removed == removed_before:  # the file system refuses
                    break
        return removed

    def _find_expirable_folder(self, before: datetime, keep_newest_days: int) -> Path | None:
        """Return the folder of the oldest image where that one may be removed by its age."""
        with self._lock:
            oldest = self._find_oldest_image()
            if oldest is None or _captured_at(oldest) >= before or self._count_dates_since(oldest) <= keep_newest_days:
                return None
            return oldest.parent

    def _count_dates_since(self, image: Path) -> int:
        """Return how many dates have a folder, from an image's own on."""
        return sum(folder >= image.parent for folder in self.folder.glob(_DAYS))

    def usage(self) -> DiskUsage:
        """Return the size of the images; counted once, then kept up to date."""
        with self._lock, self._require_readable():
            if self._bytes is None:
                self._bytes = sum(
                    _file_size_bytes(path) for path in self.folder.rglob("*") if _OURS.fullmatch(path.name)
                )
            oldest = self._find_oldest_image()
            return DiskUsage(
                free_bytes=self._measure_free_bytes(),
                keep_free_bytes=self._keep_free_bytes,
                out_of_files=self._lacks_inodes(),
                images_bytes=self._bytes,
                oldest_image_at=None if oldest is None else _captured_at(oldest),
            )

    def clear_up(self) -> None:
        """Remove the partial files of an interrupted write."""
        with self._require_readable():
            for part in self.folder.rglob("*.part"):
                part.unlink(missing_ok=True)

    @contextmanager
    def _require_readable(self) -> Iterator[None]:
        """Raise `OutsideError` where the folder cannot be read; `glob` and `rglob` alone would return nothing."""
        try:
            if self.folder.exists():
                os.scandir(self.folder).close()
            yield
        except OSError as error:
            raise OutsideError(f"image folder {self.folder}: {error.strerror or error}") from error

    def _measure_free_bytes(self) -> int:
        return self._free_bytes(self._existing_folder())

    def _lacks_inodes(self) -> bool:
        """Return whether the file system can hold no more files; some (btrfs) have no such limit and say 0 of 0."""
        try:
            found = os.statvfs(self._existing_folder())
        except OSError:
            return False
        return found.f_files > 0 and found.f_favail < _LEAST_FREE_FILES

    def _existing_folder(self) -> Path:
        folder = self.folder
        while not folder.exists():
            folder = folder.parent
        return folder

    def _find_oldest_image(self) -> Path | None:
        """Return the oldest image; the files of one day are listed at a time."""
        while self._oldest and not self._oldest[0].exists():
            self._oldest.popleft()
        if not self._oldest:
            # One day at a time: a month has a hundred thousand files, and only the oldest are asked for.
            for folder in sorted(self.folder.glob(_DAYS)):
                self._oldest.extend(path for path in sorted(folder.iterdir()) if _OURS.fullmatch(path.name))
                if self._oldest:
                    break
        return self._oldest[0] if self._oldest else None

    def _remove_oldest(self, *, before: datetime | None = None, within: Path | None = None) -> bool:
        with self._lock:
            oldest = self._find_oldest_image()
            if oldest is None or (before is not None and _captured_at(oldest) >= before):
                return False
            if within is not None and oldest.parent != within:
                return False
            size = _file_size_bytes(oldest)
            try:
                oldest.unlink()
            except OSError:
                return False
            self._bytes = None if self._bytes is None else self._bytes - size
            self._oldest.popleft()
            _remove_empty_folders(oldest.parent, root=self.folder)
            return True


def write_atomically(target: Path, encoded: bytes) -> None:
    """Write in the folder of the target, to the disk itself, and rename: a power cut leaves all of it or nothing.

    Raises
    ------
    OSError : the disk refuses; the target is as it was.
    """
    target.parent.mkdir(parents=True, exist_ok=True)
    with replacing(target) as file:
        file.write(encoded)


@contextmanager
def replacing(target: Path) -> Iterator[BinaryIO]:
    """Return a file in the target's folder, which exists; it takes the target's place at the end as a whole.

    Raises
    ------
    OSError : the disk refuses; the target is as it was.
    """
    part = target.with_suffix(target.suffix + ".part")
    try:
        with part.open("wb") as file:
            yield file
            file.flush()
            # Before the rename: else the name could reach the disk before the data do.
            os.fdatasync(file.fileno())
        part.replace(target)
    except OSError:
        with suppress(OSError):
            part.unlink()
        raise


def time_in_name(path: Path) -> datetime | None:
    """Return when an image was captured by its name; None for a file that is not named as ours are."""
    return _captured_at(path) if _OURS.fullmatch(path.name) else None


def _captured_at(path: Path) -> datetime:
    return datetime.strptime(path.name[:19], f"{_STAMP}.%f").replace(tzinfo=UTC)


def _file_size_bytes(path: Path) -> int:
    try:
        return path.stat().st_size
    except OSError:
        return 0


def _remove_empty_folders(folder: Path, *, root: Path) -> None:
    """Remove a day's folder, and its month's and year's, where nothing is left in them."""
    while folder != root:
        try:
            folder.rmdir()
        except OSError:
            return
        folder = folder.parent
