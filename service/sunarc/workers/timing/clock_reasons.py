"""What is said of the clock that dates the frames, with its remedy."""

from __future__ import annotations

from sunarc.cameras import TAI_MINUS_UTC_S
from sunarc.runtime.status import Reason
from sunarc.workers.timing.clock_steps import ClockStep

_ABOUT_S = 1.0
"""How near to TAI less UTC a difference must be to be called that."""


def stepped(whose: str, step: ClockStep) -> Reason:
    """Return that a clock was set."""
    return Reason(
        code="clock_stepped",
        severity="degraded",
        text=f"the {step_text(whose, step)} at {step.at:%Y-%m-%dT%H:%M:%SZ}",
        remedy="see what sets the clock; sightings around the step carry its size as their error",
    )


def step_text(whose: str, step: ClockStep) -> str:
    """Return what a clock did, as the rest of a sentence that begins with "the"."""
    if step.gradual:
        return f"{whose}'s clock moved by {step.step_s:+.3f} s in small steps within {step.within_s:.0f} s"
    return f"{whose}'s clock was stepped by {step.step_s:+.3f} s"


def settling(left_s: float) -> Reason:
    """Return that a clock is not used yet after a large step."""
    return Reason(
        code="clock_settling",
        severity="degraded",
        text=f"the host's clock was moved far, and is not used for calibration for another {left_s / 60.0:.0f} min; "
        "sightings made now stay out of fits, and no day is judged",
        remedy="check the host's time (timedatectl); if it is wrong, correct it: a return to the former time shortens "
        "the wait to 10 min",
    )


def unsynchronised(whose: str) -> Reason:
    """Return that nothing keeps a clock right."""
    if whose == "camera":
        return Reason(
            code="clock_unsynchronised",
            severity="degraded",
            text="the camera's clock was stepped and has not come back; no day is judged and no camera solved",
            remedy='see to its PTP master, or set camera.timestamps = "host"; then restart the service',
        )
    return Reason(
        code="clock_unsynchronised",
        severity="degraded",
        text="the host's clock is not synchronised (1 s turns the sky by 0.004 degrees); capture goes on, "
        "but no day is judged and no camera solved, and sightings made now stay out of fits",
        remedy="start a time service (systemd-timesyncd or chrony) and let it reach its servers",
    )


def camera_offset(offset_s: float, *, limit_s: float) -> Reason:
    """Return that the camera's time is not the host's, and what that difference looks like."""
    if abs(abs(offset_s) - TAI_MINUS_UTC_S) < _ABOUT_S:
        scale = "tai" if offset_s > 0.0 else "utc"
        cause = f"; {TAI_MINUS_UTC_S:.0f} s is TAI - UTC"
        remedy = f'set camera.timestamp_scale = "{scale}"'
    else:
        cause = ""
        remedy = (
            "check the camera's PTP master and the host's time service; set camera.timestamp_offset_s for a known "
            'offset, or camera.timestamps = "host"'
        )
    return Reason(
        code="camera_clock_offset",
        severity="degraded",
        text=f"the camera's timestamps differ from the host's clock by {offset_s:+.3f} s (limit {limit_s:g} s){cause}; "
        "sightings carry this difference as their clock error",
        remedy=remedy,
    )
