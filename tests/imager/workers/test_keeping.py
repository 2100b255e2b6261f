"""Sightings when the disk refuses them."""

from __future__ import annotations

import logging
from datetime import timedelta
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from sqlalchemy import Engine
from tests.fixtures.archive import add_after_opening, new_archive

from sunarc.common.errors import OutsideError
from sunarc.imager.archive.archive import Archive
from sunarc.imager.archive.database.connections import DatabaseFile
from sunarc.imager.archive.sightings import SightingStore
from sunarc.imager.archive.values import SunPoint
from sunarc.imager.workers import detect as keeping
from sunarc.imager.workers.detect import SightingWriteBuffer

from .conftest import NOON

if TYPE_CHECKING:
    from collections.abc import Iterable

    from sunarc.common.findings import Data
from sunarc.imager.runtime.status import StatusRegistry


class RefusingSightings(SightingStore):
    """Sightings that a full disk takes none of."""

    full = False

    def add(self, points: Iterable[SunPoint], *, first_epoch: str = "first sighting") -> int:
        if self.full:
            raise OutsideError("cannot use the database: database or disk is full")
        return super().add(points, first_epoch=first_epoch)


class Refusing(Archive):
    """An archive whose disk is full while `full`."""

    sightings: RefusingSightings

    def __init__(self, engine: Engine, file: DatabaseFile | None) -> None:
        super().__init__(engine, file)
        self.sightings = RefusingSightings(self.database)

    @property
    def full(self) -> bool:
        """Whether sightings are refused."""
        return self.sightings.full

    @full.setter
    def full(self, full: bool) -> None:
        self.sightings.full = full


@pytest.fixture
def archive(tmp_path: Path) -> Refusing:
    opened = new_archive(tmp_path)
    return Refusing(opened.database.engine, opened.database.file)


def sighting(number: int) -> SunPoint:
    return SunPoint(
        camera="roof",
        pose_epoch="",
        time=NOON + timedelta(seconds=number),
        method="disc",
        accepted=True,
        verdict="clear",
        x_px=float(number),
        y_px=3.0,
    )


def reasons(board: StatusRegistry) -> dict[str, Data]:
    return {reason.code: reason.data for reason in board.snapshot().reasons}


def test_a_sighting_is_stored_at_once_in_its_pose_epoch(archive: Refusing, board: StatusRegistry) -> None:
    SightingWriteBuffer(archive, board=board).keep(sighting(1))
    (stored,) = archive.sightings.find("roof")
    assert (stored.x_px, stored.pose_epoch) == (1.0, "roof-1")
    assert reasons(board) == {}


def test_a_sighting_is_stored_in_the_epoch_that_was_opened_after_it_was_made(
    archive: Refusing, board: StatusRegistry, monkeypatch: pytest.MonkeyPatch
) -> None:
    keeper = SightingWriteBuffer(archive, board=board)
    keeper.keep(sighting(0))
    monkeypatch.setattr(archive.sightings, "add", add_after_opening(archive, at=NOON + timedelta(seconds=20)))
    keeper.keep(sighting(30))
    assert [point.pose_epoch for point in archive.sightings.find("roof")] == ["roof-1", "roof-2"]


def test_what_the_disk_refuses_waits_is_told_and_is_stored_in_its_order(
    archive: Refusing, board: StatusRegistry, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(keeping, "_AT_A_TIME", 20)  # three transactions
    keeper = SightingWriteBuffer(archive, board=board)
    archive.full = True
    for number in range(45):
        keeper.keep(sighting(number))
    assert keeper.stored == 0
    assert reasons(board)["sightings_not_stored"]["waiting"] == 45
    assert archive.sightings.find("roof") == ()
    archive.full = False
    keeper.keep(sighting(45))
    assert [point.x_px for point in archive.sightings.find("roof")] == [float(number) for number in range(46)]
    assert reasons(board) == {}
    assert keeper.waiting == 0
    assert keeper.stored == 46


def test_when_memory_runs_out_the_oldest_are_lost_and_counted(archive: Refusing, board: StatusRegistry) -> None:
    keeper = SightingWriteBuffer(archive, board=board, capacity=3)
    archive.full = True
    for number in range(5):
        keeper.keep(sighting(number))
    told = reasons(board)["sightings_not_stored"]
    assert (told["waiting"], told["lost"]) == (3, 2)
    archive.full = False
    keeper.store()
    assert [point.x_px for point in archive.sightings.find("roof")] == [2.0, 3.0, 4.0]


def test_what_is_lost_at_the_end_is_said(
    archive: Refusing, board: StatusRegistry, caplog: pytest.LogCaptureFixture
) -> None:
    keeper = SightingWriteBuffer(archive, board=board)
    archive.full = True
    keeper.keep(sighting(1))
    with caplog.at_level(logging.ERROR):
        keeper.give_up()
    assert "1 sightings could not be stored" in caplog.text
