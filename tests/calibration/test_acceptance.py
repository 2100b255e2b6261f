"""Which fit takes the place of the current one."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import pytest
from tests.fixtures.finding_codes import codes

from sunarc.calibration import acceptance
from sunarc.calibration.acceptance import distance_px, unseen_points
from sunarc.calibration.answers.covariance import hemisphere
from sunarc.calibration.model.result import Verdict
from sunarc.calibration.model.sightings import Sightings
from sunarc.calibration.verdict import accept
from sunarc.common.findings import Finding
from sunarc.optics.camera import PARAMETER_NAMES
from sunarc.optics.forward import project, project_with_rows_fast
from sunarc.sky.sun import sun_directions

if TYPE_CHECKING:
    from tests.fixtures.clear_day import Simulated

    from sunarc.calibration.model.result import Calibration


def knowing(calibration: Calibration, *days: str, sky: float = 1.0) -> Calibration:
    """Return a calibration that rests on more days, and states another sigma."""
    evidence = replace(calibration.evidence, days=(*calibration.evidence.days, *days))
    return replace(calibration, evidence=evidence, sky_rms_deg=sky * calibration.sky_rms_deg)


def turned(calibration: Calibration, sigmas: float) -> Calibration:
    """Return a calibration turned about the vertical by so many of its stated sigmas over the sky."""
    x, y, z = calibration.camera.rotation_cam_enu
    turn = np.radians(sigmas * calibration.sky_rms_deg * np.sqrt(3.0))
    return replace(calibration, camera=replace(calibration.camera, rotation_cam_enu=(x, y, z + turn)))


def swayed(calibration: Calibration, sigmas: float) -> Calibration:
    """Return a calibration changed by so many sigmas in the way that it knows the sky least."""
    chosen = [PARAMETER_NAMES.index(name) for name in calibration.parameter_names]
    rows = project_with_rows_fast(calibration.camera, hemisphere(400))[1].reshape(-1, 23)[:, chosen]
    root = np.linalg.cholesky(calibration.covariance + 1e-18 * np.eye(len(chosen)))
    rows = rows[np.all(np.isfinite(rows), axis=1)] @ root
    ways = np.linalg.eigh(rows.T @ rows)[1]
    vector = calibration.camera.to_vector()
    vector[chosen] += sigmas * (root @ ways[:, -1])
    return replace(calibration, camera=calibration.camera.replace_parameters(vector))


def test_what_refuses_itself_is_refused_for_its_own_reasons(calibrated: Calibration) -> None:
    own = Verdict(accepted=False, findings=(Finding("tilt_too_large"),))
    assert accept(replace(calibrated, verdict=own), calibrated) == own


def test_less_sure_on_the_same_days_is_not_served(calibrated: Calibration) -> None:
    somewhat, far = (accept(knowing(calibrated, sky=s), calibrated) for s in (1.5, 3.0))
    assert (somewhat.accepted, somewhat.marginal) == (False, True)
    assert (far.accepted, far.marginal) == (False, False)
    assert codes(far.findings) == ["direction_sigma_increased"]


def test_the_same_fit_once_more_says_nothing_new(calibrated: Calibration) -> None:
    again = accept(calibrated, calibrated)
    assert (again.accepted, again.marginal) == (False, True)
    assert codes(again.findings) == ["no_change"]


def test_a_fit_that_knows_more_may_find_the_current_one_too_sure(calibrated: Calibration) -> None:
    assert accept(knowing(calibrated, "2013-05-20", sky=3.0), calibrated).accepted
    assert not accept(knowing(calibrated, "2013-05-20", sky=20.0), calibrated).accepted


def test_a_change_beyond_what_is_stated_waits_for_proof(calibrated: Calibration, clear_day: Simulated) -> None:
    changed = swayed(knowing(calibrated, "2013-05-20"), 3.5)
    waiting = accept(changed, calibrated)
    assert (waiting.accepted, waiting.marginal) == (False, True)
    assert "change_not_confirmed" in codes(waiting.findings)
    times = clear_day.points.unix_s + 120 * 86_400.0
    seen = project(changed.camera, sun_directions(times, clear_day.site))
    assert accept(changed, calibrated, unseen=Sightings.of(unix_s=times, pixels=seen)).accepted


def test_a_sky_that_contradicts_the_current_one_is_refused_whatever_the_proof(
    calibrated: Calibration, clear_day: Simulated
) -> None:
    moved = turned(knowing(calibrated, "2013-05-20"), 40.0)
    seen = project(moved.camera, sun_directions(clear_day.points.unix_s, clear_day.site))
    verdict = accept(moved, calibrated, unseen=Sightings.of(unix_s=clear_day.points.unix_s, pixels=seen))
    assert (verdict.accepted, verdict.marginal) == (False, False)
    assert verdict.findings[0].code == "contradicts_active"


@pytest.mark.parametrize(("found", "marginal"), [(0.09, True), (0.2, False)])
def test_days_left_out_that_are_met_worse_than_expected_speak_against_a_fit(
    calibrated: Calibration, found: float, *, marginal: bool
) -> None:
    metrics = replace(calibrated.metrics, held_out_rmse_px=found, held_out_expected_px=0.03)
    verdict = accept(replace(calibrated, metrics=metrics))
    assert (verdict.accepted, verdict.marginal) == (False, marginal)
    assert codes(verdict.findings) == ["cross_validation_rmse"]
    assert verdict.findings[0].data == {"rmse_px": found, "expected_px": 0.03}


def test_no_distance_of_a_refused_succession_is_larger_than_the_image(calibrated: Calibration) -> None:
    metrics = replace(calibrated.metrics, held_out_rmse_px=1e7, held_out_expected_px=0.03)
    (found,) = accept(replace(calibrated, metrics=metrics)).findings
    diagonal_px = math.hypot(calibrated.camera.width, calibrated.camera.height)
    assert found.data == {"rmse_px": pytest.approx(diagonal_px), "expected_px": 0.03}


def test_a_focal_length_that_follows_the_season_contradicts_no_camera_of_another_season(
    calibrated: Calibration,
) -> None:
    vector = calibrated.camera.to_vector()
    vector[:2] *= 1.002
    winter = replace(knowing(calibrated, "2013-11-20"), camera=calibrated.camera.replace_parameters(vector))
    assert not accept(winter, calibrated).accepted
    known = replace(winter, evidence=replace(winter.evidence, log_odds={"season_share": 0.002}))
    assert accept(known, calibrated).accepted
    stepped = replace(winter, evidence=replace(winter.evidence, log_odds={"season_share": 0.0001}))
    assert not accept(stepped, calibrated).accepted


def test_the_other_hand_is_refused(calibrated: Calibration) -> None:
    flipped = replace(calibrated, camera=replace(calibrated.camera, mirrored=True))
    assert codes(accept(flipped, calibrated).findings) == ["handedness_differs"]


def test_unseen_are_the_latest_poses_days_that_a_calibration_does_not_know(
    calibrated: Calibration, clear_day: Simulated
) -> None:
    times = np.concatenate([clear_day.points.unix_s + 86_400.0 * n for n in range(3)])
    epoch = np.repeat([0, 0, 1], len(clear_day.points))
    points = Sightings.of(unix_s=times, pixels=np.zeros((times.size, 2)), epoch=epoch)
    assert len(unseen_points(points, calibrated)) == len(clear_day.points)
    assert len(unseen_points(points.select(epoch == 0), calibrated)) == len(clear_day.points)


def test_the_distance_of_a_camera_from_itself_is_nothing(calibrated: Calibration) -> None:
    assert distance_px(calibrated, calibrated) == 0.0
    assert distance_px(turned(calibrated, 1.0), calibrated) > 0.0


def test_sightings_are_met_in_their_measured_air(calibrated: Calibration, clear_day: Simulated) -> None:
    times = clear_day.points.unix_s
    air = np.full(times.size, 40.0)
    pixels = project(calibrated.camera, sun_directions(times, calibrated.site, temperature=air))
    measured, assumed = (
        acceptance.chi_square(calibrated, Sightings.of(unix_s=times, pixels=pixels, temperature=one), 0.02)
        for one in (air, np.full(times.size, np.nan))
    )
    assert measured < 1e-9
    assert assumed > 1.0


@pytest.mark.parametrize(("sigmas", "same"), [(5e-4, True), (0.01, False)])
def test_a_fit_of_the_same_days_that_moved_by_a_thousandth_of_a_sigma_says_the_same(
    calibrated: Calibration, sigmas: float, *, same: bool
) -> None:
    again = swayed(calibrated, sigmas)
    assert ("no_change" in codes(accept(again, calibrated).findings)) == same
    assert acceptance.says_the_same(again, calibrated) == same


@pytest.mark.parametrize("sigma_px", [0.0, np.nan])
def test_a_fit_without_a_noise_has_no_proof(calibrated: Calibration, clear_day: Simulated, sigma_px: float) -> None:
    knows_more = swayed(knowing(calibrated, "2013-05-20"), 3.5)
    changed = replace(knows_more, evidence=replace(knows_more.evidence, sigma_px=sigma_px))
    times = clear_day.points.unix_s + 120 * 86_400.0
    seen = project(changed.camera, sun_directions(times, clear_day.site))
    verdict = accept(changed, calibrated, unseen=Sightings.of(unix_s=times, pixels=seen))
    assert (verdict.accepted, verdict.marginal) == (False, True)
    assert "change_not_confirmed" in codes(verdict.findings)
