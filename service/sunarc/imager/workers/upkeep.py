"""Upkeep: disk space, the database's file, and the record of the service's own state."""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta

from sunarc.common.errors import OutsideError, StoreFullError
from sunarc.common.findings import Finding
from sunarc.imager.archive.archive import Archive, CameraArchive
from sunarc.imager.archive.database.recovery import Recovery
from sunarc.imager.archive.database.store import Reserve
from sunarc.imager.archive.images import DiskOptions, DiskUsage, ImageStore
from sunarc.imager.archive.values import Event, Housekeeping, merged
from sunarc.imager.runtime.clock import Clock
from sunarc.imager.runtime.loop import Attempts, Loop, Pauses
from sunarc.imager.runtime.states import Severity
from sunarc.imager.runtime.status import DiskStatus, Reason, StatusRegistry, condition

_log = logging.getLogger(__name__)
_DISK_EVERY_S = 5.0
"""Seconds from check to check: a full cycle's images in between are far below the reserve."""
_UNREADABLE = "images_unreadable"
_DISK_CODES = ("disk_low", "disk_full", "disk_no_inodes")


@dataclass(kw_only=True, eq=False)
class DiskWorker:
    """Checks the disk periodically, removes images by age and by free space, and publishes the disk's state.

    Parameters
    ----------
    store : the images.
    reserve : space for the database, released when the disk is full and taken again when it is not.
    options : how much images may have.
    clock : real time.
    age_from : the time that the age of images is counted from; None while it cannot be trusted.
    board : where the disk's state is shown.
    """

    store: ImageStore
    reserve: Reserve
    options: DiskOptions
    clock: Clock
    age_from: Callable[[], datetime | None]
    board: StatusRegistry

    def __post_init__(self) -> None:
        """Set the interval of the checks."""
        self._attempts = Attempts(
            self.clock,
            Pauses(_DISK_EVERY_S, _DISK_EVERY_S),
            board=self.board,
            code=_UNREADABLE,
            reason=lambda error, _: condition(_UNREADABLE, error=error),
        )

    def run(self, stop: threading.Event, heartbeat: Callable[[], None]) -> None:
        """Check until stopped."""
        self._attempts.attempt(self.store.clear_up)
        Loop(self.clock, stop, heartbeat).repeat(self.check)

    def check(self) -> float:
        """Check once, and return the seconds until the next time; a folder that cannot be read becomes a condition."""
        return self._attempts.attempt(self._check_disk_and_database)

    def _check_disk_and_database(self) -> None:
        try:
            self._clean_up()
        except OSError as error:
            raise OutsideError(str(error)) from error

    def _clean_up(self) -> None:
        now = self.age_from()
        if now is not None:
            keep = self.options.keep_days
            removed = self.store.expire(now - timedelta(days=keep), keep_newest_days=int(keep))
            if removed:
                _log.info("%d images older than %g days were removed", removed, self.options.keep_days)
        has_space = self.store.make_room()
        usage = self.store.usage()
        self.reserve.balance(usage.free_bytes)
        self._publish_condition(usage, has_space=has_space)

    def _publish_condition(self, usage: DiskUsage, *, has_space: bool) -> None:
        self.board.note(
            disk=DiskStatus(
                free_bytes=usage.free_bytes,
                images_bytes=usage.images_bytes,
                oldest_image_at=usage.oldest_image_at,
            )
        )
        self.board.set_one_condition(_DISK_CODES, self._make_condition(usage, has_space=has_space))

    def _make_condition(self, usage: DiskUsage, *, has_space: bool) -> Reason | None:
        if usage.out_of_files:
            code = "disk_no_inodes"
        elif has_space:
            return None
        else:
            code = "disk_low" if self.reserve.held() else "disk_full"
        return condition(
            code,
            folder=str(self.store.folder),
            free_mb=usage.free_bytes / 1e6,
            lacking_mb=max(usage.keep_free_bytes - usage.free_bytes, 0) / 1e6,
            images_mb=usage.images_bytes / 1e6,
        )


_DATABASE_EVERY_S = 2.0
_MISSING = "database_missing"
_SLOW = "database_slow"
_SLOW_S, _SLOW_WITHIN_S = 0.5, 60.0
"""From here on a commit tells of a device that stalls; a sound one takes some milliseconds. It does now and then, not
every time: the condition lasts so long after the last one."""
_STORE_FULL = "store_full"
_STORE_FAILED = "store_failed"


@dataclass(kw_only=True, eq=False)
class DatabaseWorker:
    """Checks periodically that the database's file is the one that was opened, and restores it where it is not.

    Parameters
    ----------
    archive : whose file.
    clock : real time.
    now : frame time, which dates events.
    board : where a lost database is shown.
    recovered : what was done about a lost database at the start; None when it was in place.
    waiting : how many images and sightings wait to be stored.
    """

    archive: Archive
    clock: Clock
    now: Callable[[], datetime]
    board: StatusRegistry
    recovered: Recovery | None = None
    waiting: Callable[[], int] = lambda: 0

    def __post_init__(self) -> None:
        """Sample every few seconds, and show the former measurements."""
        self._attempts = Attempts(
            self.clock,
            Pauses(_DATABASE_EVERY_S, _DATABASE_EVERY_S),
            board=self.board,
            code=_MISSING,
            reason=lambda error, _: condition(_MISSING, error=error),
        )
        if self.recovered is not None:
            _publish_condition(self.board, self.recovered)

    def run(self, stop: threading.Event, heartbeat: Callable[[], None]) -> None:
        """Check until stopped."""
        Loop(self.clock, stop, heartbeat).repeat(self.check)

    def check(self) -> float:
        """Check once, and return the seconds until the next time."""
        return self._attempts.attempt(self._check_disk_and_database)

    def _check_disk_and_database(self) -> None:
        seconds = self.archive.database.commits.slowest_s(_SLOW_WITHIN_S)
        slow = condition(_SLOW, seconds=seconds, waiting=self.waiting()) if seconds >= _SLOW_S else None
        self.board.set_condition(_SLOW, slow)
        done = self.archive.recover(now=self.clock.now())
        if done is not None:
            self.recovered = done
            _publish_condition(self.board, done)
        self._write_recovery_event()

    def _write_recovery_event(self) -> None:
        """Write the event of a recovery, as soon as it can be written."""
        if self.recovered is None:
            return
        event = Event.of(_recovery_finding(self.recovered), time=self.now(), severity="alarm")
        try:
            self.archive.events.add(event)
        except OutsideError as error:
            _log.error("could not store the event %s: %s", event.kind, error)
        else:
            self.recovered = None


def _recovery_finding(done: Recovery) -> Finding:
    return Finding(f"database_{done.kind}", {"text": done.text})


def _publish_condition(board: StatusRegistry, done: Recovery) -> None:
    reason = Reason.of(_recovery_finding(done))
    board.set_condition(reason.code, reason, log=False)


QUIET_S, PATIENCE_S = 60.0, 45.0
"""Of an imager, which tries to store where nothing was stored for so long: 12 kB a minute, and none by day. Others may
hold the file locked for 30 s, and a slow device is `database_slow`."""


@dataclass(kw_only=True, eq=False)
class StoreRoomWorker:
    """Worker that checks whether a database can store a row, and sets a condition where it cannot.

    Parameters
    ----------
    archive : of a hub, or of an imager.
    clock : real time.
    board : where it is shown.
    severity : "not_ready" of a hub. An imager goes on, and holds its sightings in memory.
    quiet_s : without a write to the file, after which a row is tried; 0 tries at each look, and room for more rows.
    patience_s : that a trial may take.
    """

    archive: Archive
    clock: Clock
    board: StatusRegistry
    severity: Severity = "not_ready"
    quiet_s: float = 0.0
    patience_s: float = 5.0

    def __post_init__(self) -> None:
        """Begin as after a write to the database."""
        self._written, self._written_s = self.archive.last_written(), self.clock.monotonic()
        self._fails = False

    def run(self, stop: threading.Event, heartbeat: Callable[[], None]) -> None:
        """Check until stopped."""
        Loop(self.clock, stop, heartbeat).every(_DATABASE_EVERY_S, self.check)

    def check(self) -> None:
        """Check once."""
        if self._was_written() and not self._fails:
            return
        failure, room = None, self.quiet_s == 0.0
        try:
            self.archive.require_storing(now=self.clock.now(), patience_s=self.patience_s, room=room)
        except StoreFullError as error:
            failure = condition(_STORE_FULL, severity=self.severity, error=str(error))
        except OutsideError as error:
            failure = condition(_STORE_FAILED, severity=self.severity, error=str(error))
        self._fails = failure is not None
        self.board.set_one_condition((_STORE_FULL, _STORE_FAILED), failure)

    def _was_written(self) -> bool:
        """Return whether anything was stored lately, by whomever."""
        written, now_s = self.archive.last_written(), self.clock.monotonic()
        if written != self._written:
            self._written, self._written_s = written, now_s
        return now_s - self._written_s < self.quiet_s


_SAMPLE_EVERY_S = 10.0
_STORE_EVERY_S = 600.0
"""A kill loses at most so much of an hour; 300 writes a day are a tenth of the sightings'."""
_MOST_WAITING = 1000
"""Hours that are held in memory while the disk is full; of more the oldest are dropped."""


@dataclass(kw_only=True, eq=False)
class HousekeepingWorker:
    """Worker that reads disk space and temperature from the status board, and stores them by hour and by day.

    Parameters
    ----------
    camera : its archive.
    clock : real time.
    now : the frames' time; None while it cannot be trusted, and nothing is recorded.
    age_from : the time that the age of rows is counted from; None while none are to be removed.
    board : where disk and camera stand.
    """

    camera: CameraArchive
    clock: Clock
    now: Callable[[], datetime | None]
    age_from: Callable[[], datetime | None]
    board: StatusRegistry

    def __post_init__(self) -> None:
        """Begin without samples."""
        self._waiting: dict[datetime, Housekeeping] = {}
        self._stored_s = self.clock.monotonic()
        self._failed = False

    def run(self, stop: threading.Event, heartbeat: Callable[[], None]) -> None:
        """Sample until stopped, and store the rest."""
        Loop(self.clock, stop, heartbeat).every(_SAMPLE_EVERY_S, self.step)
        self.store()

    def step(self) -> None:
        """Take one sample, and store the sums when an hour has ended."""
        now = self.now()
        if now is not None:
            self._take_sample(now)
        if self.clock.monotonic() - self._stored_s >= _STORE_EVERY_S or self._has_ended_hour():
            self.store()

    def _has_ended_hour(self) -> bool:
        """Return whether an hour has just ended: a simulated one lasts seconds. Sums that failed wait their time."""
        return len(self._waiting) > 1 and not self._failed

    def _take_sample(self, now: datetime) -> None:
        snapshot = self.board.snapshot()
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
        """Store the waiting sums; where that fails they are kept for the next time."""
        self._stored_s = self.clock.monotonic()
        age_from = self.age_from()
        try:
            if self._waiting:
                self.camera.archive.housekeeping.add(self.camera.name, self._waiting.values())
                self._waiting.clear()
            if age_from is not None:
                self.camera.archive.housekeeping.expire(self.camera.name, now=age_from)
        except OutsideError as error:
            if not self._failed:
                _log.warning("could not store disk space and temperature, will retry: %s", error)
            self._failed = True
        else:
            self._failed = False


_LOOK_EVERY_S = 10.0
_LEAST_HELD = timedelta(seconds=60)
"""A condition that holds for less is not stored: one that comes and goes would be written at every cycle."""
SETTLED_S = 900.0
"""For so long after the start a stored condition that is not set may come back: some need ten slots to be found."""


@dataclass(kw_only=True, eq=False)
class ConditionTimesWorker:
    """Worker that stores since when conditions hold, and restores these times at the start.

    Parameters
    ----------
    archive : the store.
    camera : whose conditions; "" for the hub's own.
    board : where conditions are set.
    clock : real time.
    passing : codes that say something of this run of the service alone.
    """

    archive: Archive
    camera: str
    board: StatusRegistry
    clock: Clock
    passing: Collection[str] = ()

    def __post_init__(self) -> None:
        """Give the status board the stored times."""
        self._settled_s = self.clock.monotonic() + SETTLED_S
        self._failed = False
        self._stored: Mapping[str, datetime] | None = None
        self._restore_times()

    def run(self, stop: threading.Event, heartbeat: Callable[[], None]) -> None:
        """Store changed conditions until stopped."""
        Loop(self.clock, stop, heartbeat).every(_LOOK_EVERY_S, self.step)

    def step(self) -> None:
        """Store the changed conditions once; a failure is tried again at the next step."""
        if self._stored is None:
            self._restore_times()
        if self._stored is None:
            return
        held = self._held_conditions(self._stored)
        if held == self._stored:
            return
        try:
            self.archive.conditions.replace_since(self.camera, held)
        except OutsideError as error:
            self._log_once("could not store since when conditions hold, will retry: %s", error)
        else:
            self._stored, self._failed = held, False

    def _restore_times(self) -> None:
        try:
            self._stored = self.archive.conditions.times(self.camera)
        except OutsideError as error:
            self._log_once("could not read since when conditions hold, will retry: %s", error)
        else:
            self.board.resume(self._stored, within_s=self._settled_s - self.clock.monotonic())

    def _log_once(self, text: str, error: OutsideError) -> None:
        if not self._failed:
            _log.warning(text, error)
        self._failed = True

    def _held_conditions(self, stored: Mapping[str, datetime]) -> dict[str, datetime]:
        now = self.clock.now()
        present = {reason.code: reason.since for reason in self.board.snapshot().reasons if reason.since is not None}
        lasting = {
            code: since
            for code, since in present.items()
            if code not in self.passing and (code in stored or now - since >= _LEAST_HELD)
        }
        return {**self.board.awaited(), **lasting}
