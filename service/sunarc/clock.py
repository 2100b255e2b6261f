"""Time, injected: the only place that asks the machine what time it is."""

from __future__ import annotations

import threading
import time
from datetime import UTC, datetime, timedelta
from typing import Protocol


class Clock(Protocol):
    """Wall time, monotonic time and waiting."""

    def now(self) -> datetime:
        """Return the wall time, aware, UTC."""

    def monotonic(self) -> float:
        """Return seconds that never jump."""

    def wait(self, stop: threading.Event, seconds: float) -> bool:
        """Wait, at most `seconds`, and return whether `stop` was set."""


class SystemClock:
    """The machine's own clocks."""

    def now(self) -> datetime:
        """Return the wall time, aware, UTC."""
        return datetime.now(UTC)  # noqa: TID251 - this is the place

    def monotonic(self) -> float:
        """Return seconds that never jump."""
        return time.monotonic()  # noqa: TID251 - this is the place

    def wait(self, stop: threading.Event, seconds: float) -> bool:
        """Wait, at most `seconds`, and return whether `stop` was set."""
        return stop.wait(max(seconds, 0.0))


class VirtualClock:
    """A clock that moves only when someone waits on it or advances it.

    Parameters
    ----------
    start : the first wall time, aware.
    """

    def __init__(self, start: datetime) -> None:
        self._start = start
        self._elapsed_s = 0.0
        self._lock = threading.Lock()

    def now(self) -> datetime:
        """Return the wall time, aware, UTC."""
        return self._start + timedelta(seconds=self.monotonic())

    def monotonic(self) -> float:
        """Return the seconds advanced so far."""
        with self._lock:
            return self._elapsed_s

    def advance(self, seconds: float) -> None:
        """Move on by `seconds`."""
        with self._lock:
            self._elapsed_s += seconds

    def wait(self, stop: threading.Event, seconds: float) -> bool:
        """Advance by `seconds` at once and return whether `stop` is set."""
        if not stop.is_set():
            self.advance(max(seconds, 0.0))
        return stop.is_set()
