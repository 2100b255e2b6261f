"""Sending of the outbox to a hub: in order, as long as it takes, and never in the way of the measurements."""

from __future__ import annotations

import logging
import math
import threading
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from http import HTTPStatus
from typing import Any

from sunarc.archive.camera_archive import CameraArchive
from sunarc.archive.feed_values import FeedRow
from sunarc.archive.outbox import OutboxPosition
from sunarc.errors import OutsideError
from sunarc.runtime.clock import Clock
from sunarc.runtime.status import StatusRegistry
from sunarc.utc import rfc3339
from sunarc.workers.feeding.hub_connection import HubRefusal, HubUnfinishedError, Send
from sunarc.workers.messages import condition

_log = logging.getLogger(__name__)
_POLL_S = 1.0  # the heartbeat's
_MOST_ROWS = 1000
_QUICK_S = 7.5
"""An exchange that took no longer, a quarter of what it may take, shows that the next may have twice the rows."""
_MOST_BYTES = 1_000_000  # of JSON, a tenth of that on the way
_STATUS_EVERY_S = 60.0
_LONGEST_WAIT_S = 60.0
_SILENT_S = 900.0
"""A hub that was not reached for so long is a condition; a network that is lost for minutes is none."""
_UNREACHABLE, _REFUSED = "hub_unreachable", "hub_refuses"


class FeedWorker:
    """Sends what the outbox holds, and forgets it when the hub has it.

    Parameters
    ----------
    camera : whose archive.
    send : sends rows.
    clock : real time.
    board : whose status the hub gets, and where a hub that does not answer is shown.
    every_s : seconds between two looks at the outbox.
    """

    def __init__(
        self, *, camera: CameraArchive, send: Send, clock: Clock, board: StatusRegistry, every_s: float = 5.0
    ) -> None:
        self._camera = camera
        self._archive = camera.archive
        self._send = send
        self._clock = clock
        self._board = board
        self._every_s = every_s
        self._most_rows = _MOST_ROWS
        self._failures = 0
        self._reached_s = clock.monotonic()
        self._status_s = -math.inf
        self._enabled = False

    def run(self, stop: threading.Event, heartbeat: Callable[[], None]) -> None:
        """Send until stopped."""
        while not stop.is_set():
            until_s = self._clock.monotonic() + self.step(heartbeat)
            heartbeat()
            while not stop.is_set() and self._clock.monotonic() < until_s:
                self._clock.wait(stop, min(_POLL_S, max(until_s - self._clock.monotonic(), 0.0)))
                heartbeat()

    def step(self, heartbeat: Callable[[], None]) -> float:
        """Send once, and return the seconds until the next time."""
        try:
            more = self._send_next(heartbeat)
        except OutsideError as error:
            _log.debug("not sent to the hub: %s", error)
            return self._failed(str(error))
        except HubRefusal as refusal:
            return self._refused(refusal)
        self._failures, self._reached_s = 0, self._clock.monotonic()
        self._board.set_condition(_UNREACHABLE, None)
        self._board.set_condition(_REFUSED, None)
        return 0.0 if more else self._every_s

    def _send_next(self, heartbeat: Callable[[], None]) -> bool:
        """Send the next rows, if there are any, and return whether there may be more."""
        if not self._enabled:
            if self._archive.enable_outbox():
                _log.info("all rows of the archive are queued for the hub")
            self._enabled = True
        if self._clock.monotonic() - self._status_s >= _STATUS_EVERY_S:
            self._archive.queue_status(self._status())
            self._status_s = self._clock.monotonic()
        position = self._archive.outbox_position()
        rows = self._archive.outbox_rows(most=self._most_rows, most_bytes=_MOST_BYTES)
        if not rows:
            return False
        # Before they are sent: a database that is put back to before this knows less than the hub, and finds it out.
        self._archive.mark_sent(rows[-1].seq)
        self._follow(position, rows, self._sent(position, rows, heartbeat))
        return True

    def _sent(self, position: OutboxPosition, rows: Sequence[FeedRow], heartbeat: Callable[[], None]) -> int:
        """Send rows, the next time fewer where they took too long or were too large, and more where it was quick.

        One that is too large for the hub goes as its number alone, and the hub sets that apart.
        """
        begun_s = self._clock.monotonic()
        try:
            committed = self._send(position, rows, heartbeat)
        except HubUnfinishedError:
            self._most_rows = max(len(rows) // 2, 1)
            raise
        except HubRefusal as refusal:
            if refusal.status != HTTPStatus.REQUEST_ENTITY_TOO_LARGE or (len(rows) == 1 and rows[0].data is None):
                raise
            if len(rows) > 1:
                self._most_rows = max(len(rows) // 2, 1)
                return self._sent(position, rows[: self._most_rows], heartbeat)
            committed = self._send(position, [replace(rows[0], data=None)], heartbeat)
        if self._clock.monotonic() - begun_s <= _QUICK_S:
            self._most_rows = min(2 * self._most_rows, _MOST_ROWS)
        return committed

    def _follow(self, position: OutboxPosition, rows: Sequence[FeedRow], committed: int) -> None:
        """Do what the hub's number asks for."""
        if committed < position.committed:
            _log.warning(
                "the hub has rows up to %d, and had them up to %d: all go again", committed, position.committed
            )
            self._archive.send_again(committed=committed)
        elif committed > max(rows[-1].seq, position.sent):
            former, new = position.installation, self._archive.begin_installation()
            _log.warning("the hub has later rows of installation %s than were sent: going on as %s", former, new)
        elif committed == position.committed:
            raise OutsideError(f"the hub took nothing of {len(rows)} rows")
        else:
            self._archive.acknowledge(committed)

    def _failed(self, text: str) -> float:
        self._failures += 1
        silent_s = self._clock.monotonic() - self._reached_s
        if silent_s >= _SILENT_S:
            reason = condition(_UNREACHABLE, hours=round(silent_s / 3600.0, 1), error=text)
            self._board.set_condition(_UNREACHABLE, reason)
        return float(min(self._every_s * 2.0 ** min(self._failures - 1, 10), _LONGEST_WAIT_S))

    def _refused(self, refusal: HubRefusal) -> float:
        """Show a refusal: the hub answers, and an operator has to do something. It is tried again all the same."""
        self._reached_s = self._clock.monotonic()
        self._board.set_condition(_REFUSED, condition(_REFUSED, status=refusal.status, error=str(refusal)))
        return self._failed(str(refusal))

    def _status(self) -> Mapping[str, Any]:
        """Return what the fleet page shows of this imager."""
        board = self._board.snapshot()
        days = self._camera.days(limit=1)
        offset = days[0].pose_offset_deg if days else None
        return {
            "version": board.version,
            "health": board.health,
            "conditions": [reason.code for reason in board.reasons],
            "disk_free_bytes": None if board.disk is None else board.disk.free_bytes,
            "clock_synchronised": None if board.clock is None else board.clock.synchronised,
            "clock_error_s": None if board.clock is None else board.clock.max_error_s,
            "last_frame_at": None if board.last_frame_at is None else rfc3339(board.last_frame_at),
            "drift_deg": None if offset is None else math.hypot(*offset),
        }
