"""Descriptions, examples and times of dataclasses that the API returns: pydantic reads them with the types.

`free_bytes: Annotated[int, described("Free space, bytes.", 82_000_000_000)]` is the source of the OpenAPI document's
description and of the metric's.
"""

from __future__ import annotations

import re
from dataclasses import fields
from datetime import UTC, date, datetime
from functools import cache
from typing import Annotated, Any, ClassVar, get_type_hints

from pydantic import AfterValidator, AwareDatetime, BeforeValidator, ConfigDict, Field, WithJsonSchema
from pydantic.fields import FieldInfo

from sunarc.common.findings import Finding

_YEARS = range(1970, 2200)
_YEARS_PATTERN = r"^(19[7-9]\d|2[01]\d\d)-"
_DATE_PATTERN = _YEARS_PATTERN + r"(0[1-9]|1[0-2])-(0[1-9]|[12]\d|3[01])$"


def described(text: str, *examples: object) -> Any:  # noqa: ANN401 - as pydantic's Field
    """Return the description and the examples of a field, for its annotation."""
    return Field(description=text, examples=[*examples] or None)


@cache
def descriptions(cls: type) -> dict[str, str]:
    """Return the descriptions of a dataclass's fields by name; fields without one are absent."""
    hints = get_type_hints(cls, include_extras=True)
    marks = {field.name: getattr(hints[field.name], "__metadata__", ()) for field in fields(cls)}
    texts = {name: [m.description for m in found if isinstance(m, FieldInfo)] for name, found in marks.items()}
    return {name: found[-1] for name, found in texts.items() if found and found[-1]}


def _remove_defaults(schema: dict[str, Any]) -> None:
    for field in schema["properties"].values():
        field.pop("default", None)


class Returned:
    """Base of the dataclasses that the API returns: their JSON has every field, whatever has a default in Python."""

    __slots__ = ()
    __pydantic_config__: ClassVar[ConfigDict] = ConfigDict(
        json_schema_serialization_defaults_required=True, json_schema_extra=_remove_defaults
    )


_UNIX = re.compile(r"[1-9]\d{8,9}(\.\d+)?|(?P<ms>[1-9]\d{12})", re.ASCII)
"""Seconds since 1970, from 1973 to 2286, or milliseconds."""
_PLUS_LOST = re.compile(r"[Tt][0-9:.]+ [0-9]{2}:?[0-9]{2}$")
"""A time whose offset's + was read as a space, as in the query of a URL."""


def _require_full_time(value: object) -> object:
    if isinstance(value, str) and _PLUS_LOST.search(value):
        raise ValueError("has a space before its offset; in a URL write + as %2B, or give the time in UTC with a Z")
    number = str(value) if isinstance(value, int | float) else value
    if isinstance(number, str) and (unix := _UNIX.fullmatch(number)):
        unix_s = float(number) / (1000.0 if unix["ms"] else 1.0)
        written = f"{datetime.fromtimestamp(unix_s, UTC):%Y-%m-%dT%H:%M:%SZ}"
        raise ValueError(
            f"is a Unix time; write it as {written} (date -u -d @{unix_s:.0f} +%FT%TZ converts unix seconds)"
        )
    if isinstance(number, str) and "T" not in number.upper():
        raise ValueError(
            "is not a time with its date; write it as 2013-05-13T18:30:00Z (date -u -d @1368469800 +%FT%TZ converts "
            "unix seconds)"
        )
    return value


def _convert_to_utc(value: datetime) -> datetime:
    if value.year not in _YEARS:
        raise ValueError(f"lies outside the years {_YEARS.start} to {_YEARS.stop - 1}")
    return value.astimezone(UTC)


def _require_date(value: object) -> object:
    if isinstance(value, str) and not re.fullmatch(_YEARS_PATTERN + r"\d\d-\d\d", value):
        raise ValueError(f"is not a date as in 2013-05-13, of the years {_YEARS.start} to {_YEARS.stop - 1}")
    return value


Time = Annotated[
    AwareDatetime,
    BeforeValidator(_require_full_time),
    AfterValidator(_convert_to_utc),
    Field(description="RFC 3339, with its offset; answers are in UTC.", examples=["2013-05-13T18:30:00Z"]),
    Field(json_schema_extra={"pattern": _YEARS_PATTERN}),
]
SolarDate = Annotated[
    date,
    BeforeValidator(_require_date),
    Field(description="Local mean solar date.", examples=["2013-05-13"], json_schema_extra={"pattern": _DATE_PATTERN}),
]
_FINDINGS_SCHEMA = WithJsonSchema(
    {
        "type": "array",
        "items": {
            "type": "object",
            "required": ["code", "data"],
            "properties": {
                "code": {"type": "string"},
                "data": {"type": "object", "additionalProperties": {"type": ["number", "string", "null"]}},
            },
        },
    }
)
_FINDINGS_DESCRIBED = described(
    "The same, as codes with data (docs/codes.md).", [{"code": "day_arc_too_short", "data": {"arc_deg": 9.5}}]
)
Findings = Annotated[tuple[Finding, ...], _FINDINGS_SCHEMA, _FINDINGS_DESCRIBED]
# of a class whose fields refer to findings more than once: pydantic would add a component without descriptions
FindingsJson = Annotated[list[dict[str, Any]], _FINDINGS_SCHEMA, _FINDINGS_DESCRIBED]
EXAMPLE_TIME = "2013-05-13T18:30:00Z"
