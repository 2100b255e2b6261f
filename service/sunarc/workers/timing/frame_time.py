"""What time the frames say it is; dates sightings and days, never a timeout."""

from __future__ import annotations

import math
import threading
from collections import deque
from datetime import datetime, timedelta

from sunarc.errors import InputError
from sunarc.runtime.clock import Clock
from sunarc.utc import utc_time

_COMPARED = 4
"""Frames whose time is compared with the host's: a bracket, so that a sighting's own frame is among them."""


class FrameTime:
    """The host's wall clock, or the camera's disciplined clock carried on between its frames.

    Parameters
    ----------
    clock : the host's clocks.
    follows_camera : take the time from the frames.
    speed : seconds of frame time in a real second; other than 1 only for a simulated camera.
    """

    def __init__(self, clock: Clock, *, follows_camera: bool, speed: float = 1.0) -> None:
        if not follows_camera and speed != 1.0:
            raise InputError(
                field="capture.speed", problem="the host's clock runs at speed 1", remedy='set timestamps = "camera"'
            )
        self._clock = clock
        self._follows_camera = follows_camera
        self._speed = speed
        self._lock = threading.Lock()
        self._last: tuple[datetime, float] | None = None
        self._offsets_s: deque[float] = deque(maxlen=_COMPARED)

    @property
    def speed(self) -> float:
        """Seconds of frame time in a real second."""
        return self._speed

    def set_speed(self, speed: float) -> None:
        """Go on at another speed from now on; only a simulated camera changes it."""
        now, at = self.now(), self._clock.monotonic()
        with self._lock:
            if self._last is not None:
                self._last = (now, at)
            self._speed = speed

    @property
    def is_known(self) -> bool:
        """Whether the frame time is known: at once from the host, after the first frame from a camera."""
        return not self._follows_camera or self._last is not None

    def note(self, captured_at: datetime, *, host_offset_s: float | None = None) -> None:
        """Take the time from a frame just received.

        Parameters
        ----------
        captured_at : when its exposure ended.
        host_offset_s : the camera's time less the host's, seconds; None where the host dated the frame.
        """
        with self._lock:
            self._last = (captured_at, self._clock.monotonic())
            if host_offset_s is not None:
                self._offsets_s.append(host_offset_s)

    @property
    def host_offsets_s(self) -> tuple[float, ...]:
        """Camera time less host time of the last few frames, seconds; empty where they are not compared."""
        with self._lock:
            return tuple(self._offsets_s)

    def now(self) -> datetime:
        """Return the frame time, aware, UTC; the host's until the camera's is known."""
        with self._lock:
            last = self._last
        if not self._follows_camera or last is None:
            return self._clock.now()
        captured_at, at = last
        # Between frames the time goes on by the monotonic clock, which no time service sets.
        return captured_at + timedelta(seconds=(self._clock.monotonic() - at) * self._speed)

    def real_seconds_until(self, time: datetime) -> float:
        """Return how long to wait for a moment in frame time; negative when it is past."""
        return (time - self.now()).total_seconds() / self._speed

    def next_slot(self, *, every_s: float) -> datetime:
        """Return the next moment that is a whole multiple of `every_s` since 1970-01-01 UTC."""
        slots = math.floor(self.now().timestamp() / every_s) + 1
        return utc_time(slots * every_s)
