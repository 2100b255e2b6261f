"""The measured air of a day reaches every fit, and the sun's position that the detector expects."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from pathlib import Path

import numpy as np
import pandas as pd
import pvlib
import pytest
from tests.fixtures.archive import make_empty
from tests.fixtures.calibrations import SITE
from tests.fixtures.served import LENS, document

from sunarc.calibration.model.options import CalibrationOptions
from sunarc.calibration.model.sightings import Sightings
from sunarc.calibration.quality.day_quality import measure_day
from sunarc.common.array_types import BoolArray, FloatArray
from sunarc.common.findings import Finding
from sunarc.imager.archive.archive import Archive, CameraArchive, open_archive
from sunarc.imager.archive.values import CameraRecord, Day, DayAir, SunPoint
from sunarc.imager.workers.calibrating import day_judge as days
from sunarc.imager.workers.calibrating.day_judge import DayJudge
from sunarc.imager.workers.calibrating.refit import EpochSearch, RefitTask, next_task
from sunarc.imager.workers.sun_prediction import SunPredictor
from sunarc.optics.forward import project
from sunarc.sky.sun import sun_angles, sun_directions

NOON = datetime(2013, 5, 13, 18, 30, tzinfo=UTC)
LOW_SUN = datetime(2013, 5, 13, 12, 0, tzinfo=UTC)
WARM = DayAir(camera="roof", date=NOON.date(), temperature_c=35.0, pressure_hpa=960.0, set_at=NOON)


def add_sightings(archive: Archive, *, day: int, method: str = "disc") -> None:
    times = (NOON + timedelta(days=day)).timestamp() + 600.0 * np.arange(-30.0, 31.0)
    times = times[sun_angles(times, SITE).apparent_zenith < 88.0]
    pixels = project(LENS, sun_directions(times, SITE))
    archive.sightings.add(
        SunPoint(camera="roof", pose_epoch="roof-1", time=datetime.fromtimestamp(time, UTC), method=method,
                 accepted=True, verdict="clear", x_px=x, y_px=y)
        for time, (x, y) in zip(times.tolist(), pixels.tolist(), strict=True)
    )  # fmt: skip


@pytest.fixture
def archive(tmp_path: Path) -> Iterator[Archive]:
    """Return an archive with a day of sightings in air of 35 degrees, and one of which nothing was measured."""
    make_empty(tmp_path / "sunarc.sqlite")
    opened = open_archive(tmp_path / "sunarc.sqlite")
    opened.cameras.save(
        CameraRecord(name="roof", latitude=SITE.latitude, longitude=SITE.longitude, altitude=SITE.altitude,
                     width=LENS.width, height=LENS.height)
    )  # fmt: skip
    opened.epochs.at("roof", NOON - timedelta(days=9), reason="first")
    add_sightings(opened, day=0)
    add_sightings(opened, day=1)
    opened.days.set_air(WARM)
    yield opened
    opened.close()


def check_air(points: Sightings) -> None:
    """Check that the sightings of the measured day, and only those, carry its air."""
    measured = points.unix_s < (NOON + timedelta(hours=12)).timestamp()
    assert 0 < np.count_nonzero(measured) < len(points)
    assert set(points.temperature[measured].tolist()) == {35.0}
    assert set(points.pressure[measured].tolist()) == {96_000.0}
    assert np.all(np.isnan(points.temperature[~measured]))


def test_a_refit_is_given_the_measured_air(archive: Archive) -> None:
    task = next_task(
        CameraArchive(archive, name="roof", site=SITE), cadence_s=30.0,
        options=CalibrationOptions(), circle=None, now=NOON + timedelta(days=2),
    )  # fmt: skip
    assert isinstance(task, RefitTask)
    check_air(task.problem.points)
    check_air(task.for_epoch("roof-1").points)


def test_the_search_for_pose_epochs_is_given_the_measured_air(archive: Archive) -> None:
    search = EpochSearch(
        camera=CameraArchive(archive, name="roof", site=SITE), options=CalibrationOptions(), circle=None,
        now=lambda: NOON + timedelta(days=2),
    )  # fmt: skip
    problem = search.due()
    assert problem is not None
    check_air(problem.points)


def test_a_day_is_judged_in_its_measured_air(archive: Archive, monkeypatch: pytest.MonkeyPatch) -> None:
    given: list[Sightings] = []

    def noting(points: Sightings, **how: object) -> object:
        given.append(points)
        return measure_day(points, **how)  # type: ignore[arg-type]

    monkeypatch.setattr(days, "measure_day", noting)
    judge = DayJudge(
        camera=CameraArchive(archive, name="roof", site=SITE), cadence_s=lambda: 600.0, sun_zenith_deg=88.0,
        now=lambda: NOON + timedelta(days=2), request_refit=lambda _: None,  # type: ignore[arg-type, return-value]
    )  # fmt: skip
    assert len(judge.judge_ended_days()) == 2
    by_time = sorted(given, key=lambda points: float(points.unix_s[0]))
    assert set(by_time[0].temperature.tolist()) == {35.0}
    assert np.all(np.isnan(by_time[1].temperature))


def test_a_clear_day_with_trees_in_the_suns_way_is_clear(archive: Archive) -> None:
    noon = (NOON + timedelta(days=2)).timestamp()
    add_sightings(archive, day=2)
    archive.sightings.exclude(
        "roof", Finding("sun_elsewhere"), since=NOON + timedelta(days=2, hours=-3), until=NOON + timedelta(days=2)
    )

    def judged(hidden: Callable[[FloatArray], BoolArray]) -> Day:
        judge = DayJudge(
            camera=CameraArchive(archive, name="roof", site=SITE), cadence_s=lambda: 600.0, sun_zenith_deg=88.0,
            now=lambda: NOON + timedelta(days=3), request_refit=lambda _: None,  # type: ignore[arg-type, return-value]
            hidden=hidden,
        )  # fmt: skip
        judge.look_back()
        judge.judge_again(date_of_third)
        return next(day for day in judge.judge_ended_days() if day.date == date_of_third)

    date_of_third = (NOON + timedelta(days=2)).date()
    without = judged(lambda unix_s: np.zeros(unix_s.shape, dtype=bool))
    trees = judged(lambda unix_s: (unix_s > noon - 3.0 * 3600.0 - 1.0) & (unix_s < noon - 1.0))
    assert (without.verdict, trees.verdict) == ("partly", "clear")
    assert trees.n == without.n
    assert without.n_possible - trees.n_possible == 18
    assert trees.n_observed == trees.n


def test_the_expected_sun_moves_by_what_pvlib_says(archive: Archive) -> None:
    archive.calibrations.add(document("a"))
    archive.calibrations.activate("a")
    predictor = SunPredictor(CameraArchive(archive, name="roof", site=SITE))
    warm = predictor.expectation(LOW_SUN)
    archive.days.set_air(replace(WARM, temperature_c=None, pressure_hpa=None))
    assumed = predictor.expectation(LOW_SUN)
    assert warm is not None
    assert assumed is not None

    def by_pvlib(temperature: float, pressure_pa: float) -> float:
        found = pvlib.solarposition.get_solarposition(
            pd.DatetimeIndex([LOW_SUN]), SITE.latitude, SITE.longitude, altitude=SITE.altitude,
            pressure=pressure_pa, temperature=temperature, delta_t=None,
        )  # fmt: skip
        return float(found["apparent_zenith"].iloc[0])

    shift_deg = by_pvlib(35.0, 96_000.0) - by_pvlib(SITE.temperature, SITE.pressure_pa)
    assert shift_deg > 0.005
    assert warm.apparent_zenith is not None
    assert assumed.apparent_zenith is not None
    assert np.degrees(warm.apparent_zenith - assumed.apparent_zenith) == pytest.approx(shift_deg, abs=1e-5)
    there = sun_angles(LOW_SUN.timestamp(), SITE)
    step = project(LENS, sun_directions(LOW_SUN.timestamp(), replace(SITE, temperature=35.0, pressure=96_000.0)))
    step -= project(LENS, sun_directions(LOW_SUN.timestamp(), SITE))
    assert there.apparent_zenith > 80.0
    found = np.array([warm.x_px, warm.y_px], dtype=np.float64) - np.array(
        [assumed.x_px, assumed.y_px], dtype=np.float64
    )
    np.testing.assert_allclose(found, step, atol=0.01)
