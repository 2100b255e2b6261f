"""What a step of a camera's rotation may be: a clock, a longitude, north, or a camera that was moved.

The sun's directions are computed for the stated time at the stated site. A clock that is ahead, and a longitude that
is stated too far east, both turn them about the celestial pole, and the camera seems turned the other way. A track of
the sun says nothing else of either: 1 s and 1/240 degree are one and the same.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from sunarc.array_types import FloatArray
from sunarc.calibration.changes.detect_change import pole_of
from sunarc.cross_checks.rotation_steps import RotationStep
from sunarc.sky.days import SECONDS_PER_DEGREE
from sunarc.sky.directions import wrapped_deg
from sunarc.sky.site import Site

Cause = Literal["clock", "longitude", "site", "north", "clock_or_north", "moved", "slow_turn"]
"""`clock`: about the celestial pole, and the stated site is as before. `longitude`, `site`: what is stated of the site
changed, by the rotation that was seen. `north`: about the vertical. `clock_or_north`: both fit, as they do near the
poles. `moved`: none of them. `slow_turn`: no step, but a turn of days and weeks
about another axis than the celestial pole, as that of a mast that settles; no alarm, since the imager's own calibration
follows it."""
_FITS_2, _FITS_3 = 11.83, 14.16
"""Quantiles of chi-squared with 2 and 3 degrees of freedom at 0.9973, as 3 sigma of one number."""
_LEAD, _LEAD_OF_NAMED = 2.0, -8.0
"""By how many powers of e a step must explain the days better than a slow turn: one about any axis, and one about the
axis of a clock, of north or of a new statement, which a mast has by chance only; by docs/studies/cross_checks.py."""
_SLOW_CLOCK = 300.0
"""Chi-squared that a slow turn must have to be a clock's: of any axes 1 in 50 would fit the pole at this size."""


@dataclass(frozen=True, slots=True, kw_only=True)
class StepSize:
    """The most likely cause of a step, and its size by each of the causes that have one number.

    Attributes
    ----------
    change : what was explained: the step, or the slow turn in its place.
    clock_s, longitude_deg : by how much the clock went ahead, or the stated longitude to the east: the same rotation.
    north_deg : by how much the camera turned about the vertical, counter-clockwise as seen from above.
    """

    cause: Cause
    change: RotationStep
    clock_s: float
    clock_sigma_s: float
    longitude_deg: float
    longitude_sigma_deg: float
    north_deg: float
    north_sigma_deg: float


def rotation_of_site(before: Site, after: Site) -> FloatArray:
    """Return the rotation (3,), degrees about east, north and up, by which a new statement of the site turns a camera.

    For differences of a few degrees and less.
    """
    east = float(wrapped_deg(after.longitude - before.longitude))
    return np.array([after.latitude - before.latitude, 0.0, 0.0]) - east * pole_of(before)


def explain_step(step: RotationStep, *, before: Site, after: Site) -> StepSize:
    """Return what a change may be.

    Parameters
    ----------
    step : of a camera's rotation against one calibration, or a slow turn.
    before, after : the site as it was stated for the days before and after it.
    """
    cause = _slow_cause(step, before) if step.settling_days else _cause(step, before, after)
    lead = np.inf if step.slower is None else step.gain - step.slower.gain
    if step.slower is not None and lead < (_LEAD if cause == "moved" else _LEAD_OF_NAMED):
        step = step.slower
        cause = _slow_cause(step, before)
    size, information = step.rotation_deg, _information(step)
    pole, pole_sigma = _about(size, information, pole_of(before))
    north, north_sigma = _about(size, information, np.array([0.0, 0.0, 1.0]))
    return StepSize(
        cause=cause,
        change=step,
        clock_s=-SECONDS_PER_DEGREE * pole,
        clock_sigma_s=SECONDS_PER_DEGREE * pole_sigma,
        longitude_deg=-pole,
        longitude_sigma_deg=pole_sigma,
        north_deg=north,
        north_sigma_deg=north_sigma,
    )


def _information(step: RotationStep) -> FloatArray:
    return np.asarray(np.linalg.inv(step.covariance_deg2), dtype=np.float64)


def _about(size: FloatArray, information: FloatArray, axis: FloatArray) -> tuple[float, float]:
    """Return the rotation about an axis that comes nearest, and its 1-sigma."""
    weight = float(axis @ information @ axis)
    return float(axis @ information @ size) / weight, weight**-0.5


def _misfit(size: FloatArray, information: FloatArray, axis: FloatArray) -> float:
    """Return chi-squared, 2 degrees of freedom, of a rotation about an axis alone."""
    amount, sigma = _about(size, information, axis)
    return float(size @ information @ size) - (amount / sigma) ** 2


def _slow_cause(turn: RotationStep, site: Site) -> Cause:
    """Return what a slow turn may be: a clock that gains or loses, or a mount; a statement changes at once."""
    size, information = turn.rotation_deg, _information(turn)
    clear = float(size @ information @ size) > _SLOW_CLOCK
    return "clock" if clear and _misfit(size, information, pole_of(site)) < _FITS_2 else "slow_turn"


def _cause(step: RotationStep, before: Site, after: Site) -> Cause:
    size, information = step.rotation_deg, _information(step)
    restated = rotation_of_site(before, after)
    if np.any(restated):
        left = size - restated
        if float(left @ information @ left) < _FITS_3:
            return "longitude" if before.latitude == after.latitude else "site"
    clock = _misfit(size, information, pole_of(before)) < _FITS_2
    north = _misfit(size, information, np.array([0.0, 0.0, 1.0])) < _FITS_2
    if clock and north:
        return "clock_or_north"
    return "clock" if clock else "north" if north else "moved"
