"""Settings that no camera could be opened with are refused, each by its name."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from sunarc.common.errors import InputError
from sunarc.imager.cameras.frame import largest_count
from sunarc.imager.cameras.options import AravisOptions, ReplayOptions


@pytest.mark.parametrize(
    ("wrong", "field"),
    [
        ({"address": "sky-camera.example"}, "address"),
        ({"address": ""}, "address"),
        ({"pixel_format": "RGB8"}, "pixel_format"),
        ({"packet_size": 100}, "packet_size"),
        ({"gain_db": float("nan")}, "gain_db"),
        ({"answer_timeout_s": 0.0}, "answer_timeout_s"),
        ({"region": (0, 0, 0, 10)}, "region"),
        ({"region": (-1, 0, 10, 10)}, "region"),
        ({"timestamps": "gps"}, "timestamps"),
        ({"timestamp_scale": "gps"}, "timestamp_scale"),
        ({"timestamp_offset_s": 3601.0}, "timestamp_offset_s"),
        ({"timestamp_offset_s": float("nan")}, "timestamp_offset_s"),
    ],
)
def test_wrong_settings_are_refused(wrong: dict[str, Any], field: str) -> None:
    with pytest.raises(InputError) as caught:
        AravisOptions(**{"address": "192.0.2.7", **wrong})
    assert caught.value.field == f"camera.{field}"


def test_wrong_replays_are_refused() -> None:
    with pytest.raises(InputError, match="exposure_us"):
        ReplayOptions(folder=Path(), exposure_us=0.0)
    with pytest.raises(InputError, match="pixel_format"):
        ReplayOptions(folder=Path(), pixel_format="Mono9")


@pytest.mark.parametrize(
    ("pixel_format", "full_scale"),
    [("Mono8", 255), ("Mono10", 1023), ("BayerRG12", 4095), ("Mono14", 16_383), ("BayerGB16", 65_535)],
)
def test_full_scale_is_that_of_the_depth(pixel_format: str, full_scale: int) -> None:
    assert largest_count(pixel_format) == full_scale
