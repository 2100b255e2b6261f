"""The housekeeping: disk space and the camera's temperature, from the status into the archive."""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable
from datetime import UTC, datetime

from sunarc.archive.camera_archive import CameraArchive
from sunarc.archive.housekeeping_values import Housekeeping, merged
from sunarc.errors import OutsideError
from sunarc.runtime.clock import Clock
from sunarc.runtime.status import StatusRegistry

_log = logging.getLogger(__name__)
_SAMPLE_EVERY_S = 10.0
_STORE_EVERY_S = 600.0
"""A kill loses at most so much of an hour; 300 writes a day are a tenth of the sightings'."""
_MOST_WAITING = 1000
"""Hours that are held in memory while the disk is full; of more the oldest are dropped."""


class HousekeepingWorker:
    """Reads disk space and temperature off the status, and stores them by hour and by day.

    Parameters
    ----------
    camera : its archive.
    clock : real time.
    now : the frames' time; None while it cannot be trusted, and nothing is recorded.
    age_from : the time that the age of rows is counted from; None while none are to be removed.
    board : where disk and camera stand.
    """

    def __init__(
        self,
        *,
        camera: CameraArchive,
        clock: Clock,
        now: Callable[[], datetime | None],
        age_from: Callable[[], datetime | None],
        board: StatusRegistry,
    ) -> None:
        self._camera, self._clock, self._board = camera, clock, board
        self._now, self._age_from = now, age_from
        self._waiting: dict[datetime, Housekeeping] = {}
        self._stored_s = clock.monotonic()
        self._failed = False

    def run(self, stop: threading.Event, heartbeat: Callable[[], None]) -> None:
        """Sample until stopped, and store what is left."""
        while not stop.is_set():
            heartbeat()
            self.step()
            self._clock.wait(stop, _SAMPLE_EVERY_S)
        self.store()

    def step(self) -> None:
        """Sample once, and store when it is time."""
        now = self._now()
        if now is not None:
            self._sample(now)
        if self._clock.monotonic() - self._stored_s >= _STORE_EVERY_S or self._has_ended_hour():
            self.store()

    def _has_ended_hour(self) -> bool:
        """Whether an hour has just ended: a simulated one lasts seconds. What could not be stored waits its time."""
        return len(self._waiting) > 1 and not self._failed

    def _sample(self, now: datetime) -> None:
        snapshot = self._board.snapshot()
        disk, degrees = snapshot.disk, None if snapshot.camera is None else snapshot.camera.temperature_c
        if disk is None and degrees is None:
            return
        hour = now.astimezone(UTC).replace(minute=0, second=0, microsecond=0)
        sample = Housekeeping(
            time=hour,
            disk_free_bytes=None if disk is None else disk.free_bytes,
            images_bytes=None if disk is None else disk.images_bytes,
            temperature_c=degrees,
            temperature_min_c=degrees,
            temperature_max_c=degrees,
            n_temperatures=int(degrees is not None),
        )
        self._waiting[hour] = merged(sample, self._waiting.get(hour, Housekeeping(time=hour)), time=hour)
        while len(self._waiting) > _MOST_WAITING:
            del self._waiting[min(self._waiting)]

    def store(self) -> None:
        """Store what waits; where that fails it waits on."""
        self._stored_s = self._clock.monotonic()
        age_from = self._age_from()
        try:
            if self._waiting:
                self._camera.add_housekeeping(self._waiting.values())
                self._waiting.clear()
            if age_from is not None:
                self._camera.expire_housekeeping(now=age_from)
        except OutsideError as error:
            if not self._failed:
                _log.warning("could not store disk space and temperature, will retry: %s", error)
            self._failed = True
        else:
            self._failed = False
