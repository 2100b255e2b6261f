"""Common parts of workers: a loop with stop and heartbeat, repeated attempts at work that fails, and a queue."""

from __future__ import annotations

import logging
import threading
from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import KW_ONLY, dataclass
from typing import Generic, NamedTuple, TypeVar

from sunarc.common.errors import OutsideError
from sunarc.imager.runtime.clock import Clock
from sunarc.imager.runtime.status import Reason, StatusRegistry

_log = logging.getLogger(__name__)
T = TypeVar("T")

_HEARTBEAT_S = 1.0
_QUEUE_S = 0.5


def turns(stop: threading.Event, heartbeat: Callable[[], None]) -> Iterator[None]:
    """Yield at every turn of a worker's loop, with a heartbeat, until it is stopped."""
    while not stop.is_set():
        heartbeat()
        yield


@dataclass(eq=False)
class Loop:
    """The loop of a worker's thread, which ends when it is stopped and beats at least every second while it waits.

    Parameters
    ----------
    clock : real time.
    stop : set when the loop is to end.
    heartbeat : called at every turn.
    """

    clock: Clock
    stop: threading.Event
    heartbeat: Callable[[], None]

    def turns(self) -> Iterator[None]:
        """Yield at every turn, until stopped."""
        return turns(self.stop, self.heartbeat)

    def wait(self, seconds: float) -> bool:
        """Wait with heartbeats, and return whether the loop was stopped; returns at once then."""
        end_s = self.clock.monotonic() + seconds
        for _ in self.turns():
            remaining_s = end_s - self.clock.monotonic()
            if remaining_s <= 0.0:
                return False
            self.clock.wait(self.stop, min(remaining_s, _HEARTBEAT_S))
        return True

    def repeat(self, work: Callable[[], float]) -> None:
        """Call `work` until stopped, each time after the number of seconds that it returned."""
        for _ in self.turns():
            self.wait(work())

    def every(self, seconds: float, work: Callable[[], None]) -> None:
        """Call `work` until stopped, with so many seconds between calls."""
        for _ in self.turns():
            work()
            self.wait(seconds)


def entries(queue: DropOldestQueue[T], stop: threading.Event, heartbeat: Callable[[], None]) -> Iterator[T | None]:
    """Yield the entries of a queue, None where none came for half a second; once stopped, until it is empty."""
    while True:
        heartbeat()
        entry = queue.get(timeout_s=_QUEUE_S)
        if entry is None and stop.is_set():
            return
        yield entry


class Pauses(NamedTuple):
    """Pauses between attempts, s: after a success, after the first failure, and the longest after many."""

    every_s: float
    longest_s: float

    def after(self, failures: int) -> float:
        """Return the pause after so many failures in a row: the first one, doubled after each, up to the longest."""
        return float(min(self.every_s * 2.0 ** min(max(failures - 1, 0), 30), self.longest_s))


@dataclass(eq=False)
class Attempts:
    """Work that may fail for causes outside: repeated after growing pauses, with a condition while it fails.

    Parameters
    ----------
    clock : real time.
    pauses : between the attempts.
    board, code : where the condition is set, and its code; cleared by success.
    reason : makes the condition of the error's text, and of the hours since the last success.
    after_s : for how long the work must have failed before that is a condition.
    """

    clock: Clock
    pauses: Pauses
    _: KW_ONLY
    board: StatusRegistry
    code: str
    reason: Callable[[str, float], Reason]
    after_s: float = 0.0

    def __post_init__(self) -> None:
        """Count from now on."""
        self._failures = 0
        self._succeeded_s = self.clock.monotonic()

    def attempt(self, work: Callable[[], float | None]) -> float:
        """Call `work`, and return the seconds until the next call: its own answer, or the usual pause.

        An `OutsideError` is a failure; any other error ends the loop.
        """
        try:
            pause_s = work()
        except OutsideError as error:
            return self.failed(str(error))
        self.succeeded()
        return self.pauses.every_s if pause_s is None else pause_s

    def failed(self, error: str) -> float:
        """Count a failure, set the condition where it has lasted, and return the pause after it."""
        _log.debug("%s: %s", self.code, error)
        self._failures += 1
        failing_s = self.clock.monotonic() - self._succeeded_s
        if failing_s >= self.after_s:
            self.board.set_condition(self.code, self.reason(error, failing_s / 3600.0))
        return self.pauses.after(self._failures)

    def answered(self) -> None:
        """Restart the time after which the condition is set: there was an answer, though perhaps no success."""
        self._succeeded_s = self.clock.monotonic()

    def succeeded(self) -> None:
        """Restart with the shortest pause, and clear the condition."""
        self._failures = 0
        self.answered()
        self.board.set_condition(self.code, None)


class DropOldestQueue(Generic[T]):
    """Queue between two threads; when full, the oldest entry is dropped and counted.

    Parameters
    ----------
    capacity : how many things may wait.
    """

    def __init__(self, *, capacity: int) -> None:
        self._waiting: deque[T] = deque()
        self._capacity = capacity
        self._changed = threading.Condition()
        self._dropped = 0

    def put(self, thing: T) -> None:
        """Add an entry without waiting; where the queue is full the oldest is dropped."""
        with self._changed:
            if len(self._waiting) >= self._capacity:
                self._waiting.popleft()
                self._dropped += 1
            self._waiting.append(thing)
            self._changed.notify()

    def get(self, *, timeout_s: float) -> T | None:
        """Return the oldest entry, or None where none came within `timeout_s` real seconds."""
        with self._changed:
            # One wait and no loop: a wake-up without an entry is to the caller a time-out that came early.
            if not self._waiting:
                self._changed.wait(timeout_s)
            return self._waiting.popleft() if self._waiting else None

    @property
    def dropped(self) -> int:
        """Number of entries dropped so far."""
        with self._changed:
            return self._dropped

    @property
    def full(self) -> bool:
        """True where the next `put` would drop an entry."""
        return len(self) >= self._capacity

    def __len__(self) -> int:
        with self._changed:
            return len(self._waiting)
