"""Steps in a camera's daily rotations, against white noise and a drift whose sizes the days themselves tell.

A component's model is a constant, one step, a random walk and white noise in the ratio of the stated variances. The
walk takes what drifts: a mast that settles, a lens whose error changes with the sun's declination. A step has to beat
that model with a walk of its own best size, so that the faster a camera drifts the larger a step must be.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from sunarc.array_types import FloatArray, IntArray, picked
from sunarc.cross_checks.daily_rotations import DailyRotations
from sunarc.robust_statistics import MAD_TO_SIGMA

_WALK = (0.0, 0.003, 0.03, 0.3, 3.0)
"""Variance of the walk in a day over that of a day's rotation, tried each: from none to nothing but a walk."""
_FEWEST_BEFORE, _FEWEST_AFTER = 8, 4
"""Days: a scatter needs some before, and three days of cloud's making are not a step."""
MIN_GAIN = 13.0
"""By how many powers of e a step must explain the days better; by docs/studies/cross_checks.py, so that there is less
than one false step in a camera-year."""
_NEAR, _OUTLYING = 5, 4.0
"""A day that is further than so many scatters from the median of so many days about it is moved to that limit."""
_FEWEST_OTHERS = 2
"""Of two cameras that differ none is the one that is wrong."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RotationStep:
    """A step of a camera's rotation.

    Attributes
    ----------
    day : the first one after it.
    rotation_deg : (3,) after minus before, about east, north and up.
    covariance_deg2 : (3, 3) of it, by the scatter and the drift of the days.
    gain : by how many powers of e the step explains the days better than none.
    n_before, n_after : days.
    """

    day: float
    rotation_deg: FloatArray
    covariance_deg2: FloatArray
    gain: float
    n_before: int
    n_after: int


def find_steps(cameras: Sequence[DailyRotations], *, min_gain: float = MIN_GAIN) -> tuple[RotationStep | None, ...]:
    """Return the step of each camera of a group of neighbours; None of one that shows none clearly.

    What all of them have in common on a day is not a camera's: refraction, a time server, a new version of the
    software. Each is compared with the mean of the others. The clearest step is taken first, and removed, because the
    others would show it with the opposite sign. With fewer than three cameras nothing is common.

    Parameters
    ----------
    cameras : their rotations on days numbered alike, of at most some 60 days.
    min_gain : the least gain, natural logarithm.
    """
    found: list[RotationStep | None] = [None] * len(cameras)
    remaining = list(cameras)
    for _ in cameras:
        steps = {
            number: find_step(_beside_others(remaining, number), min_gain=min_gain)
            for number in range(len(cameras))
            if found[number] is None
        }
        clear = {number: step for number, step in steps.items() if step is not None}
        if not clear:
            break
        first = max(clear, key=lambda number: clear[number].gain)
        found[first] = clear[first]
        remaining[first] = _without(remaining[first], clear[first])
    return tuple(found)


def _without(one: DailyRotations, step: RotationStep) -> DailyRotations:
    after = (one.day >= step.day)[:, None]
    return replace(one, rotation_deg=one.rotation_deg - after * step.rotation_deg)


def _beside_others(cameras: Sequence[DailyRotations], number: int) -> DailyRotations:
    """Return a camera's rotations less the mean, on each day, of what the others differ from their own medians.

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


def find_step(days: DailyRotations, *, min_gain: float = MIN_GAIN) -> RotationStep | None:
    """Return the step that explains a camera's daily rotations best; None where none does so clearly.

    Parameters
    ----------
    days : of at most some 60 days, without what is common to the neighbours.
    min_gain : the least gain, natural logarithm.
    """
    n = len(days.day)
    starts = np.arange(_FEWEST_BEFORE, n - _FEWEST_AFTER + 1, dtype=np.int64)
    if not len(starts):
        return None
    # about the principal axes of what is stated the three components err independently
    axes = np.linalg.eigh(days.covariance_deg2.mean(axis=0))[1]
    rotations = _limited(days.rotation_deg @ axes)
    variances = np.einsum("ij,nik,kj->nj", axes, days.covariance_deg2, axes)
    fits = [_component(days.day, rotations[:, j], variances[:, j], starts) for j in range(3)]
    gain = np.sum([fit.gain for fit in fits], axis=0)
    best = int(np.argmax(gain))
    if gain[best] < min_gain:
        return None
    size = np.array([fit.size[best] for fit in fits])
    variance = np.array([fit.variance[best] for fit in fits])
    first = int(starts[best])
    return RotationStep(
        day=float(days.day[first]),
        rotation_deg=axes @ size,
        covariance_deg2=axes @ np.diag(variance) @ axes.T,
        gain=float(gain[best]),
        n_before=first,
        n_after=n - first,
    )


class _Steps(NamedTuple):
    """Of each start: the gain, and the step's size and variance."""

    gain: FloatArray
    size: FloatArray
    variance: FloatArray


def _component(day: FloatArray, rotation: FloatArray, variance: FloatArray, starts: IntArray) -> _Steps:
    """Return what a step from each of the starts on is worth, by generalised least squares for each size of walk."""
    n = len(day)
    walk = np.minimum.outer(day - day[0], day - day[0])
    after = (np.arange(n)[:, None] >= starts).astype(np.float64)
    none, steps, sizes, spreads = [], [], [], []
    for ratio in _WALK:
        factor = np.linalg.cholesky(np.diag(variance) + ratio * variance.mean() * walk)
        white = np.linalg.solve(factor, np.column_stack([np.ones(n), rotation, after]))
        constant = white[:, 0] / np.linalg.norm(white[:, 0])
        white = white[:, 1:] - constant[:, None] * (constant @ white[:, 1:])
        values, shape = white[:, 0], white[:, 1:]
        information = np.sum(shape**2, axis=0)
        size = shape.T @ values / information
        left = max(float(values @ values), 1e-12)  # rotations without any scatter are none of a camera
        remaining = np.maximum(left - size**2 * information, 1e-12 * left)
        constant_part = -np.log(np.diag(factor)).sum()
        none.append(constant_part - 0.5 * n * np.log(left))
        steps.append(constant_part - 0.5 * n * np.log(remaining))
        sizes.append(size)
        spreads.append(remaining / (n - 2.0) / information)
    likelihood = np.array(steps)
    best = np.argmax(likelihood, axis=0)
    column = np.arange(len(starts))
    gain = likelihood[best, column] - max(none)
    return _Steps(gain, np.array(sizes)[best, column], np.array(spreads)[best, column])


def _limited(rotations: FloatArray) -> FloatArray:
    """Return (n, 3) with single days that stand off from those about them moved near; a step stays as it is."""
    half = _NEAR // 2
    padded = np.pad(rotations, ((half, half), (0, 0)), mode="edge")
    near = np.lib.stride_tricks.sliding_window_view(padded, _NEAR, axis=0)
    middle = np.asarray(np.median(near, axis=-1), dtype=np.float64)
    off = rotations - middle
    limit = _OUTLYING * MAD_TO_SIGMA * np.asarray(np.median(np.abs(off), axis=0), dtype=np.float64)
    return np.asarray(middle + np.clip(off, -limit, limit))
