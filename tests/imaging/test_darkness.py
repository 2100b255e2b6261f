"""A black frame is told from every sky, by day and by any camera."""

from __future__ import annotations

from datetime import UTC, datetime

import numpy as np
import pytest

from sunarc.imaging.brightness import is_dark
from sunarc.lab.simulation.options import SceneOptions, SensorModel, Weather
from sunarc.lab.simulation.scene import Scene
from sunarc.lab.simulation.truth import SGP, true_camera

DAY = datetime(2013, 5, 13, tzinfo=UTC).timestamp()


@pytest.mark.parametrize("full_scale", [255, 4095, 65535])
@pytest.mark.parametrize("black", [0.0, 0.01, 0.1])
def test_noise_about_a_black_level_is_dark(full_scale: int, black: float) -> None:
    rng = np.random.default_rng(1)
    counts = rng.normal(black * full_scale, max(0.01 * full_scale, 0.5), (480, 640)).clip(0, full_scale)
    image = counts.astype(np.uint8) if full_scale == 255 else counts.astype(np.uint16)
    image[rng.integers(0, 480, 50), rng.integers(0, 640, 50)] = full_scale  # hot pixels
    assert is_dark(image, full_scale=full_scale)


@pytest.mark.parametrize("weather", ["clear", "overcast", "broken"])
@pytest.mark.parametrize("hour", [12.6, 18.5])  # the sun at 80 and at 20 degrees from the zenith
def test_no_sky_by_day_is_dark(weather: Weather, hour: float) -> None:
    scene = Scene(true_camera(), SGP, options=SceneOptions(weather=(weather,)), sensor=SensorModel())
    image = scene.render(round((DAY + 3600.0 * hour) * 1e6), exposure_us=3000.0)
    assert not is_dark(image, full_scale=4095)


def test_a_sun_behind_a_dense_filter_is_no_darkness() -> None:
    image = np.full((480, 640), 30, dtype=np.uint16)
    image[200:206, 300:306] = 4095
    assert not is_dark(image, full_scale=4095)


def test_a_flat_bright_frame_is_not_dark_and_a_tiny_one_tells_nothing() -> None:
    assert not is_dark(np.full((480, 640), 4095, dtype=np.uint16), full_scale=4095)
    assert not is_dark(np.zeros((6, 8), dtype=np.uint16), full_scale=4095)
