"""Whether the host's clock has agreed with monotonic time for long enough after a large step."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import datetime, timedelta

from sunarc.workers.timing.clock_steps import ClockReading

LARGE_STEP_S = 60.0
"""From this size on a step is no correction of a disciplined clock: a minute turns the sky by 0.25 degrees."""
SETTLE_S = 600.0
"""How long a clock must go without a large or gradual step afterwards; time services settle within minutes."""
IMPLAUSIBLE_SETTLE_S = 86_400.0
"""The same where the new time contradicts both the time before and the record: longer than a fault is left alone."""
_LONGEST_GAP = timedelta(days=2)
"""A service that ran until now has a newer sighting than this, unless the sky was covered."""


@dataclass(frozen=True, slots=True)
class _Settling:
    began_s: float
    wait_s: float


class ClockAgreement:
    """Remembers how the wall clock stood against the monotonic one, and from when on a new time is accepted."""

    def __init__(self) -> None:
        self._newest_stored: datetime | None = None
        self._good: ClockReading | None = None
        self._began_s: float | None = None
        self._settling: _Settling | None = None

    def wait_s(self, monotonic_s: float) -> float:
        """Return for how long the clock is still distrusted, seconds; 0 where it is not."""
        if self._settling is None:
            return 0.0
        return max(self._settling.began_s + self._settling.wait_s - monotonic_s, 0.0)

    def begin(self, reading: ClockReading, *, newest_stored: datetime | None, remaining_s: float) -> None:
        """Take the first reading of the process that can be compared with the record.

        Parameters
        ----------
        reading : wall time and monotonic time.
        newest_stored : the newest time in the record with a good clock; None without one.
        remaining_s : what is left of a wait that an earlier process began, seconds.
        """
        self._began_s, self._newest_stored = reading.monotonic_s, newest_stored
        if newest_stored is not None:
            gap = reading.wall - newest_stored
            if not -timedelta(seconds=LARGE_STEP_S) <= gap <= _LONGEST_GAP:  # not one service's end and start
                remaining_s = max(remaining_s, SETTLE_S)
        if remaining_s > self.wait_s(reading.monotonic_s):
            self._settling = _Settling(reading.monotonic_s, min(remaining_s, IMPLAUSIBLE_SETTLE_S))

    def stepped(self, reading: ClockReading) -> float:
        """Start the wait after a large or gradual step, and return its length in seconds."""
        wait_s = SETTLE_S if self._is_plausible(reading) else IMPLAUSIBLE_SETTLE_S
        self._settling = _Settling(reading.monotonic_s, wait_s)
        return wait_s

    def agreed(self, reading: ClockReading) -> None:
        """Take a reading of a clock that is synchronised; once settled, later steps are compared with it."""
        if self.wait_s(reading.monotonic_s) == 0.0:
            self._settling = None
            self._good = reading

    def _is_plausible(self, reading: ClockReading) -> bool:
        """Return whether a new time agrees with the last good one, or follows shortly on the record."""
        if self._good is None:
            return True  # nothing is known that it could contradict
        since_good = timedelta(seconds=reading.monotonic_s - self._good.monotonic_s)
        if abs((reading.wall - self._good.wall - since_good).total_seconds()) <= LARGE_STEP_S:
            return True
        if self._newest_stored is None or self._began_s is None:
            return False
        ran = timedelta(seconds=reading.monotonic_s - self._began_s)
        return self._newest_stored <= reading.wall <= self._newest_stored + ran + _LONGEST_GAP
