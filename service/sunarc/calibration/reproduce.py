"""The fit of a past calibration once more, from its own evidence."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from sunarc.calibration.calibrate import calibrate
from sunarc.calibration.model.options import CalibrationOptions, ImageCircle, LensTolerances, PaperOptions
from sunarc.calibration.model.result import Calibration
from sunarc.calibration.model.sightings import SunPoints
from sunarc.calibration.quality.pose_drift import with_pose_spread
from sunarc.errors import InputError
from sunarc.optics.camera import Camera


def reproduce_calibration(past: Calibration, points: SunPoints) -> Calibration:
    """Return the calibration that the evidence of a past one leads to.

    Parameters
    ----------
    past : as it was made, or as its document tells it.
    points : the sightings that it was given.

    Raises
    ------
    InputError
        Where its evidence is not whole: made by hand, or by a version with other options.
    """
    evidence = past.evidence
    try:
        solved = calibrate(
            points,
            site=past.site,
            image_size=(past.camera.width, past.camera.height),
            options=_options(evidence.options),
            circle=None if evidence.circle is None else ImageCircle(**_named(evidence.circle)),
            start=None if evidence.start is None else Camera(**_named(evidence.start)),
        )
    except TypeError as error:
        raise InputError(
            field="evidence", problem=f"is of another version ({error})", remedy="use the version that made it"
        ) from error
    solved = replace(solved, evidence=replace(solved.evidence, selection=evidence.selection))
    return with_pose_spread(solved, evidence.pose_spread_deg or (0.0, 0.0, 0.0))


def _options(stored: Mapping[str, object]) -> CalibrationOptions:
    if not stored:
        raise InputError(field="evidence.options", problem="are empty", remedy="name a calibration that a fit made")
    named = _named(stored)
    if named.pop("free", "all") != "all":
        raise InputError(
            field="evidence.options.free",
            problem="only the pose was fitted, with another calibration's lens, or the camera about a stated prior",
            remedy="solve the calibration that it names as its parent, or name that camera again with --start",
        )
    if "lens_prior" in named:
        raise InputError(
            field="evidence.options.lens_prior",
            problem="the fit was given a type of lens, whose file the archive does not hold",
            remedy="fit the same sightings again with that file and --lens-prior",
        )
    lens, paper = LensTolerances(**named.pop("tolerances")), PaperOptions(**named.pop("paper"))
    return CalibrationOptions(**named, tolerances=lens, paper=paper)


def _named(stored: Mapping[str, object]) -> dict[str, Any]:
    """Return arguments by name; JSON has lists where values have tuples."""
    return {name: tuple(value) if isinstance(value, list) else value for name, value in stored.items()}
