"""How long a look takes (run with --benchmark-enable; never a gate)."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from tests.detection.photographs import sky
from tests.detection.rendering import Image, Scene, equisolid_stretch, render

from sunarc.detection.disc.detect import detect_sun
from sunarc.detection.photo.urquhart2016 import locate, split_planes
from sunarc.detection.values import Expectation, Sensor


@pytest.fixture(scope="module", params=[0.7, 30.0], ids=["unsaturated", "saturated"])
def frame(request: pytest.FixtureRequest) -> tuple[Scene, Image]:
    scene = Scene(shape=(2048, 2048), x=1200.3, y=900.7, stretch=equisolid_stretch(), peak=request.param, black=40.0)
    return scene, render(scene, np.random.default_rng(0))


@pytest.mark.parametrize("asked", [True, False])
def test_a_2048_frame(benchmark: Any, frame: tuple[Scene, Image], asked: bool) -> None:  # noqa: ANN401, FBT001 - the plugin's own type; parametrised
    scene, image = frame
    sensor = Sensor(full_scale=4095, gain_e_per_count=20_000.0 / 4095, black_level=40.0)
    expectation = Expectation(x_px=1201.0, y_px=900.0, uncertainty_px=2.0, stretch_px_per_rad=scene.stretch)
    found = benchmark(detect_sun, image, sensor=sensor, expectation=expectation if asked else None)
    assert found.accepted


@pytest.mark.parametrize("full_image", [False, True])
def test_the_papers_estimators_on_a_1748_colour_image(benchmark: Any, full_image: bool) -> None:  # noqa: ANN401, FBT001 - as above
    image = sky(x=1100.0, y=700.0, radius=25.0, size=1748)

    def look() -> Any:  # noqa: ANN401 - handed on
        return locate(split_planes(image, full_scale=4095), apparent_zenith=0.8, full_image=full_image)

    assert benchmark.pedantic(look, rounds=3 if full_image else 10).position == pytest.approx((1100.0, 700.0), abs=1.5)
