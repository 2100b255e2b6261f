"""Real-like tracks: the robust fit meets the sightings at least about as well as the paper's method."""

from __future__ import annotations

import csv
from dataclasses import replace
from datetime import datetime
from pathlib import Path

import numpy as np
import pytest
from held_out import turned
from numpy.typing import NDArray
from real_like_fits import compared, sky_error_px
from real_like_tracks import Draw, drawn_aside, real_like_track

from sunarc.calibration.answers.covariance import hemisphere, project_with_covariance
from sunarc.calibration.calibrate import calibrate
from sunarc.calibration.model.options import CalibrationOptions
from sunarc.calibration.model.sightings import Sightings, filter_sightings
from sunarc.calibration.solve.priors import lens_prior
from sunarc.calibration.solve.problem import FitProblem, problem_for
from sunarc.calibration.start.multistart import lowest
from sunarc.optics.forward import project
from sunarc.optics.pose import rotation_matrix
from sunarc.sky.site import Site
from sunarc.sky.sun import sun_directions

REAL = Path(__file__).parents[3] / "shared" / "real" / "fe4_2016-08-30.csv"
EQUIDISTANT = Draw(projection="equidistant", cloud="middle", thin=1)

# Seed 26 ended 3.6 px (median) off, a field of 7 px beside a camera that met nothing.
# Seed 398, tilted by 27 degrees, ended 42 % above the paper's cost, 46 px off over the sky, and accepted.
HARD = [(26, EQUIDISTANT), (2, Draw()), (9, Draw()), (13, Draw()), (398, Draw())]


@pytest.mark.parametrize(("seed", "draw"), HARD)
def test_the_fit_is_not_worse_than_the_paper_s(seed: int, draw: Draw) -> None:
    one = compared(real_like_track(seed, draw))
    assert one.above <= 1e-6
    assert one.ratio <= 1.05
    assert 0.8 < one.core_px < 3.0


def test_a_camera_that_does_not_answer_for_part_of_the_sun_s_track_does_not_win() -> None:
    # Tilted by 48 degrees. At 67 degrees the sightings are met as well, by 1 power of e, 57 of them beyond the
    # 100 degrees that the camera answers: the fit was refused, and with two poses a move was named.
    track = real_like_track(399)
    fit = calibrate(track.points, site=track.site, image_size=track.image_size, options=track.options)
    predicted = project(fit.camera, sun_directions(track.points.unix_s, track.site))
    assert np.all(np.isfinite(predicted))
    assert fit.verdict.accepted
    lean = np.degrees(np.arccos(rotation_matrix(fit.camera.rotation_cam_enu)[2, 2]))
    assert lean == pytest.approx(track.drawn.tilt_deg, abs=3.0)
    assert 1.0 < sky_error_px(fit, track) < 10.0


def test_a_fit_that_parts_of_its_sightings_contradict_is_refused() -> None:
    # the camera is turned by a few px in the middle of the day
    track = real_like_track(372)
    late = 2 * np.arange(len(track.points)) > len(track.points)
    points = replace(track.points, pixels=track.points.pixels + np.outer(late, [10.0, -6.0]))
    fit = calibrate(points, site=track.site, image_size=track.image_size, options=track.options)
    assert not fit.verdict.accepted
    (finding,) = (one for one in fit.verdict.findings if one.code == "held_out_contradicts")
    assert finding.data["excess"] == fit.evidence.held_out["excess"]
    assert float(finding.data["excess"]) > float(finding.data["limit"])
    unasked = calibrate(points, site=track.site, image_size=track.image_size, options=track.options, parts=False)
    assert unasked.verdict.accepted
    assert not unasked.evidence.held_out


def test_where_parts_are_predicted_worse_than_stated_more_is_stated() -> None:
    track = real_like_track(613)
    one, other = (
        calibrate(track.points, site=track.site, image_size=track.image_size, options=track.options, parts=parts)
        for parts in (False, True)
    )
    factor = other.evidence.held_out["widening"]
    assert 1.1 < factor < 2.0
    assert other.sky_rms_deg == pytest.approx(factor * one.sky_rms_deg, rel=1e-3)
    sky = hemisphere(50)
    narrow, wide = (project_with_covariance(fit, sky)[1] for fit in (one, other))
    np.testing.assert_allclose(wide, factor**2 * narrow, rtol=1e-3, atol=1e-3)
    assert other.camera == one.camera
    (finding,) = (each for each in other.verdict.findings if each.code == "sigma_of_parts")
    assert finding.data["factor"] == factor


def test_a_camera_that_is_turned_between_two_days_is_named() -> None:
    track = turned(1).track
    fit = calibrate(track.points, site=track.site, image_size=track.image_size, options=track.options)
    assert not fit.verdict.accepted
    (finding,) = (one for one in fit.verdict.findings if one.code == "camera_turned")
    assert float(finding.data["turn_deg"]) == pytest.approx(0.1, abs=0.05)
    assert float(finding.data["chi_square"]) > float(finding.data["limit"])


def _problem(track_seed: int) -> tuple[FitProblem, Sightings, NDArray[np.float64]]:
    """Return the problem of a clear track, its sightings and the unknowns of a camera near the truth."""
    track = real_like_track(track_seed, EQUIDISTANT, cloud="none", tilt_deg=2.0, half_day=False, gaps=False)
    fit = calibrate(track.points, site=track.site, image_size=track.image_size, options=track.options)
    prior = lens_prior(fit.camera, tolerances=track.options.tolerances, circle=None, field_angle=np.pi / 2)
    problem = problem_for(fit.camera, prior, n_epochs=1)
    usable = filter_sightings(track.points, site=track.site)
    return problem, usable, problem.unknowns([fit.camera])


def test_the_lowest_of_the_starts_is_the_one_that_meets_the_sightings() -> None:
    problem, seen, good = _problem(7)
    missed = good.copy()
    missed[5] += 60.0
    assert lowest(problem, seen, [missed, good], precision=np.full(problem.size, 1e-6)) is good


@pytest.mark.real
@pytest.mark.skipif(not REAL.exists(), reason="the real sun tracks are not here")
def test_a_real_track_drawn_aside_by_cloud_for_16_minutes_fits_as_before() -> None:
    with REAL.open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    times = np.array([datetime.fromisoformat(row["time_utc"]).timestamp() for row in rows])
    pixels = np.array([[float(row["x_px"]), float(row["y_px"])] for row in rows])
    share = (times - times[0] - 0.4 * np.ptp(times)) / 960.0
    clouded = (share >= 0.0) & (share <= 1.0)
    aside = drawn_aside(np.random.default_rng(6), np.clip(share, 0.0, 1.0), 5.0) * clouded[:, None]
    site = Site(latitude=54.495866, longitude=11.237683, altitude=9.0)
    options = CalibrationOptions(projection="equidistant")
    points = Sightings.of(unix_s=times, pixels=pixels + aside)
    clear = calibrate(replace(points, pixels=pixels), site=site, image_size=(1920, 1920), options=options)
    found = calibrate(points, site=site, image_size=(1920, 1920), options=options)
    paper = calibrate(points, site=site, image_size=(1920, 1920), options=replace(options, method="paper"))
    assert found.verdict.accepted, found.verdict.reasons
    assert found.metrics.rmse_px <= min(0.43, 1.05 * clear.metrics.rmse_px)
    left = [
        np.linalg.norm(points.pixels - project(one.camera, sun_directions(times, site)), axis=-1)
        for one in (found, paper)
    ]
    assert np.median(left[0]) <= 1.05 * np.median(left[1])
