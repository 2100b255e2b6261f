"""Write buffer of sightings; those that cannot be stored wait in memory."""

from __future__ import annotations

import logging
from collections import deque
from dataclasses import replace

from sunarc.archive.archive import Archive
from sunarc.archive.values import SunPoint
from sunarc.errors import OutsideError
from sunarc.runtime.clock import SystemClock
from sunarc.runtime.status import StatusRegistry
from sunarc.workers.messages import condition

_log = logging.getLogger(__name__)
_CAPACITY = 20_000  # a week of two a cycle, and 10 MB
_AT_A_TIME = 200
_CODE = "sightings_not_stored"
_SLOW = "database_slow"
_SLOW_S = 0.5
"""From here on a commit tells of a device that stalls; a sound one takes some milliseconds."""
_QUICK_STORES = 10
"""So many in a row end the condition: a device stalls now and then, not every time."""


class SightingWriteBuffer:
    """Stores sightings in the order they come, and those that could not be stored when it is possible again.

    Parameters
    ----------
    archive : where they go.
    board : where those that wait are shown.
    capacity : how many may wait; then the oldest is dropped.
    """

    def __init__(
        self,
        archive: Archive,
        *,
        board: StatusRegistry,
        capacity: int = _CAPACITY,
    ) -> None:
        self._monotonic = SystemClock().monotonic
        self._slowest_s = 0.0
        self._quick = 0
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

    def keep(self, point: SunPoint, *, store: bool = True) -> None:
        """Store a sighting, now or later; its pose epoch is found when it is stored.

        Parameters
        ----------
        point : the sighting.
        store : False leaves it to the next call of `keep` or `store`, so that several share a commit.
        """
        if len(self._waiting) >= self._capacity:
            self._waiting.popleft()
            self._lost += 1
        self._waiting.append(point)
        if store:
            self.store()

    def store(self) -> None:
        """Try to store what waits."""
        began_s = self._monotonic()
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
            self._note_duration(self._monotonic() - began_s)

    def give_up(self) -> None:
        """Log how many sightings are lost with the end of the process."""
        if self._waiting:
            _log.error("%d sightings could not be stored and are lost", len(self._waiting))

    def _note_duration(self, seconds: float) -> None:
        """Set the condition of a slow device, or clear it after stores that were quick."""
        self._quick = self._quick + 1 if seconds < _SLOW_S else 0
        if self._quick == 0:
            self._slowest_s = max(self._slowest_s, seconds)
            self._board.set_condition(_SLOW, condition(_SLOW, seconds=self._slowest_s))
        elif self._quick >= _QUICK_STORES:
            self._slowest_s = 0.0
            self._board.set_condition(_SLOW, None)

    def _placed(self, point: SunPoint) -> SunPoint:
        epoch = self._archive.epoch_at(point.camera, point.time, reason="first frame")
        return replace(point, pose_epoch=epoch.id)
