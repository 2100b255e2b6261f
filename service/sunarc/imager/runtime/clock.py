"""Time, injected: the only place that asks the machine for the time."""

from __future__ import annotations

import ctypes
import threading
import time
from dataclasses import dataclass
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

    def state(self) -> ClockState:
        """Return how far the wall time can be trusted."""


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

    def state(self) -> ClockState:
        """Return the kernel's state of its clock."""
        return host_clock_state()


class VirtualClock:
    """A clock that moves only when someone waits on it or advances it, with a real clock's faults on demand.

    Parameters
    ----------
    start : the first wall time, aware.
    """

    def __init__(self, start: datetime) -> None:
        self._start = start
        self._elapsed_s = 0.0
        self._stepped_s = 0.0
        self._state = ClockState(synchronised=True, error_bound_s=0.01)
        self._lock = threading.Lock()

    def now(self) -> datetime:
        """Return the wall time, aware, UTC."""
        with self._lock:
            return self._start + timedelta(seconds=self._elapsed_s + self._stepped_s)

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

    def step(self, seconds: float) -> None:
        """Set the wall time forward (or back), as an administrator or a time service does; monotonic time goes on."""
        with self._lock:
            self._stepped_s += seconds

    def state(self) -> ClockState:
        """Return the state that `set_state` set last; at first, synchronised to within 10 ms."""
        with self._lock:
            return self._state

    def set_state(self, state: ClockState) -> None:
        """Set the state that `state` returns from now on."""
        with self._lock:
            self._state = state


@dataclass(frozen=True, slots=True, kw_only=True)
class ClockState:
    """Trust in the host's clock.

    Attributes
    ----------
    synchronised : whether the kernel's clock is disciplined by a time service.
    error_bound_s : the kernel's bound on its error, seconds; it says nothing about a clock that is not synchronised.
    leap_second : whether the kernel is inserting or deleting a leap second, or has just done so.
    """

    synchronised: bool
    error_bound_s: float
    leap_second: bool = False


class _Timex(ctypes.Structure):
    """`struct timex` of adjtimex(2) on 64-bit Linux, up to the fields read here; the rest is room for the kernel."""

    _fields_ = (
        ("modes", ctypes.c_uint),
        ("offset", ctypes.c_long),
        ("freq", ctypes.c_long),
        ("maxerror", ctypes.c_long),
        ("esterror", ctypes.c_long),
        ("status", ctypes.c_int),
        ("rest", ctypes.c_long * 32),
    )


_STA_UNSYNC = 0x0040
_TIME_OOP, _TIME_WAIT, _TIME_ERROR = 3, 4, 5


def host_clock_state() -> ClockState:
    """Ask the kernel whether its clock is synchronised, and within which bound (adjtimex(2), reading only)."""
    timex = _Timex(modes=0)
    answer = ctypes.CDLL(None, use_errno=True).adjtimex(ctypes.byref(timex))
    synchronised = answer not in {-1, _TIME_ERROR} and not timex.status & _STA_UNSYNC
    return ClockState(
        synchronised=synchronised,
        error_bound_s=timex.maxerror * 1e-6,
        leap_second=answer in {_TIME_OOP, _TIME_WAIT},
    )
