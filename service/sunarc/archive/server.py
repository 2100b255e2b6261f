"""PostgreSQL as the archive's store: connections, transactions, the data version and the partitions of sightings."""

from __future__ import annotations

import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from datetime import datetime

from sqlalchemy import URL, BigInteger, Connection, Engine, bindparam, create_engine, event, make_url, text
from sqlalchemy.exc import (
    ArgumentError,
    DBAPIError,
    IntegrityError,
    InterfaceError,
    InternalError,
    OperationalError,
    ProgrammingError,
)

from sunarc.archive.json_text import json_text, parsed_json
from sunarc.errors import InputError, OutsideError, StoreFullError
from sunarc.extras import extra_module
from sunarc.utc import to_microseconds

DRIVER = "postgresql+psycopg"
WRITES = "sunarc_writes"
"""Execution option of a transaction that writes."""
ONE_CAMERA = "sunarc_camera"
"""Execution option of a transaction that writes rows of one camera alone, with the camera's name."""
_ARCHIVE_LOCK = 0x73756E  # of this database; any number that no other application of it takes
_LOCK_TIMEOUT_MS = 30_000  # as long as SQLite waits
_DISK_FULL = "53100"
"""SQLSTATE (PostgreSQL, appendix A)."""
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
            problem="is no address of a PostgreSQL database",
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
        pool_pre_ping=True,  # after a failover every pooled connection is broken
        json_serializer=json_text,
        json_deserializer=parsed_json,
    )

    @event.listens_for(engine, "begin")
    def _begin(connection: Connection) -> None:
        options = connection.get_execution_options()
        if options.get(WRITES, False):
            connection.exec_driver_sql("SET TRANSACTION ISOLATION LEVEL READ COMMITTED")
            _lock(connection, options.get(ONE_CAMERA))

    return engine


def _lock(connection: Connection, camera: str | None) -> None:
    """Wait for the write lock: of all that is written, or of one camera's rows.

    SQLite has one writer at a time, and the archive's methods read under its lock what they write by. Feeds of
    different cameras write at the same time.
    """
    if camera is None:
        connection.exec_driver_sql("SELECT pg_advisory_xact_lock(%s)", (_ARCHIVE_LOCK,))
        return
    connection.exec_driver_sql(
        "SELECT pg_advisory_xact_lock_shared(%s), pg_advisory_xact_lock(%s, hashtext(%s))",
        (_ARCHIVE_LOCK, _ARCHIVE_LOCK, camera),
    )


@contextmanager
def server_errors(engine: Engine) -> Iterator[None]:
    """Raise PostgreSQL's errors as this package's, in one line with the remedy; the password is not in it."""
    where = name_of(engine.url)
    try:
        yield
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


def is_of_row(error: DBAPIError) -> bool:
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
    """Return the error of a row that contradicts another, with what the database says of it."""
    return InputError(
        field="archive",
        problem=f"a row contradicts another ({detail})",
        remedy="write the camera, its pose epoch and its calibration before what refers to them",
    )


def _first_line(error: DBAPIError) -> str:
    return str(error.orig).strip().partition("\n")[0]


class SnapshotVersion:
    """A connection of its own that tells whether anything was committed, by anyone, since it was last asked.

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
        """Return a number that is another one after any commit; one round trip to the server."""
        with self._lock, server_errors(self._engine):
            snapshot = self._current()
            if snapshot != self._snapshot:
                self._snapshot, self._count = snapshot, self._count + 1
            return self._count

    def _current(self) -> str:
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
            f"the database {name_of(connection.engine.url)} is a stand-by; name every server in `store`, "
            "with target_session_attrs=read-write"
        )


def name_of(url: URL) -> str:
    """Return the address of a database, without its password."""
    return url.render_as_string(hide_password=True)
