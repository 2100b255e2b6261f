"""Since when conditions hold, over restarts of the service."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from datetime import datetime, timedelta
from pathlib import Path

import pytest
from tests.fixtures.archive import new_archive
from tests.fixtures.board import START, status_registry

from sunarc.common.errors import OutsideError
from sunarc.imager.archive.archive import Archive
from sunarc.imager.runtime.clock import VirtualClock
from sunarc.imager.runtime.status import Reason, StatusRegistry
from sunarc.imager.workers.upkeep import ConditionTimesWorker

LOW = Reason(code="disk_low", severity="degraded", text="the disk is full", remedy="free some space")
LATE = Reason(code="no_sightings", severity="degraded", text="none", remedy="look")


@dataclass
class Bench:
    archive: Archive
    clock: VirtualClock
    board: StatusRegistry
    worker: ConditionTimesWorker

    def start(self) -> None:
        """Begin a life of the service."""
        self.board = status_registry(self.clock)
        self.worker = worker(self.archive, self.clock, self.board)

    def pass_time(self, seconds: float) -> None:
        for _ in range(round(seconds / 10.0)):
            self.worker.step()
            self.clock.advance(10.0)

    def since(self, code: str) -> datetime | None:
        return next(one.since for one in self.board.snapshot().reasons if one.code == code)


def worker(archive: Archive, clock: VirtualClock, board: StatusRegistry) -> ConditionTimesWorker:
    return ConditionTimesWorker(archive=archive, camera="roof", board=board, clock=clock, passing=["no_frame_yet"])


@pytest.fixture
def bench(tmp_path: Path) -> Iterator[Bench]:
    clock = VirtualClock(START)
    board = status_registry(clock)
    with new_archive(tmp_path) as archive:
        yield Bench(archive, clock, board, worker(archive, clock, board))


def test_a_condition_that_holds_over_restarts_keeps_its_beginning(bench: Bench) -> None:
    bench.board.set_condition("disk_low", LOW)
    bench.pass_time(100.0)
    for _ in range(3):
        bench.clock.advance(3600.0)
        bench.start()
        bench.pass_time(300.0)  # it is found again after some minutes
        bench.board.set_condition("disk_low", LOW)
        assert bench.since("disk_low") == START
        bench.pass_time(1000.0)
    assert bench.archive.conditions.times("roof") == {"disk_low": START}


def test_a_condition_that_was_set_before_the_store_could_be_read_keeps_its_beginning_too(
    bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    bench.board.set_condition("disk_low", LOW)
    bench.pass_time(100.0)

    def refuse(_: str) -> None:
        raise OutsideError("the database does not answer")

    with monkeypatch.context() as away:
        away.setattr(bench.archive.conditions, "times", refuse)
        bench.start()
        bench.board.set_condition("disk_low", LOW)
        bench.pass_time(50.0)
        assert bench.since("disk_low") != START
    bench.pass_time(10.0)
    assert bench.since("disk_low") == START


def test_one_that_ended_begins_anew(bench: Bench) -> None:
    bench.board.set_condition("disk_low", LOW)
    bench.pass_time(100.0)
    bench.start()
    bench.board.set_condition("disk_low", LOW)
    bench.board.set_condition("disk_low", None)
    bench.pass_time(100.0)
    assert bench.archive.conditions.times("roof") == {}
    bench.board.set_condition("disk_low", LOW)
    assert bench.since("disk_low") == bench.clock.now()


@pytest.mark.parametrize(("after_s", "goes_on"), [(880.0, True), (920.0, False)])
def test_one_that_is_not_found_again_within_a_quarter_of_an_hour_has_ended(
    bench: Bench, after_s: float, *, goes_on: bool
) -> None:
    bench.board.set_condition("no_sightings", LATE)
    bench.pass_time(100.0)
    bench.start()
    bench.pass_time(after_s)
    assert (bench.archive.conditions.times("roof") == {"no_sightings": START}) is goes_on
    bench.board.set_condition("no_sightings", LATE)
    assert (bench.since("no_sightings") == START) is goes_on


def test_one_that_comes_and_goes_is_never_written(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    written: list[object] = []
    monkeypatch.setattr(bench.archive.conditions, "replace_since", lambda *args: written.append(args))
    for _ in range(20):
        bench.board.set_condition("disk_low", LOW)
        bench.pass_time(50.0)
        bench.board.set_condition("disk_low", None)
        bench.pass_time(50.0)
    assert written == []


def test_what_concerns_one_run_alone_is_not_stored(bench: Bench) -> None:
    first = Reason(code="no_frame_yet", severity="degraded", text="no frame", remedy="wait")
    bench.board.set_condition("no_frame_yet", first)
    bench.pass_time(200.0)
    assert bench.archive.conditions.times("roof") == {}


def test_a_full_disk_delays_the_writing_alone(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: object) -> None:
        raise OutsideError("the disk is full")

    bench.board.set_condition("disk_low", LOW)
    with monkeypatch.context() as full:
        full.setattr(bench.archive.conditions, "replace_since", refuse)
        bench.pass_time(200.0)
    bench.pass_time(20.0)
    assert bench.archive.conditions.times("roof") == {"disk_low": START}


def test_a_beginning_that_lies_ahead_of_the_clock_is_now(bench: Bench) -> None:
    bench.archive.conditions.replace_since("roof", {"disk_low": START + timedelta(days=1)})
    bench.start()
    bench.board.set_condition("disk_low", LOW)
    assert bench.since("disk_low") == START
