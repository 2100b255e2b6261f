"""The kinds of field that questions and answers are made of."""

from __future__ import annotations

import re
from datetime import UTC, date, datetime
from typing import Annotated

from pydantic import AfterValidator, AwareDatetime, BaseModel, BeforeValidator, ConfigDict, Field

MOST_ROWS = 10_000
"""At most so many rows in one answer."""

_YEARS = range(1970, 2200)
_YEARS_PATTERN = r"^(19[7-9]\d|2[01]\d\d)-"
_DATE_PATTERN = _YEARS_PATTERN + r"(0[1-9]|1[0-2])-(0[1-9]|[12]\d|3[01])$"


def _written_in_full(value: object) -> object:
    if isinstance(value, str) and "T" not in value.upper():
        raise ValueError("is not a time as in 2013-05-13T18:30:00Z")
    return value


def _in_utc(value: datetime) -> datetime:
    if value.year not in _YEARS:
        raise ValueError(f"lies outside the years {_YEARS.start} to {_YEARS.stop - 1}")
    return value.astimezone(UTC)


def _a_date(value: object) -> object:
    if isinstance(value, str) and not re.fullmatch(_YEARS_PATTERN + r"\d\d-\d\d", value):
        raise ValueError(f"is not a date as in 2013-05-13, of the years {_YEARS.start} to {_YEARS.stop - 1}")
    return value


Time = Annotated[
    AwareDatetime,
    BeforeValidator(_written_in_full),
    AfterValidator(_in_utc),
    Field(description="RFC 3339, with its offset; answers are in UTC.", examples=["2013-05-13T18:30:00Z"]),
    Field(json_schema_extra={"pattern": _YEARS_PATTERN}),
]
SolarDate = Annotated[
    date,
    BeforeValidator(_a_date),
    Field(description="Local mean solar date.", examples=["2013-05-13"], json_schema_extra={"pattern": _DATE_PATTERN}),
]
Number = Annotated[float, Field(strict=True, allow_inf_nan=False)]
Pixel = Annotated[
    list[Number], Field(min_length=2, max_length=2, description="x, y in px.", examples=[[871.96, 883.0]])
]
Vector = Annotated[
    list[Number],
    Field(
        min_length=3,
        max_length=3,
        description="East, north, up; of any length but 0.",
        json_schema_extra={"contains": {"not": {"const": 0}}},
    ),
]
Pair = Annotated[list[float], Field(min_length=2, max_length=2)]
Unit = Annotated[list[float], Field(min_length=3, max_length=3)]
Size = Annotated[list[int], Field(min_length=2, max_length=2)]
Answers = list[float | None]
Next = Annotated[
    str | None,
    Field(
        default=None,
        description="Link to the following page; null on the last.",
        examples=["/v1/events?limit=100&cursor=1368469800000000-1"],
    ),
]


class Asked(BaseModel):
    """What is asked; unknown names are refused."""

    model_config = ConfigDict(extra="forbid")
