"""What a fit that is refused for its uncertainty says: what the sightings determine, and which hours and days lack."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from tests.fixtures.calibration import current_document
from tests.fixtures.clear_day import times_of
from tests.fixtures.finding_codes import codes

from sunarc.calibration.answers.covariance import hemisphere, project_with_covariance, sigma_deg, unproject_with_sigma
from sunarc.calibration.answers.direction_table import lookup
from sunarc.calibration.calibrate import calibrate
from sunarc.calibration.model.options import CalibrationOptions
from sunarc.calibration.model.result import Calibration
from sunarc.calibration.model.sightings import Sightings
from sunarc.calibration.verdict import provisional
from sunarc.formats.calibration_document import from_document
from sunarc.formats.formats import calibration_view
from sunarc.lab.simulation.truth import SGP, true_camera
from sunarc.optics.camera import Camera, camera_sees
from sunarc.optics.forward import project
from sunarc.optics.inverse import unproject
from sunarc.optics.pose import rotation_matrix
from sunarc.sky.sun import sun_directions

N = 23
STRICT = CalibrationOptions(projection="equisolid", max_sky_deg=0.05)
"""Refuses all of these fits for their uncertainty, and for nothing else."""
OF_UNCERTAINTY = {"direction_sigma_too_large", "sightings_determine", "hours_missing", "declinations_alike"}


def _fit(seed: int, days: tuple[float, ...], *, options: CalibrationOptions = STRICT) -> tuple[Camera, Calibration]:
    """Return a camera, and its fit to 23 sightings of mornings with errors of 0.25 to 2.3 px."""
    truth, rng = true_camera(seed), np.random.default_rng(2000 + seed)
    times = times_of(days, site=SGP, cadence_s=60.0)
    directions = sun_directions(times, SGP)
    pixels = project(truth, directions)
    morning = (directions[:, 0] > 0.0) & np.all((pixels > 0.0) & (pixels < truth.width), axis=-1)
    some = np.sort(rng.choice(np.flatnonzero(morning), N, replace=False))
    errors = rng.normal(size=(N, 2)) * rng.uniform(0.25, 2.3, (N, 1)) / math.sqrt(2.0)
    points = Sightings.of(unix_s=times[some], pixels=pixels[some] + errors)
    return truth, calibrate(points, site=SGP, image_size=(truth.width, truth.height), options=options)


def _data(fit: Calibration, code: str) -> dict[str, float]:
    (found,) = [one for one in fit.verdict.findings if one.code == code]
    return {name: float(value) for name, value in found.data.items() if not isinstance(value, str)}


def test_what_is_stated_of_arc_and_pose_holds() -> None:
    of_arc, of_pose = [], []
    for seed in range(6):
        truth, fit = _fit(seed, (0.0,))
        assert set(codes(fit.verdict.findings)) == OF_UNCERTAINTY
        stated = _data(fit, "sightings_determine")
        # the middle of the morning, by the pixel that the true camera has there
        times = times_of((0.0,), site=SGP, cadence_s=600.0)
        sun = sun_directions(times, SGP)
        sun = sun[(sun[:, 0] > 0.0) & (sun[:, 2] > 0.3)]
        off = np.degrees(np.linalg.norm(unproject(fit.camera, project(truth, sun)) - sun, axis=-1)) / math.sqrt(2.0)
        of_arc.append(float(np.sqrt(np.mean(off**2))) / stated["arc_deg"])
        between = rotation_matrix(fit.camera.rotation_cam_enu) @ rotation_matrix(truth.rotation_cam_enu).T
        of_pose.append(math.degrees(math.acos(min((np.trace(between) - 1.0) / 2.0, 1.0))) / stated["pose_deg"])
        assert stated["arc_deg"] < fit.sky_rms_deg
    for ratios in (of_arc, of_pose):
        assert 0.1 < np.sqrt(np.mean(np.square(ratios))) < 1.8
        assert max(ratios) < 3.5


def test_the_hours_and_the_days_that_lack_are_named() -> None:
    _, fit = _fit(1, (0.0,))
    hours, days = _data(fit, "hours_missing"), _data(fit, "declinations_alike")
    assert hours["covered_h"] < 0.7 * hours["up_h"]
    assert days["days"] == 1
    assert days["least_deg"] == days["most_deg"]


def test_the_stored_document_has_them() -> None:
    _, fit = _fit(1, (0.0,))
    stored = from_document(current_document(fit)).verdict
    assert set(codes(stored.findings)) == OF_UNCERTAINTY


@pytest.mark.parametrize(("apart", "alike"), [(-10.0, True), (-20.0, False)])
def test_days_whose_tracks_are_apart_are_not_called_alike(apart: float, alike: bool) -> None:  # noqa: FBT001
    _, fit = _fit(2, (apart, 0.0))
    assert ("declinations_alike" in codes(fit.verdict.findings)) is alike
    assert "sightings_determine" in codes(fit.verdict.findings)


LIMIT_DEG = 0.5


@pytest.fixture(scope="module")
def morning() -> tuple[Camera, Calibration]:
    """Return a camera, and its fit to the sightings of one morning, kept as provisional."""
    truth, fit = _fit(2, (0.0,))
    assert not fit.verdict.accepted
    return truth, provisional(fit, limit_deg=LIMIT_DEG)


def test_a_provisional_fit_answers_where_it_is_sure_and_is_right_there(morning: tuple[Camera, Calibration]) -> None:
    truth, kept = morning
    assert (kept.verdict.accepted, kept.verdict.marginal) == (False, True)
    sky = hemisphere(600)
    at = project(truth, sky)
    seen = camera_sees(truth, at)
    found, sigma, inside = unproject_with_sigma(kept, at[seen])
    off = np.degrees(np.linalg.norm(found - sky[seen], axis=-1))
    assert _data(kept, "provisional_where_sure")["share"] == pytest.approx(np.mean(inside), abs=0.05)
    assert 0.05 < np.mean(inside) < 0.95
    assert np.all(sigma[inside] <= LIMIT_DEG)
    assert np.all(np.isnan(found[~inside]))
    assert np.mean(off[inside] < 2.45 * sigma[inside]) > 0.9
    pixels, covariance = project_with_covariance(kept, sky)
    whole = sigma_deg(kept, sky)
    assert np.array_equal(np.isfinite(pixels[:, 0]), whole <= LIMIT_DEG)
    assert np.array_equal(np.isfinite(covariance[:, 0, 0]), whole <= LIMIT_DEG)


def test_maps_and_comparisons_have_the_same_limit(morning: tuple[Camera, Calibration]) -> None:
    truth, kept = morning
    sky = hemisphere(600)
    sky = sky[camera_sees(truth, project(truth, sky))]
    clear = np.abs(sigma_deg(kept, sky) - LIMIT_DEG) > 0.02  # beside the edge the table may decide otherwise
    sure = sigma_deg(kept, sky) <= LIMIT_DEG
    ready, pixels = lookup(kept), project(kept.camera, sky)
    for rows in (ready.project(sky), ready.back_project(pixels)):
        assert np.array_equal((rows[:, -1] == 1.0)[clear], sure[clear])
        assert np.array_equal(np.isfinite(rows[:, 0])[clear], sure[clear])
    view = calibration_view(kept)
    assert np.array_equal(np.isfinite(view.project(sky)[:, 0]), sure)
    assert np.array_equal(np.isfinite(view.unproject(pixels)[:, 0])[clear], sure[clear])


def test_the_limit_is_in_the_document_and_none_is_in_those_without(morning: tuple[Camera, Calibration]) -> None:
    stored = current_document(morning[1])
    assert from_document(stored).sigma_limit_deg == LIMIT_DEG
    del stored["uncertainty"]["sigma_limit_deg"]
    assert from_document(stored).sigma_limit_deg is None
    assert "sigma_limit_deg" not in current_document(from_document(stored))["uncertainty"]


def test_a_fit_that_sightings_contradict_is_refused_all_the_same() -> None:
    truth, rng = true_camera(1), np.random.default_rng(5)
    times = times_of((0.0,), site=SGP, cadence_s=600.0)[:N]
    pixels = project(truth, sun_directions(times, SGP)) + rng.normal(0.0, 0.7, (N, 2))
    late = times + np.where(np.arange(N) < N // 2, 0.0, 3600.0)
    size = (truth.width, truth.height)
    fit = calibrate(Sightings.of(unix_s=late, pixels=pixels), site=SGP, image_size=size, options=STRICT)
    kept = provisional(fit, limit_deg=30.0)
    assert (kept.verdict.accepted, kept.verdict.marginal, kept.sigma_limit_deg) == (False, False, None)


def test_a_tilt_must_be_stated() -> None:
    _, fit = _fit(1, (0.0,))  # the true camera is tilted by more than 5 degrees
    assert codes(provisional(fit, limit_deg=1.0).verdict.findings)[0] == "provisional_tilted"
    stated = replace(STRICT, level_within_deg=20.0)
    _, fit = _fit(1, (0.0,), options=stated)
    assert provisional(fit, limit_deg=1.0).sigma_limit_deg == 1.0


def test_a_fit_that_is_sure_of_nothing_or_accepted_stays_as_it_is() -> None:
    _, fit = _fit(2, (0.0,))
    assert provisional(fit, limit_deg=1e-3) is fit
    good = replace(fit, verdict=replace(fit.verdict, accepted=True))
    assert provisional(good, limit_deg=LIMIT_DEG) is good


def test_an_accepted_fit_does_not_speak_of_what_lacks() -> None:
    _, fit = _fit(3, (-90.0, 0.0), options=CalibrationOptions(projection="equisolid", max_sky_deg=30.0))
    assert fit.verdict.accepted
    assert not OF_UNCERTAINTY & set(codes(fit.verdict.findings))
