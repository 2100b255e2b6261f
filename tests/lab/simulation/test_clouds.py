"""Clouds are the same for everyone, move with the wind, and do to the sun what their name says."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from sunarc import _kernels
from sunarc.lab.simulation.options import SceneOptions, Weather
from sunarc.lab.simulation.scene import Scene
from sunarc.lab.simulation.scene_parts import cloud_layer
from sunarc.lab.simulation.truth import SGP, true_camera

TINY = replace(true_camera(), width=8, height=8)  # where the sun falls does not matter here
NOON_S = 1_368_469_800.0  # 2013-05-13 18:30 UTC


def transmittances(weather: Weather, seed: int = 0) -> list[float]:
    scene = Scene(TINY, SGP, options=SceneOptions(weather=(weather,), seed=seed))
    return [scene.sun_transmittance(NOON_S + 30.0 * i) for i in range(120)]


def test_a_clear_sky_lets_everything_through_and_an_overcast_one_nothing() -> None:
    assert min(transmittances("clear")) == 1.0
    assert max(transmittances("overcast")) < 1e-3


def test_broken_clouds_show_hide_and_partly_cover_the_sun() -> None:
    seen = np.array(transmittances("broken"))
    assert 0.2 < np.mean(seen > 0.9) < 0.8
    assert np.mean(seen < 0.05) > 0.1
    assert np.any((seen > 0.1) & (seen < 0.9))


def test_a_veil_dims_the_sun_and_never_hides_it() -> None:
    seen = np.array(transmittances("veil"))
    assert seen.min() > 0.15
    assert 0.3 < np.median(seen) < 0.8


def test_the_layer_moves_with_the_wind_as_a_whole() -> None:
    first = cloud_layer("broken", seed=3, unix_s=NOON_S)
    later = cloud_layer("broken", seed=3, unix_s=NOON_S + 100.0)
    assert first.transmittance is later.transmittance
    assert (later.offset_x - first.offset_x) % 1024 == pytest.approx(130.0, abs=0.01)
    assert (later.offset_y - first.offset_y) % 1024 == pytest.approx(37.0, abs=0.01)


def test_below_the_horizon_there_are_no_clouds() -> None:
    layer = cloud_layer("overcast", seed=0, unix_s=NOON_S)
    assert _kernels.cloud_transmittance(*layer, np.array([[1.0, 0.0, -0.1]], np.float32)) == 1.0


def test_the_weather_changes_with_the_solar_day() -> None:
    scene = Scene(TINY, SGP, options=SceneOptions(weather=("clear", "overcast", "broken")))
    days = [scene.weather(NOON_S + 86_400.0 * i) for i in range(5)]
    assert days == ["clear", "overcast", "broken", "clear", "overcast"]
