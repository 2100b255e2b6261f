"""The feed of an imager: rows of its archive, sent to a hub."""

from __future__ import annotations

import logging
import math
import threading
import uuid
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from http import HTTPStatus
from typing import Any

from sunarc.common.utc import rfc3339
from sunarc.imager.archive.archive import CameraArchive
from sunarc.imager.archive.feed_rows import FeedRow
from sunarc.imager.archive.outbox import OutboxPosition
from sunarc.imager.runtime.clock import Clock
from sunarc.imager.runtime.loop import Attempts, Loop, Pauses
from sunarc.imager.runtime.status import StatusRegistry, condition
from sunarc.imager.workers.feed_comparison import FeedComparison
from sunarc.imager.workers.hub_connection import AskStoredDays, HubAnswerError, HubRefusal, HubUnfinishedError, Send

_log = logging.getLogger(__name__)
_MOST_ROWS = 1000
_QUICK_S = 7.5
"""An exchange that took no longer, a quarter of what it may take, shows that the next may have twice the rows."""
_MOST_BYTES = 1_000_000  # of JSON, a tenth of that on the way
_STATUS_EVERY_S = 60.0
LONGEST_WAIT_S = 60.0
SILENT_S = 900.0
"""A hub that was not reached for so long is a condition; a network that is lost for minutes is none."""
_UNREACHABLE, _REFUSED, _INVALID = "hub_unreachable", "hub_refuses", "hub_answer_invalid"


@dataclass(kw_only=True, eq=False)
class FeedWorker:
    """Sends what the outbox holds, and forgets it when the hub has it.

    Parameters
    ----------
    camera : whose archive.
    send : sends rows.
    ask : asks what the hub has.
    clock : real time.
    board : whose status the hub gets, and where a hub that does not answer is shown.
    every_s : seconds between two looks at the outbox.
    asked_s : returns for how many seconds more the hub asks to wait.
    """

    camera: CameraArchive
    send: Send
    ask: AskStoredDays
    clock: Clock
    board: StatusRegistry
    every_s: float = 5.0
    asked_s: Callable[[], float] = lambda: 0.0

    def __post_init__(self) -> None:
        """Begin with as many rows as are ever sent at once."""
        self._most_rows = _MOST_ROWS
        self._attempts = Attempts(
            self.clock,
            Pauses(self.every_s, LONGEST_WAIT_S),
            board=self.board,
            code=_UNREACHABLE,
            reason=lambda error, hours: condition(_UNREACHABLE, hours=round(hours, 1), error=error),
            after_s=SILENT_S,
        )
        self._status_s = -math.inf
        self._agreed: OutboxPosition | None = None
        """Where the outbox stood when the hub last said that it stands there, too; None until it has."""
        self._next_installation = uuid.uuid4().hex
        self._comparison = FeedComparison(camera=self.camera, ask=self.ask, clock=self.clock, board=self.board)

    def run(self, stop: threading.Event, heartbeat: Callable[[], None]) -> None:
        """Send until stopped."""
        Loop(self.clock, stop, heartbeat).repeat(partial(self.step, heartbeat))

    def step(self, heartbeat: Callable[[], None]) -> float:
        """Send once, and return the seconds until the next time: no less than the hub asks for."""
        try:
            pause_s = self._attempts.attempt(partial(self._send_some, heartbeat))
        except HubRefusal as refusal:  # the hub answers, and an operator has to do something; it is tried all the same
            self._attempts.answered()
            self.board.set_condition(_REFUSED, condition(_REFUSED, status=refusal.status, error=str(refusal)))
            pause_s = self._attempts.failed(str(refusal))
        return max(pause_s, self.asked_s())

    def _send_some(self, heartbeat: Callable[[], None]) -> float | None:
        try:
            more = self._send_next(heartbeat)
        except HubAnswerError as error:
            self.board.set_condition(_INVALID, condition("hub_answer_invalid", error=str(error)))
            raise
        self.board.set_condition(_REFUSED, None)
        self.board.set_condition(_INVALID, None)
        return 0.0 if more else None

    def _send_next(self, heartbeat: Callable[[], None]) -> bool:
        """Send the next rows, if there are any, and return whether there may be more."""
        outbox = self.camera.archive.outbox
        if self.clock.monotonic() - self._status_s >= _STATUS_EVERY_S:
            if outbox.enable():  # also when the database was put together anew, which takes its triggers away
                _log.info("all rows of the archive are queued for the hub")
            outbox.queue_status(self._status())
            self._status_s = self.clock.monotonic()
        if self._agreed is None or outbox.position() != self._agreed:
            self._agree(heartbeat)
            if self.asked_s() > 0.0:
                return False
        position, self._agreed = self._agreed, None
        rows = () if position is None else outbox.rows_to_send(position, most=self._most_rows, most_bytes=_MOST_BYTES)
        if position is None or rows is None:
            return True  # the database was put back meanwhile
        if rows:
            self._follow(position, self._sent(position, rows, heartbeat), heartbeat)
        self._agreed = outbox.position()
        return bool(rows) or self._comparison.queue_differing(heartbeat)

    def _agree(self, heartbeat: Callable[[], None]) -> None:
        """Ask the hub where it stands, and go on from there.

        Until it has answered no number counts as sent: a database that was put back to an earlier copy knows of less
        than the hub has, however long the hub is away.
        """
        outbox = self.camera.archive.outbox
        position = outbox.position()
        committed = self.send(replace(position, committed=-1), (), heartbeat)
        if committed > position.sent:
            self._begin_anew(position, committed, heartbeat)
        elif committed > position.committed:
            self._acknowledge(committed)
        elif committed < position.committed:
            _log.warning(
                "the hub has rows up to %d, and had them up to %d: all go again", committed, position.committed
            )
            outbox.send_again(committed=committed)
        self._agreed = outbox.position()

    def _begin_anew(self, position: OutboxPosition, committed: int, heartbeat: Callable[[], None]) -> None:
        """Go on under a new id, with all rows: the hub has rows of this one that were never sent from here.

        A hub has nothing under the new id, and wants an operator to accept it; another answer is no hub's.
        """
        new = OutboxPosition(installation=self._next_installation, committed=-1, sent=0)
        refused = None
        try:
            found = self.send(new, (), heartbeat)
        except HubRefusal as refusal:
            if refusal.status != HTTPStatus.CONFLICT:
                raise
            found, refused = 0, refusal
        if found != 0:
            raise HubAnswerError(f"the number {committed} of rows that were not sent, and {found} for a new sender")
        self.camera.archive.outbox.begin_installation(new.installation)
        self._next_installation = uuid.uuid4().hex
        _log.warning(
            "the hub has rows up to %d of installation %s, of which %d were sent from here: going on as %s",
            *(committed, position.installation, position.sent, new.installation),
        )
        if refused is not None:
            raise refused

    def _sent(self, position: OutboxPosition, rows: Sequence[FeedRow], heartbeat: Callable[[], None]) -> int:
        """Send rows, the next time fewer where they took too long or were too large, and more where it was quick.

        One that is too large for the hub goes as its number alone, and the hub sets that apart.
        """
        begun_s = self.clock.monotonic()
        try:
            committed = self.send(position, rows, heartbeat)
        except HubUnfinishedError:
            self._most_rows = max(len(rows) // 2, 1)
            raise
        except HubRefusal as refusal:
            if refusal.status != HTTPStatus.REQUEST_ENTITY_TOO_LARGE or (len(rows) == 1 and rows[0].data is None):
                raise
            if len(rows) > 1:
                self._most_rows = max(len(rows) // 2, 1)
                return self._sent(position, rows[: self._most_rows], heartbeat)
            committed = self.send(position, [replace(rows[0], data=None)], heartbeat)
        if self.clock.monotonic() - begun_s <= _QUICK_S:
            self._most_rows = min(2 * self._most_rows, _MOST_ROWS)
        return committed

    def _follow(self, position: OutboxPosition, committed: int, heartbeat: Callable[[], None]) -> None:
        """Forget the rows that the hub has, or find out where it stands where it stands no more at `position`."""
        if committed > position.committed:
            self._acknowledge(committed)
            return
        self._agree(heartbeat)
        if self._agreed == self.camera.archive.outbox.position() and self._agreed.committed == position.committed:
            raise HubAnswerError(f"{committed} where rows after {position.committed} were sent")

    def _acknowledge(self, committed: int) -> None:
        if not self.camera.archive.outbox.acknowledge(committed):
            raise HubAnswerError(f"the number {committed}, of no row that was sent")

    def _status(self) -> Mapping[str, Any]:
        """Return what the fleet page shows of this imager."""
        board = self.board.snapshot()
        days = self.camera.archive.days.find(self.camera.name, limit=1)
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
            "compared_at": None if self._comparison.compared_at is None else rfc3339(self._comparison.compared_at),
        }
