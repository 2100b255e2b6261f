"""Input of the detectors: bounds of sensors, predictions and options."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from sunarc.common.array_types import Image
from sunarc.common.errors import InputError
from sunarc.detection.values import DiscOptions, Expectation, Sensor, bayer_pattern, require_raw

STRETCH = ((565.0, 0.0), (0.0, 640.0))


@pytest.mark.parametrize(
    "changes",
    [
        {"binning": 0},
        {"binning": -1},
        {"gain_e_per_count": 0.0},
        {"gain_e_per_count": -1.0},
        {"gain_e_per_count": math.nan},
        {"read_noise_e": -0.1},
        {"read_noise_e": math.inf},
        {"black_level": -0.1},
        {"black_level": 255.0},
        {"black_level": math.nan},
        {"full_scale": 65536},
    ],
)
def test_a_sensor_that_does_not_exist_is_refused(changes: dict[str, Any]) -> None:
    with pytest.raises(InputError) as error:
        Sensor(**({"full_scale": 255, "gain_e_per_count": 80.0} | changes))
    assert error.value.field == "sensor"


@pytest.mark.parametrize(
    "changes",
    [{"binning": 1}, {"read_noise_e": 0.0}, {"black_level": 0.0}, {"black_level": 254.9}, {"full_scale": 65535}],
)
def test_a_sensor_at_its_limits_is_taken(changes: dict[str, Any]) -> None:
    assert Sensor(**({"full_scale": 255, "gain_e_per_count": 80.0} | changes)).bayer is None


def test_the_gain_of_a_full_well() -> None:
    sensor = Sensor.from_full_well(full_scale=4095, full_well_e=8190.0, bayer="GRBG")
    assert (sensor.full_scale, sensor.gain_e_per_count, sensor.bayer) == (4095, 2.0, "GRBG")
    assert Sensor.from_full_well(full_scale=1000).gain_e_per_count == 20.0


@pytest.mark.parametrize(
    "changes",
    [
        {"x_px": math.nan},
        {"y_px": math.inf},
        {"uncertainty_px": math.nan},
        {"uncertainty_px": -0.1},
        {"stretch_px_per_rad": ((565.0, math.nan), (0.0, 640.0))},
        {"stretch_px_per_rad": ((565.0, 0.0), (math.inf, 640.0))},
    ],
)
def test_a_prediction_that_is_not_finite_is_refused(changes: dict[str, Any]) -> None:
    with pytest.raises(InputError) as error:
        Expectation(**({"x_px": 5.0, "y_px": 6.0} | changes))
    assert error.value.field == "expectation"


def test_a_prediction_may_be_certain_and_beyond_the_image() -> None:
    assert Expectation(x_px=-5.0, y_px=1e6, uncertainty_px=0.0, stretch_px_per_rad=STRETCH).uncertainty_px == 0.0


@pytest.mark.parametrize(
    ("pixel_format", "bayer"),
    [
        ("BayerRG8", "RGGB"),
        ("BayerBG12Packed", "BGGR"),
        ("BayerGR10", "GRBG"),
        ("BayerGB16", "GBRG"),
        ("BayerXX8", None),
        ("Mono8", None),
        ("Mono12Packed", None),
        ("", None),
    ],
)
def test_colours_of_a_pixel_format(pixel_format: str, bayer: str | None) -> None:
    assert bayer_pattern(pixel_format) == bayer


@pytest.mark.parametrize("value", [-1.0, 1.1e6, math.nan, math.inf])
def test_a_clear_level_is_finite_and_not_negative(value: float) -> None:
    with pytest.raises(InputError):
        DiscOptions(clear_level_per_us=value)


@pytest.mark.parametrize(
    ("image", "full_scale"),
    [
        (np.zeros((4, 4, 3), np.uint8), 255),
        (np.zeros(16, np.uint8), 255),
        (np.zeros((0, 4), np.uint8), 255),
        (np.zeros((4, 4), np.float32), 255),
        (np.zeros((4, 4), np.int16), 255),
        (np.zeros((4, 4), np.uint8), 256),
    ],
)
def test_an_array_that_is_no_raw_frame_is_refused(image: Any, full_scale: int) -> None:  # noqa: ANN401 - no image
    with pytest.raises(InputError) as error:
        require_raw(image, Sensor.from_full_well(full_scale=full_scale))
    assert error.value.field == "image"


@pytest.mark.parametrize(
    ("image", "full_scale"),
    [(np.zeros((1, 1), np.uint8), 255), (np.zeros((1, 1), np.uint16), 255), (np.zeros((1, 1), np.uint16), 65535)],
)
def test_eight_and_sixteen_bits_are_raw_frames(image: Image, full_scale: int) -> None:
    require_raw(image, Sensor.from_full_well(full_scale=full_scale))


def test_a_sensor_of_which_nothing_else_is_known_is_black_mono_and_not_binned() -> None:
    sensor = Sensor(full_scale=4095, gain_e_per_count=5.0)
    assert (sensor.black_level, sensor.bayer, sensor.blooming, sensor.binning) == (0.0, None, False, 1)


def test_a_prediction_without_a_stated_uncertainty_has_two_pixels() -> None:
    assert Expectation(x_px=5.0, y_px=6.0).uncertainty_px == 2.0
