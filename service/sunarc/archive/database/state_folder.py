"""The state folder: one service at a time, and the owner of what is written into it.

The kernel drops the lock with the process, however it ends, so that a file left by `kill -9` is no obstacle.
"""

from __future__ import annotations

import fcntl
import os
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from sunarc.errors import OutsideError

PRIVATE = 0o640
"""Mode of a copy of the database: its owner, and the group for backups."""


def give_to_owner_of(folder: Path, path: Path) -> None:
    """Set a file's owner and group to those of a folder, where this process may (root does).

    A file made by root in the service's state folder could not be written by the service.
    """
    if os.geteuid() != 0:
        return
    owner = folder.stat()
    os.chown(path, owner.st_uid, owner.st_gid)


_NAME = "lock"
_ATTEMPTS, _BETWEEN_S = 3, 0.02
"""`lock_holder` of another process holds the lock for microseconds; a service holds it for good."""


_SERVICE = "stop that service first (systemctl stop sunarc), or set `state` to another folder"


@contextmanager
def lock_state(folder: Path, *, remedy: str = _SERVICE) -> Iterator[None]:
    """Hold the lock of a state folder, or of the folder of a long run's results.

    Parameters
    ----------
    folder : the folder.
    remedy : what to do where another process holds it.

    Raises
    ------
    OutsideError : another process holds it (its id is named), or the file cannot be opened.
    """
    path = folder / _NAME
    try:
        descriptor = os.open(path, os.O_RDWR | os.O_CREAT, 0o644)  # not inherited by child processes
        give_to_owner_of(folder, path)
    except OSError as error:
        raise OutsideError(f"{path}: {error.strerror}; make it writable for the service's user") from None
    try:
        _take(descriptor, folder, remedy)
        os.ftruncate(descriptor, 0)
        # Written after the lock is held: what a reader finds is the holder's id or nothing.
        os.pwrite(descriptor, f"{os.getpid()}\n".encode(), 0)
        yield
    finally:
        os.close(descriptor)


def lock_holder(folder: Path) -> int | None:
    """Return the id of the process that holds the lock of a state folder; None when none does.

    Id 0 stands for a holder that has not written its id yet.
    """
    try:
        descriptor = os.open(folder / _NAME, os.O_RDONLY)
    except OSError:
        return None
    try:
        fcntl.flock(descriptor, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except BlockingIOError:
        return _pid(descriptor)
    else:
        return None
    finally:
        os.close(descriptor)


def require_unlocked(folder: Path) -> None:
    """Raise `OutsideError` when a process holds the lock of a state folder."""
    holder = lock_holder(folder)
    if holder is not None:
        raise _in_use(folder, holder, _SERVICE)


def _take(descriptor: int, folder: Path, remedy: str) -> None:
    for _ in range(_ATTEMPTS):
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            threading.Event().wait(_BETWEEN_S)
        else:
            return
    raise _in_use(folder, _pid(descriptor), remedy)


def _in_use(folder: Path, holder: int, remedy: str) -> OutsideError:
    return OutsideError(f"folder {folder} is in use by process {holder}; {remedy}")


def _pid(descriptor: int) -> int:
    text = os.pread(descriptor, 32, 0).strip()
    return int(text) if text.isdigit() else 0
