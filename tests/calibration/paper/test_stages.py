"""The three-stage fit of the paper, against a plain call of scipy's least squares and linear theory."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from tests.calibration.paper.equations_reference import penalties
from tests.fixtures.calibration import (
    numerical_derivative,
    observed,
    random_covariance,
    small_camera,
    spread_directions,
)

from sunarc.calibration.fit.assemble import FitOutcome
from sunarc.calibration.model.options import CalibrationOptions, PaperOptions
from sunarc.calibration.model.sightings import Sightings
from sunarc.calibration.paper import fit_as_paper, normal_inverse, start_camera
from sunarc.optics.camera import PARAMETER_NAMES
from sunarc.optics.forward import project

FloatArray = NDArray[np.float64]

OPTIONS = CalibrationOptions(method="paper")


@pytest.fixture(scope="module")
def seen() -> Sightings:
    round_lens = replace(small_camera(), focal_length_px=(220.0, 220.0), skew_px=0.0)
    return observed(round_lens, spread_directions(80, widest_deg=85.0), sigma_px=0.1)


@pytest.fixture(scope="module")
def fitted(seen: Sightings) -> FitOutcome:
    start = replace(small_camera(), focal_length_px=(215.0, 215.0), radial=(0.0,) * 8, decentering=(0.0,) * 4)
    return fit_as_paper(seen, [start], options=OPTIONS)


def test_the_residuals_are_those_of_the_camera(fitted: FitOutcome, seen: Sightings) -> None:
    expected = seen.pixels - project(fitted.cameras[0], seen.directions)
    np.testing.assert_allclose(fitted.residual, expected, atol=1e-6)
    assert np.all(fitted.used)
    assert math.isnan(fitted.radial_px)
    assert fitted.held_out is None


def test_the_noise_is_found_with_the_degrees_of_freedom(fitted: FitOutcome) -> None:
    # 160 numbers, 20 parameters: the relative error of sigma is 1 / sqrt(2 * 140) = 6 %
    assert fitted.sigma_px == pytest.approx(0.1, rel=0.2)
    expected = math.sqrt(float(np.sum(fitted.residual**2)) / (160 - 20))
    assert fitted.sigma_px == pytest.approx(expected)


def test_the_cost_is_stationary(fitted: FitOutcome, seen: Sightings) -> None:
    camera = fitted.cameras[0]
    moving = [PARAMETER_NAMES.index(name) for name in fitted.parameter_names]

    def cost(values: FloatArray) -> FloatArray:
        vector = camera.to_vector()
        vector[moving] = values
        changed = camera.replace_parameters(vector)
        off = (project(changed, seen.directions) - seen.pixels).ravel()
        return np.concatenate([off, penalties(changed, OPTIONS.paper, largest_angle=math.pi / 2)])

    at = camera.to_vector()[moving]
    rows = numerical_derivative(cost, at)
    scale = np.linalg.norm(rows, axis=0)
    gradient = rows.T @ cost(at) / scale
    # in units of the noise: far below one
    assert np.max(np.abs(gradient)) < 0.05 * 0.1


def test_without_a_translation_it_has_none_and_with_one_it_is_among_the_names(fitted: FitOutcome) -> None:
    assert "translation_x" not in fitted.parameter_names
    assert len(fitted.parameter_names) == 20
    assert fitted.cameras[0].translation == (0.0, 0.0, 0.0)


def test_only_the_latest_pose_counts(seen: Sightings) -> None:
    epoch = (np.arange(80) >= 20).astype(np.int64)
    parted = replace(seen, epoch=epoch)
    start = replace(small_camera(), focal_length_px=(215.0, 215.0))
    found = fit_as_paper(parted, [start, start], options=OPTIONS)
    assert found.used.tolist() == (epoch == 1).tolist()
    np.testing.assert_array_equal(found.residual[:20], 0.0)
    assert found.cameras[0] is start


def test_the_inverse_is_that_of_the_normal_matrix() -> None:
    jacobian = np.random.default_rng(1).standard_normal((30, 5)) * [1.0, 1e4, 1e-4, 1.0, 10.0]
    found = normal_inverse(jacobian.T @ jacobian)
    np.testing.assert_allclose(found @ (jacobian.T @ jacobian), np.eye(5), atol=1e-6)
    undetermined = jacobian.copy()
    undetermined[:, 4] = undetermined[:, 3]
    found = normal_inverse(undetermined.T @ undetermined)
    assert np.all(np.isfinite(found))
    assert found[3, 3] > 1e6
    assert random_covariance(2).shape == (2, 2)


@pytest.mark.parametrize(("pose_start", "fit_translation"), [("wahba", False), ("dlt", False), ("dlt", True)])
def test_the_first_camera_has_no_distortion_and_the_chosen_pose(
    seen: Sightings, pose_start: str, *, fit_translation: bool
) -> None:
    paper = PaperOptions(pose_start=pose_start, fit_translation=fit_translation)  # type: ignore[arg-type]
    start = start_camera(small_camera(), seen, replace(OPTIONS, paper=paper))
    assert start.focal_length_px == (220.5, 220.5)
    assert (start.skew_px, start.radial, start.decentering) == (0.0, (0.0,) * 8, (0.0,) * 4)
    turned = start.rotation_cam_enu != small_camera().rotation_cam_enu
    assert turned is (pose_start == "dlt")
    assert (start.translation != (0.0, 0.0, 0.0)) is fit_translation
