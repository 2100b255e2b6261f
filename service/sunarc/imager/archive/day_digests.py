"""Number and hash of a camera's rows by kind and UTC day, equal on an imager and on its hub where their rows are."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, date, datetime, timedelta
from functools import cache
from typing import Annotated, Any, NamedTuple

import sqlalchemy as sa

from sunarc.common.findings import from_json
from sunarc.common.utc import to_microseconds
from sunarc.imager.archive.database import tables
from sunarc.imager.archive.feed_rows import FED, plain_type, sent_columns
from sunarc.imager.runtime.json_fields import Returned, described

LEAST_KEPT = timedelta(days=90)
"""Sightings younger than this are never removed; PostgreSQL's function has the same bound (revision 0014)."""

MOST_DAYS = 32
MOST_ROWS = 200_000
"""Rows read at once: seconds of processor; of a day that has more its largest kinds are not compared."""
_DAY_COLUMNS: Mapping[str, str] = {
    "pose_epoch": "started_at",
    "sun_point": "time",
    "day": "date",
    "day_air": "date",
    "calibration": "created_at",
    "refit": "requested_at",
    "event": "time",
    "night": "date",
    "housekeeping": "time",
}
"""The column that has the day of a row; a camera's own row has no day."""
_DAY_US = 86_400_000_000
_LATEST = date(2200, 1, 1)
"""A damaged time may be of no year."""
_AT_ONCE = 2000
"""Rows that are in memory at the same time."""


class DayDigest(NamedTuple):
    """Number of the rows of a kind on a UTC day, and the sum of their hashes modulo 2^64, hexadecimal."""

    n: int
    hash: str


@dataclass(frozen=True, slots=True, kw_only=True)
class DayDigests:
    """Digests of the days from one on, as many as can be read at once.

    Attributes
    ----------
    until : the day after the last one.
    days : by kind and day; a day without rows is not there, and one of which there are too many to read is None.
    """

    until: date
    days: Mapping[str, Mapping[date, DayDigest | None]]


@dataclass(frozen=True, slots=True, kw_only=True)
class StoredDays(Returned):
    """Rows of a camera at a hub, for a comparison with those of its imager."""

    revision: Annotated[str, described("Revision of the hub's tables; of rows of another one nothing is said.", "0020")]
    until: Annotated[date, described("The day after the last one of which something is said.", "2026-06-30")]
    days: Annotated[
        Mapping[str, Mapping[date, DayDigest | None]],
        described(
            "By kind and UTC day the number of rows, and the sum of their hashes (hexadecimal). A day without rows is "
            "left out; null: too many to be compared.",
            {"sun_point": {"2026-06-29": [1440, "5f1d0c33a4b2e19d"]}},
        ),
    ]


def day_digests(connection: sa.Connection, camera: str, *, since: date, until: date) -> DayDigests:
    """Return the digests of a camera's rows of the days `since` <= day < `until`, in one snapshot.

    At most 32 days and 200,000 rows are read: where there are more, `until` of what is returned is earlier, and where
    one day alone has more, its largest kinds are left out until the others are no more. An event counts by its key
    alone, and once: the hub keeps the first of equal ones. Documents count by their checksums.
    """
    until = max(min(until, since + min(timedelta(days=MOST_DAYS), date.max - since)), since)
    counts = {kind: _count_rows_by_day(connection, kind, camera, since, until) for kind in _DAY_COLUMNS}
    left, day = MOST_ROWS, since
    read: dict[date, dict[str, int]] = {}
    while day < until:
        of_day = _kinds_to_read(counts, day)
        left -= sum(of_day.values())
        if left < 0:
            break
        read[day], day = of_day, day + timedelta(days=1)
    days: dict[str, dict[date, DayDigest | None]] = {
        kind: {
            one: _compute_day_digest(connection, kind, camera, one) if kind in read[one] else None
            for one in found
            if one in read
        }
        for kind, found in counts.items()
    }
    return DayDigests(until=day, days=days)


def _kinds_to_read(counts: Mapping[str, Mapping[date, int]], day: date) -> dict[str, int]:
    """Return the number of a day's rows by kind, without the largest kinds where it has more than may be read."""
    of_day = sorted((found[day], kind) for kind, found in counts.items() if day in found)
    while sum(n_rows for n_rows, _ in of_day) > MOST_ROWS:
        of_day.pop()
    return {kind: n_rows for n_rows, kind in of_day}


def first_and_last_day(connection: sa.Connection, camera: str) -> tuple[date, date] | None:
    """Return the days of a camera's first and last sighting; None without any."""
    time = sa.type_coerce(_get_day_column("sun_point"), sa.BigInteger)
    where = _ownership_condition("sun_point", camera), time.between(0, _date_to_us(_LATEST))
    first, last = (connection.scalar(sa.select(found(time)).where(*where)) for found in (sa.func.min, sa.func.max))
    if not isinstance(first, int) or not isinstance(last, int):
        return None
    return _us_to_date(first), _us_to_date(last)


def day_condition(kind: str, camera: str, day: date) -> sa.ColumnElement[bool]:
    """Return the condition that a row of a kind is a camera's, and of a UTC day."""
    return sa.and_(_ownership_condition(kind, camera), _days_condition(kind, day, day + timedelta(days=1)))


def _get_day_column(kind: str) -> sa.Column[Any]:
    return sent_columns(kind)[_DAY_COLUMNS[kind]]


def _ownership_condition(kind: str, camera: str) -> sa.ColumnElement[bool]:
    """Return the condition that a row is a camera's: an event of no camera is, on an imager, that of its own."""
    owner = FED[kind][0].c.camera
    return sa.or_(owner == camera, owner.is_(None)) if kind == "event" else owner == camera


def _days_condition(kind: str, first: date, end: date) -> sa.ColumnElement[bool]:
    column = _get_day_column(kind)
    if isinstance(column.type, tables.CalendarDate):
        return (column >= first) & (column < end)
    time = sa.type_coerce(column, sa.BigInteger)
    return (time >= _date_to_us(first)) & (time < _date_to_us(end))


def _count_rows_by_day(connection: sa.Connection, kind: str, camera: str, since: date, until: date) -> dict[date, int]:
    """Return the number of rows by day."""
    column = _get_day_column(kind)
    dated = isinstance(column.type, tables.CalendarDate)
    day: sa.ColumnElement[Any] = column if dated else sa.type_coerce(column, sa.BigInteger).op("/")(_DAY_US)
    where = (_ownership_condition(kind, camera), _days_condition(kind, since, until))
    rows = connection.execute(sa.select(day.label("of"), sa.func.count()).where(*where).group_by("of")).all()
    found = ((one if dated else _us_to_date(int(one) * _DAY_US), n) for one, n in rows if one is not None)
    return {one: int(n) for one, n in found if isinstance(one, date)}


def _compute_day_digest(connection: sa.Connection, kind: str, camera: str, day: date) -> DayDigest:
    columns = _compared_columns(kind)
    statement = sa.select(*(one.selected for one in columns)).where(day_condition(kind, camera, day))
    rows = connection.execution_options(yield_per=_AT_ONCE).execute(statement)
    hashes = _hash_rows(rows, [one.plain for one in columns], owner=None if kind != "event" else camera)
    if kind == "event":
        hashes = iter(set(hashes))
    n = total = 0
    for one in hashes:
        n, total = n + 1, total + one
    return DayDigest(n, f"{total & (2**64 - 1):016x}")


def _hash_rows(
    rows: Iterator[Sequence[Any]], plain: Sequence[Callable[[Any], Any]], owner: str | None
) -> Iterator[int]:
    for row in rows:
        values = [make(value) for make, value in zip(plain, row, strict=True)]
        if owner is not None:
            values[0] = owner
        text = json.dumps(values, sort_keys=True, separators=(",", ":"))
        yield int.from_bytes(hashlib.blake2b(text.encode(), digest_size=8).digest())


class _ComparedColumn(NamedTuple):
    """A column whose value counts, and the expression that makes the same value of it on both engines."""

    selected: sa.ColumnElement[Any]
    plain: Callable[[Any], Any]


@cache
def _compared_columns(kind: str) -> tuple[_ComparedColumn, ...]:
    names = FED[kind][1] if kind == "event" else sent_columns(kind)  # an event's first column is its camera
    columns = [sent_columns(kind)[name] for name in names]
    left_out = {"document"}  # its checksum stands for it
    return tuple(
        _make_comparable(one) for one in columns if one.name not in left_out and not isinstance(one.type, tables.JsonOf)
    )


def _make_comparable(column: sa.Column[Any]) -> _ComparedColumn:
    match column.type:
        case tables.UtcTime():
            return _ComparedColumn(sa.type_coerce(column, sa.BigInteger), _return_unchanged)
        case tables.FindingText():
            return _ComparedColumn(sa.type_coerce(column, sa.Text), _plain_finding_text)
        case tables.FindingTuple():
            return _ComparedColumn(sa.type_coerce(column, sa.JSON), _plain_findings)
        case tables.CalendarDate():
            return _ComparedColumn(column, str)
    kind = plain_type(column)
    return _ComparedColumn(
        sa.type_coerce(column, kind), _finite_or_none if isinstance(kind, sa.Float) else _return_unchanged
    )


def _return_unchanged(value: Any) -> Any:  # noqa: ANN401 - of many types
    return value


def _finite_or_none(value: Any) -> float | None:  # noqa: ANN401 - a damaged row has a text there
    if not isinstance(value, int | float) or value != value or value in {float("inf"), float("-inf")}:  # noqa: PLR0124 - NaN
        return None
    return float(value) + 0.0  # SQLite has no negative zero


def _plain_findings(value: Any) -> list[dict[str, Any]]:  # noqa: ANN401 - whatever is stored
    return [from_json(one).as_json() for one in value] if isinstance(value, list) else []


def _plain_finding_text(value: Any) -> Any:  # noqa: ANN401 - a damaged row has no text there
    if not isinstance(value, str) or not value or value.startswith("[{"):
        return value
    return json.dumps([one.as_json() for one in tables.parse_finding_text(value)], separators=(",", ":"))


def _date_to_us(day: date) -> int:
    return to_microseconds(datetime(day.year, day.month, day.day, tzinfo=UTC))


def _us_to_date(us: int) -> date:
    return date(1970, 1, 1) + timedelta(microseconds=us)
