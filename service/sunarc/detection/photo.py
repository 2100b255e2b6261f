"""A verdict on ordinary images: circles through the blob's level sets must agree with one another."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from sunarc.detection.bias import Lens, bias_at
from sunarc.detection.blob import thickest
from sunarc.detection.circles import Circle, Plane, level_circle
from sunarc.detection.options import require_positive
from sunarc.detection.paper import Estimates, Planes, locate, planes_of
from sunarc.detection.values import Detection, Expectation, Image, Verdict

_LEVELS = (0.995, 0.98, 0.96, 0.93, 0.90, 0.86)
_SEEDS = 5
_LEAST_SEED_PX = 3.0


@dataclass(frozen=True, slots=True, kw_only=True)
class PaperOptions:
    """How ordinary images are searched and judged.

    Attributes
    ----------
    robust : answer with the level circles' centre; otherwise with the medians of the paper's estimators.
    full_image : convolve the whole image as the paper does (slow, the reference).
    min_peak_fraction : an image darker than this at its brightest shows no sun.
    max_radius_fraction : a blob wider than this share of the image's smaller side is no sun.
    min_share : share of its circle that a level set's outline must follow.
    max_spread_px : largest rms distance between the level sets' centres.
    max_scatter : the outline's typical distance from its circle, over the radius.
    max_growth : radius of the lowest level set over the highest's, above which the edge is no edge.
    sigma_px : 1-sigma per axis of an accepted position, at least (the paper finds 0.43 px).
    max_apparent_zenith_deg : a lower sun is below the horizon.
    """

    robust: bool = True
    full_image: bool = False
    min_peak_fraction: float = 0.85
    max_radius_fraction: float = 0.08
    min_share: float = 0.6
    max_spread_px: float = 1.5
    max_scatter: float = 0.03
    max_growth: float = 2.5
    sigma_px: float = 0.43
    max_apparent_zenith_deg: float = 89.6

    def __post_init__(self) -> None:
        """Refuse what makes no sense."""
        require_positive(self, self.max_radius_fraction, self.max_spread_px, self.sigma_px, self.max_growth)


class _Seen(NamedTuple):
    """The level circles of one blob, highest level first, and the light around it: a reflection has none."""

    circles: tuple[Circle, ...]
    halo: float

    @property
    def center(self) -> tuple[float, float]:
        return float(np.median([c.x for c in self.circles])), float(np.median([c.y for c in self.circles]))

    @property
    def spread_px(self) -> float:
        x, y = self.center
        return math.sqrt(float(np.mean([(c.x - x) ** 2 + (c.y - y) ** 2 for c in self.circles])))

    @property
    def radius(self) -> float:
        return float(np.median([c.radius for c in self.circles]))

    @property
    def share(self) -> float:
        return float(np.median([c.share for c in self.circles]))

    @property
    def scatter(self) -> float:
        return float(np.median([c.scatter / c.radius for c in self.circles]))

    @property
    def growth(self) -> float:
        radii = [c.radius for c in self.circles]
        return max(radii) / max(min(radii), 1e-9)

    @property
    def score(self) -> float:
        """Say how sun-like it is: well outlined, steady, large, and in the midst of its own glare."""
        return (
            self.halo**2
            * self.share
            * len(self.circles)
            * math.sqrt(self.radius)
            / (1.0 + self.spread_px / self.radius)
        )


_DEFAULT_OPTIONS = PaperOptions()


def detect_sun_in_photo(
    image: Image,
    *,
    full_scale: int,
    expectation: Expectation | None = None,
    options: PaperOptions = _DEFAULT_OPTIONS,
    lens: Lens | None = None,
    exposure_us: float | None = None,
) -> Detection:
    """Find the sun's saturated blob in an ordinary or HDR image.

    Parameters
    ----------
    image : (rows, columns) or (rows, columns, 3) uint8 or uint16; the colours' order does not matter.
    full_scale : its largest count.
    expectation : where the sun should be, where known; its apparent zenith sets the kernels' width.
    options : the search's and the verdict's.
    lens : where given, the expected radial bias of the blob is reported (never subtracted).
    exposure_us : told on in the answer.

    Returns
    -------
    What was seen, method "paper"; px, (0, 0) the centre of the top-left pixel.

    Raises
    ------
    InputError : the array is no image.
    """
    planes = planes_of(image, full_scale=full_scale)
    zenith = None if expectation is None else expectation.apparent_zenith
    if zenith is not None and zenith > math.radians(options.max_apparent_zenith_deg):
        return _none("below_horizon", f"the sun is at {math.degrees(zenith):.2f} degrees from the zenith", exposure_us)
    peak = float(planes.counts.max()) / full_scale
    if peak < options.min_peak_fraction:
        return _none("hidden", f"the brightest pixel is {peak:.2f} of full scale", exposure_us, peak)
    seen = _best_blob(planes, peak, expectation, options)
    estimates = _estimates(planes, seen, zenith, options)
    if seen is None or estimates is None:
        return _none("hidden", "no bright region is round", exposure_us, peak)
    verdict, reason = _verdict(seen, expectation, options)
    return _detection(seen, estimates, (verdict, reason), planes, options=options, lens=lens, exposure_us=exposure_us)


def _estimates(planes: Planes, seen: _Seen | None, zenith: float | None, options: PaperOptions) -> Estimates | None:
    """Return the paper's estimators' answers; where something else may be brighter, from the blob's surroundings."""
    if seen is None or not options.robust:
        return locate(planes, apparent_zenith=zenith, full_image=options.full_image)
    half = math.ceil(3.0 * seen.radius) + 8
    x0, y0 = (max(0, round(value) - half) for value in seen.center)
    rows, columns = slice(y0, round(seen.center[1]) + half + 1), slice(x0, round(seen.center[0]) + half + 1)
    found = locate(planes.part(rows, columns), apparent_zenith=zenith)
    return None if found is None else found.shifted(x0, y0)


def _none(verdict: Verdict, reason: str, exposure_us: float | None, peak: float | None = None) -> Detection:
    return Detection(
        method="paper", accepted=False, verdict=verdict, reason=reason, peak_fraction=peak, exposure_us=exposure_us
    )


def _best_blob(planes: Planes, peak: float, expectation: Expectation | None, options: PaperOptions) -> _Seen | None:
    """Return the roundest of the brightest regions; with an expectation only those around it count."""
    grey = planes.grey()
    top = float(grey.max())
    mask = (grey >= _LEVELS[1] * min(top, peak)).astype(np.uint8)
    seeds = thickest(mask, most=_SEEDS, least_radius=_LEAST_SEED_PX)
    if expectation is not None:
        reach = 5.0 * expectation.uncertainty_px + options.max_radius_fraction * min(mask.shape)
        seeds = [(x, y) for x, y in seeds if math.hypot(x - expectation.x_px, y - expectation.y_px) < reach]
    seen = [found for seed in seeds if (found := _circles(grey, top, seed, options)) is not None]
    return max(seen, key=lambda each: each.score, default=None)


def _circles(grey: Plane, top: float, seed: tuple[float, float], options: PaperOptions) -> _Seen | None:
    """Return the level circles around a point that look like circles at all."""
    largest = options.max_radius_fraction * min(grey.shape)
    half = math.ceil(2.5 * largest)
    x0, y0 = max(0, round(seed[0]) - half), max(0, round(seed[1]) - half)
    part = np.ascontiguousarray(grey[y0 : round(seed[1]) + half + 1, x0 : round(seed[0]) + half + 1])
    near, circles = (seed[0] - x0, seed[1] - y0), list[Circle]()
    for level in _LEVELS:
        circle = level_circle(part, level=level * top, near=near)
        if circle is None or circle.radius > largest or circle.share < 0.5 * options.min_share:
            continue
        near = (circle.x, circle.y)
        circles.append(circle._replace(x=circle.x + x0, y=circle.y + y0))
    return _Seen(tuple(circles), _halo(part, near, circles[0].radius)) if len(circles) >= 2 else None


def _halo(part: Plane, center: tuple[float, float], radius: float) -> float:
    """Return the median level between 1.5 and 2.5 radii."""
    rows, columns = np.mgrid[: part.shape[0], : part.shape[1]]
    far = np.hypot(columns - center[0], rows - center[1])
    ring = part[(far > 1.5 * radius) & (far < 2.5 * radius)]
    return float(np.median(ring)) if ring.size else 0.0


def _verdict(seen: _Seen, expectation: Expectation | None, options: PaperOptions) -> tuple[Verdict, str]:
    x, y = seen.center
    if expectation is not None:
        distance = math.hypot(x - expectation.x_px, y - expectation.y_px)
        if distance > 5.0 * expectation.uncertainty_px + 2.0:
            return "reflection", f"a round bright region {distance:.0f} px from where the sun should be"
    if seen.share < options.min_share:
        return "partly_covered", f"only {seen.share:.2f} of the bright region's outline is a circle"
    if seen.scatter > options.max_scatter:
        return "veiled", f"the bright region's outline strays from a circle by {seen.scatter:.3f} of its radius"
    if seen.spread_px > options.max_spread_px:
        return "veiled", f"the centre moves by {seen.spread_px:.1f} px from level to level"
    if seen.growth > options.max_growth or len(seen.circles) < 4:
        return (
            "veiled",
            f"the bright region has no edge: it grows {seen.growth:.1f}-fold over {len(seen.circles)} levels",
        )
    return "clear", f"a round bright region of {2.0 * seen.radius:.0f} px, its levels agree to {seen.spread_px:.2f} px"


def _detection(
    seen: _Seen,
    estimates: Estimates,
    verdict: tuple[Verdict, str],
    planes: Planes,
    *,
    options: PaperOptions,
    lens: Lens | None,
    exposure_us: float | None,
) -> Detection:
    x, y = seen.center if options.robust else estimates.position
    return Detection(
        method="paper",
        accepted=verdict[0] == "clear",
        verdict=verdict[0],
        reason=verdict[1],
        x_px=x,
        y_px=y,
        sigma_px=math.hypot(options.sigma_px, seen.spread_px),
        peak_fraction=float(planes.counts.max()) / planes.full_scale,
        background_fraction=float(np.median(planes.counts[::16, ::16])) / planes.full_scale,
        radius_px=seen.radius,
        ellipticity=1.0 - seen.share,
        saturated_px=int(np.count_nonzero(planes.counts >= 0.995 * planes.full_scale)),
        spread_px=estimates.spread_px,
        radial_bias_px=None if lens is None else bias_at(lens, x_px=x, y_px=y, radius_px=seen.radius),
        exposure_us=exposure_us,
    )
