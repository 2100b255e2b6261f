from __future__ import annotations

import logging
import threading
import tracemalloc
from collections.abc import Callable, Iterator
from datetime import UTC, datetime, timedelta, tzinfo
from itertools import pairwise

import pytest

from sunarc.imager.runtime.clock import SystemClock, VirtualClock
from sunarc.imager.runtime.daily_job import MonotonicTrigger, Schedule
from sunarc.imager.runtime.status import StatusRegistry

PATIENCE_S = 20.0  # only a failing test waits as long
SOON_S = 0.01
NEVER_S = 1e6


@pytest.fixture
def board() -> StatusRegistry:
    return StatusRegistry(version="0.1", started_at=datetime(2026, 5, 1, tzinfo=UTC), monotonic=SystemClock().monotonic)


MakeSchedule = Callable[[Callable[[], None], float], Schedule]


@pytest.fixture
def make_schedule(board: StatusRegistry) -> Iterator[MakeSchedule]:
    made: list[Schedule] = []

    def make(job: Callable[[], None], every_s: float) -> Schedule:
        made.append(Schedule(job, every_s=every_s, clock=SystemClock(), board=board))
        return made[-1]

    yield make
    for schedule in made:
        schedule.stop()


def test_the_job_is_called_at_once(make_schedule: MakeSchedule) -> None:
    called = threading.Event()
    make_schedule(called.set, NEVER_S).start()
    assert called.wait(PATIENCE_S)


def test_the_job_is_called_again_and_again(make_schedule: MakeSchedule) -> None:
    calls = threading.Semaphore(0)
    make_schedule(calls.release, SOON_S).start()
    for _ in range(5):
        assert calls.acquire(timeout=PATIENCE_S)


def test_starting_twice_does_not_call_twice(make_schedule: MakeSchedule) -> None:
    calls = threading.Semaphore(0)
    schedule = make_schedule(calls.release, NEVER_S)
    schedule.start()
    schedule.start()
    assert calls.acquire(timeout=PATIENCE_S)
    assert schedule.stop()
    assert not calls.acquire(blocking=False)


def test_stopping_twice_and_stopping_what_never_began_is_allowed(make_schedule: MakeSchedule) -> None:
    schedule = make_schedule(lambda: None, NEVER_S)
    assert schedule.stop()
    schedule.start()
    assert schedule.stop()
    assert schedule.stop()


def test_a_stopped_schedule_may_begin_again(make_schedule: MakeSchedule) -> None:
    calls = threading.Semaphore(0)
    schedule = make_schedule(calls.release, NEVER_S)
    for _ in range(2):
        schedule.start()
        assert calls.acquire(timeout=PATIENCE_S)
        schedule.stop()


def test_a_job_that_fails_is_a_reason_until_it_succeeds(
    make_schedule: MakeSchedule, board: StatusRegistry, caplog: pytest.LogCaptureFixture
) -> None:
    reasons: list[tuple[str, ...]] = []
    third_call = threading.Event()

    def job() -> None:
        reasons.append(tuple(reason.text for reason in board.snapshot().reasons))
        if len(reasons) == 1:
            raise OSError("disk full")
        if len(reasons) == 3:
            third_call.set()

    with caplog.at_level(logging.ERROR):
        make_schedule(job, SOON_S).start()
        assert third_call.wait(PATIENCE_S)
    assert reasons[:3] == [(), ("scheduled work failed: OSError: disk full",), ()]
    assert caplog.text.count("Traceback") == 1


def test_a_slow_job_is_never_called_twice_at_a_time(make_schedule: MakeSchedule, board: StatusRegistry) -> None:
    running, most, calls = 0, 0, threading.Semaphore(0)

    def job() -> None:
        nonlocal running, most
        running += 1
        most = max(most, running)
        threading.Event().wait(5 * SOON_S)  # several calls fall due meanwhile
        running -= 1
        calls.release()

    make_schedule(job, SOON_S).start()
    for _ in range(3):
        assert calls.acquire(timeout=PATIENCE_S)
    assert most == 1
    assert board.snapshot().reasons == ()


def test_a_blocked_job_does_not_hold_up_the_stop(make_schedule: MakeSchedule) -> None:
    begun, release = threading.Event(), threading.Event()

    def job() -> None:
        begun.set()
        release.wait(PATIENCE_S)

    schedule = make_schedule(job, NEVER_S)
    schedule.start()
    assert begun.wait(PATIENCE_S)
    clock = SystemClock()
    before_s = clock.monotonic()
    assert not schedule.stop(within_s=0.1)
    assert clock.monotonic() - before_s < 2.0
    release.set()
    assert schedule.stop()


def test_nothing_is_called_after_the_stop(make_schedule: MakeSchedule) -> None:
    schedule = make_schedule(lambda: pytest.fail("called"), NEVER_S)
    schedule._run_job()  # a call that stood in the queue when the schedule was stopped


class SteppedClock(SystemClock):
    """The machine's clocks, the wall clock stepped by hand."""

    def __init__(self) -> None:
        self.stepped = timedelta(0)

    def now(self) -> datetime:
        return super().now() + self.stepped


@pytest.fixture
def stepped(monkeypatch: pytest.MonkeyPatch) -> SteppedClock:
    """Return a clock whose steps APScheduler sees, too."""
    clock = SteppedClock()

    class Stepped(datetime):
        @classmethod
        def now(cls, tz: tzinfo | None = None) -> datetime:  # type: ignore[override]
            return clock.now().astimezone(tz)

    monkeypatch.setattr("apscheduler.schedulers.base.datetime", Stepped)
    return clock


@pytest.mark.parametrize(
    "step",
    [timedelta(hours=1), timedelta(hours=-1), timedelta(days=400), timedelta(days=-400)],
    ids=["hour on", "hour back", "400 days on", "400 days back"],
)
def test_a_step_of_the_wall_clock_neither_delays_nor_multiplies_the_calls(
    stepped: SteppedClock, board: StatusRegistry, step: timedelta
) -> None:
    every_s, calls, called = 0.3, list[float](), threading.Semaphore(0)

    def job() -> None:
        calls.append(stepped.monotonic())
        called.release()

    schedule = Schedule(job, every_s=every_s, clock=stepped, board=board)
    begun = stepped.monotonic()
    schedule.start()
    try:
        for n in range(6):
            assert called.acquire(timeout=PATIENCE_S if n == 0 else 3.0)
            if n == 2:
                tracemalloc.start()
                stepped.stepped += step
            for _ in range(2):  # as the supervisor does, about every second
                threading.Event().wait(0.05)
                schedule.follow_clock()
        _, peak_bytes = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
        schedule.stop()
    intervals = [after - before for before, after in pairwise(calls)]
    early = [n * every_s - (call - begun) for n, call in enumerate(calls)]
    assert max(early) < 0.1 * every_s + 0.11  # a step is followed within a turn, never called early
    assert max(intervals) < every_s + 1.0
    assert peak_bytes < 2_000_000  # 400 days of missed calls would be enumerated


def test_a_clock_that_was_ahead_at_the_start_and_is_set_right_holds_up_no_call(
    stepped: SteppedClock, board: StatusRegistry
) -> None:
    stepped.stepped = timedelta(days=400)
    called = threading.Semaphore(0)
    schedule = Schedule(called.release, every_s=0.2, clock=stepped, board=board)
    schedule.start()
    try:
        assert called.acquire(timeout=PATIENCE_S)
        stepped.stepped = timedelta(0)
        threading.Event().wait(0.05)
        schedule.follow_clock()
        assert called.acquire(timeout=3.0)
    finally:
        schedule.stop()


def test_the_trigger_gives_one_fire_time_later_than_now_however_late_it_is() -> None:
    clock = VirtualClock(datetime(2026, 5, 1, tzinfo=UTC))
    trigger = MonotonicTrigger(every_s=60.0, monotonic=clock.monotonic)
    due = trigger.get_next_fire_time(None, clock.now())
    assert due == clock.now() + timedelta(seconds=60)
    clock.step(400 * 86_400.0)
    clock.advance(10.0)
    assert trigger.fire_time(clock.now()) == clock.now() + timedelta(seconds=50)
    clock.advance(500.0)
    assert trigger.fire_time(clock.now()) < clock.now()  # due: called at once
    assert trigger.get_next_fire_time(due, clock.now()) == clock.now() + timedelta(seconds=60)


def test_the_heartbeat_is_beaten_by_calls_alone(make_schedule: MakeSchedule) -> None:
    called = threading.Semaphore(0)
    schedule = make_schedule(called.release, NEVER_S)
    schedule.start()
    assert called.acquire(timeout=PATIENCE_S)
    assert schedule.stop()
    age_s = schedule.heartbeat.age_s()
    threading.Event().wait(0.05)
    schedule.follow_clock()
    assert schedule.heartbeat.age_s() >= age_s + 0.05
