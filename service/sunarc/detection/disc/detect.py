"""Detection of the sun's disc in one microsecond frame."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from sunarc.array_types import FloatArray, Image
from sunarc.detection.disc.classify import detection_of, is_flat, verdict_of
from sunarc.detection.disc.fit import DiscFit, fit_disc
from sunarc.detection.disc.limits import (
    FAINTEST_LEVEL_PER_US,
    FAINTEST_SHARE,
    LIMB_DARKENING,
    MAX_APPARENT_ZENITH_DEG,
    MAX_RADIUS_PX,
    MIN_PEAK_FRACTION,
    MIN_RADIUS_PX,
    PSF_PX,
    PSF_TOLERANCE,
    SATURATION_FRACTION,
    SOLAR_RADIUS_DEG,
    WINGS_TOLERANCE,
)
from sunarc.detection.disc.model import Prior
from sunarc.detection.disc.obstruction import obstruction
from sunarc.detection.disc.search import Spot, brightest_spots, semi_axes, symmetric_root
from sunarc.detection.disc.template import sun_sources
from sunarc.detection.disc.window import Window, cut, saturated_level
from sunarc.detection.frames import require_raw
from sunarc.detection.options import DiscOptions
from sunarc.detection.values import Detection, Expectation, Sensor, Verdict
from sunarc.findings import Finding

_CANDIDATES = 3
_MARGIN_PX = 5.0
_HALOS = (0.9, 1.7, 2.7)  # point spreads by which a saturated disc may look too large
_BINNED_HALOS = (0.0, 0.9, 1.7)
_BINNED_WIDTHS = (1.0, 0.7, 1.4)
"""Starts for means of clipped pixels, whose cost has several valleys (`docs/studies/binned_sun.py`)."""
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
    InputError : the array is no image of this sensor.
    """
    require_raw(image, sensor)
    clear = _clear_level(expectation, options, exposure_us)
    if expectation is not None:
        expectation = replace(expectation, clear_peak_fraction=clear)
    limit = math.radians(MAX_APPARENT_ZENITH_DEG)
    if expectation is not None and expectation.apparent_zenith is not None and expectation.apparent_zenith > limit:
        zenith = math.degrees(expectation.apparent_zenith)
        found = _none("below_horizon", Finding("sun_below_horizon", {"zenith_deg": zenith}))
    elif expectation is None:
        found = _search(image, sensor=sensor)
    else:
        found = _detect_near(image, sensor=sensor, expectation=expectation)
    # Only without a prediction: a full moon fits a disc as well as a dimmed sun does.
    if clear is None and expectation is None and exposure_us is not None:
        found = _reject_unpredicted_faint(found, exposure_us)
    return replace(_reject_faint(found, clear), exposure_us=exposure_us)


def _clear_level(expectation: Expectation | None, options: DiscOptions, exposure_us: float | None) -> float | None:
    """Return the clear sun's level over full scale, where known."""
    if expectation is not None and expectation.clear_peak_fraction is not None:
        return expectation.clear_peak_fraction
    return options.clear_level_per_us * exposure_us if exposure_us and options.clear_level_per_us else None


def _reject_faint(found: Detection, clear: float | None) -> Detection:
    """Return what was found, rejected where it is far too faint at this exposure."""
    if clear is None or not found.accepted or (found.peak_fraction or 0.0) >= FAINTEST_SHARE * clear:
        return found
    faint = Finding("disc_below_clear_sun", {"share": (found.peak_fraction or 0.0) / clear})
    return replace(found, accepted=False, verdict="hidden", findings=(faint,))


def _reject_unpredicted_faint(found: Detection, exposure_us: float) -> Detection:
    """Return what was found, rejected where no camera without a dense filter would see the sun so faint."""
    if not found.accepted or (found.peak_fraction or 0.0) >= FAINTEST_LEVEL_PER_US * exposure_us:
        return found
    level = (found.peak_fraction or 0.0) / max(exposure_us, 1e-9)
    faint = Finding("disc_below_faintest", {"level": level})
    return replace(found, accepted=False, verdict="hidden", findings=(faint,))


def _none(verdict: Verdict, finding: Finding) -> Detection:
    return Detection(method="disc", accepted=False, verdict=verdict, findings=(finding,))


def _detect_near(image: Image, *, sensor: Sensor, expectation: Expectation) -> Detection:
    """Detect the sun around the predicted pixel."""
    height, width = image.shape
    if not (-0.5 <= expectation.x_px < width - 0.5 and -0.5 <= expectation.y_px < height - 0.5):
        return _none("hidden", Finding("sun_outside_image"))
    axes = _expected_axes(expectation)
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
    spots = brightest_spots(part, count=1, reach=max(part.shape), floor=_floor(sensor))
    if not spots:
        return _dark(part, sensor)
    spot = spots[0]._replace(x=spots[0].x + x0, y=spots[0].y + y0)
    return _fitted(image, spot, axes, sensor=sensor, expectation=expectation)


def _search(image: Image, *, sensor: Sensor) -> Detection:
    """Search the whole frame; the brightest spot must stand out, and stand alone."""
    reach = math.ceil(1.5 * MAX_RADIUS_PX / sensor.binning)
    spots = brightest_spots(image, count=_CANDIDATES, reach=reach, floor=_floor(sensor))
    if not spots:
        return _dark(image, sensor)
    first = spots[0]
    if first.contrast < 0.5 * (first.level - sensor.black_level):
        return _none("hidden", Finding("no_outstanding_region", {"level": first.level / sensor.full_scale}))
    found = _fitted(image, first, None, sensor=sensor, expectation=None)
    smallest_px = 0.7 * MIN_RADIUS_PX / sensor.binning
    rivals = [s for s in spots[1:] if s.contrast > 0.3 * first.contrast and s.semi_axes[1] > smallest_px]
    if found.accepted and rivals:
        places = ", ".join(f"({spot.x:.0f}, {spot.y:.0f})" for spot in rivals)
        alike = Finding("disc_rivals", {"places": places})
        return replace(found, accepted=False, verdict="reflection", findings=(alike,))
    return found


def _floor(sensor: Sensor) -> float:
    """Return the counts that a disc's core exceeds, noise allowed for; a Bayer mosaic's weakest colour has fewest."""
    share = 0.3 if sensor.bayer else 0.5
    noise = 2.0 * sensor.read_noise_e / sensor.gain_e_per_count
    return sensor.black_level + max(share * MIN_PEAK_FRACTION * sensor.full_scale - noise, 0.0)


def _expected_axes(expectation: Expectation) -> FloatArray | None:
    if expectation.stretch_px_per_rad is None:
        return None
    stretch = np.array(expectation.stretch_px_per_rad) * math.radians(SOLAR_RADIUS_DEG)
    return symmetric_root(stretch @ stretch.T)


def _dark(part: Image, sensor: Sensor) -> Detection:
    top = float(part.max()) if part.size else 0.0
    peak = max(top - sensor.black_level, 0.0) / sensor.full_scale
    dark = Finding("no_bright_region", {"least": MIN_PEAK_FRACTION})
    return replace(_none("hidden", dark), peak_fraction=peak)


def _fitted(
    image: Image,
    spot: Spot,
    axes: FloatArray | None,
    *,
    sensor: Sensor,
    expectation: Expectation | None,
) -> Detection:
    """Fit and judge the disc at a spot; `axes` None: the disc's shape is fitted too."""
    shapes = _first_shapes(spot, axes, sensor)
    start = shapes[0][1]
    half = math.ceil(max(semi_axes(start)[1], spot.semi_axes[1]) + _MARGIN_PX * PSF_PX / sensor.binning + 2.0)
    longest = MAX_RADIUS_PX / sensor.binning
    if spot.semi_axes[1] > 2.0 * longest or half > 4.0 * longest:
        return _none("hidden", Finding("disc_too_long", {"length_px": 2.0 * spot.semi_axes[1]}))
    at = (spot.x, spot.y)
    window = cut(image, center=at, half=half, sensor=sensor, saturation_fraction=SATURATION_FRACTION)
    if _all_saturated(window):
        saturated = Finding("disc_saturated", {"n": window.saturated_px})
        return replace(_none("saturated", saturated), saturated_px=window.saturated_px, peak_fraction=1.0)
    radius_px = math.sqrt(math.prod(semi_axes(start)))
    fit = _fit(window, at, shapes, radius_px=radius_px, free=axes is None, sensor=sensor)
    if fit is None:
        return _none("hidden", Finding("disc_too_few_pixels"))
    verdict = verdict_of(fit, expectation=expectation, sensor=sensor)
    if verdict[1] and expectation is None and not window.saturated_px:
        at, shapes = (fit.x_px, fit.y_px), [(fit.psf_px, fit.stretch)]
        if is_flat(fit, _fit(window, at, shapes, radius_px=radius_px, free=True, sensor=sensor, limb_darkening=0.0)):
            verdict = ("hidden", False, Finding("disc_without_limb"))
    return detection_of(fit, verdict, sensor=sensor, saturated_px=window.saturated_px)


def _fit(
    window: Window,
    at: tuple[float, float],
    shapes: list[tuple[float, FloatArray]],
    *,
    radius_px: float,
    free: bool,
    sensor: Sensor,
    limb_darkening: float = LIMB_DARKENING,
) -> DiscFit | None:
    """Fit a disc of that limb darkening; `free`: its shape too."""
    psf_px = PSF_PX / sensor.binning
    prior = Prior(math.log(psf_px), PSF_TOLERANCE, WINGS_TOLERANCE, free_stretch=free)
    sources = sun_sources(radius_px=radius_px, psf_px=psf_px, limb_darkening=limb_darkening)
    return fit_disc(window, start=at, shapes=shapes, sources=sources, sensor=sensor, prior=prior)


def _first_shapes(spot: Spot, axes: FloatArray | None, sensor: Sensor) -> list[tuple[float, FloatArray]]:
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


def _all_saturated(window: Window) -> bool:
    return bool(np.count_nonzero(window.usable) < 0.3 * window.usable.size)
