"""Disk space and temperature from the status into the archive, also over a full disk and a wrong clock."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from dataclasses import dataclass
from datetime import datetime, timedelta
from pathlib import Path

import pytest
from tests.fixtures.archive import new_archive
from tests.fixtures.board import START, board, clock

from sunarc.common.errors import OutsideError
from sunarc.imager.archive.archive import Archive, CameraArchive
from sunarc.imager.runtime.clock import VirtualClock
from sunarc.imager.runtime.status import CameraStatus, DiskStatus, StatusRegistry
from sunarc.imager.workers.upkeep import HousekeepingWorker
from sunarc.sky.site import Site

__all__ = ["board", "clock"]


@dataclass
class Bench:
    archive: Archive
    camera: CameraArchive
    clock: VirtualClock
    board: StatusRegistry
    trusted: bool = True

    def now(self) -> datetime | None:
        return self.clock.now() if self.trusted else None

    def worker(self) -> HousekeepingWorker:
        return HousekeepingWorker(
            camera=self.camera, clock=self.clock, now=self.now, age_from=self.now, board=self.board
        )

    def pass_time(
        self, worker: HousekeepingWorker, seconds: float, *, free: int = 50, degrees: float | None = 40.0
    ) -> None:
        """Let time pass with looks every 10 s, with one state of disk and camera."""
        self.board.note(
            disk=DiskStatus(free_bytes=free, images_bytes=7),
            camera=CameraStatus(name="roof", connected=True, temperature_c=degrees),
        )
        for _ in range(round(seconds / 10.0)):
            worker.step()
            self.clock.advance(10.0)


@pytest.fixture
def bench(tmp_path: Path, clock: VirtualClock, board: StatusRegistry) -> Iterator[Bench]:
    with new_archive(tmp_path) as archive:
        yield Bench(
            archive, CameraArchive(archive, name="roof", site=Site(latitude=36.6, longitude=-97.5)), clock, board
        )


def test_an_hour_has_its_mean_least_and_greatest(bench: Bench) -> None:
    worker = bench.worker()
    bench.pass_time(worker, 1800.0, free=50, degrees=40.0)
    bench.pass_time(worker, 1800.0, free=30, degrees=44.0)
    bench.pass_time(worker, 700.0, free=20, degrees=None)
    later, hour = bench.archive.housekeeping.find("roof", step="hour")
    assert (hour.time, hour.disk_free_bytes, hour.images_bytes) == (START, 30, 7)
    assert (hour.temperature_min_c, hour.temperature_max_c, hour.n_temperatures) == (40.0, 44.0, 360)
    assert hour.temperature_c == pytest.approx(42.0)
    assert (later.disk_free_bytes, later.temperature_c, later.n_temperatures) == (20, None, 0)


def test_a_kill_loses_ten_minutes_at_most_and_a_stop_nothing(bench: Bench) -> None:
    bench.pass_time(bench.worker(), 1500.0)  # killed
    assert bench.archive.housekeeping.find("roof", step="hour")[0].n_temperatures == pytest.approx(121, abs=1)
    again = bench.worker()
    bench.pass_time(again, 100.0)
    stop = threading.Event()
    stop.set()
    again.run(stop, lambda: None)
    assert bench.archive.housekeeping.find("roof", step="hour")[0].n_temperatures == pytest.approx(131, abs=1)


def test_an_hour_that_has_ended_is_stored_at_once(bench: Bench) -> None:
    bench.clock.advance(3500.0)
    worker = bench.worker()
    bench.pass_time(worker, 100.0)
    assert bench.archive.housekeeping.find("roof", step="hour") == ()
    bench.pass_time(worker, 10.0)
    assert bench.archive.housekeeping.find("roof", step="hour")[-1].n_temperatures == 10


def test_what_a_full_disk_refuses_waits_and_is_stored_later(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    worker = bench.worker()

    def refuse(*_: object) -> None:
        raise OutsideError("the disk is full")

    with monkeypatch.context() as full:
        full.setattr(bench.archive.housekeeping, "add", refuse)
        bench.pass_time(worker, 2 * 3600.0, free=0)
        assert bench.archive.housekeeping.find("roof", step="hour") == ()
    bench.pass_time(worker, 620.0, free=90)
    hours = bench.archive.housekeeping.find("roof", step="hour")
    assert [one.n_temperatures for one in hours[1:]] == [360, 360]
    assert [one.disk_free_bytes for one in hours] == [90, 0, 0]


def test_nothing_is_dated_by_a_clock_that_is_not_trusted(bench: Bench) -> None:
    worker = bench.worker()
    bench.trusted = False
    bench.pass_time(worker, 1300.0)
    assert bench.archive.housekeeping.find("roof", step="hour") == ()
    bench.trusted = True
    bench.pass_time(worker, 700.0)
    assert len(bench.archive.housekeeping.find("roof", step="hour")) == 1


def test_without_disk_and_camera_there_is_nothing_to_store(bench: Bench) -> None:
    worker = bench.worker()
    for _ in range(100):
        worker.step()
        bench.clock.advance(10.0)
    assert bench.archive.housekeeping.find("roof", step="hour") == ()


def test_old_hours_are_removed_as_time_goes_on(bench: Bench) -> None:
    worker = bench.worker()
    bench.pass_time(worker, 700.0)
    bench.clock.advance(93 * 86400.0)
    bench.pass_time(worker, 700.0)
    assert [one.time for one in bench.archive.housekeeping.find("roof", step="hour")] == [START + timedelta(days=93)]
    assert len(bench.archive.housekeeping.find("roof", step="day")) == 2
