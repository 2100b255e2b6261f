"""The axes in which the field's own equations are diagonal, against the untransformed ones."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from sunarc.calibration.fit.marginal_likelihood import BasisProducts
from sunarc.optics.displacement import WaveBasis, wave_basis

FloatArray = NDArray[np.float64]

LENGTH = 260.0


@pytest.fixture(scope="module")
def basis() -> WaveBasis:
    return wave_basis(width=1000, height=800, shortest_px=250.0, longest_px=400.0)


def _waves(basis: WaveBasis, count: int) -> FloatArray:
    return basis.values(np.random.default_rng(3).uniform(0.0, 800.0, (count, 2)))


@pytest.mark.parametrize("amplitude", [0.01, 1.0, 8.0])
def test_shrunk_in_the_axes_it_is_the_posterior_of_the_coefficients(basis: WaveBasis, amplitude: float) -> None:
    waves = _waves(basis, 60)
    axes = BasisProducts(matrix=waves.T @ waves * 100.0).axes(basis, LENGTH)
    pull = waves.T @ np.random.default_rng(4).standard_normal(60) * 100.0
    shrink = axes.posterior_variances(np.array([amplitude]))[0]
    found = axes.transform @ (shrink * (axes.transform.T @ pull))
    prior = amplitude**2 * basis.variances(length_px=LENGTH)
    # without the inverse of the prior, which is next to nothing for the short waves
    expected = prior * np.linalg.solve(np.eye(prior.size) + waves.T @ waves * 100.0 * prior, pull)
    np.testing.assert_allclose(waves @ found, waves @ expected, rtol=1e-6, atol=1e-9 * np.max(np.abs(pull)))


def test_what_the_sightings_tell_nothing_of_is_left_out(basis: WaveBasis) -> None:
    waves = _waves(basis, 10)
    axes = BasisProducts(matrix=waves.T @ waves).axes(basis, LENGTH)
    assert axes.transform.shape == (waves.shape[1], 10)
    diagonal = axes.transform.T @ (waves.T @ waves) @ axes.transform
    np.testing.assert_allclose(diagonal, np.diag(axes.information), atol=1e-9 * np.max(axes.information))
    assert np.min(axes.information) > 0.0
    nothing = BasisProducts(matrix=np.zeros_like(waves.T @ waves)).axes(basis, LENGTH)
    assert nothing.information.size == 0


def test_axes_of_a_longer_field_are_the_same_from_those_of_a_shorter_one(basis: WaveBasis) -> None:
    waves = _waves(basis, 40)
    products = BasisProducts(matrix=1e6 * waves.T @ waves)
    products.axes(basis, 250.0)
    derived, direct = products.axes(basis, 390.0), BasisProducts(matrix=products.matrix).axes(basis, 390.0)
    np.testing.assert_allclose(
        derived.information, direct.information[: derived.information.size], atol=1e-9 * direct.information[0]
    )
    seen = [
        waves @ axes.transform * np.sqrt(axes.posterior_variances(np.array([0.3]))[0]) for axes in (derived, direct)
    ]
    first, second = (one @ one.T for one in seen)
    np.testing.assert_allclose(first, second, atol=1e-7 * np.max(second))


def test_what_exact_sightings_leave_over_is_positive(basis: WaveBasis) -> None:
    waves = 1e4 * _waves(basis, 200)
    for length in (250.0, 390.0):
        products = BasisProducts(matrix=waves.T @ waves)
        products.axes(basis, 250.0)
        axes = products.axes(basis, length)
        seen = waves @ axes.transform
        # noise of 1e-4 px beside a field of 8 px: no more may be taken from the information than there is
        left = waves.T @ waves - waves.T @ (seen * axes.posterior_variances(np.array([8.0]))[0]) @ seen.T @ waves
        values = np.linalg.eigvalsh(left)
        assert values[0] > -1e-11 * np.max(np.diag(waves.T @ waves))


def test_the_axes_of_a_length_are_made_once(basis: WaveBasis) -> None:
    waves = _waves(basis, 20)
    products = BasisProducts(matrix=waves.T @ waves)
    assert products.axes(basis, LENGTH) is products.axes(basis, LENGTH)
    assert products.axes(basis, LENGTH) is not products.axes(basis, 300.0)


def test_products_of_low_rank_are_factored_and_those_of_nothing_have_no_axes(basis: WaveBasis) -> None:
    waves = _waves(basis, 10)
    axes = BasisProducts(matrix=waves.T @ waves).axes(basis, LENGTH)
    spread = np.sqrt(basis.variances(length_px=LENGTH))
    # in units of the spread the transform is orthonormal, and its axes carry all of the products
    unit = axes.transform / spread[:, None]
    np.testing.assert_allclose(unit.T @ unit, np.eye(10), atol=1e-12)
    whole = waves.T @ waves * spread[:, None] * spread
    np.testing.assert_allclose(unit * axes.information @ unit.T, whole, atol=1e-12 * np.max(whole))
    assert BasisProducts(matrix=np.zeros_like(whole)).axes(basis, LENGTH).transform.shape == (spread.size, 0)
