"""Eq. 27 of the paper by hand."""

from __future__ import annotations

import math

import numpy as np
import pytest
from tests.fixtures.calibration import small_camera, spread_directions

from sunarc.calibration.model.result import NO_METRICS, fit_metrics, measures, residual_angles
from sunarc.optics.forward import project

RESIDUAL = np.array([[3.0, 4.0], [0.0, 1.0], [0.0, -5.0], [8.0, 6.0]])
"""Distances 5, 1, 5 and 10."""


def test_measures_by_hand() -> None:
    rmse, mae, sd, sd_of_distance = measures(RESIDUAL)
    assert rmse == pytest.approx(math.sqrt(151.0 / 4.0))
    assert mae == pytest.approx(21.0 / 4.0)
    mean = np.array([11.0 / 4.0, 6.0 / 4.0])
    assert sd == pytest.approx(math.sqrt(151.0 / 4.0 - float(mean @ mean)))
    assert sd_of_distance**2 == pytest.approx(rmse**2 - mae**2)  # as the paper's tables have it


def test_measures_of_nothing_are_no_numbers() -> None:
    assert all(math.isnan(one) for one in measures(np.zeros((0, 2))))


def test_a_common_displacement_is_no_scatter() -> None:
    rmse, mae, sd, sd_of_distance = measures(np.tile([0.6, -0.8], (5, 1)))
    assert rmse == pytest.approx(1.0)
    assert mae == pytest.approx(1.0)
    assert sd == pytest.approx(0.0, abs=1e-12)
    assert sd_of_distance == pytest.approx(0.0, abs=1e-12)


def test_what_was_not_used_counts_for_the_whole_alone() -> None:
    used = np.array([True, True, True, False])
    angle = np.radians([3.0, 4.0, np.nan, 90.0])
    found = fit_metrics(RESIDUAL, used, angle)
    assert found.n == 3
    assert found.rmse_px == pytest.approx(math.sqrt(51.0 / 3.0))
    assert found.rmse_all_px == pytest.approx(math.sqrt(151.0 / 4.0))
    assert found.mae_px == pytest.approx(11.0 / 3.0)
    assert found.rmse_deg == pytest.approx(math.sqrt(12.5))  # those that the camera sees


def test_no_used_sighting_has_no_metrics() -> None:
    found = fit_metrics(RESIDUAL, np.zeros(4, dtype=bool), np.full(4, np.nan))
    assert found.n == 0
    assert math.isnan(found.rmse_px)
    assert math.isnan(found.rmse_deg)
    assert NO_METRICS.n == 0


def test_the_angle_between_a_sighting_and_the_sun() -> None:
    camera = small_camera()
    directions = spread_directions(5, widest_deg=50.0)
    pixels = project(camera, directions)
    np.testing.assert_allclose(residual_angles(camera, pixels, directions), 0.0, atol=1e-8)
    other = np.roll(directions, 1, axis=0)
    expected = np.arccos(np.sum(directions * other, axis=-1))
    np.testing.assert_allclose(residual_angles(camera, pixels, other), expected, atol=1e-7)
