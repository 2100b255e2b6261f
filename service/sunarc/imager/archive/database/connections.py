"""Connections to the SQLite file or the PostgreSQL server: durable, with transactions that begin where we say."""

from __future__ import annotations

import json
import os
import select
import shutil
import sqlite3
import threading
import zlib
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from datetime import datetime
from pathlib import Path
from typing import Any
from urllib.parse import quote
from weakref import WeakKeyDictionary

from sqlalchemy import URL, BigInteger, Connection, Engine, bindparam, create_engine, event, make_url, text
from sqlalchemy.exc import (
    ArgumentError,
    DatabaseError,
    DBAPIError,
    IntegrityError,
    InterfaceError,
    InternalError,
    InvalidatePoolError,
    OperationalError,
    ProgrammingError,
)
from sqlalchemy.exc import TimeoutError as NoConnectionError

from sunarc.common.errors import ConfigurationError, InputError, OutsideError, StoreFullError
from sunarc.common.extras import extra_module
from sunarc.common.utc import to_microseconds

DELETED = "was deleted while it was in use"
REPLACED = "was replaced while it was in use"
EMPTIED = "was emptied while it was in use"
DAMAGED = "has a malformed page"


class DatabaseFile:
    """A database file, identified by device and inode from the moment it was opened.

    A file that is deleted or replaced stays open in the connections that there are; what they write would be lost
    with the process. A connection that is opened later would even make a new, empty file.

    Parameters
    ----------
    path : the file.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._identity: tuple[int, int] | None = None
        self._damaged = False

    def note_damage(self) -> None:
        """Take note that SQLite met a page that it cannot read: nothing is written until the file is put back."""
        self._damaged = True

    def remember(self) -> None:
        """Take the file that is there now for the one that is in use."""
        self._damaged = False
        found = self.path.stat()
        self._identity = (found.st_dev, found.st_ino)

    def problem(self) -> str | None:
        """Return the change of the file since it was opened; None when it is in place."""
        try:
            found = self.path.stat()
        except FileNotFoundError:
            return DELETED
        except OSError as error:
            return f"cannot be reached: {error.strerror}"
        if self._identity is not None and (found.st_dev, found.st_ino) != self._identity:
            return REPLACED
        if self._damaged:
            return DAMAGED
        return EMPTIED if found.st_size == 0 and self._identity is not None else None

    def require_in_place(self) -> None:
        """Raise `OutsideError` when the file is not the one that was opened."""
        problem = self.problem()
        if problem is not None:
            raise OutsideError(f"the database {self.path} {problem}; nothing is written until it is back")

    def connect(self, *, create: bool = False) -> sqlite3.Connection:
        """Open a connection; never to another file than the one in use, and to a new one only with `create`."""
        mode = "rwc" if create else "rw"
        connection = sqlite3.connect(f"file:{quote(str(self.path))}?mode={mode}", uri=True, check_same_thread=False)
        # Checked after opening: a file that was exchanged just before would else be taken for the one in use.
        problem = None if create else self.problem()
        if problem is not None:
            connection.close()
            raise sqlite3.OperationalError(f"the file {problem}")
        return connection


def json_text(value: object) -> str:
    """Return a value as the text that is stored of it."""
    return json.dumps(value)


def parsed_json(text: str | bytes) -> Any:  # noqa: ANN401 - whatever JSON holds
    """Return a stored value; None where it is no JSON any more."""
    try:
        return json.loads(text)
    except (ValueError, RecursionError):
        return None


DRIVER = "postgresql+psycopg"
WRITES = "sunarc_writes"
"""Execution option of a transaction that writes."""
ONE_CAMERA = "sunarc_camera"
"""Execution option of a transaction that writes rows of one camera alone, with the camera's name."""
_ARCHIVE_LOCK = 0x73756E  # of this database; any number that no other application of it takes
_LOCK_TIMEOUT_MS = 30_000  # as long as SQLite waits
_DISK_FULL = "53100"
"""SQLSTATE (PostgreSQL, appendix A)."""
_ROOM_BYTES = 1_000_000
"""A disk with less is full: SQLite asks for megabytes of temporary files at once."""
_OF_THE_SERVER = ("08", "25", "28", "3D", "40", "53", "55", "57", "58", "F0", "XX")
"""Classes of SQLSTATE that say nothing of the row: connection, state of the transaction, authorisation, serialization,
resources, locks, operators, system, configuration, and faults of PostgreSQL's own."""
_CONNECTION = {
    "connect_timeout": 10,
    # a server that vanished without closing its connections is noticed within a minute, not in two hours
    "keepalives_idle": 15,
    "keepalives_interval": 5,
    "keepalives_count": 3,
    "tcp_user_timeout": 30_000,
    # Reads are of one snapshot, as in SQLite; set here, it costs them no round trip. Not read only as well:
    # libpq would take every server for a stand-by (target_session_attrs).
    "options": f"-c lock_timeout={_LOCK_TIMEOUT_MS} -c timezone=UTC -c default_transaction_isolation=repeatable\\ read",
}


def server_url(store: str) -> URL:
    """Return the address of a PostgreSQL database, checked.

    Parameters
    ----------
    store : `postgresql+psycopg://[USER[:PASSWORD]@][HOST[:PORT]]/DATABASE[?…]`, with the parameters of libpq: several
        hosts with `target_session_attrs=read-write` name a server and its stand-bys.

    Raises
    ------
    InputError : it is no such address.
    """
    try:
        url = make_url(store)
    except ArgumentError:
        url = None
    if url is None or url.drivername not in {DRIVER, "postgresql"} or not url.database:
        raise InputError(
            field="store",
            problem="is not the address of a PostgreSQL database",
            remedy=f"give {DRIVER}://USER@HOST/DATABASE",
        )
    return url.set(drivername=DRIVER)


def create_server_engine(url: URL) -> Engine:
    """Return an engine on a PostgreSQL database; a connection that broke is replaced when it is next asked for."""
    extra_module("psycopg", extra="postgresql")
    engine = create_engine(
        url,
        connect_args=_CONNECTION,
        pool_size=8,
        max_overflow=32,
        pool_timeout=30.0,
        json_serializer=json_text,
        json_deserializer=parsed_json,
    )

    @event.listens_for(engine, "checkout")
    def _require_open(connection: Any, _record: object, _proxy: object) -> None:  # noqa: ANN401 - psycopg's
        # After a failover every pooled connection is closed, which the socket says without a round trip: nothing else
        # is to be read from a connection that is not in use.
        readable, _, _ = select.select([connection.fileno()], [], [], 0.0)
        if readable:
            raise InvalidatePoolError("the server closed it")

    @event.listens_for(engine, "begin")
    def _begin_transaction(connection: Connection) -> None:
        options = connection.get_execution_options()
        if options.get(WRITES, False):
            _lock(connection, options.get(ONE_CAMERA))

    return engine


def _lock(connection: Connection, camera: str | None) -> None:
    """Wait, in a transaction that writes, for the write lock: of all that is written, or of one camera's rows.

    SQLite has one writer at a time, and the archive's methods read under its lock what they write by. Feeds of
    different cameras write at the same time.
    """
    # REPEATABLE READ takes its snapshot before the lock is granted: what its last holder wrote would be missed
    level = "SET TRANSACTION ISOLATION LEVEL READ COMMITTED"
    if camera is None:
        connection.exec_driver_sql(f"{level}; SELECT pg_advisory_xact_lock({_ARCHIVE_LOCK})")
        return
    # in one round trip, which takes no parameters: the name's number is made here
    of_camera = zlib.crc32(camera.encode("utf-8", "replace")) - 2**31
    connection.exec_driver_sql(
        f"{level}; SELECT pg_advisory_xact_lock_shared({_ARCHIVE_LOCK}), "
        f"pg_advisory_xact_lock({_ARCHIVE_LOCK}, {of_camera})"
    )


@contextmanager
def server_errors(engine: Engine) -> Iterator[None]:
    """Raise PostgreSQL's errors as this package's, in one line with the remedy; the password is not in it."""
    where = public_address(engine.url)
    try:
        yield
    except NoConnectionError as error:
        raise OutsideError(f"cannot use the database {where}: every connection waits for it") from error
    except IntegrityError as error:
        raise contradiction(_first_line(error)) from error
    except (OperationalError, ProgrammingError, InternalError) as error:
        if _sqlstate(error) == _DISK_FULL:
            raise StoreFullError(f"the disk of the database {where} is full: {_first_line(error)}") from error
        remedy = "; ask as a role that may" if "permission denied" in str(error.orig) else ""
        raise OutsideError(f"cannot use the database {where}: {_first_line(error)}{remedy}") from error
    except DBAPIError as error:
        if error.connection_invalidated:
            raise OutsideError(f"cannot use the database {where}: {_first_line(error)}") from error
        raise InputError(
            field="archive", problem=f"a value cannot be stored ({_first_line(error)})", remedy="correct it"
        ) from error


def refuses_row_on_server(error: DBAPIError) -> bool:
    """Return whether PostgreSQL refused a row itself: privileges, constraints, data; else no row could be stored."""
    code = _sqlstate(error)
    if error.connection_invalidated or code is None:
        return not (
            error.connection_invalidated or isinstance(error, OperationalError | InterfaceError | InternalError)
        )
    return not code.startswith(_OF_THE_SERVER)


def _sqlstate(error: DBAPIError) -> str | None:
    """Return PostgreSQL's code of an error; None where psycopg itself found it."""
    code = getattr(error.orig, "sqlstate", None)
    return code if isinstance(code, str) else None


def contradiction(detail: str) -> InputError:
    """Return the error of a row that contradicts another, with the database's message."""
    return InputError(
        field="archive",
        problem=f"a row contradicts another ({detail})",
        remedy="write the camera, its pose epoch and its calibration before what refers to them",
    )


def _first_line(error: DBAPIError) -> str:
    return str(error.orig).strip().partition("\n")[0]


class SnapshotVersion:
    """Connection of its own that shows whether anyone has committed anything since it was last asked.

    Parameters
    ----------
    engine : of the database.
    """

    def __init__(self, engine: Engine) -> None:
        self._engine = engine.execution_options(isolation_level="AUTOCOMMIT")
        self._lock = threading.Lock()
        self._connection: Connection | None = None
        self._snapshot = ""
        self._count = 0

    def count(self) -> int:
        """Return a number that changes with every commit to the database; costs one round trip to the server."""
        with self._lock, server_errors(self._engine):
            snapshot = self._read_current_snapshot()
            if snapshot != self._snapshot:
                self._snapshot, self._count = snapshot, self._count + 1
            return self._count

    def _read_current_snapshot(self) -> str:
        # A snapshot is the set of transactions whose rows are visible: where two are equal, no commit lies between.
        try:
            if self._connection is None or self._connection.invalidated:
                self.close()
                self._connection = self._engine.connect()
            return str(self._connection.exec_driver_sql("SELECT pg_current_snapshot()::text").scalar())
        except DBAPIError:
            self.close()
            raise

    def close(self) -> None:
        """Close the connection; the next question opens another."""
        if self._connection is not None:
            self._connection.close()
        self._connection = None


class Months:
    """The monthly partitions of the sightings, made before the first sighting of a month is stored.

    Parameters
    ----------
    engine : of the database.
    """

    def __init__(self, engine: Engine) -> None:
        self._engine = engine
        self._present: set[tuple[int, int]] = set()

    def require(self, times: Sequence[datetime]) -> None:
        """Make the partitions that are missing for sightings of these times.

        In a transaction of its own, before the one that writes: a new partition locks the tables that it refers to,
        and a transaction that has written to one of them could wait for another that has, for ever.
        """
        missing = {(time.year, time.month): time for time in times if (time.year, time.month) not in self._present}
        if not missing:
            return
        make = text("SELECT sunarc_require_month(:time)").bindparams(bindparam("time", type_=BigInteger))
        with server_errors(self._engine), self._engine.execution_options(**{WRITES: True}).begin() as connection:
            for time in missing.values():
                connection.execute(make, {"time": to_microseconds(time)})
        self._present |= missing.keys()

    def forget(self) -> None:
        """Look again for the partitions that there are: some were dropped."""
        self._present.clear()


def require_writable(connection: Connection) -> None:
    """Raise `OutsideError` where the server is a stand-by, which only reads."""
    if connection.exec_driver_sql("SELECT pg_is_in_recovery()").scalar():
        raise OutsideError(
            f"the database {public_address(connection.engine.url)} is a stand-by; name every server in `store`, "
            "with target_session_attrs=read-write"
        )


def public_address(url: URL) -> str:
    """Return the address of a database, without its password and the name of the connections."""
    return url.difference_update_query(["application_name"]).render_as_string(hide_password=True)


_BUSY_TIMEOUT_MS = 30_000
_OF_THE_ROW = frozenset(
    {
        sqlite3.SQLITE_ERROR,
        sqlite3.SQLITE_TOOBIG,
        sqlite3.SQLITE_CONSTRAINT,
        sqlite3.SQLITE_MISMATCH,
        sqlite3.SQLITE_RANGE,
    }
)
"""Result codes of SQLite that say something of a row; the others are of the file, its disk and its locks."""
_FILES: WeakKeyDictionary[Engine, DatabaseFile] = WeakKeyDictionary()


def create_archive_engine(
    path: Path, *, foreign_keys: bool = True, create: bool = False, file: DatabaseFile | None = None
) -> Engine:
    """Return an engine on a database file; migrations alone switch the foreign keys off, and make the file."""
    opened = file or DatabaseFile(path)
    engine = create_engine(
        f"sqlite:///{path}",
        creator=lambda: opened.connect(create=create),
        pool_size=8,
        max_overflow=32,
        pool_timeout=30.0,
        json_serializer=json_text,
        json_deserializer=parsed_json,
    )

    _FILES[engine] = opened

    @event.listens_for(engine, "connect")
    def _prepare_connection(connection: sqlite3.Connection, _record: object) -> None:
        connection.isolation_level = None  # the driver begins nothing by itself
        connection.text_factory = _decode_text  # else one flipped bit makes every query that meets it fail
        connection.execute(f"PRAGMA busy_timeout={_BUSY_TIMEOUT_MS}")
        # WAL: readers never wait for a writer. FULL: each commit is on the disk before it is reported, since a field
        # computer loses power without notice.
        connection.execute("PRAGMA journal_mode=WAL")
        connection.execute("PRAGMA synchronous=FULL")
        connection.execute(f"PRAGMA foreign_keys={'ON' if foreign_keys else 'OFF'}")

    @event.listens_for(engine, "begin")
    def _begin_transaction(connection: Connection) -> None:
        writes = connection.get_execution_options().get(WRITES, False)
        # IMMEDIATE: a transaction that reads first and writes later could find another's commit between, and fail.
        connection.exec_driver_sql("BEGIN IMMEDIATE" if writes else "BEGIN")

    return engine


@contextmanager
def reading(engine: Engine) -> Iterator[Connection]:
    """Yield a connection that reads one snapshot of the database."""
    with outside_errors(engine), engine.connect() as connection:
        yield connection


@contextmanager
def writing(engine: Engine, *, camera: str | None = None) -> Iterator[Connection]:
    """Yield a connection that holds the database's write lock, and commit at the end.

    With `camera` only rows of that camera are written: PostgreSQL then lets other cameras' be written meanwhile.
    """
    options = {WRITES: True, ONE_CAMERA: camera}
    with outside_errors(engine), engine.execution_options(**options).begin() as connection:
        yield connection


@contextmanager
def outside_errors(engine: Engine) -> Iterator[None]:
    """Raise the database's errors as this package's, in one line with the remedy."""
    with server_errors(engine) if engine.dialect.name == "postgresql" else _file_errors(engine):
        yield


def refuses_row(connection: Connection, error: DBAPIError) -> bool:
    """Return whether the database refused a row itself; else no row could be stored: server, disk, locks."""
    if connection.dialect.name == "postgresql":
        return refuses_row_on_server(error)
    return _result_code(error) in _OF_THE_ROW


def _result_code(error: DBAPIError) -> int:
    """Return SQLite's primary result code; of an error of the driver, that of a row."""
    return getattr(error.orig, "sqlite_errorcode", sqlite3.SQLITE_ERROR) & 0xFF


@contextmanager
def _file_errors(engine: Engine) -> Iterator[None]:
    path = engine.url.database
    try:
        yield
    except IntegrityError as error:
        raise contradiction(str(error.orig)) from error
    except OperationalError as error:
        if _result_code(error) == sqlite3.SQLITE_FULL:
            raise StoreFullError(f"{_name_full_disk(Path(str(path)))} is full: {error.orig}") from error
        may = os.access(str(path), os.R_OK | os.W_OK, effective_ids=True) or not Path(str(path)).exists()
        remedy = "" if may else "; give the file to the service's user (chown), or ask as that user"
        raise OutsideError(f"cannot use the database {path}: {error.orig}{remedy}") from error
    except DatabaseError as error:
        if _result_code(error) == sqlite3.SQLITE_CORRUPT:
            _FILES[engine].note_damage()
            raise OutsideError(f"the database {path} {DAMAGED} ({error.orig}); it is put together anew") from error
        raise ConfigurationError(
            f"{path} is no sound SQLite database ({error.orig}); put the newest copy in its place: "
            f"sunarc db restore --latest --state {Path(str(path)).parent}"
        ) from error


def _name_full_disk(database: Path) -> str:
    """Return which disk SQLite found full, of the two that its one error may mean."""
    temporary = next((folder for folder in _temporary_folders() if os.access(folder, os.W_OK | os.X_OK)), None)
    if (
        temporary is None
        or _count_free_bytes(database.parent) < _ROOM_BYTES
        or _count_free_bytes(temporary) >= _ROOM_BYTES
    ):
        return f"the disk of the database {database}"
    return f"the disk of temporary files {temporary}, which the database {database} needs too,"


def _temporary_folders() -> Iterator[Path]:
    """Yield the folders where SQLite puts temporary files, the first one first (sqlite.org/tempfiles.html)."""
    named = (os.environ.get(name) for name in ("SQLITE_TMPDIR", "TMPDIR"))
    yield from (Path(folder) for folder in (*named, "/var/tmp", "/usr/tmp", "/tmp") if folder)  # noqa: S108


def _count_free_bytes(folder: Path) -> int:
    """Return the bytes that any user may still write into a folder; 0 where it cannot be asked."""
    try:
        return shutil.disk_usage(folder).free
    except OSError:
        return 0


def _decode_text(stored: bytes) -> str:
    return stored.decode("utf-8", "replace")
