"""The likeliest sequence of states is that of a search through all sequences; causes and clocks follow from it."""

from __future__ import annotations

import itertools
from typing import Any

import numpy as np
import pytest

from sunarc.calibration.evidence import likeliest_path
from sunarc.reanalysis.states import State, cause_of, with_true_clock


def state(*, lens: int = 0, pose: int = 0, clock: float = 0.0) -> State:
    nothing: Any = None
    return State(nothing, lens, pose, clock, 1.0)


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
    assert cause_of(state(), state(lens=1, pose=1, clock=3600.0)) == "lens"
    assert cause_of(state(), state(pose=1, clock=3600.0)) == "moved"
    assert cause_of(state(), state(clock=3600.0)) == "clock"


def test_the_right_clock_is_the_one_that_most_sightings_of_a_pose_have() -> None:
    states = [state(clock=0.0), state(clock=3600.0), state(pose=1, clock=3600.0)]
    path = np.array([0] * 3 + [1] * 7 + [2] * 5)
    assert [one.clock_offset_s for one in with_true_clock(states, path)] == [-3600.0, 0.0, 0.0]
