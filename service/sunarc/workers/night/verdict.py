"""What a night was like, by its images."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from sunarc.calibration.star_views import MatchedView, StarView
from sunarc.detection.stars.values import FWHM
from sunarc.findings import Finding
from sunarc.workers.night.numbers import cloud_fraction, limit_of

NightVerdict = Literal["clear", "partly", "cloudy", "moonlit", "unusable"]
_FEWEST_IMAGES = 3
_CLEAR_SHARE, _CLEAR_CLOUDS = 0.8, 0.25
_PARTLY_SHARE = 0.1
_MOONLIT_SHARE = 0.5


@dataclass(frozen=True, slots=True, kw_only=True)
class NightSummary:
    """The numbers of a night; NaN where no image was matched.

    Attributes
    ----------
    n_images, n_accepted : images, and those whose stars were named.
    n_stars, n_matched : detections and named stars of an accepted image, medians.
    limiting_magnitude : V to which half of the stars are detected, the median of the accepted images.
    star_fwhm_px : width of the stars, the median of all images.
    cloud_fraction : share of the stars to V 4 that are not seen, the mean of the images: 1 in those not accepted.
    """

    n_images: int
    n_accepted: int
    n_stars: int
    n_matched: int
    limiting_magnitude: float
    star_fwhm_px: float
    cloud_fraction: float


def summary_of(views: Sequence[StarView], matched: Sequence[MatchedView]) -> NightSummary:
    """Return the numbers of a night of images and their matches."""
    pairs = [(view, found) for view, found in zip(views, matched, strict=True) if found.matches.accepted]
    widths = np.concatenate([view.stars.width_px for view in views]) if views else np.zeros(0)
    clouds = [1.0] * (len(views) - len(pairs)) + [cloud_fraction(view) for view, _ in pairs]
    return NightSummary(
        n_images=len(views),
        n_accepted=len(pairs),
        n_stars=round(_median([len(found.stars) for _, found in pairs], otherwise=0.0)),
        n_matched=round(_median([found.matches.star.size for _, found in pairs], otherwise=0.0)),
        limiting_magnitude=_median([limit_of(view) for view, _ in pairs]),
        star_fwhm_px=FWHM * _median(widths.tolist()),
        cloud_fraction=float(np.mean(clouds)) if clouds else math.nan,
    )


def decide_night(summary: NightSummary, *, moonlit_share: float) -> tuple[NightVerdict, tuple[Finding, ...]]:
    """Return what a night was, and why.

    Parameters
    ----------
    summary : its numbers.
    moonlit_share : of its images, those with a moon above the horizon that is more than half lit.
    """
    share = summary.n_accepted / max(summary.n_images, 1)
    counts = {"n": summary.n_accepted, "images": summary.n_images}
    if summary.n_images < _FEWEST_IMAGES:
        return "unusable", (Finding("night_few_images", {"n": summary.n_images, "limit": _FEWEST_IMAGES}),)
    found = (Finding("night_images", {**counts, "cloud_fraction": summary.cloud_fraction}),)
    if share >= _CLEAR_SHARE and summary.cloud_fraction <= _CLEAR_CLOUDS:
        return "clear", found
    if share >= _PARTLY_SHARE:
        return "partly", found
    return ("moonlit" if moonlit_share > _MOONLIT_SHARE else "cloudy"), found


def _median(values: Sequence[float], *, otherwise: float = math.nan) -> float:
    finite = [value for value in values if math.isfinite(value)]
    return float(np.median(finite)) if finite else otherwise
