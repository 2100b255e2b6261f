"""The sun in one ordinary image: the plateau that it saturates, and the circle through the plateau's rim."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import NamedTuple

import cv2
import numpy as np

from sunarc.array_types import BoolArray, Image
from sunarc.detection.frames import require_photo
from sunarc.detection.photo.blob_bias import Lens, bias_at
from sunarc.detection.photo.plateau import faintest_colour, faintest_of_mosaic, plateaus
from sunarc.detection.photo.rim import RAYS, Rim, rim_of
from sunarc.detection.photo.urquhart2016 import locate, planes_of
from sunarc.detection.values import Bayer, Detection, Expectation, Verdict
from sunarc.findings import Finding

_MIN_LEVEL = 0.35
"""Of full scale: a darker plateau is no sun in an ordinary exposure (a camera that clips at 160 of 255 has 0.63)."""
_ALL_WHITE, _SATURATED = 0.98, 0.995  # of full scale
_MAX_RADIUS_FRACTION = 0.12
"""A plateau wider than this share of the image's smaller side is no sun; thin cloud before it gave 0.11 at most."""
_MIN_SHARE = 0.4
"""Share of the rays on which the rim must follow the circle."""
_MAX_SCATTER = 0.12
"""Scatter of the rim over the radius."""
_MIN_NEAR = 0.55
"""Light at 1.7 radii over the plateau's (in counts), below which it is no sun in its glare but something white."""
_NEAR_MARGIN = 0.1
"""By so much the light beside the inscribed circle may be darker than beside the rim."""
_MAX_NEAR = 0.945
"""Light there above which it does not stand out: a patch of an evenly bright cloud (real ones had 0.95 and more)."""
_MAX_SIGMA = 0.006
"""Of the smaller side: a less certain position is of no use; 180 degrees across, it is about a degree."""
_MIN_SIGMA_PX = 0.3
_MIN_SIGMA_RADIUS = 0.015
"""1-sigma per axis over the radius, at best: the plateau's own asymmetry, from hand-labelled real images."""
_CORRELATED_RAYS = 12.0  # neighbouring rays see the same JPEG block or streak
_SPREAD, _OFFSET = 0.7, 0.25  # weights of the circles' spread and of the distance to the inscribed circle
_MAX_APPARENT_ZENITH_DEG = 89.6
"""A lower sun is below the horizon: at 89.6 degrees the whole disc (radius 0.27 degrees) is still above it."""
_REACH_SIGMAS, _REACH_PX = 5.0, 2.0
"""A plateau within so many sigmas (and px) of the prediction is the sun's."""


class Candidate(NamedTuple):
    """A plateau with a rim, in px of the image, and its position's 1-sigma per axis."""

    rim: Rim
    sigma_px: float

    @property
    def score(self) -> float:
        """Say how sun-like it is: large, round, bright."""
        rim = self.rim
        uneven = (rim.scatter / (0.1 * rim.radius)) ** 2 + (rim.spread / (0.2 * rim.radius)) ** 2
        return rim.radius * rim.share**2 * rim.level**2 / (1.0 + uneven)


def detect_sun_in_photo(
    image: Image,
    *,
    full_scale: int,
    expectation: Expectation | None = None,
    static: BoolArray | None = None,
    bayer: Bayer | None = None,
    robust: bool = True,
    lens: Lens | None = None,
    exposure_us: float | None = None,
) -> Detection:
    """Find the sun in an ordinary or HDR image.

    Parameters
    ----------
    image : (rows, columns) or (rows, columns, 3) uint8 or uint16; the colours' order does not matter.
    full_scale : its largest count.
    expectation : where the sun should be, where known: plateaus within 5 of its sigmas (and 2 px) count alone. A sun
        elsewhere is then given as a reflection, not accepted.
    static : pixels that stand still in the camera's images (`static_mask`), (rows, columns) or reduced; they do not
        take part.
    bayer : colours of a raw mosaic; None where the image is none.
    robust : answer with the rim's circle; otherwise with the medians of the paper's estimators.
    lens : where given, the expected radial bias of the plateau is reported (never subtracted).
    exposure_us : returned in the result.

    Returns
    -------
    What was seen, method "paper"; px, (0, 0) the centre of the top-left pixel. Accepted: its sigma may be relied on.

    Raises
    ------
    InputError : the array is no image.
    """
    require_photo(image, full_scale=full_scale)
    zenith = None if expectation is None else expectation.apparent_zenith
    if zenith is not None and zenith > math.radians(_MAX_APPARENT_ZENITH_DEG):
        below = Finding("sun_below_horizon", {"zenith_deg": math.degrees(zenith)})
        return _none("below_horizon", below, exposure_us)
    plane = _plane_of(image, bayer)
    seen = candidates_in(image, full_scale=full_scale, static=static, bayer=bayer)
    if not seen:
        peak = float(plane.max(initial=0)) / full_scale
        return _none(*_why_none(plane, peak, full_scale), exposure_us, peak)
    best = _best(seen, min(image.shape[:2]), expectation)
    found = _detection(best, plane, full_scale, exposure_us)
    return _with_bias(found if robust else _papers(found, image, full_scale, zenith), lens)


def candidates_in(
    image: Image,
    *,
    full_scale: int,
    least_level: float = _MIN_LEVEL,
    least_near: float = _MIN_NEAR - _NEAR_MARGIN,
    static: BoolArray | None = None,
    bayer: Bayer | None = None,
) -> list[Candidate]:
    """Return the plateaus that have a rim.

    Parameters
    ----------
    image, full_scale, static, bayer : as in `detect_sun_in_photo`.
    least_level, least_near : of full scale and of a plateau's level, as in `plateaus`.
    """
    plane = _plane_of(image, bayer)
    hidden = _enlarged(static, plane)
    largest = _MAX_RADIUS_FRACTION * min(plane.shape)
    found = plateaus(plane, least_level=least_level * full_scale, least_near=least_near, static=hidden)
    rims = [rim_of(plane, each, static=hidden) for each in found if each.radius <= largest]
    seen = [Candidate(rim, _sigma_px(rim)) for rim in rims if rim is not None and rim.radius <= largest]
    return seen if bayer is None else [_of_mosaic(each) for each in seen]


def _sigma_px(rim: Rim) -> float:
    """Return the 1-sigma per axis of a rim's centre."""
    independent = max(rim.share * RAYS / _CORRELATED_RAYS, 1.0)
    # Of n directions all around, half of the weight is that of either axis; those of an arc say less.
    scatter = rim.scatter * math.sqrt(2.0 / independent) / rim.share
    least = math.hypot(_MIN_SIGMA_PX, _MIN_SIGMA_RADIUS * rim.radius)
    return math.hypot(least, scatter, _SPREAD * rim.spread, _OFFSET * rim.offset)


def _plane_of(image: Image, bayer: Bayer | None) -> Image:
    return faintest_colour(image) if bayer is None or image.ndim != 2 else faintest_of_mosaic(image)


def _of_mosaic(seen: Candidate) -> Candidate:
    """Return a candidate of the half-sized plane in px of the mosaic."""
    rim = seen.rim
    lengths = {name: 2.0 * getattr(rim, name) for name in ("radius", "scatter", "spread", "offset")}
    return Candidate(rim._replace(x=2.0 * rim.x + 0.5, y=2.0 * rim.y + 0.5, **lengths), 2.0 * seen.sigma_px)


def _enlarged(static: BoolArray | None, plane: Image) -> BoolArray | None:
    """Return the mask of what stands still in the size of the plane."""
    if static is None or static.shape == plane.shape:
        return static
    size = (plane.shape[1], plane.shape[0])
    return np.asarray(cv2.resize(static.astype(np.uint8), size, interpolation=cv2.INTER_NEAREST), dtype=np.bool_)


def _why_none(plane: Image, peak: float, full_scale: int) -> tuple[Verdict, Finding]:
    if peak < _MIN_LEVEL:
        return "hidden", Finding("image_dark", {"peak": peak})
    if float(np.median(plane[::8, ::8])) >= _ALL_WHITE * full_scale:
        return "saturated", Finding("image_saturated")
    return "hidden", Finding("no_round_region")


def _best(seen: list[Candidate], size: int, expectation: Expectation | None) -> tuple[Candidate, Verdict, Finding]:
    """Return the most sun-like candidate with its verdict: an accepted one, else one within the prediction's reach."""
    judged = [(each, *_verdict(each, size, expectation)) for each in seen]
    for verdicts in ({"clear"}, {"veiled", "partly_covered", "hidden"}):
        among = [each for each in judged if each[1] in verdicts]
        if among:
            return max(among, key=lambda each: each[0].score)
    return max(judged, key=lambda each: each[0].score)


def _beyond_px(seen: Candidate, expectation: Expectation | None) -> float:
    """Return how far a candidate is beyond the reach of a prediction, px; 0 or less within it."""
    if expectation is None:
        return 0.0
    distance = math.hypot(seen.rim.x - expectation.x_px, seen.rim.y - expectation.y_px)
    return distance - _REACH_SIGMAS * math.hypot(expectation.uncertainty_px, seen.sigma_px) - _REACH_PX


def _verdict(seen: Candidate, size: int, expectation: Expectation | None) -> tuple[Verdict, Finding]:
    rim = seen.rim
    if expectation is not None and _beyond_px(seen, expectation) > 0.0:
        distance = math.hypot(rim.x - expectation.x_px, rim.y - expectation.y_px)
        return "reflection", Finding("blob_displaced", {"distance_px": distance})
    if not _MIN_NEAR <= rim.near <= _MAX_NEAR:
        return "hidden", Finding("blob_edged" if rim.near < _MIN_NEAR else "blob_flat", {"near": rim.near})
    if rim.share < _MIN_SHARE:
        return "partly_covered", Finding("blob_one_sided", {"share": rim.share})
    if rim.scatter > _MAX_SCATTER * rim.radius:
        return "veiled", Finding("blob_uneven", {"scatter": rim.scatter / rim.radius})
    if seen.sigma_px > max(_MAX_SIGMA * size, 2.0 * _MIN_SIGMA_PX):
        return "veiled", Finding("blob_centre_uncertain", {"sigma_px": seen.sigma_px})
    return "clear", Finding("blob_found", {"diameter_px": 2.0 * rim.radius, "share": rim.share})


def _none(verdict: Verdict, finding: Finding, exposure_us: float | None, peak: float | None = None) -> Detection:
    return Detection(
        method="paper",
        accepted=False,
        verdict=verdict,
        findings=(finding,),
        peak_fraction=peak,
        exposure_us=exposure_us,
    )


def _detection(
    best: tuple[Candidate, Verdict, Finding], plane: Image, full_scale: int, exposure_us: float | None
) -> Detection:
    (rim, sigma_px), verdict, finding = best
    return Detection(
        method="paper",
        accepted=verdict == "clear",
        verdict=verdict,
        findings=(finding,),
        x_px=rim.x,
        y_px=rim.y,
        sigma_px=sigma_px,
        peak_fraction=rim.level / full_scale,
        background_fraction=float(np.median(plane[::16, ::16])) / full_scale,
        radius_px=rim.radius,
        ellipticity=rim.ellipticity,
        saturated_px=int(np.count_nonzero(plane >= _SATURATED * full_scale)),
        spread_px=rim.spread,
        exposure_us=exposure_us,
    )


def _papers(found: Detection, image: Image, full_scale: int, zenith: float | None) -> Detection:
    """Return a detection with the position of the paper's estimators in place of the rim's."""
    estimates = locate(planes_of(image, full_scale=full_scale), apparent_zenith=zenith)
    if estimates is None:
        return found
    x, y = estimates.position
    return replace(found, x_px=x, y_px=y, spread_px=estimates.spread_px)


def _with_bias(found: Detection, lens: Lens | None) -> Detection:
    if lens is None or found.x_px is None or found.y_px is None or found.radius_px is None:
        return found
    return replace(found, radial_bias_px=bias_at(lens, x_px=found.x_px, y_px=found.y_px, radius_px=found.radius_px))
