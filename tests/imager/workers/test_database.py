"""The database's file deleted, emptied and out of reach under the workers."""

from __future__ import annotations

import os
from datetime import timedelta
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from tests.fixtures.archive import new_archive

from sunarc.imager.archive.archive import Archive, open_archive
from sunarc.imager.archive.database.recovery import Recovery
from sunarc.imager.archive.database.schema import upgrade
from sunarc.imager.archive.values import CameraRecord, SunPoint
from sunarc.imager.workers.detect import SightingWriteBuffer
from sunarc.imager.workers.upkeep import DatabaseWorker

from .conftest import NOON

if TYPE_CHECKING:
    from collections.abc import Iterator

    from sunarc.imager.runtime.clock import VirtualClock
    from sunarc.imager.runtime.status import StatusRegistry


@pytest.fixture
def archive(tmp_path: Path) -> Iterator[Archive]:
    archive = new_archive(tmp_path)
    yield archive
    archive.close()


def worker_of(
    archive: Archive, clock: VirtualClock, board: StatusRegistry, recovered: Recovery | None = None
) -> DatabaseWorker:
    return DatabaseWorker(archive=archive, clock=clock, now=clock.now, board=board, recovered=recovered)


def sighting(number: int) -> SunPoint:
    return SunPoint(camera="roof", pose_epoch="", time=NOON + timedelta(minutes=number), method="disc", accepted=True,
                    verdict="clear", x_px=1.0, y_px=2.0)  # fmt: skip


def codes(board: StatusRegistry) -> set[str]:
    return {reason.code for reason in board.snapshot().reasons}


def test_a_database_in_place_is_not_worth_a_word(archive: Archive, clock: VirtualClock, board: StatusRegistry) -> None:
    worker_of(archive, clock, board).check()
    assert codes(board) == set()
    assert archive.events.find() == ()


def test_no_sighting_is_lost_when_the_database_is_deleted(
    archive: Archive, clock: VirtualClock, board: StatusRegistry, tmp_path: Path
) -> None:
    keeper, worker = SightingWriteBuffer(archive, board=board), worker_of(archive, clock, board)
    keeper.keep(sighting(0))
    (tmp_path / "sunarc.sqlite").unlink()
    keeper.keep(sighting(1))
    assert keeper.waiting == 1
    assert "sightings_not_stored" in codes(board)
    worker.check()
    keeper.store()
    assert keeper.waiting == 0
    assert codes(board) == {"database_written_back"}
    assert [event.kind for event in archive.events.find(severity="alarm")] == ["database_written_back"]
    stored = open_archive(tmp_path / "sunarc.sqlite")
    assert len(stored.sightings.find("roof")) == 2
    stored.close()


def test_what_was_done_at_the_start_is_shown_and_written_down_once(
    archive: Archive, clock: VirtualClock, board: StatusRegistry
) -> None:
    done = Recovery(kind="restored", text="the database had 0 bytes; it was restored")
    worker = worker_of(archive, clock, board, done)
    assert codes(board) == {"database_restored"}
    worker.check()
    worker.check()
    assert [(event.kind, event.text) for event in archive.events.find()] == [("database_restored", done.text)]


def test_a_database_that_cannot_be_put_back_is_shown_and_tried_again(
    archive: Archive, clock: VirtualClock, board: StatusRegistry, tmp_path: Path
) -> None:
    worker = worker_of(archive, clock, board)
    (tmp_path / "sunarc.sqlite").unlink()
    (tmp_path / "sunarc.sqlite.partial").mkdir()  # no copy can be written
    worker.check()
    worker.check()
    assert codes(board) == {"database_missing"}
    (tmp_path / "sunarc.sqlite.partial").rmdir()
    worker.check()
    assert codes(board) == {"database_written_back"}


@pytest.fixture
def as_nobody(tmp_path: Path) -> Iterator[None]:
    """Give up root's right to read everything, and own the test's folder."""
    if os.geteuid() != 0:
        yield
        return
    for folder in (tmp_path, *tmp_path.rglob("*")):
        os.chown(folder, 65534, 65534)
    shut = [folder for folder in tmp_path.parents if not folder.stat().st_mode & 0o001]
    modes = [folder.stat().st_mode for folder in shut]
    for folder in shut:
        folder.chmod(0o711)
    os.seteuid(65534)
    yield
    os.seteuid(0)
    for folder, mode in zip(shut, modes, strict=True):
        folder.chmod(mode)


@pytest.mark.usefixtures("as_nobody")
def test_a_state_folder_out_of_reach_is_shown_and_nothing_is_rebuilt(
    tmp_path: Path, clock: VirtualClock, board: StatusRegistry
) -> None:
    state = tmp_path / "state"
    upgrade(state / "sunarc.sqlite")
    archive = open_archive(state / "sunarc.sqlite")
    archive.cameras.save(CameraRecord(name="roof", latitude=36.6, longitude=-97.5, altitude=318.0, width=8, height=6))
    keeper, worker = SightingWriteBuffer(archive, board=board), worker_of(archive, clock, board)
    inode = (state / "sunarc.sqlite").stat().st_ino
    state.chmod(0)
    worker.check()
    keeper.keep(sighting(0))
    assert codes(board) == {"database_missing", "sightings_not_stored"}
    assert "Permission denied" in next(r.text for r in board.snapshot().reasons if r.code == "database_missing")
    state.chmod(0o750)
    worker.check()
    keeper.store()
    assert codes(board) == set()
    assert (state / "sunarc.sqlite").stat().st_ino == inode
    assert len(archive.sightings.find("roof")) == 1
    archive.close()
