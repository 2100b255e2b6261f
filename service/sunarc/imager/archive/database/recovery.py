"""Recovery of a lost or emptied database file, at the start and while it is in use."""

from __future__ import annotations

import sqlite3
import struct
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing, suppress
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Literal, NamedTuple

from sqlalchemy import URL

from sunarc.common.errors import InputError, OutsideError
from sunarc.imager.archive.database.backup import (
    backup,
    keep_aside,
    keep_name,
    newest_sound_copy,
    require_sound,
    restore,
)
from sunarc.imager.archive.database.connections import DAMAGED, EMPTIED
from sunarc.imager.archive.database.schema import upgrade
from sunarc.imager.archive.database.state_folder import PRIVATE
from sunarc.imager.archive.database.tables import metadata

# Rows of a SQLite table whose inner pages are broken, read from its leaf pages themselves.
#
# Reference: "Database File Format", https://www.sqlite.org/fileformat2.html, sections 1.3 to 2.1.

Value = int | float | str | bytes | None

_LEAF = 13  # of a table's b-tree
_FIRST_TRUNK = 32
_PAGE_SIZES = frozenset(1 << power for power in range(9, 17))
_PAGE_SIZE = 4096
"""SQLite's own, of which our databases are."""
_BYTES = (0, 1, 2, 3, 4, 6, 8, 8, 0, 0)
"""Of the serial types 0 to 9."""
_FITS: dict[str, tuple[type, ...]] = {"TEXT": (str,), "REAL": (int, float), "INTEGER": (int,), "BLOB": (bytes,)}


class Column(NamedTuple):
    """A column: its name, its declared type, whether it may not be NULL, and whether it is the row id."""

    name: str
    type: str
    required: bool
    is_rowid: bool


def leaf_rows(path: Path, columns: tuple[Column, ...]) -> Iterator[tuple[Value, ...]]:
    """Yield the rows of a database's leaf pages that have these columns; pages that cannot be read are left out.

    Parameters
    ----------
    path : the database, its write-ahead log copied into it.
    columns : of the table; rows of another number of columns or of other types are another table's.
    """
    data = path.read_bytes()
    size = int.from_bytes(data[16:18], "big")
    size = 65_536 if size == 1 else size
    if size not in _PAGE_SIZES:  # the header is damaged
        size = _PAGE_SIZE
    free = set(_list_free_pages(data, size))
    for number in range(2, len(data) // size + 1):
        page = data[(number - 1) * size : number * size]
        if number in free or page[0] != _LEAF:
            continue
        for cell in range(int.from_bytes(page[3:5], "big")):
            try:
                row = _parse_row(data, page, int.from_bytes(page[8 + 2 * cell : 10 + 2 * cell], "big"), columns, size)
            except (IndexError, struct.error, ValueError):
                continue
            if row is not None:
                yield row


def _list_free_pages(data: bytes, size: int) -> Iterator[int]:
    trunk = int.from_bytes(data[_FIRST_TRUNK : _FIRST_TRUNK + 4], "big")
    for _ in range(len(data) // size):  # a broken list may be a ring
        if not 0 < trunk <= len(data) // size:
            return
        yield trunk
        page = data[(trunk - 1) * size : trunk * size]
        count = min(int.from_bytes(page[4:8], "big"), size // 4 - 2)
        yield from struct.unpack_from(f">{count}I", page, 8)
        trunk = int.from_bytes(page[:4], "big")


def _parse_row(data: bytes, page: bytes, at: int, columns: tuple[Column, ...], size: int) -> tuple[Value, ...] | None:
    """Return the row of a cell; None where it is not of these columns."""
    length, at = _read_varint(page, at)
    rowid, at = _read_varint(page, at)
    record = _read_payload(data, page, at, length, size)
    header, place = _read_varint(record, 0)
    values: list[Value] = []
    offset = header
    while place < header:
        kind, place = _read_varint(record, place)
        count = _BYTES[kind] if kind < len(_BYTES) else (kind - 12) // 2
        values.append(_parse_value(kind, record[offset : offset + count], count))
        offset += count
    if len(values) != len(columns):
        return None
    row = tuple(rowid if column.is_rowid else value for column, value in zip(columns, values, strict=True))
    return row if all(map(_fits_column, row, columns)) else None


def _fits_column(value: Value, column: Column) -> bool:
    if value is None:
        return not column.required
    kinds = next((kinds for name, kinds in _FITS.items() if column.type.startswith(name)), None)
    return kinds is None or isinstance(value, kinds)


def _parse_value(kind: int, stored: bytes, count: int) -> Value:
    if len(stored) != count:
        raise ValueError("cut short")
    if kind == 0:
        return None
    if kind == 7:
        return float(struct.unpack(">d", stored)[0])
    if kind < 10:
        return kind - 8 if kind >= 8 else int.from_bytes(stored, "big", signed=True)
    return stored.decode("utf-8", "replace") if kind % 2 else stored


def _read_payload(data: bytes, page: bytes, at: int, length: int, size: int) -> bytes:
    """Return a cell's payload, with its part on overflow pages (section 1.6)."""
    most, least = size - 35, (size - 12) * 32 // 255 - 23
    if length <= most:
        return page[at : at + length]
    here = least + (length - least) % (size - 4)
    here = here if here <= most else least
    parts, left = [page[at : at + here]], length - here
    following = int.from_bytes(page[at + here : at + here + 4], "big")
    while left > 0 and 0 < following <= len(data) // size:
        overflow = data[(following - 1) * size : following * size]
        parts.append(overflow[4 : 4 + left])
        left -= len(parts[-1])
        following = int.from_bytes(overflow[:4], "big")
    return b"".join(parts)


def _read_varint(data: bytes, at: int) -> tuple[int, int]:
    """Return a variable-length integer and the place after it (section 1.6)."""
    value = 0
    for count in range(9):
        byte = data[at + count]
        if count == 8:
            value = value << 8 | byte
            break
        value = value << 7 | byte & 0x7F
        if byte < 0x80:
            break
    return value - (1 << 64) if value >= 1 << 63 else value, at + count + 1


Recovered = Literal["written_back", "restored", "new", "salvaged"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Recovery:
    """Recovery of a missing or damaged database.

    Attributes
    ----------
    kind : "written_back" (nothing is lost), "restored" (from a copy), "new" (empty), or "salvaged" (what was readable,
        and a copy for the rest).
    text : what happened and what was done, one sentence.
    """

    kind: Recovered
    text: str


def prepare_database(path: Path, *, backups: Path, images: Path, now: datetime) -> Recovery | None:
    """Make, restore or migrate the database before a start.

    A database that is missing or has 0 bytes is restored from the newest sound copy in `backups`, so that the service
    goes on with its calibration; without a copy it begins anew. An empty folder is a new installation, of which
    nothing is said.

    Returns
    -------
    What was done about a lost database; None when it was in place, or there never was one.
    """
    emptied = path.is_file() and path.stat().st_size == 0
    if path.exists() and not emptied:
        if _is_malformed(path):
            return _salvage_at_start(path, now=now)
        upgrade(path)
        return None
    copy = newest_sound_copy(backups)
    used_before = emptied or copy is not None or next(images.glob("[0-9]*/*/*/*"), None) is not None
    what = f"the database {path} {'had 0 bytes' if emptied else 'was missing'} at the start"
    if copy is not None:
        restore(path, copy, now=now)
        upgrade(path)
        return Recovery(kind="restored", text=f"{what}; it was restored from {copy}, what came after that is lost")
    if emptied:
        path.replace(keep_aside(path, "before-new", now=now))
    upgrade(path)
    return (
        Recovery(kind="new", text=f"{what}, and no copy is in {backups}; a new one was begun") if used_before else None
    )


def upgrade_present(store: Path | URL) -> Path | None:
    """Make or migrate a database as `upgrade` does, unless it was lost while copies of it lie in `backups`.

    A PostgreSQL database is left as it is: its owner alone may migrate it.

    Raises
    ------
    InputError : it is missing or has 0 bytes, and there is a sound copy.
    """
    if isinstance(store, URL):
        return None
    path = store
    lost = not path.exists() or path.stat().st_size == 0
    copy = newest_sound_copy(path.parent / "backups") if lost else None
    if copy is not None:
        raise InputError(
            field="state",
            problem=f"the database {path} is {'empty' if path.exists() else 'missing'}, and there is a copy: {copy}",
            remedy=f"run sunarc db restore --latest --state {path.parent}; to begin anew, move the copies away",
        )
    return upgrade(path)


def rebuild(
    path: Path, connection: sqlite3.Connection, *, problem: str, now: datetime, close: Callable[[], None]
) -> Recovery:
    """Put a database back that was deleted, replaced or emptied while it was in use.

    What an open connection still reads is written back; where that is no whole database, the newest sound copy of the
    folder `backups` is taken, or a new database begun. A file that was put in its place is kept aside.

    Parameters
    ----------
    path, connection : the database, and a connection from before.
    problem : what happened to it.
    now : names a file that is kept aside.
    close : closes all connections, this one too; called when nothing is read from them any more.

    Raises
    ------
    OutsideError : the disk refuses; the connections are still open.
    """
    partial = path.with_name(f"{path.name}.partial")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        if problem == DAMAGED:
            found = _salvage_rows(connection, path, partial)
        else:
            found = _copy_readable_rows(connection, partial, emptied=problem == EMPTIED) or _restart_from_copy(
                path, partial
            )
        upgrade(partial)  # in its place it would be a file of another revision that no open connection reads
        close()
        return _put_in_place(path, partial, found, problem=problem, now=now)
    except OSError as error:
        raise OutsideError(f"cannot write {path} back: {error.strerror}; free some space, or restart") from error


def _copy_readable_rows(connection: sqlite3.Connection, partial: Path, *, emptied: bool) -> Recovery | None:
    """Copy the rows that a connection still reads; None where they are no whole database."""
    done = Recovery(kind="written_back", text="written back from the open connection, nothing is lost")
    if _close_quietly(connection) and partial.exists():  # by an attempt that failed after it had copied
        return done
    partial.unlink(missing_ok=True)
    try:
        with closing(sqlite3.connect(partial)) as copy:
            connection.backup(copy)
            copy.execute("PRAGMA journal_mode=DELETE")
        require_sound(partial)
    except (sqlite3.Error, InputError) as error:
        partial.unlink(missing_ok=True)
        if emptied:
            return None
        raise OutsideError(f"cannot copy the open database to {partial}: {error}; free some space") from error
    return done


def _restart_from_copy(path: Path, partial: Path) -> Recovery:
    """Put the newest sound copy of the folder `backups` in place; without one, the database is created anew."""
    copy = newest_sound_copy(path.parent / "backups")
    if copy is None:
        return Recovery(kind="new", text="begun anew, for there was no copy")
    backup(copy, partial, replace=True)
    return Recovery(kind="restored", text=f"restored from {copy}, what came after that is lost")


def _is_malformed(path: Path) -> bool:
    """Return whether the structure of a database's pages is broken; damaged values in sound pages are not meant."""
    try:
        with closing(sqlite3.connect(f"file:{path}?mode=rw", uri=True)) as connection:
            lines = [str(row[0]) for row in connection.execute("PRAGMA quick_check(100)")]
    except sqlite3.DatabaseError as error:
        return getattr(error, "sqlite_errorcode", 0) & 0xFF == sqlite3.SQLITE_CORRUPT
    return any(line.startswith(("Tree", "*** in database")) or "btreeInitPage" in line for line in lines)


def _salvage_at_start(path: Path, *, now: datetime) -> Recovery:
    partial = path.with_name(f"{path.name}.partial")
    with closing(sqlite3.connect(path)) as connection:
        found = _salvage_rows(connection, path, partial)
    upgrade(partial)
    return _put_in_place(path, partial, found, problem=DAMAGED, now=now)


def _salvage_rows(connection: sqlite3.Connection, path: Path, partial: Path) -> Recovery:
    """Put a database together from the readable rows of a malformed one, and the newest sound copy for the rest."""
    partial.unlink(missing_ok=True)
    copy = newest_sound_copy(path.parent / "backups")
    if copy is not None:
        backup(copy, partial, replace=True)
    upgrade(partial)
    connection.text_factory = lambda stored: stored.decode("utf-8", "replace")
    with suppress(sqlite3.DatabaseError):
        connection.execute("PRAGMA wal_checkpoint(TRUNCATE)").fetchall()  # leaf pages are read from the file itself
    broken, kept = list[str](), 0
    with closing(sqlite3.connect(partial)) as target:
        for table in metadata.tables:
            columns = _read_columns(connection, table)
            whole, rows = _read_sound_rows(connection, table, columns)
            if not whole:
                broken.append(table)
                rows = [*leaf_rows(path, columns), *rows]
            elif columns:
                target.execute(f'DELETE FROM "{table}"')  # noqa: S608 - a name of the schema
            kept += _insert_rows(target, table, columns, rows)
        target.commit()
        target.execute("PRAGMA journal_mode=DELETE")
    rest = "there is no copy for the rest" if copy is None else f"the rest is from {copy}"
    damaged = ", ".join(broken) or "none"
    return Recovery(kind="salvaged", text=f"put together from {kept} readable rows; damaged tables: {damaged}; {rest}")


def _read_columns(connection: sqlite3.Connection, table: str) -> tuple[Column, ...]:
    """Return a table's columns; empty where the database does not have it."""
    try:
        found = connection.execute(f'PRAGMA table_info("{table}")').fetchall()
    except sqlite3.DatabaseError:
        return ()
    key = [row for row in found if row[5]]
    return tuple(
        Column(row[1], row[2].upper(), required=bool(row[3]), is_rowid=key == [row] and row[2].upper() == "INTEGER")
        for row in found
    )


def _read_sound_rows(
    connection: sqlite3.Connection, table: str, columns: tuple[Column, ...]
) -> tuple[bool, list[tuple[Value, ...]]]:
    """Return whether all of a table can be read, and its readable rows from either end."""
    if not columns:
        return True, []
    rows: dict[int, tuple[Value, ...]] = {}
    for order in ("ASC", "DESC"):
        with suppress(sqlite3.DatabaseError):
            query = f'SELECT rowid, * FROM "{table}" NOT INDEXED ORDER BY rowid {order}'  # noqa: S608 - as above
            for row in connection.execute(query):
                rows[row[0]] = row[1:]
            return order == "ASC", list(rows.values())
    return False, list(rows.values())


def _insert_rows(
    target: sqlite3.Connection, table: str, columns: tuple[Column, ...], rows: Sequence[tuple[Value, ...]]
) -> int:
    """Insert rows, in place of those with the same key; return how many were sound."""
    names = ", ".join(f'"{column.name}"' for column in columns)
    marks = ", ".join("?" * len(columns))
    inserted = 0
    for row in rows:
        with suppress(sqlite3.IntegrityError):
            target.execute(f'INSERT OR REPLACE INTO "{table}" ({names}) VALUES ({marks})', row)  # noqa: S608 - as above
            inserted += 1
    return inserted


def _close_quietly(connection: sqlite3.Connection) -> bool:
    try:
        connection.cursor()
    except sqlite3.ProgrammingError:
        return True
    return False


def _put_in_place(path: Path, partial: Path, found: Recovery, *, problem: str, now: datetime) -> Recovery:
    aside = ""
    if path.exists():
        former = path.replace(keep_aside(path, "found", now=now))
        aside = f"; what stood in its place is kept as {former.name}"
    for leftover in ("-wal", "-shm"):
        path.with_name(path.name + leftover).unlink(missing_ok=True)
    partial.chmod(PRIVATE)
    partial.replace(path)
    keep_name(path.parent)
    return Recovery(kind=found.kind, text=f"the database {path} {problem}; it was {found.text}{aside}")
