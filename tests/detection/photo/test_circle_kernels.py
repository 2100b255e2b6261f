"""The circle through a rim, against definitions in numpy and scipy."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.optimize import least_squares

from sunarc import _kernels
from sunarc.common.array_types import FloatArray
from sunarc.common.robust_statistics import MAD_TO_SIGMA, biweights, mad_sigma
from sunarc.detection.photo.rim import circles_through

RNG = np.random.default_rng(6)


def ring(
    n: int = 180, *, noise: float = 0.0, wave: tuple[float, float] = (0.0, 0.0), rng: np.random.Generator = RNG
) -> FloatArray:
    """Return points about (40, 30) at 12 px, drawn out by twice the angle."""
    angle = np.arange(n) * (2.0 * math.pi / n)
    radius = 12.0 + wave[0] * np.cos(2.0 * angle) + wave[1] * np.sin(2.0 * angle) + noise * rng.standard_normal(n)
    return np.column_stack([40.0 + radius * np.cos(angle), 30.0 + radius * np.sin(angle)])


def weights(residual: FloatArray, scale: float) -> FloatArray:
    return biweights(residual / (np.where(residual > 0.0, 2.5, 4.0) * scale))


Fitted = tuple[FloatArray, float, FloatArray] | None


def fitted(
    points: FloatArray, start: FloatArray, scale: float, *, drawn_out: float = 0.1, least_points: int = 10
) -> Fitted:
    return _kernels.fitted_rim(points, start, scale, drawn_out, least_points, 0.3, 0.01)


def fitted_in_numpy(points: FloatArray, start: FloatArray, scale: float, *, drawn_out: float) -> Fitted:
    """Fit as `_kernels.fitted_rim` does, in numpy."""
    state, varies = np.array([*start, 0.0, 0.0]), np.array([0.0, 0.0, 0.0, 1.0, 1.0])
    for _ in range(20):
        dx, dy = points.T - state[:2, None]
        length = np.hypot(dx, dy)
        dx, dy = dx / length, dy / length
        design = np.array([dx, dy, np.ones(dx.size), dx * dx - dy * dy, 2.0 * dx * dy])
        residual = length - state[2:] @ design[2:]
        weight = weights(residual, scale)
        if np.count_nonzero(weight) < 10:
            return None
        held = varies * (scale / (drawn_out * state[2])) ** 2
        normal = (design * weight) @ design.T + np.diag(held + 1e-6 * (1.0 - varies))
        step = np.linalg.solve(normal, design @ (weight * residual) - held * state)
        state += np.clip(step, -0.5 * state[2], 0.5 * state[2])
        if state[2] < 1.0:
            return None
        scale = max(mad_sigma(residual[weight > 0.0]), 0.3, 0.01 * float(state[2]))
        if np.max(np.abs(step)) < 1e-3:
            break
    return state, scale, residual


@pytest.mark.parametrize("drawn_out", [0.1, 1e-4])
@pytest.mark.parametrize("n", [30, 75, 180])
def test_a_fit_takes_the_steps_of_gauss_and_newton(n: int, drawn_out: float) -> None:
    rng = np.random.default_rng(n)
    for _ in range(20):
        points = ring(n, noise=rng.uniform(0.0, 1.0), wave=(rng.normal(0.0, 0.5), rng.normal(0.0, 0.5)), rng=rng)
        points[: n // 4] += rng.normal(0.0, 4.0, 2)
        start = np.array([40.0, 30.0, 12.0]) + rng.normal(0.0, 3.0, 3)
        found, expected = (fit(points, start, 2.0, drawn_out=drawn_out) for fit in (fitted, fitted_in_numpy))
        assert (found is None) == (expected is None)
        for one, other in zip(found or (), expected or (), strict=True):
            assert one == pytest.approx(other, rel=1e-9, abs=1e-9)


@pytest.mark.parametrize("bad", [math.nan, math.inf])
def test_points_that_are_no_numbers_have_no_circle(bad: float) -> None:
    points = np.insert(ring(noise=0.3), 90, bad, axis=0)
    assert fitted(points, np.array([41.0, 30.5, 11.0]), 1.0) is None


@pytest.mark.parametrize(
    "start", [(40.0, 30.0, math.nan), (math.nan, 30.0, 12.0), (40.0, 30.0, -12.0), (4e9, 3e9, 1.0)]
)
def test_no_circle_is_fitted_from_where_none_is(start: tuple[float, float, float]) -> None:
    assert fitted(ring(), np.array(start), 1.0) is None
    assert fitted(ring()[:0], np.array([40.0, 30.0, 12.0]), 1.0, least_points=0) is None


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
    assert fitted(ring(), np.array([40.0, 30.0, 12.0]), 1.0, least_points=least) is None


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
    assert _kernels.most_followed(points, circles, 0.8) == int(np.argmax(sums))


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
    found = _kernels.crossings(np.array([light, light], dtype=np.float64), 0.9, 3, RADII)
    assert found == pytest.approx([radius, radius], nan_ok=True)


def crossings_in_numpy(light: FloatArray, level: float, lasting: int, radii: FloatArray) -> FloatArray:
    below = (light < level) & (np.cumsum(np.isnan(light), axis=1) == 0)
    lasts = np.logical_and.reduce([below[:, k : below.shape[1] - lasting + 1 + k] for k in range(lasting)])
    falls, first = lasts.any(axis=1), lasts.argmax(axis=1)
    ray, last = np.arange(len(light)), np.maximum(first - 1, 0)
    before = light[ray, last]
    share = np.clip((before - level) / np.maximum(before - light[ray, first], 1e-6), 0.0, 1.0)
    return np.where(falls & (first > 0), radii[last] + share * (radii[1] - radii[0]), np.nan)


@pytest.mark.parametrize("lasting", [1, 3, 7])
def test_crossings_of_any_light_are_those_of_numpy(lasting: int) -> None:
    rng = np.random.default_rng(lasting)
    light: FloatArray = np.linspace(1.3, 0.5, 40) + rng.normal(0.0, 0.15, (400, 40))
    light[rng.uniform(size=light.shape) < 0.01] = math.nan
    radii = np.arange(5.0, 25.0, 0.5)
    found = _kernels.crossings(light, 0.9, lasting, radii)
    assert np.isnan(found).any()
    np.testing.assert_allclose(found, crossings_in_numpy(light, 0.9, lasting, radii), rtol=1e-12)


@pytest.mark.parametrize(("samples", "lasting"), [(0, 3), (1, 1), (10, 0), (9, 3)])
def test_light_without_a_radius_to_each_of_two_samples_is_refused(samples: int, lasting: int) -> None:
    with pytest.raises(ValueError, match=r".+"):
        _kernels.crossings(np.ones((5, samples)), 0.9, lasting, RADII if samples in {9, 10} else RADII[:samples])


def test_points_on_a_line_are_followed_by_no_circle() -> None:
    points = np.column_stack([np.arange(30.0), np.arange(30.0)])
    assert fitted(points, circles_through(points)[0], math.nan) is None
