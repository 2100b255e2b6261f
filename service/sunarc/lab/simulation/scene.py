"""The simulated sky, as a function of time and exposure."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from sunarc import _kernels
from sunarc.common.array_types import BoolArray, FloatArray, Image
from sunarc.detection.values import Bayer
from sunarc.lab.simulation import scene_parts
from sunarc.lab.simulation.night import NightLight
from sunarc.lab.simulation.options import Bump, SceneOptions, SensorModel, Weather
from sunarc.optics.camera import Camera
from sunarc.optics.forward import project
from sunarc.optics.pose import rotation_matrix, rotation_vector
from sunarc.sky.days import solar_date
from sunarc.sky.directions import direction_from_angles
from sunarc.sky.site import Site, clear_transmission
from sunarc.sky.sun import sun_angles

Region = tuple[int, int, int, int]

_NOISE_LENGTH = 1 << 20
_HEADROOM = 1.15  # a full well holds a little more than full scale, so that what is saturated stays so under noise
_GLARE_CORE_DEG = 0.5
_NIGHT_UP = math.sin(math.radians(-6.0))
"""The night's light is added while the sun is lower: before, the twilight is brighter by far."""
_MOON = 2.5e-6  # the full moon's brightness over the sun's


class Scene:
    """Sky of a site on a simulated sensor: the same time and exposure always give the same counts.

    Parameters
    ----------
    camera : the true camera.
    site : where it stands.
    options : the sky and the lens's imperfections.
    sensor : how light becomes counts.
    """

    def __init__(
        self,
        camera: Camera,
        site: Site,
        *,
        options: SceneOptions | None = None,
        sensor: SensorModel | None = None,
    ) -> None:
        self.camera = camera
        self.site = site
        self.options = options or SceneOptions()
        self.sensor = sensor or SensorModel()
        self._bumped: Scene | None = None
        self._field = scene_parts.pixel_field(
            camera, field_deg=self.options.field_deg, obstructions=self.options.obstructions
        )
        self._night = None
        if (night := self.options.night) is not None:
            obstructions = self.options.obstructions
            self._night = NightLight(camera, site, options=night, seed=self.options.seed, obstructions=obstructions)
        rng = np.random.default_rng([self.options.seed, 11])
        self._noise = rng.standard_normal(_NOISE_LENGTH + camera.width, dtype=np.float32)
        self._hot_at = rng.integers(0, [camera.width, camera.height], size=(self.sensor.hot_pixels, 2))
        self._hot_e = self.sensor.full_well_e * rng.uniform(0.05, 1.2, self.sensor.hot_pixels)
        self._hot_e_per_us = self.sensor.full_well_e * 10.0 ** rng.uniform(-6.0, -3.0, self.sensor.hot_pixels)

    def render(
        self,
        start_us: int,
        *,
        exposure_us: float,
        gain_db: float = 0.0,
        full_scale: int = 4095,
        region: Region | None = None,
        noise: bool = True,
        bayer: Bayer | None = None,
    ) -> Image:
        """Return the counts of one exposure.

        Parameters
        ----------
        start_us : start of the exposure, microseconds since 1970-01-01 UTC; everything stands where it is mid-way.
        exposure_us : its length.
        gain_db : amplification before the counts.
        full_scale : the largest count; 255 gives uint8, anything above uint16.
        region : x, y, width, height in px; None is the whole sensor.
        noise : False leaves photon, read noise and hot pixels out.
        bayer : colours of the sensor's top-left 2×2 pixels; None is mono.

        Returns
        -------
        (height, width) of the region.
        """
        if (after := self._bumped_scene(start_us * 1e-6)) is not None:
            return after.render(
                start_us,
                exposure_us=exposure_us,
                gain_db=gain_db,
                full_scale=full_scale,
                region=region,
                noise=noise,
                bayer=bayer,
            )
        region = region or (0, 0, self.camera.width, self.camera.height)
        light, smear = self._collect_light(start_us * 1e-6 + exposure_us * 0.5e-6, region, exposure_us, bayer)
        starts = np.zeros(region[3], dtype=np.int64)
        if noise:
            self._add_hot_pixels(light, region, exposure_us)
            key = [self.options.seed, start_us, round(exposure_us * 1000.0), region[0], region[1]]
            starts = np.random.default_rng(key).integers(0, _NOISE_LENGTH, region[3])
        factors = self._sensor_factors(exposure_us, gain_db=gain_db, full_scale=full_scale, noise=noise)
        counts = _kernels.count_light(light, smear, self._noise, starts, factors)
        return counts.astype(np.uint8) if full_scale == 255 else counts

    def sun_direction(self, unix_s: float) -> FloatArray:
        """Return the (3,) apparent direction of the sun."""
        angles = sun_angles(unix_s, self.site)
        return direction_from_angles(zenith_deg=angles.apparent_zenith, azimuth_deg=angles.azimuth)

    def sun_pixel(self, unix_s: float) -> FloatArray:
        """Return the (2,) pixel of the sun's centre; NaN where the lens does not see it."""
        after = self._bumped_scene(unix_s)
        return project(self.camera if after is None else after.camera, self.sun_direction(unix_s))

    def _bumped_scene(self, unix_s: float) -> Scene | None:
        """Return the scene as the camera sees it once it was bumped; None before, and where it never is."""
        bump = self.options.bump
        if bump is None or unix_s < bump.at.timestamp():
            return None
        if self._bumped is None:
            rotated = bumped_camera(self.camera, bump)
            self._bumped = Scene(rotated, self.site, options=replace(self.options, bump=None), sensor=self.sensor)
        return self._bumped

    def weather(self, unix_s: float) -> Weather:
        """Return the weather of the solar day of a moment."""
        day = solar_date(unix_s, longitude=self.site.longitude)
        return self.options.weather[(day - self.options.first_day).days % len(self.options.weather)]

    def sun_transmittance(self, unix_s: float) -> float:
        """Return how much of the sun's light clouds and obstructions let through, averaged over its disc."""
        layer = scene_parts.cloud_layer(self.weather(unix_s), seed=self.options.seed, unix_s=unix_s)
        sun = self.sun_direction(unix_s)
        points = scene_parts.disc_points(self.camera, sun, limb_darkening=self.options.limb_darkening)
        if points is None:
            return 0.0
        transmittance = self._compute_transmittance(points.direction_enu, layer) * self._is_uncovered(
            points.direction_enu, sun
        )
        return float(np.average(transmittance, weights=points.weight_px))

    def _collect_light(
        self, unix_s: float, region: Region, exposure_us: float, bayer: Bayer | None
    ) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Return `_compute_light` as the wells hold it: behind the mosaic, and run over."""
        x, y, width, height = region
        blooms = self.sensor.blooming > 0.0
        first_row, rows = (0, self.camera.height) if blooms else (y, height)  # charge comes from outside the region too
        light, smear = self._compute_light(unix_s, (x, first_row, width, rows), exposure_us)
        if bayer is not None:
            behind_mosaic(light, bayer, first=(x, first_row))
        if blooms:
            run_over(light, _HEADROOM / exposure_us, self.sensor.blooming)
            light = np.ascontiguousarray(light[y : y + height])
        return light, smear

    def _compute_light(
        self, unix_s: float, region: Region, exposure_us: float
    ) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Return the light of a region in full scales per microsecond, and its smear in electrons, (w,)."""
        sun = self.sun_direction(unix_s)
        layer = scene_parts.cloud_layer(self.weather(unix_s), seed=self.options.seed, unix_s=unix_s)
        x, y, width, height = region
        field = np.ascontiguousarray(self._field[y : y + height, x : x + width])
        smear = np.zeros(width, dtype=np.float32)
        stamps, share = self._make_sun_stamps(sun, layer)
        stamps += self._make_moon_stamps(layer)
        light = _kernels.sky_light(field, sun.astype(np.float32), self._compute_sky_levels(sun[2], share), *layer)
        if self._night is not None and sun[2] < _NIGHT_UP:
            well_e, part = self.sensor.full_well_e, scene_parts.RegionLight(light, field, (x, y))
            self._night.add(part, unix_s=unix_s, exposure_us=exposure_us, layer=layer, well_e=well_e)
        for stamp in stamps:
            add_stamp(light, stamp, (x, y))
            column_sum = stamp.values.sum(axis=0, keepdims=True) * self.sensor.smear_us_per_row
            add_stamp(smear[None, :], scene_parts.Stamp(stamp.x, 0, column_sum * self.sensor.full_well_e), (x, 0))
        return light, smear

    def _make_sun_stamps(self, sun: FloatArray, layer: scene_parts.CloudLayer) -> tuple[list[scene_parts.Stamp], float]:
        """Return the images of the sun's disc, and how much of its light comes through."""
        points = scene_parts.disc_points(self.camera, sun, limb_darkening=self.options.limb_darkening)
        if points is None:
            return [], 0.0
        transmittance = self._compute_transmittance(points.direction_enu, layer) * self._is_uncovered(
            points.direction_enu, sun
        )
        share = float(np.average(transmittance, weights=points.weight_px))
        if share <= 0.0:
            return [], 0.0
        weight = points.weight_px * transmittance * self._compute_disc_rate(sun[2])
        stamps = [scene_parts.make_stamp(points.pixel, weight, sigma_px=self.options.psf_sigma_px)]
        if self.options.ghost_strength > 0.0:
            opposite = 2.0 * np.array(self.camera.principal_point_px) - points.pixel
            stamps.append(
                scene_parts.make_stamp(
                    opposite, weight * self.options.ghost_strength, sigma_px=self.options.psf_sigma_px
                )
            )
        return stamps, share

    def _make_moon_stamps(self, layer: scene_parts.CloudLayer) -> list[scene_parts.Stamp]:
        """Return the image of the full moon, where there is one: even, and 400 000 times fainter than the sun."""
        if self.options.moon_at is None:
            return []
        zenith, azimuth = self.options.moon_at
        direction = direction_from_angles(zenith_deg=zenith, azimuth_deg=azimuth)
        points = scene_parts.disc_points(self.camera, direction, limb_darkening=0.0)
        if points is None:
            return []
        weight = (
            points.weight_px
            * self._compute_transmittance(points.direction_enu, layer)
            * self._compute_disc_rate(direction[2])
            * _MOON
        )
        return [scene_parts.make_stamp(points.pixel, weight, sigma_px=self.options.psf_sigma_px)]

    def _compute_transmittance(self, direction_enu: FloatArray, layer: scene_parts.CloudLayer) -> FloatArray:
        through = _kernels.cloud_transmittance(*layer, direction_enu.astype(np.float32))
        return np.where(scene_parts.is_blocked(direction_enu, self.options.obstructions), 0.0, through)

    def _is_uncovered(self, direction_enu: FloatArray, sun_enu: FloatArray) -> BoolArray:
        return ~scene_parts.is_covered(direction_enu, sun_enu, share=self.options.sun_cover)

    def _compute_disc_rate(self, sun_up: float) -> float:
        """Return full scales per microsecond in the middle of the disc, behind the air and the filter."""
        through = clear_transmission(90.0 - math.degrees(math.asin(sun_up)))
        return self.options.sun_rate * self.options.nd_transmission * through

    def _compute_sky_levels(self, sun_up: float, share: float) -> NDArray[np.float32]:
        """Return the levels of `sky_light` in full scales per microsecond."""
        disc = self.options.sun_rate * self.options.nd_transmission
        core = math.radians(_GLARE_CORE_DEG) ** 2
        below_deg = max(-math.degrees(math.asin(sun_up)), 0.0)
        day = max(sun_up, 0.0) ** 0.7 + 0.03 * math.exp(-below_deg / 2.0)
        zenith = disc * self.options.sky_strength * day
        glare = self._compute_disc_rate(sun_up) * share * self.options.glare_strength * math.radians(1.0) ** 2
        return np.array([zenith, 2.5 * zenith, 0.4 * zenith, glare, core, 0.4 * zenith], dtype=np.float32)

    def _sensor_factors(
        self, exposure_us: float, *, gain_db: float, full_scale: int, noise: bool
    ) -> NDArray[np.float32]:
        well = self.sensor.full_well_e
        black = self.sensor.black_level * full_scale
        per_electron = (full_scale - black) / well * 10.0 ** (gain_db / 20.0)
        read_square = self.sensor.read_noise_e**2 if noise else -1.0
        return np.array(
            [well * exposure_us, well * _HEADROOM, read_square, per_electron, black, full_scale], dtype=np.float32
        )

    def _add_hot_pixels(self, light: NDArray[np.float32], region: Region, exposure_us: float) -> None:
        x, y = (self._hot_at - np.array(region[:2])).T
        inside = (x >= 0) & (y >= 0) & (x < region[2]) & (y < region[3])
        electrons = self._hot_e + self._hot_e_per_us * exposure_us
        light[y[inside], x[inside]] += electrons[inside] / (self.sensor.full_well_e * exposure_us)


def bumped_camera(camera: Camera, bump: Bump) -> Camera:
    """Return the camera after a bump."""
    back = rotation_matrix(tuple(-math.radians(angle) for angle in bump.turn_deg))
    return replace(camera, rotation_cam_enu=rotation_vector(rotation_matrix(camera.rotation_cam_enu) @ back))


def add_stamp(image: NDArray[np.float32], stamp: scene_parts.Stamp, origin: tuple[int, int]) -> None:
    """Add a stamp to an image whose first pixel is `origin` of the sensor, where they overlap."""
    x, y = stamp.x - origin[0], stamp.y - origin[1]
    height, width = stamp.values.shape
    left, top = max(x, 0), max(y, 0)
    right, bottom = min(x + width, image.shape[1]), min(y + height, image.shape[0])
    if left < right and top < bottom:
        image[top:bottom, left:right] += stamp.values[top - y : bottom - y, left - x : right - x].astype(np.float32)


# What a sensor does to light before it is counted: a mosaic of colours, and wells that run over.

_TRANSMISSION = {"R": 0.6, "G": 1.0, "B": 0.7}  # of white light, of the most sensitive colour's


def behind_mosaic(light: NDArray[np.float32], bayer: Bayer, *, first: tuple[int, int]) -> None:
    """Multiply each pixel by its colour filter; `first` is the sensor's column and row of the first pixel."""
    for k, letter in enumerate(bayer):
        row, column = (k // 2 - first[1]) % 2, (k % 2 - first[0]) % 2
        light[row::2, column::2] *= _TRANSMISSION[letter]


def run_over(light: NDArray[np.float32], most: float, share: float) -> None:
    """Spread the surplus of a full well along its column, half up and half down, until wells with room take it.

    Parameters
    ----------
    light : (h, w), changed in place; what exceeds `most` stays as it is (it is cut off when counted).
    most : light that fills a well.
    share : of the excess that runs; the rest is drained.
    """
    columns = np.flatnonzero((light > most).any(axis=0))
    for way in (slice(None), slice(None, None, -1)):
        room = most - light[way, columns].astype(np.float64)
        level = np.cumsum(np.where(room < 0.0, -0.5 * share, -1.0) * room, axis=0)
        # what runs is never less than nothing: as the water in a tank, it is the level above its lowest so far
        carried = level - np.minimum(np.minimum.accumulate(level, axis=0), 0.0)
        before = np.concatenate([np.zeros((1, columns.size)), carried[:-1]])
        light[way, columns] += np.minimum(np.maximum(room, 0.0), before).astype(np.float32)
