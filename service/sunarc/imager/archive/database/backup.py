"""Copies of the database: made while others use it, kept a few at a time, put back."""

from __future__ import annotations

import os
import re
import sqlite3
from contextlib import closing
from datetime import UTC, datetime
from pathlib import Path

from sunarc.common.errors import InputError, OutsideError, disk_errors
from sunarc.imager.archive.database.state_folder import PRIVATE

_NAME = re.compile(r"sunarc-\d{8}T\d{6}Z\.sqlite")
_ASIDE = re.compile(r"\.(before|at|found)-[\w.-]+")
_KEPT_ASIDE = 3
"""So many copies made before migrations and restores are kept; more would fill the disk over the years."""


def backup(path: Path, target: Path, *, replace: bool = False) -> Path:
    """Copy a database while others use it; `target` appears only when it is whole and on the disk.

    Parameters
    ----------
    path, target : of the database and its copy.
    replace : whether an existing copy gives way; otherwise it is refused.

    Raises
    ------
    InputError : `target` exists.
    OutsideError : the disk is full or cannot be written, or `path` is no database.
    """
    if target.exists() and not replace:
        raise InputError(field="target", problem=f"{target} exists", remedy="name a file that does not exist yet")
    partial = target.with_name(f"{target.name}.partial")
    try:
        partial.unlink(missing_ok=True)  # of a copy that a power cut ended
        os.close(os.open(partial, os.O_CREAT | os.O_EXCL | os.O_WRONLY, PRIVATE))  # SQLite does not say why it cannot
        with closing(sqlite3.connect(path)) as source, closing(sqlite3.connect(partial)) as copy:
            source.backup(copy)
            copy.execute("PRAGMA journal_mode=DELETE")  # a copy is one file
        partial.chmod(PRIVATE)
        # Renamed last: a copy that a power cut ended never has a name that a restore would take.
        partial.replace(target)
        keep_name(target.parent)
    except (sqlite3.Error, OSError) as error:
        raise OutsideError(
            f"cannot copy {path} to {target}: {error}; free some space, or name another place"
        ) from error
    return target


def remove_old_asides(path: Path) -> None:
    """Remove all but the newest copies that migrations and restores have left by a database."""
    beside = [file for file in path.parent.glob(f"{path.name}.*") if _ASIDE.fullmatch(file.name[len(path.name) :])]
    for old in sorted(beside, key=lambda file: file.stat().st_mtime)[:-_KEPT_ASIDE]:
        old.unlink(missing_ok=True)


def newest_sound_copy(folder: Path) -> Path | None:
    """Return the newest of a folder's dated copies that is a whole database; None without one."""
    if not folder.is_dir():
        return None
    for copy in sorted((file for file in folder.iterdir() if _NAME.fullmatch(file.name)), reverse=True):
        try:
            require_sound(copy)
        except InputError:
            continue
        return copy
    return None


def backup_into(path: Path, folder: Path, *, keep: int, now: datetime) -> Path:
    """Copy a database into a folder under the time's name, and remove all but the `keep` newest of such copies."""
    if keep < 1:
        raise InputError(field="--keep", problem="below 1", remedy="keep one copy or more")
    with disk_errors(folder):
        folder.mkdir(parents=True, exist_ok=True)
    copy = backup(path, folder / f"sunarc-{now.astimezone(UTC):%Y%m%dT%H%M%SZ}.sqlite", replace=True)
    for old in sorted(file for file in folder.iterdir() if _NAME.fullmatch(file.name))[:-keep]:
        old.unlink(missing_ok=True)
    return copy


def restore(path: Path, source: Path, *, now: datetime) -> Path | None:
    """Put a copy in a database's place, in one step.

    Returns
    -------
    Where the former database was put; None when there was none.

    Raises
    ------
    InputError : `source` is no sound database, or the database is in use.
    """
    require_sound(source)
    former = None
    if path.exists():
        former = _keep_former(path, keep_aside(path, "before-restore", now=now))
    # A write-ahead log belongs to one database: beside another it would be replayed into it.
    for leftover in ("-wal", "-shm"):
        path.with_name(path.name + leftover).unlink(missing_ok=True)
    backup(source, path, replace=True)
    remove_old_asides(path)
    return former


def _keep_former(path: Path, former: Path) -> Path:
    """Copy the former database aside; one that is damaged or empty is moved as it is."""
    if _is_database(path):
        _require_unused(path)
        try:
            return backup(path, former)
        except OutsideError:  # damaged, or no room for both
            pass
    path.replace(former)
    return former


def _is_database(path: Path) -> bool:
    with path.open("rb") as file:
        return file.read(16) == b"SQLite format 3\0"


def keep_aside(path: Path, why: str, *, now: datetime) -> Path:
    """Return the name that a former database is kept under, in the folder of the present one."""
    return path.with_name(f"{path.name}.{why}-{now.astimezone(UTC):%Y%m%dT%H%M%SZ}")


def require_sound(source: Path) -> None:
    """Raise `InputError` when a file is no whole database of this service."""
    if not source.is_file():
        raise InputError(field="source", problem=f"{source} is not there", remedy="name a copy of the database")
    try:
        source.open("rb").close()  # SQLite does not say why it cannot
        with closing(sqlite3.connect(f"file:{source}?mode=ro", uri=True)) as connection:
            (answer,) = connection.execute("PRAGMA integrity_check(1)").fetchone()
            revision = connection.execute("SELECT version_num FROM alembic_version").fetchone()
    except (sqlite3.Error, OSError) as error:
        answer, revision = str(error), None
    if answer != "ok" or revision is None:
        raise InputError(
            field="source", problem=f"{source} is not an intact archive ({answer})", remedy="restore another copy"
        )


def _require_unused(path: Path) -> None:
    """Refuse a database that another process has open, and leave nothing of it in a write-ahead log."""
    try:
        with closing(sqlite3.connect(path, timeout=1.0, isolation_level=None)) as connection:
            connection.execute("PRAGMA wal_checkpoint(TRUNCATE)")
        with closing(sqlite3.connect(path, timeout=1.0, isolation_level=None)) as connection:
            connection.execute("PRAGMA locking_mode=EXCLUSIVE")
            connection.execute("BEGIN EXCLUSIVE")  # in this mode, granted only to the one connection there is
            connection.execute("ROLLBACK")
    except sqlite3.DatabaseError as error:
        if "locked" not in str(error):
            return  # damaged: nobody can use it
        raise InputError(
            field="state", problem=f"{path} is in use ({error})", remedy="stop the service first: systemctl stop sunarc"
        ) from None


def keep_name(folder: Path) -> None:
    """Sync a folder's entries to the disk, so that a renamed file keeps its name after a power cut."""
    descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
