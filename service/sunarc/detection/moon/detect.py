"""Detection of the moon in a short exposure."""

from __future__ import annotations

import math

import cv2
import numpy as np

from sunarc.array_types import BoolArray, FloatArray, Image
from sunarc.detection.frames import require_photo
from sunarc.detection.moon.fit import FittedMoon, Pixels, fit_moon
from sunarc.detection.moon.limb import Surface, lit_surface
from sunarc.detection.moon.values import MoonDetection, MoonExpectation
from sunarc.detection.values import Sensor
from sunarc.findings import Finding

_MARGIN_PX = 6.0
"""Of the stamp beyond the disc: four widths of the point spread, and sky."""
_LARGEST_HALF = 40
_CLIPPED = 0.97
_SEARCH_SIGMAS = 4.0
_LIT = 0.3
_LEAST_LIT = 0.03
"""Share of the disc; a thinner crescent stands in the twilight."""
_LEAST_SNR = 30.0
_MOST_CLIPPED = 0.1
"""Of the lit part's pixels."""
_MOST_RESIDUAL = 0.08
"""Rms over the level; a cloud's edge before the disc leaves more."""
_HAZY, _MOST_HAZE = 0.015, 0.12
"""Sky beside the disc over the disc: thin haze, and a cloud that leaves no limb."""
_MOST_SIGMA_PX = 0.5
_MOST_SHAPE_MISFIT = 3.0
"""Mean square of the seas' coefficients over their prior: a lamp is no disc."""
_RESOLVED_PX = 3.0
"""Radius beyond which seas show that the polynomials do not have."""
_FLOOR_PX = 0.015
"""1-sigma that is added: no point spread is the Gaussian of the fit."""
_LAW_RADII = 0.008
"""1-sigma over the radius of what the surface's brightness leaves: the seas, and a terminator that no law has."""
_HAZE_RADII = 0.6
"""1-sigma over the radius that a haze of 1 adds: a cloud is not even over the disc."""
_COLOURS = {"RGGB": (0, 1, 1, 2), "BGGR": (2, 1, 1, 0), "GRBG": (1, 0, 2, 1), "GBRG": (1, 2, 0, 1)}


def detect_moon(image: Image, expected: MoonExpectation, *, sensor: Sensor) -> MoonDetection:
    """Fit the lit part of the moon near its predicted pixel.

    Parameters
    ----------
    image : (rows, columns) counts of a raw frame, a mosaic too, or of a part of it that begins at an even pixel.
    expected : in the same pixels.
    sensor : noise, black level and colours.

    Returns
    -------
    The centre of the whole disc. Centre, point spread, brightness law, seas, an aureole, and level and background of
    each colour are fitted, so that sigma has the uncertainty of them all; it grows with the misfit and with haze.

    Raises
    ------
    InputError : the array is no image.
    """
    require_photo(image, full_scale=sensor.full_scale)
    if expected.cos_phase < 2.0 * _LEAST_LIT - 1.0:
        return _none(Finding("moon_thin", {"lit": 0.5 * (1.0 + expected.cos_phase), "limit": _LEAST_LIT}))
    surface = lit_surface(expected.cos_phase)
    start = _start(image, expected, surface)
    if start is None:
        return _none(Finding("moon_not_found", {"sigma_px": expected.uncertainty_px}))
    radius = math.sqrt(abs(float(np.linalg.det(expected.edges_px))))
    longest = float(np.max(np.linalg.norm(expected.edges_px, axis=0)))
    stamp, clipped = _stamp(image, start, longest, sensor)
    near = _distance(stamp, start, expected.edges_px) < 1.0 + 2.0 / radius
    n_clipped = int(np.count_nonzero(clipped & near))
    if n_clipped > _MOST_CLIPPED * math.pi * radius**2 * 0.5 * (1.0 + expected.cos_phase):
        return _none(Finding("moon_saturated", {"n": n_clipped}), saturated_px=n_clipped)
    fitted = fit_moon(stamp, surface, expected.edges_px, start)
    haze = max(_haze(stamp, fitted, longest), fitted.aureole)
    return _judged(fitted, expected, haze=haze, n_clipped=n_clipped, full_scale=sensor.full_scale)


def _start(image: Image, expected: MoonExpectation, surface: Surface) -> FloatArray | None:
    """Return where the disc's centre would be (2,) px by the brightest place near the prediction."""
    middle = expected.edges_px @ (surface.light[0] @ surface.nodes)
    at = np.array([expected.x_px, expected.y_px]) + middle
    reach = _SEARCH_SIGMAS * expected.uncertainty_px + float(np.max(np.abs(expected.edges_px))) + 2.0
    left, top = (max(int(value - reach), 0) for value in at)
    right, bottom = (int(value + reach) + 2 for value in at)
    part = image[top : max(bottom, 0), left : max(right, 0)].astype(np.float32)
    if min(part.shape) < 3:
        return None
    # twice the middle of what is brighter than half: first about the brightest place, then about that
    smooth = cv2.GaussianBlur(part, (0, 0), 1.2)
    smooth -= np.quantile(smooth, 0.1)
    row, column = np.unravel_index(int(np.argmax(smooth)), smooth.shape)
    rows, columns = np.indices(smooth.shape)
    radius = float(np.max(np.linalg.norm(expected.edges_px, axis=0)))
    lit = (smooth > _LIT * smooth[row, column]) & (np.hypot(rows - row, columns - column) < 2.0 * radius + 2.0)
    weight = np.where(lit, smooth, 0.0)
    if not np.sum(weight) > 0.0:
        return None
    place = [left + np.average(columns, weights=weight), top + np.average(rows, weights=weight)]
    return np.asarray(np.array(place) - middle)


def _stamp(image: Image, start: FloatArray, longest: float, sensor: Sensor) -> tuple[Pixels, BoolArray]:
    """Return the pixels around the disc, and which are clipped; what lies outside of the image takes no part."""
    half = min(math.ceil(longest + _MARGIN_PX), _LARGEST_HALF)
    left, top = (round(float(value)) - half for value in start)
    rows, columns = np.indices((2 * half + 1, 2 * half + 1)) + np.array([top, left])[:, None, None]
    inside = (rows >= 0) & (columns >= 0) & (rows < image.shape[0]) & (columns < image.shape[1])
    raw = image[np.clip(rows, 0, image.shape[0] - 1), np.clip(columns, 0, image.shape[1] - 1)].astype(np.float64)
    full = raw >= _CLIPPED * sensor.full_scale
    clipped = cv2.dilate(full.astype(np.uint8), np.ones((3, 3), dtype=np.uint8)) > 0 if sensor.blooming else full
    counts = raw - sensor.black_level
    # the noise of the smooth image: a pixel's own would favour those that are dark by chance
    smooth = cv2.GaussianBlur(counts, (0, 0), 0.8)
    variance = (sensor.read_noise_e / sensor.gain_e_per_count) ** 2 + np.maximum(smooth, 0.0) / sensor.gain_e_per_count
    variance = np.where(inside & ~clipped, variance + 1.0 / 12.0, np.inf)
    colour = np.zeros(raw.shape, dtype=np.int64)
    if sensor.bayer is not None:
        colour = np.array(_COLOURS[sensor.bayer])[2 * (rows % 2) + columns % 2]
    return Pixels((left, top), counts, variance, colour), np.asarray(clipped)


def _distance(stamp: Pixels, centre: FloatArray, edges_px: FloatArray) -> FloatArray:
    """Return how far each pixel lies from the disc's centre, in radii."""
    rows, columns = np.indices(stamp.counts.shape)
    offset = np.stack([columns + stamp.origin[0] - centre[0], rows + stamp.origin[1] - centre[1]], axis=-1)
    return np.asarray(np.linalg.norm(offset @ np.linalg.inv(edges_px).T, axis=-1))


def _haze(stamp: Pixels, fitted: FittedMoon, longest: float) -> float:
    """Return the light of the sky just outside of the disc over the disc's, above that at the stamp's edge."""
    rows, columns = np.indices(stamp.counts.shape)
    far = np.hypot(columns + stamp.origin[0] - fitted.centre[0], rows + stamp.origin[1] - fitted.centre[1])
    used, blurred = np.isfinite(stamp.variance), longest + 3.0 * fitted.width_px
    near = used & (far > blurred) & (far < blurred + 1.5)
    edge = used & (far > longest + _MARGIN_PX - 1.0)
    levels = []
    for colour in range(int(stamp.colour.max()) + 1):
        one, peak = stamp.colour == colour, float(np.max(fitted.light[stamp.colour == colour]))
        if np.any(near & one) and np.any(edge & one):
            beside = float(np.mean(stamp.counts[near & one]) - np.mean(stamp.counts[edge & one]))
            levels.append(beside / max(peak, 1e-9))
    return float(np.mean(levels)) if levels else 0.0


def _judged(
    fitted: FittedMoon, expected: MoonExpectation, *, haze: float, n_clipped: int, full_scale: int
) -> MoonDetection:
    """Return the detection, accepted or not."""
    radius = math.sqrt(abs(float(np.linalg.det(expected.edges_px))))
    peak = float(fitted.light.max())
    residual = fitted.residual_rms / max(peak, 1e-9)
    law, cloud = _LAW_RADII * radius, _HAZE_RADII * radius * max(haze, 0.0)
    sigma = math.sqrt(fitted.variance * max(fitted.chi2, 1.0) + _FLOOR_PX**2 + law**2 + cloud**2)
    x, y = fitted.centre.tolist()
    distance = math.hypot(x - expected.x_px, y - expected.y_px)
    allowed = _SEARCH_SIGMAS * math.hypot(expected.uncertainty_px, sigma)
    refused = []
    if fitted.snr < _LEAST_SNR:
        refused.append(Finding("moon_not_found", {"sigma_px": expected.uncertainty_px}))
    if distance > allowed:
        refused.append(Finding("moon_displaced", {"distance_px": distance, "limit_px": allowed}))
    if haze > _MOST_HAZE:
        refused.append(Finding("moon_in_cloud", {"haze": haze, "limit": _MOST_HAZE}))
    if residual > _MOST_RESIDUAL or not sigma < _MOST_SIGMA_PX:
        refused.append(Finding("moon_poor_fit", {"residual": residual, "sigma_px": sigma}))
    most = _MOST_SHAPE_MISFIT * max(radius / _RESOLVED_PX, 1.0) ** 2
    if fitted.shape_misfit > most:
        refused.append(Finding("moon_other_shape", {"misfit": fitted.shape_misfit, "limit": most}))
    found = [Finding("moon_hazy", {"haze": haze})] if haze > _HAZY else []
    return MoonDetection(
        accepted=not refused,
        findings=(*refused, *found) or (Finding("moon_found", {"chi2": fitted.chi2, "sigma_px": sigma}),),
        x_px=x, y_px=y, sigma_px=sigma, level=peak / full_scale, snr=fitted.snr, chi2=fitted.chi2,
        residual=residual, haze=haze, width_px=fitted.width_px, saturated_px=n_clipped,
    )  # fmt: skip


def _none(finding: Finding, *, saturated_px: int = 0) -> MoonDetection:
    return MoonDetection(accepted=False, findings=(finding,), saturated_px=saturated_px)
