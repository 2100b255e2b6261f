"""The circle through a rim, against definitions in numpy and scipy."""

from __future__ import annotations

import math
from functools import partial

import numpy as np
import pytest
from scipy.optimize import least_squares

from sunarc import _kernels
from sunarc.array_types import FloatArray
from sunarc.detection.photo.rim import circles_through, crossings, fitted_rim
from sunarc.robust_statistics import MAD_TO_SIGMA, biweights

RNG = np.random.default_rng(6)


def ring(n: int = 180, *, noise: float = 0.0, wave: tuple[float, float] = (0.0, 0.0)) -> FloatArray:
    """Return points about (40, 30) at 12 px, drawn out by twice the angle."""
    angle = np.arange(n) * (2.0 * math.pi / n)
    radius = 12.0 + wave[0] * np.cos(2.0 * angle) + wave[1] * np.sin(2.0 * angle) + noise * RNG.standard_normal(n)
    return np.column_stack([40.0 + radius * np.cos(angle), 30.0 + radius * np.sin(angle)])


def weights(residual: FloatArray, scale: float) -> FloatArray:
    return biweights(residual / (np.where(residual > 0.0, 2.5, 4.0) * scale))


fitted = partial(fitted_rim, least_points=10, least_scales=(0.3, 0.01))


@pytest.mark.parametrize("drawn_out", [0.1, 1e-4])
def test_a_fit_is_the_minimum_of_its_weighted_squares(drawn_out: float) -> None:
    points = ring(noise=0.3, wave=(0.4, -0.2))
    found = fitted(points, np.array([41.0, 30.5, 11.0]), 1.0, drawn_out=drawn_out)
    assert found is not None
    state, scale, residual = found
    weight = weights(residual, scale)

    def model(values: FloatArray) -> FloatArray:
        off = points - values[:2]
        far = np.hypot(*off.T)
        twice = 2.0 * np.arctan2(off[:, 1], off[:, 0])
        misfit = far - values[2] - values[3] * np.cos(twice) - values[4] * np.sin(twice)
        held = scale / (drawn_out * state[2]) * values[3:]
        return np.concatenate([np.sqrt(weight) * misfit, held])

    expected = least_squares(model, state, xtol=1e-12, ftol=1e-12).x
    assert state == pytest.approx(expected, abs=0.01)
    assert scale == pytest.approx(max(MAD_TO_SIGMA * float(np.median(np.abs(residual[weight > 0.0]))), 0.3), rel=0.05)


def test_what_lies_outside_is_weighted_harder_than_what_lies_inside() -> None:
    outside, inside = ring(), ring()
    for points, far in ((outside, 1.07), (inside, 0.93)):
        points[:40] = (points[:40] - (40.0, 30.0)) * far + (40.0, 30.0)
    start = np.array([40.0, 30.0, 12.0])
    found = [fitted(points, start, 0.3, drawn_out=1e-4) for points in (outside, inside)]
    off = [float(np.hypot(*(one[0][:2] - (40.0, 30.0)))) for one in found if one is not None]
    assert off[0] < 1e-3 < off[1]


@pytest.mark.parametrize("least", [181, 1000])
def test_with_too_few_points_there_is_no_circle(least: int) -> None:
    assert fitted(ring(), np.array([40.0, 30.0, 12.0]), 1.0, drawn_out=0.1, least_points=least) is None


@pytest.mark.parametrize("n", [20, 21, 90, 180])
def test_circles_go_through_the_points_of_their_triples(n: int) -> None:
    points = ring(n, noise=1.0)
    first = np.arange(n)
    triples = np.concatenate([np.column_stack([first, first + n // k, first + 2 * n // k]) % n for k in (3, 4, 6)])[::2]
    found = circles_through(points)
    assert found.shape == (len(triples), 3)
    for circle, triple in zip(found, triples, strict=True):
        assert np.hypot(*(points[triple] - circle[:2]).T) == pytest.approx(circle[2], rel=1e-6)


def test_points_on_a_line_have_no_circle() -> None:
    assert np.isnan(circles_through(np.column_stack([np.arange(30.0), np.arange(30.0)]))).all()


@pytest.mark.parametrize("seed", range(5))
def test_the_most_followed_circle_has_the_largest_sum_of_weights(seed: int) -> None:
    rng = np.random.default_rng(seed)
    points = ring(noise=2.0)
    circles = np.column_stack([rng.normal(40.0, 3.0, 40), rng.normal(30.0, 3.0, 40), rng.normal(12.0, 2.0, 40)])
    circles[3] = math.nan
    sums = [float(np.nansum(weights(np.hypot(*(points - circle[:2]).T) - circle[2], 0.8))) for circle in circles]
    assert _kernels.most_followed(points, circles, 2.5 * 0.8, 4.0 * 0.8) == int(np.argmax(sums))


RADII = np.arange(5.0, 15.0)


@pytest.mark.parametrize(
    ("light", "radius"),
    [
        ([1, 1, 1, 0.8, 0.8, 0.8, 0.8, 0.8, 0.8, 0.8], 7.5),
        ([1, 1, 1, 0.8, 1, 1, 0.8, 0.8, 0.8, 0.8], 10.5),  # a dip of one sample is not for good
        ([1, 1, 1, 1, 1, 1, 1, 1, 0.8, 0.8], math.nan),  # nor is a fall of two at the end
        ([0.8, 0.8, 0.8, 1, 1, 1, 1, 0.8, 0.8, 0.8], math.nan),  # begins below
        ([1, 1, math.nan, 1, 0.8, 0.8, 0.8, 0.8, 0.8, 0.8], math.nan),
        ([1, 1, 1, 0.8, 0.8, 0.8, math.nan, 1, 1, 1], 7.5),
        ([1] * 10, math.nan),
    ],
)
def test_light_crosses_a_level_where_it_falls_for_good(light: list[float], radius: float) -> None:
    found = crossings(np.array([light, light], dtype=np.float64), 0.9, 3, RADII)
    assert found == pytest.approx([radius, radius], nan_ok=True)


def test_points_on_a_line_are_followed_by_no_circle() -> None:
    points = np.column_stack([np.arange(30.0), np.arange(30.0)])
    assert fitted(points, circles_through(points)[0], math.nan, drawn_out=0.1) is None
