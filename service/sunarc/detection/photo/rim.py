"""The rim of a plateau: where the light first falls for good in every direction, and the circle through it.

Light outside the circle (a cloud next to the sun, a streak, glare on the dome) is more often wrong than that
inside, so it is weighted harder. Circles at three levels each give a centre; their medians are the answer, and how far
they are apart is a part of its uncertainty.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import cv2
import numpy as np

from sunarc import _kernels
from sunarc.common.array_types import BoolArray, FloatArray, Image
from sunarc.detection.photo.plateau import Plateau

_LEAST_CROSS_PX2 = 1e-6  # three points with less are on a line


def circles_through(points: FloatArray) -> FloatArray:
    """Return the circles through triples of neighbours by a sixth to a third of the points, (m, 3): x, y, radius.

    The triples are fixed ones, so that every arc is tried. NaN where three are on a line.
    """
    n = len(points)
    at = np.arange(0, 3 * n, 2)
    part, first = np.array([3, 4, 6])[at // n], at % n
    a = points[first]
    b, c = (points[(first + times * n // part) % n] - a for times in (1, 2))
    cross = 2.0 * (b[:, 0] * c[:, 1] - b[:, 1] * c[:, 0])
    cross[np.abs(cross) < _LEAST_CROSS_PX2] = np.nan
    b2, c2 = np.sum(b * b, axis=1), np.sum(c * c, axis=1)
    off = np.column_stack([c[:, 1] * b2 - b[:, 1] * c2, b[:, 0] * c2 - c[:, 0] * b2]) / cross[:, None]
    return np.column_stack([a + off, np.hypot(off[:, 0], off[:, 1])])


RAYS = 180
_LEVELS = (0.985, 0.97, 0.955)  # of the plateau: beside it, in the steepest part of the glare
_SHARP_LEVELS = (0.85, 0.7, 0.5)  # of the fall from a plateau with an edge to the light beside it
_SHARP, _SHARP_PX, _SHARP_LIGHT = 2.0, 2.5, 0.52  # radii, px beyond, and the light there below which it has an edge
_START, _REACH, _REACH_PX = 0.5, 3.0, 10.0
_MARGIN_PX = 4  # of the blur
_STEPS = 60  # along an inscribed radius; never finer than half a pixel
_LASTING, _LASTING_STEPS = 0.08, 3  # of the radius, and samples at least, for which a fall must last
_BLUR, _LEAST_BLUR_PX, _BLUR_PX = 0.1, 0.4, 1.0  # of the radius, within these px
_LEAST_SCALE_PX, _LEAST_SCALE = 0.3, 0.01  # px, and of the radius
_FIRST_SCALE, _WHOLE_SCALE = 0.06, 0.15  # of the radius: of the circle through three points, and through the whole rim
_DRAWN_OUT, _ROUND = 0.1, 1e-4  # of the radius, 1-sigma: by so much a lens draws out a rim; glare has none
_LEAST_POINTS, _LEAST_SHARE = 20, 0.25
_FOLLOWED, _FOLLOWED_SCALES = 0.06, 3.0  # of the radius, and scales, within which the rim follows the circle
_AT = (1.7, 2.6)  # radii at which the light around is taken
_BESIDE = 1.15
"""Radii at which the symmetry of the glare is taken: farther out it is the sky's, within that the plateau's."""

_GRADIENT = (0.7, 0.85)
"""Share of the light's variance around a rim that is once around, from which it is a gradient's: at blown-out horizons
it was 0.82 to 0.98, of the texture of the glare about stand-ins of real suns 0.73 and less."""
_PULLED = 0.45
"""Share of the pull by which a rim's centre is off: 0.25 to 0.55 at drawn blown-out horizons, 0.96 by a gradient."""

_DARK, _FAR_DARKER = 0.06, 0.25
"""Of the plateau, and of the median of a ring of light: darker than both is the rim of the field."""

_CLIPPED = 0.6  # share of a plateau that is level where it is clipped
_WITHIN, _FLAT, _FLAT_COUNTS = 0.75, 0.006, 1.5  # radii; of the level, and counts at least: JPEG's noise
_LEAST_FALL = 0.01  # of the level: less is JPEG's noise

_ANGLES = np.arange(RAYS) * (2.0 * math.pi / RAYS)
_COSINE, _SINE = np.cos(_ANGLES), np.sin(_ANGLES)
_HARMONICS = np.column_stack(
    [np.ones(RAYS), *(part(times * _ANGLES) for times in (1, 2, 3) for part in (np.cos, np.sin))]
)


class Circle(NamedTuple):
    """A circle through the rim at one level.

    x, y, radius : px. scale : scatter of the rim about it, px. share : of the rays on which the rim follows it.
    """

    x: float
    y: float
    radius: float
    scale: float
    share: float


class Rim(NamedTuple):
    """The rim of a plateau.

    x, y : medians of the circles, less the share of the pull by which they are off, px. radius : their median, px.
    scatter : of the rim about them, px. share : of the rays on which it follows them. spread : rms distance of the
    circles' centres from the median, px. offset : of that from the centre of the inscribed circle, px.
    ellipticity : 1 - minor/major axis. level : of the plateau, counts. flat : share of the light within the rim that is
    level to within JPEG's noise: 1 where the sun is clipped. near, far : light at 1.7 and 2.6 radii over the level,
    medians over the rays. uneven : width of the middle 70 % of the light at 1.7 radii over its fall from the plateau.
    pull : see `_displacement_by_gradient`, px; 0 of a rim with an edge. lopsided : see `_measure_lopsidedness`.
    circles : how many levels have one.
    edged : whether the light falls to half within twice the radius: in a short exposure, or no sun.
    """

    x: float
    y: float
    radius: float
    scatter: float
    share: float
    spread: float
    offset: float
    ellipticity: float
    level: float
    flat: float
    near: float
    far: float
    uneven: float
    pull: float
    lopsided: float
    circles: int
    edged: bool = False


class _Rays(NamedTuple):
    """Light along the rays, (rays, radii), over the plateau's level; NaN where it is not known."""

    light: FloatArray
    radii: FloatArray


def light_radius(radius: float) -> float:
    """Return how far from its centre the light about a plateau is used, px."""
    return _REACH * radius + _REACH_PX + _MARGIN_PX


def fit_rim(plane: Image, plateau: Plateau, *, static: BoolArray | None = None) -> Rim | None:
    """Return the rim of a plateau; None where no circle follows it.

    Parameters
    ----------
    plane : (rows, columns), the faintest colour.
    plateau : an inscribed circle, as `plateaus` finds it.
    static : (rows, columns), pixels that do not take part.
    """
    x, y, radius = plateau.x, plateau.y, plateau.radius
    for _ in range(2):
        rays = _sample_rays(plane, plateau._replace(x=x, y=y, radius=radius), static)
        beside = _median_light_at(rays, max(_SHARP * radius, radius + _SHARP_PX))
        edged = beside < _SHARP_LIGHT
        if edged:
            settled = _measure_clipped_level(rays, radius, plateau.level)
            plateau, rays = plateau._replace(level=settled * plateau.level), rays._replace(light=rays.light / settled)
        levels = [beside + (1.0 - beside) * share for share in _SHARP_LEVELS] if edged else _LEVELS
        crossing = [_find_crossings(rays, level, radius) for level in levels]
        circles = [
            c for r in crossing if (c := _fit_circle_to_rim(r, x, y, edged)) is not None and c.share >= _LEAST_SHARE
        ]
        if not circles:
            return None
        x, y, fitted = (float(np.median([c[k] for c in circles])) for k in range(3))
        if math.hypot(x - plateau.x, y - plateau.y) > plateau.radius:
            return None
        radius = min(fitted, 2.0 * plateau.radius)
    found = _make_rim(plateau, rays, crossing, circles, (x, y, fitted))._replace(edged=edged)
    return found if edged else _correct_for_gradient(found, _displacement_by_gradient(rays, crossing, fitted))


def _correct_for_gradient(found: Rim, pull: tuple[float, float]) -> Rim:
    """Return a rim at the place that it has without a gradient of the light."""
    x, y = found.x - _PULLED * pull[0], found.y - _PULLED * pull[1]
    return found._replace(x=x, y=y, pull=math.hypot(*pull))


def _make_rim(
    plateau: Plateau, rays: _Rays, crossing: list[FloatArray], circles: list[Circle], center: tuple[float, float, float]
) -> Rim:
    x, y, radius = center
    squares = [(c.x - x) ** 2 + (c.y - y) ** 2 for c in circles]
    near, far = (_median_light_at(rays, ratio * radius) for ratio in _AT)
    return Rim(
        x,
        y,
        radius,
        scatter=float(np.median([c.scale for c in circles])),
        share=float(np.median([c.share for c in circles])),
        spread=math.sqrt(float(np.mean(squares))),
        offset=math.hypot(x - plateau.x, y - plateau.y),
        ellipticity=_measure_ellipticity(crossing[0], radius),
        level=plateau.level,
        flat=_measure_flatness(rays, radius, plateau.level),
        near=near,
        far=far,
        uneven=_measure_unevenness(rays, _AT[0] * radius),
        pull=0.0,
        lopsided=_measure_lopsidedness(rays, _BESIDE * radius),
        circles=len(circles),
    )


def _sample_rays(plane: Image, plateau: Plateau, static: BoolArray | None) -> _Rays:
    """Sample the light along rays from half a radius outwards."""
    x, y, radius, level = plateau
    reach = _REACH * radius + _REACH_PX
    half = math.ceil(reach) + _MARGIN_PX
    x0, y0 = max(0, round(x) - half), max(0, round(y) - half)
    window = slice(y0, round(y) + half + 1), slice(x0, round(x) + half + 1)
    blur = min(max(_BLUR * radius, _LEAST_BLUR_PX), _BLUR_PX)
    part = cv2.GaussianBlur(plane[window].astype(np.float32), (0, 0), blur) / np.float32(level)
    radii = np.arange(_START * radius, reach, max(0.5, radius / _STEPS))
    columns = (x - x0 + np.outer(_COSINE, radii)).astype(np.float32)
    rows = (y - y0 + np.outer(_SINE, radii)).astype(np.float32)
    light = cv2.remap(part, columns, rows, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT, borderValue=(-1.0,))
    inside = (columns >= 0) & (rows >= 0) & (columns <= part.shape[1] - 1) & (rows <= part.shape[0] - 1)
    if static is not None:
        hidden = cv2.remap(static[window].astype(np.float32), columns, rows, cv2.INTER_LINEAR, borderValue=(0.0,))
        inside &= np.asarray(hidden) == 0.0
    return _Rays(np.where(inside, np.asarray(light, dtype=np.float64), np.nan), radii)


def _sample_ring(rays: _Rays, radius: float) -> FloatArray:
    """Return the light at a radius, (rays,); NaN beyond the rim of the field, where it is far darker than elsewhere."""
    ring = rays.light[:, min(int(np.searchsorted(rays.radii, radius)), rays.radii.size - 1)]
    known = ring[np.isfinite(ring)]
    middle = float(np.median(known)) if known.size else 0.0
    return np.where(ring < min(_DARK, _FAR_DARKER * middle), np.nan, ring)


def _known_ring_light(rays: _Rays, radius: float) -> FloatArray:
    """Return the light at a radius on the rays where it is known."""
    column = _sample_ring(rays, radius)
    return np.asarray(column[np.isfinite(column)])


def _median_light_at(rays: _Rays, radius: float) -> float:
    """Return the median light at a radius, 0 where nothing is known there."""
    ring = _known_ring_light(rays, radius)
    return float(np.median(ring)) if ring.size else 0.0


def _measure_unevenness(rays: _Rays, radius: float) -> float:
    """Return the width of the middle 70 % of the light at a radius over its fall from the plateau."""
    ring = _known_ring_light(rays, radius)
    if ring.size < _LEAST_POINTS:
        return 1.0
    low, middle, high = np.quantile(ring, (0.15, 0.5, 0.85))
    return float((high - low) / max(1.0 - middle, _LEAST_FALL))


def _measure_lopsidedness(rays: _Rays, radius: float) -> float:
    """Return the amplitude of the light once and three times around, at a radius, over its fall from the plateau.

    A lens draws glare out, twice around; the edge of a cloud has the other parts.
    """
    ring = _sample_ring(rays, radius)
    known = np.isfinite(ring)
    if np.count_nonzero(known) < _LEAST_POINTS:
        return 1.0
    middle, *parts = np.linalg.lstsq(_HARMONICS[known], ring[known])[0].tolist()
    return float(math.hypot(*parts[:2], *parts[4:]) / max(1.0 - middle, _LEAST_FALL))


def _displacement_by_gradient(rays: _Rays, crossing: list[FloatArray], radius: float) -> tuple[float, float]:
    """Return the displacement (x, y), px, of a level's circle by a light gradient across the glare.

    A gradient g moves the circle of radius R by g R / s, s being the fall of the glare there: from the first to the
    last level. About that circle the light at k R has then an amplitude g R (k - q) once around, q being its fall at
    k R over s. Light that varies in other ways, too, is the glare's own, and moves its levels far less.
    """
    near, far = _AT[0] * radius, _AT[1] * radius
    ring = _sample_ring(rays, near)
    known = np.isfinite(ring)
    apart = crossing[-1] - crossing[0]
    apart = apart[np.isfinite(apart)]
    if np.count_nonzero(known) < _LEAST_POINTS or not apart.size:
        return 0.0, 0.0
    fall = (_LEVELS[0] - _LEVELS[-1]) / max(float(np.median(apart)), _LEAST_SCALE_PX)
    design = _HARMONICS[known, :3]
    once = np.linalg.lstsq(design, ring[known])[0]
    left = float(np.var(ring[known] - design @ once) / max(float(np.var(ring[known])), np.finfo(np.float64).tiny))
    even = float(np.interp(1.0 - left, _GRADIENT, (0.0, 1.0)))
    beyond = max(_median_light_at(rays, near) - _median_light_at(rays, far), 0.0) / (far - near)
    x, y = (even * once[1:] / (fall * (_AT[0] - min(beyond / fall, 1.0)))).tolist()
    return x, y


def _measure_clipped_level(rays: _Rays, radius: float, level: float) -> float:
    """Return a clipped plateau's level over the one it was found by, which may be ringing; 1 where not clipped."""
    within = rays.light[:, rays.radii <= _WITHIN * radius]
    known = within[np.isfinite(within)]
    if not known.size:
        return 1.0
    middle = float(np.median(known))
    is_clipped = np.mean(np.abs(known - middle) <= max(_FLAT, _FLAT_COUNTS / level)) >= _CLIPPED
    return middle if is_clipped else 1.0


def _measure_flatness(rays: _Rays, radius: float, level: float) -> float:
    within = rays.light[:, rays.radii <= _WITHIN * radius]
    known = within[np.isfinite(within)]
    return float(np.mean(np.abs(known - 1.0) <= max(_FLAT, _FLAT_COUNTS / level))) if known.size else 0.0


def _find_crossings(rays: _Rays, level: float, radius: float) -> FloatArray:
    """Return the radius on each ray, (rays,), from which the light stays below a level; NaN where it does not fall."""
    step = rays.radii[1] - rays.radii[0]
    lasting = max(_LASTING_STEPS, round(_LASTING * radius / step))
    return _kernels.crossings(rays.light, level, lasting, rays.radii)


def _fit_circle_to_rim(crossing: FloatArray, x: float, y: float, edged: bool) -> Circle | None:  # noqa: FBT001 - of the rim
    """Fit a circle to the rim of rays about (x, y); one that is drawn out to a rim with an edge."""
    known = np.isfinite(crossing)
    if np.count_nonzero(known) < _LEAST_POINTS:
        return None
    points = np.column_stack([x + (crossing * _COSINE)[known], y + (crossing * _SINE)[known]])
    start, scale = _find_consensus_circle(points)
    if not edged:
        return _fit_circle_harmonics(points, start, scale, _ROUND)
    middle = np.median(points, axis=0)
    whole = np.array([*middle, np.median(np.hypot(*(points - middle).T))])
    starts = ((start, scale), (whole, _WHOLE_SCALE * float(whole[2])))
    fitted = [
        one for first, width in starts if (one := _fit_circle_harmonics(points, first, width, _DRAWN_OUT)) is not None
    ]
    return max(fitted, key=lambda one: one.share, default=None)


def _fit_circle_harmonics(points: FloatArray, start: FloatArray, scale: float, drawn_out: float) -> Circle | None:
    """Fit a circle whose radius varies with twice the angle, from a circle; None where the points follow none."""
    found = _kernels.fitted_rim(points, start, scale, drawn_out, _LEAST_POINTS // 2, _LEAST_SCALE_PX, _LEAST_SCALE)
    if found is None:
        return None
    state, scale, residual = found
    followed = np.abs(residual) < max(_FOLLOWED_SCALES * scale, _FOLLOWED * state[2])
    x, y, radius = (float(value) for value in state[:3])
    return Circle(x, y, radius, scale, float(np.count_nonzero(followed)) / RAYS)


def _find_consensus_circle(points: FloatArray) -> tuple[FloatArray, float]:
    """Return the circle through three of the points that most of them follow (x, y, radius), and its scale."""
    circles = circles_through(points)
    scale = _FIRST_SCALE * float(np.nanmedian(circles[:, 2])) + _LEAST_SCALE_PX
    return circles[_kernels.most_followed(points, circles, scale)], scale


def _measure_ellipticity(crossing: FloatArray, radius: float) -> float:
    """Return 1 - minor/major axis of the rim, from the second harmonic of its radius."""
    known = np.isfinite(crossing) & (np.abs(crossing - radius) < 0.5 * radius)
    if np.count_nonzero(known) < _LEAST_POINTS:
        return 0.0
    wave = np.exp(2j * _ANGLES[known])
    amplitude = 2.0 * abs(
        complex(np.mean(crossing[known] / radius * wave) - np.mean(crossing[known] / radius) * np.mean(wave))
    )
    return min(2.0 * amplitude / (1.0 + amplitude), 1.0)
