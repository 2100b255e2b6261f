"""Comparison of neighbouring cameras: which camera turned, and the possible causes.

The sun's directions are computed for the stated time at the stated site. A clock that is ahead, and a longitude that
is stated too far east, both turn them about the celestial pole, and the camera seems turned the other way. A track of
the sun says nothing else of either: 1 s and 1/240 degree are one and the same.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from sunarc.calibration.evidence import DAYS, RARER, Weighed, log_marginal, most_probable
from sunarc.calibration.model.pose_change import Cause, PoseChange
from sunarc.changes.daily_rotations import DailyRotations, as_shown, find_change
from sunarc.common.array_types import FloatArray, picked
from sunarc.sky.days import SECONDS_PER_DEGREE
from sunarc.sky.directions import wrapped_deg
from sunarc.sky.site import Site, pole_enu

_UP = np.array([0.0, 0.0, 1.0])
_FEWEST_OTHERS = 2
"""Of two cameras that differ none is the one that is wrong."""
FEWEST_AGREEING = 3
"""Others that must show a camera's change, each by itself, for the camera to be named."""
_SHARE, _LEAST_SHOWN = 0.5, 3.0
"""By how much of its size a change may be another one at another camera, and its least gain there."""
_NOT_WEIGHED = 0.05
"""Share of causes with a probability of nearly 1 among those weighed that were none of them: mounts that walk, days
that all cameras have wrong alike; by docs/studies/cross_checks.py."""


def site_rotation(before: Site, after: Site) -> FloatArray:
    """Return the rotation (3,), degrees about east, north and up, by which a new statement of the site turns a camera.

    For differences of a few degrees and less.
    """
    east = float(wrapped_deg(after.longitude - before.longitude))
    return np.array([after.latitude - before.latitude, 0.0, 0.0]) - east * pole_enu(before)


def explain_step(step: PoseChange, *, before: Site, after: Site) -> tuple[PoseChange, float]:
    """Return the most probable explanation of a change, and its probability: at most 0.95, see `_NOT_WEIGHED`.

    Parameters
    ----------
    step : of a camera's rotation against one calibration, or a slow turn.
    before, after : the site as it was stated for the days before and after it.

    Returns
    -------
    The step, or the slow turn in its place, with its cause.
    """
    changes = [step] if step.slower is None else [step, step.slower]
    weighed = [one for change in changes for one in _list_explanations(change, before, after)]
    best = most_probable(weighed).explanation
    of_cause = [one.log_evidence - one.rarer for one in weighed if one.explanation.cause == best.cause]
    other_evidence = [one.log_evidence - one.rarer for one in weighed if one.explanation.cause != best.cause]
    against = np.logaddexp.reduce([*other_evidence, DAYS.gain]) - np.logaddexp.reduce(of_cause)
    return best, (1.0 - _NOT_WEIGHED) * float(np.exp(-np.logaddexp(0.0, against)))


def step_sizes(change: PoseChange, site: Site) -> dict[str, float]:
    """Return the size of a turn by each of the causes that have one number, with 1-sigmas, by name.

    `clock_s`, `longitude_deg`: by how much the clock went ahead, or the stated longitude to the east: one rotation.
    `north_deg`: by how much the camera turned about the vertical, counter-clockwise as seen from above.
    """
    information = np.asarray(np.linalg.inv(change.covariance_deg2), dtype=np.float64)
    pole, pole_sigma = _rotation_about_axis(change.rotation_deg, information, pole_enu(site))
    north, north_sigma = _rotation_about_axis(change.rotation_deg, information, _UP)
    return {
        "clock_s": -SECONDS_PER_DEGREE * pole,
        "clock_sigma_s": SECONDS_PER_DEGREE * pole_sigma,
        "longitude_deg": -pole,
        "longitude_sigma_deg": pole_sigma,
        "north_deg": north,
        "north_sigma_deg": north_sigma,
    }


def _list_explanations(change: PoseChange, before: Site, after: Site) -> list[Weighed[PoseChange]]:
    """Return the possible causes of a change: a rotation about any axis, or about one that names the cause."""
    size = change.rotation_deg

    def evidence(axes: FloatArray, left: FloatArray = size) -> float:
        return log_marginal(left[:, None], change.covariance_deg2, DAYS.turn_deg * axes[:, None, :])

    def weighed(cause: Cause, log_evidence: float, rarer: float | None = None) -> Weighed[PoseChange]:
        rarer = DAYS.rarer[cause] if rarer is None else rarer
        return Weighed(replace(change, cause=cause), change.gain + log_evidence - of_any, rarer)

    of_any = evidence(np.eye(3))
    clock, north = evidence(pole_enu(before)[:, None]), evidence(_UP[:, None])
    if change.settling > 0.0:  # a statement changes at once, and so does north
        return [weighed("slow_turn", of_any), weighed("clock", clock, RARER)]
    found = [weighed("moved", of_any)]
    if min(clock, north) > of_any:
        found.append(weighed("clock_or_north", max(clock, north)))
    else:
        found += [weighed("clock", clock), weighed("north", north)]
    restated = site_rotation(before, after)
    if np.any(restated):
        named: Cause = "longitude" if before.latitude == after.latitude else "site"
        found.append(weighed(named, evidence(np.zeros((3, 1)), size - restated)))
    return found


def _rotation_about_axis(size: FloatArray, information: FloatArray, axis: FloatArray) -> tuple[float, float]:
    """Return the rotation about an axis that comes nearest, and its 1-sigma."""
    weight = float(axis @ information @ axis)
    return float(axis @ information @ size) / weight, weight**-0.5


def find_steps(cameras: Sequence[DailyRotations]) -> tuple[PoseChange | None, ...]:
    """Return the change of each camera of a group of neighbours; None of one that shows none clearly.

    What all of them have in common on a day is not a camera's: refraction, a time server, a new version of the
    software. Each is compared with the mean of the others. The largest change is taken first, and removed, because
    the others would show it with the opposite sign. With fewer than three cameras nothing is common.

    Parameters
    ----------
    cameras : their rotations on days numbered alike, of at most some 60 days.
    """
    found: list[tuple[PoseChange, bool] | None] = [None] * len(cameras)
    remaining = list(cameras)
    for _ in cameras:
        steps = {
            number: find_change(_subtract_mean_of_others(remaining, number))
            for number in range(len(cameras))
            if found[number] is None
        }
        clear = {number: step for number, step in steps.items() if step is not None}
        if not clear:
            break
        # by size, which the others show divided by their number; gains are near one another where days are precise
        first = max(clear, key=lambda number: clear[number][0].likeliest.turn_deg)
        found[first] = clear[first]
        remaining[first] = _remove_step(remaining[first], clear[first][0])
    return tuple(None if one is None or one[1] else one[0] for one in found)


def agreeing(cameras: Sequence[DailyRotations], number: int, change: PoseChange) -> int:
    """Return how many other cameras show a camera's change; 0 where they are no more than half of all.

    What differs between two cameras is either's: a change is the camera's own where its difference from others has it
    in about its whole size. What many cameras do alike, others than this one, is not distinguished from it.
    """
    n_shown, n_compared = 0, 0
    change = change.likeliest
    weighed = np.linalg.solve(change.covariance_deg2, change.rotation_deg)
    for one in [other for k, other in enumerate(cameras) if k != number]:
        shown = as_shown(_subtract_rotations(cameras[number], one), change)
        if shown is not None:
            share = float(weighed @ shown.rotation_deg) / float(weighed @ change.rotation_deg)
            n_shown += abs(share - 1.0) < _SHARE and shown.gain > _LEAST_SHOWN
            n_compared += 1
    return n_shown if 2 * n_shown > n_compared + 1 else 0


def _subtract_rotations(one: DailyRotations, other: DailyRotations) -> DailyRotations:
    """Return by how much more one camera stood turned than another, on the days that both show."""
    day, here, there = np.intersect1d(one.day, other.day, return_indices=True)
    return DailyRotations(
        day=day,
        rotation_deg=one.rotation_deg[here] - other.rotation_deg[there],
        covariance_deg2=one.covariance_deg2[here] + other.covariance_deg2[there],
    )


def _remove_step(one: DailyRotations, step: PoseChange) -> DailyRotations:
    step = step.likeliest
    return replace(one, rotation_deg=one.rotation_deg - step.progress(one.day)[:, None] * step.rotation_deg)


def _subtract_mean_of_others(cameras: Sequence[DailyRotations], number: int) -> DailyRotations:
    """Return a camera's rotations less the mean, on each day, of the others' differences from their own medians.

    Days that none of the others shows are left out: between corrected days they would stand off by what is common.
    """
    own = cameras[number]
    others = [one for k, one in enumerate(cameras) if k != number and len(one.day)]
    if len(others) < _FEWEST_OTHERS or not len(own.day):
        return own
    total, count = np.zeros((len(own.day), 3)), np.zeros(len(own.day))
    for one in others:
        place = np.minimum(np.searchsorted(one.day, own.day), len(one.day) - 1)
        there = one.day[place] == own.day
        off = one.rotation_deg - np.median(one.rotation_deg, axis=0)
        total += np.where(there[:, None], off[place], 0.0)
        count += there
    common = total / np.maximum(count, 1.0)[:, None]
    return picked(replace(own, rotation_deg=own.rotation_deg - common), count > 0.0)
