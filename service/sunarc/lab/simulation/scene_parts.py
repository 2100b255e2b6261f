"""Parts of the simulated sky by day and by night: clouds, the sun's disc on the sensor, directions of pixels."""

from __future__ import annotations

import math
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

from sunarc.common.array_types import BoolArray, FloatArray
from sunarc.lab.simulation.options import Obstruction, Weather
from sunarc.optics.camera import Camera
from sunarc.optics.forward import project_with_jacobian, tangent_basis
from sunarc.optics.inverse import unproject
from sunarc.optics.pose import rotation_matrix
from sunarc.sky.directions import wrapped_deg
from sunarc.sky.sun import SOLAR_RADIUS

_RINGS = 16
_SPOKES = 48


class DiscPoints(NamedTuple):
    """The disc as weighted points, exactly symmetric about its centre.

    direction_enu (n, 3) unit vectors; pixel (n, 2); weight_px (n,) area in px² times the limb's darkening.
    """

    direction_enu: FloatArray
    pixel: FloatArray
    weight_px: FloatArray


class Stamp(NamedTuple):
    """A small image (h, w) whose first pixel is (x, y) of the large one."""

    x: int
    y: int
    values: FloatArray


def disc_points(
    camera: Camera, sun_enu: FloatArray, *, limb_darkening: float, radius: float = SOLAR_RADIUS
) -> DiscPoints | None:
    """Return the sun's disc as points, or one of another radius (rad); None where the camera does not see it.

    Gauss-Legendre in mu (the cosine on the sun) and equal steps in angle: the weights of each ring of
    1 - u (1 - mu), so that the middle of the disc has unit brightness.
    """
    centre, _, by_direction = project_with_jacobian(camera, sun_enu)
    if not np.all(np.isfinite(centre)):
        return None
    mu, ring = (
        0.5 * (nodes + shift) for nodes, shift in zip(np.polynomial.legendre.leggauss(_RINGS), (1, 0), strict=True)
    )
    spoke = (np.arange(_SPOKES) + 0.5) * (2.0 * math.pi / _SPOKES)
    offset = radius * np.sqrt(1.0 - mu**2)[:, None, None] * np.stack([np.cos(spoke), np.sin(spoke)], axis=-1)
    offset = offset.reshape(-1, 2)
    brightness = (1.0 - limb_darkening * (1.0 - mu)) * mu * ring
    basis = tangent_basis(sun_enu)
    stretch = by_direction @ basis
    area = abs(np.linalg.det(stretch)) * radius**2 * (2.0 * math.pi / _SPOKES)
    direction = sun_enu + offset @ basis.T
    return DiscPoints(
        direction / np.linalg.norm(direction, axis=-1, keepdims=True),
        centre + offset @ stretch.T,
        np.repeat(brightness * area, _SPOKES),
    )


def is_covered(direction_enu: FloatArray, sun_enu: FloatArray, *, share: float) -> BoolArray:
    """Return (n,) which points of the disc are behind an edge that hides this share of its diameter from the left."""
    rightward = np.array([sun_enu[1], -sun_enu[0], 0.0]) / max(math.hypot(sun_enu[0], sun_enu[1]), 1e-9)
    along = (direction_enu - sun_enu) @ rightward / SOLAR_RADIUS
    return np.asarray(along < -1.0 + 2.0 * share) if share > 0.0 else np.zeros(len(direction_enu), dtype=np.bool_)


def make_stamp(pixel: FloatArray, weight: FloatArray, *, sigma_px: float) -> Stamp:
    """Return weighted points blurred by a Gaussian and integrated over each pixel; the stamp's sum is the weights'."""
    margin = 6.0 * sigma_px + 1.0
    x0, y0 = (int(v) for v in np.floor(pixel.min(axis=0) - margin))
    x1, y1 = (int(v) for v in np.ceil(pixel.max(axis=0) + margin))
    columns = _compute_pixel_shares(np.arange(x0, x1 + 2), pixel[:, 0], sigma_px)
    rows = _compute_pixel_shares(np.arange(y0, y1 + 2), pixel[:, 1], sigma_px)
    return Stamp(x0, y0, (rows * weight) @ columns.T)


def _compute_pixel_shares(first_to_last: NDArray[np.intp], position: FloatArray, sigma_px: float) -> FloatArray:
    """Return (pixels, points): how much of each point's light falls between the pixel's edges, in one axis."""
    edges = (first_to_last[:, None] - 0.5 - position[None, :]) / sigma_px
    return np.asarray(np.diff(ndtr(edges), axis=0))


_SIZE = 1024
_WIND_TEXELS_PER_S = (1.3, 0.37)  # 10 m/s under a base of 1500 m


class CloudLayer(NamedTuple):
    """The layer at one moment: transmittance (1024, 1024), periodic, and its offset in texels, positive."""

    transmittance: NDArray[np.float32]
    offset_x: float
    offset_y: float


CLEAR_SKY = CloudLayer(np.ones((1, 1), dtype=np.float32), 0.0, 0.0)
"""No clouds."""


def cloud_layer(weather: Weather, *, seed: int, unix_s: float) -> CloudLayer:
    """Return the clouds of a weather at a moment."""
    if weather == "clear":
        return CLEAR_SKY
    # eight periods more keep every position of the layer positive
    offset_x, offset_y = (speed * unix_s % _SIZE + 8.0 * _SIZE for speed in _WIND_TEXELS_PER_S)
    return CloudLayer(_make_transmittance(weather, seed), offset_x, offset_y)


@lru_cache(maxsize=4)
def _make_transmittance(weather: Weather, seed: int) -> NDArray[np.float32]:
    noise = _fractal_noise(np.random.default_rng([seed, 77]))
    match weather:
        case "veil":
            depth = np.clip(0.6 + 0.35 * noise, 0.1, None)
        case "broken":
            depth = 5.0 * np.clip(noise, 0.0, None)
        case _:
            depth = np.clip(12.0 + 3.0 * noise, 8.0, None)
    return np.exp(-depth).astype(np.float32)


def _fractal_noise(rng: np.random.Generator) -> FloatArray:
    """Draw periodic noise of unit variance with the spectrum of cloud fields (power ~ k^-11/3)."""
    frequency = np.fft.fftfreq(_SIZE)
    k = np.hypot(frequency[:, None], frequency[None, :])
    k[0, 0] = np.inf
    amplitude = (k**2 + (10.0 / _SIZE) ** 2) ** (-11.0 / 12.0)
    noise = np.fft.ifft2(np.fft.fft2(rng.standard_normal((_SIZE, _SIZE))) * amplitude).real
    return np.asarray((noise - noise.mean()) / noise.std())


_ROWS_AT_ONCE = 64


class RegionLight(NamedTuple):
    """A region of the image: its light (h, w), the directions of its pixels (h, w, 4), and its first pixel."""

    light: NDArray[np.float32]
    field: NDArray[np.float32]
    origin: tuple[int, int]


@lru_cache(maxsize=1)
def pixel_field(camera: Camera, *, field_deg: float, obstructions: tuple[Obstruction, ...]) -> NDArray[np.float32]:
    """Return (height, width, 4) float32: east, north, up of each pixel, and whether it sees the sky.

    The fourth number is the share of sky (0 to 1), minus the share of ground where it sees ground, and 0 outside the
    image circle; edges are soft over one pixel. The last answer is kept (it takes seconds), and not to be written to.
    """
    field = np.zeros((camera.height, camera.width, 4), dtype=np.float32)
    x = np.arange(camera.width, dtype=np.float64)
    axis = rotation_matrix(camera.rotation_cam_enu)[2]
    for first in range(0, camera.height, _ROWS_AT_ONCE):
        rows = np.arange(first, min(first + _ROWS_AT_ONCE, camera.height), dtype=np.float64)
        pixels = np.stack(np.meshgrid(x, rows), axis=-1)
        direction = unproject(camera, pixels)
        block = field[first : first + rows.size]
        inside = np.nan_to_num(_inside_circle(camera, direction @ axis, field_deg))
        direction = np.nan_to_num(direction)
        block[..., :3] = direction
        sky = np.clip(0.5 + direction[..., 2] * camera.focal_length_px[0], 0.0, 1.0)
        sky[is_blocked(direction, obstructions)] = 0.0
        block[..., 3] = inside * np.where(sky > 0.0, sky, -1.0)
    return field


def is_blocked(direction_enu: FloatArray, obstructions: tuple[Obstruction, ...]) -> BoolArray:
    """Return (...) whether directions end on the ground or on an obstruction."""
    east, north, up = np.moveaxis(direction_enu, -1, 0)
    blocked = up <= 0.0
    azimuth = np.degrees(np.arctan2(east, north))
    for thing in obstructions:
        aside = wrapped_deg(azimuth - thing.azimuth_deg)
        blocked |= (np.abs(aside) < 0.5 * thing.width_deg) & (up < math.sin(math.radians(thing.height_deg)))
    return np.asarray(blocked)


def _inside_circle(camera: Camera, cos_theta: FloatArray, field_deg: float) -> FloatArray:
    limit = math.radians(min(field_deg, math.degrees(camera.max_angle)))
    theta = np.arccos(np.clip(cos_theta, -1.0, 1.0))
    return np.asarray(np.clip(0.5 + (limit - theta) * camera.focal_length_px[0], 0.0, 1.0))
