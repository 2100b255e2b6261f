"""The bias of a blob's centroid against the integral over its image."""

from __future__ import annotations

import math

import numpy as np
import pytest
from tests.detection.rendering import FloatArray

from sunarc.detection.photo.ordinary_image import Lens, bias_at, radial_bias_px

ALPHA_PX = 600.0


def equidistant(angle: FloatArray) -> FloatArray:
    return ALPHA_PX * np.asarray(angle)


def stereographic(angle: FloatArray) -> FloatArray:
    return 2.0 * ALPHA_PX * np.tan(np.asarray(angle) / 2.0)


def lens_of(radius: object) -> Lens:
    assert callable(radius)
    return Lens(axis_px=(700.0, 500.0), radius_px=radius, max_angle=math.radians(95.0))


def bias_by_area(lens: Lens, angle: float, blob: float) -> float:
    """Return the centroid of the blob's image by a sum over the sphere, each patch with its area on the sensor."""
    steps, turns = (np.arange(400) + 0.5) / 400.0 * blob, (np.arange(720) + 0.5) / 360.0 * math.pi
    off, turn = np.meshgrid(steps, turns, indexing="ij")
    along = math.sin(angle) * np.cos(off) + math.cos(angle) * np.sin(off) * np.cos(turn)
    across = np.sin(off) * np.sin(turn)
    upward = math.cos(angle) * np.cos(off) - math.sin(angle) * np.sin(off) * np.cos(turn)
    theta = np.arctan2(np.hypot(along, across), upward)
    step = 1e-5
    slope = (lens.radius_px(theta + step) - lens.radius_px(theta - step)) / (2.0 * step)
    area = np.sin(off) * slope * lens.radius_px(theta) / np.sin(theta)
    x = lens.radius_px(theta) * along / np.hypot(along, across)
    return float(np.sum(area * x) / np.sum(area)) - float(lens.radius_px(np.array([angle]))[0])


@pytest.mark.parametrize("radius", [equidistant, stereographic])
@pytest.mark.parametrize(("angle_deg", "blob_deg"), [(20.0, 3.0), (50.0, 8.0), (80.0, 5.0)])
def test_the_bias_is_that_of_the_area_of_the_image(radius: object, angle_deg: float, blob_deg: float) -> None:
    lens, angle, blob = lens_of(radius), math.radians(angle_deg), math.radians(blob_deg)
    expected = bias_by_area(lens, angle, blob)
    assert radial_bias_px(lens, angle=angle, blob_radius=blob) == pytest.approx(expected, rel=0.01, abs=1e-3)


def test_the_bias_grows_with_the_square_of_the_blob() -> None:
    lens = lens_of(equidistant)
    small, large = (radial_bias_px(lens, angle=0.9, blob_radius=radius) for radius in (0.02, 0.04))
    assert large / small == pytest.approx(4.0, rel=0.02)


@pytest.mark.parametrize("azimuth", [0.0, 1.0, 4.0])
@pytest.mark.parametrize("radius", [equidistant, stereographic])
def test_at_a_pixel_angle_and_size_follow_from_the_lens(azimuth: float, radius: object) -> None:
    lens, angle, blob = lens_of(radius), 0.9, 0.05
    far = float(lens.radius_px(np.array([angle]))[0])
    slope = float(lens.radius_px(np.array([angle + 1e-5]))[0] - far) / 1e-5
    radius_px = blob * math.sqrt(slope * far / math.sin(angle))
    found = bias_at(
        lens, x_px=700.0 + far * math.cos(azimuth), y_px=500.0 + far * math.sin(azimuth), radius_px=radius_px
    )
    assert found == pytest.approx(radial_bias_px(lens, angle=angle, blob_radius=blob), rel=0.01)


def test_on_the_axis_the_bias_is_nil_and_finite() -> None:
    assert bias_at(lens_of(equidistant), x_px=700.0, y_px=500.0, radius_px=20.0) == pytest.approx(0.0, abs=1e-9)
