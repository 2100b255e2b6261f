"""The sun in a stack of exposures of one time, and its disc in a short exposure in colours."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from sunarc.common.array_types import Image
from sunarc.common.errors import InputError
from sunarc.common.findings import Finding
from sunarc.detection.disc.detect import detect_sun
from sunarc.detection.photo.candidates import Candidate, candidates_in, whole_part
from sunarc.detection.photo.ordinary_image import (
    Photo,
    cut_out,
    detect_sun_in_photo,
    edge,
    lies_in_aureole,
    moved,
)
from sunarc.detection.photo.plateau import circle_box
from sunarc.detection.values import Detection, Expectation, Sensor

_TONES = 2.2
"""Exponent of the tones of 8 bits; images of more bits are taken for linear."""
_EIGHT_BITS, _LINEAR_SCALE = 255, 4095
_DARK = 0.03
"""Of full scale, of linear light: the median of an image in which the disc is looked for."""
_SMEAR_PX = 0.1
"""1-sigma that interpolated colours, tones and JPEG add to the disc's place: a stand-in's errors had up to 0.1 px."""
_SHAPED = frozenset(
    {"disc_found", "disc_poor_fit", "disc_residuals", "disc_uneven", "disc_without_limb", "disc_position_uncertain",
     "disc_in_bright_sky", "disc_faint", "disc_dimmed", "disc_wrong_size"}
)  # fmt: skip
"""Measures of a true dot in the disc's model: tones and JPEG fit no limb darkening."""
_LARGEST_ELLIPTICITY, _LARGEST_RADIUS = 0.45, 0.02
"""1 - minor/major axis, and radius over the image's smaller side, of a dot that may be the disc (4 times the sun's)."""


def linear_sum(image: Image, full_scale: int) -> Image:
    """Return the light of a colour image, (rows, columns), 0 to 3 * 4095: the mean of its colours, tones undone."""
    exponent = _TONES if full_scale == _EIGHT_BITS else 1.0
    light = _LINEAR_SCALE * (np.arange(full_scale + 1) / full_scale) ** exponent
    counts = np.round(light).astype(np.uint16)
    return np.asarray(counts[np.minimum(image, full_scale)].sum(axis=2, dtype=np.uint16))


def detect_disc_in_colours(photo: Photo, *, expectation: Expectation | None = None) -> Detection:
    """Find the sun's disc in a colour image of short exposure, by the disc's model on the sum of the linear colours.

    Parameters
    ----------
    photo : (rows, columns, 3).
    expectation : where the sun should be, where known.

    Returns
    -------
    What `detect_sun` says, its sigma with the smear of interpolated colours; accepted only where that model fits.
    """
    light = linear_sum(photo.image, photo.full_scale)
    sensor = Sensor.from_full_well(full_scale=3 * _LINEAR_SCALE)
    found = detect_sun(light, sensor=sensor, expectation=expectation, exposure_us=photo.exposure_us)
    return replace(found, sigma_px=None if found.sigma_px is None else math.hypot(found.sigma_px, _SMEAR_PX))


def is_short(photo: Photo) -> bool:
    """Return whether a colour image is so dark that the sun's disc is visible without glare."""
    if photo.image.ndim != 3:
        return False
    light = linear_sum(photo.image[::8, ::8], photo.full_scale)
    return float(np.median(light)) <= _DARK * 3 * _LINEAR_SCALE


class _DiscOfStack(NamedTuple):
    """Disc common to several short exposures: place, 1-sigma, and detection in the shortest of them."""

    x: float
    y: float
    sigma_px: float
    shortest: Detection
    frames: int


_SAME_PX = 1.0
_FEWEST = 2
_AS_SMALL = 1.2
"""Radius over the shortest exposure's: a wider dot is the disc with a glare that need not be centred on it."""
_TIMES_SKY = 60.0
"""Light of the disc over that of the sky: the sun has 1e5 without cloud; a reflection has less than the cloud's rim."""
_WIDE_GLARE, _SMALLEST_RING_PX = 3.0, 2.0
"""Radius of a clipped glare over the disc's that a lamp without a halo has before a bright cloud alone; least radius
for that and the rings."""
_RINGS = ((2.5, 4.0), (4.0, 6.0), (6.0, 8.0), (10.0, 14.0))
_CLIPPED_RING, _DARK_RING = 0.9, 0.002
"""Radii of rings over the disc's; light of full scale from which on a ring is clipped, and up to which it is dark."""
_FALLS_OFF, _FALLS_STEEPLY = 1.11, 2.0
"""Light of the near ring over the far one's: of drawn lamps mostly below 1.08; suns behind cloud that lets a third
through have 1.04 to 1.15. A steep fall needs no round glare about it, in images whose sky is clipped all about."""
_INWARDS, _AS_HALO = 1.15, 6.0
"""Its fall in the inner half over that in the outer: of bright clouds behind lamps at most 1.08, of drawn suns 1.3 to
2.7, of a real one 4.0; of lamps behind frosted glass 21 and more."""
_AUREOLE = 1.06
"""Light of the third ring over that of the fourth, where air scatters: of suns mostly 1.09 and more, of lamps 1.04 and
less unless the lens scatters their light as it does the sun's."""


def _find_common_disc(ordered: Sequence[Photo], expectation: Expectation | None) -> _DiscOfStack | None:
    """Return the disc that short exposures show at one place, the longest exposures coming first; None without one."""
    short = [each for each in ordered if is_short(each)]
    found = [detect_disc_in_colours(each, expectation=expectation) for each in reversed(short)]
    dots = [(one, each) for one, each in zip(found, reversed(short), strict=True) if _has_disc_shape(one, each)]
    if len(dots) < _FEWEST:
        return None
    first = dots[0][0]
    places = np.array([[one.x_px, one.y_px] for one, _ in dots], dtype=np.float64)
    same = np.linalg.norm(places - places[0], axis=1) <= _SAME_PX
    if np.count_nonzero(same) < max(_FEWEST, 0.5 * len(dots)):
        return None
    weights = np.array([one.sigma_px or math.inf for one, _ in dots]) ** -2.0
    radii = np.array([one.radius_px or math.inf for one, _ in dots])
    small = same & (radii <= _AS_SMALL * radii[0])
    x, y = np.average(places[small], axis=0, weights=weights[small])
    off = places - (x, y)
    scatter = math.sqrt(float(np.average(np.sum(off[small] ** 2, axis=1), weights=weights[small])) / 2.0)
    # by as much as the glare moves the others the clipped light of these may have moved them
    drift = float(np.linalg.norm(np.average(off[same], axis=0, weights=weights[same]))) / math.sqrt(2.0)
    sigma = max(math.hypot(first.sigma_px or math.inf, drift), scatter)
    return _DiscOfStack(float(x), float(y), sigma, first, int(np.count_nonzero(same)))


def _has_disc_shape(found: Detection, photo: Photo) -> bool:
    """Return whether the detection has the shape of a disc, though its light need not be the model's."""
    if found.x_px is None or found.sigma_px is None or found.findings[0].code not in _SHAPED:
        return False
    radius, size = found.radius_px or math.inf, min(photo.image.shape[:2])
    return (found.ellipticity or 0.0) <= _LARGEST_ELLIPTICITY and radius <= max(_LARGEST_RADIUS * size, 4.0)


def _judge_disc(disc: _DiscOfStack, ordered: Sequence[Photo], accepted: Sequence[Detection]) -> Detection:
    """Return the stack's sighting at the disc; rejected without glare about it, or where another place was accepted."""
    at = replace(
        disc.shortest, method="paper", accepted=True, verdict="clear", x_px=disc.x, y_px=disc.y, sigma_px=disc.sigma_px
    )
    elsewhere = [one for one in accepted if not _is_same_place(one, at)]
    if elsewhere:
        far = math.hypot((elsewhere[0].x_px or 0.0) - disc.x, (elsewhere[0].y_px or 0.0) - disc.y)
        return replace(
            at, accepted=False, verdict="reflection", findings=(Finding("blob_displaced", {"distance_px": far}),)
        )
    glare = [near for each in ordered if (near := _find_glare(each, at)) is not None]
    if not accepted and not (_outshines_sky(disc.shortest, ordered) and _has_halo(disc, glare, ordered)):
        return replace(at, accepted=False, verdict="hidden", findings=(Finding("disc_without_glare"),))
    wide = accepted[0] if accepted else disc.shortest
    diameter = 2.0 * (glare[0].rim.radius if glare else wide.radius_px or 0.0)
    share = glare[0].rim.share if glare else 1.0
    larger = disc.sigma_px / (disc.shortest.sigma_px or math.inf)
    mean = Finding("stack_mean", {"frames": disc.frames, "chi2": larger**2})
    return replace(at, findings=(Finding("blob_found", {"diameter_px": diameter, "share": share}), mean))


def _is_same_place(one: Detection, other: Detection) -> bool:
    distance = math.hypot((one.x_px or 0.0) - (other.x_px or 0.0), (one.y_px or 0.0) - (other.y_px or 0.0))
    reach = _AGREE_SIGMAS * math.hypot(one.sigma_px or 0.0, other.sigma_px or 0.0)
    return distance <= max(reach, _AGREE_RADIUS * max(one.radius_px or 0.0, other.radius_px or 0.0))


def _find_glare(photo: Photo, disc: Detection) -> Candidate | None:
    """Return the glare about the disc in an image of the day; None where none is."""
    if is_short(photo):
        return None
    part = whole_part(photo.image, static=photo.static, bayer=photo.bayer)
    found = candidates_in(part, full_scale=photo.full_scale)
    return next(
        (one for one in found if agrees(one, disc) and edge(one, has_aureole=lies_in_aureole(one)) is None), None
    )


def _has_halo(disc: _DiscOfStack, glare: Sequence[Candidate], ordered: Sequence[Photo]) -> bool:
    """Return whether light falls off about the disc as the sun's does in air and lens, beyond the clipped pixels.

    A lamp of the sun's radiance on a bright sky has an edge and then the sky; that of a cloud behind it falls off the
    farther out the more. One whose light the lens scatters as the sun's is like it in a single stack, and stands still
    in the next one.
    """
    if all(is_short(each) for each in ordered):  # of the night
        return False
    radius = max(disc.shortest.radius_px or 0.0, _SMALLEST_RING_PX)
    rows, columns = np.mgrid[: ordered[0].image.shape[0], : ordered[0].image.shape[1]]
    away = np.hypot(columns - disc.x, rows - disc.y) / radius
    rings = [(away >= least) & (away < most) for least, most in _RINGS]
    for each in ordered:
        near, middle, far, beyond = (_median_light(each.image[ring][None], each.full_scale) for ring in rings)
        if near < _CLIPPED_RING:  # the longest exposure of these has the least noise
            falls = near >= (_FALLS_OFF if glare else _FALLS_STEEPLY) * far
            outer = middle - far
            as_halo = _INWARDS * outer <= near - middle <= _AS_HALO * outer
            return far > _DARK_RING and falls and as_halo and far >= _AUREOLE * beyond
    return any(one.rim.radius >= _WIDE_GLARE * radius for one in glare)


def _median_light(image: Image, full_scale: int) -> float:
    """Return the median of the linear light of a colour image, of full scale; NaN where it has no pixel."""
    return float(np.median(linear_sum(image, full_scale))) / (3 * _LINEAR_SCALE) if image.size else math.nan


def _outshines_sky(dot: Detection, ordered: Sequence[Photo]) -> bool:
    """Return whether the disc is as much brighter than the sky as the sun is; True where exposures are unknown."""
    if dot.exposure_us is None or dot.peak_fraction is None:
        return True
    skies = [
        _median_light(each.image[::8, ::8], each.full_scale) / each.exposure_us
        for each in ordered
        if each.exposure_us is not None and not is_short(each)
    ]
    return not skies or dot.peak_fraction / dot.exposure_us >= _TIMES_SKY * max(skies)


_LEAST_LEVEL = 0.1
"""Of full scale: in a short exposure the disc need not be saturated."""
_AGREE_SIGMAS, _AGREE_RADIUS = 4.0, 0.35
"""Candidates of two exposures are of one thing within so many of their sigmas, or so much of the larger radius."""


def detect_sun_in_stack(exposures: Sequence[Photo], *, expectation: Expectation | None = None) -> Detection:
    """Find the sun in a stack of exposures of one time.

    Parameters
    ----------
    exposures : images of one size, in any order; where not all times are known, the lighter one is the longer one.
    expectation : as in `detect_sun_in_photo`.

    Returns
    -------
    Where short exposures in colours show the disc alone, and the glare of a longer one is about it, its place. Else the
    mean of the exposures that agree with what an ordinary exposure shows, weighted by their variances: a short
    exposure's plateau is the smallest, so that it rules. Where no exposure is accepted by itself, what the longest one
    shows.

    Raises
    ------
    InputError : no exposures, several sizes, or no images.
    """
    if not exposures:
        raise InputError(field="exposures", problem="none is given", remedy="give the images of one time")
    if len({each.image.shape for each in exposures}) > 1:
        raise InputError(field="exposures", problem="several sizes", remedy="give images of one size")
    ordered, left, top = _sort_longest_first(exposures), 0, 0
    if (box := circle_box(ordered[0].image)) is not None:
        ordered, left, top = [cut_out(each, box) for each in ordered], box[1].start, box[0].start
    place = None if expectation is None else moved(expectation, -left, -top)
    return moved(_detect_in_sorted_stack(ordered, place), left, top)


def _detect_in_sorted_stack(ordered: Sequence[Photo], expectation: Expectation | None) -> Detection:
    seen = [detect_sun_in_photo(each, expectation=expectation) for each in ordered]
    accepted = [found for found in seen if found.accepted]
    disc = _find_common_disc(ordered, expectation)
    if disc is not None:
        return _judge_disc(disc, ordered, accepted)
    if not accepted:
        return seen[0]
    anchor = min(accepted, key=lambda found: found.sigma_px or math.inf)
    agreeing = [
        (near, each.exposure_us) for each in ordered if (near := _find_agreeing_candidate(each, anchor)) is not None
    ]
    return weighted_mean(anchor, agreeing)


def _sort_longest_first(exposures: Sequence[Photo]) -> list[Photo]:
    known = [each.exposure_us for each in exposures if each.exposure_us is not None]
    lengths = known if len(known) == len(exposures) else [float(np.mean(each.image)) for each in exposures]
    order = sorted(range(len(exposures)), key=lambda number: -lengths[number])
    return [exposures[number] for number in order]


def _find_agreeing_candidate(photo: Photo, anchor: Detection) -> Candidate | None:
    """Return an exposure's most certain candidate that agrees with the anchor."""
    part = whole_part(photo.image, static=photo.static, bayer=photo.bayer)
    found = candidates_in(part, full_scale=photo.full_scale, least_level=_LEAST_LEVEL, least_near=0.0)
    agreeing = [each for each in found if agrees(each, anchor)]
    return min(agreeing, key=lambda each: each.sigma_px, default=None)


def agrees(seen: Candidate, anchor: Detection) -> bool:
    """Return whether a candidate is within the errors of a detection's position."""
    distance = math.hypot(seen.rim.x - (anchor.x_px or 0.0), seen.rim.y - (anchor.y_px or 0.0))
    reach = _AGREE_SIGMAS * math.hypot(seen.sigma_px, anchor.sigma_px or 0.0)
    return distance <= max(reach, _AGREE_RADIUS * max(seen.rim.radius, anchor.radius_px or 0.0))


def weighted_mean(anchor: Detection, agreeing: Sequence[tuple[Candidate, float | None]]) -> Detection:
    """Return the most certain detection, moved to the weighted mean position of those that agree with it."""
    if len(agreeing) < 2:
        return anchor
    places = np.array([[each.rim.x, each.rim.y] for each, _ in agreeing])
    weights = np.array([each.sigma_px**-2 for each, _ in agreeing])
    x, y = np.average(places, axis=0, weights=weights)
    ruling, exposure_us = min(agreeing, key=lambda pair: pair[0].sigma_px)
    freedom = 2 * (len(agreeing) - 1)
    chi2 = float(np.sum(weights[:, None] * (places - (x, y)) ** 2)) / freedom
    # The exposures see the same glare: their mean is no better than the best of them.
    sigma = ruling.sigma_px * math.sqrt(max(chi2, 1.0))
    return replace(
        anchor,
        x_px=float(x),
        y_px=float(y),
        sigma_px=sigma,
        radius_px=ruling.rim.radius,
        ellipticity=ruling.rim.ellipticity,
        exposure_us=exposure_us,
        findings=(*anchor.findings, Finding("stack_mean", {"frames": len(agreeing), "chi2": chi2})),
    )
