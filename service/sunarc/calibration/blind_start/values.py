"""What a blind start is given, and what it returns."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Annotated

from annotated_types import Gt, Le

from sunarc.bounds import require_bounds
from sunarc.calibration.model.options import ImageCircle
from sunarc.detection.stars.matching import StarMatches
from sunarc.detection.stars.values import PredictedStars, Stars
from sunarc.findings import Finding
from sunarc.optics.camera import Camera
from sunarc.sky.night import NightSky


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class NightImage:
    """The detections of one image, and the sky at its moment.

    Attributes
    ----------
    unix_s : the middle of the exposure, seconds since 1970-01-01 UTC.
    stars : point sources, the brightest first.
    sky : stars and planets above the horizon, to V 5.5.
    """

    unix_s: float
    stars: Stars
    sky: NightSky


@dataclass(frozen=True, slots=True, kw_only=True)
class BlindOptions:
    """What is known of the camera before.

    Attributes
    ----------
    max_tilt_deg : how far its axis may lie from the zenith.
    circle : the image circle, where it is known; the axis is then looked for within 8 % of its radius of its centre,
        else of the image's.
    """

    max_tilt_deg: Annotated[float, Gt(0.0), Le(45.0)] = 20.0
    circle: ImageCircle | None = None

    def __post_init__(self) -> None:
        """Refuse what is no tilt."""
        require_bounds(self, section="blind start")


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class BlindStart:
    """A camera by the stars alone, or why there is none.

    Attributes
    ----------
    camera : the best one; None where nothing turned. To be used only where `accepted`.
    accepted : whether the stars of two images or more are named by it, and by no other.
    findings : why, or why not.
    predicted, stars, matches : of each image, in the order given: where the camera sees the stars, the detections
        that are not still, and which is which; empty where there is no camera.
    """

    accepted: bool
    findings: tuple[Finding, ...]
    camera: Camera | None = None
    predicted: tuple[PredictedStars, ...] = field(default=())
    stars: tuple[Stars, ...] = field(default=())
    matches: tuple[StarMatches, ...] = field(default=())
