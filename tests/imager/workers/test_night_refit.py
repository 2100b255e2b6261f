"""A refit uses the stars of the night beside the sun, and can be reproduced."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pytest
from tests.fixtures.archive import new_archive

from sunarc.calibration.answers.covariance import hemisphere
from sunarc.calibration.calibrate import calibrate
from sunarc.calibration.model.options import CalibrationOptions
from sunarc.calibration.model.result import Calibration
from sunarc.common.array_types import FloatArray, NameArray
from sunarc.common.utc import utc_time
from sunarc.imager.archive.archive import Archive, CameraArchive
from sunarc.imager.archive.values import CameraRecord, SunPoint
from sunarc.imager.workers.calibrating.refit import RefitTask, next_task
from sunarc.imager.workers.calibrating.solver_process import columns_to_sightings
from sunarc.lab.simulation.truth import SGP, true_camera
from sunarc.optics.forward import project
from sunarc.sky.night import body_directions, night_sky
from sunarc.sky.sun import sun_angles, sun_directions

NOW = datetime(2013, 5, 14, 12, 0, tzinfo=UTC)
SUN_PX, STAR_PX = 0.03, 0.12


def sun_points(rng: np.random.Generator) -> list[SunPoint]:
    times = datetime(2013, 5, 13, 6, tzinfo=UTC).timestamp() + np.arange(0.0, 86_400.0, 120.0)
    times = times[sun_angles(times, SGP).apparent_zenith < 88.0]
    pixels = project(true_camera(), sun_directions(times, SGP)) + rng.normal(0.0, SUN_PX, (times.size, 2))
    names = np.full(times.size, "sun")
    return _points(times, pixels, names, np.full(times.size, SUN_PX))


def star_points(rng: np.random.Generator, *, clock_error_s: float = 0.01) -> list[SunPoint]:
    points = []
    for hour in (3.5, 5.5, 7.5, 9.5):
        moment = datetime(2013, 5, 14, tzinfo=UTC).timestamp() + 3600.0 * hour
        sky = night_sky(moment, SGP, faintest=4.0)
        sky = sky.select(sky.directions[:, 2] > 0.15)
        pixels = project(true_camera(), sky.directions) + rng.normal(0.0, STAR_PX, (len(sky), 2))
        points += _points(np.full(len(sky), moment), pixels, sky.names, np.full(len(sky), STAR_PX))
    return [replace(point, method="star", clock_error_s=clock_error_s) for point in points]


def _points(times: FloatArray, pixels: FloatArray, names: NameArray, sigma: FloatArray) -> list[SunPoint]:
    return [
        SunPoint(
            camera="roof", pose_epoch="roof-1", time=utc_time(time), body=name, method="disc", accepted=True,
            verdict="clear", x_px=x, y_px=y, sigma_px=one,
        )
        for time, (x, y), name, one in zip(times.tolist(), pixels.tolist(), names.tolist(), sigma.tolist(), strict=True)
    ]  # fmt: skip


@pytest.fixture
def camera(tmp_path: Path) -> Iterator[CameraArchive]:
    archive = new_archive(tmp_path)
    lens = true_camera()
    archive.cameras.save(CameraRecord.at(SGP, name="roof", width=lens.width, height=lens.height))
    archive.epochs.at("roof", datetime(2013, 5, 13, 6, tzinfo=UTC), reason="first frame")
    archive.sightings.add(sun_points(np.random.default_rng(1)))
    yield CameraArchive(archive, name="roof", site=SGP)
    archive.close()


def task_of(camera: CameraArchive) -> RefitTask:
    task = next_task(camera, cadence_s=30.0, options=CalibrationOptions(), circle=None, now=NOW)
    assert isinstance(task, RefitTask)
    return task


def solved(task: RefitTask) -> Calibration:
    problem = task.problem
    return calibrate(problem.points, site=problem.site, image_size=problem.image_size, options=problem.options)


def north_px(calibration: Calibration) -> float:
    sky = hemisphere(1000)
    sky = sky[(sky[:, 1] > 0.0) & (sky[:, 2] > 0.1)]
    return float(
        np.sqrt(np.mean(np.sum((project(calibration.camera, sky) - project(true_camera(), sky)) ** 2, axis=-1)))
    )


def test_a_fit_has_the_sun_and_at_most_150_stars_all_over_the_image(camera: CameraArchive) -> None:
    camera.archive.sightings.add(star_points(np.random.default_rng(2)))
    task = task_of(camera)
    of_sun = task.used.body == "sun"
    assert np.count_nonzero(~of_sun) == 150
    assert np.count_nonzero(of_sun) > 300
    assert np.all(np.diff(task.used.unix_s) >= 0.0)
    points = task.problem.points
    assert np.array_equal(np.isnan(points.directions[:, 0]), of_sun)
    expected = body_directions(task.used.body, task.used.unix_s, SGP)
    np.testing.assert_allclose(points.directions[~of_sun], expected[~of_sun], atol=1e-12)
    assert np.unique(np.floor(np.arctan2(*(task.used.pixels[~of_sun] - 873.5).T) / (np.pi / 6.0))).size == 12


def test_stars_beside_the_sun_make_the_sky_better_known_and_the_fit_is_reproduced(camera: CameraArchive) -> None:
    alone = solved(task_of(camera))
    camera.archive.sightings.add(star_points(np.random.default_rng(2)))
    task = task_of(camera)
    both = solved(task)
    assert both.verdict.accepted
    # one day may be right by chance: what stars add is in what is stated
    assert north_px(both) < 0.025
    assert both.sky_rms_deg < 0.6 * alone.sky_rms_deg
    kept = camera.archive.sightings.columns("roof", body=None).select(
        np.isin(camera.archive.sightings.columns("roof", body=None).ids, task.used.ids)
    )
    again = columns_to_sightings(kept, site=SGP)
    np.testing.assert_array_equal(again.directions, task.problem.points.directions)
    np.testing.assert_array_equal(again.pixels, task.problem.points.pixels)


def test_stars_of_a_doubtful_clock_or_of_an_epoch_without_the_sun_are_not_used(camera: CameraArchive) -> None:
    stars = star_points(np.random.default_rng(2), clock_error_s=5.0)
    camera.archive.sightings.add(stars)
    assert set(task_of(camera).used.body.tolist()) == {"sun"}


def test_stars_alone_are_nothing_to_solve(tmp_path: Path) -> None:
    archive: Archive = new_archive(tmp_path)
    archive.epochs.at("roof", datetime(2013, 5, 13, 6, tzinfo=UTC), reason="first frame")
    archive.sightings.add(star_points(np.random.default_rng(2)))
    found = next_task(
        CameraArchive(archive, name="roof", site=SGP),
        cadence_s=30.0,
        options=CalibrationOptions(),
        circle=None,
        now=NOW,
    )
    assert not isinstance(found, RefitTask)
    assert found.code == "no_accepted_sightings"
    archive.close()
