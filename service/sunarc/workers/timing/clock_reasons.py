"""Conditions of the clock that dates the frames."""

from __future__ import annotations

from sunarc.cameras.timestamps import TAI_MINUS_UTC_S
from sunarc.findings import Finding
from sunarc.utc import rfc3339
from sunarc.workers.timing.clock_steps import ClockStep

_ABOUT_S = 1.0
"""How near to TAI less UTC a difference must be to be called that."""


def stepped(code: str, clock: str, step: ClockStep) -> Finding:
    """Return that a clock was set, or moved in small steps."""
    how = f"in small steps within {step.within_s:.0f} s" if step.gradual else "at once"
    at = rfc3339(step.at, timespec="seconds")
    return Finding(code, {"clock": clock, "step_s": step.step_s, "how": how, "at": at})


def is_tai(offset_s: float) -> bool:
    """Return whether two clocks differ by about TAI less UTC, which no wrong clock does but by chance."""
    return abs(abs(offset_s) - TAI_MINUS_UTC_S) < _ABOUT_S


def camera_offset(offset_s: float, *, limit_s: float) -> Finding:
    """Return that the camera's time is not the host's, and what that difference looks like."""
    if is_tai(offset_s):
        cause = f"; {TAI_MINUS_UTC_S:.0f} s is TAI - UTC"
        remedy = f'set camera.timestamp_scale = "{"tai" if offset_s > 0.0 else "utc"}"'
    else:
        cause = ""
        remedy = (
            "check the camera's PTP master and the host's time service; set camera.timestamp_offset_s for a known "
            'offset, or camera.timestamps = "host"'
        )
    return Finding("camera_clock_offset", {"offset_s": offset_s, "limit_s": limit_s, "cause": cause, "remedy": remedy})
