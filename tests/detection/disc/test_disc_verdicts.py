"""What is believed and what is not."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from tests.detection.rendering import Scene, equisolid_stretch, read_out, render
from tests.detection.sunless import KINDS, accepted_of
from tests.fixtures.finding_codes import codes

from sunarc.common.errors import InputError
from sunarc.detection.disc.detect import detect_sun
from sunarc.detection.values import Detection, DiscOptions, Expectation, Sensor

SENSOR = Sensor.from_full_well(full_scale=4095)
STRETCH = equisolid_stretch()


def looked(scene: Scene, rng: np.random.Generator, cover: np.ndarray | None = None, **known: float) -> Detection:
    expectation = Expectation(x_px=24.0, y_px=24.0, uncertainty_px=1.0, stretch_px_per_rad=scene.stretch, **known)
    return detect_sun(render(scene, rng, cover), sensor=SENSOR, expectation=expectation)


@pytest.mark.parametrize("peak", [0.5, 0.9, 3.0, 10.0])
def test_partly_covered_discs_that_mislead_are_refused(peak: float) -> None:
    rng, misleading, refused = np.random.default_rng(1), 0, 0
    for _ in range(70):
        angle = rng.uniform(0, 2 * math.pi)
        edge = [math.cos(angle), math.sin(angle), rng.uniform(-1, 1), 10 ** rng.uniform(-2, 0.5), rng.uniform(0, 0.5)]
        x, y = 24 + rng.uniform(-1, 1, 2)
        found = looked(Scene(stretch=STRETCH, x=x, y=y, peak=peak), rng, np.array(edge))
        if found.x_px is None or found.y_px is None:
            continue
        if math.hypot(found.x_px - x, found.y_px - y) > 0.1:
            misleading += 1
            refused += not found.accepted
    assert misleading > 25
    assert refused / misleading >= 0.95


def test_clear_discs_are_rarely_refused() -> None:
    rng = np.random.default_rng(2)
    peaks = 10 ** rng.uniform(-1, 2, 200)
    refused = sum(not looked(Scene(stretch=STRETCH, x=24.3, peak=float(peak)), rng).accepted for peak in peaks)
    assert refused <= 2


@pytest.mark.parametrize("kind", KINDS)
def test_no_sun_is_found_where_there_is_none(kind: str) -> None:
    rng = np.random.default_rng(3)
    assert not any(any(accepted_of(kind, rng)) for _ in range(25))


def test_a_sun_as_faint_as_a_moon_is_believed_where_a_filter_is_told_of() -> None:
    image, exposure_us = render(Scene(stretch=STRETCH), np.random.default_rng(0)), 30_000.0
    behind_filter = DiscOptions(clear_level_per_us=3e-5)
    aware = detect_sun(image, sensor=SENSOR, options=behind_filter, exposure_us=exposure_us)
    unaware = detect_sun(image, sensor=SENSOR, exposure_us=exposure_us)
    assert (aware.accepted, unaware.accepted, unaware.verdict) == (True, False, "hidden")
    assert codes(unaware.findings) == ["disc_below_faintest"]


@pytest.mark.parametrize("level", [0, 4095])
@pytest.mark.parametrize("asked", [True, False])
def test_an_image_of_one_level_holds_no_sun(level: int, asked: bool) -> None:  # noqa: FBT001 - parametrised
    image = np.full((64, 64), level, np.uint16)
    expectation = Expectation(x_px=30.0, y_px=30.0, stretch_px_per_rad=STRETCH) if asked else None
    found = detect_sun(image, sensor=SENSOR, expectation=expectation)
    assert not found.accepted
    assert found.x_px is None


def test_a_dimmed_disc_is_veiled_but_believed() -> None:
    found = looked(Scene(stretch=STRETCH, peak=0.3), np.random.default_rng(5), clear_peak_fraction=1.0)
    assert found.verdict == "veiled"
    assert found.accepted


def test_a_sun_below_the_limit_is_not_looked_for() -> None:
    found = looked(Scene(stretch=STRETCH), np.random.default_rng(5), apparent_zenith=math.radians(89.9))
    assert found.verdict == "below_horizon"


def test_a_disc_far_from_the_expectation_is_no_sun() -> None:
    scene = Scene(stretch=STRETCH, x=32.5)
    expectation = Expectation(x_px=24.0, y_px=24.0, uncertainty_px=0.3, stretch_px_per_rad=STRETCH)
    found = detect_sun(render(scene, np.random.default_rng(6)), sensor=SENSOR, expectation=expectation)
    assert not found.accepted


def test_of_two_like_discs_none_is_believed() -> None:
    rng = np.random.default_rng(7)
    one = Scene(shape=(160, 160), x=40.0, y=40.0, stretch=STRETCH)
    both = read_out(render_light(one) + render_light(replace(one, x=120.0, y=118.0)), one, rng)
    found = detect_sun(both, sensor=SENSOR)
    assert (found.verdict, found.accepted) == ("reflection", False)


def render_light(scene: Scene) -> np.ndarray:
    from tests.detection.rendering import disc_image  # noqa: PLC0415 - only here

    return np.asarray(scene.peak * disc_image(scene))


@pytest.mark.parametrize("shape", [(64, 64, 3), (0, 4), (4,)])
def test_an_array_that_is_no_raw_plane_is_refused(shape: tuple[int, ...]) -> None:
    with pytest.raises(InputError, match="shape"):
        detect_sun(np.zeros(shape, np.uint16), sensor=SENSOR)


def test_eight_bits_cannot_be_twelve() -> None:
    with pytest.raises(InputError, match="full_scale"):
        detect_sun(np.zeros((8, 8), np.uint8), sensor=SENSOR)


def test_a_sun_outside_the_image_is_hidden() -> None:
    expectation = Expectation(x_px=-40.0, y_px=5.0, stretch_px_per_rad=STRETCH)
    found = detect_sun(np.zeros((64, 64), np.uint16), sensor=SENSOR, expectation=expectation)
    assert codes(found.findings) == ["sun_outside_image"]
