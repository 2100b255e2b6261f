"""Rows as an imager sends them to a hub: which tables, under which keys, and the values as JSON.

A value is as in the table: times as whole microseconds since 1970-01-01 UTC, JSON columns as JSON, dates as ISO 8601.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from itertools import chain
from typing import Annotated, Any, Literal

from sqlalchemy import JSON, Boolean, Column, Float, Table, TypeDecorator
from sqlalchemy.types import TypeEngine

from sunarc.common.errors import InputError
from sunarc.imager.archive.database import tables
from sunarc.imager.archive.database.connections import parsed_json
from sunarc.imager.runtime.json_fields import EXAMPLE_TIME, Returned, Time, described

FED: Mapping[str, tuple[Table, tuple[str, ...]]] = {
    "camera": (tables.camera, ("name",)),
    "pose_epoch": (tables.pose_epoch, ("id",)),
    "sun_point": (tables.sun_point, ("camera", "time", "body", "exposure_us", "method", "file", "folder")),
    "day": (tables.day, ("camera", "date")),
    "day_air": (tables.day_air, ("camera", "date")),
    "calibration": (tables.calibration, ("id",)),
    "refit": (tables.refit, ("id",)),
    "event": (tables.event, ("camera", "time", "kind", "text")),
    "night": (tables.night, ("camera", "date")),  # after the events: those of former imagers become nights, too
    "housekeeping": (tables.housekeeping, ("camera", "step", "time")),
}
"""The tables that are sent, each after those that it refers to, with the columns that make a row of it another one."""

SINCE = frozenset({("sun_point", "folder")})
"""Columns of keys that former imagers do not send: they are empty there."""
STATUS = "status"
"""Kind of the imager's own state; the hub keeps the newest."""
MOST_ROWS = 10_000
"""Of a body."""
MOST_LEVELS = 32
"""Most levels of lists and objects in a row; the service's answers end at some 250, a calibration document has 6."""
MOST_ROW_BYTES: Mapping[str, int] = {STATUS: 65_536, "calibration": 16_000_000}
"""Of a row as JSON."""
_MOST_OTHER_BYTES = 1_000_000
REMOVED = ".removed"
"""Ending of the kind of a row that is there no more, or not under that key."""
_NUMBERED = frozenset({"sun_point", "event"})
"""Tables whose `id` is the archive's own, and another one at the hub."""


@cache
def sent_columns(kind: str) -> Mapping[str, Column[Any]]:
    """Return the columns that are sent of a table, by their names."""
    columns = FED[kind][0].columns
    return {column.name: column for column in columns if not (kind in _NUMBERED and column.name == "id")}


def plain_type(column: Column[Any]) -> TypeEngine[Any]:
    """Return how a column is stored."""
    return column.type.impl_instance if isinstance(column.type, TypeDecorator) else column.type


def from_trigger(kind: str, stored: Mapping[str, Any]) -> dict[str, Any]:
    """Return the JSON values of a row that a trigger of `outbox` wrote: there a number is a text of all its digits."""
    types = {column.name: plain_type(column) for column in FED[kind.removesuffix(REMOVED)][0].columns}
    return {name: _plain_value(types[name], value) for name, value in stored.items()}


def _plain_value(kind: TypeEngine[Any], stored: Any) -> Any:  # noqa: ANN401 - of many types
    if stored is None:
        return None
    if isinstance(kind, Float):
        return _parse_finite(str(stored))
    if isinstance(kind, Boolean):
        return bool(stored)
    return parsed_json(str(stored)) if isinstance(kind, JSON) else stored


def _parse_finite(text: str) -> float | None:
    try:
        value = float(text)
    except ValueError:
        return None
    return value if math.isfinite(value) else None


Reason = Literal[
    "unknown_camera",
    "forged_token",
    "second_installation",
    "newer_imager",
    "gap",
    "body_too_large",
    "malformed",
    "other_camera",
    "future_clock",
    "newer_document",
    "damaged_document",
    "contradiction",
    "refused_by_database",
]


@dataclass(frozen=True, slots=True, kw_only=True)
class FeedRow:
    """A row as it is sent.

    Attributes
    ----------
    seq : its number in the outbox.
    kind : the table, with ".removed" where the row is there no more; or "status".
    data : the columns; None where they were too large to be sent, or are too large or too deep to be stored.
    """

    seq: int
    kind: str
    data: Mapping[str, Any] | None


def feed_lines(rows: Sequence[FeedRow]) -> bytes:
    """Return rows as newline-delimited JSON."""
    lines = (json.dumps({"seq": row.seq, "kind": row.kind, "data": row.data}, allow_nan=False) for row in rows)
    return "".join(f"{line}\n" for line in lines).encode()


def read_feed_lines(body: bytes, *, after: int) -> tuple[FeedRow, ...]:
    """Return the rows of newline-delimited JSON.

    Raises
    ------
    InputError : a line is no row, or the numbers do not rise from `after` on; it names the line.
    """
    rows: list[FeedRow] = []
    for number, line in enumerate(body.splitlines(), 1):
        row = _parse_row(line)
        if row is None or row.seq <= max(after, rows[-1].seq if rows else after):
            problem = "is not a row" if row is None else f"has number {row.seq}, which is not after the one before"
            raise InputError(field=f"body, line {number}", problem=problem, remedy='send {"seq", "kind", "data"}')
        rows.append(row)
    return tuple(rows)


def _parse_row(line: bytes) -> FeedRow | None:
    try:
        found = json.loads(line, parse_constant=lambda _: None)  # NaN and infinities: no JSON, and no value
        seq, kind, data = found["seq"], found["kind"], found["data"]
    except (ValueError, TypeError, KeyError, RecursionError):
        return None
    formed = type(seq) is int and 0 < seq < 2**63 and isinstance(kind, str) and isinstance(data, dict | None)
    if formed and (len(line) > MOST_ROW_BYTES.get(kind, _MOST_OTHER_BYTES) or is_deep(data)):
        data = None
    return FeedRow(seq=seq, kind=kind, data=data) if formed else None


def is_deep(value: object) -> bool:
    """Return whether a value of JSON has more levels than a row may have."""
    level = [value]
    for _ in range(MOST_LEVELS + 1):
        inner = [one.values() if isinstance(one, dict) else one for one in level if isinstance(one, dict | list)]
        if not inner:
            return False
        level = [*chain.from_iterable(inner)]
    return True


@dataclass(frozen=True, slots=True, kw_only=True)
class FeedBatch:
    """Rows of one camera's imager, in their order.

    Attributes
    ----------
    camera, installation : whose.
    after : the imager has nothing between this number and the first row's.
    rows : their numbers rise.
    """

    camera: str
    installation: str
    after: int
    rows: tuple[FeedRow, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class Refusal:
    """Reason why the hub did not take a row or a batch."""

    reason: Reason
    text: str


@dataclass(frozen=True, slots=True, kw_only=True)
class Quarantined(Returned):
    """Row or batch of an imager that the hub refused or set apart."""

    camera: Annotated[str, described("Name it was sent under.", "imager")]
    installation: Annotated[str, described("Id of the imager's database; empty where not known.", "5f1d")]
    reason: Annotated[Reason, described("Why, in a word.")]
    seq: Annotated[int, described("Number of the row; 0 for what was refused as a whole.", 4711)]
    kind: Annotated[str, described("Kind of the row; empty for what was refused as a whole.", "sun_point")]
    text: Annotated[str, described("Why, in a sentence.", "dated 2099-01-01T00:00:00+00:00, later than now")]
    data: Annotated[str, described("The row as it was sent, JSON; empty where there is none.", "{}")]
    n: Annotated[int, described("How often it came, a count.", 1)]
    first_at: Time
    last_at: Time


@dataclass(frozen=True, slots=True, kw_only=True)
class FleetCamera(Returned):
    """A camera as the hub sees it."""

    camera: Annotated[str, described("Its name.", "imager")]
    latitude: Annotated[float | None, described("Degrees, north positive; null until it sent it.", 36.604)] = None
    longitude: Annotated[float | None, described("Degrees, east positive; null until it sent it.", -97.485)] = None
    altitude: Annotated[float | None, described("Metres above sea level; null until it sent it.", 318.0)] = None
    received_at: Annotated[Time | None, described("When it last sent something; null: never.", EXAMPLE_TIME)] = None
    last_sighting_at: Annotated[Time | None, described("Time of its newest sighting.", EXAMPLE_TIME)] = None
    calibration: Annotated[str | None, described("Id of its current calibration.", "20130514T150508Z-52ee44")] = None
    calibrated_at: Annotated[Time | None, described("When that was made.", EXAMPLE_TIME)] = None
    sky_rms_deg: Annotated[float | None, described("Its 1-sigma over the sky (RMS), degrees.", 0.01)] = None
    status: Annotated[Mapping[str, Any] | None, described("What it last reported of itself.", {"health": "ready"})] = (
        field(default_factory=dict)
    )
    status_at: Annotated[Time | None, described("When that came.", EXAMPLE_TIME)] = None
    n_quarantined: Annotated[int, described("How many things of it are in quarantine.", 0)] = 0
