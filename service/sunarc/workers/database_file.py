"""The database while the service runs: recovery of its file, and whether it has room."""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable
from datetime import datetime

from sunarc.archive.archive import Archive
from sunarc.archive.recovery import Recovery
from sunarc.archive.values import Event
from sunarc.errors import OutsideError, StoreFullError
from sunarc.findings import Finding
from sunarc.runtime.clock import Clock
from sunarc.runtime.status import Reason, StatusRegistry
from sunarc.workers.messages import MESSAGES, condition

_log = logging.getLogger(__name__)
_EVERY_S = 2.0
_MISSING = "database_missing"
_FULL = "store_full"


class DatabaseWorker:
    """Checks periodically that the database's file is the one that was opened, and restores it where it is not.

    Parameters
    ----------
    archive : whose file.
    clock : real time.
    now : frame time, which dates events.
    board : where a lost database is shown.
    recovered : what was done about a lost database at the start; None when it was in place.
    """

    def __init__(
        self,
        *,
        archive: Archive,
        clock: Clock,
        now: Callable[[], datetime],
        board: StatusRegistry,
        recovered: Recovery | None = None,
    ) -> None:
        self._archive = archive
        self._clock = clock
        self._now = now
        self._board = board
        self._unreported = recovered
        if recovered is not None:
            _publish(board, recovered)

    def run(self, stop: threading.Event, heartbeat: Callable[[], None]) -> None:
        """Check until stopped."""
        while not stop.is_set():
            heartbeat()
            self.check()
            self._clock.wait(stop, _EVERY_S)

    def check(self) -> None:
        """Check once."""
        try:
            done = self._archive.recover(now=self._clock.now())
        except OutsideError as error:
            self._board.set_condition(_MISSING, condition(_MISSING, error=str(error)))
            return
        self._board.set_condition(_MISSING, None)
        if done is not None:
            self._unreported = done
            _publish(self._board, done)
        self._report()

    def _report(self) -> None:
        """Write the event of a recovery, as soon as it can be written."""
        if self._unreported is None:
            return
        event = Event.of(_finding(self._unreported), MESSAGES, time=self._now(), severity="alarm")
        try:
            self._archive.add_event(event)
        except OutsideError as error:
            _log.error("could not store the event %s: %s", event.kind, error)
        else:
            self._unreported = None


def _finding(done: Recovery) -> Finding:
    return Finding(f"database_{done.kind}", {"text": done.text})


def _publish(board: StatusRegistry, done: Recovery) -> None:
    reason = Reason.of(_finding(done), MESSAGES)
    board.set_condition(reason.code, reason, log=False)


class StoreRoomWorker:
    """Checks whether a hub's database can store a row, and shows where its disk is full.

    Parameters
    ----------
    archive : the hub's.
    clock : real time.
    board : where a full disk is shown.
    """

    def __init__(self, *, archive: Archive, clock: Clock, board: StatusRegistry) -> None:
        self._archive = archive
        self._clock = clock
        self._board = board

    def run(self, stop: threading.Event, heartbeat: Callable[[], None]) -> None:
        """Check until stopped."""
        while not stop.is_set():
            heartbeat()
            self.check()
            self._clock.wait(stop, _EVERY_S)

    def check(self) -> None:
        """Check once; where the database does not answer, nothing is known of its disk."""
        try:
            self._archive.require_room(now=self._clock.now())
        except StoreFullError as error:
            self._board.set_condition(_FULL, condition(_FULL, severity="not_ready", error=str(error)))
        except OutsideError as error:
            _log.debug("not known whether there is room: %s", error)
        else:
            self._board.set_condition(_FULL, None)
