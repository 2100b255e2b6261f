"""Write buffer of sightings; those that cannot be stored wait in memory."""

from __future__ import annotations

import logging
from collections import deque
from dataclasses import replace

from sunarc.archive import Archive, SunPoint
from sunarc.errors import OutsideError
from sunarc.runtime.status import StatusRegistry
from sunarc.workers.messages import condition

_log = logging.getLogger(__name__)
_CAPACITY = 20_000  # a week of two a cycle, and 10 MB
_AT_A_TIME = 200
_CODE = "sightings_not_stored"


class SightingWriteBuffer:
    """Stores sightings in the order they come, and those that could not be stored when it is possible again.

    Parameters
    ----------
    archive : where they go.
    board : where those that wait are shown.
    capacity : how many may wait; then the oldest is dropped.
    """

    def __init__(self, archive: Archive, *, board: StatusRegistry, capacity: int = _CAPACITY) -> None:
        self._archive = archive
        self._board = board
        self._waiting: deque[SunPoint] = deque()
        self._capacity = capacity
        self._lost = 0
        self._stored = 0

    @property
    def waiting(self) -> int:
        """How many sightings wait."""
        return len(self._waiting)

    @property
    def stored(self) -> int:
        """How many sightings were stored so far."""
        return self._stored

    def keep(self, point: SunPoint) -> None:
        """Store a sighting, now or later; its pose epoch is found when it is stored."""
        if len(self._waiting) >= self._capacity:
            self._waiting.popleft()
            self._lost += 1
        self._waiting.append(point)
        self.store()

    def store(self) -> None:
        """Try to store what waits."""
        try:
            while self._waiting:
                some = [self._waiting[number] for number in range(min(len(self._waiting), _AT_A_TIME))]
                self._archive.add_sun_points([self._placed(point) for point in some])
                # Removed after the commit: a row that is stored twice is ignored, one that is dropped early is lost.
                for _ in some:
                    self._waiting.popleft()
                self._stored += len(some)
        except OutsideError as error:
            reason = condition(_CODE, waiting=len(self._waiting), lost=self._lost, error=str(error))
            self._board.set_condition(_CODE, reason)
        else:
            self._lost = 0
            self._board.set_condition(_CODE, None)

    def give_up(self) -> None:
        """Log how many sightings are lost with the end of the process."""
        if self._waiting:
            _log.error("%d sightings could not be stored and are lost", len(self._waiting))

    def _placed(self, point: SunPoint) -> SunPoint:
        epoch = self._archive.epoch_at(point.camera, point.time, reason="first frame")
        return replace(point, pose_epoch=epoch.id)
