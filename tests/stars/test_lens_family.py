"""The family of lenses against the ideal projections."""

from __future__ import annotations

import math

import numpy as np
import pytest

from sunarc.optics.projections import Projection, ideal_radius
from sunarc.stars.sky_turn import (
    angle_to_radius,
    nearest_projection,
    radial_for,
    radius_to_angle,
)

ANGLES = np.radians(np.linspace(1.0, 85.0, 40))


@pytest.mark.parametrize(
    ("projection", "shape"),
    [("equidistant", 0.0), ("equisolid", -0.5), ("stereographic", 0.5), ("orthographic", -1.0)],
)
def test_each_ideal_projection_is_a_shape(projection: Projection, shape: float) -> None:
    np.testing.assert_allclose(angle_to_radius(ANGLES, shape), ideal_radius(projection, ANGLES), rtol=1e-12)
    assert nearest_projection(shape + 0.1) == projection
    assert np.max(np.abs(radial_for(shape, projection))) < 1e-9


@pytest.mark.parametrize("shape", [-0.9, -0.3, 0.2, 0.6])
def test_the_radius_gives_the_angle_back_and_a_polynomial_makes_up_the_rest(shape: float) -> None:
    np.testing.assert_allclose(radius_to_angle(angle_to_radius(ANGLES, shape), shape), ANGLES, rtol=1e-9)
    projection = nearest_projection(shape)
    powers = (ANGLES / (0.5 * math.pi))[:, None] ** np.arange(2, 10)
    made = ideal_radius(projection, ANGLES) + powers @ np.array(radial_for(shape, projection))
    assert np.max(np.abs(made - angle_to_radius(ANGLES, shape))) < 0.004
