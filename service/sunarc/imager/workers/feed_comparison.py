"""The nightly comparison of an imager's rows with its hub's, by kind and day; what differs is sent again."""

from __future__ import annotations

import logging
import math
import zlib
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from datetime import UTC, date, datetime, timedelta
from http import HTTPStatus
from typing import NamedTuple

from sunarc.common.errors import OutsideError
from sunarc.common.findings import Finding
from sunarc.imager.archive.archive import CameraArchive
from sunarc.imager.archive.database.schema import head_revision
from sunarc.imager.archive.day_digests import LEAST_KEPT, MOST_DAYS, DayDigest, DayDigests, StoredDays
from sunarc.imager.archive.values import EventSeverity
from sunarc.imager.runtime.clock import Clock
from sunarc.imager.runtime.status import StatusRegistry, condition
from sunarc.imager.workers.hub_connection import AskStoredDays, HubAnswerError, HubRefusal

_log = logging.getLogger(__name__)
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
    """Compares the last 32 days, those of the newest sightings, and by turns 32 older ones: at a start, once a night.

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
        """Begin with the night that is now."""
        self.compared_at: datetime | None = None
        self._night: int | None = None
        self._windows: deque[tuple[date, date]] = deque()
        self._not_before_s = -math.inf
        self._sent_again: set[KindDay] = set()
        """What was sent again this night."""
        self._others: dict[KindDay, _OwnAndHub] = {}
        """Days of which the hub has more rows: they stay so, and are not sent again every night."""
        self._lacking: set[KindDay] = set()
        self._skipped = ""

    def queue_differing(self, heartbeat: Callable[[], None]) -> bool:
        """Compare some days if it is time, and return whether rows were queued; a failure is tried again later."""
        self._plan()
        if not self._windows or self.clock.monotonic() < self._not_before_s:
            return False
        try:
            return self._compare(*self._windows[0], heartbeat)
        except HubRefusal as refusal:
            if refusal.status in _WITHOUT_COMPARISON:
                self._skip(f"the hub is of an older version ({refusal.status})")
            failure = str(refusal)
        except OutsideError as error:
            failure = str(error)
        _log.info("rows were not compared with the hub's: %s", failure)
        self._not_before_s = self.clock.monotonic() + _AGAIN_S
        return False

    def _plan(self) -> None:
        """Begin a night's work when it is time."""
        now = self.clock.now()
        begins_s = _BEGINS_S + zlib.crc32(self.camera.name.encode()) % _SPREAD_S
        night = math.floor((now.timestamp() + 240.0 * self.camera.site.longitude - begins_s) / 86_400.0)
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

    def _compare(self, since: date, until: date, heartbeat: Callable[[], None]) -> bool:
        """Compare the days of a window, as many as either side reads at once, and queue what differs."""
        outbox = self.camera.archive.outbox
        own = outbox.digests(self.camera.name, since=since, until=until)
        if own is None:
            return False  # rows wait: they are sent first
        heartbeat()
        stored = self.ask(outbox.position().installation, since, own.until, heartbeat)
        if stored.revision != head_revision():
            self._skip(f"the hub's tables are of revision {stored.revision}, this imager's of {head_revision()}")
            return False
        if not since < stored.until <= own.until:
            raise HubAnswerError(f"days until {stored.until} where those of {since} to {own.until} were asked for")
        self.compared_at, self._skipped = self.clock.now(), ""
        differing = dict(self._differing(own, stored, since))
        again = {key: pair for key, pair in differing.items() if self._goes_again(key, pair)}
        self._judge({key: pair for key, pair in differing.items() if key not in again})
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
        self._say(Finding("hub_rows_sent_again", {"kinds": kinds, "n_rows": n_rows, **_days_of(again)}), "warning")
        return True

    def _goes_again(self, key: KindDay, pair: _OwnAndHub) -> bool:
        return pair.own.n > 0 and key not in self._sent_again and self._others.get(key) != pair

    def _differing(self, own: DayDigests, stored: StoredDays, since: date) -> Iterator[tuple[KindDay, _OwnAndHub]]:
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

    def _judge(self, after: dict[KindDay, _OwnAndHub]) -> None:
        """Say what differs though it was sent again."""
        others = {key: pair for key, pair in after.items() if pair.hub.n > pair.own.n}
        new = {key: pair for key, pair in others.items() if self._others.get(key) != pair}
        if new:
            n_rows = sum(pair.hub.n - pair.own.n for pair in new.values())
            self._say(Finding("hub_has_other_rows", {"n_rows": n_rows, **_days_of(new)}), "warning")
        self._others |= others
        self._show_lacking(self._lacking | (after.keys() - others.keys()))

    def _show_lacking(self, lacking: set[KindDay]) -> None:
        self._lacking = lacking
        first = min(lacking, key=lambda key: key[1], default=None)
        found = None
        if first is not None:
            found = condition(_LACKS, n_days=len(lacking), kind=first[0], first=first[1].isoformat())
        self.board.set_condition(_LACKS, found)

    def _say(self, found: Finding, severity: EventSeverity) -> None:
        self.camera.add_event(found, time=self.clock.now(), severity=severity)

    def _skip(self, reason: str) -> None:
        """Compare nothing until the next night, and say so once."""
        self._windows.clear()
        if reason != self._skipped:
            self._say(Finding("hub_not_compared", {"reason": reason}), "info")
        self._skipped = reason


def _days_of(pairs: Iterable[KindDay]) -> dict[str, int | str]:
    """Return how many days there are, and the first."""
    days = {day for _, day in pairs}
    return {"n_days": len(days), "first": min(days).isoformat()}
