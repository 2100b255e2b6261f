"""What is computed of a camera's sightings between and after the passes: on workers, from values, to values."""

from __future__ import annotations

from typing import NamedTuple

from sunarc.array_types import IntArray
from sunarc.calibration.model.sightings import SunPoints
from sunarc.calibration.robust_loss import robust_sigma
from sunarc.findings import Finding
from sunarc.offline.reanalysis.epochs import Epoch, find_epochs, with_true_clock
from sunarc.offline.reanalysis.fit import Fitted, better_of, doubts, fit_poses, with_small_steps
from sunarc.offline.reanalysis.states import Camera, State, find_states

_SIGMA_FLOOR_PX = 0.05


class Sightings(NamedTuple):
    """Accepted sightings of a camera at their stated times, and the states that are known so far."""

    points: SunPoints
    camera: Camera
    states: tuple[State, ...] = ()


class Rough(NamedTuple):
    """States and epochs after the first pass, and what is doubtful or why there are none."""

    states: tuple[State, ...] = ()
    epochs: tuple[Epoch, ...] = ()
    findings: tuple[Finding, ...] = ()


class Final(NamedTuple):
    """States, epochs, the state of each sighting (n,), and the calibration of each pose by its number."""

    states: tuple[State, ...]
    epochs: tuple[Epoch, ...]
    path: IntArray
    fitted: dict[int, Fitted]


def first_analysis(given: Sightings) -> Rough:
    """Return the states and epochs of a camera by its first pass."""
    found = find_states(given.points, given.camera)
    if found.finding is not None:
        return Rough(findings=(found.finding,))
    epochs, path = find_epochs(given.points, found.states, given.camera)
    states = with_true_clock(found.states, path)
    largest = states[max(range(len(states)), key=lambda number: int((path == number).sum()))]
    return Rough(tuple(states), tuple(epochs), doubts(largest.calibration, given.camera))


def final_analysis(given: Sightings) -> Final:
    """Return the epochs and calibrations of a camera by its second pass."""
    points, camera = given.points, given.camera
    _, path = find_epochs(points, given.states, camera)
    states = with_small_steps(points, path, given.states, camera)
    _, path = find_epochs(points, states, camera)
    fitted = fit_poses(points, path, states, camera)
    refined = [_refined(state, fitted, points.select(path == number), camera) for number, state in enumerate(states)]
    epochs, path = find_epochs(points, refined, camera)
    return Final(tuple(refined), tuple(epochs), path, fitted)


class Starry(NamedTuple):
    """Accepted sightings of a camera, what came of them, and the stars of its nights."""

    given: Sightings
    final: Final
    stars: SunPoints


def starry_analysis(of: Starry) -> Final:
    """Return epochs and calibrations with those calibrations that are better fitted to suns and stars."""
    final, given = of.final, of.given
    both = fit_poses(given.points, final.path, final.states, given.camera, stars=of.stars)
    return final._replace(fitted=better_of(final.fitted, both))


def _refined(state: State, fitted: dict[int, Fitted], points: SunPoints, camera: Camera) -> State:
    """Return a state with the calibration that was fitted to all of its sightings."""
    found = fitted.get(state.pose)
    if found is None or found.calibration.evidence.n_used == 0 or len(points) == 0:
        return state
    distance = camera.distances_of(found.calibration, points, state.clock_offset_s)
    return state._replace(calibration=found.calibration, sigma_px=robust_sigma(distance, floor=_SIGMA_FLOOR_PX))
