"""Days, nightly refits and acceptance over weather, and what hands and crashes do to the record."""

from __future__ import annotations

import hashlib
import json
import sqlite3
import threading
from collections.abc import Iterator
from contextlib import closing
from dataclasses import dataclass
from datetime import UTC, date, datetime, timedelta
from pathlib import Path

import numpy as np
import pytest
from tests.fixtures.finding_codes import codes

from sunarc.common.errors import InputError
from sunarc.formats.calibration_document import from_document
from sunarc.imager.archive.archive import Archive, CameraArchive, open_archive
from sunarc.imager.archive.database.backup import backup
from sunarc.imager.archive.values import Day, SunPoint
from sunarc.imager.commands.calibrate_archive import solve_again
from sunarc.imager.settings.load import load_settings
from sunarc.imager.workers.sun_prediction import SunPredictor
from sunarc.lab.simulation.truth import SGP

from .long_run import CLEAR, CLOUDY, FIRST_DAY, HEAVY, PARTLY, LongRun, Night, judged_against, worst_rise

WEATHER = (CLEAR, CLOUDY, PARTLY, HEAVY, HEAVY, CLEAR)


@dataclass(frozen=True)
class Lived:
    run: LongRun
    nights: list[Night]
    folder: Path


@pytest.fixture(scope="module")
def lived(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Lived]:
    """Live through six days; the two under heavy cloud are refitted in spite of it."""
    folder = tmp_path_factory.mktemp("state")
    run = LongRun(folder, cadence_s=240.0, seed=4)
    nights = [
        run.day(FIRST_DAY + timedelta(days=number), weather, always_refit=weather is HEAVY)
        for number, weather in enumerate(WEATHER)
    ]
    yield Lived(run, nights, folder)
    run.archive.close()


def copied(lived: Lived, folder: Path) -> tuple[Path, Archive]:
    """Return a copy of the database, to do harm to."""
    path = backup(lived.folder / "sunarc.sqlite", folder / "sunarc.sqlite")
    return path, open_archive(path)


def by_hand(path: Path, statement: str, *values: object) -> None:
    with closing(sqlite3.connect(path)) as connection, connection:
        connection.execute(statement, values)


def test_every_day_gets_the_verdict_of_its_weather(lived: Lived) -> None:
    assert [night.verdict for night in lived.nights[:3]] == ["clear", "cloudy", "partly"]
    assert {night.verdict for night in lived.nights[3:5]} <= {"cloudy", "unusable"}
    assert [night.refit for night in lived.nights[:2]] == ["accepted", ""]


def test_the_served_camera_gets_no_worse_than_it_says(lived: Lived) -> None:
    assert worst_rise(lived.nights) < 2.0
    assert lived.nights[-1].error_px < 3.0 * lived.nights[-1].stated_px
    assert lived.nights[-1].stated_px < lived.nights[0].stated_px


def test_heavy_cloud_changes_nothing_that_is_served(lived: Lived) -> None:
    before, *under = lived.nights[2:5]
    assert [night.refit for night in under] == ["marginal", "marginal"]
    assert [night.calibration for night in under] == [before.calibration] * 2


def test_each_day_that_shows_the_sun_tells_how_the_camera_stood(lived: Lived) -> None:
    days = {day.date: day for day in lived.run.archive.days.find("roof")}
    assert days[FIRST_DAY].pose_offset_deg is None  # there was nothing to compare with
    last = days[FIRST_DAY + timedelta(days=5)]
    assert last.pose_offset_deg is not None
    assert last.pose_offset_sigma_deg is not None
    assert all(abs(turn) < 4.0 * s for turn, s in zip(last.pose_offset_deg, last.pose_offset_sigma_deg, strict=True))
    told = [event for event in lived.run.archive.events.find("roof") if event.kind == "day"]
    assert told[0].details["pose_offset_deg"] == list(last.pose_offset_deg)


def test_a_calibration_tells_how_its_sightings_were_picked(lived: Lived) -> None:
    current = lived.run.archive.calibrations.current("roof")
    assert current is not None
    told = current.document["evidence"]["selection"]
    used = lived.run.archive.calibrations.sightings_given_to(current.id)
    assert told["n_supplied"] - told["n_other_days"] - told["n_repeated"] == used.ids.size
    assert current.document["evidence"]["days"] == ["2013-05-13", "2013-05-15", "2013-05-18"]


def test_a_past_calibration_is_solved_again_with_the_same_result(lived: Lived) -> None:
    first = lived.nights[0].calibration
    assert first is not None
    config = lived.folder / "sunarc.toml"
    config.write_text(f'name = "roof"\nstate = "{lived.folder}"\n[site]\nlatitude = 1.0\nlongitude = 2.0\n')
    told = solve_again(load_settings(config), first)
    assert told["same"]
    assert told["apart_px"] < 1e-9
    stored = from_document(lived.run.archive.calibrations.get(first).document)
    again = from_document(json.loads(json.dumps(told["calibration"])))
    assert np.allclose(again.covariance, stored.covariance, rtol=1e-6)
    assert again.metrics == stored.metrics


def test_sightings_deleted_by_hand_are_told_and_the_service_carries_on(lived: Lived, tmp_path: Path) -> None:
    path, archive = copied(lived, tmp_path)
    by_hand(path, "DELETE FROM sun_point WHERE id % 10 = 3")
    by_hand(path, "UPDATE sun_point SET x_px = NULL WHERE id % 10 = 4")
    by_hand(path, "UPDATE sun_point SET y_px = 'left', sigma_px = 'small' WHERE id % 10 = 5")
    by_hand(path, "UPDATE sun_point SET sigma_px = 'small' WHERE id % 10 = 6")
    served = archive.calibrations.current("roof")
    assert served is not None
    run = lived.run.on(archive)
    run.request("by hand")
    (waiting,) = archive.refits.find("roof", unfinished=True)
    run.worker.carry_out(waiting, threading.Event(), lambda: None)
    assert archive.refits.get(waiting.id).state in ("accepted", "marginal", "refused")
    told = [event for event in archive.events.find("roof") if event.kind == "evidence_changed"]
    current = archive.calibrations.current("roof")
    assert current is not None
    if current.id == served.id:
        assert [event.severity for event in told] == ["alarm"]
    with pytest.raises(InputError, check=lambda error: error.field == f"calibration {served.id}"):
        archive.calibrations.sightings_given_to(served.id)
    error, stated, _ = judged_against(run.truth, from_document(current.document))
    assert error < 3.0 * stated
    archive.close()


def test_a_calibration_of_a_newer_schema_is_kept_told_and_not_replaced(lived: Lived, tmp_path: Path) -> None:
    path, archive = copied(lived, tmp_path)
    served = archive.calibrations.current("roof")
    assert served is not None
    newer = json.dumps({**served.document, "schema": "sunarc.calibration/9"})
    checksum = hashlib.sha256(newer.encode()).hexdigest()
    by_hand(path, "UPDATE calibration SET document = ?, document_sha256 = ? WHERE id = ?", newer, checksum, served.id)
    archive.close()
    archive = open_archive(path)
    predictor = SunPredictor(CameraArchive(archive, name="roof", site=SGP))
    assert predictor.expectation(datetime(2013, 5, 13, 18, tzinfo=UTC)) is None
    run = lived.run.on(archive)
    run.request("by hand")
    (waiting,) = archive.refits.find("roof", unfinished=True)
    run.worker.carry_out(waiting, threading.Event(), lambda: None)
    refit = archive.refits.get(waiting.id)
    assert refit.state == "marginal"
    assert "active_unreadable" in codes(refit.findings)
    current = archive.calibrations.current("roof")
    assert current is not None
    assert current.id == served.id
    assert current.document["schema"] == "sunarc.calibration/9"
    assert [event.kind for event in archive.events.find("roof", severity="alarm")] == ["calibration_unreadable"]
    assert refit.calibration is not None
    assert (
        archive.calibrations.reinstate(refit.calibration, at=run.now, reason="read by this version").state == "current"
    )
    assert predictor.expectation(datetime(2013, 5, 13, 18, tzinfo=UTC)) is not None
    archive.close()


def test_a_refit_cut_short_is_begun_again_and_nothing_is_lost(lived: Lived, tmp_path: Path) -> None:
    _, archive = copied(lived, tmp_path)
    before = archive.calibrations.current("roof")
    run = lived.run.on(archive)
    refit = run.request("cut short")
    stopped = run.with_solve(lambda *_, **__: None)
    stopped.carry_out(refit, threading.Event(), lambda: None)
    assert archive.refits.get(refit.id).state == "running"
    assert archive.calibrations.current("roof") == before
    (waiting,) = archive.refits.find("roof", unfinished=True)
    run.worker.carry_out(waiting, threading.Event(), lambda: None)
    assert archive.refits.get(refit.id).state in ("accepted", "marginal")
    assert archive.refits.find("roof", unfinished=True) == ()
    archive.close()


def test_no_fit_is_made_of_days_whose_clock_was_doubtful(tmp_path: Path) -> None:
    run = LongRun(tmp_path, cadence_s=240.0)
    run.archive.epochs.at("roof", run.now, reason="first frame")
    run.archive.sightings.add(
        SunPoint(
            camera="roof",
            pose_epoch="roof-1",
            time=run.now + timedelta(minutes=n),
            method="disc",
            accepted=True,
            verdict="clear",
            x_px=1.0,
            y_px=1.0,
            clock_error_s=60.0,
        )
        for n in range(30)
    )
    run.now += timedelta(hours=1)
    refit = run.request("now")
    run.worker.carry_out(refit, threading.Event(), lambda: None)
    (unusable,) = run.archive.refits.get(refit.id).findings
    assert (unusable.code, unusable.data["n"], unusable.data["n_doubtful_clock"]) == ("no_usable_sightings", 30, 30)
    run.archive.close()


def test_what_daily_poses_scatter_enters_the_served_uncertainty(lived: Lived, tmp_path: Path) -> None:
    _, archive = copied(lived, tmp_path)
    run = lived.run.on(archive)
    for number in range(8):
        archive.days.save(
            Day(
                camera="roof",
                date=date(2013, 5, 14) + timedelta(days=number),
                verdict="clear",
                findings=(),
                n=300,
                n_possible=300,
                decided_at=run.now,
                pose_offset_deg=(0.05 * (-1) ** number, 0.0, 0.0),
                pose_offset_sigma_deg=(0.001, 0.001, 0.001),
            )
        )
    refit = run.request("now")
    run.worker.carry_out(refit, threading.Event(), lambda: None)
    current = archive.calibrations.current("roof")
    assert current is not None
    assert current.id == archive.refits.get(refit.id).calibration
    assert current.document["evidence"]["pose_spread_deg"] == pytest.approx([0.074, 0.0, 0.0], abs=0.001)
    assert current.document["uncertainty"]["sky_rms_deg"] > 0.03
    archive.close()
