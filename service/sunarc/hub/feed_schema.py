"""Schema of a row of a feed: one table of columns, for the hub's check and for the JSON Schema of a line.

The table is that of the database (`tables`): type, null and words of a column are there. `docs/feed.schema.json` is
what `feed_schema` returns.
"""

from __future__ import annotations

import hashlib
import json
import math
import re
from collections.abc import Callable, Mapping
from datetime import UTC, date, datetime, timedelta
from functools import cache
from typing import Any, NamedTuple

from sqlalchemy import JSON, BigInteger, Boolean, Column, Float, Integer, Text

from sunarc.common.findings import from_json
from sunarc.common.utc import from_microseconds, to_microseconds
from sunarc.formats.calibration_document import READ_SCHEMAS
from sunarc.imager.archive import values
from sunarc.imager.archive.database import tables
from sunarc.imager.archive.database.connections import json_text
from sunarc.imager.archive.feed_rows import (
    FED,
    MOST_LEVELS,
    MOST_ROW_BYTES,
    REMOVED,
    SINCE,
    STATUS,
    FeedRow,
    Refusal,
    plain_type,
    sent_columns,
)
from sunarc.imager.runtime.json_fields import descriptions

FUTURE = timedelta(minutes=10)
"""A row dated later than now by more than this is set apart: clocks differ by seconds, time zones by hours."""
_DATED = {
    "pose_epoch": "started_at",
    "sun_point": "time",
    "day": "decided_at",
    "day_air": "set_at",
    "night": "decided_at",
    "calibration": "created_at",
    "refit": "requested_at",
    "event": "time",
    "housekeeping": "time",
}
_KINDS = frozenset({*FED, *(kind + REMOVED for kind in FED)})
LATEST_US = to_microseconds(datetime(2200, 1, 1, tzinfo=UTC))
"""No time is that late."""
_LARGEST = 1.7976931348623157e308
_DATE = r"^(19[7-9]\d|2[01]\d\d)-(0[1-9]|1[0-2])-(0[1-9]|[12]\d|3[01])$"
_IS_DATE = re.compile(_DATE, re.ASCII)
_SENT_ALWAYS = frozenset({("calibration", "document_sha256")})
"""Columns with a default that a row has to have all the same."""

_VALUES: Mapping[str, type] = {
    "camera": values.CameraRecord,
    "sun_point": values.SunPoint,
    "day": values.Day,
    "refit": values.Refit,
    "event": values.Event,
    "night": values.Night,
    "housekeeping": values.Housekeeping,
}
"""Values whose fields describe the columns of a kind."""
_MEANINGS: Mapping[str, str] = {
    "camera": "Name of the camera, that of the request.",
    "camera.name": "Name of the camera, that of the request.",
    "camera.pixel_format": "Pixel format, as the camera states it.",
    "pose_epoch.id": "Id, of the whole hub: begin it with the camera's name.",
    "pose_epoch.started_at": "From when on the camera did not move.",
    "pose_epoch.ended_at": "Until when; null: it goes on.",
    "pose_epoch.reason": "Why it began, in words.",
    "sun_point.time": "Middle of the exposure.",
    "sun_point.reason": "Why it was accepted or rejected: findings as the text of a JSON list, or a sentence.",
    "sun_point.temperature_c": "Of the air, measured with it, degrees Celsius; null takes the day's.",
    "sun_point.pressure_hpa": "Of the air, measured with it, hPa; null takes the day's.",
    "sun_point.file": "Name of the image file; empty for a frame of the camera.",
    "sun_point.folder": "Folder of the image file; empty where it is not known.",
    "sun_point.ingest_pass": "1: found without a prediction, 2: with one; null: of no file.",
    "day_air.date": "Local mean solar date.",
    "day_air.temperature_c": "Mean over the hours of sun, degrees Celsius; null where not measured.",
    "day_air.pressure_hpa": "Mean over the hours of sun, hPa; null where not measured.",
    "day_air.set_at": "When it was given.",
    "calibration.id": "Id, of the whole hub.",
    "calibration.state": "Whether it is in use.",
    "calibration.method": "How it was fitted: robust or paper.",
    "calibration.created_at": "When it was made.",
    "calibration.valid_from": "From when on it answers.",
    "calibration.valid_until": "Until when; null: until further notice.",
    "calibration.pose_epoch": "Id of a pose epoch that was sent before.",
    "calibration.parent": "Id of the calibration that it was compared with or copied from.",
    "calibration.accepted": "The verdict.",
    "calibration.reasons": "Why, as findings.",
    "calibration.document": "The calibration document (calibration.schema.json).",
    "calibration.document_sha256": "SHA-256, hexadecimal, of the document's canonical text (feed.md).",
    "calibration.pinned": "Whether a refit leaves it in use whatever it finds.",
    "night.picture_time": "Middle of the exposure of the night's picture.",
    "housekeeping.step": "Of an hour or of a UTC day.",
    "day.decided_at": "When the day was judged.",
    "refit.requested_at": "When it was requested.",
    "event.time": "When it happened.",
    "event.details": "Its numbers; their names have their units.",
}
"""Descriptions of the other columns."""


class _Rule(NamedTuple):
    """Rule of a value of JSON, as JSON Schema and as a test; null apart."""

    schema: Mapping[str, Any]
    fits: Callable[[Any], bool]


def _integer_rule(least: int, most: int) -> _Rule:
    schema = {"type": "integer", "minimum": least, "maximum": most}
    return _Rule(schema, lambda value: type(value) is int and least <= value <= most)


def _is_number(value: object) -> bool:
    if type(value) is float:
        return math.isfinite(value)
    return type(value) is int and -_LARGEST <= value <= _LARGEST


def _is_text(value: object) -> bool:
    """Return whether both engines can store a text: no NUL (PostgreSQL), no half of a surrogate pair."""
    return (
        type(value) is str
        and "\0" not in value
        and (value.isascii() or not any("\ud800" <= character <= "\udfff" for character in value))
    )


def _is_text_throughout(value: object) -> bool:
    """Return whether no text of a list or an object has half of a surrogate pair, which no answer could hold."""
    try:
        json.dumps(value, ensure_ascii=False).encode()
    except UnicodeEncodeError:
        return False
    return True


def _is_date(value: object) -> bool:
    return type(value) is str and _IS_DATE.fullmatch(value) is not None


_INT32, _INT64 = _integer_rule(-(2**31), 2**31 - 1), _integer_rule(-(2**63), 2**63 - 1)
_NUMBER = _Rule({"type": "number", "minimum": -_LARGEST, "maximum": _LARGEST}, _is_number)
_TEXT = _Rule({"type": "string", "pattern": "^[^\\u0000]*$"}, _is_text)
_FLAG = _Rule({"type": "boolean"}, lambda value: type(value) is bool)
_TIME = _integer_rule(0, LATEST_US - 1)
_DAY = _Rule({"type": "string", "format": "date", "pattern": _DATE}, _is_date)
_LIST = _Rule({"type": "array"}, lambda value: type(value) is list and _is_text_throughout(value))
_OBJECT = _Rule({"type": "object"}, lambda value: type(value) is dict and _is_text_throughout(value))


def _word_rule(words: tuple[str, ...]) -> _Rule:
    return _Rule({"enum": [*words]}, lambda value: type(value) is str and value in words)


def _number_list_rule(length: int) -> _Rule:
    schema = {"type": "array", "items": _NUMBER.schema, "minItems": length, "maxItems": length}
    return _Rule(
        schema, lambda value: type(value) is list and len(value) == length and all(_is_number(one) for one in value)
    )


def _column_rule(column: Column[Any]) -> _Rule:  # noqa: PLR0911 - a column has one of many types
    match column.type:
        case tables.UtcTime():
            return _TIME
        case tables.CalendarDate():
            return _DAY
        case tables.Word(words=words):
            return _word_rule(words)
        case tables.FindingTuple():
            return _LIST
        case tables.NumberTuple(length=length):
            return _number_list_rule(length)
        case tables.JsonOf():
            schema = {name: part for name, part in column.type.schema().items() if name != "$defs"}
            return _Rule(schema, (_LIST if schema.get("type") == "array" else _OBJECT).fits)
    plain = plain_type(column)
    found = (
        (Float, _NUMBER), (Boolean, _FLAG), (BigInteger, _INT64), (Integer, _INT32), (Text, _TEXT), (JSON, _OBJECT)
    )  # fmt: skip
    return next(rule for base, rule in found if isinstance(plain, base))


_STATUS: Mapping[str, tuple[_Rule, str]] = {
    "version": (_TEXT, "Version of the sender's software."),
    "health": (_word_rule(("ready", "degraded", "not_ready")), "How it is."),
    "state": (_TEXT, "The same in one of five words: not_serving, attention, starting, ready_with_note, ready."),
    "state_text": (_TEXT, "What decides the state, in a sentence."),
    "conditions": (_LIST, "Codes of what is wrong (codes.md), a list of words."),
    "disk_free_bytes": (_NUMBER, "Free space where the images are, bytes."),
    "clock_synchronised": (_FLAG, "Whether a time service steers its clock."),
    "clock_error_s": (_NUMBER, "Bound of its clock's error, s."),
    "last_frame_at": (_TEXT, "Time of its newest frame, RFC 3339."),
    "drift_deg": (_NUMBER, "Rotation against its calibration on its last day, degrees."),
    "compared_at": (
        _TEXT,
        "When its rows were last compared with the hub's, RFC 3339; null or missing: not yet, or not by this version.",
    ),
}
"""Keys of a status; every value may be null or missing, and other keys are kept too."""


class _Check(NamedTuple):
    name: str
    required: bool
    nullable: bool
    fits: Callable[[Any], bool]
    what: str


@cache
def _make_checks(kind: str, only_key: bool) -> tuple[_Check, ...]:  # noqa: FBT001
    """Return the checks of each column."""
    if kind == STATUS:
        return tuple(_Check(name, False, True, rule.fits, _rule_name(rule)) for name, (rule, _) in _STATUS.items())
    columns = sent_columns(kind)
    made = []
    for name in FED[kind][1] if only_key else columns:
        column, rule = columns[name], _column_rule(columns[name])
        # an event without a camera concerns all that an imager has: at the hub it is the camera's
        required = (
            (only_key and (kind, name) not in SINCE) or column.server_default is None or (kind, name) in _SENT_ALWAYS
        )
        made.append(_Check(name, required and not column.nullable, bool(column.nullable), rule.fits, _rule_name(rule)))
    return tuple(made)


def _rule_name(rule: _Rule) -> str:
    return str(rule.schema.get("type", "word of " + ", ".join(map(str, rule.schema.get("enum", ())))))


def refuse_row(camera: str, row: FeedRow, now: datetime) -> Refusal | None:
    """Return why a row is not stored, as far as it says itself."""
    kind = row.kind.removesuffix(REMOVED)
    if row.data is None:
        text = f"a row of kind {row.kind} was too large to be sent or stored, or has more than {MOST_LEVELS} levels"
        return Refusal(reason="body_too_large", text=text)
    if row.kind not in {STATUS, *_KINDS}:
        return Refusal(reason="malformed", text=f"kind {row.kind} is unknown")
    problem = find_problem(kind, row.data, only_key=row.kind != kind)
    if problem is not None:
        return Refusal(reason="malformed", text=problem)
    if kind == STATUS:
        return None
    named = row.data.get("name" if kind == "camera" else "camera", camera)
    if named != camera and not (kind == "event" and named is None):
        return Refusal(reason="other_camera", text=f"the row is of camera {named}")
    return _refuse_value(kind, row, row.data, now)


def _refuse_value(kind: str, row: FeedRow, data: Mapping[str, Any], now: datetime) -> Refusal | None:
    try:
        values = typed(kind, data)
    except (ValueError, OverflowError) as error:
        return Refusal(reason="malformed", text=str(error))
    if row.kind != kind:
        return None  # removed: its time says when it was made
    dated: datetime | None = values.get(_DATED.get(kind, ""))
    if dated is not None and dated > now + FUTURE:
        return Refusal(reason="future_clock", text=f"dated {dated.isoformat()}, later than now")
    if dated is not None and dated.year < 1970:
        return Refusal(reason="malformed", text=f"dated {dated.isoformat()}, before 1970")
    return _refuse_document(data) if kind == "calibration" else None


def _refuse_document(data: Mapping[str, Any]) -> Refusal | None:
    document = data["document"]
    schema = document.get("schema") if isinstance(document, dict) else None
    if schema not in READ_SCHEMAS:
        return Refusal(
            reason="newer_document", text=f"document {data['id']} is {schema}, none of {', '.join(READ_SCHEMAS)}"
        )
    if hashlib.sha256(json_text(document).encode()).hexdigest() != data["document_sha256"]:
        return Refusal(reason="damaged_document", text=f"document {data['id']} does not match its checksum")
    return None


def find_problem(kind: str, data: Mapping[str, Any], *, only_key: bool = False) -> str | None:
    """Return the fault in the form of a row that was sent; None without one."""
    if kind == STATUS:
        if len(json.dumps(data)) > MOST_ROW_BYTES[STATUS]:
            return f"the status is larger than {MOST_ROW_BYTES[STATUS]} bytes"
        if not _is_text_throughout(data):
            return "a text has half of a surrogate pair"
    checks = _make_checks(kind, only_key)
    unknown = set() if kind == STATUS else data.keys() - {one.name for one in checks}
    if unknown:
        return f"column {min(unknown)} is unknown"
    for name, required, nullable, fits, what in checks:
        value = data.get(name)
        if value is None:
            if required or (not nullable and name in data):
                return f"{name} is missing"
        elif not fits(value):
            return f"{name} is no {what}"
    return None


def typed(kind: str, data: Mapping[str, Any]) -> dict[str, Any]:
    """Return the values of a row that has no problem, by the keys of its columns, as the table takes them.

    Raises
    ------
    ValueError, OverflowError : a date or a time that there is not.
    """
    found = dict(data)
    for name, key, convert in _list_conversions(kind):
        if name in found:
            value = found.pop(name)
            found[key] = None if value is None else convert(value)
    return found


@cache
def _list_conversions(kind: str) -> tuple[tuple[str, str, Callable[[Any], Any]], ...]:
    """Return the columns whose values JSON does not have: name, key and conversion."""
    found = ((name, column, _find_conversion(column)) for name, column in sent_columns(kind).items())
    return tuple((name, column.key, convert) for name, column, convert in found if convert is not None)


def _find_conversion(column: Column[Any]) -> Callable[[Any], Any] | None:
    if isinstance(column.type, tables.JsonOf):
        return column.type.read
    if isinstance(plain_type(column), Float):
        return float
    return _CONVERSIONS.get(type(column.type))


_CONVERSIONS: Mapping[type, Callable[[Any], Any]] = {
    tables.UtcTime: from_microseconds,
    tables.CalendarDate: date.fromisoformat,
    tables.FindingText: tables.parse_finding_text,
    tables.FindingTuple: lambda value: tuple(from_json(one) for one in value),
    tables.NumberTuple: tuple,
}


def feed_schema(revision: str) -> dict[str, Any]:
    """Return the JSON Schema of a line of a feed.

    Parameters
    ----------
    revision : of the tables.
    """
    kinds: dict[str, Any] = {}
    parts: dict[str, Any] = {}
    for kind in FED:
        for column in sent_columns(kind).values():
            parts |= column.type.schema().get("$defs", {}) if isinstance(column.type, tables.JsonOf) else {}
        kinds[kind] = _make_object_schema(kind, only_key=False)
        kinds[kind + REMOVED] = _make_object_schema(kind, only_key=True)
    kinds[STATUS] = {
        "type": "object",
        "properties": {
            name: _allow_null(rule.schema, nullable=True) | {"description": text}
            for name, (rule, text) in _STATUS.items()
        },
    }
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "$id": f"urn:sunarc:schema:feed:{revision}",
        "title": f"A line of a feed, revision {revision}",
        "description": "Times are whole microseconds since 1970-01-01 UTC; a whole number has neither point nor "
        "exponent; a text has no half of a surrogate pair. What else is asked of a row is in feed.md.",
        "type": "object",
        "required": ["seq", "kind", "data"],
        "properties": {
            "seq": {"type": "integer", "minimum": 1, "maximum": 2**63 - 1},
            "kind": {"enum": [*kinds]},
            "data": {"type": "object"},
        },
        "oneOf": [{"properties": {"kind": {"const": kind}, "data": {"$ref": f"#/$defs/{kind}"}}} for kind in kinds],
        "$defs": kinds | parts,
    }


def _make_object_schema(kind: str, *, only_key: bool) -> dict[str, Any]:
    columns, checks = sent_columns(kind), _make_checks(kind, only_key)
    texts = descriptions(_VALUES[kind]) if kind in _VALUES else {}
    properties = {}
    for check in checks:
        column = columns[check.name]
        meaning = _MEANINGS.get(f"{kind}.{check.name}") or _MEANINGS.get(check.name) or texts.get(column.key)
        schema = _allow_null(_column_rule(column).schema, nullable=check.nullable)
        properties[str(check.name)] = schema | ({"description": meaning} if meaning else {})
    return {
        "type": "object",
        "required": [str(check.name) for check in checks if check.required],
        "properties": properties,
        "additionalProperties": False,
    }


def _allow_null(schema: Mapping[str, Any], *, nullable: bool) -> dict[str, Any]:
    if not nullable:
        return dict(schema)
    if "type" in schema:
        return {**schema, "type": [schema["type"], "null"]}
    return {"enum": [*schema["enum"], None]}
