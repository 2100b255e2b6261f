"""Matching of detections with predicted stars, and its acceptance."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from scipy.spatial import ConvexHull, cKDTree

from sunarc.common.array_types import BoolArray, FloatArray, IntArray
from sunarc.common.findings import Finding
from sunarc.common.robust_statistics import MAD_TO_SIGMA, biweights, mad_sigma
from sunarc.detection.values import PredictedStars, Stars

LIMITS = (4.5, 4.0, 3.5, 3.0, 2.5)
"""Magnitudes to begin with, the faintest first that chance allows: denser skies match anything."""
_MOST_CHANCE = 0.15
"""Share of the predicted stars that would find a detection by chance."""
_LEAST_EXPLAINED = _LEAST_FOUND = 0.6
_FEWEST = 15
_WIDEST_GAP_DEG = 210.0
"""Between the azimuths of matched stars: half a sky is enough to tell a wrong camera, a third is not."""
_SIGMAS = 3.0
_SEEING_PX = 0.3
"""1-sigma of a star's centre on real lenses, in addition to the prediction's."""
_ALONE_WIDTHS, _FAINTER = 4.0, 1.5
"""A star is alone where none brighter than 1.5 magnitudes below it is as near as the search, or 4 widths."""
_MAGNITUDE_CUT = (0.5, 1.0)
"""Least and largest difference of brightness that ends a match; magnitudes."""
_LEAST_CORRELATION = 0.4
_LEAST_SCATTER_PX, _MOST_SCATTER_PX, _CLIPPED_PX = 0.15, 0.8, 1.0
"""Scatter of star centres on real lenses (0.16 to 0.4 px were found), and the additional error of a clipped one. A
clock that is 10 minutes off, followed by a search of 24 px, left 1.0 to 1.6 px: no smooth correction unites that."""
_CHANCE_SCATTER = 0.35
"""Scatter over the search's radius, per axis: chance has 0.5 and more."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class StarMatches:
    """Assignment of detections to catalogue stars.

    Attributes
    ----------
    accepted : whether the matches may be used.
    findings : why, or why not.
    star, detection : (m,) rows of the predicted and of the detected stars; empty where not accepted.
    explained : share of the bright detections that are predicted stars.
    found : share of the predicted bright stars that are detected, over the clear part of the sky.
    scatter_px : of the matches about a smooth correction of the prediction, per axis.
    floor_px : 1-sigma of the centres in addition to the stated one of each, by their scatter (`noise_floor`).
    """

    accepted: bool
    findings: tuple[Finding, ...]
    star: IntArray
    detection: IntArray
    explained: float = math.nan
    found: float = math.nan
    scatter_px: float = math.nan
    floor_px: float = 0.0


class _StarPairs(NamedTuple):
    """Pairs of predicted and detected stars as rows, and their pixel differences, (m, 2)."""

    star: IntArray
    detection: IntArray
    difference: FloatArray


def match_stars(
    stars: Stars, predicted: PredictedStars, *, trail_px: float = 0.0, limits: Sequence[float] = LIMITS
) -> StarMatches:
    """Match detections with the stars that a calibration predicts.

    First the bright ones, within 3 sigma of the prediction and the trail: down to the faintest of `LIMITS` at which
    chance would match at most 15 %. These count where 60 % of the bright detections are predicted stars and
    60 % of the predicted ones are detected over the clear part of the sky (`clear_sky`), where they lie around
    it, their brightness is that of the catalogue, and a smooth correction of the prediction unites them. Then all
    stars, about the corrected prediction. A star with another next to it is not used.

    Parameters
    ----------
    stars : detections; what stands still between images should be left out before (`standing_still`).
    predicted : stars to V 5.5, so that a faint neighbour is known.
    trail_px : added to the search's radius.
    limits : magnitudes to begin with, the faintest first.
    """
    rows = np.flatnonzero(~on_cloud(stars))
    matches = _match_visible(stars.select(rows), predicted, trail_px, limits)
    return replace(matches, detection=rows[matches.detection])


def _match_visible(stars: Stars, predicted: PredictedStars, trail_px: float, limits: Sequence[float]) -> StarMatches:
    radius = _SIGMAS * np.hypot(predicted.sigma_px, _SEEING_PX) + trail_px
    if len(stars) < _FEWEST:
        return _refuse(_too_few_finding(0, stars))
    limit = next((one for one in limits if _chance_share(predicted, radius, one) <= _MOST_CHANCE), None)
    if limit is None:
        return _refuse(Finding("stars_prediction_uncertain", {"sigma_px": float(np.median(predicted.sigma_px))}))
    bright = predicted.magnitude <= limit
    considered = stars.select(np.arange(min(len(stars), _count_considered(int(bright.sum())))))
    pairs = _pair_stars(considered, predicted, predicted.pixels, radius, bright)
    if pairs.star.size < _FEWEST:
        return _refuse(_too_few_finding(pairs.star.size, stars))
    zero = _fit_zero_point(considered, predicted, pairs)
    pairs = _select_like_brightness(considered, predicted, pairs, zero)
    explained = _share_of_detections_explained(considered, predicted, radius, zero, limit)
    found = _share_of_stars_found(considered, predicted, radius, zero, limit)
    if pairs.star.size < _FEWEST:
        return _refuse(
            _too_few_finding(pairs.star.size, stars), *_check_shares(explained, found), explained=explained, found=found
        )
    correction, scatter = _fit_correction(predicted.pixels[pairs.star], pairs.difference)
    findings = (
        *_check_shares(explained, found),
        *_check_spread(predicted, pairs),
        *_check_coherence(considered, predicted, pairs, scatter, radius),
    )
    if findings:
        return _refuse(*findings, explained=explained, found=found, scatter_px=scatter)
    corrected = replace(predicted, pixels=predicted.pixels + correction.at(predicted.pixels))
    return _match_with_correction(stars, corrected, zero, scatter, limits[0])


def _match_with_correction(
    stars: Stars, predicted: PredictedStars, zero: FloatArray, scatter: float, limit: float
) -> StarMatches:
    """Return the matches of all stars about the corrected prediction, if that explains the sky as well."""
    near = np.full(len(predicted), 4.0 * max(scatter, _LEAST_SCATTER_PX))
    wide = near + _CLIPPED_PX
    chance = _chance_share(predicted, wide, limit)
    explained = _share_of_detections_explained(stars, predicted, wide, zero, limit)
    found = _share_of_stars_found(stars, predicted, wide, zero, limit)
    measured = {"explained": explained, "found": found, "scatter_px": scatter}
    findings = _check_shares(explained, found)
    if chance > _MOST_CHANCE or scatter > _MOST_SCATTER_PX:
        findings.append(Finding("stars_scattered", {"scatter_px": scatter, "radius_px": float(wide[0])}))
    if findings:
        return _refuse(*findings, **measured)
    pairs = _pair_stars(stars, predicted, predicted.pixels, near, np.ones(len(predicted), dtype=bool))
    pairs = _select_like_brightness(stars, predicted, pairs, zero)
    if pairs.star.size < _FEWEST:
        return _refuse(_too_few_finding(pairs.star.size, stars), **measured)
    matched = Finding("stars_matched", {"n": int(pairs.star.size), "explained": explained, "found": found})
    sound = stars.sound[pairs.detection]
    places, sigma = predicted.pixels[pairs.star[sound]], stars.sigma_px[pairs.detection[sound]]
    floor = noise_floor(places, pairs.difference[sound], sigma)
    return StarMatches(
        accepted=True, findings=(matched,), star=pairs.star, detection=pairs.detection, floor_px=floor, **measured
    )


_FEWEST_FLOOR, _WITHIN, _TWO_SIGMAS = 30, 0.95, 1.96
_HALVINGS = 12


def noise_floor(places: FloatArray, difference: FloatArray, sigma_px: FloatArray) -> float:
    """Return the 1-sigma, px, to be added to star centres' so that 95 % lie within 1.96 sigma.

    Each star is held against its nearest neighbour, which what is smooth of a lens moves alike. 0 where what is stated
    suffices, or of fewer than 30 stars.

    Parameters
    ----------
    places : (n, 2) of the stars, px.
    difference : (n, 2) of their detections from the prediction, px.
    sigma_px : (n,) as stated.
    """
    if sigma_px.size < _FEWEST_FLOOR:
        return 0.0
    beside = np.asarray(cKDTree(places).query(places, k=2)[1])[:, 1]
    apart = np.abs(difference - difference[beside])
    variance = (sigma_px**2 + sigma_px[beside] ** 2)[:, None]

    def has_enough_within(floor: float) -> bool:
        return bool(np.mean(apart <= _TWO_SIGMAS * np.sqrt(variance + 2.0 * floor**2)) >= _WITHIN)

    least, most = 0.0, _MOST_SCATTER_PX
    if has_enough_within(least):
        return least
    for _ in range(_HALVINGS):
        middle = 0.5 * (least + most)
        least, most = (least, middle) if has_enough_within(middle) else (middle, most)
    return most


def _count_considered(n_bright: int) -> int:
    """Return how many of the brightest detections are considered for so many predicted stars."""
    return 2 * n_bright + 20


def _chance_share(predicted: PredictedStars, radius: FloatArray, limit: float) -> float:
    """Return the share of the stars to a magnitude that would find a detection anywhere."""
    bright = predicted.magnitude <= limit
    if bright.sum() < _FEWEST:
        return 1.0
    density = _count_considered(int(bright.sum())) / float(ConvexHull(predicted.pixels[bright]).volume)
    return float(np.mean(1.0 - np.exp(-density * math.pi * radius[bright] ** 2)))


def _pair_stars(
    stars: Stars, predicted: PredictedStars, pixels: FloatArray, radius: FloatArray, wanted: BoolArray
) -> _StarPairs:
    """Return the pairs of wanted stars that are alone, one detection each: the brightest within the radius."""
    tree = cKDTree(stars.pixels)
    alone = _is_alone(predicted, pixels, np.maximum(radius, _ALONE_WIDTHS * float(np.median(stars.width_px))))
    rows, columns = [], []
    for row in np.flatnonzero(wanted & alone):
        near = tree.query_ball_point(pixels[row], radius[row])
        if not near:
            continue
        flux = stars.flux[near]
        first, others = int(np.argmax(flux)), np.delete(flux, np.argmax(flux))
        if np.all(others < flux[first] * 10.0 ** (-0.4 * _FAINTER)):
            rows.append(row)
            columns.append(near[first])
    star, detection = np.array(rows, dtype=np.int64), np.array(columns, dtype=np.int64)
    # one that two stars claim is neither's
    claims = np.bincount(detection, minlength=len(stars))
    single = claims[detection] == 1
    star, detection = star[single], detection[single]
    return _StarPairs(star, detection, stars.pixels[detection] - pixels[star])


def _is_alone(predicted: PredictedStars, pixels: FloatArray, reach: FloatArray) -> BoolArray:
    tree = cKDTree(pixels)
    near = tree.query_ball_point(pixels, reach)
    return np.array(
        [
            all(other == row or predicted.magnitude[other] > predicted.magnitude[row] + _FAINTER for other in others)
            for row, others in enumerate(near)
        ],
        dtype=bool,
    )


def _instrumental_magnitude(stars: Stars) -> FloatArray:
    return np.asarray(-2.5 * np.log10(np.maximum(stars.flux, 1e-12)))


def _fit_zero_point(stars: Stars, predicted: PredictedStars, pairs: _StarPairs) -> FloatArray:
    """Return a, b, s of instrumental = a + b (V - 3), robustly, and the scatter; b < 1 where counts are compressed."""
    magnitude = predicted.magnitude[pairs.star] - 3.0
    measured = _instrumental_magnitude(stars)[pairs.detection]
    design = np.stack([np.ones_like(magnitude), magnitude], axis=-1)
    line = np.array([float(np.median(measured - magnitude)), 1.0])
    scatter = 1.0
    for _ in range(10):
        residual = measured - design @ line
        scatter = max(mad_sigma(residual), 0.1)
        weight = np.sqrt(biweights(residual / (4.0 * scatter)))[:, None]
        line = np.linalg.lstsq(design * weight, measured * weight[:, 0], rcond=None)[0]
    line[1] = float(np.clip(line[1], 0.3, 1.3))
    return np.array([*line, scatter])


def _estimated_magnitude(stars: Stars, zero: FloatArray) -> FloatArray:
    """Return the V that detections would have by their flux."""
    return np.asarray(3.0 + (_instrumental_magnitude(stars) - zero[0]) / zero[1])


def _select_like_brightness(stars: Stars, predicted: PredictedStars, pairs: _StarPairs, zero: FloatArray) -> _StarPairs:
    residual = (
        _instrumental_magnitude(stars)[pairs.detection] - zero[0] - zero[1] * (predicted.magnitude[pairs.star] - 3.0)
    )
    like = np.abs(residual) < float(np.clip(3.0 * zero[2], *_MAGNITUDE_CUT))
    return _StarPairs(*(part[like] for part in pairs))


def _share_of_detections_explained(
    stars: Stars, predicted: PredictedStars, radius: FloatArray, zero: FloatArray, limit: float
) -> float:
    """Return the share of the bright detections that have a predicted star within its radius."""
    bright = _estimated_magnitude(stars, zero) < limit - 0.5
    if not np.any(bright):
        return 0.0
    bright_enough = predicted.magnitude < limit + 0.5
    apart, row = cKDTree(predicted.pixels[bright_enough]).query(stars.pixels[bright])
    return float(np.mean(np.asarray(apart) < radius[bright_enough][np.asarray(row)]))


def _share_of_stars_found(
    stars: Stars, predicted: PredictedStars, radius: FloatArray, zero: FloatArray, limit: float
) -> float:
    """Return the share of the predicted bright stars that are detected, where the sky about them is clear."""
    bright = _estimated_magnitude(stars, zero) < limit + 0.5
    expected = predicted.magnitude < limit - 0.5
    if not np.any(bright):
        return 0.0
    pixels = predicted.pixels[expected]
    apart = np.asarray(cKDTree(stars.pixels[bright]).query(pixels)[0])
    return share_where_clear(pixels, apart < radius[expected])


def _too_few_finding(count: int, stars: Stars) -> Finding:
    return Finding("stars_few", {"n": int(count), "limit": _FEWEST, "detected": len(stars)})


def _check_shares(explained: float, found: float) -> list[Finding]:
    shares = (("stars_not_explained", explained, _LEAST_EXPLAINED), ("stars_not_found", found, _LEAST_FOUND))
    return [Finding(code, {"share": share, "limit": least}) for code, share, least in shares if share < least]


def _check_spread(predicted: PredictedStars, pairs: _StarPairs) -> list[Finding]:
    azimuth = np.sort(predicted.azimuth_deg[pairs.star] % 360.0)
    gap = float(np.max(np.diff(np.r_[azimuth, azimuth[0] + 360.0])))
    return [Finding("stars_one_sided", {"gap_deg": gap, "limit": _WIDEST_GAP_DEG})] if gap > _WIDEST_GAP_DEG else []


def _check_coherence(
    stars: Stars, predicted: PredictedStars, pairs: _StarPairs, scatter: float, radius: FloatArray
) -> list[Finding]:
    """Return the findings of matches made by chance: unrelated brightness, or differences without order."""
    correlation = float(
        np.corrcoef(_instrumental_magnitude(stars)[pairs.detection], predicted.magnitude[pairs.star])[0, 1]
    )
    usual = float(np.median(radius[pairs.star]))
    if correlation < _LEAST_CORRELATION:
        return [Finding("stars_brightness", {"correlation": correlation, "limit": _LEAST_CORRELATION})]
    if scatter > max(_CHANCE_SCATTER * usual, 2.0 * _SEEING_PX):
        return [Finding("stars_scattered", {"scatter_px": scatter, "radius_px": usual})]
    return []


class _Correction(NamedTuple):
    """A polynomial of the pixel: middle and scale of the pixels, and coefficients (k, 2)."""

    middle: FloatArray
    scale: float
    coefficients: FloatArray

    def at(self, pixels: FloatArray) -> FloatArray:
        """Return (n, 2) px at pixels (n, 2)."""
        return np.asarray(
            _polynomial_terms((pixels - self.middle) / self.scale, self.coefficients.shape[0]) @ self.coefficients
        )


def _polynomial_terms(places: FloatArray, count: int) -> FloatArray:
    x, y = places.T
    return np.stack([np.ones_like(x), x, y, x * x, x * y, y * y][:count], axis=-1)


def _fit_correction(pixels: FloatArray, difference: FloatArray) -> tuple[_Correction, float]:
    """Return a linear (from 60 stars on a quadratic) function of the pixel through differences, and their scatter."""
    middle, scale = np.median(pixels, axis=0), max(float(np.max(np.ptp(pixels, axis=0))), 1.0)
    count = 6 if pixels.shape[0] >= 60 else 3
    design = _polynomial_terms((pixels - middle) / scale, count)
    weight = np.ones(pixels.shape[0])
    for _ in range(10):
        rows = np.sqrt(weight)[:, None]
        coefficients = np.linalg.lstsq(design * rows, difference * rows, rcond=None)[0]
        residual = difference - design @ coefficients
        scatter = MAD_TO_SIGMA * float(np.median(np.abs(residual)))
        weight = biweights(np.linalg.norm(residual, axis=-1) / max(5.0 * scatter, 0.1))
    return _Correction(np.asarray(middle, dtype=np.float64), scale, np.asarray(coefficients)), scatter


def _refuse(*findings: Finding, **measured: float) -> StarMatches:
    none = np.zeros(0, dtype=np.int64)
    return StarMatches(accepted=False, findings=findings, star=none, detection=none, **measured)


# Which part of a sky is clear: detections that are the texture of clouds, and predicted stars that clouds hide.

_FAINT_SNR, _TEXTURE, _CLEAREST = 25.0, 3.0, 0.25
"""A detection of a signal-to-noise ratio below 25 whose noise is 3 times that of the clearest quarter lies on cloud. On
rendered broken cloud the noise of stars is within a factor of 2, that of cloud's edges 3 to 10 times as large."""
_NEIGHBOURS, _NEIGHBOURS_SEEN, _FEWEST_CLEAR_SKY = 8, (4, 6), 8
"""The sky about a star is clear where 4, or 6, of the 8 bright ones next to it are detected: in haze the former leaves
the larger share, between small clouds the latter. Of neighbours that chance matches at 15 % so many are hardly ever."""


def on_cloud(stars: Stars) -> BoolArray:
    """Return (n,): which detections are faint against a texture about them: edges of clouds, at whatever flux."""
    noise = stars.flux / np.maximum(stars.snr, 1e-12)
    faint: BoolArray = stars.snr < _FAINT_SNR
    if not np.any(faint):
        return faint
    return np.asarray(faint & (noise > _TEXTURE * float(np.quantile(noise[faint], _CLEAREST))))


def share_where_clear(pixels: FloatArray, seen: BoolArray) -> float:
    """Return the share of bright stars that are seen, of those about which the sky is clear: 0 where these are few.

    Parameters
    ----------
    pixels : (n, 2) where bright stars are predicted.
    seen : (n,) whether each is detected; it says nothing of the sky about itself.
    """
    if pixels.shape[0] <= _NEIGHBOURS:
        return 0.0
    beside = np.asarray(cKDTree(pixels).query(pixels, k=_NEIGHBOURS + 1)[1])[:, 1:]
    about = seen[beside].sum(axis=1)
    clear = [about >= least for least in _NEIGHBOURS_SEEN]
    return max((float(np.mean(seen[part])) for part in clear if part.sum() >= _FEWEST_CLEAR_SKY), default=0.0)


LEAST_MOTION_PX = 3.0
"""Of the sky between two images, for which a detection that stays is no star; a star's own centre errs by a tenth."""


def standing_still(first: Stars, second: Stars, *, moved_px: FloatArray) -> BoolArray:
    """Return (n,): which detections of an image stand where another has one, though the sky has turned: no stars.

    Parameters
    ----------
    first, second : detections of two images of one camera.
    moved_px : (n,) by how much the sky moved between them at each detection of the first, px. Where that is less than
        3 px (about the pole), nothing is said.
    """
    if len(first) == 0 or len(second) == 0:
        return np.zeros(len(first), dtype=bool)
    apart = np.asarray(cKDTree(second.pixels).query(first.pixels)[0])
    return np.asarray((apart < 3.0 * np.hypot(first.sigma_px, 0.2)) & (np.asarray(moved_px) > LEAST_MOTION_PX))


def sky_motion(stars: Stars, then: PredictedStars, later: PredictedStars) -> FloatArray:
    """Return by how much the sky moves at each detection, (n,) px, between two predictions: the nearest star's."""
    place = {name: row for row, name in enumerate(later.names)}
    both = np.array([row for row, name in enumerate(then.names) if name in place], dtype=np.int64)
    if both.size == 0 or len(stars) == 0:
        return np.zeros(len(stars))
    shift = later.pixels[[place[name] for name in then.names[both]]] - then.pixels[both]
    nearest = np.asarray(cKDTree(then.pixels[both]).query(stars.pixels)[1])
    return np.asarray(np.linalg.norm(shift, axis=-1)[nearest])
