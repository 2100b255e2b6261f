"""The worker that sends the outbox: whatever the hub and the network do, every row arrives once."""

from __future__ import annotations

import random
import threading
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from http import HTTPStatus
from pathlib import Path

import pytest
from tests.fixtures.archive import make_empty
from tests.fixtures.fleet import NOW, new_imager, sighting

from sunarc.archive import (
    Archive,
    CameraArchive,
    FeedBatch,
    FeedRow,
    OutboxPosition,
    Refusal,
    feed_lines,
    open_archive,
    read_feed_lines,
)
from sunarc.errors import ConfigurationError, InputError, OutsideError
from sunarc.runtime.clock import VirtualClock
from sunarc.runtime.status import StatusRegistry
from sunarc.sky import Site
from sunarc.workers import FeedWorker, HubConnection, HubOptions
from sunarc.workers.feeding.feed import _LONGEST_WAIT_S, _SILENT_S
from sunarc.workers.feeding.hub_connection import HubRefusal


@dataclass
class Wire:
    """Carries rows to a hub's archive, with the faults that it is told to have."""

    hub: Archive
    faults: list[str] = field(default_factory=list)
    most_rows: int = 10**6
    late: list[FeedBatch] = field(default_factory=list)

    def __call__(self, position: OutboxPosition, rows: Sequence[FeedRow]) -> int:
        fault = self.faults.pop(0) if self.faults else ""
        if fault == "cut":
            raise OutsideError("the network is gone")
        if fault == "refused":
            raise HubRefusal(401, "forged_token: …")
        if len(rows) > max(self.most_rows, 1) or (self.most_rows == 0 and rows[0].data is not None):
            raise HubRefusal(HTTPStatus.REQUEST_ENTITY_TOO_LARGE, "too large")
        arrived = read_feed_lines(feed_lines(rows), after=position.committed)
        batch = FeedBatch(camera="roof", installation=position.installation, after=position.committed, rows=arrived)
        if fault == "late":
            self.late.append(batch)
            raise OutsideError("no answer; what was sent arrives later")
        committed = self.hub.take_feed(batch, now=NOW)
        for late in self.late:
            self.hub.take_feed(late, now=NOW)
        self.late.clear()
        if fault == "answer_lost":
            raise OutsideError("the answer did not come back")
        if isinstance(committed, Refusal):
            raise HubRefusal(409, committed.text)
        return committed


@dataclass
class Bench:
    imager: Archive
    hub: Archive
    wire: Wire
    clock: VirtualClock
    board: StatusRegistry

    def worker(self) -> FeedWorker:
        camera = CameraArchive(self.imager, name="roof", site=Site(latitude=36.6, longitude=-97.5))
        return FeedWorker(camera=camera, send=self.wire, clock=self.clock, board=self.board)

    def codes(self) -> set[str]:
        return {reason.code for reason in self.board.snapshot().reasons}


@pytest.fixture
def bench(tmp_path: Path) -> Iterator[Bench]:
    make_empty(tmp_path / "hub.sqlite")
    clock = VirtualClock(NOW)
    board = StatusRegistry(version="1", started_at=NOW, monotonic=clock.monotonic)
    with new_imager(tmp_path) as imager, open_archive(tmp_path / "hub.sqlite") as hub:
        yield Bench(imager, hub, Wire(hub), clock, board)


def send_all(worker: FeedWorker) -> None:
    for _ in range(200):
        if worker.step() > 0.0:
            return
    pytest.fail("it does not end")


def test_rows_arrive_and_are_forgotten_and_the_fleet_learns_of_the_imager(bench: Bench) -> None:
    bench.imager.add_sun_points(sighting(n) for n in range(5))
    send_all(bench.worker())
    assert bench.hub.sun_points("roof") == bench.imager.sun_points("roof")
    assert bench.imager.outbox_waiting() == 0
    (camera,) = bench.hub.fleet()
    assert camera.status is not None
    assert (camera.status["health"], camera.status["conditions"]) == ("ready", [])


def test_with_nothing_new_nothing_is_sent_but_a_status_each_minute(bench: Bench) -> None:
    worker = bench.worker()
    send_all(worker)
    bench.wire.faults = ["cut"]
    assert worker.step() == 5.0
    assert bench.wire.faults == ["cut"]  # nothing was sent
    bench.clock.advance(61.0)
    worker.step()
    assert bench.wire.faults == []


@pytest.mark.parametrize("seed", range(6))
def test_cuts_lost_answers_and_late_repetitions_lose_and_double_nothing(bench: Bench, seed: int) -> None:
    chance, worker = random.Random(seed), bench.worker()
    for n in range(60):
        bench.imager.add_sun_points([sighting(n)])
        bench.wire.faults = chance.choices(["", "cut", "answer_lost", "late", "refused"], k=2)
        if chance.random() < 0.1:
            worker = bench.worker()  # the process was killed and began again
        worker.step()
    bench.wire.faults.clear()
    send_all(worker)
    send_all(worker)
    assert bench.hub.sun_points("roof") == bench.imager.sun_points("roof")
    assert len(bench.hub.sun_points("roof")) == 60
    assert {found.reason for found in bench.hub.quarantine()} <= {"gap"}
    assert bench.imager.outbox_waiting() == 0


@pytest.mark.parametrize("most_rows", [1, 3, 0])
def test_batches_become_smaller_until_the_hub_takes_them_and_one_row_that_is_too_large_is_passed(
    bench: Bench, most_rows: int
) -> None:
    bench.imager.add_sun_points(sighting(n) for n in range(7))
    bench.wire.most_rows = most_rows
    if most_rows == 0:  # not even one: they go as numbers
        worker = bench.worker()
        for _ in range(60):
            worker.step()
        assert {found.reason for found in bench.hub.quarantine()} == {"body_too_large"}
        return
    send_all(bench.worker())
    assert len(bench.hub.sun_points("roof")) == 7


def test_a_hub_that_was_put_back_gets_all_again(bench: Bench) -> None:
    bench.imager.add_sun_points(sighting(n) for n in range(7))
    worker = bench.worker()
    send_all(worker)
    bench.hub.ask_again("roof")
    bench.imager.add_sun_points([sighting(8)])
    send_all(worker)
    assert len(bench.hub.sun_points("roof")) == 8
    assert bench.imager.outbox_position().committed > 15


def test_an_imager_that_was_put_back_goes_on_as_another_installation(bench: Bench, tmp_path: Path) -> None:
    send_all(bench.worker())
    bench.imager.close()
    copy = (tmp_path / "roof.sqlite").read_bytes()
    bench.imager.add_sun_points(sighting(n) for n in range(7))
    send_all(bench.worker())
    former = bench.imager.outbox_position().installation
    bench.imager.close()
    for ending in ("", "-wal", "-shm"):
        (tmp_path / f"roof.sqlite{ending}").unlink(missing_ok=True)
    (tmp_path / "roof.sqlite").write_bytes(copy)
    with open_archive(tmp_path / "roof.sqlite") as again:
        bench.imager = again
        again.add_sun_points([sighting(100)])
        worker = bench.worker()
        worker.step()
        own = again.outbox_position().installation
        assert own != former
        worker.step()
        assert [found.reason for found in bench.hub.quarantine()] == ["second_installation"]
        assert "hub_refuses" in bench.codes()
        bench.hub.accept_installation("roof", own, now=NOW)
        bench.clock.advance(100.0)
        send_all(worker)
        assert len(bench.hub.sun_points("roof")) == 8
        assert bench.codes() == set()


def test_a_hub_that_is_silent_for_long_is_a_condition_and_is_asked_at_most_once_a_minute(bench: Bench) -> None:
    worker, bench.wire.faults = bench.worker(), ["cut"] * 100
    waits = [worker.step() for _ in range(12)]
    assert waits[:3] == [5.0, 10.0, 20.0]
    assert max(waits) == _LONGEST_WAIT_S
    assert bench.codes() == set()
    bench.clock.advance(_SILENT_S)
    worker.step()
    assert bench.codes() == {"hub_unreachable"}
    bench.wire.faults.clear()
    worker.step()
    assert bench.codes() == set()


def test_it_runs_until_it_is_stopped(bench: Bench) -> None:
    stop, beats = threading.Event(), []

    def beat() -> None:
        beats.append(1)
        if len(beats) > 20:
            stop.set()

    bench.worker().run(stop, beat)
    assert len(beats) >= 20
    assert bench.imager.outbox_waiting() == 0


@pytest.mark.parametrize("url", ["", "fleet.example", "ftp://x", "http://", "https://a?b=c", "https://me@x"])
def test_an_address_that_is_none_is_refused(url: str) -> None:
    with pytest.raises(InputError) as error:
        HubOptions(url=url, token_file=Path("x"))
    assert error.value.field == "hub.url"


def test_a_hub_needs_a_token_that_can_be_read(tmp_path: Path) -> None:
    with pytest.raises(InputError):
        HubOptions(url="https://fleet.example")
    with pytest.raises(ConfigurationError):
        HubConnection(HubOptions(url="https://fleet.example", token_file=tmp_path / "none"), camera="roof")
