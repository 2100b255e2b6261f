"""A stated camera and a few sightings: better than either, with errors as stated; a wrong statement is refused."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from sunarc.calibration.answers.covariance import hemisphere, project_with_covariance
from sunarc.calibration.answers.error_model import rotated
from sunarc.calibration.calibrate import calibrate
from sunarc.calibration.model.options import CalibrationOptions
from sunarc.calibration.model.result import Calibration
from sunarc.calibration.solve.priors import FREE
from sunarc.calibration.stated_prior import PriorTolerances, calibrate_with_prior, whitened_basis
from sunarc.common.errors import InputError
from sunarc.imager.commands.calibrate_archive import reproduce_calibration
from sunarc.optics.camera import Camera
from sunarc.optics.forward import project

if TYPE_CHECKING:
    from tests.fixtures.clear_day import Simulated, Simulator

TOLERANCES = PriorTolerances(lens_px=2.0, pose_deg=1.0)
SKY = hemisphere(200)


def some(simulator: Simulator, truth: Camera, count: int, *, seed: int = 0) -> Simulated:
    """`count` sightings a minute apart from noon on, which state their noise."""
    day = simulator(truth, cadence_s=60.0, seed=seed)
    first = len(day.points) // 2
    points = day.points.select(slice(first, first + count))
    return replace(day, points=replace(points, sigma_px=np.full(count, 0.02)))


def stated(truth: Camera, tolerances: PriorTolerances, *, seed: int) -> Camera:
    """Draw a statement of a camera whose errors are those of the tolerances."""
    rng, basis = np.random.default_rng(seed), whitened_basis(truth, tolerances)
    vector = truth.to_vector()
    vector[FREE] += basis @ rng.standard_normal(basis.shape[1])
    return rotated(truth.replace_parameters(vector), np.radians(tolerances.pose_deg or 0.0) * rng.standard_normal(3))


def with_prior(seen: Simulated, prior: Camera, tolerances: PriorTolerances = TOLERANCES) -> Calibration:
    return calibrate_with_prior(
        seen.points, prior=prior, tolerances=tolerances, site=seen.site, options=CalibrationOptions()
    )


def error_px(camera: Camera, truth: Camera) -> float:
    off = project(replace(camera, max_angle=2.0), SKY) - project(replace(truth, max_angle=2.0), SKY)
    return float(np.sqrt(np.nanmean(np.sum(off**2, axis=-1))))


def squares(found: Calibration, truth: Camera) -> float:
    """Return the mean squared error over the sky in stated sigmas; 2 on average."""
    wide = replace(found, camera=replace(found.camera, max_angle=2.0))
    pixels, covariance = project_with_covariance(wide, SKY)
    error = pixels - project(replace(truth, max_angle=2.0), SKY)
    return float(np.mean(np.einsum("ni,ni->n", error, np.linalg.solve(covariance, error[..., None])[..., 0])))


def codes(found: Calibration) -> set[str]:
    return {finding.code for finding in found.verdict.findings}


def test_twenty_sightings_and_a_right_prior_are_better_than_either_alone(
    clear_day: Simulated, simulator: Simulator
) -> None:
    truth = clear_day.camera
    before, after, surprise = [], [], []
    for seed in range(8):
        prior, seen = stated(truth, TOLERANCES, seed=seed), some(simulator, truth, 20, seed=seed)
        found = with_prior(seen, prior)
        assert found.verdict.accepted, found.verdict.reasons
        before.append(error_px(prior, truth))
        after.append(error_px(found.camera, truth))
        surprise.append(squares(found, truth))
    assert 0.05 < np.median(after) / np.median(before) < 0.35  # measured: 2.2 of 14 px
    assert max(a / b for a, b in zip(after, before, strict=True)) < 0.8
    assert 1.0 < np.mean(surprise) < 4.0  # of 8 draws of 20 parameters
    alone = calibrate(seen.points, site=seen.site, image_size=(truth.width, truth.height))
    assert not alone.verdict.accepted


def test_what_the_sightings_do_not_say_stays_as_uncertain_as_it_was_stated(
    clear_day: Simulated, simulator: Simulator
) -> None:
    seen = some(simulator, clear_day.camera, 3)
    found = with_prior(seen, clear_day.camera)
    basis = whitened_basis(clear_day.camera, TOLERANCES)
    prior, after = np.sqrt(np.diag(basis @ basis.T)), np.sqrt(np.diag(found.covariance))
    scale = FREE.tolist().index(0)
    assert 0.5 < after[scale] / prior[scale] <= 1.0
    assert 0.1 < found.sky_rms_deg < 1.0


@pytest.mark.parametrize(
    ("change", "count"),
    [
        ({"focal_length_px": (615.0, 615.0)}, 20),
        ({"principal_point_px": (880.0, 883.0)}, 3),
        ({"rotation_cam_enu": (0.3, 0.2, -2.0)}, 3),
    ],
)
def test_a_wrong_prior_with_tight_tolerances_is_refused(
    clear_day: Simulated, simulator: Simulator, change: dict[str, Any], count: int
) -> None:
    seen = some(simulator, clear_day.camera, count)
    wrong = replace(clear_day.camera, **change)
    tight = PriorTolerances(lens_px=0.5, pose_deg=0.1)
    assert "prior_contradicted" in codes(with_prior(seen, wrong, tight))
    assert "prior_contradicted" not in codes(with_prior(seen, clear_day.camera, tight))


def test_an_unknown_pose_is_found_at_any_angle(clear_day: Simulated, simulator: Simulator) -> None:
    seen = some(simulator, clear_day.camera, 40)
    turned = rotated(clear_day.camera, np.array([0.1, -0.2, 1.2]))
    found = with_prior(seen, turned, PriorTolerances(lens_px=1.0))
    assert found.verdict.accepted
    assert error_px(found.camera, clear_day.camera) < 0.05 * error_px(turned, clear_day.camera)
    assert "prior_contradicted" in codes(with_prior(seen, turned, PriorTolerances(lens_px=1.0, pose_deg=0.5)))


def test_outliers_do_not_pull(clear_day: Simulated, simulator: Simulator) -> None:
    seen = some(simulator, clear_day.camera, 20)
    pixels = seen.points.pixels.copy()
    pixels[::5] += 40.0
    found = with_prior(replace(seen, points=replace(seen.points, pixels=pixels)), clear_day.camera)
    assert found.left_out is not None
    assert found.left_out.tolist() == [0, 5, 10, 15]
    assert error_px(found.camera, clear_day.camera) < 3.0


def test_it_says_what_it_was_given_and_is_not_solved_again_without(clear_day: Simulated, simulator: Simulator) -> None:
    seen = some(simulator, clear_day.camera, 5)
    found = with_prior(seen, clear_day.camera)
    options = found.evidence.options
    assert (options["free"], options["prior"]) == (
        "prior",
        {"lens_px": 2.0, "pose_deg": 1.0, "focal_length": None},
    )
    assert found.evidence.start is not None
    with pytest.raises(InputError) as refused:
        reproduce_calibration(found, seen.points)
    assert refused.value.field == "evidence.options.free"


def test_two_sightings_are_too_few(clear_day: Simulated, simulator: Simulator) -> None:
    assert codes(with_prior(some(simulator, clear_day.camera, 2), clear_day.camera)) == {"too_few_sightings"}


@pytest.mark.parametrize(
    "stated",
    [
        {"lens_px": 0.0},
        {"lens_px": 21.0},
        {"lens_px": 1.0, "pose_deg": 11.0},
        {"lens_px": 1.0, "focal_length": 0.3},
        {"lens_px": float("nan")},
    ],
)
def test_tolerances_are_bounded(stated: dict[str, float]) -> None:
    with pytest.raises(InputError) as refused:
        PriorTolerances(**stated)
    assert refused.value.field == f"prior.{list(stated)[-1]}"
