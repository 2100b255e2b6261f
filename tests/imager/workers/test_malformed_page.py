"""An inner page of the database's file overwritten with noise, in use and before a start."""

from __future__ import annotations

import sqlite3
from collections.abc import Iterator
from contextlib import closing
from datetime import UTC, datetime, timedelta
from pathlib import Path

import numpy as np
import pytest
from tests.fixtures.archive import new_archive

from sunarc.common.errors import OutsideError
from sunarc.imager.archive.archive import Archive, open_archive
from sunarc.imager.archive.database.backup import backup_into
from sunarc.imager.archive.database.recovery import prepare_database
from sunarc.imager.archive.values import SunPoint
from sunarc.imager.runtime.clock import VirtualClock
from sunarc.imager.runtime.status import StatusRegistry
from sunarc.imager.workers.detect import SightingWriteBuffer
from sunarc.imager.workers.upkeep import DatabaseWorker

NOON = datetime(2013, 5, 13, 18, tzinfo=UTC)
COUNT, COPIED = 3000, 2000


def sightings(numbers: range, epoch: str) -> list[SunPoint]:
    return [
        SunPoint(camera="roof", pose_epoch=epoch, time=NOON + timedelta(seconds=30 * number), method="disc",
                 accepted=True, verdict="clear", x_px=float(number), y_px=2.0)
        for number in numbers
    ]  # fmt: skip


@pytest.fixture
def archive(tmp_path: Path) -> Iterator[Archive]:
    """Return an archive of 3,000 sightings, of which 2,000 are in a copy."""
    archive = new_archive(tmp_path)
    epoch = archive.epochs.at("roof", NOON, reason="first frame").id
    archive.sightings.add(sightings(range(COPIED), epoch))
    backup_into(tmp_path / "sunarc.sqlite", tmp_path / "backups", keep=3, now=NOON)
    archive.sightings.add(sightings(range(COPIED, COUNT), epoch))
    yield archive
    archive.close()


def overwrite_inner_page(path: Path) -> None:
    """Overwrite the root of the sightings' table, which is an inner page, with noise."""
    with closing(sqlite3.connect(path)) as connection:
        connection.execute("PRAGMA wal_checkpoint(TRUNCATE)")
        (root,) = connection.execute("SELECT rootpage FROM sqlite_master WHERE name = 'sun_point'").fetchone()
        (size,) = connection.execute("PRAGMA page_size").fetchone()
    with path.open("r+b") as file:
        file.seek((root - 1) * size)
        assert file.read(1) == b"\x05"  # of an inner page of a table
        file.seek((root - 1) * size)
        file.write(np.random.default_rng(1).integers(20, 256, size, dtype=np.uint8).tobytes())


def stored(archive: Archive) -> list[float]:
    return sorted(point.x_px for point in archive.sightings.find("roof") if point.x_px is not None)


def test_a_malformed_page_in_use_is_said_and_everything_readable_is_kept(
    archive: Archive, clock: VirtualClock, board: StatusRegistry, tmp_path: Path
) -> None:
    path = tmp_path / "sunarc.sqlite"
    overwrite_inner_page(path)
    keeper = SightingWriteBuffer(archive, board=board)
    worker = DatabaseWorker(archive=archive, clock=clock, now=clock.now, board=board)
    with pytest.raises(OutsideError):
        archive.sightings.find("roof")
    keeper.keep(sightings(range(COUNT, COUNT + 1), "")[0])
    assert keeper.waiting == 1
    worker.check()
    keeper.store()
    assert {reason.code for reason in board.snapshot().reasons} == {"database_salvaged"}
    assert stored(archive) == [float(number) for number in range(COUNT + 1)]
    assert [event.kind for event in archive.events.find(severity="alarm")] == ["database_salvaged"]
    assert len(list(tmp_path.glob("sunarc.sqlite.found-*"))) == 1


def test_a_malformed_page_before_a_start_is_no_reason_to_end(archive: Archive, tmp_path: Path) -> None:
    path = tmp_path / "sunarc.sqlite"
    archive.close()
    overwrite_inner_page(path)
    done = prepare_database(path, backups=tmp_path / "backups", images=tmp_path / "images", now=NOON)
    assert done is not None
    assert done.kind == "salvaged"
    again = open_archive(path)
    assert stored(again) == [float(number) for number in range(COUNT)]
    again.close()
    assert prepare_database(path, backups=tmp_path / "backups", images=tmp_path / "images", now=NOON) is None
