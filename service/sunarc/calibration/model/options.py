"""What may be chosen: the method, what is known of the lens, and how sure one is of it."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Literal, get_args

from sunarc.errors import InputError
from sunarc.optics import PROJECTIONS, Projection

Method = Literal["robust", "paper"]
Mirrored = Literal["no", "yes", "auto"]
EllipseScope = Literal["focal_lengths", "with_decentering"]


def _choice(name: str, value: object, choices: tuple[str, ...]) -> None:
    if value not in choices:
        raise InputError(field=name, problem=f"{value!r} is unknown", remedy=f"use one of {', '.join(choices)}")


def _positive(name: str, value: float) -> None:
    if not (math.isfinite(value) and value > 0.0):
        raise InputError(field=name, problem=f"{value} is not positive", remedy="give a positive number")


@dataclass(frozen=True, slots=True, kw_only=True)
class LensTolerances:
    """How far a lens may be from its ideal: 1-sigma priors of the robust method.

    Attributes
    ----------
    radial_px : residual radial distortion; its scale is found in the data, starting here.
    radial_length_deg : angle over which the residual radial distortion changes.
    decentering_px : decentering at the horizon (radial), px; its scale, too, is found in the data.
    decentering_higher : p3 and p4.
    skew_px, aspect_px : skew, and αx − αy.
    circle_center_px, circle_focal_length_px : how well an image circle tells the principal point and the focal length.
    center_fraction, focal_length_fraction : the same without an image circle, as fractions of the image's shorter
        side and of the focal length found.
    """

    radial_px: float = 2.0
    radial_length_deg: float = 34.0
    decentering_px: float = 0.7
    decentering_higher: float = 0.3
    skew_px: float = 0.01
    aspect_px: float = 0.02
    circle_center_px: float = 5.0
    circle_focal_length_px: float = 12.0
    center_fraction: float = 0.07
    focal_length_fraction: float = 0.3

    def __post_init__(self) -> None:
        """Refuse tolerances that are none."""
        for name in self.__slots__:
            _positive(name, float(getattr(self, name)))


@dataclass(frozen=True, slots=True, kw_only=True)
class PaperOptions:
    """What the paper leaves open of its own procedure (sections 4.1 and 4.2).

    Attributes
    ----------
    fit_translation : whether t is estimated; the sun cannot tell it.
    pose_start : direct linear transform (the paper's) or Wahba's problem.
    ellipse_scope : whether the ellipse of c2 contains the decentering.
    orthogonality_weight : w1 of c1, px.
    circularity_weight : w2 of c2, per px of the ellipse's radius.
    monotony_weight : w3 of c3, px.
    """

    fit_translation: bool = False
    pose_start: Literal["dlt", "wahba"] = "wahba"
    ellipse_scope: EllipseScope = "focal_lengths"
    orthogonality_weight: float = 1e3
    circularity_weight: float = 750.0
    monotony_weight: float = 1e3

    def __post_init__(self) -> None:
        """Refuse choices that are none."""
        _choice("pose_start", self.pose_start, ("dlt", "wahba"))
        _choice("ellipse_scope", self.ellipse_scope, get_args(EllipseScope))
        for name in ("orthogonality_weight", "circularity_weight", "monotony_weight"):
            if not float(getattr(self, name)) >= 0.0:
                raise InputError(field=name, problem="negative", remedy="give 0 or more")


@dataclass(frozen=True, slots=True, kw_only=True)
class CalibrationOptions:
    """How to fit, and when to accept.

    Attributes
    ----------
    method : "robust" (the service's) or "paper" (the reference).
    projection : the lens's ideal projection.
    mirrored : whether the image is a mirror image; "auto" tries both and reports which it took.
    free : what was fitted, in the evidence of a calibration: the whole camera, or (`estimate_pose`) a known lens's
        pose.
    level_within_deg : a camera tilted by more is refused (the fit itself searches tilts to 75 degrees).
    max_angle_deg : how far off the axis the model is asked to answer.
    max_rmse_px : a fit whose used sightings scatter by more is refused.
    max_rejected : a fit that had to leave out a larger share of the sightings is refused.
    max_sky_deg : a fit whose stated 1-sigma over the sky (root mean square) is larger is refused.
    site_error_m : 1-sigma of the surveyed position, m.
    field_floor_px : smallest discrepancy field that is ever assumed, px.
    tolerances, paper : see there.
    """

    method: Method = "robust"
    projection: Projection = "equisolid"
    mirrored: Mirrored = "no"
    free: Literal["all", "pose"] = "all"
    level_within_deg: float = 5.0
    max_angle_deg: float = 100.0
    max_rmse_px: float = 3.0
    max_rejected: float = 0.6
    max_sky_deg: float = 2.0
    site_error_m: float = 30.0
    field_floor_px: float = 0.002
    tolerances: LensTolerances = field(default_factory=LensTolerances)
    paper: PaperOptions = field(default_factory=PaperOptions)

    def __post_init__(self) -> None:
        """Refuse choices that are none."""
        _choice("method", self.method, get_args(Method))
        _choice("projection", self.projection, PROJECTIONS)
        _choice("mirrored", self.mirrored, get_args(Mirrored))
        _choice("free", self.free, ("all", "pose"))
        for name in ("level_within_deg", "max_angle_deg", "max_rmse_px", "max_rejected", "max_sky_deg"):
            _positive(name, float(getattr(self, name)))
        for name in ("site_error_m", "field_floor_px"):
            if not (math.isfinite(float(getattr(self, name))) and float(getattr(self, name)) >= 0.0):
                raise InputError(field=name, problem="not a number from 0", remedy="give 0 or more")


@dataclass(frozen=True, slots=True, kw_only=True)
class ImageCircle:
    """The circle that the lens draws on the sensor.

    Attributes
    ----------
    x, y, radius : px.
    angle_deg : the angle off the axis that is seen at its edge.
    """

    x: float
    y: float
    radius: float
    angle_deg: float = 90.0

    def __post_init__(self) -> None:
        """Refuse what is no circle."""
        if not (math.isfinite(self.x) and math.isfinite(self.y)):
            raise InputError(field="image circle", problem="its centre is not finite", remedy="give x, y in px")
        _positive("image circle radius", self.radius)
        _positive("image circle angle", self.angle_deg)
