"""The disc's stamp against a rendering by brute force, and its sums."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from sunarc.lab.simulation.scene_parts import disc_points, make_stamp
from sunarc.lab.simulation.truth import true_camera
from sunarc.optics.forward import local_stretch, project
from sunarc.sky.directions import direction_from_angles
from sunarc.sky.sun import SOLAR_RADIUS

FloatArray = NDArray[np.float64]

_FINE = 40
_SIGMA_PX = 0.7


def by_brute_force(centre: FloatArray, stretch: FloatArray, *, x: int, y: int, shape: tuple[int, ...]) -> FloatArray:
    """Render the limb-darkened disc (u = 0.6) on a grid 40 times finer, blur it, and average over each pixel."""
    fine_y, fine_x = (np.arange(n * _FINE) / _FINE - 0.5 + 0.5 / _FINE for n in shape)
    offset = np.stack(np.meshgrid(fine_x + x - centre[0], fine_y + y - centre[1]), axis=-1)
    rho = np.linalg.norm(offset @ np.linalg.inv(stretch).T, axis=-1) / SOLAR_RADIUS
    disc = np.where(rho < 1.0, 1.0 - 0.6 * (1.0 - np.sqrt(np.clip(1.0 - rho**2, 0.0, 1.0))), 0.0)
    blurred = gaussian_filter(disc, _SIGMA_PX * _FINE, truncate=6.0)
    return np.asarray(blurred.reshape(shape[0], _FINE, shape[1], _FINE).mean(axis=(1, 3)))


def test_the_stamp_is_what_brute_force_gives() -> None:
    camera = true_camera()
    for zenith_deg in (3.0, 40.0, 85.0):
        direction = direction_from_angles(zenith_deg=zenith_deg, azimuth_deg=200.0)
        points = disc_points(camera, direction, limb_darkening=0.6)
        assert points is not None
        stamp = make_stamp(points.pixel, points.weight_px, sigma_px=_SIGMA_PX)
        reference = by_brute_force(
            project(camera, direction),
            local_stretch(camera, direction),
            x=stamp.x,
            y=stamp.y,
            shape=stamp.values.shape,
        )
        np.testing.assert_allclose(stamp.values, reference, atol=2e-3 * reference.max())


@settings(derandomize=True, deadline=None, max_examples=40)
@given(zenith_deg=st.floats(0.0, 88.0), azimuth_deg=st.floats(0.0, 360.0), sigma_px=st.floats(0.5, 2.0))
def test_the_stamp_s_centroid_is_the_sun_and_its_sum_the_disc_s_light(
    zenith_deg: float, azimuth_deg: float, sigma_px: float
) -> None:
    camera = true_camera()
    direction = direction_from_angles(zenith_deg=zenith_deg, azimuth_deg=azimuth_deg)
    points = disc_points(camera, direction, limb_darkening=0.6)
    assert points is not None
    stamp = make_stamp(points.pixel, points.weight_px, sigma_px=sigma_px)
    rows, columns = np.indices(stamp.values.shape)
    total = stamp.values.sum()
    found = np.array([(columns * stamp.values).sum() / total + stamp.x, (rows * stamp.values).sum() / total + stamp.y])
    np.testing.assert_allclose(found, project(camera, direction), atol=1e-4)
    area = np.pi * SOLAR_RADIUS**2 * abs(np.linalg.det(local_stretch(camera, direction)))
    np.testing.assert_allclose(total, area * (1.0 - 0.6 / 3.0), rtol=1e-6)
