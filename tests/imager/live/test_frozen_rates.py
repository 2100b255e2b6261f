"""Few camera-days of `frozen_rates`: no living camera has an alarm, and the faults that last are found."""

from __future__ import annotations

import numpy as np
import pytest
from tests.imager.live.frozen_rates import LIVE, Camera, codes_of, drawn

SEED = 1


def cameras(kind: str, n: int) -> list[Camera]:
    rng = np.random.default_rng(SEED)
    return [drawn(kind, rng) for _ in range(n)]


@pytest.mark.parametrize("kind", LIVE)
def test_a_living_camera_has_no_alarm(kind: str) -> None:
    noiseless = Camera(kind, noise=0.0, quality=75, exposes=True, clock=True, seed=SEED)
    assert [codes_of(camera) for camera in [noiseless, *cameras(kind, 1)]] == [set(), set()]


@pytest.mark.parametrize(
    "camera",
    [
        Camera("fog", noise=0.0, quality=92, exposes=False, clock=False, seed=1429229876),  # light that changes slowly
        Camera("lamp", noise=0.0, quality=40, exposes=True, clock=True, seed=703689775),  # a sun that does not move
    ],
)
def test_a_source_without_noise_is_not_taken_for_a_frozen_one(camera: Camera) -> None:
    assert codes_of(camera) == set()


@pytest.mark.parametrize(
    ("kind", "code", "least"),
    [
        ("frozen clear", "camera_frozen", 3),
        ("frozen overcast", "camera_frozen", 2),  # of 4: without noise a grey sky may be the same by itself
        ("smear", "image_rows_repeated", 2),
        ("four bits", "image_levels_missing", 2),
    ],
)
def test_a_fault_is_found_by_its_own_alarm_alone(kind: str, code: str, least: int) -> None:
    drawn_ones = [camera._replace(clock=False) if kind == "four bits" else camera for camera in cameras(kind, 4)]
    found = [codes_of(camera) for camera in drawn_ones[: 4 if kind == "frozen overcast" else least]]
    assert sum(codes == {code} for codes in found) >= least
    assert all(codes <= {code} for codes in found)
