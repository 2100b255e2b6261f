"""Compiles the kernels that the service needs for its first sighting, by detecting and merging drawn frames."""

from __future__ import annotations

import numpy as np

from sunarc.array_types import FloatArray, Image
from sunarc.detection import Expectation, Sensor, detect_sun
from sunarc.imaging import merge_hdr

_SIZE = 160
_SUN_RADIUS_PX = 9.0  # about the sun's through a fisheye of 2 megapixels
_CENTRE_PX = 81.3


def compile_kernels() -> None:
    """Detect a drawn sun in frames of 8 and 16 bit, and merge them.

    numba compiles a kernel for the types that it is called with and keeps it in its cache folder (NUMBA_CACHE_DIR),
    where the service finds it.
    """
    expected = Expectation(
        x_px=_CENTRE_PX + 0.5, y_px=_CENTRE_PX - 0.5, stretch_px_per_rad=((1500.0, 0.0), (0.0, 1500.0))
    )
    for full_scale in (255, 4095):
        sensor = Sensor(full_scale=full_scale, gain_e_per_count=10_000.0 / full_scale, black_level=0.01 * full_scale)
        drawn = _drawn_sun(full_scale)
        frame: Image = drawn.astype(np.uint8) if full_scale < 256 else drawn.astype(np.uint16)
        frame.flags.writeable = False  # as the camera's frames are, another type to numba
        for expectation in (None, expected):
            detect_sun(frame, sensor=sensor, expectation=expectation, exposure_us=20.0)
        merge_hdr([frame, frame], [10.0, 40.0], sensor=sensor)


def _drawn_sun(full_scale: int) -> FloatArray:
    y, x = np.mgrid[:_SIZE, :_SIZE]
    edge = np.clip(_SUN_RADIUS_PX + 0.5 - np.hypot(x - _CENTRE_PX, y - _CENTRE_PX), 0.0, 1.0)
    drawn: FloatArray = (0.01 + 0.6 * edge) * full_scale
    return drawn
