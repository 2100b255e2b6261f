"""When each state of a camera held: the likeliest sequence of states, and the cause of each change."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from typing import Literal, NamedTuple

import numpy as np

from sunarc.array_types import FloatArray, IntArray
from sunarc.calibration.model.sightings import SunPoints
from sunarc.offline.reanalysis.states import Camera, State

Cause = Literal["start", "moved", "lens", "clock"]

_MOST_COST = 8.0
"""Cost of a sighting that no state explains: 4 sigma. False ones are alike in all states."""
_CHANGE_COST = 20.0
"""Cost of a change of the state: three sightings have to speak for it. A camera is changed once a year, at one of some
thousands of sightings (-8), and three false ones in a row that fit another state are rare."""


class Epoch(NamedTuple):
    """A time in which one state held.

    state: its number. cause: of the change at its beginning. first, last: rows of its first and last sighting.
    start_unix_s, end_unix_s: their stated times.
    """

    state: int
    cause: Cause
    first: int
    last: int
    start_unix_s: float
    end_unix_s: float


def find_epochs(points: SunPoints, states: Sequence[State], camera: Camera) -> tuple[list[Epoch], IntArray]:
    """Return the epochs in the order of time, and the state of each sighting (n,).

    Parameters
    ----------
    points : accepted sightings in the order of their stated times.
    states : as `find_states` returns them.
    camera : see there.
    """
    costs = np.stack([_costs(camera.distances(state, points), state.sigma_px) for state in states], axis=1)
    path = likeliest_path(costs, change_cost=_CHANGE_COST)
    bounds = np.flatnonzero(np.diff(path, prepend=-1))
    epochs: list[Epoch] = []
    for number, first in enumerate(bounds.tolist()):
        last = int(bounds[number + 1]) - 1 if number + 1 < bounds.size else len(points) - 1
        state = int(path[first])
        cause = _cause(states[epochs[-1].state], states[state]) if epochs else "start"
        epochs.append(Epoch(state, cause, first, last, float(points.unix_s[first]), float(points.unix_s[last])))
    return epochs, path


def _costs(distance_px: FloatArray, sigma_px: float) -> FloatArray:
    return np.minimum(0.5 * np.square(distance_px / sigma_px), _MOST_COST)


def likeliest_path(costs: FloatArray, *, change_cost: float) -> IntArray:
    """Return the sequence of states with the least cost (Viterbi 1967).

    Parameters
    ----------
    costs : (n, k) of each of k states at each of n observations.
    change_cost : of a change from one state to any other.

    Returns
    -------
    (n,) numbers of states; of equal ones that with the least number.
    """
    n, k = costs.shape
    before = np.zeros((n, k), dtype=np.int64)
    total = costs[0].copy() if n else np.zeros(k)
    for row in range(1, n):
        best = int(np.argmin(total))
        stays = total <= total[best] + change_cost
        before[row] = np.where(stays, np.arange(k), best)
        total = np.where(stays, total, total[best] + change_cost) + costs[row]
    path = np.zeros(n, dtype=np.int64)
    if n:
        path[-1] = int(np.argmin(total))
    for row in range(n - 1, 0, -1):
        path[row - 1] = before[row, path[row]]
    return path


def _cause(former: State, state: State) -> Cause:
    if state.lens != former.lens:
        return "lens"
    return "moved" if state.pose != former.pose else "clock"


def with_true_clock(states: Sequence[State], path: IntArray) -> list[State]:
    """Return states whose offsets are against the clock that most sightings of their lens and pose have.

    Which of two clocks is right cannot be seen; a clock is right most of the time.
    """
    offsets: dict[int, float] = {}
    for pose in {state.pose for state in states}:
        counted = Counter[float]()
        for number, state in enumerate(states):
            if state.pose == pose:
                counted[state.clock_offset_s] += int(np.count_nonzero(path == number))
        offsets[pose] = counted.most_common(1)[0][0]
    return [state._replace(clock_offset_s=state.clock_offset_s - offsets[state.pose]) for state in states]


def joined(points: SunPoints, path: IntArray, states: Sequence[State]) -> SunPoints:
    """Return the sightings with times that every state's clock is corrected in, and poses as epochs."""
    offsets = np.array([state.clock_offset_s for state in states])
    poses = np.array([state.pose for state in states])
    return replace(points, unix_s=points.unix_s - offsets[path], epoch=poses[path])
