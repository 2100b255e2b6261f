"""One job, again and again: it looks for what is due, so a missed night is only a late one."""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable
from datetime import UTC

from apscheduler.executors.pool import ThreadPoolExecutor
from apscheduler.schedulers.background import BackgroundScheduler

from sunarc.board import Reason, StatusBoard
from sunarc.clock import Clock

_log = logging.getLogger(__name__)

_FAILED = "schedule_failed"


class Schedule:
    """Calls a job at once and then every `every_s`, never twice at a time; missed calls are made up by one.

    The schedule is in real time, whatever time the frames have.

    Parameters
    ----------
    job : looks for what is due and hands it on. It must not take long: at the end, the process waits for it. What it
        raises is logged and stands on the board until a later call succeeds.
    every_s : seconds of real time.
    clock : real time.
    board : where a failure is written.
    """

    def __init__(self, job: Callable[[], None], *, every_s: float, clock: Clock, board: StatusBoard) -> None:
        self._job = job
        self._every_s = every_s
        self._clock = clock
        self._board = board
        self._scheduler: BackgroundScheduler | None = None
        self._idle = threading.Event()
        self._idle.set()
        self._lock = threading.Lock()

    def start(self) -> None:
        """Begin; once begun, nothing more happens."""
        with self._lock:
            if self._scheduler is not None:
                return
            self._scheduler = _scheduler()
            self._scheduler.add_job(
                self._call,
                "interval",
                seconds=self._every_s,
                next_run_time=self._clock.now(),
                coalesce=True,
                max_instances=1,
                misfire_grace_time=None,
            )
            self._scheduler.start()

    def stop(self, *, within_s: float = 5.0) -> bool:
        """Call the job no more, and wait for a call that is under way; return whether it ended within `within_s`."""
        with self._lock:
            scheduler, self._scheduler = self._scheduler, None
        if scheduler is not None:
            scheduler.shutdown(wait=False)
        return self._idle.wait(within_s)

    def _call(self) -> None:
        with self._lock:
            if self._scheduler is None:  # stopped while this call stood in the queue
                return
            self._idle.clear()
        try:
            self._job()
        except Exception as error:  # noqa: BLE001 - one failed call must not end the schedule
            _log.exception("the scheduled job failed")
            self._board.set_reason(_failed_reason(error, self._every_s))
        else:
            self._board.clear_reason(_FAILED)
        finally:
            self._idle.set()


def _scheduler() -> BackgroundScheduler:
    # it logs every call, and warns of every one it leaves out because the last one still runs: both are as intended
    logging.getLogger("apscheduler").setLevel(logging.ERROR)
    return BackgroundScheduler(timezone=UTC, executors={"default": ThreadPoolExecutor(max_workers=1)})


def _failed_reason(error: Exception, every_s: float) -> Reason:
    return Reason(
        code=_FAILED,
        severity="degraded",
        text=f"the look for ended days failed: {type(error).__name__}: {error}",
        remedy=f"it is tried again in {every_s:g} s; the log has the stack",
    )
