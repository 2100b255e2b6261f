"""Since when conditions hold, from the status into the archive, so that a restart goes on with it."""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable, Collection, Mapping
from datetime import datetime, timedelta

from sunarc.archive.archive import Archive
from sunarc.errors import OutsideError
from sunarc.runtime.clock import Clock
from sunarc.runtime.status import StatusRegistry

_log = logging.getLogger(__name__)
_LOOK_EVERY_S = 10.0
_LEAST_HELD = timedelta(seconds=60)
"""A condition that holds for less is not stored: one that comes and goes would be written at every cycle."""
SETTLED_S = 900.0
"""For so long after the start a stored condition that is not set may come back: some need ten slots to be found."""


class ConditionTimesWorker:
    """Stores since when conditions hold, and hands the status what the store has at the start.

    Parameters
    ----------
    archive : the store.
    camera : whose conditions; "" for the hub's own.
    board : where conditions are set.
    clock : real time.
    passing : codes that say something of this run of the service alone.
    """

    def __init__(
        self, *, archive: Archive, camera: str, board: StatusRegistry, clock: Clock, passing: Collection[str] = ()
    ) -> None:
        self._archive, self._camera, self._passing = archive, camera, frozenset(passing)
        self._board, self._clock = board, clock
        self._settled_s = clock.monotonic() + SETTLED_S
        self._failed = False
        self._stored: Mapping[str, datetime] | None = None
        self._resume()

    def run(self, stop: threading.Event, heartbeat: Callable[[], None]) -> None:
        """Look until stopped."""
        while not stop.is_set():
            heartbeat()
            self.step()
            self._clock.wait(stop, _LOOK_EVERY_S)

    def step(self) -> None:
        """Look once, and store what changed; where that fails it is tried again at the next look."""
        if self._stored is None:
            self._resume()
        if self._stored is None:
            return
        held = self._held(self._stored)
        if held == self._stored:
            return
        try:
            self._archive.save_condition_times(self._camera, held)
        except OutsideError as error:
            self._complain("could not store since when conditions hold, will retry: %s", error)
        else:
            self._stored, self._failed = held, False

    def _resume(self) -> None:
        try:
            self._stored = self._archive.condition_times(self._camera)
        except OutsideError as error:
            self._complain("could not read since when conditions hold, will retry: %s", error)
        else:
            self._board.resume(self._stored, within_s=self._settled_s - self._clock.monotonic())

    def _complain(self, text: str, error: OutsideError) -> None:
        if not self._failed:
            _log.warning(text, error)
        self._failed = True

    def _held(self, stored: Mapping[str, datetime]) -> dict[str, datetime]:
        now = self._clock.now()
        present = {reason.code: reason.since for reason in self._board.snapshot().reasons if reason.since is not None}
        lasting = {
            code: since
            for code, since in present.items()
            if code not in self._passing and (code in stored or now - since >= _LEAST_HELD)
        }
        return {**self._board.awaited(), **lasting}
