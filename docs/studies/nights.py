"""Detections of stars as a camera would give them, with what else a night holds; the truth is known."""

from __future__ import annotations

import functools
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import population as pop
from numpy.typing import NDArray

from sunarc.calibration.model.result import Calibration
from sunarc.common.array_types import BoolArray
from sunarc.detection.values import PredictedStars, Stars
from sunarc.optics.camera import Camera
from sunarc.optics.forward import project
from sunarc.optics.pose import rotation_matrix, rotation_vector
from sunarc.optics.projections import ideal_radius
from sunarc.sky.directions import angles_from_direction
from sunarc.sky.night import NightSky, night_sky
from sunarc.sky.site import relative_air_mass
from sunarc.stars.views import predict_stars

FloatArray = NDArray[np.float64]
MIDNIGHT = pop.MAY_13 + 6.0 * 3600.0
"""At the site of the population."""

_SNR_OF_ONE = 6.0 * 10.0 ** (0.4 * 6.0)
"""Of a star of V 0: one of V 6 stands 6 times above the noise of the sky."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Night:
    """What a made image holds beside the stars to V 5.5.

    sigma_px: of the centre of a star of V 3 per axis; it doubles every 1.5 magnitudes. field: displacement of pixels
    that no model knows. faint: fainter stars. cloud_share: of the azimuths that are behind cloud. satellites: trails
    of five detections each. hot_pixels: of the sensor hot_seed. lost: share of the stars that are not seen. coma_px:
    displacement of stars outwards at a right angle off the axis, growing as the radius to the power of 1.5;
    coma_decentred: by which share it varies over the azimuth. bent_deg: turn of the camera against the day's about a
    random axis. offset_px: further displacement outwards by the first to third power of that radius; decentred_px: by
    its square, over cosine and sine of the azimuth. raised: directions in the true air. noise_factor: noise over what
    is stated. clock_s: by how much the images are dated too late.
    """

    sigma_px: float = 0.1
    field: pop.Field | None = None
    faint: int = 300
    cloud_share: float = 0.0
    satellites: int = 0
    hot_pixels: int = 0
    hot_seed: int = 0
    lost: float = 0.05
    coma_px: float = 0.13
    coma_decentred: float = 0.0
    bent_deg: float = 0.0
    offset_px: tuple[float, ...] | FloatArray = (0.0, 0.0, 0.0)
    decentred_px: tuple[float, ...] | FloatArray = (0.0, 0.0)
    raised: Callable[[FloatArray], FloatArray] | None = None
    noise_factor: float = 1.0
    clock_s: float = 0.0


def detections(rng: np.random.Generator, camera: Camera, sky: NightSky, night: Night) -> tuple[Stars, list[str]]:
    """Return what a camera sees of a sky, the brightest first, and the name of each ("" for what is no star)."""
    zenith, azimuth = angles_from_direction(sky.directions)
    magnitude = sky.magnitude + 0.25 * (relative_air_mass(zenith) - 1.0)
    cloud_from = rng.uniform(0.0, 360.0)
    seen = (rng.uniform(size=len(sky)) > night.lost) & (zenith < 85.0)
    seen &= (azimuth - cloud_from) % 360.0 >= 360.0 * night.cloud_share
    sigma = night.sigma_px * 2.0 ** ((magnitude[seen] - 3.0) / 1.5)
    toward = _dated(sky.directions[seen], night.clock_s)
    toward = toward if night.raised is None else night.raised(toward)
    pixels = project(_bent(camera, night.bent_deg), toward)
    pixels = pixels + _coma(camera, pixels, night)
    pixels = pixels if night.field is None else pixels + night.field(pixels)
    flux = 10.0 ** (-0.4 * (magnitude[seen] + rng.normal(0.0, 0.2, sigma.size)))
    names = [str(name) for name in sky.names[seen]]
    pixels = pixels + night.noise_factor * sigma[:, None] * rng.standard_normal((sigma.size, 2))
    centre, radius = np.array(camera.principal_point_px), 1.4 * camera.focal_length_px[0]
    count = night.faint + night.hot_pixels
    angle, far = rng.uniform(0.0, 2.0 * np.pi, count), radius * np.sqrt(rng.uniform(size=count))
    sensor = np.random.default_rng(night.hot_seed)
    angle[night.faint :] = sensor.uniform(0.0, 2.0 * np.pi, night.hot_pixels)
    far[night.faint :] = radius * np.sqrt(sensor.uniform(size=night.hot_pixels))
    other = centre + far[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    light = 10.0 ** (-0.4 * np.r_[rng.uniform(5.5, 6.5, night.faint), rng.uniform(0.0, 5.0, night.hot_pixels)])
    for _ in range(night.satellites):
        begin, heading = centre + rng.uniform(-0.6, 0.6, 2) * radius, rng.uniform(0.0, 2.0 * np.pi)
        trail = begin + np.arange(5)[:, None] * 8.0 * np.array([np.cos(heading), np.sin(heading)])
        other, light = np.concatenate([other, trail]), np.r_[light, np.full(5, 10.0 ** (-0.4 * rng.uniform(1.0, 4.0)))]
    names += [""] * light.size
    every = np.concatenate([pixels, other])
    sigma = np.r_[sigma, np.full(light.size, 0.1)]
    order = np.argsort(-np.r_[flux, light], kind="stable")
    found = _stars(every, np.r_[flux, light], sigma)
    return found.select(order), [names[row] for row in order]


def _bent(camera: Camera, angle_deg: float) -> Camera:
    """Return the camera turned about an axis that the camera's own numbers choose."""
    axis = np.random.default_rng(int(1e3 * camera.focal_length_px[0])).standard_normal(3)
    turn = rotation_matrix(tuple(np.radians(angle_deg) * axis / np.linalg.norm(axis)))
    return replace(camera, rotation_cam_enu=rotation_vector(rotation_matrix(camera.rotation_cam_enu) @ turn))


def _dated(directions: FloatArray, late_s: float) -> FloatArray:
    """Return directions (n, 3) as they were so many seconds before, turned about the pole."""
    latitude = np.radians(pop.SGP.latitude)
    pole = np.array([0.0, np.cos(latitude), np.sin(latitude)])
    return np.asarray(directions @ rotation_matrix(tuple(7.292e-5 * late_s * pole)).T)


def _coma(camera: Camera, pixels: FloatArray, night: Night) -> FloatArray:
    """Return the displacement outwards (n, 2), px."""
    outwards = pixels - np.array(camera.principal_point_px)
    far = np.linalg.norm(outwards, axis=-1)
    edge = camera.focal_length_px[0] * ideal_radius(camera.projection, np.pi / 2)
    azimuth = np.arctan2(outwards[:, 1], outwards[:, 0])
    size = night.coma_px * (1.0 + night.coma_decentred * np.cos(azimuth - 1.0)) * (far / edge) ** 1.5
    size += (far / edge)[:, None] ** np.array([1, 2, 3]) @ np.asarray(night.offset_px)
    along = np.stack([np.cos(azimuth), np.sin(azimuth)], axis=-1)
    size += (far / edge) ** 2 * (along @ np.asarray(night.decentred_px))
    return np.asarray(size[:, None] * outwards / np.maximum(far, 1e-9)[:, None])


def _stars(pixels: FloatArray, flux: FloatArray, sigma: FloatArray) -> Stars:
    one = np.ones(flux.size)
    return Stars(
        pixels=pixels, sigma_px=sigma, flux=flux, snr=_SNR_OF_ONE * flux, peak_fraction=0.5 * one, width_px=1.2 * one,
        ellipticity=0.1 * one, saturated=one < 0.0,
    )  # fmt: skip


@functools.lru_cache(maxsize=64)
def sky_of(unix_s: float) -> NightSky:
    """Return the sky to V 5.5 at the site of the population."""
    return night_sky(unix_s, pop.SGP, faintest=5.5)


def predicted(calibration: Calibration, unix_s: float, *, within_px: float = 0.0) -> PredictedStars:
    """Return what a calibration predicts of that sky."""
    return predict_stars(calibration, sky_of(unix_s), within_px=within_px)


def with_camera(calibration: Calibration, camera: Camera) -> Calibration:
    """Return a calibration as sure of itself, of another camera."""
    return replace(calibration, camera=camera)


def is_right(names: list[str], stars: PredictedStars, star: NDArray[np.int64], row: NDArray[np.int64]) -> BoolArray:
    """Return which matches are right."""
    return np.array([names[r] == str(stars.names[s]) for s, r in zip(star, row, strict=True)], dtype=bool)
