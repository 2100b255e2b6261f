"""The hub's store: rows of imagers, each stored once; its cameras, their tokens, and the quarantine."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Mapping, Sequence
from contextlib import nullcontext
from dataclasses import KW_ONLY, dataclass, replace
from datetime import date, datetime, timedelta
from itertools import groupby
from pathlib import Path
from typing import Annotated, Any

from sqlalchemy import (
    URL,
    ColumnElement,
    Connection,
    Table,
    bindparam,
    case,
    delete,
    exists,
    func,
    insert,
    literal,
    or_,
    select,
    text,
    update,
)
from sqlalchemy.exc import DataError, DBAPIError, IntegrityError, StatementError

from sunarc.common.errors import InputError, NotFoundError, OutsideError
from sunarc.common.utc import from_microseconds, utc_time
from sunarc.hub.feed_schema import FUTURE, LATEST_US, find_problem, refuse_row, typed
from sunarc.imager.archive.database.connections import json_text, refuses_row
from sunarc.imager.archive.database.store import Database, Part, given, upsert, upsert_all, upsert_records
from sunarc.imager.archive.database.tables import (
    calibration,
    camera,
    event,
    feed,
    feed_token,
    fleet,
    night,
    pose_epoch,
    quarantine,
)
from sunarc.imager.archive.day_digests import DayDigests, day_digests
from sunarc.imager.archive.days import event_night, night_columns
from sunarc.imager.archive.feed_rows import (
    FED,
    REMOVED,
    SINCE,
    STATUS,
    FeedBatch,
    FeedRow,
    FleetCamera,
    Quarantined,
    Refusal,
    is_deep,
)
from sunarc.imager.runtime.json_fields import EXAMPLE_TIME, Returned, Time, described

_OF_ONE_CAMERA = frozenset({"pose_epoch", "calibration", "refit"})
"""Tables whose key is an id: a row of another camera must not be written over, nor removed."""
_REFERENCES: Mapping[str, Mapping[str, Table]] = {
    "sun_point": {"pose_epoch": pose_epoch},
    "calibration": {"pose_epoch": pose_epoch, "parent": calibration},
    "refit": {"calibration": calibration},
}
"""Columns that name a row by its id: it must be one of the same camera."""
_MOST_UNKNOWN, _MOST_KEPT, _MOST_OWN = 100, 100, 100_000
_LONGEST_DATA, _LONGEST_TEXT = 10_000, 500
_NOT_ALLOWED = "permission denied"  # of a table: it is so for every row
_LACKING = """
SELECT name FROM unnest(CAST(:tables AS text[])) name WHERE NOT coalesce(
    has_table_privilege(to_regclass(name), 'INSERT') AND has_table_privilege(to_regclass(name), 'UPDATE')
    AND has_table_privilege(to_regclass(name), 'SELECT'), false)
UNION ALL SELECT 'new months' WHERE NOT has_function_privilege('sunarc_require_month(bigint)', 'EXECUTE')
"""
_LOCK_WITHIN_MS = 2000
KEPT = timedelta(days=90)
"""Time after which a refused row that did not come again leaves the quarantine."""
_OTHERS = "(others)"
"""Stands for cameras that nobody registered, beyond the first so many: names cost a stranger nothing."""
_NAME = re.compile(r"(?! )[^/]{1,100}(?<! )")
"""Of a camera: it is a part of addresses."""
WHOLE = 0
"""The `seq` of a batch that was refused as a whole."""


Tokens = Mapping[str, Sequence[tuple[str, datetime | None]]]
"""Digests by camera, each with when it ends."""


_HUB = re.compile(r"sunarc hub (\S+) (\S+) (\d{10})")
"""Name of a hub's connections: its host and port, version and start; PostgreSQL keeps 63 characters."""


@dataclass(frozen=True, slots=True, kw_only=True)
class HubRun(Returned):
    """A process of a hub that has the database open."""

    address: Annotated[str, described("Its host and port.", "fleet:8080")]
    version: Annotated[str, described("The software's version.", "0.4.0")]
    started_at: Annotated[Time, described("When it started.", EXAMPLE_TIME)]

    def store(self, store: Path | URL) -> Path | URL:
        """Return the address of a database whose connections will name this process; a file's is as it was."""
        if isinstance(store, Path):
            return store
        host, _, port = self.address.rpartition(":")
        name = f"sunarc hub {host[:20]}:{port} {self.version[:14]} {self.started_at.timestamp():.0f}"
        return store.update_query_dict({"application_name": name})


class _RowError(Exception):
    """The database refuses a row."""


class FeedStore(Part):
    """Rows that imagers send to a hub, their cameras, and the quarantine."""

    def __init__(self, database: Database) -> None:
        super().__init__(database)
        self._failing: dict[str, int] = {}
        self._own: set[tuple[str, str, str]] = set()

    def take(self, batch: FeedBatch, *, now: datetime) -> int | Refusal:
        """Store a batch, and return the number up to which the hub has this imager's rows.

        Rows and number are written in one transaction: a batch that comes twice is stored once. A batch that does not
        begin where the hub stands is left alone; the number that is returned says where to go on.

        Parameters
        ----------
        batch : of one camera.
        now : real time.

        Returns
        -------
        The number; or why the batch was refused as a whole, which is also in quarantine.
        """
        dated = [time for time in map(_sighting_time, batch.rows) if time is not None]
        self._database.prepare_months([time for time in dated if time <= now + FUTURE])
        try:
            taken = self._store_batch(batch, now, one_by_one=False)
        except _RowError:
            taken = self._store_batch(batch, now, one_by_one=True)
        return taken

    def _store_batch(self, batch: FeedBatch, now: datetime, *, one_by_one: bool) -> int | Refusal:
        """Store a batch whose rows the database takes, in few round trips; else row by row, to leave some out.

        Raises
        ------
        _RowError : the database refuses a row; nothing is stored, and it is to be done again `one_by_one`.
        """
        with self._database.writing(camera=batch.camera) as connection:
            if not _advance_committed(connection, batch, now):
                position = _get_committed(connection, batch, now)
                if isinstance(position, int) and batch.after > position:
                    text = f"rows after {batch.after} came, rows after {position} were expected; all are sent again"
                    self._record_failure(connection, batch, Refusal(reason="gap", text=text), now)
                if isinstance(position, Refusal):
                    self._record_failure(connection, batch, position, now)
                if batch.after != position or not _advance_committed(connection, batch, now):
                    return position
            storing = _Storing(connection, batch, self._own, one_by_one=one_by_one)
            n_stored = storing.store(now)
            _write_quarantine(connection, batch, storing.apart, now=now)
            _note_in_fleet(connection, batch, now)
        if n_stored:
            self._failing.pop(batch.camera, None)
        elif storing.apart:
            self._failing[batch.camera] = self.n_failing(batch.camera) + 1
        return batch.rows[-1].seq if batch.rows else batch.after

    def _record_failure(self, connection: Connection, batch: FeedBatch, refusal: Refusal, now: datetime) -> None:
        self._failing[batch.camera] = self.n_failing(batch.camera) + 1
        _write_quarantine(connection, batch, [(None, refusal)], now=now)

    def n_failing(self, camera: str) -> int:
        """Return how many batches of a camera came in succession of which no row could be stored."""
        return self._failing.get(camera, 0)

    def digests(self, camera: str, installation: str, *, since: date, until: date) -> DayDigests | None:
        """Return the digests of a camera's days; None where the installation is not the one that is taken."""
        c = feed.c
        accepted = select(c.accepted).where(c.camera == camera, c.installation == installation)
        with self._database.reading() as connection:
            if not connection.scalar(accepted):
                return None
            return day_digests(connection, camera, since=since, until=until)

    def refuse(self, *, camera: str, installation: str, refusal: Refusal, now: datetime) -> None:
        """Write into quarantine that something was refused as a whole."""
        batch = FeedBatch(camera=camera, installation=installation, after=0, rows=())
        with self._database.writing(camera=camera) as connection:
            if refusal.reason == "unknown_camera":
                batch = replace(batch, camera=_bound_camera_name(connection, camera), installation="")
            if refusal.reason in {"unknown_camera", "forged_token", "body_too_large"}:
                _write_quarantine(connection, batch, [(None, refusal)], now=now)
            else:
                self._record_failure(connection, batch, refusal, now)

    def expire(self, *, now: datetime) -> int:
        """Remove from quarantine rows that did not come again for 90 days, and closed gaps; return how many."""
        with self._database.writing() as connection:
            old = or_(quarantine.c.last_at < now - KEPT, ~_open_condition())
            return connection.execute(delete(quarantine).where(old)).rowcount

    def require_storing(self) -> None:
        """Check that this role can store rows of every kind; on SQLite every user of the file may.

        Raises
        ------
        OutsideError : it may not; each table is named. Or another holds one of them locked for more than 2 s.
        """
        with self._database.reading() as connection:
            if connection.dialect.name != "postgresql":
                return
            tables = sorted({table.name for table, _ in FED.values()} | {feed.name, fleet.name, quarantine.name})
            lacking = connection.execute(text(_LACKING), {"tables": tables}).scalars().all()
        if lacking:
            raise OutsideError(
                f"rows of {', '.join(lacking)} cannot be stored: the role may not insert and update them; "
                "as their owner run deploy/hub/grants.sql"
            )
        with self._database.writing(camera="") as connection:
            connection.execute(text(f"SET LOCAL lock_timeout = {_LOCK_WITHIN_MS}"))
            connection.execute(text(f"LOCK TABLE {', '.join(tables)} IN ROW EXCLUSIVE MODE"))  # as an insert does

    def quarantine(self, camera: str | None = None, *, limit: int | None = None) -> tuple[Quarantined, ...]:
        """Return the rows that were refused or set apart, the newest first."""
        c = quarantine.c
        statement = select(quarantine).where(_open_condition(), *given((c.camera.__eq__, camera)))
        return self._database.records(statement.order_by(c.last_at.desc(), c.camera, c.seq).limit(limit), Quarantined)

    def hubs(self) -> tuple[HubRun, ...]:
        """Return the hubs that have the database open, the oldest first; of a file none is known."""
        names = text(
            "SELECT DISTINCT application_name FROM pg_stat_activity WHERE datname = current_database() "
            "AND application_name LIKE 'sunarc hub %'"
        )
        with self._database.reading() as connection:
            if connection.dialect.name != "postgresql":
                return ()
            found = [_HUB.fullmatch(name) for name in connection.execute(names).scalars()]
        hubs = [
            HubRun(address=one[1], version=one[2], started_at=utc_time(float(one[3])))
            for one in found
            if one is not None
        ]
        return tuple(sorted(hubs, key=lambda hub: (hub.started_at, hub.address)))

    def fleet(self) -> tuple[FleetCamera, ...]:
        """Return every camera that was registered or fed, with how many things of it are in quarantine."""
        counted = select(quarantine.c.camera, func.count().label("n")).where(_open_condition())
        apart = counted.group_by(quarantine.c.camera).subquery()
        known = select(feed_token.c.camera).union(select(fleet.c.camera)).subquery()
        f = fleet.c
        columns = [column for column in f if column.name != "camera"]
        site = (camera.c.latitude, camera.c.longitude, camera.c.altitude)
        statement = (
            select(known.c.camera, *columns, *site, func.coalesce(apart.c.n, 0).label("n_quarantined"))
            .select_from(known)
            .outerjoin(fleet, f.camera == known.c.camera)
            .outerjoin(camera, camera.c.name == known.c.camera)
            .outerjoin(apart, apart.c.camera == known.c.camera)
            .order_by(known.c.camera)
        )
        with self._database.reading() as connection:
            rows = connection.execute(statement).mappings().all()
        return tuple(FleetCamera(**{**row, "status": _valid_status(row["status"])}) for row in rows)

    def add_token(self, camera: str, digest: str, *, now: datetime, former_until: datetime) -> None:
        """Register a camera by the digest of its token; tokens that it has end at `former_until`.

        Raises
        ------
        InputError : no address of the hub could have that name.
        """
        if not _NAME.fullmatch(camera) or not camera.isprintable() or camera in {".", "..", _OTHERS}:
            raise InputError(
                field="camera",
                problem=f"{camera[:100]!r} cannot be a camera's name",
                remedy="use 1 to 100 printable characters, no slash, and no space at either end",
            )
        c = feed_token.c
        former = update(feed_token).where(c.camera == camera, or_(c.expires_at.is_(None), c.expires_at > former_until))
        with self._database.writing() as connection:
            connection.execute(former.values(expires_at=former_until))
            connection.execute(insert(feed_token).values(digest=digest, camera=camera, created_at=now))
            connection.execute(
                delete(quarantine).where(quarantine.c.camera == camera, quarantine.c.reason == "unknown_camera")
            )

    def end_tokens(self, camera: str, *, now: datetime) -> int:
        """End all tokens of a camera, and return how many there were."""
        c = feed_token.c
        valid = update(feed_token).where(c.camera == camera, or_(c.expires_at.is_(None), c.expires_at > now))
        with self._database.writing() as connection:
            return connection.execute(valid.values(expires_at=now)).rowcount

    def tokens(self, camera: str, *, now: datetime) -> tuple[str, ...] | None:
        """Return the digests of a camera's valid tokens; None where the camera was never registered."""
        c = feed_token.c
        with self._database.reading() as connection:
            rows = connection.execute(select(c.digest, c.expires_at).where(c.camera == camera)).all()
        valid = tuple(row.digest for row in rows if row.expires_at is None or row.expires_at > now)
        return valid if rows else None

    def all_tokens(self) -> Tokens:
        """Return the digests of all cameras' tokens, each with when it ends; None: it does not."""
        c = feed_token.c
        found: dict[str, list[tuple[str, datetime | None]]] = {}
        with self._database.reading() as connection:
            for row in connection.execute(select(c.camera, c.digest, c.expires_at)):
                found.setdefault(row.camera, []).append((row.digest, row.expires_at))
        return found

    def accept_installation(self, camera: str, installation: str, *, now: datetime) -> None:
        """Take the rows of an installation from now on, in place of the one that was taken before."""
        c = feed.c
        with self._database.writing() as connection:
            connection.execute(update(feed).where(c.camera == camera).values(accepted=False))
            row = {"camera": camera, "installation": installation, "committed": 0, "accepted": True}
            upsert(connection, feed, {**row, "first_at": now, "last_at": now}, key=["camera", "installation"])
            q = quarantine.c
            here = (q.camera == camera, q.installation == installation, q.reason == "second_installation")
            connection.execute(delete(quarantine).where(*here))

    def ask_again(self, camera: str) -> None:
        """Have all rows of a camera sent again, and clear its quarantine."""
        with self._database.writing() as connection:
            done = connection.execute(update(feed).where(feed.c.camera == camera).values(committed=-1))
            connection.execute(delete(quarantine).where(quarantine.c.camera == camera))
        if not done.rowcount:
            raise NotFoundError(field="camera", problem=f"camera {camera} sent nothing yet", remedy="see /v1/fleet")


def _bound_camera_name(connection: Connection, name: str) -> str:
    """Return a name under which rows of an unregistered camera are counted."""
    q = quarantine.c
    known = connection.scalars(select(q.camera).where(q.reason == "unknown_camera")).all()
    return name if name in known or len(known) < _MOST_UNKNOWN else _OTHERS


def _get_committed(connection: Connection, batch: FeedBatch, now: datetime) -> int | Refusal:
    """Return up to which number the hub has an installation's rows; a camera's first installation is taken."""
    rows = {row.installation: row for row in connection.execute(select(feed).where(feed.c.camera == batch.camera))}
    found = rows.get(batch.installation)
    if found is None and any(row.accepted for row in rows.values()):
        other = next(row for row in rows.values() if row.accepted)
        text = f"installation {batch.installation} sends as {batch.camera}, which installation {other.installation} is"
        return Refusal(reason="second_installation", text=text)
    if found is None:
        row = {"camera": batch.camera, "installation": batch.installation, "committed": 0, "accepted": True}
        connection.execute(insert(feed).values(**row, first_at=now, last_at=now))
        return 0
    if not found.accepted:
        return Refusal(reason="second_installation", text=f"installation {batch.installation} was replaced by another")
    return int(found.committed)


def _advance_committed(connection: Connection, batch: FeedBatch, now: datetime) -> bool:
    """Move the number of an installation that is accepted from where the batch begins to where it ends."""
    committed = batch.rows[-1].seq if batch.rows else batch.after
    values = {
        "of": batch.camera,
        "by": batch.installation,
        "after": batch.after,
        "committed": committed,
        "last_at": now,
    }
    return connection.execute(_MOVE_ON, values).rowcount == 1


_MOVE_ON = update(feed).where(
    feed.c.camera == bindparam("of"),
    feed.c.installation == bindparam("by"),
    feed.c.accepted,
    feed.c.committed == bindparam("after"),
)
"""Made once: a small PUT is few statements."""


def _open_condition() -> ColumnElement[bool]:
    """Return the SQL condition of rows in quarantine without the gaps that later rows have closed."""
    q = quarantine.c
    after = (feed.c.camera == q.camera, feed.c.installation == q.installation, feed.c.last_at > q.last_at)
    return or_(q.reason != "gap", ~exists().where(*after))


def _sighting_time(row: FeedRow) -> datetime | None:
    """Return the time of a sighting; None of another row, and of one without a time in its place."""
    time = row.data.get("time") if row.kind == "sun_point" and row.data is not None else None
    return from_microseconds(time) if type(time) is int and 0 <= time < LATEST_US else None


def _valid_status(status: object) -> dict[str, Any] | None:
    """Return a stored status; None of one that would not be stored today: it would take every camera off the page."""
    if not isinstance(status, dict) or is_deep(status) or find_problem(STATUS, status) is not None:
        return None
    return status


@dataclass(eq=False)
class _Storing:
    """Storage of a batch's rows in order; rows that cannot be stored are set apart.

    Parameters
    ----------
    connection, batch : where to, and what.
    own : (table, camera, id) of rows that were found to be the camera's; more are added.
    one_by_one : whether to look for the rows that the database refuses; `_RowError` else.
    """

    connection: Connection
    batch: FeedBatch
    own: set[tuple[str, str, str]]
    _: KW_ONLY
    one_by_one: bool

    def __post_init__(self) -> None:
        """Begin with nothing set apart."""
        self.apart: list[tuple[FeedRow | None, Refusal]] = []
        if self.one_by_one or len(self.own) > _MOST_OWN:
            self.own.clear()

    def store(self, now: datetime) -> int:
        """Store all rows, and return how many were stored; a status does not count."""
        n_stored = 0
        for kind, group in groupby(self.batch.rows, key=lambda row: row.kind):
            sound = []
            for row in group:
                taken, refusal = self._judge_row(row, now)
                if refusal is None:
                    sound.append(taken)
                else:
                    self.apart.append((row, refusal))
            if kind != STATUS and sound:
                n_stored += self._store_kind(kind, self._select_valid_references(kind, sound))
        return n_stored

    def _judge_row(self, row: FeedRow, now: datetime) -> tuple[FeedRow, Refusal | None]:
        """Return a row as it is stored, and why it is not.

        A document that was damaged on the imager is that of the hub, of the same id and checksum: the other columns are
        taken, and both sides agree.
        """
        refusal = refuse_row(self.batch.camera, row, now)
        if refusal is None or row.kind != "calibration" or find_problem(row.kind, {**(row.data or {}), "document": {}}):
            return row, refusal
        whole = {**(row.data or {})}
        same = (calibration.c[name] == whole[name] for name in ("camera", "id", "document_sha256"))
        whole["document"] = self.connection.scalar(select(calibration.c.document).where(*same))
        if whole["document"] is None or whole["camera"] != self.batch.camera:
            return row, refusal
        row = replace(row, data=whole)
        return row, refuse_row(self.batch.camera, row, now)

    def _select_valid_references(self, kind: str, rows: list[FeedRow]) -> list[FeedRow]:
        """Return the rows that refer to rows of the same camera; set the others apart."""
        for column, table in _REFERENCES.get(kind, {}).items():
            known: set[object] = {
                None,
                *self._read_own_ids(table, {(row.data or {}).get(column) for row in rows} - {None}),
            }
            left = []
            for row in rows:
                data = row.data or {}
                if data.get(column) in known:
                    left.append(row)
                    known |= {data["id"]} if table is FED[kind][0] else set()
                else:
                    text = f"{column} {data[column]} is not there, or is another camera's"
                    self.apart.append((row, Refusal(reason="contradiction", text=text)))
            rows = left
        return rows

    def _read_own_ids(self, table: Table, named: set[Any]) -> set[object]:
        camera = self.batch.camera
        unknown = {one for one in named if (table.name, camera, one) not in self.own}
        if unknown:
            mine = select(table.c.id).where(table.c.id.in_(unknown), table.c.camera == camera)
            self.own |= {(table.name, camera, one) for one in self.connection.scalars(mine)}
        return {one for one in named if (table.name, camera, one) in self.own}

    def _store_kind(self, kind: str, rows: Sequence[FeedRow]) -> int:
        """Store rows of one kind, one half after the other where the database refuses one; return how many."""
        refusal = self._try_to_store(kind, rows) if rows else None
        if refusal is None:
            return len(rows)
        if len(rows) == 1 or _NOT_ALLOWED in refusal.text:
            self.apart += [(row, refusal) for row in rows]
            return 0
        middle = len(rows) // 2
        return self._store_kind(kind, rows[:middle]) + self._store_kind(kind, rows[middle:])

    def _try_to_store(self, kind: str, rows: Sequence[FeedRow]) -> Refusal | None:
        """Store rows or none of them, and return why not; an error that is of no row (server, disk) is raised."""
        try:
            with self.connection.begin_nested() if self.one_by_one else nullcontext():
                _apply_rows(self.connection, self.batch.camera, kind, rows)
        except StatementError as error:
            not_allowed = _NOT_ALLOWED in str(error) and not kind.endswith(REMOVED)  # no hub may remove some rows
            if isinstance(error, DBAPIError) and (not_allowed or not refuses_row(self.connection, error)):
                raise
            if not self.one_by_one:
                raise _RowError from error
            text = str(error.orig).strip().partition("\n")[0]
            contradicts = isinstance(error, IntegrityError | DataError)
            return Refusal(reason="contradiction" if contradicts else "refused_by_database", text=text)
        return None


def _another_camera_error(what: str) -> IntegrityError:
    return IntegrityError(None, None, ValueError(f"{what} is another camera's"))


def _apply_rows(connection: Connection, camera_name: str, kind: str, rows: Sequence[FeedRow]) -> None:
    """Insert, update or remove a camera's rows of one kind, as its feed states."""
    if kind.endswith(REMOVED):
        _remove_rows(connection, camera_name, kind.removesuffix(REMOVED), rows)
        return
    table, key = FED[kind]
    if kind == "sun_point" and connection.dialect.name == "postgresql":
        for columns, alike in groupby((row.data or {} for row in rows), key=tuple):
            upsert_records(connection, table, list(alike), columns=columns, key=key)
        return
    values_of_rows = [typed(kind, row.data or {}) for row in rows]
    if kind == "event":
        _write_events(connection, camera_name, values_of_rows)
    elif kind in _OF_ONE_CAMERA:
        for values in values_of_rows:
            if kind == "calibration" and values["state"] == "current":
                _retire_current(connection, values)
            if not upsert(connection, table, values, key=key, of="camera"):
                raise _another_camera_error(f"{kind} {values['id']}")
    else:
        for _, alike in groupby(values_of_rows, key=lambda values: values.keys()):
            upsert_all(connection, table, list(alike), key=key)


def _remove_rows(connection: Connection, camera_name: str, kind: str, rows: Sequence[FeedRow]) -> None:
    """Remove rows of a camera; one that is not there is nothing to do."""
    table, key = FED[kind]
    owner = table.c["name" if kind == "camera" else "camera"]
    for row in rows:
        empty = {name: "" for of, name in SINCE if of == kind}
        values = empty | typed(kind, row.data or {}) | {owner.name: camera_name}
        this = [table.c[name] == values[name] for name in key]
        found = connection.scalar(select(owner).where(*this).limit(1))
        if found not in {None, camera_name}:
            raise _another_camera_error(f"{kind} {values['id']}")
        if found is not None:
            connection.execute(delete(table).where(*this, owner == camera_name))


def _retire_current(connection: Connection, values: Mapping[str, Any]) -> None:
    """Retire the current calibration: rows that are sent again come in another order than that of the changes."""
    c = calibration.c
    others = (c.camera == values["camera"], c.id != values["id"], c.state == "current")
    connection.execute(update(calibration).where(*others).values(state="retired"))


def _write_events(connection: Connection, camera_name: str, rows: Sequence[dict[str, Any]]) -> None:
    """Write new events; an event of all of an imager is at the hub one of its camera."""
    c = event.c
    for row in rows:
        values = {**row, "camera": row.get("camera") or camera_name}
        same = [event.c[name] == values[name] for name in ("camera", "time", "kind", "text")]
        if connection.scalar(select(c.id).where(*same).limit(1)) is None:
            connection.execute(insert(event).values(values))
            of_night = values["kind"] == "night"
            found = event_night(values["camera"], values["time"], values["details"]) if of_night else None
            if found is not None:
                upsert(connection, night, night_columns(found), key=["camera", "date"])


def _write_quarantine(
    connection: Connection, batch: FeedBatch, apart: Sequence[tuple[FeedRow | None, Refusal]], *, now: datetime
) -> None:
    """Write into quarantine, once a row, and once an installation for a batch refused as a whole (no row); count.

    Of a camera and a reason the first hundred are kept, and what follows is counted in one row.
    """
    if not apart:
        return
    q, columns = quarantine.c, ("camera", "installation", "reason", "seq")
    found = connection.execute(select(q.installation, q.reason, q.seq).where(q.camera == batch.camera))
    present = {(one.installation, one.reason, one.seq) for one in found}
    n_kept = Counter(reason for _, reason, _ in present)
    written: dict[tuple[str, str, int], dict[str, Any]] = {}
    for one, refusal in apart:
        row, reason = one, refusal.reason
        key = (batch.installation, reason, WHOLE if row is None else row.seq)
        if key not in present and key not in written:
            n_kept[reason] += 1
            if n_kept[reason] > _MOST_KEPT:
                row, key = None, ("", reason, WHOLE)
        data = "" if row is None else json_text(row.data)
        written[key] = {
            **dict(zip(columns, (batch.camera, *key), strict=True)),
            "kind": "" if row is None else _storable_text(row.kind),
            "text": _storable_text(refusal.text),
            "data": data if len(data) <= _LONGEST_DATA else "",
            "n": written[key]["n"] + 1 if key in written else 1,
            "first_at": now,
            "last_at": now,
        }
    upsert_all(
        connection, quarantine, [*written.values()], key=columns, kept=("first_at", "kind", "data"), added=("n",)
    )


def _storable_text(text: str) -> str:
    """Return a text as both engines store it: without NUL and halves of characters."""
    return text[:_LONGEST_TEXT].replace("\0", "?").encode("utf-8", "replace").decode()


def _note_in_fleet(connection: Connection, batch: FeedBatch, now: datetime) -> None:
    """Keep the fleet page's row of a camera, so that the page reads one row of each."""
    changed: dict[str, Any] = {"received_at": now}
    for row in batch.rows:
        if row.kind == STATUS and row.data is not None and find_problem(STATUS, row.data) is None:
            changed |= {"status": dict(row.data), "status_at": now}
    times = [time for time in map(_sighting_time, batch.rows) if time is not None and time <= now + FUTURE]
    if any(row.kind.removesuffix(REMOVED) == "calibration" for row in batch.rows):
        changed |= _read_served(connection, batch.camera)
    new = {"camera": batch.camera, "status": {}, **changed}
    if times:
        new["last_sighting_at"], newest = max(times), fleet.c.last_sighting_at
        latest = literal(max(times), newest.type)
        changed["last_sighting_at"] = case((newest > latest, newest), else_=latest)
    upsert(connection, fleet, new, key=["camera"], changed=changed)


def _read_served(connection: Connection, camera_name: str) -> dict[str, Any]:
    c = calibration.c
    current = select(c.id, c.created_at, c.document).where(c.camera == camera_name, c.state == "current")
    row = connection.execute(current).one_or_none()
    if row is None:
        return {"calibration": None, "calibrated_at": None, "sky_rms_deg": None}
    return {"calibration": row.id, "calibrated_at": row.created_at, "sky_rms_deg": stated_sky_rms(row.document)}


def stated_sky_rms(document: object) -> float | None:
    """Return the 1-sigma over the sky (RMS, degrees) that a stored calibration document states."""
    stated = document.get("uncertainty") if isinstance(document, Mapping) else None
    rms = stated.get("sky_rms_deg") if isinstance(stated, Mapping) else None
    return float(rms) if isinstance(rms, int | float) else None
