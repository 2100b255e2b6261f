"""The light around a saturated sun: centre, shape and evenness on analytic glare.

A little noise belongs to it: the width of the rings shows in light without any.
"""

from __future__ import annotations

import math

import numpy as np
import pytest
from tests.detection.rendering import FloatArray

from sunarc.detection.photo.aureole import Halo, _around, _normal, _ringed, _Rings, _weights, halo_about

SIZE, RADIUS = 160, 14.0


def glare(
    x: float = 80.0,
    y: float = 80.0,
    *,
    squeeze: tuple[float, float] = (0.0, 0.0),
    slope: tuple[float, float] = (0.0, 0.0),
    noise: float = 0.003,
    fall: float = 0.8,
) -> FloatArray:
    """Return light that is 1 within the blob and falls with the square of an elliptic distance, on a sloping sky."""
    rows, columns = np.mgrid[:SIZE, :SIZE]
    dx, dy = columns - x, rows - y
    p, q = squeeze
    distance = np.sqrt((1.0 + p) * dx * dx + 2.0 * q * dx * dy + (1.0 - p) * dy * dy)
    light = 0.1 + fall / (1.0 + (distance / (1.5 * RADIUS)) ** 2) + slope[0] * dx + slope[1] * dy
    light += np.random.default_rng(0).normal(0.0, noise, light.shape)
    return np.asarray(np.where(distance < RADIUS, 1.0, np.clip(light, 0.0, 0.98)))


def found_in(light: FloatArray, *, off: tuple[float, float] = (0.0, 0.0)) -> Halo:
    halo = halo_about(light, center=(80.0 + off[0], 80.0 + off[1]), radius=RADIUS)
    assert halo is not None
    return halo


@pytest.mark.parametrize("place", [(80.0, 80.0), (80.37, 79.81), (81.5, 78.5)])
def test_the_centre_is_found_to_a_fraction_of_a_pixel(place: tuple[float, float]) -> None:
    halo = found_in(glare(*place))
    assert (halo.x, halo.y) == pytest.approx(place, abs=0.02)
    assert halo.sigma_px < 0.02
    assert halo.share == 1.0
    assert halo.scatter < 0.032  # the rings' own width


@pytest.mark.parametrize("off", [(3.0, -2.0), (-4.0, 4.0)])
def test_a_start_that_is_off_ends_at_the_same_centre(off: tuple[float, float]) -> None:
    halo = found_in(glare(80.4, 79.7), off=off)
    assert (halo.x, halo.y) == pytest.approx((80.4, 79.7), abs=0.05)


@pytest.mark.parametrize("slope", [(5e-4, 0.0), (-3e-4, 6e-4)])
def test_a_sky_that_slopes_does_not_move_the_centre(slope: tuple[float, float]) -> None:
    halo = found_in(glare(slope=slope))
    assert (halo.x, halo.y) == pytest.approx((80.0, 80.0), abs=0.1)


@pytest.mark.parametrize("squeeze", [(0.2, 0.0), (-0.15, 0.0), (0.0, 0.2), (0.1, -0.12)])
def test_an_ellipse_has_its_ellipticity(squeeze: tuple[float, float]) -> None:
    halo = found_in(glare(squeeze=squeeze))
    axes = np.linalg.eigvalsh([[1.0 + squeeze[0], squeeze[1]], [squeeze[1], 1.0 - squeeze[0]]]) ** -0.5
    assert (halo.x, halo.y) == pytest.approx((80.0, 80.0), abs=0.05)
    assert halo.ellipticity == pytest.approx(1.0 - axes.min() / axes.max(), abs=0.015)


def test_a_round_glare_has_no_ellipticity() -> None:
    assert found_in(glare()).ellipticity < 0.01


@pytest.mark.parametrize("noise", [0.01, 0.03])
def test_the_scatter_is_that_of_the_noise_over_the_fall(noise: float) -> None:
    halo = found_in(glare(noise=noise))
    assert 0.8 * noise / halo.fall < halo.scatter < 1.1 * (noise / halo.fall + 0.029)
    assert (halo.x, halo.y) == pytest.approx((80.0, 80.0), abs=max(5.0 * halo.sigma_px, 0.05))
    assert 0.0 < halo.sigma_px < 0.3


def test_edge_and_fall_are_the_profiles() -> None:
    halo = found_in(glare())
    inner = 1.05 * RADIUS + 1.5

    def light(ratio: float) -> float:
        return 0.1 + 0.8 / (1.0 + (ratio * inner / (1.5 * RADIUS)) ** 2)

    assert light(2.6 ** (1 / 12)) < halo.edge < light(1.0)
    assert halo.fall == pytest.approx(light(2.6 ** (0.6 / 12)) - light(2.6 ** (11.4 / 12)), rel=0.1)


def test_a_bright_sector_is_left_out() -> None:
    rows, columns = np.mgrid[:SIZE, :SIZE]
    light = glare()
    streak = np.abs(np.arctan2(rows - 80.0, columns - 80.0)) < math.radians(20.0)
    light = np.where(streak & (light < 1.0), np.minimum(light + 0.25, 0.98), light)
    halo = found_in(light)
    assert (halo.x, halo.y) == pytest.approx((80.0, 80.0), abs=0.15)
    assert halo.share == pytest.approx(1.0 - 40.0 / 360.0, abs=0.1)


def test_uneven_light_makes_the_centre_uncertain() -> None:
    even, rng = found_in(glare(noise=0.01)), np.random.default_rng(1)
    patches = np.kron(rng.uniform(-0.12, 0.12, (16, 16)), np.ones((10, 10)))
    light = glare()
    uneven = found_in(np.where(light < 1.0, np.clip(light + patches, 0.0, 0.98), 1.0))
    assert uneven.sigma_px > 3.0 * even.sigma_px
    assert uneven.scatter > 3.0 * even.scatter


@pytest.mark.parametrize("level", [0.0, 0.02, 0.99, 1.0])
def test_light_without_a_gradation_has_no_centre(level: float) -> None:
    assert halo_about(np.full((SIZE, SIZE), level), center=(80.0, 80.0), radius=RADIUS) is None


@pytest.mark.parametrize("center", [(-500.0, 80.0), (80.0, 900.0)])
def test_beyond_the_image_there_is_no_light(center: tuple[float, float]) -> None:
    assert halo_about(glare(), center=center, radius=RADIUS) is None


@pytest.mark.parametrize("x", [2.0, 12.0])
def test_a_sun_at_the_border_has_the_light_of_one_side(x: float) -> None:
    halo = halo_about(glare(x, 80.0), center=(x + 0.5, 80.0), radius=RADIUS)
    assert halo is not None
    assert halo.share < 0.85
    assert (halo.x, halo.y) == pytest.approx((x, 80.0), abs=1.0)


def test_a_few_pixels_tell_nothing() -> None:
    assert halo_about(np.full((12, 12), 0.5), center=(6.0, 6.0), radius=2.0) is None


def rings_of(residual: FloatArray, jacobian: FloatArray, weight: FloatArray, *, sectors: int = 24) -> _Rings:
    ring = np.arange(residual.size) % 12
    return _Rings(ring, (np.arange(residual.size) // 12) % sectors, residual, jacobian, weight, np.ones(12))


def test_without_a_gradient_only_the_prior_on_the_shape_is_left() -> None:
    state = np.array([80.0, 80.0, 0.1, -0.2, 0.0, 0.0])
    rings = rings_of(np.zeros(600), np.zeros((600, 6)), np.ones(600))
    matrix, gradient = _normal(rings, state)
    precision = 16.0 * 600 / 50.0  # 1 / 0.25², at a fiftieth of the pixels' weight
    assert matrix.sum(axis=0) == pytest.approx(np.diag([0.0, 0.0, precision, precision, 0.0, 0.0]))
    assert gradient.sum(axis=0) == pytest.approx([0.0, 0.0, -0.1 * precision, 0.2 * precision, 0.0, 0.0])
    assert matrix.shape == (24, 6, 6)


def test_the_normal_equations_have_the_level_of_each_ring_free() -> None:
    rng = np.random.default_rng(3)
    jacobian, residual, weight = rng.normal(size=(600, 6)), rng.normal(size=600), rng.uniform(0.1, 1.0, 600)
    rings = rings_of(residual, jacobian, weight)
    matrix, gradient = _normal(rings, np.zeros(6))
    levels = np.eye(12)[rings.ring]
    design = np.hstack([jacobian, levels])
    prior = np.diag([0.0, 0.0, 192.0, 192.0, 0.0, 0.0] + [0.0] * 12)
    whole = design.T @ (design * weight[:, None]) + prior
    step = np.linalg.solve(whole, design.T @ (weight * residual))[:6]  # all unknowns at once
    assert np.linalg.solve(matrix.sum(axis=0), gradient.sum(axis=0)) == pytest.approx(step, rel=1e-9)


def test_the_weights_are_tukeys_over_the_spread_of_a_ring_below_its_profile() -> None:
    ring = np.repeat(np.arange(12), 50)
    residual = np.random.default_rng(4).normal(0.0, 0.02, 600)
    weight = _weights(residual, ring, 4.0)
    own = residual[ring == 5]
    scale = -2.1 * np.median(own[own < 0.0])
    expected = np.where(np.abs(own) < 4.0 * scale, (1.0 - (own / (4.0 * scale)) ** 2) ** 2, 0.0) / scale**2
    assert weight[ring == 5] == pytest.approx(expected)


def test_a_ring_without_noise_has_the_scatter_of_8_bits() -> None:
    assert _weights(np.zeros(600), np.repeat(np.arange(12), 50), 4.0) == pytest.approx(1.0)  # nothing is below
    residual = np.tile([1e-6, -1e-6], 300)
    assert _weights(residual, np.repeat(np.arange(12), 50), 4.0) == pytest.approx(0.004**-2, rel=1e-5)


@pytest.mark.parametrize("hidden", [6, 12])
def test_the_share_is_that_of_the_sectors_with_light(hidden: int) -> None:
    rows, columns = np.mgrid[:SIZE, :SIZE]
    sector = np.floor((np.arctan2(rows - 80.0, columns - 80.0) / (2.0 * math.pi) + 0.5) * 24.0)
    light = np.where((sector < hidden) & (np.hypot(rows - 80.0, columns - 80.0) > RADIUS), 0.0, glare())
    assert found_in(light).share == pytest.approx(1.0 - hidden / 24.0, abs=1.01 / 24.0)


def test_the_derivatives_by_the_skys_slope_are_the_offsets_over_the_inner_radius() -> None:
    state, inner = np.array([80.0, 80.0, 0.0, 0.0, 0.0, 0.0]), 1.05 * RADIUS + 1.5
    pixels = _around(glare(), state, 2.6 * inner)
    assert pixels is not None
    rings = _ringed(pixels, state, inner, cut=4.0)
    assert rings is not None
    offset = pixels.position - state[:2]
    distance = np.hypot(*offset.T)
    inside = (distance > inner) & (distance < 2.6 * inner)
    assert rings.jacobian[:, 4:] == pytest.approx(offset[inside] / inner)
