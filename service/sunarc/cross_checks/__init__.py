"""Comparison of neighbouring cameras: steps of a camera's pose, and clocks by the edges of clouds.

`daily_rotations` how a camera stood turned on each day · `rotation_steps` when that stepped, and by what rotation ·
`causes` what such a rotation may be: a clock, a longitude, north · `cloud_edges` how much later one camera lost and
found the sun than another · `clocks` the cameras' clocks from these lags. What follows from what: docs/maths.md,
section 13.
"""

from sunarc.cross_checks.causes import Cause, StepSize, explain_step, rotation_of_site
from sunarc.cross_checks.clocks import ClockOffsets, Lag, clock_offsets
from sunarc.cross_checks.cloud_edges import SunSeries, cloud_lag
from sunarc.cross_checks.daily_rotations import DailyRotations, daily_rotations
from sunarc.cross_checks.rotation_steps import RotationStep, find_step, find_steps

__all__ = [
    "Cause",
    "ClockOffsets",
    "DailyRotations",
    "Lag",
    "RotationStep",
    "StepSize",
    "SunSeries",
    "clock_offsets",
    "cloud_lag",
    "daily_rotations",
    "explain_step",
    "find_step",
    "find_steps",
    "rotation_of_site",
]
