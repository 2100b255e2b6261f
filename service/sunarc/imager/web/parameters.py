"""Parameters that routes share: numbers, times, the choice of a calibration, pages of long lists."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from datetime import UTC, date, datetime, timedelta
from typing import Annotated, Any, TypeVar
from urllib.parse import parse_qsl, urlencode

from fastapi import Depends, Header, Path, Query, Request
from pydantic import BaseModel, ConfigDict, Field

from sunarc.calibration.answers.error_model import MOST_DRAWS
from sunarc.common.utc import MICROSECOND, from_microseconds, to_microseconds
from sunarc.imager.runtime.json_fields import EXAMPLE_TIME, Time, described

MOST_ROWS = 10_000
"""At most so many rows in one answer."""

Element = TypeVar("Element")
ListOf = Annotated[list[Element], Field(fail_fast=True)]
"""List of a request, read until its first error: a million errors would be a gigabyte."""
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
    """Body of a request; unknown names are refused."""

    model_config = ConfigDict(extra="forbid")


At = Annotated[Time | None, Query(description="Time to answer for; now if not given.", examples=[EXAMPLE_TIME])]
Draws = Annotated[
    int,
    Query(
        ge=0,
        le=MOST_DRAWS,
        description="Number of draws from the calibration's uncertainty to answer with in addition.",
        examples=[16],
    ),
]
Seed = Annotated[
    int, Query(ge=0, lt=2**32, description="Determines the draws, together with the calibration's id.", examples=[1])
]
Chosen = Annotated[
    str | None,
    Query(
        alias="calibration",
        max_length=100,
        description="Id of an accepted calibration to answer with, in place of the one valid at the time; "
        '"best": the one of the valid pose epoch with the smallest uncertainty.',
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
    """Return the dependency that bounds the rows of a page."""
    return Query(ge=1, le=most, description="Number of rows on a page, at most.", examples=[100])


Row = TypeVar("Row")
Cursor = Annotated[
    str | None,
    Query(
        pattern=r"^\d{1,16}-\d{1,4}$",
        description="Where a page begins, as the link `next` of the page before has it.",
        examples=["1368469800000000-1"],
    ),
]
_MOST_SKIPPED = 9999


@dataclass(frozen=True, slots=True, kw_only=True)
class Page:
    """A part of a list that is sorted by time, the newest first.

    Attributes
    ----------
    last : the time of the last row of the page before; None on the first page.
    skip : how many rows of exactly that time were on earlier pages.
    limit : rows on a page.
    """

    last: datetime | None
    skip: int
    limit: int

    @property
    def rows(self) -> int:
        """Number of rows to query: those of earlier pages, the page, and one that shows whether there are more."""
        return self.skip + self.limit + 1

    def until(self, requested: datetime | None) -> datetime | None:
        """Return the earlier of the client's `until` and just after the page before's last time; both exclusive."""
        return _choose_earlier(requested, None if self.last is None else self.last + MICROSECOND)

    def until_date(self, requested: date | None) -> date | None:
        """Return the earlier of the client's `until` and the day after the last date of the page before."""
        return _choose_earlier(requested, None if self.last is None else self.last.date() + timedelta(days=1))

    def cut(
        self, found: Sequence[Row], request: Request, *, time: Callable[[Row], date]
    ) -> tuple[Sequence[Row], str | None]:
        """Return the page's rows, and the link to the next page (None on the last one).

        Parameters
        ----------
        found : `rows` rows, fewer at the end of the list.
        request : the question, which the link repeats.
        time : returns a row's time, or date.
        """
        rows = found[self.skip : self.skip + self.limit]
        if len(found) < self.rows:
            return rows, None
        last = time(rows[-1])
        n_same_time = sum(time(row) == last for row in found[: self.skip + self.limit])
        query = [(name, value) for name, value in parse_qsl(request.url.query) if name != "cursor"]
        return rows, f"{request.url.path}?{urlencode([*query, ('cursor', _write_cursor(last, n_same_time))])}"


def page_at(cursor: str | None, limit: int) -> Page:
    """Return the page that a cursor names; the first one without a cursor."""
    if cursor is None:
        return Page(last=None, skip=0, limit=limit)
    microseconds, skip = cursor.split("-")
    return Page(last=from_microseconds(int(microseconds)), skip=int(skip), limit=limit)


def _write_cursor(last: date, n_same_time: int) -> str:
    time = last if isinstance(last, datetime) else datetime(last.year, last.month, last.day, tzinfo=UTC)
    return f"{to_microseconds(time)}-{min(n_same_time, _MOST_SKIPPED)}"


AnyDate = TypeVar("AnyDate", bound=date)


def _choose_earlier(a: AnyDate | None, b: AnyDate | None) -> AnyDate | None:
    return min((time for time in (a, b) if time is not None), default=None)


async def _describe_choice(_calibration: Chosen = None) -> None:
    """Describe the parameter; `ApiContext.of` reads it."""


BY_CALIBRATION = [Depends(_describe_choice)]
"""Dependencies of a route that answers with a calibration."""
