"""The likeliest sequence of states is that of a search through all sequences; causes and clocks follow from it."""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from sunarc.archives.states import State, classify_cause, correct_clock
from sunarc.calibration.evidence import likeliest_path
from sunarc.calibration.model.options import CalibrationOptions
from sunarc.calibration.start.initial_guess import level_camera
from sunarc.optics.camera import Camera
from sunarc.optics.pose import pose_angles, rotation_vector
from sunarc.sky.site import Site, pole_enu

SITE = Site(latitude=47.0, longitude=8.0, altitude=500.0)


def level() -> Camera:
    return level_camera(None, image_size=(600, 600), options=CalibrationOptions())


@dataclass(frozen=True)
class Known:
    """As much of a calibration as is asked for."""

    camera: Camera
    poses: tuple[tuple[float, float, float], ...] = ((0.0, 0.0, 0.0),)


def state(*, lens: int = 0, pose: int = 0, clock: float = 0.0, camera: Camera | None = None) -> State:
    known: Any = Known(camera or level())
    return State(known, lens, pose, clock, 1.0)


@pytest.mark.parametrize("seed", range(6))
def test_the_path_is_the_cheapest_of_all(seed: int) -> None:
    rng = np.random.default_rng(seed)
    costs = rng.uniform(0.0, 5.0, (7, 3))
    change = 3.0

    def cost(path: tuple[int, ...]) -> float:
        changes = sum(a != b for a, b in itertools.pairwise(path))
        return float(sum(costs[row, one] for row, one in enumerate(path)) + change * changes)

    best = min(itertools.product(range(3), repeat=7), key=cost)
    assert tuple(likeliest_path(costs, change_cost=change).tolist()) == best


def test_two_false_sightings_do_not_make_an_epoch_and_four_do() -> None:
    costs = np.zeros((20, 2))
    costs[:, 1] = 8.0
    for width, states in ((2, {0}), (6, {0, 1})):
        some = costs.copy()
        some[8 : 8 + width] = (8.0, 0.0)
        assert set(likeliest_path(some, change_cost=20.0).tolist()) == states


@pytest.mark.parametrize(("n", "k"), [(0, 2), (1, 1), (1, 3)])
def test_few_observations_have_a_path(n: int, k: int) -> None:
    assert likeliest_path(np.zeros((n, k)), change_cost=1.0).tolist() == [0] * n


def test_a_cause_is_the_lens_before_the_pose_before_the_clock() -> None:
    assert classify_cause(state(), state(lens=1, pose=1, clock=3600.0)) == "lens"
    assert classify_cause(state(), state(pose=1, clock=3600.0)) == "moved"
    assert classify_cause(state(), state(clock=3600.0)) == "clock"


@pytest.mark.parametrize(("counts", "expected"), [((3, 7), [-240.0, 0.0]), ((7, 3), [0.0, 240.0])])
def test_of_two_clocks_minutes_apart_that_is_right_which_most_sightings_have(
    counts: tuple[int, int], expected: list[float]
) -> None:
    states = [state(camera=level(), clock=0.0), state(camera=level(), clock=240.0)]
    path = np.repeat([0, 1], counts)
    assert [one.clock_offset_s for one in correct_clock(states, path, SITE)] == expected


@pytest.mark.parametrize("hours", [-2.0, 1.0])
def test_of_two_clocks_hours_apart_that_is_right_by_which_the_camera_stands_level(hours: float) -> None:
    """It was fitted by the wrong clock of the first days, as a camera that leans; one sighting in ten has the other."""
    turn = Rotation.from_rotvec(math.radians(15.0 * hours) * pole_enu(SITE))
    leaning = replace(level(), rotation_cam_enu=rotation_vector(turn.as_matrix()))
    states = [state(camera=leaning, clock=0.0), state(camera=leaning, clock=-3600.0 * hours)]
    path = np.repeat([0, 1], (9, 1))
    found = correct_clock(states, path, SITE)
    assert [one.clock_offset_s for one in found] == [3600.0 * hours, 0.0]
    for one in found:
        assert pose_angles(one.calibration.camera.rotation_cam_enu).theta_zz_deg < 0.1
