"""Finding that a clock was set, from readings of it against monotonic time."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import datetime, timedelta


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
    doubted : the intervals of wall time that the clock told between the readings, as it went before and after.
    """

    step_s: float
    at: datetime
    found_s: float
    doubted: tuple[tuple[datetime, datetime], ...]

    @property
    def within_s(self) -> float:
        """Seconds between the two readings."""
        return (self.doubted[0][1] - self.doubted[0][0]).total_seconds()

    def doubts(self, moment: datetime) -> bool:
        """Return whether it is open on which side of the step this wall time was told."""
        return any(since <= moment <= until for since, until in self.doubted)


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
