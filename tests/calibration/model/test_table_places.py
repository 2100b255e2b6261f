"""Rings and spokes of the table of uncertainties: where a pixel stands among them."""

from __future__ import annotations

import math

import numpy as np
import pytest
from tests.fixtures.calibration import ideal_camera

from sunarc.calibration.answers.direction_table import (
    RINGS,
    SPOKES,
    in_image,
    polar_spline,
    ring_and_spoke,
)
from sunarc.optics.inverse_table import inverse_table, spline_weights

CONSTANTS = inverse_table(ideal_camera()).constants
N_RINGS, N_SPOKES = 20, 36


@pytest.mark.parametrize("angle_deg", [0.0, 0.5, 4.9, 89.9, 180.0, 270.0, 359.5])
def test_the_spoke_is_the_angle_about_the_principal_point_from_0_to_below_all(angle_deg: float) -> None:
    angle = math.radians(angle_deg)
    x, y = 319.5 + 80.0 * math.cos(angle), 239.5 + 80.0 * math.sin(angle)
    ring, spoke = ring_and_spoke(CONSTANTS, N_RINGS, N_SPOKES, 10.0, x, y)
    assert ring == pytest.approx(80.0 / 200.0 * 10.0)
    assert spoke == pytest.approx(angle_deg / 10.0, abs=1e-9)
    assert 0.0 <= spoke < N_SPOKES


def test_beyond_the_last_ring_the_last_one_answers() -> None:
    assert ring_and_spoke(CONSTANTS, N_RINGS, N_SPOKES, 10.0, 319.5 + 1e4, 239.5)[0] == N_RINGS - 1.0


@pytest.mark.parametrize("place", [0.0, 0.25, 3.5, 6.999, 7.0])
def test_the_weights_are_those_of_a_cubic_b_spline(place: float) -> None:
    node, *weights = spline_weights(place, 6)
    t = place - node

    def b_spline(u: float) -> float:
        u = abs(u)
        return (4.0 - 6.0 * u * u + 3.0 * u**3) / 6.0 if u < 1.0 else max(2.0 - u, 0.0) ** 3 / 6.0

    assert weights == pytest.approx([b_spline(t + 1.0), b_spline(t), b_spline(t - 1.0), b_spline(t - 2.0)], abs=1e-12)
    assert node == min(int(place), 6)


@pytest.mark.parametrize(
    ("x", "y", "inside"), [(-0.5, -0.5, 1.0), (7.5, 5.5, 1.0), (-0.51, 2.0, 0.0), (7.51, 2.0, 0.0), (2.0, 5.51, 0.0)]
)
def test_the_image_reaches_to_the_outer_edges_of_its_pixels(x: float, y: float, inside: float) -> None:
    assert in_image((8, 6), x, y) == inside


def test_the_spline_passes_through_its_sheet() -> None:
    ring, spoke = np.mgrid[:RINGS, :SPOKES]
    sheet = 2.0 + (ring / RINGS) ** 2 * np.cos(2.0 * math.pi * spoke / SPOKES)
    c = polar_spline(sheet)
    assert c.shape == (RINGS + 2, SPOKES + 3)
    across = (c[:-2] + 4.0 * c[1:-1] + c[2:]) / 6.0
    through = (across[:, :-3] + 4.0 * across[:, 1:-2] + across[:, 2:-1]) / 6.0
    np.testing.assert_allclose(through, sheet, atol=1e-9)
