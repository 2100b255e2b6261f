from __future__ import annotations

import logging
import sys
import threading
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from itertools import pairwise

import pytest
from tests.fixtures.board import START

from sunarc.common.errors import OutsideError
from sunarc.imager.runtime.clock import SystemClock, VirtualClock
from sunarc.imager.runtime.status import StatusRegistry, WorkerStatus
from sunarc.imager.runtime.supervisor import (
    Heartbeat,
    Monitored,
    Supervised,
    Supervisor,
    SupervisorOptions,
    Watchdog,
    Worker,
)

PATIENCE_S = 20.0  # only a failing test waits as long

Deed = Callable[[threading.Event, Callable[[], None]], None]


@dataclass
class Doer:
    """A worker that does what it is given."""

    deed: Deed

    def run(self, stop: threading.Event, heartbeat: Callable[[], None]) -> None:
        self.deed(stop, heartbeat)


@dataclass
class Factory:
    """Makes one worker for each of the deeds, the last one for ever after."""

    deeds: list[Deed]
    made: list[Worker] = field(default_factory=list)

    def __call__(self) -> Worker:
        worker = Doer(self.deeds[min(len(self.made), len(self.deeds) - 1)])
        self.made.append(worker)
        return worker


@pytest.fixture
def release() -> Iterator[threading.Event]:
    """Let a worker that ignores `stop` go, whatever the test came to."""
    event = threading.Event()
    yield event
    event.set()


def die(_stop: threading.Event, _heartbeat: Callable[[], None]) -> None:
    raise OSError("the cable fell out")


def obey(stop: threading.Event, _heartbeat: Callable[[], None]) -> None:
    assert stop.wait(PATIENCE_S)


def obey_and_tell(started: threading.Event) -> Deed:
    def deed(stop: threading.Event, _heartbeat: Callable[[], None]) -> None:
        started.set()
        assert stop.wait(PATIENCE_S)

    return deed


def on_board(board: StatusRegistry, name: str) -> WorkerStatus:
    return next(worker for worker in board.snapshot().workers if worker.name == name)


def test_each_worker_runs_in_a_thread_of_its_name(clock: VirtualClock, board: StatusRegistry) -> None:
    names: list[str] = []
    started = threading.Event()

    def deed(stop: threading.Event, _heartbeat: Callable[[], None]) -> None:
        names.append(threading.current_thread().name)
        started.set()
        stop.wait(PATIENCE_S)

    supervisor = Supervisor([Supervised(name="capture", make_worker=lambda: Doer(deed))], clock=clock, board=board)
    supervisor.start()
    assert started.wait(PATIENCE_S)
    assert on_board(board, "capture").state == "running"
    assert supervisor.stop() == ()
    assert names == ["capture"]
    assert on_board(board, "capture").state == "stopped"


def test_starting_and_stopping_twice_is_starting_and_stopping_once(clock: VirtualClock, board: StatusRegistry) -> None:
    started = threading.Event()
    factory = Factory([obey_and_tell(started)])
    supervisor = Supervisor([Supervised(name="detect", make_worker=factory)], clock=clock, board=board)
    supervisor.start()
    supervisor.start()
    assert started.wait(PATIENCE_S)
    assert supervisor.stop() == ()
    assert supervisor.stop() == ()
    supervisor.start()
    assert len(factory.made) == 1


def test_what_was_stopped_before_it_started_never_starts(clock: VirtualClock, board: StatusRegistry) -> None:
    factory = Factory([obey])
    supervisor = Supervisor([Supervised(name="detect", make_worker=factory)], clock=clock, board=board)
    assert supervisor.stop() == ()
    supervisor.start()
    assert supervisor._threads == []
    assert factory.made == []


def test_a_dead_worker_is_made_anew_and_the_others_notice_nothing(clock: VirtualClock, board: StatusRegistry) -> None:
    again, neighbour_runs = threading.Event(), threading.Event()
    mortal, neighbour = Factory([die, obey_and_tell(again)]), Factory([obey_and_tell(neighbour_runs)])
    supervisor = Supervisor(
        [Supervised(name="capture", make_worker=mortal), Supervised(name="detect", make_worker=neighbour)],
        clock=clock,
        board=board,
    )
    supervisor.start()
    assert again.wait(PATIENCE_S)
    assert neighbour_runs.wait(PATIENCE_S)
    assert mortal.made[0] is not mortal.made[1]
    assert len(neighbour.made) == 1
    status = on_board(board, "capture")
    assert (status.state, status.restarts, status.last_error) == ("running", 1, "OSError: the cable fell out")
    assert not supervisor.failed.is_set()
    assert supervisor.stop() == ()


def test_a_death_is_logged_once_with_its_stack(
    clock: VirtualClock, board: StatusRegistry, caplog: pytest.LogCaptureFixture
) -> None:
    again = threading.Event()
    factory = Factory([die, obey_and_tell(again)])
    supervisor = Supervisor([Supervised(name="capture", make_worker=factory)], clock=clock, board=board)
    with caplog.at_level(logging.ERROR):
        supervisor.start()
        assert again.wait(PATIENCE_S)
        supervisor.stop()
    assert [record.getMessage() for record in caplog.records] == ["capture died"]
    assert "the cable fell out" in caplog.text
    assert "in die" in caplog.text


def fail_to_make() -> Worker:
    raise OSError("no camera")


@pytest.mark.parametrize(
    ("make_worker", "last_error"),
    [
        (Factory([die]), "OSError: the cable fell out"),
        (Factory([lambda *_: None]), "returned without being asked to stop"),
        (Factory([lambda *_: sys.exit(7)]), "SystemExit: 7"),
        (fail_to_make, "OSError: no camera"),
    ],
    ids=["raises", "returns", "exits", "cannot be made"],
)
def test_a_worker_that_keeps_dying_and_is_essential_fails_with_a_reason(
    clock: VirtualClock, board: StatusRegistry, make_worker: Callable[[], Worker], last_error: str
) -> None:
    told = threading.Event()
    supervisor = Supervisor(
        [
            Supervised(
                name="capture",
                make_worker=make_worker,
                options=SupervisorOptions(max_restarts=3),
                essential=True,
                severity="not_ready",
            )
        ],
        clock=clock,
        board=board,
        on_failed=told.set,
    )
    supervisor.start()
    assert told.wait(PATIENCE_S)
    assert supervisor.failed.is_set()
    status = on_board(board, "capture")
    assert (status.state, status.restarts, status.last_error) == ("failed", 3, last_error)
    (reason,) = board.snapshot().reasons
    assert (reason.code, reason.severity) == ("worker_failed_capture", "not_ready")
    assert last_error in reason.text
    assert not supervisor.check()
    assert supervisor.stop() == ()
    assert on_board(board, "capture").state == "failed"


def test_the_failure_of_one_worker_leaves_the_others_running(clock: VirtualClock, board: StatusRegistry) -> None:
    told, runs = threading.Event(), threading.Event()
    supervisor = Supervisor(
        [
            Supervised(
                name="capture", make_worker=Factory([die]), options=SupervisorOptions(max_restarts=0), essential=True
            ),
            Supervised(name="detect", make_worker=Factory([obey_and_tell(runs)])),
        ],
        clock=clock,
        board=board,
        on_failed=told.set,
    )
    supervisor.start()
    assert told.wait(PATIENCE_S)
    assert runs.wait(PATIENCE_S)
    assert on_board(board, "detect").state == "running"
    assert supervisor.stop() == ()


def test_the_process_is_told_once_however_many_essential_workers_fail(
    clock: VirtualClock, board: StatusRegistry
) -> None:
    tellings: list[str] = []
    workers = [
        Supervised(name=name, make_worker=Factory([die]), options=SupervisorOptions(max_restarts=0), essential=True)
        for name in ("capture", "detect")
    ]
    supervisor = Supervisor(workers, clock=clock, board=board, on_failed=lambda: tellings.append("failed"))
    supervisor.start()
    for thread in supervisor._threads:
        thread.join(PATIENCE_S)
    assert tellings == ["failed"]
    assert {reason.code for reason in board.snapshot().reasons} == {"worker_failed_capture", "worker_failed_detect"}


def test_the_back_off_doubles_up_to_half_a_minute(clock: VirtualClock, board: StatusRegistry) -> None:
    births: list[float] = []

    def make_worker() -> Worker:
        births.append(clock.monotonic())
        return Doer(die)

    told = threading.Event()
    supervisor = Supervisor(
        [
            Supervised(
                name="capture",
                make_worker=make_worker,
                options=SupervisorOptions(max_restarts=7, within_s=1e6),
                essential=True,
            )
        ],
        clock=clock,
        board=board,
        on_failed=told.set,
    )
    supervisor.start()
    assert told.wait(PATIENCE_S)
    assert [after - before for before, after in pairwise(births)] == [1, 2, 4, 8, 16, 30, 30]


def test_what_is_outside_may_hinder_a_worker_for_as_long_as_it_takes(
    clock: VirtualClock, board: StatusRegistry
) -> None:
    def hindered(_stop: threading.Event, _heartbeat: Callable[[], None]) -> None:
        raise OutsideError("the disk is full")

    again = threading.Event()
    factory = Factory([*[hindered] * 20, obey_and_tell(again)])
    supervisor = Supervisor([Supervised(name="refit", make_worker=factory)], clock=clock, board=board)
    supervisor.start()
    assert again.wait(PATIENCE_S)
    (reason,) = board.snapshot().reasons
    assert (reason.code, reason.severity) == ("worker_hindered_refit", "degraded")
    assert "the disk is full" in reason.text
    assert not supervisor.failed.is_set()
    clock.advance(60.0)
    supervisor.check()
    assert board.snapshot().reasons == ()
    assert supervisor.stop() == ()


def test_rare_deaths_are_never_too_many(clock: VirtualClock, board: StatusRegistry) -> None:
    def die_late(_stop: threading.Event, _heartbeat: Callable[[], None]) -> None:
        clock.advance(601.0)
        raise OSError("the cable fell out")

    runs = threading.Event()
    factory = Factory([die_late] * 20 + [obey_and_tell(runs)])
    supervisor = Supervisor(
        [Supervised(name="capture", make_worker=factory, options=SupervisorOptions(max_restarts=1, within_s=600.0))],
        clock=clock,
        board=board,
    )
    supervisor.start()
    assert runs.wait(PATIENCE_S)
    assert not supervisor.failed.is_set()
    assert on_board(board, "capture").restarts == 20
    assert supervisor.stop() == ()


def stale_after_a_minute(deed: Deed, clock: VirtualClock, board: StatusRegistry) -> Supervisor:
    """Return a supervisor of one worker whose heartbeat may be 60 s old."""
    options = SupervisorOptions(stale_after_s=60.0)
    worker = Supervised(name="detect", make_worker=Factory([deed]), options=options)
    return Supervisor([worker], clock=clock, board=board)


def test_a_stuck_worker_is_a_reason_until_its_next_heartbeat(clock: VirtualClock, board: StatusRegistry) -> None:
    runs, beat, beaten = threading.Event(), threading.Event(), threading.Event()

    def deed(stop: threading.Event, heartbeat: Callable[[], None]) -> None:
        runs.set()
        assert beat.wait(PATIENCE_S)
        heartbeat()
        beaten.set()
        stop.wait(PATIENCE_S)

    supervisor = stale_after_a_minute(deed, clock, board)
    supervisor.start()
    assert runs.wait(PATIENCE_S)
    clock.advance(60.0)
    assert supervisor.check()
    clock.advance(1.0)
    assert not supervisor.check()
    (reason,) = board.snapshot().reasons
    assert (reason.code, reason.severity) == ("worker_stuck_detect", "not_ready")
    assert on_board(board, "detect").heartbeat_age_s == 61.0
    beat.set()
    assert beaten.wait(PATIENCE_S)
    assert supervisor.check()
    assert board.snapshot().reasons == ()
    assert supervisor.stop() == ()


def test_an_optional_worker_that_is_stuck_leaves_the_watchdog_fed_and_is_a_reason_of_its_own(
    clock: VirtualClock, board: StatusRegistry, release: threading.Event
) -> None:
    runs = threading.Event()

    def hang(_stop: threading.Event, heartbeat: Callable[[], None]) -> None:
        runs.set()
        assert release.wait(PATIENCE_S)
        heartbeat()

    worker = Supervised(
        name="feed", make_worker=Factory([hang]), options=SupervisorOptions(stale_after_s=60.0), optional=True
    )
    supervisor = Supervisor([worker], clock=clock, board=board)
    supervisor.start()
    assert runs.wait(PATIENCE_S)
    clock.advance(61.0)
    assert supervisor.check()
    (reason,) = board.snapshot().reasons
    assert (reason.code, reason.severity) == ("optional_worker_stuck_feed", "degraded")
    assert (reason.data["name"], reason.data["limit_s"]) == ("feed", 60.0)
    assert board.snapshot().health == "degraded"
    release.set()
    supervisor.stop()


def lives_of(n: int, *, then: Deed) -> Factory:
    """Return a factory of workers of which `n` die at once."""
    return Factory([*[die] * n, then])


def test_a_failed_worker_that_is_not_essential_is_retried_every_five_minutes_and_the_process_goes_on(
    board: StatusRegistry,
) -> None:
    clock, births = VirtualClock(START), list[float]()
    runs = threading.Event()

    def make_worker() -> Worker:
        births.append(clock.monotonic())
        return Doer(die if len(births) < 6 else obey_and_tell(runs))

    supervisor = Supervisor(
        [Supervised(name="watch", make_worker=make_worker, options=SupervisorOptions(max_restarts=2))],
        clock=clock,
        board=board,
        on_failed=lambda: pytest.fail("the process was to end"),
    )
    supervisor.start()
    assert runs.wait(PATIENCE_S)
    assert [after - before for before, after in pairwise(births)] == [1, 2, 300, 300, 300]
    assert not supervisor.failed.is_set()
    assert supervisor.check()  # the watchdog is fed
    (reason,) = board.snapshot().reasons
    assert (reason.code, reason.severity) == ("worker_failed_watch", "degraded")
    assert "the cable fell out" in reason.text
    clock.advance(30.0)
    supervisor.check()
    assert board.snapshot().reasons == (reason,)
    clock.advance(1.0)
    supervisor.check()
    assert board.snapshot().reasons == ()
    assert supervisor.stop() == ()


def test_a_worker_that_dies_again_is_a_condition_until_it_has_run_for_half_a_minute(
    clock: VirtualClock, board: StatusRegistry
) -> None:
    runs = threading.Event()
    worker = Supervised(name="detect", make_worker=lives_of(2, then=obey_and_tell(runs)), severity="not_ready")
    supervisor = Supervisor([worker], clock=clock, board=board)
    supervisor.start()
    assert runs.wait(PATIENCE_S)
    snapshot = board.snapshot()
    assert [reason.code for reason in snapshot.reasons] == ["worker_restarting_detect"]
    assert snapshot.health == "not_ready"
    clock.advance(31.0)
    supervisor.check()
    assert board.snapshot().health == "ready"
    assert supervisor.stop() == ()


class CheckedWhenRead(VirtualClock):
    """A clock on which the watchdog checks whenever a worker reads it, if nothing keeps it from it."""

    def __init__(self) -> None:
        super().__init__(START)
        self.supervisor: Supervisor | None = None

    def monotonic(self) -> float:
        now_s = super().monotonic()
        if self.supervisor is not None and threading.current_thread().name == "feed":
            check = threading.Thread(target=self.supervisor.check)
            check.start()
            check.join(0.05)
        return now_s


def test_a_check_at_a_birth_takes_back_nothing_that_was_said_of_the_lives_before(board: StatusRegistry) -> None:
    clock, told = CheckedWhenRead(), list[list[str]]()

    def live(stop: threading.Event, heartbeat: Callable[[], None]) -> None:
        told.append([reason.code for reason in board.snapshot().reasons])
        (die if len(told) < 6 else obey_and_tell(runs))(stop, heartbeat)

    runs = threading.Event()
    worker = Supervised(name="feed", make_worker=Factory([live]), options=SupervisorOptions(max_restarts=2))
    clock.supervisor = Supervisor([worker], clock=clock, board=board)
    clock.supervisor.start()
    assert runs.wait(PATIENCE_S)
    assert told == [[], [], ["worker_restarting_feed"], *[["worker_failed_feed"]] * 3]
    assert clock.supervisor.stop() == ()


def test_one_death_is_no_condition(clock: VirtualClock, board: StatusRegistry) -> None:
    runs = threading.Event()
    worker = Supervised(name="detect", make_worker=lives_of(1, then=obey_and_tell(runs)))
    supervisor = Supervisor([worker], clock=clock, board=board)
    supervisor.start()
    assert runs.wait(PATIENCE_S)
    assert board.snapshot().reasons == ()
    assert supervisor.stop() == ()


def test_a_monitored_loop_without_a_heartbeat_is_stuck_and_the_watchdog_not_fed(
    clock: VirtualClock, board: StatusRegistry
) -> None:
    heartbeat = Heartbeat(clock.monotonic)
    loop = Monitored(name="web", heartbeat=heartbeat, stale_after_s=30.0)
    supervisor = Supervisor([], clock=clock, board=board, watchdog=Watchdog(monitored=[loop]))
    clock.advance(30.0)
    assert supervisor.check()
    clock.advance(0.5)
    assert not supervisor.check()
    assert [(reason.code, reason.severity) for reason in board.snapshot().reasons] == [
        ("worker_stuck_web", "not_ready")
    ]
    assert on_board(board, "web").heartbeat_age_s == 30.5
    heartbeat.beat()
    assert supervisor.check()
    assert board.snapshot().reasons == ()


def test_what_a_periodic_check_raises_is_logged_and_the_watchdog_is_fed_all_the_same(
    board: StatusRegistry, caplog: pytest.LogCaptureFixture
) -> None:
    clock, meals = Turns(), list[float]()

    def fail() -> None:
        raise OSError("no such clock")

    with caplog.at_level(logging.ERROR):
        supervisor = Supervisor(
            [],
            clock=clock,
            board=board,
            watchdog=Watchdog(feed=lambda: meals.append(clock.monotonic()), on_check=[fail]),
        )
        supervisor.start()
        for _ in range(2):
            assert clock.turned.acquire(timeout=PATIENCE_S)
            clock.advance(1.0)
            clock.turn.release()
        assert clock.turned.acquire(timeout=PATIENCE_S)
        supervisor._stop.set()
        clock.turn.release()
        assert supervisor.stop() == ()
    assert meals == [0.0, 1.0, 2.0]
    assert "no such clock" in caplog.text


def test_being_stuck_is_logged_once(
    clock: VirtualClock, board: StatusRegistry, caplog: pytest.LogCaptureFixture, release: threading.Event
) -> None:
    runs = threading.Event()

    def deed(_stop: threading.Event, _heartbeat: Callable[[], None]) -> None:
        runs.set()
        release.wait(PATIENCE_S)

    supervisor = stale_after_a_minute(deed, clock, board)
    supervisor.start()
    assert runs.wait(PATIENCE_S)
    clock.advance(61.0)
    with caplog.at_level(logging.ERROR):
        assert not supervisor.check()
        assert not supervisor.check()
    (record,) = caplog.records
    assert "worker_stuck_detect" in record.getMessage()
    release.set()
    assert supervisor.stop() == ()


def test_blocked_workers_do_not_hold_up_the_stop(
    board: StatusRegistry, release: threading.Event, caplog: pytest.LogCaptureFixture
) -> None:
    run = threading.Semaphore(0)

    def deaf(_stop: threading.Event, _heartbeat: Callable[[], None]) -> None:
        run.release()
        release.wait(PATIENCE_S)

    clock, names = SystemClock(), tuple(f"deaf {n}" for n in range(8))
    workers = [Supervised(name=name, make_worker=Factory([deaf])) for name in names]
    supervisor = Supervisor(workers, clock=clock, board=board)
    supervisor.start()
    for _ in names:
        assert run.acquire(timeout=PATIENCE_S)
    with caplog.at_level(logging.ERROR):
        before_s = clock.monotonic()
        late = supervisor.stop(within_s=0.3)
        took_s = clock.monotonic() - before_s
    assert late == names
    assert 0.25 < took_s < 1.5  # 0.3 s in all, not for each of the eight
    assert "did not stop within 0.3 s" in caplog.text


def test_a_stop_interrupts_the_back_off(board: StatusRegistry) -> None:
    died = threading.Event()

    def deed(_stop: threading.Event, _heartbeat: Callable[[], None]) -> None:
        died.set()
        raise OSError("the cable fell out")

    clock = SystemClock()
    supervisor = Supervisor(
        [Supervised(name="capture", make_worker=Factory([deed]), options=SupervisorOptions(max_restarts=100))],
        clock=clock,
        board=board,
    )
    supervisor.start()
    assert died.wait(PATIENCE_S)
    before_s = clock.monotonic()
    assert supervisor.stop() == ()
    assert clock.monotonic() - before_s < 0.9  # the shortest back-off is 1 s


def test_a_worker_may_stop_its_own_supervisor(clock: VirtualClock, board: StatusRegistry) -> None:
    late: list[tuple[str, ...]] = []
    done = threading.Event()

    def stop_all() -> None:
        late.append(supervisor.stop())
        done.set()

    supervisor = Supervisor(
        [
            Supervised(
                name="capture", make_worker=Factory([die]), options=SupervisorOptions(max_restarts=0), essential=True
            )
        ],
        clock=clock,
        board=board,
        on_failed=stop_all,
    )
    supervisor.start()
    assert done.wait(PATIENCE_S)
    assert late == [()]


def test_the_watchdog_is_fed_while_all_are_alive(board: StatusRegistry) -> None:
    fed, runs = threading.Semaphore(0), threading.Event()
    supervisor = Supervisor(
        [Supervised(name="capture", make_worker=Factory([obey_and_tell(runs)]))],
        clock=SystemClock(),
        board=board,
        watchdog=Watchdog(feed=fed.release, every_s=0.001),
    )
    supervisor.start()
    for _ in range(5):
        assert fed.acquire(timeout=PATIENCE_S)
    assert runs.wait(PATIENCE_S)
    assert supervisor.stop() == ()


class Turns(VirtualClock):
    """A clock on which the watchdog takes one turn for every `turn.release`."""

    def __init__(self) -> None:
        super().__init__(START)
        self.turn = threading.Semaphore(0)
        self.turned = threading.Semaphore(0)

    def wait(self, stop: threading.Event, seconds: float) -> bool:
        del seconds
        self.turned.release()
        self.turn.acquire(timeout=PATIENCE_S)
        return stop.is_set()


def test_the_watchdog_goes_hungry_while_one_is_stuck(board: StatusRegistry) -> None:
    clock, runs, meals = Turns(), threading.Event(), list[float]()
    supervisor = Supervisor(
        [
            Supervised(
                name="capture",
                make_worker=Factory([obey_and_tell(runs)]),
                options=SupervisorOptions(stale_after_s=60.0),
            )
        ],
        clock=clock,
        board=board,
        watchdog=Watchdog(feed=lambda: meals.append(clock.monotonic())),
    )
    supervisor.start()
    assert runs.wait(PATIENCE_S)
    assert clock.turned.acquire(timeout=PATIENCE_S)
    for _ in range(4):
        clock.advance(25.0)
        clock.turn.release()
        assert clock.turned.acquire(timeout=PATIENCE_S)
    assert meals == [0.0, 25.0, 50.0]
    supervisor._stop.set()
    clock.turn.release()
    assert supervisor.stop() == ()


def test_two_workers_of_one_name_are_refused(clock: VirtualClock, board: StatusRegistry) -> None:
    twins = [Supervised(name="capture", make_worker=Factory([obey])) for _ in range(2)]
    with pytest.raises(ValueError, match="same name"):
        Supervisor(twins, clock=clock, board=board)
