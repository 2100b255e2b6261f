"""A verdict on ordinary images: circles through the blob's level sets must agree with one another."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from sunarc.array_types import Image
from sunarc.detection.photo.aureole import Halo, halo_about
from sunarc.detection.photo.blob import thickest
from sunarc.detection.photo.blob_bias import Lens, bias_at
from sunarc.detection.photo.circles import Circle, Plane, level_circle
from sunarc.detection.photo.urquhart2016 import Estimates, Planes, locate, planes_of
from sunarc.detection.values import Detection, Expectation, Verdict
from sunarc.findings import Finding

_LEVELS = (0.995, 0.98, 0.96, 0.93, 0.90, 0.86)
_SEEDS = 40
_MAX_CANDIDATES = 5
_LEAST_SHARE = 0.3  # of a circle's angles at which a level set's outline follows it
_LEAST_SEED_PX = 3.0
_HALOS = 4
_ALL_WHITE = 0.98
_LARGE = 0.02  # of its radius is a large blob's centre off: the lens draws it out unevenly
_EVEN = 0.03  # scatter of light that is the sun's
_EIGHT_BITS = 255
_JACKKNIFE = 3.0  # errors over the sigma of leaving sectors out, found on stand-ins: a contrail is in many sectors


_MIN_PEAK_FRACTION = 0.85
"""An image darker than this at its brightest shows no sun: in an ordinary exposure its disc is saturated."""
_MAX_RADIUS_FRACTION = 0.08
"""A blob wider than this share of the image's smaller side is no sun."""
_MIN_SHARE = 0.5
"""Share of the directions around the sun in which the light must fall off as in the others."""
_MIN_EDGE = 0.35
"""Light next to the blob, over its own (linear), below which it is no sun but something white."""
_MAX_SPREAD_PX = 1.5
"""Largest 1-sigma of the centre, by leaving sectors out."""
_MAX_SCATTER = 0.04
"""Scatter of the light around the sun about what is symmetric, over its fall outwards."""
_SURE_SPREAD_PX = 0.3
"""Where the centre's 1-sigma is smaller, a fifth less share and 2.5 times the scatter are no fault: streaks of the lens
and contrails are uneven and leave the centre where it is, thin cloud moves it."""
_MAX_ELLIPTICITY = 0.32
"""Largest 1 - minor/major axis of that light's ellipses."""
_GAMMA = 2.2
"""Of an 8 bit image's tones (sRGB's, about); deeper ones are taken for linear."""
_SIGMA_PX = 0.43
"""1-sigma per axis of an accepted position, at least: what the paper finds."""
_MAX_APPARENT_ZENITH_DEG = 89.6
"""A lower sun is below the horizon: at 89.6 degrees the whole disc (radius 0.27 degrees) is still above it."""


class _Blob(NamedTuple):
    """The level circles of one blob, highest level first, and the light around it: a reflection has none."""

    circles: tuple[Circle, ...]
    around: float
    halo: Halo | None = None

    @property
    def center(self) -> tuple[float, float]:
        if self.halo is not None:
            return self.halo.x, self.halo.y
        return float(np.median([c.x for c in self.circles])), float(np.median([c.y for c in self.circles]))

    @property
    def spread_px(self) -> float:
        """The centre's 1-sigma per axis."""
        return math.inf if self.halo is None else _JACKKNIFE * self.halo.sigma_px

    @property
    def radius(self) -> float:
        return float(np.median([c.radius for c in self.circles]))

    @property
    def score(self) -> float:
        """Say how sun-like it is: well outlined, large, and in the midst of its own glare, which is even."""
        share = float(np.median([c.share for c in self.circles]))
        even = 1.0 if self.halo is None else self.halo.edge**2 / (1.0 + (self.halo.scatter / _EVEN) ** 2)
        return self.around**2 * share * len(self.circles) * math.sqrt(self.radius) * even


def detect_sun_in_photo(
    image: Image,
    *,
    full_scale: int,
    expectation: Expectation | None = None,
    robust: bool = True,
    lens: Lens | None = None,
    exposure_us: float | None = None,
) -> Detection:
    """Find the sun's saturated blob in an ordinary or HDR image.

    Parameters
    ----------
    image : (rows, columns) or (rows, columns, 3) uint8 or uint16; the colours' order does not matter.
    full_scale : its largest count.
    expectation : where the sun should be, where known; its apparent zenith sets the kernels' width.
    robust : answer with the centre of the light around the blob; otherwise with the medians of the paper's estimators.
    lens : where given, the expected radial bias of the blob is reported (never subtracted).
    exposure_us : returned in the result.

    Returns
    -------
    What was seen, method "paper"; px, (0, 0) the centre of the top-left pixel.

    Raises
    ------
    InputError : the array is no image.
    """
    planes = planes_of(image, full_scale=full_scale)
    zenith = None if expectation is None else expectation.apparent_zenith
    if zenith is not None and zenith > math.radians(_MAX_APPARENT_ZENITH_DEG):
        below = Finding("sun_below_horizon", {"zenith_deg": math.degrees(zenith)})
        return _none("below_horizon", below, exposure_us)
    peak = float(planes.counts.max()) / full_scale
    if peak < _MIN_PEAK_FRACTION:
        return _none("hidden", Finding("image_dark", {"peak": peak}), exposure_us, peak)
    if float(np.median(planes.counts[::8, ::8])) >= _ALL_WHITE * full_scale:
        return _none("saturated", Finding("image_saturated"), exposure_us, peak)
    blob = _best_blob(planes, peak, expectation)
    estimates = _estimates(planes, blob, zenith, robust=robust)
    if blob is None or estimates is None:
        return _none("hidden", Finding("no_round_region"), exposure_us, peak)
    verdict = _verdict(blob, expectation)
    return _detection(blob, estimates, verdict, planes, robust=robust, lens=lens, exposure_us=exposure_us)


def _estimates(planes: Planes, blob: _Blob | None, zenith: float | None, *, robust: bool) -> Estimates | None:
    """Return the paper's estimators' answers; where something else may be brighter, from the blob's surroundings."""
    if blob is None or not robust:
        return locate(planes, apparent_zenith=zenith)
    half = math.ceil(3.0 * blob.radius) + 8
    x0, y0 = (max(0, round(value) - half) for value in blob.center)
    rows, columns = slice(y0, round(blob.center[1]) + half + 1), slice(x0, round(blob.center[0]) + half + 1)
    found = locate(planes.part(rows, columns), apparent_zenith=zenith)
    return None if found is None else found.shifted(x0, y0)


def _none(verdict: Verdict, finding: Finding, exposure_us: float | None, peak: float | None = None) -> Detection:
    return Detection(
        method="paper",
        accepted=False,
        verdict=verdict,
        findings=(finding,),
        peak_fraction=peak,
        exposure_us=exposure_us,
    )


def _best_blob(planes: Planes, peak: float, expectation: Expectation | None) -> _Blob | None:
    """Return the roundest of the brightest regions; with an expectation only those around it count."""
    grey = planes.grey()
    top = float(grey.max())
    mask = (grey >= _LEVELS[1] * min(top, peak)).astype(np.uint8)
    largest = _MAX_RADIUS_FRACTION * min(mask.shape)
    inscribed = thickest(mask, most=_SEEDS, least_radius=_LEAST_SEED_PX)
    seeds = [Circle(*found, 0.1, 1.0) for found in inscribed if found[2] <= largest]
    if expectation is not None:
        reach = 5.0 * expectation.uncertainty_px + largest
        seeds = [s for s in seeds if math.hypot(s.x - expectation.x_px, s.y - expectation.y_px) < reach]
    seeded = sorted((_Blob((seed,), _light_around(grey, seed)) for seed in seeds), key=lambda one: one.score)[
        -_MAX_CANDIDATES:
    ]
    outlined = [found for one in seeded if (found := _circles(grey, top, one.circles[0])) is not None]
    tones = _GAMMA if planes.full_scale == _EIGHT_BITS else 1.0
    best = sorted(seeded + outlined, key=lambda each: each.score)[-_HALOS:]
    with_light = [each._replace(halo=_halo_of(grey, top, each, tones)) for each in best]
    return max(with_light, key=lambda each: each.score, default=None)


def _halo_of(grey: Plane, top: float, blob: _Blob, tones: float) -> Halo | None:
    """Return what the linear light around a blob is symmetric about."""
    x, y = blob.center
    half = math.ceil(4.0 * blob.radius) + 16
    x0, y0 = max(0, round(x) - half), max(0, round(y) - half)
    part = grey[y0 : round(y) + half + 1, x0 : round(x) + half + 1]
    light = np.clip(part.astype(np.float64) / top, 0.0, 1.0) ** tones
    found = halo_about(light, center=(x - x0, y - y0), radius=blob.circles[0].radius)
    return None if found is None else found._replace(x=found.x + x0, y=found.y + y0)


def _circles(grey: Plane, top: float, seed: Circle) -> _Blob | None:
    """Return the level circles around a point that look like circles at all."""
    largest = _MAX_RADIUS_FRACTION * min(grey.shape)
    half = math.ceil(2.5 * largest)
    x0, y0 = max(0, round(seed.x) - half), max(0, round(seed.y) - half)
    part = np.ascontiguousarray(grey[y0 : round(seed.y) + half + 1, x0 : round(seed.x) + half + 1])
    near, circles = (seed.x - x0, seed.y - y0), list[Circle]()
    for level in _LEVELS:
        circle = level_circle(part, level=level * top, near=near)
        if circle is None or circle.radius > largest or circle.share < _LEAST_SHARE:
            continue
        near = (circle.x, circle.y)
        circles.append(circle._replace(x=circle.x + x0, y=circle.y + y0))
    return _Blob(tuple(circles), _light_around(grey, circles[0])) if len(circles) >= 2 else None


def _light_around(grey: Plane, circle: Circle) -> float:
    """Return the median level between 1.5 and 2.5 radii."""
    half = math.ceil(2.5 * circle.radius)
    x0, y0 = max(0, round(circle.x) - half), max(0, round(circle.y) - half)
    part = grey[y0 : round(circle.y) + half + 1, x0 : round(circle.x) + half + 1]
    rows, columns = np.ogrid[: part.shape[0], : part.shape[1]]
    far = np.hypot(columns + (x0 - circle.x), rows + (y0 - circle.y))
    ring = part[(far > 1.5 * circle.radius) & (far < 2.5 * circle.radius)]
    return float(np.median(ring)) if ring.size else 0.0


def _verdict(blob: _Blob, expectation: Expectation | None) -> tuple[Verdict, Finding]:
    x, y = blob.center
    if expectation is not None:
        distance = math.hypot(x - expectation.x_px, y - expectation.y_px)
        if distance > 5.0 * expectation.uncertainty_px + 2.0:
            return "reflection", Finding("blob_displaced", {"distance_px": distance})
    if blob.halo is None:
        return "partly_covered", Finding("blob_light_hidden")
    clear = Finding("blob_found", {"diameter_px": 2.0 * blob.radius, "scatter": blob.halo.scatter})
    return _fault(blob.halo, blob.spread_px) or ("clear", clear)


def _fault(halo: Halo, spread_px: float) -> tuple[Verdict, Finding] | None:
    """Return what is wrong with the light around a bright region."""
    if halo.edge < _MIN_EDGE:
        return "hidden", Finding("blob_edged", {"edge": halo.edge})
    sure = spread_px < _SURE_SPREAD_PX
    if halo.share < (0.8 * _MIN_SHARE if sure else _MIN_SHARE):
        return "partly_covered", Finding("blob_one_sided", {"share": halo.share})
    if halo.scatter > (2.5 * _MAX_SCATTER if sure else _MAX_SCATTER):
        return "veiled", Finding("blob_light_uneven", {"scatter": halo.scatter})
    if halo.ellipticity > _MAX_ELLIPTICITY:
        return "veiled", Finding("blob_light_elongated", {"ellipticity": halo.ellipticity})
    if spread_px > _MAX_SPREAD_PX:
        return "veiled", Finding("blob_centre_uncertain", {"sigma_px": spread_px})
    return None


def _detection(
    blob: _Blob,
    estimates: Estimates,
    verdict: tuple[Verdict, Finding],
    planes: Planes,
    *,
    robust: bool,
    lens: Lens | None,
    exposure_us: float | None,
) -> Detection:
    x, y = blob.center if robust else estimates.position
    return Detection(
        method="paper",
        accepted=verdict[0] == "clear",
        verdict=verdict[0],
        findings=(verdict[1],),
        x_px=x,
        y_px=y,
        sigma_px=math.hypot(_SIGMA_PX, min(blob.spread_px, blob.radius), _LARGE * blob.radius),
        peak_fraction=float(planes.counts.max()) / planes.full_scale,
        background_fraction=float(np.median(planes.counts[::16, ::16])) / planes.full_scale,
        radius_px=blob.radius,
        ellipticity=None if blob.halo is None else blob.halo.ellipticity,
        saturated_px=int(np.count_nonzero(planes.counts >= 0.995 * planes.full_scale)),
        spread_px=estimates.spread_px,
        radial_bias_px=None if lens is None else bias_at(lens, x_px=x, y_px=y, radius_px=blob.radius),
        exposure_us=exposure_us,
    )
