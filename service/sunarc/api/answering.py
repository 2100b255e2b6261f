"""Which calibration answers a request: one for all that it asks, or one for the time of each point."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from datetime import UTC, datetime

import numpy as np
from fastapi import Request

from sunarc.api.arrays import require_few
from sunarc.api.context import ApiContext
from sunarc.archive.values import CalibrationRecord
from sunarc.array_types import FloatArray, IntArray
from sunarc.calibration.model.direction_table import Lookup
from sunarc.errors import InputError, NotFoundError
from sunarc.sky.days import solar_days

_MOST_CALIBRATIONS = 8
"""Of one request with a time for each point: as many as are kept ready."""
_MOST_DAYS = 366
"""Solar days of such a request; each has a site of its own, with the air measured on it."""
_YEARS = (0.0, 7_258_118_400.0)
"""Times that are answered for, 1970 to 2199, s since 1970: those of the API's other times."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Answering:
    """What answers a question.

    Attributes
    ----------
    context : of the camera that was asked for.
    record : its calibration.
    ready : made ready.
    time : that was asked for; now by the frames' time where none was.
    each : what answers for the times of points; None where all points have one time.
    """

    context: ApiContext
    record: CalibrationRecord
    ready: Lookup
    time: datetime
    each: Timeline | None = None

    @property
    def calibrations(self) -> tuple[str, ...]:
        """Return the ids of the calibrations, in the order of time."""
        return (self.record.id,) if self.each is None else self.each.calibrations


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Timeline:
    """What answers for each of many times.

    Attributes
    ----------
    times : (m,) different times, rising, s since 1970.
    groups : (m,) which of `answers` does; a group has one calibration and one solar day.
    answers : in the order of time.
    asked : (n,) times of the points, as they were asked.
    """

    times: FloatArray
    groups: IntArray
    answers: tuple[Answering, ...]
    asked: FloatArray

    @property
    def calibrations(self) -> tuple[str, ...]:
        """Return the ids of the calibrations, in the order of time."""
        return tuple(dict.fromkeys(one.record.id for one in self.answers))

    def split(self, times: FloatArray) -> Iterator[tuple[Answering, IntArray]]:
        """Yield what answers for points of these times, and which points (indices)."""
        groups = self.groups[np.searchsorted(self.times, times)]
        for group in np.unique(groups).tolist():
            yield self.answers[group], np.flatnonzero(groups == group)

    def of_points(self) -> list[str]:
        """Return the id of the calibration that answers for each of the points."""
        names = [one.record.id for one in self.answers]
        return [names[group] for group in self.groups[np.searchsorted(self.times, self.asked)].tolist()]


def answering_at(context: ApiContext, request: Request, at: datetime | None) -> Answering:
    """Return what answers a request for one time, now where there is none."""
    selected, record = context.answering(request, at)
    return Answering(
        context=selected, record=record, ready=selected.ready.get(record), time=at or selected.frame_clock()
    )


def answering_each(context: ApiContext, request: Request, asked: FloatArray) -> Answering:
    """Return what answers a request whose points have times of their own; by itself it is that of the first time.

    Raises
    ------
    NotFoundError
        No calibration answers for one of the times.
    RefusedError
        (413) More than 8 calibrations answer, or the times lie on more than 366 solar days.
    InputError
        A time lies outside the years 1970 to 2199.
    """
    within = np.isfinite(asked) & (asked >= _YEARS[0]) & (asked < _YEARS[1])
    if not np.all(within):
        place = f"at[{int(np.argmin(within))}]"
        raise InputError(field=place, problem="lies outside the years 1970 to 2199", remedy="give s since 1970, UTC")
    selected, times = context.of(request), np.unique(asked)
    days = solar_days(times, longitude=selected.site.longitude)
    require_few(len(np.unique(days)), most=_MOST_DAYS, field="at", what="solar days")
    records = _records(selected, times, asked)
    changes = [k for k in range(len(times)) if k == 0 or days[k] != days[k - 1] or records[k] is not records[k - 1]]
    answers = tuple(
        Answering(context=selected, record=records[k], ready=selected.ready.get(records[k]), time=moment(times[k]))
        for k in changes
    )
    groups = np.searchsorted(np.array(changes), np.arange(len(times)), side="right") - 1
    each = Timeline(times=times, groups=groups, answers=answers, asked=asked)
    first = answers[groups[np.searchsorted(times, asked[0])]]
    return Answering(context=selected, record=first.record, ready=first.ready, time=moment(asked[0]), each=each)


def _records(context: ApiContext, times: FloatArray, asked: FloatArray) -> list[CalibrationRecord]:
    """Return what answers at each of rising times.

    A calibration answers for one interval of time (one that is made current again does so as a copy), so that what
    answers at two times answers between them.
    """
    found: dict[int, CalibrationRecord] = {}
    distinct: dict[str, CalibrationRecord] = {}

    def look(k: int) -> CalibrationRecord:
        if k not in found:
            record = context.record_or_none(moment(times[k]))
            if record is None:
                place = f"at[{int(np.flatnonzero(asked == times[k])[0])}]"
                problem = f"no calibration answers for {moment(times[k]).isoformat()}"
                raise NotFoundError(field=place, problem=problem, remedy="see /v1/calibrations for what there is")
            found[k] = distinct.setdefault(record.id, record)
            require_few(len(distinct), most=_MOST_CALIBRATIONS, field="at", what="calibrations")
        return found[k]

    spans = [(0, len(times) - 1)]
    while spans:
        low, high = spans.pop()
        if look(low) is look(high):
            found |= dict.fromkeys(range(low, high + 1), found[low])
        elif high - low > 1:
            middle = (low + high) // 2
            spans += [(low, middle), (middle, high)]
    return [found[k] for k in range(len(times))]


def moment(unix_s: float) -> datetime:
    """Return seconds since 1970 as a time."""
    return datetime.fromtimestamp(float(unix_s), UTC)
