"""Closing pose epochs beside damaged rows and changes of the lens: what was judged wrong never answers again."""

from __future__ import annotations

import sqlite3
from contextlib import closing
from datetime import timedelta
from pathlib import Path

import pytest
from tests.fixtures.stores import NOON

from sunarc.common.errors import InputError
from sunarc.imager.archive.archive import Archive, open_archive
from sunarc.imager.archive.epochs import LENS_CHANGED

from .test_calibrations import MAY, document, served


def change(path: Path, statement: str, *values: object) -> None:
    """Change rows behind the archive's back, as a bad disk does."""
    with closing(sqlite3.connect(path, isolation_level=None)) as connection:
        assert connection.execute(statement, values).rowcount


def serve(archive: Archive, name: str, *, at: int, pose_epoch: str) -> None:
    archive.calibrations.add(document(name, day=at, pose_epoch=pose_epoch))
    archive.calibrations.activate(name)


@pytest.fixture
def moved(archive: Archive) -> Archive:
    """Calibrations a and b, and c of an epoch that began by mistake on day 20."""
    serve(archive, "a", at=1, pose_epoch="roof-1")
    serve(archive, "b", at=10, pose_epoch="roof-1")
    archive.epochs.open("roof", at=MAY + timedelta(days=20), reason="bump")
    serve(archive, "c", at=20, pose_epoch="roof-2")
    return archive


def test_a_damaged_calibration_is_not_copied_when_an_epoch_is_closed(moved: Archive, path: Path) -> None:
    moved.close()
    change(path, "UPDATE calibration SET document = replace(document, 'agree', 'agrde') WHERE id = 'b'")
    archive = open_archive(path)
    assert archive.calibrations.close_epoch("roof-2", at=MAY + timedelta(days=25), reason="a bird") == "a-r1"
    assert served(archive, 26) == "a-r1"
    archive.close()


def test_what_was_closed_does_not_stand_in_for_a_damaged_calibration(moved: Archive, path: Path) -> None:
    assert moved.calibrations.close_epoch("roof-2", at=MAY + timedelta(days=25), reason="a bird") == "b-r1"
    moved.close()
    change(path, "UPDATE calibration SET document = replace(document, 'agree', 'agrde') WHERE id = 'b-r1'")
    archive = open_archive(path)
    assert served(archive, 26) == "b"
    archive.close()


def test_a_lens_change_that_was_closed_hides_no_calibration_before_it(archive: Archive, path: Path) -> None:
    serve(archive, "a", at=1, pose_epoch="roof-1")
    archive.epochs.open("roof", at=MAY + timedelta(days=5), reason=LENS_CHANGED)
    archive.calibrations.close_epoch("roof-2", at=MAY + timedelta(days=6), reason="the same camera")
    serve(archive, "b", at=10, pose_epoch="roof-1")
    archive.close()
    change(path, "UPDATE calibration SET document = replace(document, 'agree', 'agrde') WHERE id = 'b'")
    again = open_archive(path)
    assert served(again, 11) == "a"
    again.close()


def test_no_calibration_of_an_earlier_lens_is_served_again(archive: Archive) -> None:
    serve(archive, "a", at=1, pose_epoch="roof-1")
    archive.calibrations.retire("a", at=MAY + timedelta(days=5))
    archive.epochs.open("roof", at=MAY + timedelta(days=5), reason=LENS_CHANGED)
    archive.epochs.open("roof", at=MAY + timedelta(days=8), reason="bump")
    assert archive.calibrations.close_epoch("roof-3", at=MAY + timedelta(days=9), reason="a bird") is None
    assert archive.calibrations.current("roof") is None


@pytest.mark.parametrize("ended", [True, False])
def test_an_epoch_begins_beside_one_whose_beginning_cannot_be_read(
    archive: Archive, path: Path, *, ended: bool
) -> None:
    archive.epochs.open("roof", at=NOON, reason="bump")
    if ended:
        archive.epochs.open("roof", at=NOON + timedelta(hours=1), reason="bump")
    archive.close()
    change(path, "UPDATE pose_epoch SET started_at = 'x' WHERE id = 'roof-2'")
    again = open_archive(path)
    new = again.epochs.open("roof", at=NOON + timedelta(days=1), reason="bump")
    assert new.id == ("roof-4" if ended else "roof-3")
    assert again.epochs.current("roof") == new
    again.close()


def test_an_epoch_is_divided_beside_one_whose_beginning_cannot_be_read(archive: Archive, path: Path) -> None:
    archive.epochs.open("roof", at=NOON, reason="bump")
    archive.close()
    change(path, "UPDATE pose_epoch SET started_at = 'x' WHERE id = 'roof-2'")
    again = open_archive(path)
    assert [part.id for part in again.epochs.split("roof", at=NOON - timedelta(days=1), reason="bump")] == [
        "roof-1",
        "roof-3",
    ]
    again.close()


def test_of_two_wrong_epochs_neither_answers_whichever_is_closed_first(moved: Archive) -> None:
    moved.epochs.open("roof", at=MAY + timedelta(days=22), reason="bump")
    serve(moved, "d", at=22, pose_epoch="roof-3")
    assert moved.calibrations.close_epoch("roof-2", at=MAY + timedelta(days=25), reason="a bird") == "d"
    assert moved.calibrations.close_epoch("roof-3", at=MAY + timedelta(days=26), reason="another bird") == "b-r1"


def test_an_epoch_that_was_closed_is_not_divided_off_again_at_the_same_time(moved: Archive) -> None:
    at = MAY + timedelta(days=20)
    moved.calibrations.close_epoch("roof-2", at=MAY + timedelta(days=25), reason="a bird")
    with pytest.raises(InputError, match="closed"):
        moved.epochs.split("roof", at=at, reason="bump")
    assert [epoch.id for epoch in moved.epochs.find("roof")] == ["roof-1"]
