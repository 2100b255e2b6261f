"""What speaks against a fit, in words that name the remedy."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from sunarc.calibration.model.options import CalibrationOptions
from sunarc.calibration.model.result import Calibration, Verdict
from sunarc.calibration.model.sightings import FilteredSightings
from sunarc.calibration.quality.day_quality import arc_length_deg

_FEWEST = 20
_SHORTEST_ARC_DEG = 10.0
_SMALLEST_SPREAD_PX = 10.0
_MOST_STATIC = 0.5
"""Share of the sightings that may stand still: a detector that finds an overlay more often than the sun is at fault."""
_POSITIONS_NAMED = 3


class Handedness(NamedTuple):
    """What trying both hands said; `other_px` is NaN where only one was tried."""

    mirrored: bool
    ambiguous: bool


def before_fit(usable: FilteredSightings) -> tuple[str, ...]:
    """Return what makes a fit pointless: too few sightings, too short an arc, most of them standing still."""
    n_static = sum(position.n for position in usable.static)
    if n_static > _MOST_STATIC * (len(usable) + n_static):
        said = f"{n_static} of {len(usable) + n_static} sightings do not move with the sun ({_places(usable)})"
        return (f"{said}: a text overlay, a reflection or a hot pixel; mask it, or leave these sightings out",)
    dropped = f" ({', '.join(usable.dropped)})" if usable.dropped else ""
    if len(usable) < _FEWEST:
        return (f"only {len(usable)} usable sightings{dropped}; at least {_FEWEST} are needed",)
    problems = []
    arc = sum(arc_length_deg(usable.directions[usable.day == day]) for day in np.unique(usable.day))
    if arc < _SHORTEST_ARC_DEG:
        problems.append(f"the sun moved {arc:.1f} degrees only; at least {_SHORTEST_ARC_DEG:.0f} are needed")
    spread = float(np.linalg.norm(np.ptp(usable.pixels, axis=0)))
    if spread < _SMALLEST_SPREAD_PX:
        problems.append(f"all sightings lie within {spread:.1f} px: that is not the sun")
    return tuple(problems)


def _places(usable: FilteredSightings) -> str:
    """Return where sightings stand still, in words."""
    named = [f"{one.n} at x {one.x:.0f}, y {one.y:.0f}" for one in usable.static[:_POSITIONS_NAMED]]
    further = len(usable.static) - len(named)
    return "; ".join([*named, *([f"and {further} more positions"] if further else [])])


def own_verdict(
    calibration: Calibration, usable: FilteredSightings, handedness: Handedness, options: CalibrationOptions
) -> Verdict:
    """Return whether a fit may be used, judged by itself."""
    against = [*_against_scatter(calibration, usable, options), *_against_camera(calibration, options)]
    if handedness.ambiguous:
        against.append("a mirrored and an unmirrored camera fit alike; say which it is (--mirrored no or yes)")
    if against:
        return Verdict(accepted=False, reasons=tuple(against))
    metrics, days = calibration.metrics, len(calibration.evidence.days)
    said = [
        f"{metrics.n} sightings of {days} day{'s' if days != 1 else ''} fit to {metrics.rmse_px:.3f} px",
        f"1-sigma over the sky {calibration.sky_rms_deg:.4f} degrees",
    ]
    if usable.dropped:
        said.append(f"left out before the fit: {', '.join(usable.dropped)}")
    if usable.static:
        said.append(f"a text overlay, a reflection or a hot pixel at {_places(usable)}: mask it")
    if calibration.evidence.options.get("free") == "pose":
        said.append("provisional: the lens is that of an earlier pose, kept within what was known of it")
    if options.mirrored == "auto":
        said.append("the image is mirrored" if handedness.mirrored else "the image is not mirrored")
    return Verdict(accepted=True, reasons=tuple(said))


def _against_scatter(calibration: Calibration, usable: FilteredSightings, options: CalibrationOptions) -> list[str]:
    metrics, evidence = calibration.metrics, calibration.evidence
    against = []
    if not metrics.rmse_px <= options.max_rmse_px:
        against.append(f"the sightings used scatter by {metrics.rmse_px:.2f} px, more than {options.max_rmse_px:g}")
    rejected = 1.0 - evidence.n_used / max(len(usable), 1)
    if rejected > options.max_rejected:
        against.append(
            f"{100 * rejected:.0f} % of the sightings do not fit, more than {100 * options.max_rejected:.0f}"
        )
    if not calibration.sky_rms_deg <= options.max_sky_deg:
        against.append(
            f"1-sigma over the sky is {calibration.sky_rms_deg:.2f} degrees, more than {options.max_sky_deg:g}: "
            "the sightings cover too little of it"
        )
    return against


def _against_camera(calibration: Calibration, options: CalibrationOptions) -> list[str]:
    camera, tilt = calibration.camera, calibration.pose.theta_zz_deg
    against = []
    if tilt > options.level_within_deg:
        against.append(
            f"the camera would be tilted by {tilt:.1f} degrees, more than {options.level_within_deg:g} "
            "(--level-within): if it stands level, the times (clock, time zone), the longitude's or latitude's sign, "
            "or the handedness is wrong; residuals cannot tell these apart"
        )
    x, y = camera.principal_point_px
    if not (0.0 <= x <= camera.width and 0.0 <= y <= camera.height):
        against.append(f"the principal point {x:.0f}, {y:.0f} lies outside the image")
    if camera.max_angle < math.radians(20.0):
        against.append("the lens's radius does not rise with the angle")
    return against
