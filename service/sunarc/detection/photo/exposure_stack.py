"""One sighting from all exposures of one time: the small plateaus of the short ones rule."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from sunarc.array_types import BoolArray, Image
from sunarc.detection.photo.candidates import Candidate, candidates_in
from sunarc.detection.photo.ordinary_image import detect_sun_in_photo
from sunarc.detection.photo.part import whole_part
from sunarc.detection.values import Bayer, Detection, Expectation
from sunarc.errors import InputError
from sunarc.findings import Finding

_LEAST_LEVEL = 0.1
"""Of full scale: in a short exposure the disc need not be saturated."""
_AGREE_SIGMAS, _AGREE_RADIUS = 4.0, 0.35
"""Candidates of two exposures are of one thing within so many of their sigmas, or so much of the larger radius."""


class Exposure(NamedTuple):
    """An image, as `detect_sun_in_photo` takes it, and its exposure time; None where that is not known."""

    image: Image
    exposure_us: float | None


def detect_sun_in_stack(
    exposures: Sequence[Exposure],
    *,
    full_scale: int,
    expectation: Expectation | None = None,
    static: BoolArray | None = None,
    bayer: Bayer | None = None,
) -> Detection:
    """Find the sun in a stack of exposures of one time.

    Parameters
    ----------
    exposures : images of one size, in any order; where not all times are known, the lighter one is the longer one.
    full_scale, expectation, static, bayer : as in `detect_sun_in_photo`.

    Returns
    -------
    The position is the mean of the exposures that agree with what an ordinary exposure shows, weighted by their
    variances: a short exposure's plateau is the smallest, so that it rules. Where no exposure is accepted by itself,
    what the longest one shows.

    Raises
    ------
    InputError : no exposures, several sizes, or no images.
    """
    if not exposures:
        raise InputError(field="exposures", problem="none is given", remedy="give the images of one time")
    if len({each.image.shape for each in exposures}) > 1:
        raise InputError(field="exposures", problem="several sizes", remedy="give images of one size")
    ordered = _longest_first(exposures)
    seen = [
        detect_sun_in_photo(
            each.image,
            full_scale=full_scale,
            expectation=expectation,
            static=static,
            bayer=bayer,
            exposure_us=each.exposure_us,
        )
        for each in ordered
    ]
    accepted = [found for found in seen if found.accepted]
    if not accepted:
        return seen[0]
    anchor = min(accepted, key=lambda found: found.sigma_px or math.inf)
    agreeing = [
        (near, each.exposure_us)
        for each in ordered
        if (near := _nearest(each.image, anchor, full_scale=full_scale, static=static, bayer=bayer)) is not None
    ]
    return _mean(anchor, agreeing)


def _longest_first(exposures: Sequence[Exposure]) -> list[Exposure]:
    known = [each.exposure_us for each in exposures if each.exposure_us is not None]
    lengths = known if len(known) == len(exposures) else [float(np.mean(each.image)) for each in exposures]
    order = sorted(range(len(exposures)), key=lambda number: -lengths[number])
    return [exposures[number] for number in order]


def _nearest(
    image: Image, anchor: Detection, *, full_scale: int, static: BoolArray | None, bayer: Bayer | None
) -> Candidate | None:
    """Return an exposure's most certain candidate that agrees with the anchor."""
    part = whole_part(image, static=static, bayer=bayer)
    found = candidates_in(part, full_scale=full_scale, least_level=_LEAST_LEVEL, least_near=0.0)
    agreeing = [each for each in found if _agrees(each, anchor)]
    return min(agreeing, key=lambda each: each.sigma_px, default=None)


def _agrees(seen: Candidate, anchor: Detection) -> bool:
    distance = math.hypot(seen.rim.x - (anchor.x_px or 0.0), seen.rim.y - (anchor.y_px or 0.0))
    reach = _AGREE_SIGMAS * math.hypot(seen.sigma_px, anchor.sigma_px or 0.0)
    return distance <= max(reach, _AGREE_RADIUS * max(seen.rim.radius, anchor.radius_px or 0.0))


def _mean(anchor: Detection, agreeing: Sequence[tuple[Candidate, float | None]]) -> Detection:
    """Return the anchor at the weighted mean of what agrees with it."""
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
