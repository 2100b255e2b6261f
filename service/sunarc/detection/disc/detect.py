"""Detection of the sun's disc in one microsecond frame."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import NamedTuple

import cv2
import numpy as np

from sunarc.common.array_types import FloatArray, Image
from sunarc.common.findings import Finding
from sunarc.common.robust_statistics import fast_median
from sunarc.detection.disc.fit import DiscFit, fit_disc, is_foreign
from sunarc.detection.disc.model import Prior, sun_sources
from sunarc.detection.disc.window import Window, cut, saturated_level
from sunarc.detection.values import Detection, DiscOptions, Expectation, Sensor, Verdict, require_raw


class Spot(NamedTuple):
    """A bright spot.

    x, y : centre, px. level : counts of its core. background : counts around it.
    axes : (2, 2) symmetric, px: the stretch of the uniform disc that has the same second moments.
    """

    x: float
    y: float
    level: float
    background: float
    axes: FloatArray

    @property
    def contrast(self) -> float:
        """Counts above the surroundings."""
        return self.level - self.background

    @property
    def semi_axes(self) -> tuple[float, float]:
        """Minor and major semi-axis of the spot, px."""
        return semi_axes(self.axes)


def _tile_maxima(image: Image) -> Image:
    """Return the largest minimum over 2×2 pixels of every tile, (tiles down, across); a lone hot pixel never counts."""
    height, most = image.shape[0] // 2 * 2, []
    for y in range(0, height, _TILE):  # a tile's rows stay within the processor's cache
        # Two rows at a time: of a core of three by three pixels one 2×2 block is always whole.
        pair = cv2.min(image[y : min(y + _TILE, height) : 2], image[y + 1 : min(y + _TILE, height) : 2])
        most.append(np.asarray(cv2.min(pair[:, :-1], pair[:, 1:])).max(axis=0))
    best: Image = np.maximum.reduceat(np.array(most), np.arange(0, image.shape[1] - 1, _TILE), axis=1)
    return best


def _brightest_pixel(image: Image, *, x0: int, y0: int) -> tuple[int, int]:
    """Return x, y of the first pixel of a tile's largest minimum over 2×2 pixels."""
    part = image[y0 : y0 + _TILE, x0 : x0 + _TILE + 1]
    pair = np.minimum(part[: part.shape[0] // 2 * 2 : 2], part[1::2])
    y, x = divmod(int(np.argmax(np.minimum(pair[:, :-1], pair[:, 1:]))), pair.shape[1] - 1)
    return x0 + x, y0 + 2 * y


def brightest_spots(image: Image, *, count: int, reach: int, floor: float) -> list[Spot]:
    """Return up to `count` bright spots, brightest core first.

    Parameters
    ----------
    image : (rows, columns) counts.
    count : how many at most.
    reach : half the window, px, in which a spot is measured.
    floor : counts that its core must exceed.
    """
    if min(image.shape) < 8:
        return []
    best = _tile_maxima(image)
    levels = best.ravel()
    spots: list[Spot] = []
    for k in np.argsort(levels, kind="stable")[::-1]:
        if len(spots) >= count or levels[k] <= floor:
            break
        row, column = divmod(int(k), best.shape[1])
        x, y = _brightest_pixel(image, x0=column * _TILE, y0=row * _TILE)
        if not _is_part_of_spot(x, y, spots):
            spot = measure_spot(image, x=x, y=y, reach=reach)
            if not _is_part_of_spot(spot.x, spot.y, spots):
                spots.append(spot)
    return spots


def _is_part_of_spot(x: float, y: float, spots: list[Spot]) -> bool:
    return any(math.hypot(spot.x - x, spot.y - y) < 4.0 + 2.0 * spot.semi_axes[1] for spot in spots)


def measure_spot(image: Image, *, x: int, y: int, reach: int) -> Spot:
    """Measure the spot at a pixel by the pixels above half its level, the window moved onto it once."""
    # A spot at the window's edge is cut: its centroid is pulled inward, so that the window is moved once.
    for last in (False, True):
        x0, y0 = max(0, min(x - reach, image.shape[1] - 2)), max(0, min(y - reach, image.shape[0] - 2))
        part = image[y0 : y + reach + 2, x0 : x + reach + 2].astype(np.float64)
        mean = 0.25 * (part[:-1, :-1] + part[1:, :-1] + part[:-1, 1:] + part[1:, 1:])
        spot = moments(mean, x0=x0 + 0.5, y0=y0 + 0.5)
        if last or math.hypot(spot.x - x, spot.y - y) < 0.3 * reach:
            break
        x, y = round(spot.x), round(spot.y)
    return spot


def moments(mean: FloatArray, *, x0: float, y0: float) -> Spot:
    """Return centre and size of a bright region by its moments."""
    level = float(mean.max())
    background = fast_median(np.concatenate([mean[0], mean[-1], mean[:, 0], mean[:, -1]]))
    x, y, xx, xy, yy = _moments_above(mean, 0.5 * (level + background))
    covariance = np.array([[xx, xy], [xy, yy]])
    return Spot(x + x0, y + y0, level, background, symmetric_root(4.0 * covariance + 1e-3 * np.eye(2)))


def _moments_above(mean: FloatArray, cut: float) -> tuple[float, float, float, float, float]:
    """Return the centre of the pixels above a level, weighted by it, and about that the unweighted second moments."""
    j, i = np.nonzero(mean > cut)
    if not i.size:
        return mean.shape[1] // 2, mean.shape[0] // 2, 0.0, 0.0, 0.0
    weight = mean[j, i] - cut
    x, y = float(weight @ i / weight.sum()), float(weight @ j / weight.sum())
    dx, dy = i - x, j - y
    return x, y, float(dx @ dx) / i.size, float(dx @ dy) / i.size, float(dy @ dy) / i.size


def semi_axes(stretch: FloatArray) -> tuple[float, float]:
    """Return minor and major semi-axis of the ellipse to which a symmetric (2, 2) matrix takes the unit disc."""
    a, b, d = float(stretch[0, 0]), float(stretch[0, 1]), float(stretch[1, 1])
    middle, half = abs(0.5 * (a + d)), math.hypot(0.5 * (a - d), b)
    return abs(middle - half), middle + half


def symmetric_root(matrix: FloatArray) -> FloatArray:
    """Return the symmetric square root of a positive (2, 2) matrix (by Cayley and Hamilton's theorem)."""
    a, b, d = float(matrix[0, 0]), float(matrix[0, 1]), float(matrix[1, 1])
    root = math.sqrt(max(a * d - b * b, 0.0))
    trace = math.sqrt(max(a + d + 2.0 * root, 1e-9))
    return np.array([[a + root, b], [b, d + root]]) / trace


# Limits of the search for the disc and of its classification; the lengths are px of the sensor, before binning.

PSF_PX = 0.7
"""Standard deviation of the lens's point spread; the fit adapts it to the frame."""
PSF_TOLERANCE = 0.3
"""1-sigma of its logarithm; the fit moves it that far."""
WINGS_TOLERANCE = 0.05
"""1-sigma of the share of light in wings three times as wide."""
LIMB_DARKENING = 0.6
"""u of 1 - u (1 - cos) across the sun's disc, in visible light (Allen's Astrophysical Quantities)."""
SOLAR_RADIUS_DEG = 0.2666
"""The sun's angular radius at one astronomical unit, 959.6″."""
SATURATION_FRACTION = 0.98
"""Counts from this fraction of full scale on are saturated."""
MIN_PEAK_FRACTION = 0.01
"""Level over full scale below which no disc is searched for."""
MIN_ACCEPTED_FRACTION = 0.07
"""Level below which a disc is rejected: a partly covered one would look the same."""
MIN_SNR = 12.0
"""Signal-to-noise ratio below which the sun counts as hidden."""
MIN_RADIUS_PX = 1.2
MAX_RADIUS_PX = 10.0
"""Bounds of the semi-axes of a disc without a prediction."""
MAX_ELLIPTICITY = 0.6
"""Largest 1 - minor/major semi-axis of such a disc."""
MAX_UNEVEN_PX = 0.03
"""A disc whose uneven brightness may have moved the centre further is partly covered."""
MAX_RESIDUAL_FRACTION = 0.02
"""So is a disc with larger residuals over its level."""
MAX_SIGMA_PX = 0.06
"""A less certain position is not accepted."""
VEILED_BELOW = 0.5
"""A disc below this fraction of the clear sky's is veiled; so is one below this contrast."""
MAX_APPARENT_ZENITH_DEG = 89.6
"""A lower sun is below the horizon."""
FAINTEST_SHARE = 1e-4
"""Fraction of the clear sun's level below which a disc is not the sun; the full moon has 2.5e-6."""
FAINTEST_LEVEL_PER_US = 1e-4
"""Where the clear level is unknown, a disc without a prediction and with less than this level over full scale in 1 µs
is not the sun. Through a bare lens the sun has 0.1 to 10, the full moon 1e-7 to 3e-5."""


_CANDIDATES = 3
_MARGIN_PX = 5.0
_HALOS = (0.9, 1.7, 2.7)  # point spreads by which a saturated disc may look too large
_BINNED_HALOS = (0.0, 0.9, 1.7)
_BINNED_WIDTHS = (1.0, 0.7, 1.4)
"""Starts for means of clipped pixels, whose cost has several local minima (`docs/studies/binned_sun.py`)."""
_WIDTHS = (1.0, 0.75, 1.3)  # point spreads to start from, of the one expected
_DEFAULT_OPTIONS = DiscOptions()


def detect_sun(
    image: Image,
    *,
    sensor: Sensor,
    expectation: Expectation | None = None,
    options: DiscOptions = _DEFAULT_OPTIONS,
    exposure_us: float | None = None,
) -> Detection:
    """Find the sun's disc in a raw frame.

    Parameters
    ----------
    image : (rows, columns) uint8 or uint16 counts; a Bayer mosaic as it comes from the sensor.
    sensor : full scale, noise, colours.
    expectation : predicted place; without one the whole frame is searched, and the disc's size is free.
    options : what is known of the sun.
    exposure_us : returned in the result; the disc's brightness is compared with `clear_level_per_us` at this exposure,
        or without that (and without a prediction) with the faintest level of any sun.

    Returns
    -------
    The detection; "no sun" is a result with its reason. Positions in px, (0, 0) the centre of the top-left pixel.

    Raises
    ------
    InputError : the array is not an image of this sensor.
    """
    require_raw(image, sensor)
    clear = _expected_clear_level(expectation, options, exposure_us)
    if expectation is not None:
        expectation = replace(expectation, clear_peak_fraction=clear)
    limit = math.radians(MAX_APPARENT_ZENITH_DEG)
    if expectation is not None and expectation.apparent_zenith is not None and expectation.apparent_zenith > limit:
        zenith = math.degrees(expectation.apparent_zenith)
        found = _make_rejection("below_horizon", Finding("sun_below_horizon", {"zenith_deg": zenith}))
    elif expectation is None:
        found = _search_frame(image, sensor=sensor)
    else:
        found = _detect_near(image, sensor=sensor, expectation=expectation)
    # Only without a prediction: a full moon fits a disc as well as a dimmed sun does.
    if clear is None and expectation is None and exposure_us is not None:
        found = _reject_unpredicted_faint(found, exposure_us)
    return replace(_reject_faint(found, clear), exposure_us=exposure_us)


def _expected_clear_level(
    expectation: Expectation | None, options: DiscOptions, exposure_us: float | None
) -> float | None:
    """Return the clear sun's level over full scale; None where it is not known."""
    if expectation is not None and expectation.clear_peak_fraction is not None:
        return expectation.clear_peak_fraction
    return options.clear_level_per_us * exposure_us if exposure_us and options.clear_level_per_us else None


def _reject_faint(found: Detection, clear: float | None) -> Detection:
    """Return the detection, rejected where it is far too faint at this exposure."""
    if clear is None or not found.accepted or (found.peak_fraction or 0.0) >= FAINTEST_SHARE * clear:
        return found
    faint = Finding("disc_below_clear_sun", {"share": (found.peak_fraction or 0.0) / clear})
    return replace(found, accepted=False, verdict="hidden", findings=(faint,))


def _reject_unpredicted_faint(found: Detection, exposure_us: float) -> Detection:
    """Return the detection, rejected where no camera without a dense filter would see the sun so faint."""
    if not found.accepted or (found.peak_fraction or 0.0) >= FAINTEST_LEVEL_PER_US * exposure_us:
        return found
    level = (found.peak_fraction or 0.0) / max(exposure_us, 1e-9)
    faint = Finding("disc_below_faintest", {"level": level})
    return replace(found, accepted=False, verdict="hidden", findings=(faint,))


def _make_rejection(verdict: Verdict, finding: Finding) -> Detection:
    return Detection(method="disc", accepted=False, verdict=verdict, findings=(finding,))


def _detect_near(image: Image, *, sensor: Sensor, expectation: Expectation) -> Detection:
    """Detect the sun around the predicted pixel."""
    height, width = image.shape
    if not (-0.5 <= expectation.x_px < width - 0.5 and -0.5 <= expectation.y_px < height - 0.5):
        return _make_rejection("hidden", Finding("sun_outside_image"))
    axes = _expected_shape_matrix(expectation)
    size = 2.0 * (MAX_RADIUS_PX / sensor.binning if axes is None else semi_axes(axes)[1])
    reach = 2.0 + 5.0 * expectation.uncertainty_px + size
    found = _search_near(reach, image, axes, sensor=sensor, expectation=expectation)
    if found.verdict == "hidden":
        near = size + 2.0 * expectation.uncertainty_px
        dark = obstruction(image, sensor=sensor, expectation=expectation, reach_px=near)
        return found if dark is None else replace(found, verdict="obstructed", findings=(dark,))
    return found


def _search_near(
    reach: float,
    image: Image,
    axes: FloatArray | None,
    *,
    sensor: Sensor,
    expectation: Expectation,
) -> Detection:
    """Search for the brightest spot within `reach` px of the predicted pixel."""
    x0, y0 = max(0, round(expectation.x_px - reach)), max(0, round(expectation.y_px - reach))
    part = image[y0 : round(expectation.y_px + reach) + 1, x0 : round(expectation.x_px + reach) + 1]
    spots = brightest_spots(part, count=1, reach=max(part.shape), floor=_minimum_core_counts(sensor))
    if not spots:
        return _make_dark_rejection(part, sensor)
    spot = spots[0]._replace(x=spots[0].x + x0, y=spots[0].y + y0)
    return _fit_spot(image, spot, axes, sensor=sensor, expectation=expectation)


def _search_frame(image: Image, *, sensor: Sensor) -> Detection:
    """Search the whole frame; the brightest spot must stand out, and stand alone."""
    reach = math.ceil(1.5 * MAX_RADIUS_PX / sensor.binning)
    spots = brightest_spots(image, count=_CANDIDATES, reach=reach, floor=_minimum_core_counts(sensor))
    if not spots:
        return _make_dark_rejection(image, sensor)
    first = spots[0]
    if first.contrast < 0.5 * (first.level - sensor.black_level):
        return _make_rejection("hidden", Finding("no_outstanding_region", {"level": first.level / sensor.full_scale}))
    found = _fit_spot(image, first, None, sensor=sensor, expectation=None)
    smallest_px = 0.7 * MIN_RADIUS_PX / sensor.binning
    rivals = [s for s in spots[1:] if s.contrast > 0.3 * first.contrast and s.semi_axes[1] > smallest_px]
    if found.accepted and rivals:
        places = ", ".join(f"({spot.x:.0f}, {spot.y:.0f})" for spot in rivals)
        alike = Finding("disc_rivals", {"places": places})
        return replace(found, accepted=False, verdict="reflection", findings=(alike,))
    return found


def _minimum_core_counts(sensor: Sensor) -> float:
    """Return the counts that a disc's core exceeds, noise allowed for; a mosaic's weakest colour has fewest."""
    share = 0.3 if sensor.bayer else 0.5
    noise = 2.0 * sensor.read_noise_e / sensor.gain_e_per_count
    return sensor.black_level + max(share * MIN_PEAK_FRACTION * sensor.full_scale - noise, 0.0)


def _expected_shape_matrix(expectation: Expectation) -> FloatArray | None:
    """Return the symmetric (2, 2) matrix, px, that maps the unit circle to the sun's expected disc.

    None where the stretch is unknown.
    """
    if expectation.stretch_px_per_rad is None:
        return None
    stretch = np.array(expectation.stretch_px_per_rad) * math.radians(SOLAR_RADIUS_DEG)
    return symmetric_root(stretch @ stretch.T)


def _make_dark_rejection(part: Image, sensor: Sensor) -> Detection:
    top = float(part.max()) if part.size else 0.0
    peak = max(top - sensor.black_level, 0.0) / sensor.full_scale
    dark = Finding("no_bright_region", {"least": MIN_PEAK_FRACTION})
    return replace(_make_rejection("hidden", dark), peak_fraction=peak)


def _fit_spot(
    image: Image,
    spot: Spot,
    axes: FloatArray | None,
    *,
    sensor: Sensor,
    expectation: Expectation | None,
) -> Detection:
    """Fit and judge the disc at a spot; `axes` None: the disc's shape is fitted too."""
    shapes = _list_first_shapes(spot, axes, sensor)
    start = shapes[0][1]
    half = math.ceil(max(semi_axes(start)[1], spot.semi_axes[1]) + _MARGIN_PX * PSF_PX / sensor.binning + 2.0)
    longest = MAX_RADIUS_PX / sensor.binning
    if spot.semi_axes[1] > 2.0 * longest or half > 4.0 * longest:
        return _make_rejection("hidden", Finding("disc_too_long", {"length_px": 2.0 * spot.semi_axes[1]}))
    at = (spot.x, spot.y)
    window = cut(image, center=at, half=half, sensor=sensor, saturation_fraction=SATURATION_FRACTION)
    if _is_mostly_saturated(window):
        saturated = Finding("disc_saturated", {"n": window.saturated_px})
        return replace(_make_rejection("saturated", saturated), saturated_px=window.saturated_px, peak_fraction=1.0)
    radius_px = math.sqrt(math.prod(semi_axes(start)))
    fit = _fit_disc_model(window, _Start(at, shapes, radius_px), free=axes is None, sensor=sensor)
    if fit is None:
        return _make_rejection("hidden", Finding("disc_too_few_pixels"))
    verdict = judge_fit(fit, expectation=expectation, sensor=sensor)
    if verdict[1] and expectation is None and not window.saturated_px:
        again = _Start((fit.x_px, fit.y_px), [(fit.width_px, fit.stretch)], radius_px)
        if is_flat(fit, _fit_disc_model(window, again, free=True, sensor=sensor, limb_darkening=0.0)):
            verdict = ("hidden", False, Finding("disc_without_limb"))
    return make_detection(fit, verdict, sensor=sensor, saturated_px=window.saturated_px)


class _Start(NamedTuple):
    """Where a fit begins: centre, point spreads with axes to choose from, and the disc's radius, px."""

    at: tuple[float, float]
    shapes: list[tuple[float, FloatArray]]
    radius_px: float


def _fit_disc_model(
    window: Window, start: _Start, *, free: bool, sensor: Sensor, limb_darkening: float = LIMB_DARKENING
) -> DiscFit | None:
    """Fit a disc of that limb darkening; `free`: its shape too."""
    psf_px = PSF_PX / sensor.binning
    prior = Prior(math.log(psf_px), PSF_TOLERANCE, WINGS_TOLERANCE, free_stretch=free)
    sources = sun_sources(radius_px=start.radius_px, psf_px=psf_px, limb_darkening=limb_darkening)
    return fit_disc(window, start=start.at, shapes=start.shapes, sources=sources, sensor=sensor, prior=prior)


def _list_first_shapes(spot: Spot, axes: FloatArray | None, sensor: Sensor) -> list[tuple[float, FloatArray]]:
    """Return initial values of point spread and axes; several for a saturated disc, which shows neither."""
    psf_px, shortest, longest = (length / sensor.binning for length in (PSF_PX, MIN_RADIUS_PX, MAX_RADIUS_PX))
    saturated = spot.level >= saturated_level(sensor, SATURATION_FRACTION)
    if axes is not None:
        return [(factor * psf_px, axes) for factor in (_WIDTHS if saturated else (1.0,))]
    values, vectors = np.linalg.eigh(spot.axes)
    if not saturated:
        sizes = np.clip(values, shortest, longest)
        return [(factor * psf_px, np.asarray((vectors * sizes) @ vectors.T)) for factor in _WIDTHS]
    halos = _HALOS if sensor.binning == 1 else _BINNED_HALOS
    smaller = [np.clip(values - h * psf_px, shortest, longest) for h in halos]
    widths = (1.0,) if sensor.binning == 1 else _BINNED_WIDTHS
    return [(w * psf_px, np.asarray((vectors * sizes) @ vectors.T)) for sizes in smaller for w in widths]


def _is_mostly_saturated(window: Window) -> bool:
    return bool(np.count_nonzero(window.usable) < 0.3 * window.usable.size)


# Detection of obstructions in front of the sun from the sky's own light.

_TILE = 64
_TILE_ROWS = 8  # every so many rows are looked at
_DARK_SHARE = 0.5  # of the sky's light, below which no cloud is
_SIGNIFICANT = 6.0
_DETECTABLE = 3.0  # predicted level over the detection limit from which a missing disc is significant


def obstruction(image: Image, *, sensor: Sensor, expectation: Expectation, reach_px: float) -> Finding | None:
    """Return the finding of a sun behind a mast or a building where none was found; None where that is not certain.

    A cloud in front of the sun is brighter than most of the sky; a building is dark. So the surroundings of the
    predicted pixel must be darker than half of the sky (the brighter quarter of the image's 64 px tiles), the
    difference must exceed 6 of its sigmas, and a clear sun must be well above the detection limit at this exposure
    (`clear_peak_fraction`). Where an exposure is too short for the sky to show, or the obstruction is smaller than
    the surroundings, the result is None.

    Parameters
    ----------
    image : (rows, columns) counts.
    reach_px : half the square around the expected pixel that counts as its surroundings.
    """
    clear = expectation.clear_peak_fraction
    if clear is None or clear < _DETECTABLE * MIN_PEAK_FRACTION:
        return None
    x, y, reach = round(expectation.x_px), round(expectation.y_px), math.ceil(reach_px)
    part = image[max(0, y - reach) : y + reach + 1, max(0, x - reach) : x + reach + 1].astype(np.float64)
    tiles = _sample_tile_means(image)
    if tiles.size == 0 or part.size == 0:
        return None
    noise = math.hypot(sensor.read_noise_e / sensor.gain_e_per_count, 0.3)
    part = np.minimum(part, float(np.median(part)) + 5.0 * noise)  # hot pixels are clipped
    level, sky = float(part.mean()) - sensor.black_level, float(np.quantile(tiles, 0.75)) - sensor.black_level
    sigma = math.hypot(float(part.std()), noise) / math.sqrt(part.size)
    if level > _DARK_SHARE * sky or sky - level < _SIGNIFICANT * sigma:
        return None
    return Finding("sun_obstructed", {"level": level / sensor.full_scale, "sky": sky / sensor.full_scale})


def _sample_tile_means(image: Image) -> FloatArray:
    """Return the mean of some rows of every whole tile, flat."""
    down, across = image.shape[0] // _TILE, image.shape[1] // _TILE
    rows = image[: down * _TILE : _TILE_ROWS, : across * _TILE]
    return np.asarray(rows.reshape(down, _TILE // _TILE_ROWS, across, _TILE).mean(axis=(1, 3))).ravel()


# Classification of a disc fit.

_MIN_CONTRAST = 0.15  # disc over its surroundings; below it, texture resembles a disc
_POSITION_TOLERANCE_PX = 1.0
_UNPREDICTED_LEVEL, _UNPREDICTED_RESIDUAL, _UNPREDICTED_SIGMA_PX = 0.08, 0.01, 0.016
_SIGNIFICANT_CLASSIFY = 16.0  # chi² of four parameters


def judge_fit(fit: DiscFit, *, expectation: Expectation | None, sensor: Sensor) -> tuple[Verdict, bool, Finding]:
    """Return the verdict, whether the position can be accepted, and the deciding finding."""
    for check in (_check_disc, _judge_place, _judge_cover, _check_certainty):
        found = check(fit, expectation, sensor)
        if found is not None:
            return found[0], False, found[1]
    veil = _find_veil(fit, expectation, sensor)
    return ("clear", True, Finding("disc_found", {"chi2": fit.chi2})) if veil is None else ("veiled", True, veil)


def _check_disc(fit: DiscFit, expectation: Expectation | None, sensor: Sensor) -> tuple[Verdict, Finding] | None:
    numbers = (fit.x_px, fit.y_px, fit.sigma_px, fit.level, fit.chi2, fit.snr)
    if not all(math.isfinite(number) for number in numbers) or not fit.converged:
        return "hidden", Finding("disc_not_converged")
    if fit.snr < MIN_SNR or fit.level < MIN_PEAK_FRACTION * sensor.full_scale:
        return "hidden", Finding("disc_below_noise", {"snr": fit.snr, "level": fit.level / sensor.full_scale})
    if fit.level < _MIN_CONTRAST * fit.background:
        return "hidden", Finding("disc_low_contrast", {"share": fit.level / max(fit.background, 1e-9)})
    psf_px = PSF_PX / sensor.binning
    deviation = abs(math.log(fit.width_px / psf_px))
    if deviation > 4.0 * PSF_TOLERANCE:
        return "hidden", Finding("disc_edge_width", {"width_px": fit.width_px, "expected_px": psf_px})
    return _check_size(fit, sensor) if expectation is None or expectation.stretch_px_per_rad is None else None


def _check_size(fit: DiscFit, sensor: Sensor) -> tuple[Verdict, Finding] | None:
    minor, major = semi_axes(fit.stretch)
    axes = {"minor_px": minor, "major_px": major}
    if not MIN_RADIUS_PX <= minor * sensor.binning <= major * sensor.binning <= MAX_RADIUS_PX:
        return "hidden", Finding("disc_wrong_size", axes)
    if 1.0 - minor / major > MAX_ELLIPTICITY:
        return "partly_covered", Finding("disc_elongated", axes)
    return None


def _judge_place(fit: DiscFit, expectation: Expectation | None, sensor: Sensor) -> tuple[Verdict, Finding] | None:
    if expectation is None:
        return _check_unpredicted(fit, sensor)
    distance = math.hypot(fit.x_px - expectation.x_px, fit.y_px - expectation.y_px)
    if distance > _POSITION_TOLERANCE_PX + 5.0 * expectation.uncertainty_px:
        return "reflection", Finding("disc_displaced", {"distance_px": distance})
    return None


def _check_unpredicted(fit: DiscFit, sensor: Sensor) -> tuple[Verdict, Finding] | None:
    """Return why a disc without a prediction is rejected: the moon and small clouds are fainter or fit worse."""
    if fit.level < _UNPREDICTED_LEVEL * sensor.full_scale:
        return "hidden", Finding("disc_faint_unpredicted", {"level": fit.level / sensor.full_scale})
    poor = fit.residual > _UNPREDICTED_RESIDUAL or (fit.chi2 > 3.0 and fit.residual > 0.3 * _UNPREDICTED_RESIDUAL)
    if poor or fit.sigma_px > _UNPREDICTED_SIGMA_PX:
        return "hidden", Finding("disc_poor_fit", {"residual": fit.residual, "sigma_px": fit.sigma_px})
    return None


def is_flat(fit: DiscFit, flat: DiscFit | None) -> bool:
    """Return whether a disc of even brightness explains the pixels clearly better than a limb-darkened one."""
    return flat is not None and flat.chi2 * flat.used_px < fit.chi2 * fit.used_px - _SIGNIFICANT_CLASSIFY


def _judge_cover(fit: DiscFit, expectation: Expectation | None, sensor: Sensor) -> tuple[Verdict, Finding] | None:
    del expectation, sensor
    uneven_px = math.sqrt(max(fit.uneven, 0.0)) * fit.sigma_px
    if fit.uneven > _SIGNIFICANT_CLASSIFY and uneven_px > MAX_UNEVEN_PX:
        return "partly_covered", Finding(
            "disc_uneven",
            {
                "uneven_px": uneven_px,
                "limit_px": MAX_UNEVEN_PX,
                "chi2": fit.uneven,
                "limit_chi2": _SIGNIFICANT_CLASSIFY,
            },
        )
    if fit.residual > MAX_RESIDUAL_FRACTION:
        return "partly_covered", Finding("disc_residuals", {"residual": fit.residual, "chi2": fit.chi2})
    if is_foreign(*fit.bands):
        return "partly_covered", Finding("disc_foreign_rows", {"rows": fit.bands[0], "columns": fit.bands[1]})
    return None


def _check_certainty(fit: DiscFit, expectation: Expectation | None, sensor: Sensor) -> tuple[Verdict, Finding] | None:
    del expectation
    if fit.level < MIN_ACCEPTED_FRACTION * sensor.full_scale:
        return "veiled", Finding("disc_faint", {"level": fit.level / sensor.full_scale})
    if fit.sigma_px > MAX_SIGMA_PX:
        return "veiled", Finding("disc_position_uncertain", {"sigma_px": fit.sigma_px})
    return None


def _find_veil(fit: DiscFit, expectation: Expectation | None, sensor: Sensor) -> Finding | None:
    if expectation is not None and expectation.clear_peak_fraction:
        share = fit.level / sensor.full_scale / expectation.clear_peak_fraction
        if share < VEILED_BELOW:
            return Finding("disc_dimmed", {"share": share})
    contrast = fit.level / max(fit.level + fit.background, 1e-9)
    return Finding("disc_in_bright_sky", {"share": contrast}) if contrast < VEILED_BELOW else None


def make_detection(
    fit: DiscFit, verdict: tuple[Verdict, bool, Finding], *, sensor: Sensor, saturated_px: int
) -> Detection:
    """Return the detection of a classified fit."""
    name, accepted, finding = verdict
    minor, major = semi_axes(fit.stretch)
    left_out = (Finding("saturated_left_out", {"n": saturated_px}),) if accepted and saturated_px else ()
    return Detection(
        method="disc",
        accepted=accepted,
        verdict=name,
        findings=(finding, *left_out),
        x_px=fit.x_px,
        y_px=fit.y_px,
        sigma_px=fit.sigma_px,
        peak_fraction=(fit.level + max(fit.background, 0.0)) / sensor.full_scale,
        background_fraction=fit.background / sensor.full_scale,
        radius_px=math.sqrt(minor * major),
        ellipticity=1.0 - minor / max(major, 1e-9),
        residual_chi2=fit.chi2,
        snr=fit.snr,
        saturated_px=saturated_px,
    )
