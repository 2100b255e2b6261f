from __future__ import annotations

import threading
from collections.abc import Callable
from dataclasses import dataclass, field

import pytest

from sunarc.common.errors import OutsideError
from sunarc.common.findings import Finding
from sunarc.imager.runtime.clock import VirtualClock
from sunarc.imager.runtime.loop import Attempts, DropOldestQueue, Loop, Pauses, entries
from sunarc.imager.runtime.status import Reason, StatusRegistry


@dataclass
class Beats:
    """Heartbeats by the clock; the loop is stopped at a time."""

    clock: VirtualClock
    stop_at_s: float
    stop: threading.Event = field(default_factory=threading.Event)
    at_s: list[float] = field(default_factory=list)

    def __call__(self) -> None:
        self.at_s.append(self.clock.monotonic())
        if self.clock.monotonic() >= self.stop_at_s:
            self.stop.set()

    @property
    def loop(self) -> Loop:
        return Loop(self.clock, self.stop, self)


def attempts(clock: VirtualClock, board: StatusRegistry, *, after_s: float = 0.0) -> Attempts:
    def reason(error: str, hours: float) -> Reason:
        return Reason.of(Finding("hub_unreachable", {"error": error, "hours": hours}), code="failing")

    return Attempts(clock, Pauses(2.0, 15.0), board=board, code="failing", reason=reason, after_s=after_s)


def fail() -> None:
    raise OutsideError("no answer")


def codes(board: StatusRegistry) -> set[str]:
    return {reason.code for reason in board.snapshot().reasons}


def test_work_is_done_every_so_often_until_stopped(clock: VirtualClock) -> None:
    beats, done_at = Beats(clock, stop_at_s=25.0), list[float]()
    beats.loop.every(10.0, lambda: done_at.append(clock.monotonic()))
    assert done_at == [0.0, 10.0, 20.0]


def test_a_stop_ends_a_wait_at_once(clock: VirtualClock) -> None:
    beats = Beats(clock, stop_at_s=3.0)
    assert beats.loop.wait(1000.0)
    assert clock.monotonic() == 3.0


def test_a_stopped_loop_neither_works_nor_waits(clock: VirtualClock) -> None:
    beats = Beats(clock, stop_at_s=1e9)
    beats.stop.set()
    beats.loop.every(1.0, fail)
    assert beats.loop.wait(10.0)
    assert clock.monotonic() == 0.0


def test_a_long_wait_beats_every_second(clock: VirtualClock) -> None:
    beats = Beats(clock, stop_at_s=1e9)
    assert not beats.loop.wait(5.5)
    assert beats.at_s == [0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 5.5]


def test_failures_in_a_row_are_a_condition_and_make_pauses_grow_until_success_clears_both(
    clock: VirtualClock, board: StatusRegistry
) -> None:
    beats, tried_at, seen = Beats(clock, stop_at_s=100.0), list[float](), list[set[str]]()
    worker = attempts(clock, board)

    def work() -> None:
        seen.append(codes(board))
        tried_at.append(clock.monotonic())
        if 5.0 < clock.monotonic() < 50.0:
            raise OutsideError("no answer")

    beats.loop.repeat(lambda: worker.attempt(work))
    assert tried_at[:9] == [0.0, 2.0, 4.0, 6.0, 8.0, 12.0, 20.0, 35.0, 50.0]
    assert tried_at[9:11] == [52.0, 54.0]
    assert seen[3:10] == [set(), *[{"failing"}] * 5, set()]


def test_failures_are_a_condition_only_once_they_have_lasted(clock: VirtualClock, board: StatusRegistry) -> None:
    worker = attempts(clock, board, after_s=60.0)
    clock.advance(59.0)
    worker.attempt(fail)
    assert codes(board) == set()
    clock.advance(2.0)
    worker.attempt(fail)
    assert [reason.data["hours"] for reason in board.snapshot().reasons] == [pytest.approx(61.0 / 3600.0)]
    worker.answered()
    clock.advance(59.0)
    worker.attempt(lambda: None)
    assert codes(board) == set()


def test_work_that_says_when_it_goes_on_is_done_then(clock: VirtualClock, board: StatusRegistry) -> None:
    worker = attempts(clock, board)
    assert worker.attempt(lambda: 0.0) == 0.0
    assert worker.attempt(lambda: None) == 2.0


def test_what_is_no_failure_from_outside_ends_the_loop(clock: VirtualClock, board: StatusRegistry) -> None:
    def work() -> None:
        raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        Beats(clock, stop_at_s=9.0).loop.repeat(lambda: attempts(clock, board).attempt(work))
    assert codes(board) == set()


@pytest.mark.parametrize(("failures", "pause_s"), [(1, 1.0), (2, 2.0), (5, 16.0), (6, 30.0), (10_000, 30.0)])
def test_pauses_double_up_to_the_longest(failures: int, pause_s: float) -> None:
    assert Pauses(1.0, 30.0).after(failures) == pause_s


def test_what_waits_in_a_queue_is_taken_before_the_end() -> None:
    queue: DropOldestQueue[int] = DropOldestQueue(capacity=3)
    stop, beats = threading.Event(), list[int]()
    for entry in (1, 2, 3):
        queue.put(entry)
    stop.set()
    heartbeat: Callable[[], None] = lambda: beats.append(1)  # noqa: E731 - a name for its type
    taken = [*entries(queue, stop, heartbeat)]
    assert taken == [1, 2, 3]
    assert len(beats) == 4


def test_an_empty_queue_is_looked_at_again_until_stopped() -> None:
    queue: DropOldestQueue[int] = DropOldestQueue(capacity=3)
    stop = threading.Event()
    taken = list[int | None]()
    for entry in entries(queue, stop, lambda: None):
        taken.append(entry)
        stop.set()
    assert taken == [None]


def test_things_come_out_in_the_order_they_went_in() -> None:
    queue: DropOldestQueue[int] = DropOldestQueue(capacity=3)
    for thing in (1, 2, 3):
        queue.put(thing)
    assert [queue.get(timeout_s=0.0) for _ in range(3)] == [1, 2, 3]


def test_a_full_queue_drops_its_oldest_and_counts_it() -> None:
    queue: DropOldestQueue[int] = DropOldestQueue(capacity=2)
    for thing in (1, 2, 3):
        queue.put(thing)
    assert queue.dropped == 1
    assert [queue.get(timeout_s=0.0), queue.get(timeout_s=0.0)] == [2, 3]


def test_an_empty_queue_answers_none_in_time() -> None:
    assert DropOldestQueue[int](capacity=1).get(timeout_s=0.01) is None


def test_a_waiting_reader_is_woken_by_a_writer() -> None:
    queue: DropOldestQueue[str] = DropOldestQueue(capacity=1)
    got: list[str | None] = []
    reader = threading.Thread(target=lambda: got.append(queue.get(timeout_s=10.0)))
    reader.start()
    queue.put("frame")
    reader.join(timeout=5.0)
    assert got == ["frame"]
