"""Writing of notices: what changed of each camera, into the store."""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable, Collection, Mapping
from dataclasses import replace

from sunarc.archive.archive import Archive
from sunarc.archive.notices import CameraState
from sunarc.runtime.clock import Clock
from sunarc.runtime.status import StatusRegistry
from sunarc.workers.messages import condition

_log = logging.getLogger(__name__)
_SETTLED_S = 60.0
"""For so long after the start a condition that is not set is not taken for one that has ended: workers begin anew."""
_MOST_WAITING = 100_000
"""Notices that are kept for receivers that do not take them: about 50 MB, and years of an imager's."""
_DROP_EVERY_S = 60.0
_OWN = "push_"
"""Beginning of the codes of conditions that concern receivers: sent to them, they would cause the next."""
OVERFLOW = "push_overflow"


class NoticeWorker:
    """Looks at every camera, writes notices of what changed, and keeps their states for receivers that show them.

    Parameters
    ----------
    archive : the store.
    states : returns how every camera is now, by name.
    sinks : names of the receivers.
    clock : real time.
    board : where notices that were lost are shown.
    every_s : seconds between two looks.
    """

    def __init__(
        self,
        *,
        archive: Archive,
        states: Callable[[], Mapping[str, CameraState]],
        sinks: Collection[str],
        clock: Clock,
        board: StatusRegistry,
        every_s: float,
    ) -> None:
        self._archive, self._states, self._sinks = archive, states, sinks
        self._clock, self._board, self._every_s = clock, board, every_s
        self._started_s = self._dropped_s = clock.monotonic()
        self._named = False
        self.latest: Mapping[str, CameraState] = {}

    def run(self, stop: threading.Event, heartbeat: Callable[[], None]) -> None:
        """Look until stopped."""
        while not stop.is_set():
            self.step()
            heartbeat()
            self._clock.wait(stop, self._every_s)

    def step(self) -> None:
        """Look once."""
        if not self._named:
            self._archive.name_sinks(self._sinks)
            self._named = True
        clears = self._clock.monotonic() - self._started_s >= _SETTLED_S
        latest: dict[str, CameraState] = {}
        for camera, state in self._states().items():
            reported = {code: data for code, data in state.conditions.items() if not code.startswith(_OWN)}
            held = self._archive.record_notices(camera, reported, now=self._clock.now(), clears=clears)
            latest[camera] = replace(state, conditions=held)
        self.latest = latest
        if self._clock.monotonic() - self._dropped_s >= _DROP_EVERY_S:
            self._dropped_s = self._clock.monotonic()
            self._drop()

    def _drop(self) -> None:
        lost = self._archive.drop_notices(most=_MOST_WAITING)
        if lost:
            _log.error("removed %d messages that a receiver did not take for too long", lost)
            self._board.set_condition(OVERFLOW, condition(OVERFLOW, lost=lost, most=_MOST_WAITING))
