"""Feed of an imager: rows of its archive, sent to a hub, and each night compared with those of the hub."""

from __future__ import annotations

import logging
import math
import threading
import uuid
import zlib
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, date, datetime, timedelta
from functools import partial
from http import HTTPStatus
from typing import Any, NamedTuple

from sunarc.common.errors import OutsideError
from sunarc.common.findings import Finding
from sunarc.common.utc import DAY_S, rfc3339
from sunarc.imager.archive.archive import CameraArchive
from sunarc.imager.archive.database.schema import head_revision
from sunarc.imager.archive.day_digests import LEAST_KEPT, MOST_DAYS, DayDigest, DayDigests, StoredDays
from sunarc.imager.archive.feed_rows import FeedRow
from sunarc.imager.archive.outbox import OutboxPosition
from sunarc.imager.archive.values import EventSeverity
from sunarc.imager.runtime.clock import Clock
from sunarc.imager.runtime.loop import Attempts, Loop, Pauses
from sunarc.imager.runtime.status import StatusRegistry, condition
from sunarc.imager.workers.hub_connection import AskStoredDays, HubAnswerError, HubRefusal, HubUnfinishedError, Send

_BEGINS_S, _SPREAD_S = 3600, 7200
"""s after midnight, mean solar time, and s over which a fleet's comparisons begin: of 1000 imagers one every 7 s."""
_AGAIN_S = 600.0
"""s after a comparison that failed: the hub was busy or not reached, and is left alone."""
_WITHOUT_COMPARISON = frozenset({HTTPStatus.NOT_FOUND, HTTPStatus.METHOD_NOT_ALLOWED, HTTPStatus.NOT_IMPLEMENTED})
_WINDOW = timedelta(days=MOST_DAYS)
_NONE = DayDigest(0, f"{0:016x}")
_LACKS = "hub_lacks_rows"

KindDay = tuple[str, date]


class _OwnAndHub(NamedTuple):
    own: DayDigest
    hub: DayDigest


@dataclass(kw_only=True, eq=False)
class FeedComparison:
    """Nightly comparison with the hub: the last 32 days, those of the newest sightings, and 32 older days in turn.

    What differs is queued again, and compared once more when it was sent. The hub removes nothing on account of it.

    Parameters
    ----------
    camera : whose archive.
    ask : asks what the hub has.
    clock : real time.
    board : where rows are shown that the hub does not take.
    """

    camera: CameraArchive
    ask: AskStoredDays
    clock: Clock
    board: StatusRegistry

    def __post_init__(self) -> None:
        """Begin with the present night."""
        self.compared_at: datetime | None = None
        self._night: int | None = None
        self._windows: deque[tuple[date, date]] = deque()
        self._not_before_s = -math.inf
        self._sent_again: set[KindDay] = set()
        """Rows that were sent again this night."""
        self._others: dict[KindDay, _OwnAndHub] = {}
        """Days of which the hub has more rows: they stay so, and are not sent again every night."""
        self._lacking: set[KindDay] = set()
        self._skipped = ""

    def queue_differing(self, heartbeat: Callable[[], None]) -> bool:
        """Compare some days if it is time, and return whether rows were queued; a failure is tried again later."""
        self._plan_comparison()
        if not self._windows or self.clock.monotonic() < self._not_before_s:
            return False
        try:
            return self._compare_days(*self._windows[0], heartbeat)
        except HubRefusal as refusal:
            if refusal.status in _WITHOUT_COMPARISON:
                self._skip_comparison(f"the hub is of an older version ({refusal.status})")
            failure = str(refusal)
        except OutsideError as error:
            failure = str(error)
        _log.info("rows were not compared with the hub's: %s", failure)
        self._not_before_s = self.clock.monotonic() + _AGAIN_S
        return False

    def _plan_comparison(self) -> None:
        """Begin a night's work when it is time."""
        now = self.clock.now()
        begins_s = _BEGINS_S + zlib.crc32(self.camera.name.encode()) % _SPREAD_S
        night = math.floor((now.timestamp() + 240.0 * self.camera.site.longitude - begins_s) / DAY_S)
        if night == self._night:
            return
        self._night = night
        today = now.astimezone(UTC).date() + timedelta(days=1)
        first, last = self.camera.archive.outbox.first_and_last_day(self.camera.name) or (today, today)
        end = today if today - last <= _WINDOW else last + timedelta(days=1)  # a folder's images may be of years ago
        n_older = max(math.ceil(((end - _WINDOW) - first) / _WINDOW), 1)
        older = end - _WINDOW * (1 + night % n_older)
        self._windows = deque(dict.fromkeys((one - _WINDOW, one) for one in (older, end, today)))
        self._sent_again.clear()

    def _compare_days(self, since: date, until: date, heartbeat: Callable[[], None]) -> bool:
        """Compare the days of a window, as many as either side reads at once, and queue the rows that differ."""
        outbox = self.camera.archive.outbox
        own = outbox.digests(self.camera.name, since=since, until=until)
        if own is None:
            return False  # rows wait: they are sent first
        heartbeat()
        stored = self.ask(outbox.position().installation, since, own.until, heartbeat)
        if stored.revision != head_revision():
            self._skip_comparison(
                f"the hub's tables are of revision {stored.revision}, this imager's of {head_revision()}"
            )
            return False
        if not since < stored.until <= own.until:
            raise HubAnswerError(f"days until {stored.until} where those of {since} to {own.until} were asked for")
        self.compared_at, self._skipped = self.clock.now(), ""
        differing = dict(self._list_differing(own, stored, since))
        again = {key: pair for key, pair in differing.items() if self._is_to_be_resent(key, pair)}
        self._report_still_differing({key: pair for key, pair in differing.items() if key not in again})
        found_sound = {key for key in self._lacking if since <= key[1] < stored.until} - differing.keys()
        self._show_lacking(self._lacking - found_sound)
        if again:  # first of all: what could not be queued is compared again
            outbox.queue_days(self.camera.name, again)
            self._sent_again |= again.keys()
        self._windows.popleft()
        if stored.until < until:
            self._windows.appendleft((stored.until, until))
        if not again:
            return False
        self._windows.append((since, stored.until))  # once more, when they were sent
        kinds, n_rows = ", ".join(sorted({kind for kind, _ in again})), sum(pair.own.n for pair in again.values())
        self._write_event(
            Finding("hub_rows_sent_again", {"kinds": kinds, "n_rows": n_rows, **_count_days(again)}), "warning"
        )
        return True

    def _is_to_be_resent(self, key: KindDay, pair: _OwnAndHub) -> bool:
        return pair.own.n > 0 and key not in self._sent_again and self._others.get(key) != pair

    def _list_differing(self, own: DayDigests, stored: StoredDays, since: date) -> Iterator[tuple[KindDay, _OwnAndHub]]:
        """Yield the kinds and days that differ, but for days of which the hub keeps no sightings any more."""
        kept_since = self.clock.now().astimezone(UTC).date() - LEAST_KEPT
        for kind, days in own.days.items():
            of_hub = stored.days.get(kind, {})
            for day in sorted(days.keys() | of_hub.keys()):
                here, there = days.get(day, _NONE), of_hub.get(day, _NONE)
                if here is None or there is None or here == there or not since <= day < stored.until:
                    continue
                if kind == "sun_point" and there.n == 0 and day < kept_since:
                    continue
                yield (kind, day), _OwnAndHub(here, there)

    def _report_still_differing(self, after: dict[KindDay, _OwnAndHub]) -> None:
        """Report the rows that differ though they were sent again."""
        others = {key: pair for key, pair in after.items() if pair.hub.n > pair.own.n}
        new = {key: pair for key, pair in others.items() if self._others.get(key) != pair}
        if new:
            n_rows = sum(pair.hub.n - pair.own.n for pair in new.values())
            self._write_event(Finding("hub_has_other_rows", {"n_rows": n_rows, **_count_days(new)}), "warning")
        self._others |= others
        self._show_lacking(self._lacking | (after.keys() - others.keys()))

    def _show_lacking(self, lacking: set[KindDay]) -> None:
        self._lacking = lacking
        first = min(lacking, key=lambda key: key[1], default=None)
        found = None
        if first is not None:
            found = condition(_LACKS, n_days=len(lacking), kind=first[0], first=first[1].isoformat())
        self.board.set_condition(_LACKS, found)

    def _write_event(self, found: Finding, severity: EventSeverity) -> None:
        self.camera.add_event(found, time=self.clock.now(), severity=severity)

    def _skip_comparison(self, reason: str) -> None:
        """Compare nothing until the next night, and write an event once."""
        self._windows.clear()
        if reason != self._skipped:
            self._write_event(Finding("hub_not_compared", {"reason": reason}), "info")
        self._skipped = reason


def _count_days(pairs: Iterable[KindDay]) -> dict[str, int | str]:
    """Return how many days there are, and the first."""
    days = {day for _, day in pairs}
    return {"n_days": len(days), "first": min(days).isoformat()}


_log = logging.getLogger(__name__)
_MOST_ROWS = 1000
_QUICK_S = 7.5
"""An exchange that took no longer, a quarter of the limit, shows that the next may have twice the rows."""
_MOST_BYTES = 1_000_000  # of JSON, a tenth of that on the way
_STATUS_EVERY_S = 60.0
LONGEST_WAIT_S = 60.0
SILENT_S = 900.0
"""A hub that was not reached for so long is a condition; a network that is lost for minutes is not."""
_UNREACHABLE, _REFUSED, _INVALID = "hub_unreachable", "hub_refuses", "hub_answer_invalid"


@dataclass(kw_only=True, eq=False)
class FeedWorker:
    """Worker that sends the rows of the outbox to the hub, and removes those that the hub has stored.

    Parameters
    ----------
    camera : whose archive.
    send : sends rows.
    ask : asks what the hub has.
    clock : real time.
    board : whose status the hub gets, and where a hub that does not answer is shown.
    every_s : seconds between two queries of the outbox.
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
            pause_s = self._attempts.attempt(partial(self._send_or_report, heartbeat))
        except HubRefusal as refusal:  # the hub answers, and an operator has to do something; it is tried all the same
            self._attempts.answered()
            self.board.set_condition(_REFUSED, condition(_REFUSED, status=refusal.status, error=str(refusal)))
            pause_s = self._attempts.failed(str(refusal))
        return max(pause_s, self.asked_s())

    def _send_or_report(self, heartbeat: Callable[[], None]) -> float | None:
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
            outbox.queue_status(self._make_status())
            self._status_s = self.clock.monotonic()
        if self._agreed is None or outbox.position() != self._agreed:
            self._ask_position(heartbeat)
            if self.asked_s() > 0.0:
                return False
        position, self._agreed = self._agreed, None
        rows = () if position is None else outbox.rows_to_send(position, most=self._most_rows, most_bytes=_MOST_BYTES)
        if position is None or rows is None:
            return True  # the database was put back meanwhile
        if rows:
            self._advance(position, self._send_rows(position, rows, heartbeat), heartbeat)
        self._agreed = outbox.position()
        return bool(rows) or self._comparison.queue_differing(heartbeat)

    def _ask_position(self, heartbeat: Callable[[], None]) -> None:
        """Ask the hub up to which row it has stored, and continue from there.

        Until it has answered no number counts as sent: a database that was put back to an earlier copy knows of less
        than the hub has, however long the hub is away.
        """
        outbox = self.camera.archive.outbox
        position = outbox.position()
        committed = self.send(replace(position, committed=-1), (), heartbeat)
        if committed > position.sent:
            self._begin_new_installation(position, committed, heartbeat)
        elif committed > position.committed:
            self._remove_committed(committed)
        elif committed < position.committed:
            _log.warning(
                "the hub has rows up to %d, and had them up to %d: all go again", committed, position.committed
            )
            outbox.send_again(committed=committed)
        self._agreed = outbox.position()

    def _begin_new_installation(self, position: OutboxPosition, committed: int, heartbeat: Callable[[], None]) -> None:
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

    def _send_rows(self, position: OutboxPosition, rows: Sequence[FeedRow], heartbeat: Callable[[], None]) -> int:
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
                return self._send_rows(position, rows[: self._most_rows], heartbeat)
            committed = self.send(position, [replace(rows[0], data=None)], heartbeat)
        if self.clock.monotonic() - begun_s <= _QUICK_S:
            self._most_rows = min(2 * self._most_rows, _MOST_ROWS)
        return committed

    def _advance(self, position: OutboxPosition, committed: int, heartbeat: Callable[[], None]) -> None:
        """Remove the rows that the hub has stored, or ask where it stands if that is not after `position`."""
        if committed > position.committed:
            self._remove_committed(committed)
            return
        self._ask_position(heartbeat)
        if self._agreed == self.camera.archive.outbox.position() and self._agreed.committed == position.committed:
            raise HubAnswerError(f"{committed} where rows after {position.committed} were sent")

    def _remove_committed(self, committed: int) -> None:
        if not self.camera.archive.outbox.acknowledge(committed):
            raise HubAnswerError(f"the number {committed}, of no row that was sent")

    def _make_status(self) -> Mapping[str, Any]:
        """Return the fleet page's row of this imager."""
        board = self.board.snapshot()
        days = self.camera.archive.days.find(self.camera.name, limit=1)
        offset = days[0].pose_offset_deg if days else None
        return {
            "version": board.version,
            "health": board.health,
            "state": board.state,
            "state_text": board.state_text,
            "conditions": [reason.code for reason in board.reasons],
            "disk_free_bytes": None if board.disk is None else board.disk.free_bytes,
            "clock_synchronised": None if board.clock is None else board.clock.synchronised,
            "clock_error_s": None if board.clock is None else board.clock.max_error_s,
            "last_frame_at": None if board.last_frame_at is None else rfc3339(board.last_frame_at),
            "drift_deg": None if offset is None else math.hypot(*offset),
            "compared_at": None if self._comparison.compared_at is None else rfc3339(self._comparison.compared_at),
        }
