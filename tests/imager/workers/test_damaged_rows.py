"""Bits flipped in the database: every part of the service goes on, and a damaged calibration is not served."""

from __future__ import annotations

import json
import shutil
import sqlite3
import threading
from collections.abc import Iterator
from contextlib import closing
from datetime import UTC, datetime, timedelta
from pathlib import Path
from types import SimpleNamespace
from typing import TYPE_CHECKING, cast

import numpy as np
import pytest
from tests.fixtures.calibrations import SITE
from tests.fixtures.served import LENS, calibration

from sunarc.calibration.model.options import CalibrationOptions
from sunarc.calibration.model.sightings import Sightings
from sunarc.changes.values import WatchOptions
from sunarc.common.errors import InputError
from sunarc.common.findings import Finding
from sunarc.formats.calibration_document import to_document
from sunarc.imager.archive.archive import Archive, CameraArchive, open_archive
from sunarc.imager.archive.database.schema import check, downgrade, upgrade
from sunarc.imager.archive.database.tables import metadata
from sunarc.imager.archive.values import CameraRecord, Day, Event, Refit, SunPoint
from sunarc.imager.runtime.clock import VirtualClock
from sunarc.imager.runtime.status import Reason, StatusRegistry
from sunarc.imager.workers.calibrating.day_judge import DayJudge
from sunarc.imager.workers.calibrating.provisional_pose import ProvisionalPoseEstimator
from sunarc.imager.workers.calibrating.refit import RefitWorker
from sunarc.imager.workers.calibrating.watch import WatchWorker
from sunarc.imager.workers.options import RefitOptions
from sunarc.imager.workers.sun_prediction import SunPredictor
from sunarc.optics.forward import project
from sunarc.sky.sun import sun_directions

if TYPE_CHECKING:
    from sunarc.imager.workers.calibrating.refit import RefitTask

NOON = datetime(2013, 5, 13, 18, 30, tzinfo=UTC)
NOW = NOON + timedelta(days=3)
FOUND = Finding("disc_found", {"chi2": 1.0})
CAMERA = CameraRecord(
    name="roof",
    latitude=SITE.latitude,
    longitude=SITE.longitude,
    altitude=318.0,
    width=1748,
    height=1748,
    model="Test Sky",
    serial="1",
    pixel_format="Mono12",
)


def document(name: str, *, day: int) -> dict[str, object]:
    moment = NOON + timedelta(days=day)
    return to_document(
        calibration(),
        id=name,
        camera="roof",
        state="candidate",
        created_at=moment,
        valid_from=moment,
        valid_until=None,
        pose_epoch="roof-1",
        software_version="1",
    )


@pytest.fixture(scope="module")
def filled(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a database with a row or more in every table, and three calibrations of which the last is current."""
    path = tmp_path_factory.mktemp("filled") / "sunarc.sqlite"
    upgrade(path)
    archive = open_archive(path)
    archive.cameras.save(CAMERA)
    epoch = archive.epochs.at("roof", NOON - timedelta(days=1), reason="installed").id
    for number in range(6):
        time = NOON + timedelta(minutes=number)
        x, y = project(LENS, sun_directions(time.timestamp(), SITE)).tolist()
        archive.sightings.add([
            SunPoint(camera="roof", pose_epoch=epoch, time=time, method="disc", accepted=True, verdict="clear",
                     findings=(FOUND,), x_px=x, y_px=y, sigma_px=0.02, clock_error_s=0.01, exposure_us=12.0)
        ])  # fmt: skip
    for number, name in enumerate(("first", "second", "third")):
        archive.calibrations.add(document(name, day=number), used=archive.sightings.columns("roof"))
        archive.calibrations.activate(name)
    archive.refits.add(Refit(id="r", camera="roof", requested_at=NOON, reason="by hand"))
    archive.days.save(Day(camera="roof", date=NOON.date(), verdict="clear", findings=(), n=6, n_possible=6,
                         decided_at=NOON, pose_offset_deg=(0.1, 0.2, 0.3),
                         pose_offset_sigma_deg=(0.1, 0.2, 0.3)))  # fmt: skip
    archive.events.add(Event(time=NOON, kind="clock_step", severity="info", text="here", camera="roof",
                            details={"step_s": 1.0}))  # fmt: skip
    archive.close()
    return path


@pytest.fixture
def path(filled: Path, tmp_path: Path) -> Path:
    return Path(shutil.copy(filled, tmp_path / "sunarc.sqlite"))


@pytest.fixture
def clock() -> VirtualClock:
    return VirtualClock(NOW)


def flip(path: Path, table: str, column: str, *, where: str = "1", byte: int = 0, bit: int = 0) -> None:
    """Flip one bit of a text in the database, as a bad disk does; foreign keys and checks see nothing."""
    with closing(sqlite3.connect(path, isolation_level=None)) as connection:
        row, stored = connection.execute(
            f"SELECT _rowid_, CAST({column} AS BLOB) FROM {table} WHERE {where} ORDER BY _rowid_ DESC LIMIT 1"  # noqa: S608
        ).fetchone()
        flipped = bytearray(stored)
        flipped[byte] ^= 1 << bit
        connection.execute(
            f"UPDATE {table} SET {column} = CAST(? AS TEXT) WHERE _rowid_ = ?",  # noqa: S608
            (bytes(flipped), row),
        )


def refit_worker(archive: Archive, board: StatusRegistry, clock: VirtualClock) -> RefitWorker:
    return RefitWorker(
        camera=CameraArchive(archive, name="roof", site=SITE),
        options=RefitOptions(),
        calibration=CalibrationOptions(),
        cadence_s=60.0,
        clock=clock,
        now=clock.now,
        board=board,
        solve=lambda *_, **__: None,
    )


def run_every_part(path: Path, board: StatusRegistry, clock: VirtualClock) -> dict[str, Reason]:
    """Start and run every part of the service that reads the archive, once; return the conditions by code."""
    archive = open_archive(path)
    archive.cameras.save(CAMERA)  # as at every opening of the camera
    reposer = ProvisionalPoseEstimator(
        camera=CameraArchive(archive, name="roof", site=SITE),
        options=CalibrationOptions(),
        wander_deg=0.0,
        now=clock.now,
    )
    watch = WatchWorker(
        camera=CameraArchive(archive, name="roof", site=SITE),
        options=WatchOptions(),
        reposer=reposer,
        now=clock.now,
        board=board,
    )
    watch.remember()
    predictor = SunPredictor(CameraArchive(archive, name="roof", site=SITE))
    predictor.expectation(NOON)
    predictor.clear_level_per_us(NOW)
    days = DayJudge(
        camera=CameraArchive(archive, name="roof", site=SITE), cadence_s=lambda: 60.0, sun_zenith_deg=90.0,
        now=clock.now, request_refit=lambda reason: archive.refits.add(
            Refit(id="another", camera="roof", requested_at=NOW, reason=reason)
        ),
    )  # fmt: skip
    days.judge_ended_days()
    stop = threading.Event()
    refit_worker(archive, board, clock).run(stop, stop.set)
    (
        archive.cameras.all(),
        archive.epochs.find("roof"),
        archive.days.find("roof"),
        archive.refits.find("roof"),
        archive.events.find("roof"),
    )
    for record in archive.calibrations.find("roof"):
        json.dumps(record.document)
    archive.close()
    return {reason.code: reason for reason in board.snapshot().reasons}


TEXTS = [
    (table.name, column.name)
    for table in metadata.sorted_tables
    for column in table.columns
    if str(column.type) in ("TEXT", "JSON", "DATE")
]


@pytest.mark.parametrize("place", TEXTS, ids=lambda place: f"{place[0]}.{place[1]}")
def test_no_flipped_bit_in_a_text_column_ends_a_part_of_the_service(
    filled: Path, tmp_path: Path, board: StatusRegistry, clock: VirtualClock, place: tuple[str, str]
) -> None:
    table, column = place
    for bit in (0, 7):  # another letter, no UTF-8
        path = Path(shutil.copy(filled, tmp_path / f"bit{bit}.sqlite"))
        with closing(sqlite3.connect(path)) as connection:
            empty = connection.execute(f"SELECT 1 FROM {table} WHERE {column} != ''").fetchone() is None  # noqa: S608
        if empty:
            return  # there is nothing to flip
        flip(path, table, column, where=f"{column} != ''", bit=bit)
        run_every_part(path, board, clock)


@pytest.mark.parametrize(("byte", "bit"), [(0, 0), (40, 1), (700, 7), (-20, 2)])
def test_the_calibration_before_a_damaged_one_is_served_and_the_damage_shown(
    path: Path, board: StatusRegistry, clock: VirtualClock, byte: int, bit: int
) -> None:
    flip(path, "calibration", "document", where="id = 'third'", byte=byte, bit=bit)
    with closing(sqlite3.connect(path, isolation_level=None)) as connection:
        connection.execute("UPDATE refit SET state = 'refused', finished_at = requested_at")
    reasons = run_every_part(path, board, clock)
    assert reasons["calibration_damaged"].data == {"calibration": "third", "served": "second"}
    archive = open_archive(path)
    served = archive.calibrations.current("roof")
    assert served is not None
    assert (served.id, served.document["state"], served.document["valid_until"]) == ("second", "current", None)
    at = archive.calibrations.current("roof", at=NOON + timedelta(days=2, hours=1))
    assert at is not None
    assert at.id == "second"
    assert [event.details for event in archive.events.find("roof") if event.kind == "calibration_damaged"] == [
        {"calibration": "third", "served": "second"}
    ]
    (asked,) = (refit for refit in archive.refits.find("roof") if refit.reason == "in place of third")
    run_every_part(path, board, clock)  # the next start tells and asks nothing again
    assert sum(event.kind == "calibration_damaged" for event in archive.events.find("roof")) == 1
    assert [one.id for one in archive.refits.find("roof") if one.reason == asked.reason] == [asked.id]
    with pytest.raises(InputError, check=lambda error: error.field == "id"):
        archive.calibrations.get("third")
    archive.close()
    found = check(path)
    assert found.damaged == ("third",)
    assert not found.sound


def test_a_new_calibration_ends_the_condition(path: Path, board: StatusRegistry, clock: VirtualClock) -> None:
    flip(path, "calibration", "document", where="id = 'third'", byte=40)
    with closing(sqlite3.connect(path, isolation_level=None)) as connection:
        connection.execute("UPDATE calibration SET pinned = 1 WHERE id = 'third'")
    assert "calibration_damaged" in run_every_part(path, board, clock)
    archive = open_archive(path)
    archive.calibrations.add(document("fourth", day=3))
    assert archive.calibrations.activate("fourth").state == "current"
    archive.close()
    assert "calibration_damaged" not in run_every_part(path, board, clock)
    assert check(path).sound


def test_a_refit_that_finds_nothing_new_replaces_a_damaged_calibration(
    path: Path, board: StatusRegistry, clock: VirtualClock
) -> None:
    none = Sightings.of(unix_s=np.empty(0), pixels=np.empty((0, 2)))
    task = cast("RefitTask", SimpleNamespace(pose_epoch="roof-1", problem=SimpleNamespace(points=none)))
    archive = open_archive(path)
    verdict = refit_worker(archive, board, clock)._make_verdict(
        task, calibration(), archive.calibrations.current("roof")
    )
    archive.close()
    assert (verdict.accepted, verdict.marginal) == (False, True)
    flip(path, "calibration", "document", where="id = 'third'", byte=40)
    archive = open_archive(path)
    verdict = refit_worker(archive, board, clock)._make_verdict(
        task, calibration(), archive.calibrations.current("roof")
    )
    archive.close()
    assert verdict.accepted
    assert verdict.findings[0].code == "replaces_damaged"


def test_with_every_calibration_damaged_none_is_served_and_the_record_goes_on(
    path: Path, board: StatusRegistry, clock: VirtualClock
) -> None:
    for name in ("first", "second", "third"):
        flip(path, "calibration", "document", where=f"id = '{name}'", byte=40)
    reasons = run_every_part(path, board, clock)
    assert reasons["calibration_damaged"].data == {"calibration": "third", "served": "no calibration"}
    archive = open_archive(path)
    assert archive.calibrations.current("roof") is None
    archive.close()


def test_no_calibration_from_before_a_change_of_the_lens_stands_in(path: Path) -> None:
    archive = open_archive(path)
    archive.epochs.open("roof", at=NOON + timedelta(days=1, hours=12), reason="lens")
    archive.close()
    flip(path, "calibration", "document", where="id = 'third'", byte=40)
    archive = open_archive(path)
    assert archive.calibrations.current("roof") is None
    archive.close()


def test_what_stands_in_for_a_damaged_one_can_be_retired(path: Path) -> None:
    flip(path, "calibration", "document", where="id = 'third'", byte=40)
    archive = open_archive(path)
    archive.calibrations.retire("second", at=NOW)
    assert archive.calibrations.current("roof") is None
    archive.close()


def test_the_migration_computes_checksums_and_finds_what_was_damaged_before(path: Path) -> None:
    downgrade(path, "0006")
    flip(path, "calibration", "document", where="id = 'second'", byte=0)
    upgrade(path)
    assert check(path).damaged == ("second",)
    assert check(path).sound  # the current one is not damaged


@pytest.fixture(autouse=True)
def no_worker_left() -> Iterator[None]:
    yield
    assert threading.active_count() < 10
