"""The sun in one ordinary image: the plateau that it saturates, and the circle through the plateau's rim."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import NamedTuple, TypeVar

import cv2
import numpy as np

from sunarc.common.array_types import BoolArray, Image
from sunarc.common.findings import Finding
from sunarc.detection.photo import candidates
from sunarc.detection.photo.plateau import circle_box
from sunarc.detection.photo.rim import Rim
from sunarc.detection.photo.urquhart2016 import locate, split_planes
from sunarc.detection.values import Bayer, Detection, Expectation, Verdict, require_photo

# Which of the candidates is the sun's, and whether its position is worth using at its sigma.

_MIN_SHARE = 0.5
"""Share of the rays on which the rim must follow the circle."""
_MAX_SCATTER = 0.16
"""Scatter of the rim over the radius; the sun's, thin cloud before it, had 0.15 and less on real images."""
_MAX_NEAR, _MAX_FAR = 0.915, 0.86
"""Light at 1.7 and 2.6 radii above which it does not stand out. Of 2,447 patches of real cloud half had more than 0.94
and 0.925; of the suns 19 of 20 had less than 0.91 and 0.86."""
_MIN_FAR = 0.5
"""Light at 2.6 radii below which it is a lamp or the moon at night: by day it had 0.6 and more on real images."""
_STEEPEST = 0.9
"""Fall of the light to 1.7 radii over that to 2.6, above which it is an edge and no glare: real suns had 0.23 to 0.89,
a white roof has 1."""
_AUREOLE, _AUREOLE_LIGHTER, _AUREOLE_FAR, _DAY = 1.15, 0.12, 0.33, 0.15
"""Light at 2.6 radii over the sky's median, part of the sky above it, that light and that median over the plateau. A
sun with an edge (short exposure) differs from a roof and from a lamp at night by its aureole: suns had 1.19, 0.33 and
0.12 and more, 0.09 and less (docs/studies.md, "A day of clouds"), lamps 0.30 and 0.13 and less. With none that part
was 0.07 and less about 40 suns, 0.15 and more about hills of cloud."""
_LEAST_IN_DARK = 0.01
"""Of the smaller side, with a prediction: a smaller radius with an edge in a dark sky is a lamp's."""
_MIN_FLAT, _MIN_FLAT_PREDICTED = 0.6, 0.2
"""Share of the plateau that is level: nine of ten real suns had 0.82 and more, nine of ten patches of cloud 0.54 and
less. A small sun in haze, which a prediction names, has 0.25."""
_MAX_SIGMA_RADIUS = 0.2
"""Of the radius: a less certain position is of no use either (0.01 of the smaller side is 1.9 degrees where that is
180)."""
_MAX_SIGMA_PX = 0.6  # a sigma up to this is always of use
_OFF_GLARE_RADIUS = 0.3  # of the radius: within it a plateau is in the middle of the glare
_MAX_RADIUS = 0.09
"""Of the smaller side, without a prediction: thin cloud before the sun gave 0.09 at most."""
_MAX_ELLIPTICITY = 0.35
"""1 - minor/major axis of a plateau without an edge, without a prediction: suns of five real series had 0.31 and less
(with an edge, in short exposures, 0.47), a contrail had 0.39."""
_OTHER_PLATEAUS, _OTHER_AREA = 2.0, 0.001
"""Plateau areas, and of the square of the smaller side, for other parts as light, without a prediction: real suns had
1.8 plateaus and less, text has up to 0.001; overcast is as light in many places."""


class Judged(NamedTuple):
    """Candidate with its verdict and the deciding finding."""

    seen: candidates.Candidate
    verdict: Verdict
    finding: Finding


def choose_candidate(seen: list[candidates.Candidate], expectation: Expectation | None) -> Judged:
    """Return the most sun-like candidate with its verdict.

    Those within a prediction's reach come first, what stands out from the sky before what does not.
    """
    judged = [Judged(each, *_judge_candidate(each, expectation)) for each in seen]
    order = {"reflection": 2, "hidden": 1}
    return max(judged, key=lambda each: (-order.get(each.verdict, 0), each.seen.score))


def _judge_candidate(seen: candidates.Candidate, expectation: Expectation | None) -> tuple[Verdict, Finding]:
    if expectation is None:
        return (
            edge(seen, has_aureole=lies_in_aureole(seen))
            or _find_fault(seen)
            or _find_cloud_signs(seen, _MIN_FLAT, seen.off_glare_px)
            or _doubt_cloud_region(seen)
            or _make_clear_verdict(seen.rim)
        )
    distance = math.hypot(seen.rim.x - expectation.x_px, seen.rim.y - expectation.y_px)
    if distance > candidates.REACH_SIGMAS * math.hypot(expectation.uncertainty_px, seen.sigma_px) + candidates.REACH_PX:
        return "reflection", Finding("blob_displaced", {"distance_px": distance})
    return (
        edge(seen, has_aureole=_may_have_aureole(seen))
        or _find_fault(seen)
        or _find_cloud_signs(seen, _MIN_FLAT_PREDICTED, seen.off_local_glare_px)
        or _make_clear_verdict(seen.rim)
    )


def _make_clear_verdict(rim: Rim) -> tuple[Verdict, Finding]:
    return "clear", Finding("blob_found", {"diameter_px": 2.0 * rim.radius, "share": rim.share})


def edge(seen: candidates.Candidate, *, has_aureole: bool) -> tuple[Verdict, Finding] | None:
    """Return the reason why a round region with a sharp edge may be a white roof, a lamp or a gap in cloud."""
    rim = seen.rim
    is_glare = 1.0 - rim.near <= _STEEPEST * (1.0 - rim.far)
    if rim.near < candidates.MIN_NEAR or rim.far < _MIN_FAR:
        is_glare = has_aureole and (is_glare or rim.edged)
    if is_glare:
        return None
    return "hidden", Finding("blob_edged", {"near": rim.near, "far": rim.far})


def lies_in_aureole(seen: candidates.Candidate) -> bool:
    """Return whether the light about a round region is the sun's aureole: lighter than the sky, and nothing else is."""
    far = seen.rim.far
    is_lightest = far >= max(_AUREOLE * seen.sky, _AUREOLE_FAR) and seen.lighter <= _AUREOLE_LIGHTER
    return is_lightest and seen.rim.near >= far and seen.sky >= _DAY


def _may_have_aureole(seen: candidates.Candidate) -> bool:
    """Return whether the light about a round region at a predicted place may be the sun's aureole."""
    return seen.sky >= _DAY or (seen.rim.edged and seen.rim.radius >= _LEAST_IN_DARK * seen.size_px)


def _find_fault(seen: candidates.Candidate) -> tuple[Verdict, Finding] | None:
    """Return the reason why a round region cannot be used at any place."""
    rim = seen.rim
    if rim.near > _MAX_NEAR or rim.far > _MAX_FAR:
        return "hidden", Finding("blob_flat", {"near": rim.near, "far": rim.far})
    if rim.share < _MIN_SHARE:
        return "partly_covered", Finding("blob_one_sided", {"share": rim.share, "limit": _MIN_SHARE})
    if rim.scatter > _MAX_SCATTER * rim.radius:
        return "veiled", Finding("blob_uneven", {"scatter": rim.scatter / rim.radius})
    if seen.sigma_px > max(min(candidates.MAX_SIGMA * seen.size_px, _MAX_SIGMA_RADIUS * rim.radius), _MAX_SIGMA_PX):
        return "veiled", Finding("blob_centre_uncertain", {"sigma_px": seen.sigma_px})
    return None


def _find_cloud_signs(seen: candidates.Candidate, min_flat: float, off_px: float) -> tuple[Verdict, Finding] | None:
    """Return the reason why a round region may be a patch of bright cloud."""
    if seen.rim.flat < min_flat:
        return "veiled", Finding("blob_not_clipped", {"flat": seen.rim.flat})
    if off_px > max(candidates.OFF_GLARE * seen.size_px, _OFF_GLARE_RADIUS * seen.rim.radius):
        return "veiled", Finding("blob_off_glare", {"distance_px": off_px})
    return None


def _doubt_cloud_region(seen: candidates.Candidate) -> tuple[Verdict, Finding] | None:
    """Return the reason why a round region may belong to a cloud: too wide, not alone, or off the aureole's middle."""
    radius = seen.rim.radius / seen.size_px
    if radius > _MAX_RADIUS:
        return "veiled", Finding("blob_wide", {"radius": radius})
    if not seen.rim.edged and seen.rim.ellipticity > _MAX_ELLIPTICITY:
        return "veiled", Finding("blob_elongated", {"ellipticity": seen.rim.ellipticity})
    if seen.other_area > max(_OTHER_PLATEAUS * math.pi * radius**2, _OTHER_AREA):
        return "veiled", Finding("blob_not_alone", {"area": seen.other_area})
    if seen.lighter > _AUREOLE_LIGHTER:
        return "veiled", Finding("blob_flat", {"near": seen.rim.near, "far": seen.rim.far})
    return None


_ALL_WHITE, _SATURATED = 0.98, 0.995  # of full scale
_SPARSE = 16  # rows and columns from one to the next of those that tell the background
_MAX_APPARENT_ZENITH_DEG = 89.6
"""A lower sun is below the horizon: at 89.6 degrees the whole disc (radius 0.27 degrees) is still above it."""


class Photo(NamedTuple):
    """An ordinary or HDR image.

    image : (rows, columns) or (rows, columns, 3) uint8 or uint16; the colours' order does not matter. full_scale : its
    largest count. exposure_us : None where not known. static : pixels that stand still in the camera's images
    (`static_mask`), (rows, columns) or reduced; they do not take part. bayer : colours of a raw mosaic; None where the
    image has no sun.
    """

    image: Image
    full_scale: int
    exposure_us: float | None = None
    static: BoolArray | None = None
    bayer: Bayer | None = None


def detect_sun_in_photo(
    photo: Photo,
    *,
    expectation: Expectation | None = None,
    robust: bool = True,
    elsewhere: bool = True,
) -> Detection:
    """Find the sun in an ordinary or HDR image.

    Parameters
    ----------
    photo : the image.
    expectation : where the sun should be, where known: plateaus within 5 of its sigmas (and 2 px) count alone, and are
        looked for in a window about it.
    robust : answer with the rim's circle; otherwise with the medians of the paper's estimators.
    elsewhere : where nothing is at a predicted place, the whole image is searched, and a sun elsewhere is given as a
        reflection, not accepted; else it is hidden, at a fifth of the cost.

    Returns
    -------
    What was seen, method "paper"; px, (0, 0) the centre of the top-left pixel. Accepted: its sigma may be relied on.

    Raises
    ------
    InputError : the array is not an image.
    """
    require_photo(photo.image, full_scale=photo.full_scale, bayer=photo.bayer)
    zenith = None if expectation is None else expectation.apparent_zenith
    if zenith is not None and zenith > math.radians(_MAX_APPARENT_ZENITH_DEG):
        below = Finding("sun_below_horizon", {"zenith_deg": math.degrees(zenith)})
        return _make_rejection("below_horizon", below, photo.exposure_us)
    shown, (left, top) = framed(photo)
    place = None if expectation is None else moved(expectation, -left, -top)
    found = None if place is None else _detect_near_prediction(shown, place, elsewhere=elsewhere)
    found = _detect_in_whole_image(shown, place) if found is None else found
    found = found if robust or found.x_px is None else _locate_as_paper(found, shown, zenith)
    return moved(found, left, top)


def framed(photo: Photo) -> tuple[Photo, tuple[int, int]]:
    """Return the crop of an image around a small image circle, and the crop's first column and row."""
    box = circle_box(photo.image)
    return (photo, (0, 0)) if box is None else (cut_out(photo, box), (box[1].start, box[0].start))


def cut_out(photo: Photo, box: tuple[slice, slice]) -> Photo:
    """Return some rows and columns of an image."""
    static = photo.static
    if static is not None:
        rows, columns = photo.image.shape[:2]
        enlarged = cv2.resize(static.view(np.uint8), (columns, rows), interpolation=cv2.INTER_NEAREST)
        static = np.ascontiguousarray(np.asarray(enlarged)[box]).view(np.bool_)
    return photo._replace(image=photo.image[box], static=static)


_Place = TypeVar("_Place", Detection, Expectation)


def moved(place: _Place, columns: int, rows: int) -> _Place:
    """Return a place shifted by columns and rows."""
    if place.x_px is None or place.y_px is None or not (columns or rows):
        return place
    return replace(place, x_px=place.x_px + columns, y_px=place.y_px + rows)


def _detect_near_prediction(photo: Photo, expectation: Expectation, *, elsewhere: bool) -> Detection | None:
    """Return the candidate at a predicted place; None where the rest of the image has to be searched.

    Light is searched in a window about the place; in the whole image where a plateau is too wide for the window.
    """
    image, full_scale, exposure_us, static, bayer = photo
    step = candidates.window_step(image, bayer)
    part = candidates.part_near(image, expectation, step=step, static=static, bayer=bayer)
    seen = candidates.candidates_near(part, full_scale=full_scale)
    if seen is None:
        part = candidates.part_near(image, expectation, step=step, static=static, bayer=bayer, complete=True)
        seen = candidates.candidates_near(part, full_scale=full_scale)
    best = choose_candidate(seen, expectation) if seen else None
    if best is not None and not (elsewhere and best.verdict == "reflection"):
        return _make_detection(best, part, photo)
    return None if elsewhere else _make_empty_detection(part, full_scale, exposure_us)


def _detect_in_whole_image(photo: Photo, expectation: Expectation | None) -> Detection:
    part = candidates.whole_part(photo.image, static=photo.static, bayer=photo.bayer)
    seen = candidates.candidates_in(part, full_scale=photo.full_scale)
    if seen:
        return _make_detection(choose_candidate(seen, expectation), part, photo)
    return _make_empty_detection(part, photo.full_scale, photo.exposure_us)


def _make_empty_detection(part: candidates.ImagePart, full_scale: int, exposure_us: float | None) -> Detection:
    peak = float(part.plane.max(initial=0)) / full_scale
    return _make_rejection(*_explain_missing_sun(part.plane, peak, full_scale), exposure_us, peak)


def _explain_missing_sun(plane: Image, peak: float, full_scale: int) -> tuple[Verdict, Finding]:
    if peak < candidates.MIN_LEVEL:
        return "hidden", Finding("image_dark", {"peak": peak})
    level = float(np.median(plane[::8, ::8])) / full_scale
    if level >= _ALL_WHITE:
        return "saturated", Finding("image_saturated", {"level": level, "limit": _ALL_WHITE})
    return "hidden", Finding("no_round_region")


def _make_rejection(
    verdict: Verdict, finding: Finding, exposure_us: float | None, peak: float | None = None
) -> Detection:
    return Detection(
        method="paper",
        accepted=False,
        verdict=verdict,
        findings=(finding,),
        peak_fraction=peak,
        exposure_us=exposure_us,
    )


def _make_detection(best: Judged, part: candidates.ImagePart, photo: Photo) -> Detection:
    rim, full_scale = best.seen.rim, photo.full_scale
    return Detection(
        method="paper",
        accepted=best.verdict == "clear",
        verdict=best.verdict,
        findings=(best.finding,),
        x_px=rim.x,
        y_px=rim.y,
        sigma_px=best.seen.sigma_px,
        peak_fraction=rim.level / full_scale,
        background_fraction=float(np.median(_sample_plane(photo, part))) / full_scale,
        radius_px=rim.radius,
        ellipticity=rim.ellipticity,
        saturated_px=int(np.count_nonzero(part.plane >= _SATURATED * full_scale)),
        spread_px=rim.spread,
        exposure_us=photo.exposure_us,
    )


def _sample_plane(photo: Photo, part: candidates.ImagePart) -> Image:
    """Return every 16th row and column of the whole plane."""
    if part.cell == 1:
        return candidates.faintest_plane(photo.image[::_SPARSE, ::_SPARSE], None)
    whole = part if part.near is None else candidates.whole_part(photo.image, static=None, bayer=photo.bayer)
    return whole.plane[::_SPARSE, ::_SPARSE]


def _locate_as_paper(found: Detection, photo: Photo, zenith: float | None) -> Detection:
    """Return a detection with the position of the paper's estimators in place of the rim's."""
    estimates = locate(split_planes(photo.image, full_scale=photo.full_scale), apparent_zenith=zenith)
    if estimates is None:
        return found
    x, y = estimates.position
    return replace(found, x_px=x, y_px=y, spread_px=estimates.spread_px)
