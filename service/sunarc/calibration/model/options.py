"""Options of a fit: the method, the lens, and their priors."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Annotated, Literal

from annotated_types import Ge, Gt, Le

from sunarc.common.bounds import NonNegative, Positive, require_bounds
from sunarc.optics.projections import Projection

Method = Literal["robust", "paper"]
Mirrored = Literal["no", "yes", "auto"]
LensProjection = Literal[Projection, "auto"]
EllipseScope = Literal["focal_lengths", "with_decentering"]


@dataclass(frozen=True, slots=True, kw_only=True)
class LensTolerances:
    """Tolerances of a lens about its ideal: 1-sigma priors of the robust method.

    Attributes
    ----------
    radial_px : residual radial distortion; its scale is found in the data, starting here.
    radial_length_deg : angle over which the residual radial distortion changes.
    decentering_px : decentering at the horizon (radial), px; its scale, too, is found in the data.
    decentering_higher : p3 and p4.
    skew_px, aspect_px : skew, and αx − αy.
    circle_center_px, circle_focal_length_px : how well an image circle tells the principal point and the focal length.
    square_odds : odds, before any sighting, that pixels are square: 100 of a machine-vision camera; of images that a
        program may have stretched 5.
    center_fraction, focal_length_fraction : the same without an image circle, as fractions of the image's shorter
        side and of the focal length found.
    """

    radial_px: Positive = 7.0
    radial_length_deg: Positive = 34.0
    decentering_px: Positive = 1.2
    decentering_higher: Positive = 0.3
    skew_px: Positive = 0.01
    aspect_px: Positive = 0.02
    square_odds: Positive = 100.0
    circle_center_px: Positive = 5.0
    circle_focal_length_px: Positive = 12.0
    center_fraction: Positive = 0.03
    focal_length_fraction: Positive = 0.3

    def __post_init__(self) -> None:
        """Refuse invalid tolerances."""
        require_bounds(self, section_path="calibration.tolerances")


@dataclass(frozen=True, slots=True, kw_only=True)
class PaperOptions:
    """Choices that the paper leaves open in its own procedure (sections 4.1 and 4.2).

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
    orthogonality_weight: NonNegative = 1e3
    circularity_weight: NonNegative = 750.0
    monotony_weight: NonNegative = 1e3

    def __post_init__(self) -> None:
        """Refuse invalid choices."""
        require_bounds(self, section_path="calibration.paper")


@dataclass(frozen=True, slots=True, kw_only=True)
class CalibrationOptions:
    """Options of a fit, and of its acceptance.

    Attributes
    ----------
    method : "robust" (the service's) or "paper" (the reference).
    projection : the lens's ideal projection; "auto": the most probable one, see `projection_choice`.
    mirrored : whether the image is a mirror image; "auto" tries both and reports which it took. Unset: it is not, and
        the fit is refused where a mirrored one is about as probable.
    level_within_deg : a camera tilted by more is refused; unset: a first fit of one that is tilted by more than 5
        degrees is refused, unless refraction and horizon show its tilt: a wrong site or clock looks the same.
    max_angle_deg : how far off the axis the model is asked to answer.
    max_rmse_px : a fit whose used sightings scatter by more, and by 1.5 times more than they state, is refused.
    max_below_horizon : a fit of whose sightings a larger share is of times with the sun below the horizon is refused.
    max_rejected : a fit that had to leave out a larger share of the sightings is refused.
    max_unexplained : a fit that leaves out a larger share of the sightings of an epoch's clear days is refused, as is
        one that half-days contradict; 1 asks for neither.
    max_sky_deg : a fit whose stated 1-sigma over the sky (root mean square) is larger is refused; one of a known
        lens, or about a stated prior, may state 2 degrees. 1.5 degrees are three diameters of the sun, and misplace
        a cloud at 2 km by 52 m overhead and by 210 m at a zenith angle of 60 degrees. A clear day states 0.02 to 1.4.
    site_error_m : 1-sigma of the surveyed position, m.
    outwards_px : 1-sigma of how far the sun is detected from its place along the radius, whatever the radius, px: by
        the blur of the lens, by a threshold on its aureole. A bias that grows with the radius is the lens's.
    field_floor_px : smallest discrepancy field that is ever assumed, px.
    tolerances, paper : see there.
    """

    method: Method = "robust"
    projection: LensProjection = "auto"
    mirrored: Mirrored | None = None
    level_within_deg: Annotated[float, Gt(0.0), Le(90.0)] | None = None
    max_angle_deg: Annotated[float, Gt(0.0), Le(180.0)] = 100.0
    max_rmse_px: Positive = 3.0
    max_rejected: Annotated[float, Gt(0.0), Le(1.0)] = 0.6
    max_below_horizon: Annotated[float, Gt(0.0), Le(1.0)] = 0.03
    max_unexplained: Annotated[float, Gt(0.0), Le(1.0)] = 0.25
    max_sky_deg: Positive = 1.5
    site_error_m: NonNegative = 30.0
    outwards_px: Annotated[float, Ge(0.0), Le(10.0)] = 0.07
    field_floor_px: NonNegative = 0.002
    tolerances: LensTolerances = field(default_factory=LensTolerances)
    paper: PaperOptions = field(default_factory=PaperOptions)

    def __post_init__(self) -> None:
        """Refuse invalid choices."""
        require_bounds(self, section_path="calibration")

    @property
    def assumed_projection(self) -> Projection:
        """The projection, equisolid where it is to be found."""
        return "equisolid" if self.projection == "auto" else self.projection


USUAL_OPTIONS = CalibrationOptions()


@dataclass(frozen=True, slots=True, kw_only=True)
class ImageCircle:
    """Circle that a fisheye lens draws on the sensor.

    Attributes
    ----------
    x, y, radius : px.
    angle_deg : the angle off the axis that is seen at its edge.
    """

    x: Annotated[float, Ge(-1e6), Le(1e6)]
    y: Annotated[float, Ge(-1e6), Le(1e6)]
    radius: Positive
    angle_deg: Annotated[float, Gt(0.0), Le(180.0)] = 90.0

    def __post_init__(self) -> None:
        """Refuse an invalid circle."""
        require_bounds(self, section_path="image circle")


@dataclass(frozen=True, slots=True, kw_only=True)
class FirstPoseOptions:
    """Prior of a camera's pose before its first sighting.

    Attributes
    ----------
    tilt_deg : 1-sigma of the tilt about each horizontal axis.
    top_azimuth_deg : azimuth at the top of the image, as the camera was mounted; unset: not known.
    top_within_deg : a pose that differs by more is not served.
    """

    tilt_deg: Annotated[float, Gt(0.0), Le(15.0)] = 3.0
    top_azimuth_deg: Annotated[float, Ge(0.0), Le(360.0)] | None = None
    top_within_deg: Annotated[float, Gt(0.0), Le(180.0)] = 30.0

    def __post_init__(self) -> None:
        """Refuse an invalid pose."""
        require_bounds(self, section_path="first_pose")
