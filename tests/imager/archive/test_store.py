"""Transactions, the file's identity, the data version, and rows that are damaged."""

from __future__ import annotations

import logging
import sqlite3
import threading
from contextlib import closing
from dataclasses import asdict, replace
from datetime import timedelta
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
from sqlalchemy import insert, text
from tests.fixtures.stores import NOON, ROOF

from sunarc.common.errors import ConfigurationError, InputError, OutsideError
from sunarc.imager.archive.archive import open_archive
from sunarc.imager.archive.database.connections import (
    DELETED,
    EMPTIED,
    REPLACED,
    DatabaseFile,
    create_archive_engine,
    reading,
    writing,
)
from sunarc.imager.archive.database.store import given
from sunarc.imager.archive.database.tables import camera, sun_point
from sunarc.imager.archive.values import CameraRecord, SunPoint

if TYPE_CHECKING:
    from sunarc.imager.archive.archive import Archive

POINT = SunPoint(
    camera="roof", pose_epoch="roof-1", time=NOON, method="disc", accepted=True, verdict="clear", x_px=1.0, y_px=2.0
)


def changed(path: Path, statement: str) -> None:
    """Write to the database as a hand would: without our types, without foreign keys."""
    with closing(sqlite3.connect(path)) as connection, connection:
        connection.execute(statement)


def test_an_error_within_a_transaction_leaves_nothing(archive: Archive, path: Path) -> None:
    engine = create_archive_engine(path)
    other = replace(ROOF, name="attic")

    def write_and_fail() -> None:
        with writing(engine) as connection:
            connection.execute(insert(camera).values(asdict(other)))
            raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        write_and_fail()
    engine.dispose()
    assert other not in archive.cameras.all()
    assert archive.cameras.all() == (ROOF,)


def test_a_read_sees_one_state_throughout(archive: Archive, path: Path) -> None:
    engine = create_archive_engine(path)
    with reading(engine) as connection:
        before = connection.execute(text("SELECT count(*) FROM sun_point")).scalar()
        archive.sightings.add([POINT])
        assert connection.execute(text("SELECT count(*) FROM sun_point")).scalar() == before == 0
    with reading(engine) as connection:
        assert connection.execute(text("SELECT count(*) FROM sun_point")).scalar() == 1
    engine.dispose()


@pytest.mark.parametrize(
    ("changes", "field"),
    [({"camera": "attic"}, "archive"), ({"pose_epoch": "roof-9"}, "archive")],
)
def test_a_reference_to_nothing_is_refused(archive: Archive, changes: dict[str, str], field: str) -> None:
    with pytest.raises(InputError) as error:
        archive.sightings.add([replace(POINT, **dict[str, Any](changes))])
    assert error.value.field == field


def test_a_file_that_is_no_database_is_a_matter_of_configuration(tmp_path: Path) -> None:
    path = tmp_path / "sunarc.sqlite"
    path.write_bytes(b"no database at all" * 100)
    engine = create_archive_engine(path)
    with pytest.raises(ConfigurationError), reading(engine) as connection:
        connection.execute(text("SELECT 1 FROM sqlite_master"))
    engine.dispose()


def test_a_missing_file_is_not_made_by_a_reader(tmp_path: Path) -> None:
    engine = create_archive_engine(tmp_path / "sunarc.sqlite")
    with pytest.raises(OutsideError), reading(engine):
        pass
    assert not (tmp_path / "sunarc.sqlite").exists()
    engine.dispose()


def test_a_busy_database_is_waited_for(archive: Archive, path: Path) -> None:
    held = sqlite3.connect(path, isolation_level=None, check_same_thread=False)
    held.execute("BEGIN IMMEDIATE")
    ending = threading.Timer(0.2, held.execute, args=("COMMIT",))
    ending.start()
    assert archive.sightings.add([POINT]) == 1
    ending.join()
    held.close()


def test_conditions_without_an_argument_filter_nothing() -> None:
    c = sun_point.c
    assert given((c.camera.__eq__, None), (c.time.__ge__, None)) == []
    assert len(given((c.camera.__eq__, "roof"), (c.accepted.__eq__, False), (c.body.__eq__, None))) == 2


def test_the_revision_changes_with_every_commit_of_anyone(archive: Archive, path: Path) -> None:
    seen = [archive.revision()]
    assert archive.revision() == seen[0]
    archive.sightings.add([POINT])
    seen.append(archive.revision())
    changed(path, "UPDATE camera SET model = 'x'")
    seen.append(archive.revision())
    archive.sightings.add([POINT])  # already there: nothing is written
    assert len(set(seen)) == 3


@pytest.mark.parametrize(
    ("statement", "left"),
    [
        ("UPDATE sun_point SET time = 'noon' WHERE rowid = 1", 2),
        ("UPDATE sun_point SET time = 9e18 WHERE rowid = 1", 2),
        ("UPDATE sun_point SET temperature_c = 'warm' WHERE rowid = 1", 3),
        ("UPDATE sun_point SET reason = x'ff' WHERE rowid = 1", 3),
    ],
)
def test_a_damaged_row_is_left_out_and_the_others_stay(
    archive: Archive, path: Path, statement: str, left: int, caplog: pytest.LogCaptureFixture
) -> None:
    archive.sightings.add(replace(POINT, time=NOON + timedelta(seconds=n)) for n in range(3))
    changed(path, statement)
    with caplog.at_level(logging.WARNING):
        assert len(archive.sightings.find("roof")) == left
    assert bool(caplog.records) == (left < 3)
    assert len(archive.sightings.columns("roof").unix_s) >= left - 1


@pytest.mark.parametrize(
    ("fault", "problem"),
    [("delete", DELETED), ("replace", REPLACED), ("empty", EMPTIED), ("none", None)],
)
def test_what_happened_to_the_file_is_noticed(tmp_path: Path, fault: str, problem: str | None) -> None:
    path = tmp_path / "f"
    path.write_text("x")
    file = DatabaseFile(path)
    assert file.problem() is None
    file.remember()
    if fault == "delete":
        path.unlink()
    elif fault == "replace":
        other = tmp_path / "g"
        other.write_text("x")
        other.replace(path)
    elif fault == "empty":
        path.write_text("")
    assert file.problem() == problem
    if problem is None:
        file.require_in_place()
    else:
        with pytest.raises(OutsideError):
            file.require_in_place()


def test_a_folder_that_cannot_be_reached_is_said(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    problem = DatabaseFile(tmp_path / "file" / "sunarc.sqlite").problem()
    assert problem not in {None, DELETED, REPLACED, EMPTIED}


def test_a_name_with_special_characters_is_one_file(tmp_path: Path) -> None:
    path = tmp_path / "a b?c#d%.sqlite"
    DatabaseFile(path).connect(create=True).close()
    assert [file.name for file in tmp_path.iterdir()] == [path.name]


def test_a_saved_camera_is_known_to_the_object_that_saved_it(archive: Archive, path: Path) -> None:
    other = open_archive(path)
    try:
        assert archive.cameras.saved() == (ROOF,)
        assert other.cameras.saved() == ()
        assert other.cameras.all() == (ROOF,)
        moved = CameraRecord(name="roof", latitude=1.0, longitude=2.0, altitude=3.0, width=4, height=5)
        other.cameras.save(moved)
        assert archive.cameras.all() == (moved,)
    finally:
        other.close()
