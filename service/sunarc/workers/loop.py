"""What workers share: the queue between two of them, in which the newest always finds room."""

from __future__ import annotations

import threading
from collections import deque
from typing import Generic, TypeVar

T = TypeVar("T")


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
        """Add a thing; never waits."""
        with self._changed:
            if len(self._waiting) >= self._capacity:
                self._waiting.popleft()
                self._dropped += 1
            self._waiting.append(thing)
            self._changed.notify()

    def get(self, *, timeout_s: float) -> T | None:
        """Return the oldest thing waiting, or None when none came within `timeout_s` real seconds."""
        with self._changed:
            # One wait and no loop: a wake-up without an entry is to the caller a time-out that came early.
            if not self._waiting:
                self._changed.wait(timeout_s)
            return self._waiting.popleft() if self._waiting else None

    @property
    def dropped(self) -> int:
        """How many things were dropped so far."""
        with self._changed:
            return self._dropped

    @property
    def full(self) -> bool:
        """Whether the next thing put would push one out."""
        return len(self) >= self._capacity

    def __len__(self) -> int:
        with self._changed:
            return len(self._waiting)
