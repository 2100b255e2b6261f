"""The moon in its own short exposure: a fit of its lit part, which gives the centre of the whole disc."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import cv2
import numpy as np
from scipy.special import ndtr

from sunarc.common.array_types import BoolArray, FloatArray, Image, IntArray
from sunarc.common.findings import Finding
from sunarc.detection.values import Detection, LightFit, Sensor, Verdict, require_photo

_ACROSS, _ALONG = 24, 16
"""Nodes of the Gauss-Legendre rule: a moon of 40 px is exact to 1e-3 of its level with a point spread of 0.7 px."""
_LEAST_WIDTH_PX = 0.2


class Surface(NamedTuple):
    """Nodes (n, 2) on the lit part, and the light of each, (k, n).

    The rows: the law of Lommel and Seeliger, of sum 1; Lambert's less that; and the first times polynomials of the
    place to the third degree, of unit rms over the disc: what seas and highlands make of it.
    """

    nodes: FloatArray
    light: FloatArray


def lit_surface(cos_phase: float) -> Surface:
    """Return the lit part of a disc at a phase angle."""
    t, across = np.polynomial.legendre.leggauss(_ACROSS)
    s, along = np.polynomial.legendre.leggauss(_ALONG)
    # v = sin(angle): the ends of the horns are dense, where the chord goes to 0
    angle = 0.5 * np.pi * t
    v, chord = np.sin(angle), np.cos(angle)
    first, last = -cos_phase * chord, chord
    u = 0.5 * ((last - first)[:, None] * s + (last + first)[:, None])
    area = (0.5 * np.pi * across * chord * 0.5 * (last - first))[:, None] * along
    v = np.broadcast_to(v[:, None], u.shape)
    emission = np.sqrt(np.maximum(1.0 - u * u - v * v, 0.0))
    incidence = np.maximum(u * np.sqrt(max(1.0 - cos_phase**2, 0.0)) + emission * cos_phase, 0.0)
    seeliger = incidence / np.maximum(incidence + emission, 1e-9) * area
    lambert = incidence * area
    seeliger, lambert = seeliger / seeliger.sum(), lambert / lambert.sum()
    light = np.stack([seeliger, lambert - seeliger, *(seeliger * one for one in _zernike_polynomials(u, v))])
    return Surface(np.stack([u.ravel(), v.ravel()], axis=-1), light.reshape(light.shape[0], -1))


def _zernike_polynomials(u: FloatArray, v: FloatArray) -> list[FloatArray]:
    """Return Zernike's polynomials of the first to third degree, of unit rms over the whole disc."""
    square = u * u + v * v
    return [
        2.0 * u,
        2.0 * v,
        np.sqrt(3.0) * (2.0 * square - 1.0),
        np.sqrt(6.0) * (u * u - v * v),
        np.sqrt(6.0) * 2.0 * u * v,
        np.sqrt(8.0) * (3.0 * square - 2.0) * u,
        np.sqrt(8.0) * (3.0 * square - 2.0) * v,
        np.sqrt(8.0) * (u**3 - 3.0 * u * v * v),
        np.sqrt(8.0) * (3.0 * u * u * v - v**3),
    ]


class PointSpread(NamedTuple):
    """1-sigma of a Gaussian along the columns and along the rows, px."""

    x: float
    y: float


def surface_images(
    surface: Surface,
    edges_px: FloatArray,
    centre: FloatArray,
    spread: PointSpread,
    *,
    origin: tuple[int, int],
    side: int,
) -> FloatArray:
    """Return the blurred images (k + 1, side, side) of a surface, each integrated over the pixels.

    The last is what a point spread of covariance xy = `spread.x * spread.y` would add to the first, to first order.

    Parameters
    ----------
    edges_px : (2, 2), of `MoonExpectation`.
    centre : (2,) of the disc, px.
    spread : widths of the point spread.
    origin, side : first pixel and size of the stamp.
    """
    pixels = surface.nodes @ edges_px.T + centre
    shares, slopes = [], []
    for axis, width in enumerate(spread):
        edge = (origin[axis] + np.arange(side + 1)[:, None] - 0.5 - pixels[:, axis]) / max(width, _LEAST_WIDTH_PX)
        shares.append(np.diff(ndtr(edge), axis=0))
        slopes.append(np.diff(np.exp(-0.5 * edge**2), axis=0) / math.sqrt(2.0 * math.pi))
    images = (surface.light[:, None, :] * shares[1]) @ shares[0].T
    skewed = (surface.light[0] * slopes[1]) @ slopes[0].T
    return np.concatenate([images, skewed[None]])


_WIDTH_SD, _WIDTH_PX = 0.5, 0.9
_LAMBERT_MEAN, _LAMBERT_SD = 0.3, 0.5
_SEAS_SD = (0.12,) * 2 + (0.10,) * 3 + (0.07,) * 4
"""Of the polynomials' coefficients: seas are half as bright as highlands, and cover a third of the disc."""
_ASTIGMATISM_SD = 0.15
_AUREOLE_SD = 0.1
_AUREOLE_RADII, _AUREOLE_WIDTHS = 1.5, 2.0
_SHAPE = 4
"""After x, y and the logarithms of the point spread's width and of its axes' ratio to that: Lambert's share, the seas,
the covariance of the point spread, and the aureole's share; then a level and a background of each colour."""
_SEAS = slice(_SHAPE + 1, _SHAPE + 1 + len(_SEAS_SD))
_PRIOR_MEAN = np.array([np.log(_WIDTH_PX), 0.0, _LAMBERT_MEAN, *(0.0 for _ in _SEAS_SD), 0.0, 0.0])
_PRIOR_SD = np.array([_WIDTH_SD, _ASTIGMATISM_SD, _LAMBERT_SD, *_SEAS_SD, _ASTIGMATISM_SD, _AUREOLE_SD])
_LINEAR = 2 + _PRIOR_MEAN.size
_ROUNDS = 40
_STEPS = np.full(_SHAPE, 1e-3)


class Pixels(NamedTuple):
    """A stamp: first pixel, counts (side, side), variance (infinite where left out), and the colour of each pixel."""

    origin: tuple[int, int]
    counts: FloatArray
    variance: FloatArray
    colour: IntArray


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class MoonFit(LightFit):
    """The fitted moon.

    Attributes
    ----------
    light : (side, side) counts without background.
    aureole : the aureole's brightest pixel over that of the light.
    shape_misfit : mean square of the seas' coefficients over their prior's 1-sigma.
    """

    light: FloatArray
    aureole: float
    shape_misfit: float


def fit_moon(pixels: Pixels, surface: Surface, edges_px: FloatArray, start: FloatArray) -> MoonFit:
    """Fit centre, point spread, brightness law, aureole, and level and background of each colour.

    Parameters
    ----------
    pixels : the stamp.
    surface, edges_px : the lit part.
    start : (2,) px to begin at.
    """
    from scipy.optimize import least_squares  # noqa: PLC0415 - the command line loads without it

    problem = _Problem(pixels, surface, edges_px)
    found = least_squares(
        problem.residuals, problem.start(start), jac=problem.jacobian, method="trf", x_scale="jac", max_nfev=_ROUNDS
    )
    return problem.fitted(found.x)


class _Problem:
    """Residuals and their derivatives; the shape's images of the last parameters are kept."""

    def __init__(self, pixels: Pixels, surface: Surface, edges_px: FloatArray) -> None:
        self._pixels, self._surface, self._edges = pixels, surface, edges_px
        self._used = np.isfinite(pixels.variance)
        self._sigma = np.sqrt(pixels.variance[self._used])
        self._colours = int(pixels.colour.max()) + 1
        self._is = [pixels.colour == one for one in range(self._colours)]
        self._sky = [float(np.median(pixels.counts[self._used & one])) for one in self._is]
        first = self._used & self._is[0]
        mean = float(np.mean((pixels.counts - self._sky[0])[first]))
        self._scale = max(mean * pixels.colour.size, 1.0)

    def start(self, centre: FloatArray) -> FloatArray:
        """Return the parameters to begin at."""
        return np.asarray(np.r_[centre, _PRIOR_MEAN, np.ones(self._colours), self._sky])

    def residuals(self, parameters: FloatArray) -> FloatArray:
        """Return the misfit of the pixels over their sigma, and that of the priors."""
        total, _ = self._compute_counts(parameters)
        misfit = (total - self._pixels.counts)[self._used] / self._sigma
        return np.asarray(np.r_[misfit, (parameters[2:_LINEAR] - _PRIOR_MEAN) / _PRIOR_SD])

    def jacobian(self, parameters: FloatArray) -> FloatArray:
        """Return the derivatives of the residuals."""
        parts = self._render_parts(parameters)
        level = self._get_levels(parameters)
        columns = []
        for row, step in enumerate(_STEPS):
            moved = parameters.copy()
            moved[row] += step
            columns.append(
                level * (_sum_parts(self._render_parts(moved), parameters) - _sum_parts(parts, parameters)) / step
            )
        columns += [level * part for part in parts[1:]]
        shape = _sum_parts(parts, parameters)
        columns += [np.where(one, self._scale * shape, 0.0) for one in self._is]
        columns += [np.where(one, 1.0, 0.0) for one in self._is]
        by_pixels = np.stack([column[self._used] / self._sigma for column in columns], axis=-1)
        prior = np.zeros((_PRIOR_MEAN.size, by_pixels.shape[1]))
        prior[:, 2:_LINEAR] = np.diag(1.0 / _PRIOR_SD)
        return np.asarray(np.concatenate([by_pixels, prior]))

    def fitted(self, parameters: FloatArray) -> MoonFit:
        """Return the results at the best parameters."""
        total, light = self._compute_counts(parameters)
        misfit = (total - self._pixels.counts)[self._used]
        jacobian = self.jacobian(parameters)
        covariance = np.linalg.pinv(jacobian.T @ jacobian, hermitian=True)
        weight = light[self._used] / self._sigma
        chi2 = float(np.sum((misfit / self._sigma) ** 2)) / max(misfit.size - parameters.size, 1)
        return MoonFit(
            x_px=float(parameters[0]),
            y_px=float(parameters[1]),
            sigma_px=math.sqrt(0.5 * float(covariance[0, 0] + covariance[1, 1]) * max(chi2, 1.0)),
            width_px=float(np.exp(parameters[2])),
            snr=float(np.linalg.norm(weight)),
            chi2=chi2,
            residual=float(np.sqrt(np.mean(misfit**2))) / max(float(light.max()), 1e-9),
            light=light,
            aureole=self._compute_aureole(parameters),
            shape_misfit=float(np.mean((parameters[_SEAS] / _SEAS_SD) ** 2)),
        )

    def _compute_counts(self, parameters: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the counts, and those of the moon alone."""
        light = self._get_levels(parameters) * _sum_parts(self._render_parts(parameters), parameters)
        sky = parameters[_LINEAR + self._colours :][self._pixels.colour]
        return light + sky, light

    def _compute_aureole(self, parameters: FloatArray) -> float:
        parts = self._render_parts(parameters)
        return float(parameters[_LINEAR - 1] * np.max(parts[-1] + parts[0]) / np.max(_sum_parts(parts, parameters)))

    def _get_levels(self, parameters: FloatArray) -> FloatArray:
        return np.asarray(self._scale * parameters[_LINEAR : _LINEAR + self._colours][self._pixels.colour])

    def _render_parts(self, parameters: FloatArray) -> FloatArray:
        """Return the image of unit light, and its changes by Lambert's law, the seas and the aureole."""
        side, origin = self._pixels.counts.shape[0], self._pixels.origin
        width, ratio = (float(np.exp(np.clip(one, -2.0, 2.5))) for one in parameters[2:4])
        spread = PointSpread(width * ratio, width / ratio)
        images = surface_images(self._surface, self._edges, parameters[:2], spread, origin=origin, side=side)
        middle = parameters[:2] + self._edges @ (self._surface.nodes.T @ self._surface.light[0])
        broad = _AUREOLE_RADII * np.sqrt(abs(float(np.linalg.det(self._edges)))) + _AUREOLE_WIDTHS * width
        x, y = (np.exp(-0.5 * ((origin[axis] + np.arange(side) - middle[axis]) / broad) ** 2) for axis in (0, 1))
        aureole = y[:, None] * x / (2.0 * np.pi * broad**2)
        return np.concatenate([images, (aureole - images[0])[None]])


def _sum_parts(parts: FloatArray, parameters: FloatArray) -> FloatArray:
    return np.asarray(parts[0] + np.tensordot(parameters[_SHAPE:_LINEAR], parts[1:], axes=1))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class MoonExpectation:
    """Where and how the moon should be in an image.

    Attributes
    ----------
    x_px, y_px : predicted pixel of the disc's centre; (0, 0) is the centre of the top-left pixel.
    uncertainty_px : 1-sigma per axis of the prediction.
    edges_px : (2, 2) px: the first column leads from the centre to the middle of the lit limb, the second to the limb a
        quarter of the circle onwards.
    cos_phase : cosine of the phase angle: 1 is full, 0 half, -1 new.
    """

    x_px: float
    y_px: float
    uncertainty_px: float
    edges_px: FloatArray
    cos_phase: float


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
"""Sky next to the disc over the disc: thin haze, and a cloud that leaves no limb."""
_MOST_SIGMA_PX = 0.5
_MOST_SHAPE_MISFIT = 3.0
"""Mean square of the seas' coefficients over their prior: a lamp is no disc."""
_RESOLVED_PX = 3.0
"""Radius beyond which seas show that the polynomials do not have."""
_FLOOR_PX = 0.015
"""1-sigma that is added: no point spread is the Gaussian of the fit."""
_LAW_RADII = 0.008
"""1-sigma over the radius of the surface's residual brightness: the seas, and a terminator that no law has."""
_HAZE_RADII = 0.6
"""1-sigma over the radius that a haze of 1 adds: a cloud is not even over the disc."""
_COLOURS = {"RGGB": (0, 1, 1, 2), "BGGR": (2, 1, 1, 0), "GRBG": (1, 0, 2, 1), "GBRG": (1, 2, 0, 1)}


def detect_moon(image: Image, expected: MoonExpectation, *, sensor: Sensor) -> Detection:
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
    InputError : the array is not an image.
    """
    require_photo(image, full_scale=sensor.full_scale)
    if expected.cos_phase < 2.0 * _LEAST_LIT - 1.0:
        return _make_rejection(Finding("moon_thin", {"lit": 0.5 * (1.0 + expected.cos_phase), "limit": _LEAST_LIT}))
    surface = lit_surface(expected.cos_phase)
    start = _estimate_centre(image, expected, surface)
    if start is None:
        return _make_rejection(Finding("moon_not_found", {"sigma_px": expected.uncertainty_px}))
    radius = math.sqrt(abs(float(np.linalg.det(expected.edges_px))))
    longest = float(np.max(np.linalg.norm(expected.edges_px, axis=0)))
    stamp, clipped = _cut_stamp(image, start, longest, sensor)
    near = _distance_in_radii(stamp, start, expected.edges_px) < 1.0 + 2.0 / radius
    n_clipped = int(np.count_nonzero(clipped & near))
    if n_clipped > _MOST_CLIPPED * math.pi * radius**2 * 0.5 * (1.0 + expected.cos_phase):
        return _make_rejection(Finding("moon_saturated", {"n": n_clipped}), saturated_px=n_clipped)
    fitted = fit_moon(stamp, surface, expected.edges_px, start)
    haze = max(_measure_haze(stamp, fitted, longest), fitted.aureole)
    return _judge_moon(fitted, expected, haze=haze, n_clipped=n_clipped, full_scale=sensor.full_scale)


def _estimate_centre(image: Image, expected: MoonExpectation, surface: Surface) -> FloatArray | None:
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


def _cut_stamp(image: Image, start: FloatArray, longest: float, sensor: Sensor) -> tuple[Pixels, BoolArray]:
    """Return the pixels around the disc, and which are clipped; those outside of the image take no part."""
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


def _distance_in_radii(stamp: Pixels, centre: FloatArray, edges_px: FloatArray) -> FloatArray:
    """Return how far each pixel lies from the disc's centre, in radii."""
    rows, columns = np.indices(stamp.counts.shape)
    offset = np.stack([columns + stamp.origin[0] - centre[0], rows + stamp.origin[1] - centre[1]], axis=-1)
    return np.asarray(np.linalg.norm(offset @ np.linalg.inv(edges_px).T, axis=-1))


def _measure_haze(stamp: Pixels, fitted: MoonFit, longest: float) -> float:
    """Return the sky's light just outside the disc over the disc's, above the level at the stamp's edge."""
    rows, columns = np.indices(stamp.counts.shape)
    far = np.hypot(columns + stamp.origin[0] - fitted.x_px, rows + stamp.origin[1] - fitted.y_px)
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


def _judge_moon(
    fitted: MoonFit, expected: MoonExpectation, *, haze: float, n_clipped: int, full_scale: int
) -> Detection:
    """Return the detection, accepted or not."""
    radius = math.sqrt(abs(float(np.linalg.det(expected.edges_px))))
    law, cloud = _LAW_RADII * radius, _HAZE_RADII * radius * max(haze, 0.0)
    sigma = math.hypot(fitted.sigma_px, _FLOOR_PX, law, cloud)
    distance = math.hypot(fitted.x_px - expected.x_px, fitted.y_px - expected.y_px)
    allowed = _SEARCH_SIGMAS * math.hypot(expected.uncertainty_px, sigma)
    refused = []
    if fitted.snr < _LEAST_SNR:
        refused.append(Finding("moon_not_found", {"sigma_px": expected.uncertainty_px}))
    if distance > allowed:
        refused.append(Finding("moon_displaced", {"distance_px": distance, "limit_px": allowed}))
    if haze > _MOST_HAZE:
        refused.append(Finding("moon_in_cloud", {"haze": haze, "limit": _MOST_HAZE}))
    if fitted.residual > _MOST_RESIDUAL or not sigma < _MOST_SIGMA_PX:
        refused.append(Finding("moon_poor_fit", {"residual": fitted.residual, "sigma_px": sigma}))
    most = _MOST_SHAPE_MISFIT * max(radius / _RESOLVED_PX, 1.0) ** 2
    if fitted.shape_misfit > most:
        refused.append(Finding("moon_other_shape", {"misfit": fitted.shape_misfit, "limit": most}))
    found = [Finding("moon_hazy", {"haze": haze})] if haze > _HAZY else []
    return Detection(
        method="moon",
        accepted=not refused,
        verdict="hidden" if refused else "veiled" if found else "clear",
        findings=(*refused, *found) or (Finding("moon_found", {"chi2": fitted.chi2, "sigma_px": sigma}),),
        x_px=fitted.x_px,
        y_px=fitted.y_px,
        sigma_px=sigma,
        peak_fraction=float(fitted.light.max()) / full_scale,
        radius_px=radius,
        residual_chi2=fitted.chi2,
        snr=fitted.snr,
        saturated_px=n_clipped,
    )


def _make_rejection(finding: Finding, *, saturated_px: int = 0) -> Detection:
    verdict: Verdict = "saturated" if saturated_px else "hidden"
    return Detection(method="moon", accepted=False, verdict=verdict, findings=(finding,), saturated_px=saturated_px)


_HALF_PX = 24
"""Of a moon of 5 px as much sky as the aureole needs; one of 40 px still has its limb inside."""
_MOST = 4
"""The moon, and lamps that are brighter."""
_BLUR_PX = 1.5
_LEAST_FRACTION = 0.01
"""Of full scale, above the median of the image."""


class Cutout(NamedTuple):
    """A part of an image: its first pixel, and its counts."""

    x: int
    y: int
    image: Image


def brightest_cutouts(image: Image, *, full_scale: int) -> tuple[Cutout, ...]:
    """Return the parts around the brightest places of an image, at most four, the brightest first.

    Parameters
    ----------
    image : (rows, columns) counts, a mosaic too.
    full_scale : its largest count.

    Raises
    ------
    InputError : the array is not an image.
    """
    require_photo(image, full_scale=full_scale)
    # a median first: pixels that are stuck at full scale are no lights
    calm = np.asarray(cv2.medianBlur(image, 3), dtype=np.float32)
    smooth = np.asarray(cv2.GaussianBlur(calm, (0, 0), _BLUR_PX), dtype=np.float32)
    smooth -= np.float32(np.median(image[::4, ::4]))
    near = _HALF_PX // 2
    found: list[Cutout] = []
    while len(found) < _MOST:
        row, column = np.unravel_index(int(np.argmax(smooth)), smooth.shape)
        if smooth[row, column] < _LEAST_FRACTION * full_scale:
            break
        # even first pixels: the mosaic begins with the same colour
        top, left = (max(int(at) - _HALF_PX, 0) & ~1 for at in (row, column))
        found.append(Cutout(left, top, image[top : row + _HALF_PX + 1, left : column + _HALF_PX + 1].copy()))
        smooth[max(row - near, 0) : row + near, max(column - near, 0) : column + near] = 0.0
    return tuple(found)


def cutout_around(cutouts: tuple[Cutout, ...], x_px: float, y_px: float, *, within_px: float) -> Cutout | None:
    """Return the cutout whose middle lies nearest to a pixel; None where none is as near as `within_px`."""
    distances = [
        math.hypot(one.x + one.image.shape[1] / 2 - x_px, one.y + one.image.shape[0] / 2 - y_px) for one in cutouts
    ]
    distance, nearest = min(zip(distances, cutouts, strict=True), key=lambda pair: pair[0], default=(math.inf, None))
    return nearest if distance <= within_px + _HALF_PX else None
