"""Sine waves on a box, against their orthonormality and the kernel that they stand for."""

from __future__ import annotations

import math

import numpy as np
import pytest
from numpy.typing import NDArray

from sunarc.optics.displacement import WaveBasis, wave_basis

FloatArray = NDArray[np.float64]


@pytest.fixture(scope="module")
def basis() -> WaveBasis:
    return wave_basis(width=640, height=480, shortest_px=120.0, longest_px=200.0)


def test_the_box_is_the_image_with_a_margin_of_the_longest_length(basis: WaveBasis) -> None:
    assert basis.center_px == (319.5, 239.5)
    assert basis.half_px == (320.0 + 1.2 * 200.0, 240.0 + 1.2 * 200.0)


def test_waves_vanish_on_the_border_of_the_box(basis: WaveBasis) -> None:
    (cx, cy), (hx, hy) = basis.center_px, basis.half_px
    border = [[cx - hx, 100.0], [cx + hx, 100.0], [100.0, cy - hy], [100.0, cy + hy]]
    np.testing.assert_allclose(basis.values(border), 0.0, atol=1e-12)


def test_waves_are_orthonormal_on_the_box(basis: WaveBasis) -> None:
    (cx, cy), (hx, hy) = basis.center_px, basis.half_px
    x, dx = np.linspace(cx - hx, cx + hx, 121, retstep=True)
    y, dy = np.linspace(cy - hy, cy + hy, 121, retstep=True)
    values = basis.values(np.stack(np.meshgrid(x, y), axis=-1)).reshape(-1, len(basis.orders))
    np.testing.assert_allclose(values.T @ values * dx * dy, np.eye(len(basis.orders)), atol=1e-9)


def test_the_first_wave_by_hand(basis: WaveBasis) -> None:
    first = int(np.flatnonzero((basis.orders == [1, 1]).all(axis=1))[0])
    expected = 1.0 / math.sqrt(basis.half_px[0] * basis.half_px[1])
    assert basis.values(basis.center_px)[first] == pytest.approx(expected)


@pytest.mark.parametrize("length", [120.0, 160.0, 200.0])
def test_the_waves_variances_make_the_squared_exponential_kernel(basis: WaveBasis, length: float) -> None:
    pixels = np.random.default_rng(1).uniform([0.0, 0.0], [640.0, 480.0], (50, 2))
    waves = basis.values(pixels)
    made = (waves * basis.variances(length_px=length)) @ waves.T
    apart = np.sum((pixels[:, None] - pixels) ** 2, axis=-1)
    np.testing.assert_allclose(made, np.exp(-0.5 * apart / length**2), atol=0.06)


def test_variances_are_the_spectral_density_by_hand(basis: WaveBasis) -> None:
    # Rasmussen and Williams (2006), eq. 4.15 in two dimensions: 2 pi L^2 exp(-L^2 w^2 / 2)
    k = 3
    square = sum((0.5 * math.pi * basis.orders[k, a] / basis.half_px[a]) ** 2 for a in (0, 1))
    expected = 2.0 * math.pi * 150.0**2 * math.exp(-0.5 * 150.0**2 * square)
    assert basis.variances(length_px=150.0)[k] == pytest.approx(expected)


def test_all_waves_up_to_the_reach_are_there_and_none_beyond(basis: WaveBasis) -> None:
    frequency = np.hypot(*(0.5 * math.pi * basis.orders.T / np.array(basis.half_px)[:, None]))
    reach = 3.6 / 120.0
    assert frequency.max() <= reach
    counted = sum(
        math.hypot(0.5 * math.pi * i / basis.half_px[0], 0.5 * math.pi * j / basis.half_px[1]) <= reach
        for i in range(1, 40)
        for j in range(1, 40)
    )
    assert len(basis.orders) == counted
    assert len(np.unique(basis.orders, axis=0)) == counted


def test_a_completed_basis_has_the_waves_of_a_shorter_length_on_the_same_box(basis: WaveBasis) -> None:
    shorter = basis.completed(length_px=60.0)
    assert (shorter.center_px, shorter.half_px) == (basis.center_px, basis.half_px)
    known = {tuple(order) for order in basis.orders.tolist()}
    assert known < {tuple(order) for order in shorter.orders.tolist()}
    assert len(basis.completed(length_px=120.0).orders) == len(basis.orders)


def test_a_drawn_field_has_the_amplitude_and_the_length(basis: WaveBasis) -> None:
    rng = np.random.default_rng(3)
    sigma = 0.5 * np.sqrt(basis.variances(length_px=160.0))
    pixels = np.array([[300.0, 200.0], [460.0, 200.0], [300.0, 201.0]])
    drawn = (rng.standard_normal((4000, sigma.size)) * sigma) @ basis.values(pixels).T
    assert np.std(drawn[:, 0]) == pytest.approx(0.5, rel=0.05)
    # one length apart: exp(-1/2); one pixel apart: alike
    assert np.corrcoef(drawn[:, 0], drawn[:, 1])[0, 1] == pytest.approx(math.exp(-0.5), abs=0.05)
    assert np.corrcoef(drawn[:, 0], drawn[:, 2])[0, 1] > 0.999


def test_shapes_follow_those_of_the_pixels(basis: WaveBasis) -> None:
    m = len(basis.orders)
    assert basis.values(np.zeros((4, 5, 2))).shape == (4, 5, m)
    assert basis.values((1.0, 2.0)).shape == (m,)
    empty = WaveBasis(center_px=(0.0, 0.0), half_px=(1.0, 1.0), orders=np.zeros((0, 2), dtype=np.int64))
    assert empty.values(np.zeros((3, 2))).shape == (3, 0)


def test_waves_are_products_of_sines_and_nothing_beyond_the_box() -> None:
    basis = wave_basis(width=640, height=480, shortest_px=120.0, longest_px=200.0)
    half, center = np.array(basis.half_px), np.array(basis.center_px)
    pixels = np.random.default_rng(2).uniform(-0.99, 0.99, (40, 2)) * half + center
    phase = 0.5 * np.pi * ((pixels - center) / half + 1.0)
    expected = np.prod(np.sin(phase[:, None] * basis.orders) / np.sqrt(half), axis=-1)
    np.testing.assert_allclose(basis.values(pixels), expected, atol=1e-15)
    assert basis.orders.max() > 8
    np.testing.assert_array_equal(basis.values(center + half * [1.001, 0.0]), 0.0)
    assert basis.values(np.zeros((2, 0, 2))).shape == (2, 0, len(basis.orders))
