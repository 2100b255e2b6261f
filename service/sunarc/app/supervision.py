"""Supervision of the workers of a process, in which the watchdog of systemd is fed."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager

from sunarc.runtime.clock import Clock
from sunarc.runtime.daily_job import Schedule
from sunarc.runtime.heartbeats import Monitored
from sunarc.runtime.status import StatusRegistry
from sunarc.runtime.supervisor import Supervised, Supervisor
from sunarc.runtime.systemd import watchdog_interval_s

_STOP_WITHIN_S = 4.0


@contextmanager
def supervised(
    workers: Sequence[Supervised],
    *,
    clock: Clock,
    board: StatusRegistry,
    feed: Callable[[], None],
    on_failed: Callable[[], None],
    monitored: Sequence[Monitored],
    on_check: Sequence[Callable[[], None]],
) -> Iterator[Supervisor]:
    """Run workers, and stop them at the end; the parameters are those of `Supervisor`."""
    interval_s = watchdog_interval_s(os.environ, pid=os.getpid())
    supervisor = Supervisor(
        workers,
        clock=clock,
        board=board,
        feed=feed,
        check_every_s=1.0 if interval_s is None else min(interval_s / 3.0, 1.0),
        on_failed=on_failed,
        monitored=monitored,
        on_check=on_check,
    )
    supervisor.start()
    try:
        yield supervisor
    finally:
        supervisor.stop(within_s=_STOP_WITHIN_S)


@contextmanager
def running(schedule: Schedule) -> Iterator[None]:
    """Run a schedule, and end it."""
    schedule.start()
    try:
        yield
    finally:
        schedule.stop(within_s=1.0)
