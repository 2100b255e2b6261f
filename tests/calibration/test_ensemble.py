"""Joint draws of a calibration's errors: their covariance is the stated one, within and between places."""

from __future__ import annotations

import hashlib
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from tests.fixtures.calibration import small_camera, stated_calibration

from sunarc.calibration.answers.covariance import hemisphere, project_with_covariance, sigma_deg
from sunarc.calibration.answers.error_model import (
    MOST_DRAWS,
    Ensemble,
    build_error_model,
    covariance_root,
    draw_ensemble,
    draw_errors,
    joint_covariance,
    predicted,
)
from sunarc.calibration.model.result import Calibration, ErrorMixture
from sunarc.common.errors import InputError
from sunarc.optics.camera import PARAMETER_NAMES
from sunarc.optics.forward import project, project_with_rows_fast
from sunarc.optics.inverse import unproject

FloatArray = NDArray[np.float64]
DRAWS = 2000
SKY = hemisphere(120)[:110]


@pytest.fixture(scope="module")
def calibration() -> Calibration:
    """Return a calibration whose parameters make up for a third of the field, as those of a fit do."""
    plain = stated_calibration(small_camera(), amplitude_px=0.3, length_px=160.0)
    basis = plain.field.basis
    variances = 0.09 * basis.variances(length_px=160.0)
    pixels = project(plain.camera, SKY)
    rows = project_with_rows_fast(plain.camera, SKY)[1][..., [PARAMETER_NAMES.index(n) for n in plain.parameter_names]]
    # the parameters that follow a coefficient's displacement by least squares, a third of it
    sigma = np.sqrt(np.diag(plain.covariance))
    inverse = np.linalg.pinv(rows.reshape(-1, sigma.size) * sigma, rcond=1e-3)
    values = basis.values(pixels)
    shifts = [np.stack([values if axis == a else 0.0 * values for a in (0, 1)], axis=1) for axis in (0, 1)]
    gain = np.stack([-sigma[:, None] * (inverse @ shift.reshape(-1, variances.size)) / 3.0 for shift in shifts])
    cross = gain * variances
    covariance = plain.covariance + np.einsum("apm,aqm->pq", gain, cross)
    return replace(plain, covariance=covariance, field=replace(plain.field, cross=cross))


@pytest.fixture(scope="module")
def ensemble(calibration: Calibration) -> Ensemble:
    return draw_ensemble(calibration, draws=DRAWS, seed=1, calibration_id="20130514T150508Z-52ee44")


@pytest.fixture(scope="module")
def errors_px(calibration: Calibration, ensemble: Ensemble) -> FloatArray:
    estimated = project(calibration.camera, SKY)
    return np.stack([ensemble.project(draw, SKY) - estimated for draw in ensemble])


def test_the_covariance_of_the_draws_is_the_stated_one_over_the_sky(
    calibration: Calibration, errors_px: FloatArray
) -> None:
    _, stated = project_with_covariance(calibration, SKY)
    found = np.einsum("kna,knb->nab", errors_px, errors_px) / DRAWS
    ratio = np.trace(found, axis1=1, axis2=2) / np.trace(stated, axis1=1, axis2=2)
    assert 0.95 < np.mean(ratio) < 1.05
    # a variance of 2000 draws scatters by √(2 / 2000) = 3 %
    assert np.all((ratio > 0.87) & (ratio < 1.13))
    mean = np.mean(errors_px, axis=0) / np.sqrt(np.einsum("naa->na", stated) / DRAWS)
    assert 0.3 < np.sqrt(np.mean(mean**2)) < 2.0


def test_errors_of_two_places_are_correlated_as_in_the_joint_gaussian(
    calibration: Calibration, errors_px: FloatArray
) -> None:
    few = np.array([0, 1, 30, 31, 70, 104])
    errors = build_error_model(calibration)
    expected = joint_covariance(errors, predicted(errors, calibration.camera, SKY[few]))
    flat = errors_px[:, few].reshape(DRAWS, -1)
    sigma = np.sqrt(np.diag(expected))
    correlation = (flat.T @ flat / DRAWS) / np.outer(sigma, sigma)
    np.testing.assert_allclose(correlation, expected / np.outer(sigma, sigma), atol=4.5 / np.sqrt(DRAWS))
    apart = np.abs(expected / np.outer(sigma, sigma) - np.eye(sigma.size))
    assert apart.max() > 0.5  # common errors are there to be found


def test_a_displacement_is_the_derivatives_times_the_errors_and_the_field(calibration: Calibration) -> None:
    made = draw_ensemble(calibration, draws=3, seed=5, calibration_id="a")
    errors = build_error_model(calibration)
    size = errors.mean.size + 2 * errors.variances.size
    seeds = [int.from_bytes(hashlib.sha256(b"a").digest()[:8], "big"), 5]
    parameters, coefficients = draw_errors(
        errors, np.random.Generator(np.random.PCG64(seeds)).standard_normal((3, size + 1))[:, :-1]
    )
    at = predicted(errors, calibration.camera, SKY)
    for k in made:
        expected = at.rows @ parameters[k] + at.basis_values @ coefficients[k].T
        np.testing.assert_allclose(made.displacement(k, at.pixels), expected, atol=1e-3 * np.abs(expected).max())


def test_directions_spread_as_stated(calibration: Calibration, ensemble: Ensemble) -> None:
    pixels = project(calibration.camera, SKY)
    off = np.stack([ensemble.back_project(draw, pixels) - SKY for draw in range(500)])
    found = np.degrees(np.sqrt(0.5 * np.mean(np.sum(off**2, axis=-1), axis=0)))
    ratio = found / sigma_deg(calibration, SKY)
    assert 0.95 < np.mean(ratio) < 1.05
    assert np.all((ratio > 0.85) & (ratio < 1.15))


def test_a_draw_back_projects_what_it_projects(ensemble: Ensemble) -> None:
    for draw in (0, 7):
        again = ensemble.back_project(draw, ensemble.project(draw, SKY))
        apart = np.degrees(np.linalg.norm(again - SKY, axis=-1))
        error = np.degrees(
            np.linalg.norm(ensemble.back_project(draw, project(ensemble.table.camera, SKY)) - SKY, axis=-1)
        )
        assert apart.max() < 0.02 * error.max()


def test_the_first_draws_of_a_larger_ensemble_are_those_of_a_smaller(calibration: Calibration) -> None:
    small, large = (draw_ensemble(calibration, draws=n, seed=3, calibration_id="a") for n in (2, 5))
    assert (len(small), len(large), list(small)) == (2, 5, [0, 1])
    # a product of larger matrices adds in another order
    np.testing.assert_allclose(small.sheets_px, large.sheets_px[:2], rtol=0.0, atol=1e-12)
    np.testing.assert_allclose(small.common, large.common[:2], rtol=0.0, atol=1e-12)
    for other in (
        draw_ensemble(calibration, draws=2, seed=4, calibration_id="a"),
        draw_ensemble(calibration, draws=2, seed=3, calibration_id="b"),
    ):
        assert np.max(np.abs(other.sheets_px - small.sheets_px)) > 1e-6
    assert MOST_DRAWS >= 16


def test_what_is_no_place_stays_none(calibration: Calibration, ensemble: Ensemble) -> None:
    nowhere = np.array([[np.nan, 5.0], [5.0, np.nan]])
    assert np.all(np.isnan(ensemble.displacement(0, nowhere)))
    assert np.all(np.isnan(ensemble.back_project(0, nowhere)))
    below = np.array([[0.0, 0.0, -1.0]])
    assert np.all(np.isnan(ensemble.project(0, below)))
    far = np.array([[1e5, 1e5]])
    assert np.all(np.isfinite(ensemble.displacement(0, far)))
    assert np.all(np.isnan(unproject(calibration.camera, far)))


def test_without_a_field_the_parameters_alone_are_drawn(calibration: Calibration) -> None:
    field = replace(calibration.field, amplitude_px=0.0)
    plain = replace(calibration, field=field)
    made = draw_ensemble(plain, draws=400, seed=1, calibration_id="a")
    _, stated = project_with_covariance(plain, SKY)
    errors = np.stack([made.project(k, SKY) for k in made]) - project(plain.camera, SKY)
    ratio = np.mean(np.sum(errors**2, axis=-1), axis=0) / np.trace(stated, axis1=1, axis2=2)
    assert 0.9 < np.mean(ratio) < 1.1


def test_the_root_of_a_covariance_of_unlike_units_gives_it_back() -> None:
    rng = np.random.default_rng(2)
    matrix = rng.standard_normal((5, 3)) * np.array([1e-6, 1.0, 1e4, 1e-2, 10.0])[:, None]
    covariance = matrix @ matrix.T  # of rank 3: rounding makes eigenvalues of 0 negative
    root = covariance_root(covariance)
    scale = np.sqrt(np.outer(np.diag(covariance), np.diag(covariance)))
    np.testing.assert_allclose(root @ root.T / scale, covariance / scale, atol=1e-12)


def test_a_calibration_without_its_pose_cannot_be_drawn(calibration: Calibration) -> None:
    names = tuple(name for name in calibration.parameter_names if not name.startswith("rotation"))
    index = [calibration.parameter_names.index(name) for name in names]
    lens = replace(
        calibration,
        parameter_names=names,
        covariance=calibration.covariance[np.ix_(index, index)],
        field=replace(calibration.field, cross=calibration.field.cross[:, index]),
    )
    with pytest.raises(InputError) as caught:
        draw_ensemble(lens, draws=1, seed=0, calibration_id="a")
    assert caught.value.field == "uncertainty.parameters"


def test_draws_of_a_mixture_are_small_or_large_all_over_the_image(calibration: Calibration) -> None:
    """Each draw is that of the Gaussian, times its class's scale; classes come as often as their shares say."""
    places = np.array([[100.0, 100.0], [500.0, 400.0]])
    mixture = ErrorMixture(shares=np.array([0.7, 0.3]), pixels_px=places, scales=np.array([[0.5, 2.0], [0.5, 2.0]]))
    pixels = project(calibration.camera, SKY)
    plain, mixed = (
        draw_ensemble(one, draws=300, seed=3, calibration_id="a")
        for one in (calibration, replace(calibration, mixture=mixture))
    )
    found = np.array([[one.displacement(k, pixels) for k in range(300)] for one in (plain, mixed)])
    ratio = np.linalg.norm(found[1], axis=(1, 2)) / np.linalg.norm(found[0], axis=(1, 2))
    np.testing.assert_allclose(found[1], ratio[:, None, None] * found[0], atol=1e-9)
    large = np.abs(ratio - 2.0) < 1e-9
    np.testing.assert_allclose(ratio[~large], 0.5)
    assert large.mean() == pytest.approx(0.3, abs=0.08)
    again = draw_ensemble(replace(calibration, mixture=mixture), draws=5, seed=3, calibration_id="a")
    np.testing.assert_allclose(again.sheets_px, mixed.sheets_px[:5], atol=1e-11)
