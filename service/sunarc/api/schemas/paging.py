"""Long lists in pages: the newest first, each page with a link to the next."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from datetime import UTC, date, datetime, timedelta
from typing import Annotated, TypeVar
from urllib.parse import parse_qsl, urlencode

from fastapi import Query, Request

from sunarc.utc import MICROSECOND, from_microseconds, to_microseconds

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
        """How many rows to query: those of earlier pages, the page, and one that shows whether there are more."""
        return self.skip + self.limit + 1

    def until(self, requested: datetime | None) -> datetime | None:
        """Return the exclusive end of the times to query, given the client's `until`."""
        return _sooner(requested, None if self.last is None else self.last + MICROSECOND)

    def until_date(self, requested: date | None) -> date | None:
        """Return the exclusive end of the dates to query, given the client's `until`."""
        return _sooner(requested, None if self.last is None else self.last.date() + timedelta(days=1))

    def cut(
        self, found: Sequence[Row], request: Request, *, time: Callable[[Row], date]
    ) -> tuple[Sequence[Row], str | None]:
        """Return the page's rows, and the link to the next page (None on the last one).

        Parameters
        ----------
        found : `rows` rows, fewer at the end of the list.
        request : the question, which the link repeats.
        time : tells a row's time, or date.
        """
        rows = found[self.skip : self.skip + self.limit]
        if len(found) < self.rows:
            return rows, None
        last = time(rows[-1])
        n_same_time = sum(time(row) == last for row in found[: self.skip + self.limit])
        query = [(name, value) for name, value in parse_qsl(request.url.query) if name != "cursor"]
        return rows, f"{request.url.path}?{urlencode([*query, ('cursor', _written(last, n_same_time))])}"


def page_at(cursor: str | None, limit: int) -> Page:
    """Return the page that a cursor names; the first one without a cursor."""
    if cursor is None:
        return Page(last=None, skip=0, limit=limit)
    microseconds, skip = cursor.split("-")
    return Page(last=from_microseconds(int(microseconds)), skip=int(skip), limit=limit)


def _written(last: date, n_same_time: int) -> str:
    time = last if isinstance(last, datetime) else datetime(last.year, last.month, last.day, tzinfo=UTC)
    return f"{to_microseconds(time)}-{min(n_same_time, _MOST_SKIPPED)}"


Time = TypeVar("Time", bound=date)


def _sooner(a: Time | None, b: Time | None) -> Time | None:
    return min((time for time in (a, b) if time is not None), default=None)
