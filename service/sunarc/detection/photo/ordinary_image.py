"""The sun in one ordinary image: the plateau that it saturates, and the circle through the plateau's rim."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from sunarc.array_types import BoolArray, Image
from sunarc.detection.frames import require_photo
from sunarc.detection.photo.blob_bias import Lens, bias_at
from sunarc.detection.photo.candidates import MIN_LEVEL, candidates_in, plane_of
from sunarc.detection.photo.classify import Judged, best_of
from sunarc.detection.photo.urquhart2016 import locate, planes_of
from sunarc.detection.values import Bayer, Detection, Expectation, Verdict
from sunarc.findings import Finding

_ALL_WHITE, _SATURATED = 0.98, 0.995  # of full scale
_MAX_APPARENT_ZENITH_DEG = 89.6
"""A lower sun is below the horizon: at 89.6 degrees the whole disc (radius 0.27 degrees) is still above it."""


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
    plane = plane_of(image, bayer)
    seen = candidates_in(image, full_scale=full_scale, static=static, bayer=bayer)
    if not seen:
        peak = float(plane.max(initial=0)) / full_scale
        return _none(*_why_none(plane, peak, full_scale), exposure_us, peak)
    best = best_of(seen, expectation)
    found = _detection(best, plane, full_scale, exposure_us)
    return _with_bias(found if robust else _papers(found, image, full_scale, zenith), lens)


def _why_none(plane: Image, peak: float, full_scale: int) -> tuple[Verdict, Finding]:
    if peak < MIN_LEVEL:
        return "hidden", Finding("image_dark", {"peak": peak})
    if float(np.median(plane[::8, ::8])) >= _ALL_WHITE * full_scale:
        return "saturated", Finding("image_saturated")
    return "hidden", Finding("no_round_region")


def _none(verdict: Verdict, finding: Finding, exposure_us: float | None, peak: float | None = None) -> Detection:
    return Detection(
        method="paper",
        accepted=False,
        verdict=verdict,
        findings=(finding,),
        peak_fraction=peak,
        exposure_us=exposure_us,
    )


def _detection(best: Judged, plane: Image, full_scale: int, exposure_us: float | None) -> Detection:
    rim = best.seen.rim
    return Detection(
        method="paper",
        accepted=best.verdict == "clear",
        verdict=best.verdict,
        findings=(best.finding,),
        x_px=rim.x,
        y_px=rim.y,
        sigma_px=best.seen.sigma_px,
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
