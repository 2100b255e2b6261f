"""The states that a camera was in over an archive: its lens, its pose, how far its clock was ahead; when each held.

A state is sought in the first days that no known state explains: the same camera with its clock ahead, then the same
lens in another pose, then another lens. The simplest goes first, since a wrong clock turns the sky as a turned camera
does.
"""

from __future__ import annotations

import itertools
import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from sunarc.calibration.calibrate import calibrate
from sunarc.calibration.evidence import EPOCHS, bounded_cost, likeliest_path
from sunarc.calibration.model.options import CalibrationOptions, ImageCircle, Mirrored
from sunarc.calibration.model.pose_change import Cause
from sunarc.calibration.model.result import Calibration
from sunarc.calibration.model.sightings import Sightings
from sunarc.calibration.pose import estimate_pose
from sunarc.calibration.quality.tilt import clock_behind_turn, mount_density
from sunarc.calibration.verdict import is_undetermined
from sunarc.changes.epoch_changes import EpochCause, estimate_daily_noise
from sunarc.common.array_types import BoolArray, FloatArray, IntArray, evenly_spread
from sunarc.common.findings import Finding
from sunarc.common.robust_statistics import finite, robust_sigma
from sunarc.common.utc import DAY_S
from sunarc.optics.forward import project_fast
from sunarc.optics.pose import rotation_matrix, rotation_vector
from sunarc.sky.days import solar_days
from sunarc.sky.site import Site, pole_enu
from sunarc.sky.sun import sun_directions

_PER_DAY = 40
"""Sightings of a day that states are sought in."""
_FEWEST_PER_DAY = 6
_WINDOW_DAYS = (6, 3, 1)
"""Days that a new state is fitted to: many tell a lens better, few lie less often on both sides of a change."""
_MOST_WINDOWS = 6
"""Places among the open days at which a window is tried."""
_OVER_NOISE, _OVER_NOISE_PX = 2.0, 0.3
"""A state's scatter over its days' own noise, and beyond it: days of two states, fitted as one, scatter more."""
_FEWEST = 12
_EXPLAINED = 0.7
"""Share of sightings near a state's predictions from which it explains them; others are false, or of another state."""
_MAJORITY = 0.5
"""The same for a lens that nothing is known of: days of two states may be among those that it is fitted to."""
_NEAR_SIGMAS, _NEAR_PX = 5.0, 1.5
_MOST_STATES = 24
_ALTERNATING = 0.15
"""Share of the sightings of a day that another state than the one before explains, from which they are those of two
cameras: of images taken by turns it is a half and more, of a day on which a camera changes one sighting's."""
_HOUR_S, _QUARTER_S = 3600.0, 900.0
"""Clocks are wrong by time zones, which are whole quarters of an hour, or by their drift."""
_LARGEST_OFFSET_S = 14.0 * 3600.0
_FINEST_S = 1.0
"""Step at which the search for an offset ends: the sun moves by 0.004 degrees."""
_SUN_RAD_PER_S = 2.0 * math.pi / DAY_S
_TRIED = 60
"""Sightings by which offsets are compared."""
_WHOLE_S = 20.0
"""An offset so near a whole quarter is that: a sighting's sigma is worth some seconds."""
_LOOSE: dict[str, Any] = {
    "level_within_deg": 90.0, "max_rmse_px": 30.0, "max_sky_deg": 30.0, "max_rejected": 0.75, "max_unexplained": 1.0,
    "max_below_horizon": 1.0,
}  # fmt: skip
"""A state need not be a calibration."""


_MISFIT_PX = 0.15
"""1-sigma by which a state is wrong in addition to the noise of a day."""


class State(NamedTuple):
    """State of a camera for a time: lens, pose and clock offset.

    calibration: lens and pose. lens, pose: numbers that tell them from those of other states. clock_offset_s: how far
    the stated times are ahead of UTC. sigma_px: robust scatter of its sightings per axis.
    """

    calibration: Calibration
    lens: int
    pose: int
    clock_offset_s: float
    sigma_px: float


def known_state(calibration: Calibration, points: Sightings) -> State:
    """Return the state of a given calibration, whose sightings scatter as they state, or as its own did."""
    stated = points.sigma_px[np.isfinite(points.sigma_px)]
    own_px = float(np.nan_to_num(calibration.evidence.sigma_px))
    return State(calibration, 0, 0, 0.0, max(own_px, float(np.median(stated)) if stated.size else 0.0))


class ArchiveCamera(NamedTuple):
    """Site, image size (width, height), fit options and image circle of a camera."""

    site: Site
    size: tuple[int, int]
    options: CalibrationOptions
    circle: ImageCircle | None = None

    def shifted(self, points: Sightings, offset_s: float) -> Sightings:
        """Return sightings with the times that they have by a clock that is ahead by an offset."""
        return replace(points, unix_s=points.unix_s - offset_s)

    def distances(self, state: State, points: Sightings) -> FloatArray:
        """Return how far each sighting lies from where a state predicts it, (n,) px."""
        return self.calibration_distances(state.calibration, points, state.clock_offset_s)

    def calibration_distances(self, calibration: Calibration, points: Sightings, offset_s: float) -> FloatArray:
        """Return the same for a calibration, and a clock that is ahead by an offset."""
        directions = sun_directions(points.unix_s - offset_s, self.site)
        residual = finite(points.pixels - project_fast(calibration.camera, directions))
        return np.asarray(np.hypot(residual[:, 0], residual[:, 1]))

    def loosely(self) -> CalibrationOptions:
        """Return options by which a fit is hardly ever refused."""
        return replace(self.options, **_LOOSE)


class Found(NamedTuple):
    """States of a camera in the order in which they were found; the finding where none was."""

    states: tuple[State, ...]
    finding: Finding | None = None


def find_states(points: Sightings, camera: ArchiveCamera, known: Sequence[State] = ()) -> Found:
    """Return the states that explain a camera's sightings, those that are known before them.

    Parameters
    ----------
    points : accepted sightings in the order of their stated times, false ones among them.
    camera : see there.
    known : states that are tried first.
    """
    thin, day = _thin_sightings(points, camera.site)
    states = list(known)
    hopeless: set[int] = set()
    refusal = Finding("too_few_sightings", {"n": len(thin), "least": _FEWEST})
    while len(states) < _MOST_STATES:
        open_days = [one for one in _unexplained(states, thin, day, camera) if one not in hopeless]
        if not open_days:
            break
        state, finding = _next_state(states, thin, day, open_days, camera)
        if state is None:
            hopeless.add(open_days[0])
            refusal = finding or refusal
        else:
            states.append(state)
    if not states and len(thin) >= _FEWEST:  # what they do not determine is said of a camera
        state, finding = _try_other_lens((), thin, camera, determined=False)
        states += [] if state is None else [state]
    return Found(tuple(_simplified(states, len(known), thin, camera)), None if states else refusal)


def _simplified(states: Sequence[State], n_known: int, points: Sightings, camera: ArchiveCamera) -> list[State]:
    """Return states, those with a lens of their own which a former one explains after all taken as that.

    A state is sought in days among which are those of others: what explains these in part may not explain them all.
    """
    found = list(states[:n_known])
    if len(states) < 2:
        return list(states)
    _, path = find_epochs(points, states, camera)
    for number, state in enumerate(states[n_known:], n_known):
        own = points.select(np.flatnonzero(path == number))
        if found and len(own) >= _FEWEST and all(state.lens != one.lens for one in found):
            posed = _in_other_pose(found, own, camera)
            free = 1 + max(one.pose for one in (*states, *found))
            simpler = _try_other_clock(found, own, camera) or (posed and posed._replace(pose=free))
            state = simpler or state  # noqa: PLW2901 - the same state, said otherwise
        found.append(state)
    return found


def _thin_sightings(points: Sightings, site: Site) -> tuple[Sightings, IntArray]:
    day = solar_days(points.unix_s, longitude=site.longitude)
    rows = [np.flatnonzero(day == one) for one in np.unique(day)]
    retained = [row[:: -(-row.size // _PER_DAY)] for row in rows if row.size >= _FEWEST_PER_DAY]
    if not retained:  # a few a day: all of them are sought in as one day
        index = evenly_spread(len(points), most=_WINDOW_DAYS[0] * _PER_DAY)
        return points.select(index), np.zeros(index.size, dtype=np.int64)
    index = np.concatenate(retained)
    return points.select(index), day[index]


def _unexplained(states: Sequence[State], points: Sightings, day: IntArray, camera: ArchiveCamera) -> list[int]:
    """Return the days of which too few sightings are near any state's prediction; a day may be of two states."""
    near, days = _near_any(states, points, camera), np.unique(day)
    return [int(one) for one in days if float(np.mean(near[day == one])) < _EXPLAINED]


def disagreeing_days(points: Sightings, states: Sequence[State], camera: ArchiveCamera) -> dict[int, Finding]:
    """Return the solar days of which less than half of the sightings are near any state's prediction, and the finding.

    Parameters
    ----------
    points : accepted sightings.
    states, camera : see there.
    """
    day = solar_days(points.unix_s, longitude=camera.site.longitude)
    near = _near_any(states, points, camera)
    shares = {int(one): float(np.mean(near[day == one])) for one in np.unique(day)}
    return {
        one: Finding("sightings_disagree", {"share": share, "least": _MAJORITY})
        for one, share in shares.items()
        if share < _MAJORITY
    }


def _near_any(states: Sequence[State], points: Sightings, camera: ArchiveCamera) -> BoolArray:
    """Return which sightings are near any state's prediction."""
    near = np.zeros(len(points), dtype=bool)
    for state in states:
        near |= camera.distances(state, points) < _near_px(state.sigma_px)
    return near


def _near_px(sigma_px: float) -> float:
    return _NEAR_SIGMAS * sigma_px + _NEAR_PX


def _next_state(
    states: Sequence[State], points: Sightings, day: IntArray, open_days: Sequence[int], camera: ArchiveCamera
) -> tuple[State | None, Finding | None]:
    """Return the state of the first days that none explains."""
    refusal: Finding | None = None
    for width in _WINDOW_DAYS:
        places = range(max(len(open_days) - width, 0) + 1)
        for place in places[:: -(-len(places) // _MOST_WINDOWS)]:
            window = points.select(np.isin(day, open_days[place : place + width]))
            found, finding = _fit_state(states, window, camera)
            if found is not None:
                return found, None
            refusal = finding or refusal
    return None, refusal


def _fit_state(
    states: Sequence[State], window: Sightings, camera: ArchiveCamera
) -> tuple[State | None, Finding | None]:
    """Return the state of some days, and the reason why it is missing."""
    # of days that are partly explained, what is left is of the new state
    for state in states:
        rest = camera.distances(state, window) >= _near_px(state.sigma_px)
        window = window.select(rest) if np.count_nonzero(rest) >= _FEWEST else window
    if len(window) < _FEWEST:
        return None, None
    for find in (_try_other_clock, _in_other_pose):
        found = find(states, window, camera)
        if found is not None:
            return found, None
    return _try_other_lens(states, window, camera)


def _judged(
    calibration: Calibration, offset_s: float, points: Sightings, camera: ArchiveCamera, sigma_px: float
) -> tuple[float, float]:
    """Return the share of sightings that a camera explains, and their robust scatter."""
    distance = camera.calibration_distances(calibration, points, offset_s)
    scatter = robust_sigma(distance, floor=0.05)
    return float(np.mean(distance < _near_px(sigma_px))), scatter


def _try_other_clock(states: Sequence[State], points: Sightings, camera: ArchiveCamera) -> State | None:
    """Return a known state with its clock ahead or behind."""
    best: tuple[float, State] | None = None
    for state in states:
        offset_s = _best_offset_s(state, points, camera)
        share, scatter = _judged(state.calibration, offset_s, points, camera, state.sigma_px)
        if share >= _EXPLAINED and scatter <= 1.5 * state.sigma_px + 0.2 and (best is None or share > best[0]):
            best = share, state._replace(clock_offset_s=offset_s, sigma_px=max(scatter, state.sigma_px))
    return None if best is None else best[1]


def _best_offset_s(state: State, points: Sightings, camera: ArchiveCamera) -> float:
    """Return the offset of the clock with which a state explains sightings best."""
    some = points.select(np.unique(np.linspace(0, len(points) - 1, _TRIED).astype(int)))
    near = _near_px(state.sigma_px)
    # a grid as fine as the sun crosses what is near; the smallest of equal offsets goes first
    step = near / (_SUN_RAD_PER_S * max(state.calibration.camera.focal_length_px))
    count = math.ceil(_LARGEST_OFFSET_S / step)
    grid = step * np.array(sorted(range(-count, count + 1), key=abs))
    offset = _cheapest(state, some, grid, camera, near)
    while step > _FINEST_S:
        step /= 4.0
        offset = _cheapest(state, some, offset + step * np.arange(-4.0, 5.0), camera, near)
    whole = _QUARTER_S * round(offset / _QUARTER_S)
    return state.clock_offset_s + (whole if abs(offset - whole) < _WHOLE_S else offset)


def _cheapest(state: State, points: Sightings, offsets: FloatArray, camera: ArchiveCamera, near_px: float) -> float:
    """Return that of some offsets with which sightings are nearest to a state's predictions."""
    times = points.unix_s - state.clock_offset_s - offsets[:, None]
    predicted = project_fast(state.calibration.camera, sun_directions(times, camera.site).reshape(-1, 3))
    distance = np.linalg.norm(finite(points.pixels - predicted.reshape(*times.shape, 2)), axis=-1)
    return float(offsets[int(np.argmin(np.mean(np.minimum(distance / near_px, 1.0) ** 2, axis=1)))])


def _in_other_pose(states: Sequence[State], points: Sightings, camera: ArchiveCamera) -> State | None:
    """Return a known lens in a new pose."""
    for state in reversed(_one_a_lens(states)):
        posed = estimate_pose(
            camera.shifted(points, state.clock_offset_s),
            start=state.calibration,
            site=camera.site,
            options=camera.loosely(),
        )
        share, scatter = _judged(posed, state.clock_offset_s, points, camera, state.sigma_px)
        if share >= _EXPLAINED and scatter <= 1.5 * state.sigma_px + 0.2:
            pose = 1 + max(one.pose for one in states)
            return state._replace(calibration=posed, pose=pose, sigma_px=max(scatter, state.sigma_px))
    return None


def _one_a_lens(states: Sequence[State]) -> list[State]:
    return list({state.lens: state for state in states}.values())


def _try_other_lens(
    states: Sequence[State], points: Sightings, camera: ArchiveCamera, *, determined: bool = True
) -> tuple[State | None, Finding | None]:
    """Return a new lens, and the reason why it is missing; unless it has to be determined, also one that is not."""
    clock = states[-1].clock_offset_s if states else 0.0
    options = replace(camera.loosely(), mirrored="auto")
    if states:  # a lens of another projection is met as well; an image may be flipped only where that is asked for
        last = states[-1].calibration.camera
        hand: Mirrored = "yes" if last.mirrored else "no"
        flips = camera.options.mirrored == "auto"
        options = replace(options, projection=last.projection, mirrored="auto" if flips else hand)
    fitted = calibrate(
        camera.shifted(points, clock),
        site=camera.site,
        image_size=camera.size,
        options=options,
        circle=camera.circle,
        parts=False,
    )
    if not fitted.verdict.accepted and (determined or not is_undetermined(fitted.verdict)):
        return None, fitted.verdict.findings[0]
    scatter = robust_sigma(camera.calibration_distances(fitted, points, clock), floor=0.05)
    most = _OVER_NOISE * float(np.median(estimate_daily_noise(points, camera.site))) + _OVER_NOISE_PX
    if scatter > most:
        return None, Finding("days_of_two_states", {"scatter_px": scatter, "limit_px": most})
    near = camera.calibration_distances(fitted, points, clock) < _near_px(scatter)
    near = _on_explained_days(near, solar_days(points.unix_s, longitude=camera.site.longitude))
    share = float(np.mean(near))
    if share < _MAJORITY:
        return None, Finding("sightings_disagree", {"share": share, "least": _MAJORITY})
    if share < 1.0:  # without those of another state, which pull at it
        options = replace(options, mirrored="yes" if fitted.camera.mirrored else "no")
        again = calibrate(
            camera.shifted(points.select(near), clock),
            site=camera.site,
            image_size=camera.size,
            options=options,
            start=fitted.camera,
            circle=camera.circle,
            parts=False,
        )
        fitted = again if again.verdict.accepted else fitted
    lens, pose = (1 + max((getattr(one, name) for one in states), default=-1) for name in ("lens", "pose"))
    return State(fitted, lens, pose, clock, scatter), None


def _on_explained_days(near: BoolArray, day: IntArray) -> BoolArray:
    """Return which sightings are near, of the days (n,) of which most are: a fit of a half of each is no camera."""
    explained = [one for one in np.unique(day).tolist() if float(np.mean(near[day == one])) >= _EXPLAINED]
    return np.asarray(near & np.isin(day, explained))


def changed_states(
    states: Sequence[State], state: State, sides: tuple[Sightings, Sightings], cause: Cause, camera: ArchiveCamera
) -> list[State]:
    """Return the states of sightings before and after a change within a state, new poses and lenses numbered anew.

    Parameters
    ----------
    states : all that are known.
    state : the one that was taken to explain both sides.
    sides : sightings before and after, at their stated times.
    cause : what changed.
    camera : see there.
    """
    free_pose, free_lens = (1 + max(getattr(one, name) for one in states) for name in ("pose", "lens"))
    found = []
    for number, side in enumerate(sides):
        clock = state.clock_offset_s
        if cause == "clock":
            one = state._replace(clock_offset_s=_best_offset_s(state, side, camera))
        else:
            shifted = camera.shifted(side, clock)
            posed = estimate_pose(shifted, start=state.calibration, site=camera.site, options=camera.loosely())
            one = state._replace(calibration=posed, pose=free_pose + number)
        if cause == "lens":
            options = replace(camera.loosely(), mirrored="yes" if posed.camera.mirrored else "no")
            fitted = calibrate(
                shifted, site=camera.site, image_size=camera.size, options=options, start=posed.camera, parts=False
            )
            one = one._replace(lens=free_lens + number, calibration=fitted if fitted.verdict.accepted else posed)
        scatter = robust_sigma(camera.distances(one, side), floor=0.05)
        found.append(one._replace(sigma_px=scatter))
    return found


class Epoch(NamedTuple):
    """A time in which one state held.

    state: its number. cause: of the change at its beginning. first, last: rows of its first and last sighting.
    start_unix_s, end_unix_s: their stated times.
    """

    state: int
    cause: EpochCause
    first: int
    last: int
    start_unix_s: float
    end_unix_s: float


def find_epochs(points: Sightings, states: Sequence[State], camera: ArchiveCamera) -> tuple[list[Epoch], IntArray]:
    """Return the epochs in the order of time, and the state of each sighting (n,).

    Parameters
    ----------
    points : accepted sightings in the order of their stated times.
    states : as `find_states` returns them.
    camera : see there.
    """
    noise = np.hypot(estimate_daily_noise(points, camera.site), _MISFIT_PX)
    costs = np.stack([bounded_cost(camera.distances(state, points) / noise, 1.0) for state in states], axis=1)
    path = likeliest_path(costs, change_cost=EPOCHS.gain)
    return split_epochs(path, states, points), path


_SURE = 0.999
"""Probability from which on a sighting near a change is of the state before it, or after."""


def surely_held(
    epochs: Sequence[Epoch], points: Sightings, states: Sequence[State], camera: ArchiveCamera
) -> tuple[Epoch, ...]:
    """Return epochs shortened by the times around changes at which the sightings fit both states.

    Where two states see the sun at about one place, a change between them is some sightings off.

    Parameters
    ----------
    epochs : one after the other.
    points, states, camera : as `find_epochs` takes them.
    """
    noise = np.hypot(estimate_daily_noise(points, camera.site), _MISFIT_PX)
    found = list(epochs)
    for number, (one, other) in enumerate(itertools.pairwise(epochs)):
        rows = slice(one.first, other.last + 1)
        of_one, of_other = (
            bounded_cost(camera.distances(states[each.state], points.select(rows)) / noise[rows], 1.0)
            for each in (one, other)
        )
        cost = np.cumsum(of_one - of_other)[:-1]  # of a change after each sighting but the last
        changed = np.cumsum(np.exp(np.min(cost) - cost))
        changed /= changed[-1]
        last, first = np.searchsorted(changed, 1.0 - _SURE, side="right"), 1 + np.searchsorted(changed, _SURE)
        end, start = points.unix_s[one.first + int(last)], points.unix_s[one.first + int(first)]
        found[number] = found[number]._replace(end_unix_s=max(float(end), found[number].start_unix_s))
        found[number + 1] = other._replace(start_unix_s=float(start))
    return tuple(found)


def alternation(points: Sightings, states: Sequence[State], camera: ArchiveCamera) -> Finding | None:
    """Return that sightings go to and fro between states, as those of two cameras do; None where they do not.

    Parameters
    ----------
    points, states, camera : as `find_epochs` takes them.
    """
    if len(states) < 2:
        return None
    # two cameras' tracks together are no smooth arc: a day's own noise says nothing here
    near = np.stack([camera.distances(state, points) < _near_px(state.sigma_px) for state in states], axis=1)
    decided = np.count_nonzero(near, axis=1) == 1
    own = np.argmax(near, axis=1)[decided]
    day = solar_days(points.unix_s[decided], longitude=camera.site.longitude)
    same_day = np.diff(day) == 0
    n, changes = int(np.count_nonzero(same_day)), int(np.count_nonzero(same_day & (np.diff(own) != 0)))
    if n < _FEWEST or changes <= _ALTERNATING * n:
        return None
    return Finding("sightings_alternate", {"changes": changes, "n": n})


def split_epochs(path: IntArray, states: Sequence[State], points: Sightings) -> list[Epoch]:
    """Return the epochs in which sightings (n,) in the order of time are of one state each."""
    bounds = np.flatnonzero(np.diff(path, prepend=-1))
    epochs: list[Epoch] = []
    for number, first in enumerate(bounds.tolist()):
        last = int(bounds[number + 1]) - 1 if number + 1 < bounds.size else len(points) - 1
        state = int(path[first])
        cause = classify_cause(states[epochs[-1].state], states[state]) if epochs else "start"
        epochs.append(Epoch(state, cause, first, last, float(points.unix_s[first]), float(points.unix_s[last])))
    return epochs


def classify_cause(former: State, state: State) -> EpochCause:
    """Return the change from one state to the next."""
    if state.lens != former.lens:
        return "lens"
    return "moved" if state.pose != former.pose else "clock"


_RARE_CLOCK = 0.02
"""Share of the sightings of a pose that are taken to be by a clock which only other poses are known to have had."""


def correct_clock(states: Sequence[State], path: IntArray, site: Site) -> list[State]:
    """Return states whose offsets are against the clock that is right, each camera turned with the sky.

    The sightings of a pose do not tell a wrong clock from a camera that is turned about the pole. A clock is right most
    of the time, and a camera is mounted level (see `mount_density`): the more probable of both is taken.

    Parameters
    ----------
    states : as they were found; their offsets are against that of the first one.
    path : (n,) the state of each sighting.
    site : where the camera stands.
    """
    known = {0.0, *(a.clock_offset_s - b.clock_offset_s for a in states for b in states if a.pose == b.pose)}
    known |= _hours_between(states, path, site)
    offsets: dict[int, float] = {}
    for pose in {state.pose for state in states}:
        of_pose = [(number, state) for number, state in enumerate(states) if state.pose == pose]
        counted = Counter[float]()
        for number, state in of_pose:
            counted[state.clock_offset_s] += int(np.count_nonzero(path == number))
        total = max(counted.total(), 1)
        tried = [*counted, *(one + other for one in sorted(counted) for other in sorted(known))]
        offsets[pose] = max(
            tried,
            key=lambda one: (
                math.log(max(counted[one] / total, _RARE_CLOCK))
                + math.log(float(mount_density(rotation_matrix(_turned_about_pole(of_pose[0][1], one, site))[2])))
            ),
        )
    return [
        state._replace(
            clock_offset_s=state.clock_offset_s - offsets[state.pose],
            calibration=_in_pose(state.calibration, _turned_about_pole(state, offsets[state.pose], site)),
        )
        for state in states
    ]


def _hours_between(states: Sequence[State], path: IntArray, site: Site) -> set[float]:
    """Return the changes of the clock by whole hours, s, that successive poses of a camera show, either way.

    A camera that leans meanwhile is not in the pose before: no known state explains its sightings with another clock.
    """
    numbers = path[np.flatnonzero(np.diff(path, prepend=-1))].tolist()
    found = set[float]()
    for before, after in itertools.pairwise(states[number] for number in numbers):
        clock = clock_behind_turn(before.calibration.camera, after.calibration.camera, site)
        if clock.odds > 1.0 and before.pose != after.pose and before.clock_offset_s == after.clock_offset_s:
            found |= {clock.hours * _HOUR_S, -clock.hours * _HOUR_S}
    return found


def _turned_about_pole(state: State, offset_s: float, site: Site) -> tuple[float, float, float]:
    """Return the pose in which a state's camera sees the same where its clock is ahead by less, by an offset."""
    rotation = state.calibration.camera.rotation_cam_enu
    if offset_s == 0.0:
        return rotation
    # the sun stands farther west at the later time: the sky has turned about the pole, clockwise
    back = rotation_matrix(_SUN_RAD_PER_S * offset_s * pole_enu(site))
    return rotation_vector(rotation_matrix(rotation) @ back)


def _in_pose(calibration: Calibration, rotation: tuple[float, float, float]) -> Calibration:
    camera = replace(calibration.camera, rotation_cam_enu=rotation)
    return replace(calibration, camera=camera, poses=(*calibration.poses[:-1], rotation))


def joined(points: Sightings, path: IntArray, states: Sequence[State]) -> Sightings:
    """Return the sightings with times corrected by each state's clock offset, and poses as epochs."""
    offsets = np.array([state.clock_offset_s for state in states])
    poses = np.array([state.pose for state in states])
    return replace(points, unix_s=points.unix_s - offsets[path], epoch=poses[path])
