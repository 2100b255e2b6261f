from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sunarc.sky.directions import angles_from_direction, angular_distance, direction_from_angles, wrapped_deg

geometry = settings(derandomize=True, deadline=None)
AZIMUTHS = st.floats(0.0, 360.0, exclude_max=True)
EAST, NORTH, UP = np.eye(3)


@pytest.mark.parametrize(
    ("zenith_deg", "azimuth_deg", "direction"),
    [(0.0, 0.0, UP), (90.0, 0.0, NORTH), (90.0, 90.0, EAST), (90.0, 180.0, -NORTH), (90.0, 270.0, -EAST)],
)
def test_azimuth_runs_clockwise_from_north(zenith_deg: float, azimuth_deg: float, direction: np.ndarray) -> None:
    np.testing.assert_allclose(
        direction_from_angles(zenith_deg=zenith_deg, azimuth_deg=azimuth_deg), direction, atol=1e-15
    )
    zenith, azimuth = angles_from_direction(direction)
    assert (float(zenith), float(azimuth)) == (zenith_deg, azimuth_deg)


@geometry
@given(zenith_deg=st.floats(0.001, 179.999), azimuth_deg=AZIMUTHS)
def test_angles_survive_the_way_there_and_back(zenith_deg: float, azimuth_deg: float) -> None:
    direction = direction_from_angles(zenith_deg=zenith_deg, azimuth_deg=azimuth_deg)
    assert float(np.linalg.norm(direction)) == pytest.approx(1.0, abs=1e-15)
    zenith, azimuth = angles_from_direction(direction)
    assert float(zenith) == pytest.approx(zenith_deg, abs=1e-9)
    turned = (float(azimuth) - azimuth_deg + 180.0) % 360.0 - 180.0
    assert abs(turned) * np.sin(np.radians(zenith_deg)) < 1e-9
    assert 0.0 <= float(azimuth) < 360.0


@geometry
@given(vector=st.tuples(*[st.floats(-1.0, 1.0)] * 3).filter(lambda v: np.linalg.norm(v) > 0.01))
def test_directions_survive_the_way_there_and_back(vector: tuple[float, float, float]) -> None:
    unit = np.array(vector) / np.linalg.norm(vector)
    zenith, azimuth = angles_from_direction(vector)
    np.testing.assert_allclose(direction_from_angles(zenith_deg=zenith, azimuth_deg=azimuth), unit, atol=1e-14)


@pytest.mark.parametrize("east", [-1e-17, -1e-300, -0.0, 0.0, 1e-17])
def test_due_north_has_no_seam(east: float) -> None:
    _, azimuth = angles_from_direction([east, 1.0, 0.0])
    assert 0.0 <= float(azimuth) < 1e-12


def test_where_an_angle_is_missing_the_direction_is_too() -> None:
    directions = direction_from_angles(zenith_deg=[10.0, np.nan], azimuth_deg=[20.0, 20.0])
    assert np.isfinite(directions[0]).all()
    assert np.isnan(directions[1]).any()


def test_angles_broadcast() -> None:
    directions = direction_from_angles(zenith_deg=np.zeros((3, 1)), azimuth_deg=np.zeros(4))
    assert directions.shape == (3, 4, 3)


@geometry
@given(angle=st.floats(0.0, np.pi), about=st.floats(0.0, 2.0 * np.pi))
def test_the_distance_is_the_angle_between_at_every_size(angle: float, about: float) -> None:
    away = np.array([np.sin(angle) * np.cos(about), np.sin(angle) * np.sin(about), np.cos(angle)])
    assert float(angular_distance(UP, away)) == pytest.approx(angle, abs=3e-16 + 3e-15 * angle)


def test_the_distance_of_a_nanoradian_is_a_nanoradian() -> None:
    assert float(angular_distance(UP, [1e-9, 0.0, 1.0])) == pytest.approx(1e-9, rel=1e-9)
    assert float(angular_distance(UP, -UP)) == pytest.approx(np.pi)


def test_wrapped_angles_lie_from_minus_180_to_below_180() -> None:
    given = np.array([-540.0, -190.0, -180.0, -1.0, 0.0, 179.0, 180.0, 359.0, 720.0])
    np.testing.assert_array_equal(wrapped_deg(given), [-180.0, 170.0, -180.0, -1.0, 0.0, 179.0, -180.0, -1.0, 0.0])
    assert float(wrapped_deg(350.0 - 10.0)) == -20.0
