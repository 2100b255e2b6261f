"""Frames are held to their stated exposures by their brightness (the scene is drawn here, not by the simulator)."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from sunarc.imaging.brightness import Exposed, light_ratio_contradiction

FULL_SCALE, BLACK = 4095, 60.0
SIZE = 300


def sky(seed: int = 0) -> NDArray[np.float64]:
    """Return counts per microsecond: a smooth sky in a dark frame, an aureole about a saturated sun."""
    y, x = np.mgrid[:SIZE, :SIZE]
    inside = np.hypot(x - 150, y - 150) < 140
    sun = np.hypot(x - 190, y - 120)
    rate: NDArray[np.float64] = inside * (0.04 + 0.0001 * y + 30.0 / (3.0 + sun) ** 2)
    rate[sun < 3.0] = 3000.0
    hot = np.random.default_rng(seed).integers(0, SIZE, (30, 2))
    rate[hot[:, 0], hot[:, 1]] = 10.0
    return rate


def exposed(said_us: float, *, truly_us: float | None = None, scene: NDArray[np.float64] | None = None) -> Exposed:
    rng = np.random.default_rng(int(said_us))
    light = (sky() if scene is None else scene) * (truly_us or said_us)
    counts = BLACK + rng.poisson(np.minimum(light, 1e6)) + rng.normal(0.0, 2.0, light.shape)
    image = np.clip(np.round(counts), 0, FULL_SCALE).astype(np.uint16)
    return Exposed(image=image, exposure_us=said_us, full_scale=FULL_SCALE)


@pytest.mark.parametrize(("first_us", "second_us"), [(3e3, 12e3), (12e3, 48e3), (12e3, 3e3), (3e3, 20.0), (3e3, 2.0)])
def test_frames_that_had_their_exposures_agree(first_us: float, second_us: float) -> None:
    assert light_ratio_contradiction(exposed(first_us), exposed(second_us)) is None


@pytest.mark.parametrize(
    ("first_us", "second_us", "truly_us"),
    [
        (3e3, 12e3, 3e3),  # the exposure before
        (3e3, 12e3, 48e3),  # the one after
        (12e3, 48e3, 192e3),  # all of the sky saturated
        (48e3, 12e3, 48e3),
        (3e3, 20.0, 3e3),
        (3e3, 20.0, 48e3),
        (3e3, 40.0, 160.0),
    ],
)
def test_a_frame_with_another_s_exposure_is_found_out(first_us: float, second_us: float, truly_us: float) -> None:
    told = light_ratio_contradiction(exposed(first_us), exposed(second_us, truly_us=truly_us))
    assert told is not None
    assert f"{min(first_us, second_us):g} µs shows" in told


def test_a_gamma_that_was_switched_on_is_found_out() -> None:
    curved = [
        Exposed(
            image=(FULL_SCALE * (frame.image / FULL_SCALE) ** 0.45).astype(np.uint16),
            exposure_us=frame.exposure_us,
            full_scale=FULL_SCALE,
        )
        for frame in (exposed(3e3), exposed(12e3))
    ]
    assert light_ratio_contradiction(*curved) is not None


def test_a_fog_without_contrast_and_a_night_tell_nothing() -> None:
    fog, night = np.full((SIZE, SIZE), 0.05), np.zeros((SIZE, SIZE))
    for scene in (fog, night):
        assert light_ratio_contradiction(exposed(3e3, scene=scene), exposed(12e3, truly_us=48e3, scene=scene)) is None


def test_two_frames_that_are_saturated_all_over_tell_nothing() -> None:
    bright = np.full((SIZE, SIZE), 100.0)
    assert light_ratio_contradiction(exposed(3e3, scene=bright), exposed(12e3, scene=bright)) is None


def test_a_sensor_that_exposes_some_microseconds_longer_than_it_says_is_believed() -> None:
    assert light_ratio_contradiction(exposed(3e3), exposed(10.0, truly_us=20.0)) is None


def test_eight_bits_are_judged_as_well() -> None:
    def eight(frame: Exposed) -> Exposed:
        return Exposed(image=(frame.image >> 4).astype(np.uint8), exposure_us=frame.exposure_us, full_scale=255)

    assert light_ratio_contradiction(eight(exposed(3e3)), eight(exposed(12e3))) is None
    assert light_ratio_contradiction(eight(exposed(3e3)), eight(exposed(12e3, truly_us=3e3))) is not None
