"""Rows of the archive as an imager sends them to a hub: which tables, under which keys, and the values as JSON.

A value is as in the table: times as whole microseconds since 1970-01-01 UTC, JSON columns as JSON, dates as ISO 8601.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from datetime import date
from functools import cache
from typing import Any

from sqlalchemy import JSON, Boolean, Column, Date, Float, Integer, Table, Text, TypeDecorator
from sqlalchemy.types import TypeEngine

from sunarc.archive import tables
from sunarc.archive.json_text import parsed_json
from sunarc.archive.types import CalendarDate, FindingTuple, NumberTuple, UtcTime
from sunarc.findings import from_json
from sunarc.utc import from_microseconds

FED: Mapping[str, tuple[Table, tuple[str, ...]]] = {
    "camera": (tables.camera, ("name",)),
    "pose_epoch": (tables.pose_epoch, ("id",)),
    "sun_point": (tables.sun_point, ("camera", "time", "body", "exposure_us", "method", "file")),
    "day": (tables.day, ("camera", "date")),
    "day_air": (tables.day_air, ("camera", "date")),
    "calibration": (tables.calibration, ("id",)),
    "refit": (tables.refit, ("id",)),
    "event": (tables.event, ("camera", "time", "kind", "text")),
}
"""The tables that are sent, each after those that it refers to, with what makes a row of it another one."""

STATUS = "status"
"""Kind of what the imager tells of itself; the hub keeps the newest."""
REMOVED = ".removed"
"""Ending of the kind of a row that is there no more, or not under that key."""
_NUMBERED = frozenset({"sun_point", "event"})
"""Tables whose `id` is the archive's own, and another one at the hub."""


@cache
def columns_of(kind: str) -> Mapping[str, Column[Any]]:
    """Return the columns that are sent of a table, by their names."""
    columns = FED[kind][0].columns
    return {column.name: column for column in columns if not (kind in _NUMBERED and column.name == "id")}


def plain_type(column: Column[Any]) -> TypeEngine[Any]:
    """Return how a column is stored."""
    return column.type.impl_instance if isinstance(column.type, TypeDecorator) else column.type


def from_trigger(kind: str, stored: Mapping[str, Any]) -> dict[str, Any]:
    """Return the JSON values of a row that a trigger of `outbox` wrote: there a number is a text of all its digits."""
    types = {column.name: plain_type(column) for column in FED[kind.removesuffix(REMOVED)][0].columns}
    return {name: _value(types[name], value) for name, value in stored.items()}


def _value(kind: TypeEngine[Any], stored: Any) -> Any:  # noqa: ANN401 - of many types
    if stored is None:
        return None
    if isinstance(kind, Float):
        return _number(str(stored))
    if isinstance(kind, Boolean):
        return bool(stored)
    return parsed_json(str(stored)) if isinstance(kind, JSON) else stored


def _number(text: str) -> float | None:
    try:
        value = float(text)
    except ValueError:
        return None
    return value if math.isfinite(value) else None


_ALLOWED: tuple[tuple[type[TypeEngine[Any]], tuple[type, ...]], ...] = (
    (Float, (int, float)),
    (Boolean, (bool,)),
    (Integer, (int,)),
    (Text, (str,)),
    (Date, (str,)),
    (JSON, (dict, list)),
)


def problem_of(kind: str, data: Mapping[str, Any], *, only_key: bool = False) -> str | None:
    """Return what is wrong with the form of a row that was sent; None where nothing is."""
    columns = columns_of(kind)
    if only_key:
        columns = {name: columns[name] for name in FED[kind][1]}
    unknown = data.keys() - columns.keys()
    if unknown:
        return f"column {min(unknown)} is unknown"
    for name, column in columns.items():
        value = data.get(name)
        if value is None:
            # an event without a camera concerns all that an imager has: at the hub it is the camera's
            if not column.nullable and column.server_default is None:
                return f"{name} is missing"
        elif not _is_of(plain_type(column), value):
            return f"{name} is no {type(plain_type(column)).__name__}"
    return None


@cache
def _allowed(kind: TypeEngine[Any]) -> tuple[type, ...]:
    return next(types for base, types in _ALLOWED if isinstance(kind, base))


def _is_of(kind: TypeEngine[Any], value: object) -> bool:
    allowed = _allowed(kind)
    if not isinstance(value, allowed) or (isinstance(value, bool) and bool not in allowed):
        return False
    if isinstance(value, str):
        return "\0" not in value  # PostgreSQL stores none
    if isinstance(value, int) and not isinstance(kind, Float):
        return abs(value) < 2**63
    return not isinstance(value, float) or math.isfinite(value)


def typed(kind: str, data: Mapping[str, Any]) -> dict[str, Any]:
    """Return the values of a row that has no problem, by the keys of its columns, as the table takes them.

    Raises
    ------
    ValueError, OverflowError : a date or a time that there is not.
    """
    columns = columns_of(kind)
    return {columns[name].key: _typed(columns[name], value) for name, value in data.items()}


def _typed(column: Column[Any], value: Any) -> Any:  # noqa: ANN401 - of many types
    if value is None:
        return None
    if isinstance(column.type, UtcTime):
        return from_microseconds(value)
    if isinstance(column.type, CalendarDate):
        return date.fromisoformat(value)
    if isinstance(column.type, FindingTuple):
        return tuple(from_json(one) for one in value) if isinstance(value, list) else ()
    if isinstance(column.type, NumberTuple):
        return tuple(value) if isinstance(value, list) else None
    return value
