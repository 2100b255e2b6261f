from __future__ import annotations

import struct
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from tests.fixtures.command_line import sunarc

from sunarc.calibration.calibrate import calibrate
from sunarc.calibration.model.result import Calibration
from sunarc.calibration.model.sightings import Sightings
from sunarc.lab.simulation.truth import SGP, true_camera
from sunarc.optics.forward import project
from sunarc.sky.sun import sun_angles, sun_directions

__all__ = ["sunarc"]

IMAGE_SIZE = (1748, 1748)
MAY_13 = 1_368_424_800.0
"""2013-05-13 06:00 UTC: before sunrise at the site."""


PngSize = Callable[[Path], tuple[int, int]]


@pytest.fixture(scope="session")
def png_size() -> PngSize:
    """Read width and height from a PNG's own header."""

    def read(path: Path) -> tuple[int, int]:
        head = path.read_bytes()[:24]
        assert head[:8] == b"\x89PNG\r\n\x1a\n"
        width, height = struct.unpack(">II", head[16:24])
        return width, height

    return read


@pytest.fixture(scope="session")
def cloudy_points() -> Sightings:
    """Return a day, one sighting every four minutes, every tenth one 15 px off to the right."""
    times = MAY_13 + np.arange(0.0, 86_400.0, 240.0)
    times = times[sun_angles(times, SGP).apparent_zenith < 88.0]
    noise = np.random.default_rng(1).normal(0.0, 0.1, (times.size, 2))
    noise[::10, 0] += 15.0
    return Sightings.of(unix_s=times, pixels=project(true_camera(0), sun_directions(times, SGP)) + noise)


@pytest.fixture(scope="session")
def cloudy_fit(cloudy_points: Sightings) -> Calibration:
    return calibrate(cloudy_points, site=SGP, image_size=IMAGE_SIZE)
