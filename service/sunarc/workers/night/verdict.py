"""What a night was like, by its images."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy.spatial import cKDTree

from sunarc.array_types import FloatArray
from sunarc.calibration import MatchedView, StarView
from sunarc.findings import Finding
from sunarc.robust_statistics import biweights, mad_sigma
from sunarc.sky import angles_from_direction, relative_air_mass

NightVerdict = Literal["clear", "partly", "cloudy", "moonlit", "unusable"]
_FEWEST_IMAGES = 3
_CLEAR_SHARE, _CLEAR_CLOUDS = 0.8, 0.25
_PARTLY_SHARE = 0.1
_MOONLIT_SHARE = 0.5
_COUNTED_TO_V = 4.0
"""Stars that any clear sky shows; those fainter are lost to the light of towns."""
_STEP_V, _HALF = 0.5, 0.5
_SIGMAS, _SEEING_PX = 3.0, 0.5
_LOWEST_DEG = 78.0
"""Zenith angle of 4.7 air masses; below, haze and trees."""
_FEWEST_STARS, _LEAST_AIR_MASSES = 100, 1.0
_FWHM = 2.355


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
    transparency : share of the light that comes through one air mass, by the stars' brightness over the zenith angle; a
        lens that is darker towards its edge lowers it.
    """

    n_images: int
    n_accepted: int
    n_stars: int
    n_matched: int
    limiting_magnitude: float
    star_fwhm_px: float
    cloud_fraction: float
    transparency: float


def summary_of(views: Sequence[StarView], matched: Sequence[MatchedView]) -> NightSummary:
    """Return the numbers of a night of images and their matches."""
    pairs = [(view, found) for view, found in zip(views, matched, strict=True) if found.matches.accepted]
    widths = np.concatenate([view.stars.width_px for view in views]) if views else np.zeros(0)
    clouds = [1.0] * (len(views) - len(pairs)) + [_cloud_fraction(view) for view, _ in pairs]
    return NightSummary(
        n_images=len(views),
        n_accepted=len(pairs),
        n_stars=round(_median([len(found.stars) for _, found in pairs], otherwise=0.0)),
        n_matched=round(_median([found.matches.star.size for _, found in pairs], otherwise=0.0)),
        limiting_magnitude=_median([_limiting_magnitude(view) for view, _ in pairs]),
        star_fwhm_px=_FWHM * _median(widths.tolist()),
        cloud_fraction=float(np.mean(clouds)) if clouds else math.nan,
        transparency=_transparency(pairs),
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


def _seen(view: StarView) -> np.ndarray[tuple[int], np.dtype[np.bool_]]:
    """Return (n,) which of the predicted stars have a detection."""
    if len(view.stars) == 0:
        return np.zeros(len(view.predicted), dtype=np.bool_)
    distance = np.asarray(cKDTree(view.stars.pixels).query(view.predicted.pixels)[0])
    return np.asarray(distance < _SIGMAS * np.hypot(view.predicted.sigma_px, _SEEING_PX))


def _cloud_fraction(view: StarView) -> float:
    counted = view.predicted.magnitude <= _COUNTED_TO_V
    return 1.0 - float(np.mean(_seen(view)[counted])) if np.any(counted) else math.nan


def _limiting_magnitude(view: StarView) -> float:
    """Return the end of the last step of magnitudes, from the brightest on, of which half is detected."""
    seen, limit = _seen(view), math.nan
    for begin in np.arange(2.0, 6.0, _STEP_V).tolist():
        step = (view.predicted.magnitude >= begin) & (view.predicted.magnitude < begin + _STEP_V)
        if step.sum() < 5 or seen[step].mean() < _HALF:
            break
        limit = begin + _STEP_V
    return limit


def _transparency(pairs: Sequence[tuple[StarView, MatchedView]]) -> float:
    """Return 10^(-0.4 k) of the robust slope k, magnitudes an air mass, of the stars of each image about its median."""
    columns = [_faintness(view, found) for view, found in pairs]
    air_mass, magnitude = np.concatenate([np.zeros((2, 0)), *columns], axis=1)
    if air_mass.size < _FEWEST_STARS or np.ptp(air_mass) < _LEAST_AIR_MASSES:
        return math.nan
    slope, weight = 0.0, np.ones(air_mass.size)
    for _ in range(10):
        slope = float(np.sum(weight * air_mass * magnitude) / np.sum(weight * air_mass**2))
        residual = magnitude - slope * air_mass
        weight = biweights(residual / (4.0 * max(mad_sigma(residual), 1e-3)))
    return float(10.0 ** (-0.4 * slope))


def _faintness(view: StarView, found: MatchedView) -> FloatArray:
    """Return air masses and magnitudes lost, (2, m), of the unclipped stars of an image, each about its median."""
    stars = found.stars.select(found.matches.detection)
    zenith, _ = angles_from_direction(found.directions(view))
    catalogue = view.sky.magnitude[view.sky.rows_of(found.names(view))]
    sound = stars.sound & (catalogue < _COUNTED_TO_V) & (zenith < _LOWEST_DEG)
    if not np.any(sound):
        return np.zeros((2, 0))
    both = np.stack([relative_air_mass(zenith), -2.5 * np.log10(np.maximum(stars.flux, 1e-9)) - catalogue])[:, sound]
    return np.asarray(both - np.median(both, axis=1, keepdims=True))


def _median(values: Sequence[float], *, otherwise: float = math.nan) -> float:
    finite = [value for value in values if math.isfinite(value)]
    return float(np.median(finite)) if finite else otherwise
