"""The noise of sightings by group and height, against draws whose noise is known."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from sunarc.calibration.model.sightings import Sightings
from sunarc.calibration.noise import Noise, NoiseGroups, measured_noise
from sunarc.calibration.solve.problem import Bins

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

ZENITH = np.abs(np.linspace(-1.5, 1.5, 1600)) + 0.05
"""Of a day, rad."""
DRAWN = np.random.default_rng(3).standard_normal((ZENITH.size, 2))


def _noise_of(residuals: FloatArray, *, group: int | IntArray, leverage: FloatArray | None = None) -> Noise:
    n = ZENITH.size
    directions = np.stack([np.sin(ZENITH), np.zeros(n), np.cos(ZENITH)], axis=-1)
    observed = Sightings(
        directions=directions, pixels=np.zeros((n, 2)), information=np.ones(n), epoch=np.zeros(n, dtype=np.int64)
    )
    groups = NoiseGroups(
        bins=Bins(member=np.arange(n), count=n),
        run=np.zeros(n, dtype=np.int64),
        follows=np.ones(n - 1, dtype=bool),
        alone=np.zeros(n, dtype=bool),
        group=np.full(n, group),
    )
    return measured_noise(residuals, observed, groups, leverage=leverage)


def test_the_noise_of_the_track_follows_the_suns_height() -> None:
    residuals = DRAWN * 0.2 * np.exp(ZENITH)[:, None]
    residuals[::50] += 30.0
    noise = _noise_of(residuals, group=0)
    np.testing.assert_allclose(noise.scale, 0.2 * np.exp(ZENITH), rtol=0.12)
    assert noise.sigma_px == pytest.approx(0.2 * np.exp(ZENITH.mean()), rel=0.05)
    assert np.all(noise.weight[::50] == 0.0)


def test_the_noise_of_other_bodies_has_one_scale() -> None:
    residuals = DRAWN * 0.2 * np.exp(ZENITH)[:, None]
    noise = _noise_of(residuals, group=4)
    assert np.ptp(noise.scale) == 0.0
    assert noise.sigma_px == noise.scale[0]


def test_noise_of_each_group_has_its_own_scale() -> None:
    mixed = np.where(np.arange(ZENITH.size) % 2 == 0, 2, 4)
    factor = np.where(mixed == 2, 1.0, 5.0)
    noise = _noise_of(0.2 * DRAWN * factor[:, None], group=mixed)
    np.testing.assert_allclose(noise.scale, 0.2 * factor, rtol=0.12)


def test_residuals_that_a_fit_has_drawn_to_itself_count_as_larger() -> None:
    plain = _noise_of(0.2 * DRAWN, group=4)
    drawn = _noise_of(0.2 * DRAWN, group=4, leverage=np.full(ZENITH.size, 0.75))
    np.testing.assert_allclose(drawn.scale, 2.0 * plain.scale)
