"""The kinds of field that questions and answers are made of."""

from __future__ import annotations

from typing import Annotated, Any

from fastapi import Header, Path, Query
from pydantic import BaseModel, ConfigDict, Field

from sunarc.calibration.ensemble import MOST_DRAWS
from sunarc.json_fields import EXAMPLE_TIME, Time, described

MOST_ROWS = 10_000
"""At most so many rows in one answer."""

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
AnsweringId = Annotated[
    str | None, described("Id of the calibration that answered; null without one.", "20130514T150508Z-52ee44")
]
Next = Annotated[
    str | None,
    Field(
        default=None,
        description="Link to the following page; null on the last.",
        examples=["/v1/events?limit=100&cursor=1368469800000000-1"],
    ),
]


class Body(BaseModel):
    """What is asked; unknown names are refused."""

    model_config = ConfigDict(extra="forbid")


At = Annotated[Time | None, Query(description="The time to answer for; now where not given.", examples=[EXAMPLE_TIME])]
Draws = Annotated[
    int,
    Query(
        ge=0,
        le=MOST_DRAWS,
        description="Draws of an ensemble of possible truths to answer with too, as likely as the uncertainty says.",
        examples=[16],
    ),
]
Seed = Annotated[
    int, Query(ge=0, lt=2**32, description="With the calibration's id it decides the draws.", examples=[1])
]
Chosen = Annotated[
    str | None,
    Query(
        alias="calibration",
        max_length=100,
        description="Id of an accepted calibration to answer with, whatever answers at the time; "
        '"best": the least uncertain one of the pose epoch that answers.',
        examples=["best"],
    ),
]
Since = Annotated[Time | None, Query(description="From then on.", examples=[EXAMPLE_TIME])]
Until = Annotated[Time | None, Query(description="Before then.", examples=[EXAMPLE_TIME])]
IfNoneMatch = Annotated[
    str | None,
    Header(description="An ETag received before: what it names is not sent again.", examples=['"9f86d081884c7d65"']),
]
CalibrationId = Annotated[
    str, Path(description="Id of a calibration, as /v1/calibrations lists them.", examples=["20130514T150508Z-52ee44"])
]


def row_limit(most: int = MOST_ROWS) -> Any:  # noqa: ANN401 - as FastAPI's Query
    """Return what says how many rows a page may have."""
    return Query(ge=1, le=most, description="Number of rows on a page, at most.", examples=[100])
