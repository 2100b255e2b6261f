"""The sun in one ordinary image: the plateau that it saturates, and the circle through the plateau's rim."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from sunarc.array_types import BoolArray, Image
from sunarc.detection.frames import require_photo
from sunarc.detection.photo.blob_bias import Lens, bias_at
from sunarc.detection.photo.candidates import MIN_LEVEL, candidates_in, candidates_near, window_step
from sunarc.detection.photo.classify import Judged, best_of
from sunarc.detection.photo.part import Part, part_near, plane_of, whole_part
from sunarc.detection.photo.urquhart2016 import locate, planes_of
from sunarc.detection.values import Bayer, Detection, Expectation, Verdict
from sunarc.findings import Finding

_ALL_WHITE, _SATURATED = 0.98, 0.995  # of full scale
_SPARSE = 16  # rows and columns from one to the next of those that tell the background
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
    elsewhere: bool = True,
) -> Detection:
    """Find the sun in an ordinary or HDR image.

    Parameters
    ----------
    image : (rows, columns) or (rows, columns, 3) uint8 or uint16; the colours' order does not matter.
    full_scale : its largest count.
    expectation : where the sun should be, where known: plateaus within 5 of its sigmas (and 2 px) count alone, and are
        looked for in a window about it.
    static : pixels that stand still in the camera's images (`static_mask`), (rows, columns) or reduced; they do not
        take part.
    bayer : colours of a raw mosaic; None where the image is none.
    robust : answer with the rim's circle; otherwise with the medians of the paper's estimators.
    lens : where given, the expected radial bias of the plateau is reported (never subtracted).
    exposure_us : returned in the result.
    elsewhere : where nothing is at a predicted place, the whole image is searched, and a sun elsewhere is given as a
        reflection, not accepted; else it is hidden, at a fifth of the cost.

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
    given = _Given(image, full_scale, static, bayer, exposure_us)
    found = None if expectation is None else _near(given, expectation, elsewhere=elsewhere)
    found = _anywhere(given, expectation) if found is None else found
    return _with_bias(found if robust or found.x_px is None else _papers(found, image, full_scale, zenith), lens)


class _Given(NamedTuple):
    image: Image
    full_scale: int
    static: BoolArray | None
    bayer: Bayer | None
    exposure_us: float | None


def _near(given: _Given, expectation: Expectation, *, elsewhere: bool) -> Detection | None:
    """Return what is at a predicted place; None where nothing is, and the rest of the image has to be searched.

    Light is looked at in a window about the place; in the whole image where a plateau is too wide for the window.
    """
    image, full_scale, static, bayer, exposure_us = given
    step = window_step(image, bayer)
    part = part_near(image, expectation, step=step, static=static, bayer=bayer)
    seen = candidates_near(part, full_scale=full_scale)
    if seen is None:
        part = part_near(image, expectation, step=step, static=static, bayer=bayer, complete=True)
        seen = candidates_near(part, full_scale=full_scale)
    best = best_of(seen, expectation) if seen else None
    if best is not None and not (elsewhere and best.verdict == "reflection"):
        return _detection(best, part, given)
    return None if elsewhere else _nothing(part, full_scale, exposure_us)


def _anywhere(given: _Given, expectation: Expectation | None) -> Detection:
    image, full_scale, static, bayer, exposure_us = given
    part = whole_part(image, static=static, bayer=bayer)
    seen = candidates_in(part, full_scale=full_scale)
    if seen:
        return _detection(best_of(seen, expectation), part, given)
    return _nothing(part, full_scale, exposure_us)


def _nothing(part: Part, full_scale: int, exposure_us: float | None) -> Detection:
    peak = float(part.plane.max(initial=0)) / full_scale
    return _none(*_why_none(part.plane, peak, full_scale), exposure_us, peak)


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


def _detection(best: Judged, part: Part, given: _Given) -> Detection:
    rim, full_scale = best.seen.rim, given.full_scale
    return Detection(
        method="paper",
        accepted=best.verdict == "clear",
        verdict=best.verdict,
        findings=(best.finding,),
        x_px=rim.x,
        y_px=rim.y,
        sigma_px=best.seen.sigma_px,
        peak_fraction=rim.level / full_scale,
        background_fraction=float(np.median(_sparse(given, part))) / full_scale,
        radius_px=rim.radius,
        ellipticity=rim.ellipticity,
        saturated_px=int(np.count_nonzero(part.plane >= _SATURATED * full_scale)),
        spread_px=rim.spread,
        exposure_us=given.exposure_us,
    )


def _sparse(given: _Given, part: Part) -> Image:
    """Return every 16th row and column of the whole plane."""
    if part.cell == 1:
        return plane_of(given.image[::_SPARSE, ::_SPARSE], None)
    whole = part if part.near is None else whole_part(given.image, static=None, bayer=given.bayer)
    return whole.plane[::_SPARSE, ::_SPARSE]


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
