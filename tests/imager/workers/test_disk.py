"""The keeping of the disk."""

from __future__ import annotations

import threading
from datetime import datetime, timedelta
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from sunarc.imager.archive.database.store import Reserve
from sunarc.imager.archive.images import DiskOptions, DiskUsage, ImageStore
from sunarc.imager.workers.upkeep import DiskWorker

from .conftest import NOON

if TYPE_CHECKING:
    from collections.abc import Callable

    from sunarc.imager.runtime.clock import VirtualClock
    from sunarc.imager.runtime.status import StatusRegistry

OPTIONS = DiskOptions(keep_days=10.0, keep_free_mb=2.0, reserve_mb=1.0)
MB = bytes(1_000_000)


class Disk:
    """A small disk: what others took of it, and the state folder."""

    def __init__(self, folder: Path) -> None:
        self.others_bytes = 0
        self.folder = folder

    def free(self, _: Path) -> int:
        ours = sum(path.stat().st_size for path in self.folder.rglob("*") if path.is_file())
        return 8_000_000 - self.others_bytes - ours


@pytest.fixture
def disk(tmp_path: Path) -> Disk:
    return Disk(tmp_path)


@pytest.fixture
def store(disk: Disk) -> ImageStore:
    return ImageStore(disk.folder / "images", options=OPTIONS, free_bytes=disk.free)


def worker_of(
    store: ImageStore, clock: VirtualClock, board: StatusRegistry, age_from: Callable[[], datetime | None] | None = None
) -> DiskWorker:
    return DiskWorker(
        store=store,
        reserve=Reserve(store.folder.parent / "reserve", size_bytes=1_000_000),
        options=OPTIONS,
        clock=clock,
        age_from=age_from or clock.now,
        board=board,
    )


def reasons(board: StatusRegistry) -> set[str]:
    return {reason.code for reason in board.snapshot().reasons}


def test_others_take_the_disk_images_go_then_the_reserve_and_all_comes_back(
    disk: Disk, store: ImageStore, clock: VirtualClock, board: StatusRegistry
) -> None:
    worker = worker_of(store, clock, board)
    for hour in range(3):
        store.write(NOON - timedelta(hours=hour), MB, kind="hdr.png")
    worker.check()
    shown = board.snapshot().disk
    assert shown is not None
    assert (shown.images_bytes, shown.free_bytes) == (3_000_000, 5_000_000)  # the reserve is taken at the end of a look
    disk.others_bytes = 3_500_000
    worker.check()
    assert store.usage().images_bytes == 1_000_000
    assert reasons(board) == set()
    disk.others_bytes = 6_000_000
    worker.check()
    assert store.usage().images_bytes == 0
    assert reasons(board) == {"disk_low"}
    data = board.snapshot().reasons[0].data
    assert data["lacking_mb"] == pytest.approx(OPTIONS.keep_free_mb - float(data["free_mb"]))
    assert float(data["lacking_mb"]) > 0.0
    assert data["folder"] == str(store.folder)
    disk.others_bytes = 6_900_000
    worker.check()
    assert reasons(board) == {"disk_full"}
    assert disk.free(disk.folder) == 1_100_000  # what was reserved
    disk.others_bytes = 0
    worker.check()
    assert reasons(board) == set()
    assert disk.free(disk.folder) == 7_000_000


def test_old_images_are_removed_but_not_by_a_clock_that_cannot_be_trusted(
    store: ImageStore, clock: VirtualClock, board: StatusRegistry
) -> None:
    for age_days in range(12):
        store.write(NOON - timedelta(days=age_days), b"composite", kind="hdr.png")
    worker_of(store, clock, board, age_from=lambda: None).check()
    assert oldest_days(store) == 11
    worker_of(store, clock, board).check()
    assert oldest_days(store) == 10


def test_a_clock_that_is_a_year_ahead_removes_one_date_of_images_a_day_at_most(
    store: ImageStore, clock: VirtualClock, board: StatusRegistry
) -> None:
    for age_days in range(10):
        store.write(NOON - timedelta(days=age_days), b"composite", kind="hdr.png")
    ahead = NOON + timedelta(days=400)
    worker_of(store, clock, board, age_from=lambda: ahead).check()
    assert oldest_days(store) == 9
    store.write(ahead, b"composite", kind="hdr.png")
    worker_of(store, clock, board, age_from=lambda: ahead).check()
    assert oldest_days(store) == 8
    worker_of(store, clock, board).check()  # right again: what is dated in the future makes nothing old
    assert oldest_days(store) == 8


def oldest_days(store: ImageStore) -> int:
    oldest = store.usage().oldest_image_at
    assert oldest is not None
    return (NOON - oldest).days


def test_it_checks_every_five_seconds_until_stopped(
    store: ImageStore, clock: VirtualClock, board: StatusRegistry, monkeypatch: pytest.MonkeyPatch
) -> None:
    worker, stop, looks, usage = worker_of(store, clock, board), threading.Event(), list[float](), store.usage

    def look() -> DiskUsage:
        looks.append(clock.monotonic())
        return usage()

    monkeypatch.setattr(store, "usage", look)
    worker.run(stop, lambda: stop.set() if clock.monotonic() > 35.0 else None)
    assert looks == pytest.approx([0.0, 5.0, 10.0, 15.0, 20.0, 25.0, 30.0, 35.0])
