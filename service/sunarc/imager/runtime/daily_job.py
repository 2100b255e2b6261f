"""One job at a fixed interval of monotonic time; it looks for due work, so a missed night is only a late one."""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable
from datetime import UTC, datetime, timedelta

from apscheduler.executors.pool import ThreadPoolExecutor
from apscheduler.schedulers.background import BackgroundScheduler
from apscheduler.triggers.base import BaseTrigger

from sunarc.common.findings import Data, Finding
from sunarc.imager.runtime.clock import Clock
from sunarc.imager.runtime.status import Reason, StatusRegistry
from sunarc.imager.runtime.supervisor import Heartbeat

_log = logging.getLogger(__name__)

_FAILED = "schedule_failed"
_JOB = "job"
_LEAST_WAIT_S = 1e-3  # APScheduler lists every fire time up to now: each must be later than now
_STEP_S = 0.5  # a wall clock that moved less against the monotonic one is left to the next call


class MonotonicTrigger(BaseTrigger):  # type: ignore[misc]
    """Fires every `every_s` seconds of monotonic time.

    APScheduler compares wall-clock times. This trigger knows the monotonic time at which the job is due and gives its
    one next fire time relative to whatever the wall clock shows, so misses are never listed; after a step of the wall
    clock, `fire_time` is where the pending call has to be moved to.

    Parameters
    ----------
    every_s : seconds between calls.
    monotonic : seconds that never jump.
    """

    def __init__(self, *, every_s: float, monotonic: Callable[[], float]) -> None:
        self._every_s = max(every_s, _LEAST_WAIT_S)
        self._monotonic = monotonic
        self._due_at_s = monotonic()

    def get_next_fire_time(self, previous_fire_time: datetime | None, now: datetime) -> datetime:
        """Return the fire time after a call that is handed over at wall time `now`."""
        del previous_fire_time  # a wall time of before a possible step
        self._due_at_s = self._monotonic() + self._every_s
        return self.fire_time(now)

    def fire_time(self, now: datetime) -> datetime:
        """Return the wall time at which the pending call is due, when the wall clock shows `now`."""
        return now + timedelta(seconds=self._due_at_s - self._monotonic())


class Schedule:
    """Calls a job at once and then every `every_s`, never twice at a time; missed calls are made up by one.

    The interval is one of monotonic time: steps of the wall clock neither delay nor multiply calls, provided that
    `follow_clock` is called about every second.

    Parameters
    ----------
    job : looks for what is due and hands it on. It must not take long: at the end, the process waits for it. What it
        raises is logged and stands on the board until a later call succeeds.
    every_s : seconds of monotonic time.
    clock : real time.
    board : where a failure is written.
    """

    def __init__(self, job: Callable[[], None], *, every_s: float, clock: Clock, board: StatusRegistry) -> None:
        self.heartbeat = Heartbeat(clock.monotonic)
        self._job = job
        self._every_s = every_s
        self._clock = clock
        self._board = board
        self._scheduler: BackgroundScheduler | None = None
        self._trigger = MonotonicTrigger(every_s=every_s, monotonic=clock.monotonic)
        self._idle = threading.Event()
        self._idle.set()
        self._lock = threading.Lock()

    def start(self) -> None:
        """Start; a second call does nothing."""
        with self._lock:
            if self._scheduler is not None:
                return
            self.heartbeat.beat()
            self._trigger = MonotonicTrigger(every_s=self._every_s, monotonic=self._clock.monotonic)
            self._scheduler = _scheduler()
            self._scheduler.add_job(
                self._run_job,
                self._trigger,
                id=_JOB,
                next_run_time=self._clock.now(),
                coalesce=True,
                max_instances=1,
                misfire_grace_time=None,
            )
            self._scheduler.start()

    def follow_clock(self) -> None:
        """Move the pending call to where it belongs after a step of the wall clock; to be called about every second."""
        with self._lock:
            if self._scheduler is None:
                return
            job = self._scheduler.get_job(_JOB)
            planned = self._trigger.fire_time(self._clock.now())
            if job is not None and abs((job.next_run_time - planned).total_seconds()) > _STEP_S:
                self._scheduler.modify_job(_JOB, next_run_time=planned)

    def stop(self, *, within_s: float = 5.0) -> bool:
        """Call the job no more, and wait for a call that is under way; return whether it ended within `within_s`."""
        with self._lock:
            scheduler, self._scheduler = self._scheduler, None
        if scheduler is not None:
            scheduler.shutdown(wait=False)
        return self._idle.wait(within_s)

    def _run_job(self) -> None:
        with self._lock:
            if self._scheduler is None:  # stopped while this call stood in the queue
                return
            self._idle.clear()
        self.heartbeat.beat()
        try:
            self._job()
        except Exception as error:  # noqa: BLE001 - one failed call must not end the schedule
            _log.exception("the scheduled job failed")
            data: Data = {"error": f"{type(error).__name__}: {error}", "every_s": self._every_s}
            self._board.set_condition(_FAILED, Reason.of(Finding(_FAILED, data)), log=False)  # with its stack
        else:
            self._board.set_condition(_FAILED, None)
        finally:
            self.heartbeat.beat()
            self._idle.set()


def _scheduler() -> BackgroundScheduler:
    # it logs every call, and warns of every one it leaves out because the last one still runs: both are as intended
    logging.getLogger("apscheduler").setLevel(logging.ERROR)
    return BackgroundScheduler(timezone=UTC, executors={"default": ThreadPoolExecutor(max_workers=1)})
