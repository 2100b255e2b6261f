"""An imager whose database takes no row says so within a minute, by night too, and writes hardly more for it."""

from __future__ import annotations

import os
import shutil
import sqlite3
import subprocess
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from dataclasses import replace
from pathlib import Path

import pytest
from sqlalchemy import event
from tests.fixtures.archive import new_archive

from sunarc.imager.archive.archive import Archive
from sunarc.imager.archive.database import store
from sunarc.imager.archive.values import Housekeeping
from sunarc.imager.runtime.clock import VirtualClock
from sunarc.imager.runtime.status import StatusRegistry
from sunarc.imager.workers.upkeep import PATIENCE_S, QUIET_S, StoreRoomWorker

from .conftest import NOON

PAGE_BYTES = 4096 + 24
"""Of the file's log."""


@contextmanager
def running(command: list[str], undone: list[str]) -> Iterator[None]:
    done = subprocess.run(command, check=False, capture_output=True)
    if done.returncode:
        pytest.skip(f"this cannot be done here: {done.stderr.decode().strip()}")
    try:
        yield
    finally:
        subprocess.run(undone, check=False)


@pytest.fixture
def disk(tmp_path: Path) -> Iterator[Path]:
    """Yield a small disk of its own."""
    if os.geteuid() != 0 or shutil.which("mkfs.ext4") is None:
        pytest.skip("a disk of its own needs root, and mkfs.ext4")
    image, folder = tmp_path / "image", tmp_path / "disk"
    folder.mkdir()
    with image.open("wb") as file:
        file.truncate(24 << 20)
    subprocess.run(["mkfs.ext4", "-q", "-O", "^has_journal", image], check=True)
    with running(["mount", "-o", "loop", str(image), str(folder)], ["umount", "--lazy", str(folder)]):
        yield folder


def worker_of(archive: Archive, clock: VirtualClock, board: StatusRegistry) -> StoreRoomWorker:
    """Return the worker as an imager has it."""
    return StoreRoomWorker(
        archive=archive, clock=clock, board=board, severity="degraded", quiet_s=QUIET_S, patience_s=PATIENCE_S
    )


def looks(worker: StoreRoomWorker, clock: VirtualClock, seconds: float) -> None:
    """Let time pass, with a look every 2 s."""
    for _ in range(round(seconds / 2.0)):
        clock.advance(2.0)
        worker.check()


def found(board: StatusRegistry) -> set[tuple[str, str]]:
    return {(reason.code, reason.severity) for reason in board.snapshot().reasons}


def immutable(folder: Path) -> Callable[[], None]:
    """Make a database and its log immutable, and return what makes them as before."""
    files = [str(folder / name) for name in ("sunarc.sqlite", "sunarc.sqlite-wal")]
    subprocess.run(["chattr", "+i", *files], check=True)

    def undo() -> None:
        subprocess.run(["chattr", "-i", *files], check=True)

    return undo


def filled(folder: Path) -> Callable[[], None]:
    """Fill the disk, to its last block."""
    ballast = folder / "ballast"
    with ballast.open("wb", buffering=0) as file:
        for size in (1 << 20, 1 << 12, 1):
            while True:
                try:
                    file.write(bytes(size))
                except OSError:
                    break
    return ballast.unlink


@pytest.mark.parametrize(("fault", "code"), [(immutable, "store_failed"), (filled, "store_full")])
def test_an_imager_that_cannot_store_says_so_at_night_and_until_it_can(
    disk: Path, clock: VirtualClock, board: StatusRegistry, fault: Callable[[Path], Callable[[], None]], code: str
) -> None:
    with new_archive(disk) as archive:
        worker = worker_of(archive, clock, board)
        looks(worker, clock, 120.0)
        assert found(board) == set()
        undo = fault(disk)
        try:
            looks(worker, clock, QUIET_S + 2.0)
            assert found(board) == {(code, "degraded")}
            looks(worker, clock, 60.0)
            assert found(board) == {(code, "degraded")}
        finally:
            undo()
        looks(worker, clock, 10.0)
        assert found(board) == set()


def test_an_imager_whose_disk_went_read_only_says_so_at_night(
    disk: Path, clock: VirtualClock, board: StatusRegistry
) -> None:
    with new_archive(disk) as archive:
        worker = worker_of(archive, clock, board)
        subprocess.run(["mount", "-o", "remount,abort", disk], check=True)  # ext4(5): as after an error of the device
        looks(worker, clock, QUIET_S + 2.0)
        assert found(board) == {("store_failed", "degraded")}


def test_the_trials_write_three_pages_a_minute_at_night_and_nothing_beside_sightings(
    tmp_path: Path, clock: VirtualClock, board: StatusRegistry
) -> None:
    with new_archive(tmp_path) as archive:
        worker = worker_of(archive, clock, board)
        log = tmp_path / "sunarc.sqlite-wal"
        before = log.stat().st_size
        looks(worker, clock, 600.0)
        pages = (log.stat().st_size - before) / PAGE_BYTES
        assert 9 <= pages <= 33
        commits = list[object]()
        event.listen(archive.database.engine, "commit", commits.append)
        for n in range(20):
            archive.housekeeping.add("roof", [Housekeeping(time=NOON, temperature_c=float(n))])
            looks(worker, clock, 30.0)
        assert len(commits) == 20


@pytest.mark.parametrize(("patience_s", "code"), [(PATIENCE_S, set()), (0.2, {("store_failed", "degraded")})])
def test_a_lock_of_another_process_is_a_store_that_fails_where_it_lasts(
    *,
    tmp_path: Path,
    clock: VirtualClock,
    board: StatusRegistry,
    monkeypatch: pytest.MonkeyPatch,
    patience_s: float,
    code: set[tuple[str, str]],
) -> None:
    monkeypatch.setattr(store, "_TRIED_FOR_S", 0.05)
    with new_archive(tmp_path) as archive:
        worker = replace(worker_of(archive, clock, board), patience_s=patience_s)
        with closing(sqlite3.connect(tmp_path / "sunarc.sqlite", isolation_level=None)) as other:
            other.execute("BEGIN IMMEDIATE")
            looks(worker, clock, QUIET_S + 20.0)
            assert found(board) == code
            looks(worker, clock, 20.0)
            assert found(board) == code
            other.execute("ROLLBACK")
        monkeypatch.setattr(store, "_TRIED_FOR_S", 20.0)
        looks(worker, clock, 10.0)
        assert found(board) == set()
