"""Rings and spokes of the table of uncertainties: where a pixel stands among them."""

from __future__ import annotations

import math

import numpy as np
import pytest
from tests.fixtures.calibration import ideal_camera

from sunarc import _kernels
from sunarc.calibration.answers.direction_table import RINGS, SPOKES, polar_spline
from sunarc.common.array_types import FloatArray
from sunarc.optics.inverse_table import inverse_table

CONSTANTS = np.array(inverse_table(ideal_camera()).constants)
N_RINGS, N_SPOKES = 20, 36


def values_at(sheets: FloatArray, x: float, y: float) -> list[float]:
    return [float(v) for v in _kernels.polar_values(CONSTANTS, sheets, 10.0, np.array([[x, y]]))[0]]


def place_of(x: float, y: float) -> list[float]:
    """Return the ring and the spoke of a pixel: a spline reproduces its nodes' own numbers."""
    numbers = np.mgrid[-1.0 : N_RINGS + 1.0, -1.0 : N_SPOKES + 2.0]
    return values_at(np.ascontiguousarray(np.moveaxis(numbers, 0, -1)), x, y)


@pytest.mark.parametrize("angle_deg", [0.0, 0.5, 4.9, 89.9, 180.0, 270.0, 359.5])
def test_the_spoke_is_the_angle_about_the_principal_point_from_0_to_below_all(angle_deg: float) -> None:
    angle = math.radians(angle_deg)
    ring, spoke = place_of(319.5 + 80.0 * math.cos(angle), 239.5 + 80.0 * math.sin(angle))
    assert ring == pytest.approx(80.0 / 200.0 * 10.0)
    assert spoke == pytest.approx(angle_deg / 10.0, abs=1e-9)
    assert -1e-9 <= spoke < N_SPOKES


def test_beyond_the_last_ring_the_last_one_answers() -> None:
    assert place_of(319.5 + 1e4, 239.5)[0] == pytest.approx(N_RINGS - 1.0)


@pytest.mark.parametrize("place", [0.0, 0.25, 3.5, 18.999, 19.0])
def test_a_node_counts_as_in_a_cubic_b_spline(place: float) -> None:
    def b_spline(u: float) -> float:
        u = abs(u)
        return (4.0 - 6.0 * u * u + 3.0 * u**3) / 6.0 if u < 1.0 else max(2.0 - u, 0.0) ** 3 / 6.0

    for ring in range(N_RINGS):
        sheets = np.zeros((N_RINGS + 2, N_SPOKES + 3, 2))
        sheets[ring + 1] = [1.0, -2.0]
        found = values_at(sheets, 319.5 + 20.0 * place, 239.5)
        assert found == pytest.approx([b_spline(place - ring), -2.0 * b_spline(place - ring)], abs=1e-9)


@pytest.mark.parametrize(
    ("x", "y", "inside"), [(-0.5, -0.5, 1.0), (7.5, 5.5, 1.0), (-0.51, 2.0, 0.0), (7.51, 2.0, 0.0), (2.0, 5.51, 0.0)]
)
def test_the_image_reaches_to_the_outer_edges_of_its_pixels(x: float, y: float, inside: float) -> None:
    sheet, slope, up = np.ones((N_RINGS + 2, N_SPOKES + 3)), np.ones(N_RINGS + 2), np.array([[0.0, 0.0, 1.0]])
    assert _kernels.back_projected(np.eye(3), sheet, slope, 10.0, 8, 6, np.array([[x, y]]), up)[0, 6] == inside


@pytest.mark.parametrize("turn_deg", [0.0, 0.5, 4.9, 89.9, 180.0, 270.0, 359.5])
def test_a_direction_has_the_ring_of_its_angle_off_the_axis_and_the_spoke_of_its_turn(turn_deg: float) -> None:
    turn = math.radians(turn_deg)
    ray = np.array([[0.6 * math.cos(turn), 0.6 * math.sin(turn), 0.8], [0.1, 0.0, -1.0]])
    ring, spoke = np.mgrid[-1.0 : N_RINGS + 1.0, -1.0 : N_SPOKES + 2.0]
    for numbers, expected in ((ring, 10.0 * math.atan2(0.6, 0.8)), (spoke, turn_deg / 10.0)):
        sheet, slope = np.ascontiguousarray(numbers / 10.0), np.full(N_RINGS + 2, 2.0)
        found = _kernels.back_projected(np.eye(3), sheet, slope, 10.0, 8, 6, np.zeros((2, 2)), ray)[:, 5]
        assert 10.0 * math.log(2.0 * found[0]) == pytest.approx(expected, abs=1e-9)
        sheets = np.stack([np.zeros_like(numbers), numbers, np.zeros_like(numbers)], axis=-1)
        factor = _kernels.projected(np.eye(3), sheets, 10.0, 8, 6, np.zeros((2, 2)), ray)
        assert factor[0, 4] == pytest.approx(expected, abs=1e-9)
    assert _kernels.projected(
        np.eye(3), np.stack([0.0 * ring, ring, 0.0 * ring], axis=-1), 10.0, 8, 6, np.zeros((2, 2)), ray
    )[1, 4] == pytest.approx(N_RINGS - 1.0)


def test_where_a_value_is_not_finite_the_next_one_inwards_stands() -> None:
    sheet = np.add.outer(np.linspace(1.0, 2.0, 20), np.zeros(36))
    damaged, mended = sheet.copy(), sheet.copy()
    damaged[17:, 3], mended[17:, 3] = np.inf, sheet[16, 3]
    np.testing.assert_array_equal(polar_spline(damaged), polar_spline(mended))


def test_the_spline_passes_through_its_sheet() -> None:
    ring, spoke = np.mgrid[:RINGS, :SPOKES]
    sheet = 2.0 + (ring / RINGS) ** 2 * np.cos(2.0 * math.pi * spoke / SPOKES)
    c = polar_spline(sheet)
    assert c.shape == (RINGS + 2, SPOKES + 3)
    across = (c[:-2] + 4.0 * c[1:-1] + c[2:]) / 6.0
    through = (across[:, :-3] + 4.0 * across[:, 1:-2] + across[:, 2:-1]) / 6.0
    np.testing.assert_allclose(through, sheet, atol=1e-9)
