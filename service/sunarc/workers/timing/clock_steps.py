"""Finding that a clock was set, from readings of it against monotonic time."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, replace
from datetime import datetime, timedelta

_WINDOWS_S = (60.0, 3600.0)
"""Times over which many small steps are added up."""
_SLEW = 500e-6
"""Rate of wall time against monotonic time that is no step: what a time service corrects a quartz by, piecemeal."""
_INTERVALS_KEPT = 64


@dataclass(frozen=True, slots=True, kw_only=True)
class ClockReading:
    """Wall time beside monotonic time, the two read within `within_s` of one another."""

    wall: datetime
    monotonic_s: float
    within_s: float


@dataclass(frozen=True, slots=True, kw_only=True)
class ClockStep:
    """A clock was set by `step_s` somewhere between two readings.

    Attributes
    ----------
    step_s : seconds, positive where it was set forward.
    at, found_s : when it was found, in wall time and in monotonic time.
    doubted : the intervals of wall time between the readings, by the clock before and after the step.
    gradual : made of many small steps, each too small to be found between two looks.
    """

    step_s: float
    at: datetime
    found_s: float
    doubted: tuple[tuple[datetime, datetime], ...]
    gradual: bool = False

    @property
    def within_s(self) -> float:
        """Seconds between the two readings."""
        return (self.doubted[0][1] - self.doubted[0][0]).total_seconds()

    def doubts(self, time: datetime) -> bool:
        """Return whether this wall time may be from either side of the step."""
        return any(since <= time <= until for since, until in self.doubted)


def step_between(before: ClockReading, now: ClockReading, *, least_s: float) -> ClockStep | None:
    """Return the step between two readings; None where there is none of more than `least_s`.

    A kernel that slews its clock slews its monotonic clock alike, so that their difference moves by steps alone.
    """
    elapsed = timedelta(seconds=now.monotonic_s - before.monotonic_s)
    step_s = (now.wall - before.wall - elapsed).total_seconds()
    if abs(step_s) <= least_s + before.within_s + now.within_s:
        return None
    return ClockStep(
        step_s=step_s,
        at=now.wall,
        found_s=now.monotonic_s,
        doubted=((before.wall, before.wall + elapsed), (now.wall - elapsed, now.wall)),
    )


class GradualSteps:
    """Finds steps that are too small to be found from one look to the next, by comparing readings far apart."""

    def __init__(self) -> None:
        self._anchors: dict[float, ClockReading] = {}

    def restart(self, reading: ClockReading) -> None:
        """Compare with this reading from now on: the clock was set, and that is known."""
        self._anchors = dict.fromkeys(_WINDOWS_S, reading)

    def step_to(self, reading: ClockReading, *, least_s: float) -> ClockStep | None:
        """Return the sum of the steps over a window that has ended with this reading; None where it is too small."""
        for window_s in _WINDOWS_S:
            anchor = self._anchors.setdefault(window_s, reading)
            elapsed_s = reading.monotonic_s - anchor.monotonic_s
            if elapsed_s < window_s:
                continue
            self._anchors[window_s] = reading
            step = step_between(anchor, reading, least_s=least_s + _SLEW * elapsed_s)
            if step is not None:
                self.restart(reading)
                return replace(step, gradual=True)
        return None


class UntrustedTimes:
    """Intervals of wall time in which the clock could not be trusted.

    A frame is dated when it is taken and its sighting stored later, perhaps when the clock is right again.
    """

    def __init__(self) -> None:
        self._intervals: deque[tuple[datetime, datetime]] = deque(maxlen=_INTERVALS_KEPT)
        self._growing = False

    def note(self, before: ClockReading | None, now: ClockReading, *, step: ClockStep | None, trusted: bool) -> None:
        """Take a look at the clock: its reading, the one before, the step between them, and whether it is trusted."""
        since = now.wall if before is None else before.wall
        if step is not None:
            if self._growing:
                self._grow(step.doubted[0][1])
            self._growing, since = False, step.doubted[1][0]
        if self._growing:
            self._grow(now.wall)
        elif not trusted:
            self._intervals.append((since, now.wall))
        self._growing = not trusted

    def _grow(self, until: datetime) -> None:
        self._intervals[-1] = (self._intervals[-1][0], until)

    def covers(self, time: datetime) -> bool:
        """Return whether a wall time is in an interval in which the clock could not be trusted."""
        return any(since <= time < until for since, until in self._intervals)
