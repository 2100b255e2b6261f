"""The state folder: one service at a time, and its owner, as whom root works in it.

The kernel drops the lock with the process, however it ends, so that a file left by `kill -9` is no obstacle.
"""

from __future__ import annotations

import fcntl
import os
import pwd
import stat
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from sunarc.common.errors import OutsideError

PRIVATE = 0o640
"""Mode of a copy of the database: its owner, and the group for backups."""
_BY_OTHERS = stat.S_IWOTH | stat.S_IWGRP


@contextmanager
def as_owner(folder: Path) -> Iterator[None]:
    """Have the rights of a folder's owner meanwhile, where the process is root's; else change nothing.

    The owner could place links in the folder that root would follow, and could not use the files that root made. Who
    owns a part of the path can exchange what follows: the first owner on the way who is not root counts.

    Raises
    ------
    OutsideError : others may write into a folder of root's on the way, or could make a missing one; or root may not act
        as the owner here.
    """
    owner = _find_first_owner(folder) if os.geteuid() == 0 else None
    if owner is None:
        yield
        return
    uid, gid = owner
    groups, root_gid = os.getgroups(), os.getegid()
    try:
        _act_as(uid, gid, folder)
        yield
    except PermissionError as error:
        raise OutsideError(
            f"{error.filename or folder} is not for user {_user_name(uid)}, the owner of {folder}, as whom root works "
            "there; name a place that this user may use"
        ) from error
    finally:
        os.seteuid(0)
        os.setegid(root_gid)
        if os.getgroups() != groups:  # where root may not set them, they are as they were
            os.setgroups(groups)


def _act_as(uid: int, gid: int, folder: Path) -> None:
    """Take the rights of a user; OutsideError where root may not, with part of the identity perhaps changed."""
    try:
        os.setgroups(os.getgrouplist(_user_name(uid), gid))
        os.setegid(gid)
        os.seteuid(uid)
    except OSError as error:
        raise OutsideError(
            f"root cannot act as user {_user_name(uid)}, the owner of {folder}: {error.strerror}; "
            "run the command as that user"
        ) from None


def _find_first_owner(folder: Path, most_links: int = 40) -> tuple[int, int] | None:
    """Return user and group of the first part of a path that is not root's, links included; None where all is."""
    place, names = Path("/"), folder.absolute().parts[1:]
    for n, name in enumerate(names, start=1):
        here = place.parent if name == ".." else place / name
        try:
            found = here.lstat()
        except NotADirectoryError:
            return None
        except FileNotFoundError:
            if place.lstat().st_mode & _BY_OTHERS:  # they could make it first, and a sticky folder does not hinder that
                raise OutsideError(
                    f"{here} does not exist, and others may write into {place}; make it and give it to the service's "
                    "user (mkdir, chown), or run the command as that user"
                ) from None
            return None
        if found.st_uid != 0:
            return found.st_uid, found.st_gid
        if stat.S_ISLNK(found.st_mode):
            if not most_links:
                raise OutsideError(f"{folder}: its links have no end; name the folder itself")
            return _find_first_owner(Path(place, here.readlink(), *names[n:]), most_links - 1)
        by_others = stat.S_IWOTH if n < len(names) else _BY_OTHERS
        if found.st_mode & by_others and not found.st_mode & stat.S_ISVTX:
            raise OutsideError(
                f"{here} belongs to root, and others may write into it; give it to the service's user (chown), "
                "or run the command as that user"
            )
        place = here
    return None


def _user_name(uid: int) -> str:
    try:
        return pwd.getpwuid(uid).pw_name
    except KeyError:
        return str(uid)


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
        # not inherited by child processes; of another user's folder no link is followed
        descriptor = os.open(path, os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW, 0o644)
    except OSError as error:
        raise OutsideError(f"{path}: {error.strerror}; make it writable for the service's user") from None
    try:
        _take_lock(descriptor, folder, remedy)
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
        descriptor = os.open(folder / _NAME, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK)
    except OSError:
        return None
    try:
        fcntl.flock(descriptor, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except BlockingIOError:
        return _read_process_id(descriptor)
    else:
        return None
    finally:
        os.close(descriptor)


def require_unlocked(folder: Path) -> None:
    """Raise `OutsideError` when a process holds the lock of a state folder."""
    holder = lock_holder(folder)
    if holder is not None:
        raise _folder_in_use_error(folder, holder, _SERVICE)


def _take_lock(descriptor: int, folder: Path, remedy: str) -> None:
    for _ in range(_ATTEMPTS):
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            threading.Event().wait(_BETWEEN_S)
        else:
            return
    raise _folder_in_use_error(folder, _read_process_id(descriptor), remedy)


def _folder_in_use_error(folder: Path, holder: int, remedy: str) -> OutsideError:
    return OutsideError(f"folder {folder} is in use by process {holder}; {remedy}")


def _read_process_id(descriptor: int) -> int:
    text = os.pread(descriptor, 32, 0).strip()
    return int(text) if text.isdigit() else 0
