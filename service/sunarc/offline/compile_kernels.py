"""Compiles the kernels that the service needs, by its own work on drawn frames and on sightings of a made day."""

from __future__ import annotations

from dataclasses import replace
from typing import get_args

import numpy as np

from sunarc.array_types import FloatArray, Image, stacked
from sunarc.calibration.answers.covariance import hemisphere
from sunarc.calibration.answers.direction_table import lookup
from sunarc.calibration.calibrate import calibrate
from sunarc.calibration.model.options import CalibrationOptions, Method
from sunarc.calibration.model.sightings import Kind, Sightings
from sunarc.detection.disc.detect import detect_sun
from sunarc.detection.values import Expectation, Sensor
from sunarc.imaging.hdr import merge_hdr
from sunarc.optics.camera import Camera
from sunarc.optics.forward import project
from sunarc.sky.site import Site
from sunarc.sky.sun import sun_angles, sun_directions

_SIZE = 160
_SUN_RADIUS_PX = 9.0  # about the sun's through a fisheye of 2 megapixels
CENTRE_PX = 81.3

_SITE = Site(latitude=36.6, longitude=0.0, altitude=318.0)
_DAY = 1_368_403_200.0  # 13 May 2013, 0 h UTC; any day would do
_CADENCE_S = 600.0
_NOISE_PX = 0.05
_STARS = 60
_FIELD_PX, _FIELD_LENGTH_PX = 1.0, 150.0  # of a field that the sightings prove
_CAMERA = Camera(
    width=1024,
    height=1024,
    projection="equisolid",
    focal_length_px=(350.0, 350.0),
    principal_point_px=(512.0, 510.0),
    rotation_cam_enu=(0.01, -0.02, 0.8),
)


def compile_kernels(*, first_sighting_alone: bool = False) -> None:
    """Detect drawn suns and merge their frames; fit made sightings by each method, of a day, and of a night with it.

    numba compiles a kernel for the types that it is called with and keeps it in its cache folder (NUMBA_CACHE_DIR),
    where the service finds it.

    Parameters
    ----------
    first_sighting_alone : compile no kernel of the fit, whose turn comes in the first night.
    """
    _sight()
    if not first_sighting_alone:
        _fit()


def _sight() -> None:
    """Detect a drawn sun in frames of 8 and 16 bit, and merge them."""
    expected = Expectation(
        x_px=CENTRE_PX + 0.5, y_px=CENTRE_PX - 0.5, stretch_px_per_rad=((1500.0, 0.0), (0.0, 1500.0))
    )
    for full_scale in (255, 4095):
        sensor = Sensor(full_scale=full_scale, gain_e_per_count=10_000.0 / full_scale, black_level=0.01 * full_scale)
        drawn = drawn_sun(full_scale)
        frame: Image = drawn.astype(np.uint8) if full_scale < 256 else drawn.astype(np.uint16)
        frame.flags.writeable = False  # as the camera's frames are, another type to numba
        for expectation in (None, expected):
            detect_sun(frame, sensor=sensor, expectation=expectation, exposure_us=20.0)
        merge_hdr([frame, frame], [10.0, 40.0], sensor=sensor)


def drawn_sun(full_scale: int) -> FloatArray:
    """Return an image with a disc as the sun's."""
    y, x = np.mgrid[:_SIZE, :_SIZE]
    edge = np.clip(_SUN_RADIUS_PX + 0.5 - np.hypot(x - CENTRE_PX, y - CENTRE_PX), 0.0, 1.0)
    drawn: FloatArray = (0.01 + 0.6 * edge) * full_scale
    return drawn


def _fit() -> None:
    """Fit the sightings of a day by each method, and with those of a night; answer by fits without and with a field."""
    day, night = _made_day(), _made_night()
    size = (_CAMERA.width, _CAMERA.height)
    for method in get_args(Method):
        calibrate(day, site=_SITE, image_size=size, options=CalibrationOptions(method=method))
    both = stacked([day, night])
    through_field = replace(both, pixels=both.pixels + _FIELD_PX * np.sin(both.pixels / _FIELD_LENGTH_PX))
    for points in (both, through_field):
        ready = lookup(calibrate(points, site=_SITE, image_size=size))
        for directions, pixels in ((night.directions, night.pixels), (night.directions.copy(), night.pixels.copy())):
            ready.project(directions)  # read-only, and not: another type to numba
            ready.back_project(pixels)


def _made_day() -> Sightings:
    times = _DAY + np.arange(0.0, 86_400.0, _CADENCE_S)
    times = times[sun_angles(times, _SITE).apparent_zenith < 85.0]
    return Sightings.of(unix_s=times, pixels=_seen(sun_directions(times, _SITE)))


def _made_night() -> Sightings:
    stars = hemisphere(_STARS)
    return Sightings.of(
        unix_s=_DAY + 86_400.0 + 60.0 * np.arange(len(stars), dtype=np.float64),
        pixels=_seen(stars),
        directions=stars,
        kind=np.full(len(stars), Kind.STAR),
    )


def _seen(directions: FloatArray) -> FloatArray:
    """Return where the camera shows directions (n, 3), with some noise: without any, a fit has no scale."""
    pixels = project(_CAMERA, directions)
    return pixels + np.random.default_rng(0).normal(0.0, _NOISE_PX, pixels.shape)
