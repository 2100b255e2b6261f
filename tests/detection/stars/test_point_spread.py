"""The fit of point spreads to stamps, without an image around them."""

from __future__ import annotations

import numpy as np
import pytest

from sunarc.detection.stars.detect import Stamps, fit_point_spreads

SIZE = 9
X, Y = (axis.ravel() for axis in np.meshgrid(np.arange(SIZE, dtype=float), np.arange(SIZE, dtype=float)))


def stamp(value: np.ndarray) -> Stamps:
    """Return one stamp of noise 2."""
    return Stamps(X[None], Y[None], value[None], np.full((1, value.size), 4.0))


def test_a_drawn_star_is_found_with_the_variance_of_linear_least_squares() -> None:
    bell = np.exp(-0.5 * ((X - 4.3) ** 2 + (Y - 3.8) ** 2))
    start = np.array([[4.0, 4.0, 300.0, 0.0, 1.0, 0.0, 1.0]])
    found = fit_point_spreads(stamp(500.0 * bell + 10.0), start, gain_e=None, shape=False)
    np.testing.assert_allclose(found.parameters[0, :4], [4.3, 3.8, 500.0, 10.0], atol=1e-4)
    design = np.stack([500.0 * bell * (X - 4.3), 500.0 * bell * (Y - 3.8), bell, np.ones_like(bell)])
    expected = 4.0 * np.linalg.inv(design @ design.T)
    floor_px = 0.01  # no point spread is a Gaussian
    assert found.sigma_px[0] == pytest.approx(np.sqrt(0.5 * np.trace(expected[:2, :2]) + floor_px**2), rel=1e-3)
    assert found.snr[0] == pytest.approx(500.0 / np.sqrt(expected[2, 2]), rel=1e-3)


def test_what_no_pixel_determines_has_no_certain_place() -> None:
    """Without light the slopes by the place are 0, and so is the pseudo-inverse of their products."""
    start = np.array([[4.5, 4.5, 0.0, 0.0, 1.0, 0.0, 1.0]])
    found = fit_point_spreads(stamp(np.zeros(X.size)), start, gain_e=None, shape=False)
    assert np.isinf(found.sigma_px[0])
    assert found.snr[0] == 0.0
