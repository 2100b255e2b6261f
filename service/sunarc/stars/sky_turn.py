"""Lens, pole and handedness of a camera by the lights that turn between images of one night; no star is named here.

Between two images the sky turns by a known angle about the pole. A hypothesis (focal length, shape of the lens, pole,
handedness) maps the detections of one image into the other; the right one puts them on detections. The pole is looked
for where a camera near the zenith has it, over a grid as fine as the turn asks, then by least squares.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.spatial import cKDTree

from sunarc.common.array_types import BoolArray, FloatArray, IntArray
from sunarc.optics.forward import tangent_basis
from sunarc.optics.pose import rotation_matrix
from sunarc.optics.projections import PROJECTIONS, Projection, ideal_radius, shape_angle, shape_radius

# The search: how many detections of one image come onto those of another.

_CELLS = 128
_CHUNK = 64
"""Turns taken together: their arrays stay within the processor's cache."""


class Turns(NamedTuple):
    """Poles (k, 3), unit vectors in the camera's frame, and the angles of the turns about them (k,), radians."""

    poles: FloatArray
    angles: FloatArray


def _count_on_cells(
    rays: FloatArray, near: BoolArray, half: float, turns: Turns, *, shape: float, largest: float
) -> FloatArray:
    """Return (k,): the share of the mapped rays in the image that fall on marked cells; 0 where few are in it."""
    n = near.shape[0]
    # the largest angle at which the radius is computed: the tangent has a pole, the sine falls beyond its maximum
    widest = 1.5 / shape if shape > 0.0 else 0.5 * math.pi / -shape if shape < 0.0 else largest
    found = np.empty(turns.angles.size)
    for begin in range(0, found.size, _CHUNK):
        part = slice(begin, begin + _CHUNK)
        u, v, w = np.moveaxis(rotation_matrix(turns.angles[part, None] * turns.poles[part]) @ rays.T, 1, 0)
        across = np.hypot(u, v)
        theta = np.arctan2(across, w)
        inside = theta <= largest
        scale = shape_radius(shape, np.minimum(theta, widest)) / np.maximum(across, 1e-12) / half
        column, row = ((0.5 * n * (along * scale + 1.0)).astype(np.int64) for along in (u, v))
        within = inside & (column >= 0) & (column < n) & (row >= 0) & (row < n)
        hits = np.count_nonzero(near[row * within, column * within] & within, axis=1)
        found[part] = hits / np.maximum(np.count_nonzero(inside, axis=1), rays.shape[0] // 3)
    return found


def _mark_cells(onto: FloatArray, half: float, reach: float, n: int) -> tuple[BoolArray, float]:
    """Return (n, n) cells over -half to half, whether a detection is near, and the share of those in the disc."""
    centre = (np.arange(n) + 0.5) * 2.0 * half / n - half
    near = np.zeros((n, n), dtype=bool)
    for x, y in onto:
        columns, rows = (slice(*np.searchsorted(centre, (at - reach, at + reach))) for at in (x, y))
        near[rows, columns] |= np.hypot(centre[columns] - x, centre[rows, None] - y) <= reach
    disc = np.hypot(centre, centre[:, None]) <= half
    return near, float(np.count_nonzero(near & disc) / np.count_nonzero(disc))


def count_on_detections(
    rays: FloatArray,
    onto: FloatArray,
    turns: Turns,
    *,
    shape: float,
    reach: float,
    largest: float,
) -> FloatArray:
    """Return (k,): the share of rays that come near a detection when they turn about a pole, less chance's share.

    Parameters
    ----------
    rays : (n, 3) unit vectors in the camera's frame.
    onto : (m, 2) detections, focal lengths from the axis.
    turns : poles and angles.
    shape : of the lens (`lens_family`).
    reach : what is near, focal lengths.
    largest : angle off the axis to which rays count, radians.
    """
    half = float(np.quantile(np.max(np.abs(onto), axis=-1), 0.98)) + 2.0 * reach
    near, chance = _mark_cells(onto, half, reach, _CELLS)
    counts = _count_on_cells(rays, near, half, turns, shape=shape, largest=largest)
    return np.asarray((counts - chance) / max(1.0 - chance, 0.1))


# The sky's turning about the celestial pole.

SIDEREAL_RATE = 2.0 * math.pi / 86_164.0905
"""Radians a second."""
MAX_ANGLE = math.radians(95.0)
"""Off the axis, to which stars are looked for."""


def turned(rays: FloatArray, pole: FloatArray, angle: float) -> FloatArray:
    """Return rays (n, 3) turned about a pole (3,) by an angle in radians."""
    return np.asarray(rays @ rotation_matrix(angle * pole).T)


# One family of lenses with a number for its shape: all five ideal projections, and what lies between them.

_POWERS = (2, 3, 4, 5)


def radius_to_angle(radius: FloatArray, shape: float) -> FloatArray:
    """Return angles off the axis (rad) of radii in focal lengths; of those beyond the lens's end its largest."""
    angle = shape_angle(shape, radius)
    return np.where(shape * radius < -1.0, 0.5 * math.pi / -shape, angle) if shape < 0.0 else angle


def angle_to_radius(angle: FloatArray, shape: float) -> FloatArray:
    """Return radii in focal lengths of angles off the axis (rad)."""
    rising = (0.49 if shape > 0.0 else 0.5) * math.pi
    return shape_radius(shape, np.minimum(angle, rising / abs(shape)) if shape else angle)


def nearest_projection(shape: float) -> Projection:
    """Return the ideal projection that is nearest to a shape."""
    return min(PROJECTIONS, key=lambda name: abs(PROJECTIONS[name].shape - shape))


def radial_for(shape: float, projection: Projection) -> tuple[float, ...]:
    """Return k2 … k9 of a camera of an ideal projection that has this shape, by least squares to 90 degrees."""
    angle = np.linspace(0.05, min(MAX_ANGLE, 0.5 * math.pi), 60)
    design = np.stack([(angle / (0.5 * math.pi)) ** power for power in _POWERS], axis=-1)
    difference = angle_to_radius(angle, shape) - ideal_radius(projection, angle)
    found = np.linalg.lstsq(design, difference, rcond=None)[0]
    return (*(float(value) for value in found), *(0.0,) * (8 - len(_POWERS)))


_REACH = 0.02
"""Tolerance of the search, focal lengths: 1.1 degrees."""
_SHAPES_TRIED = (-0.5, 0.0, 0.5)
_FOCAL_STEP = 1.06
_MAPPED, _MAPPED_ONTO = 60, 160
"""Brightest detections of an image that are mapped, and those onto which: some are behind cloud or set in the other."""
_LEAST_TURN, _MOST_TURN = math.radians(3.0), math.radians(45.0)
_PAIRS = 3
_KEPT = 4
"""Hypotheses of each handedness that are refined."""
_DISTINCT = math.radians(6.0)
_REFINED_BY, _FEWEST, _ROUNDS, _EVALUATIONS = 120, 10, 6, 6
_CLOSE_PX = 3.0
_LIKELY, _CONFORMAL = 0.3, 0.25
_OTHER_FOCAL, _FOCAL_FIXED = (0.8, 0.86, 0.93, 1.07, 1.15), 0.005
_PRIOR_PX = 4.0
"""Weight of a 1-sigma departure from the hypothesis: a stereographic lens turns alike about many centres."""


class Pair(NamedTuple):
    """Two images: pixels (n, 2) of the first, (m, 2) of the second, and the turn between them, radians."""

    first: FloatArray
    second: FloatArray
    turn: float


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Turning:
    """A lens and the pole in its frame (x right, y down, z out of the lens, after the mirror).

    Attributes
    ----------
    mirrored : the handedness.
    focal_px, shape : of the lens (`lens_family`).
    centre : (2,) px.
    pole : (3,) of the north celestial pole.
    width : of the image, px.
    share : of the mapped detections that come onto others, less what chance would bring.
    """

    mirrored: bool
    focal_px: float
    shape: float
    centre: FloatArray
    pole: FloatArray
    width: int
    share: float


@dataclass(frozen=True, slots=True, kw_only=True)
class SearchRange:
    """Range of lenses and poles that is searched.

    centre: px; radius_px: least and greatest of 90 degrees off the axis; polar_rad: least and greatest angle of the
    pole off the axis; width: of the image, px.
    """

    centre: tuple[float, float]
    radius_px: tuple[float, float]
    polar_rad: tuple[float, float]
    width: int


def image_pairs(unix_s: Sequence[float], pixels: Sequence[FloatArray]) -> list[Pair]:
    """Return pairs of images between which the sky turned by 3 to 45 degrees, those nearest to 15 first."""
    found = []
    for first in range(len(unix_s)):
        for second in range(len(unix_s)):
            turn = SIDEREAL_RATE * (unix_s[second] - unix_s[first])
            if _LEAST_TURN <= turn <= _MOST_TURN and min(len(pixels[first]), len(pixels[second])) >= 15:
                found.append((abs(math.log(turn / math.radians(15.0))), first, second, turn))
    found.sort()
    used: dict[int, int] = {}
    chosen: list[Pair] = []
    for _, first, second, turn in found:
        # each image in two pairs at most: a cloudy one spoils no more
        if len(chosen) < _PAIRS and used.get(first, 0) < 2 and used.get(second, 0) < 2:
            used[first], used[second] = used.get(first, 0) + 1, used.get(second, 0) + 1
            chosen.append(Pair(pixels[first], pixels[second], turn))
    return chosen


def turnings(pairs: Sequence[Pair], field: SearchRange) -> list[Turning]:
    """Return the refined hypotheses of both handednesses, the best first."""
    found = [one for mirrored in (False, True) for one in _find_turnings(pairs, field, mirrored=mirrored)]
    return sorted(found, key=lambda one: -one.share)


def _find_turnings(pairs: Sequence[Pair], field: SearchRange, *, mirrored: bool) -> list[Turning]:
    flipped = [
        one._replace(
            first=unmirrored(one.first, field.width, mirrored=mirrored),
            second=unmirrored(one.second, field.width, mirrored=mirrored),
        )
        for one in pairs
    ]
    centre = np.array([field.width - 1.0 - field.centre[0] if mirrored else field.centre[0], field.centre[1]])
    poles = _make_poles(
        field, step=min(0.5 * _REACH / math.sin(0.5 * min(one.turn for one in pairs)), math.radians(5.0))
    )
    radius = field.radius_px
    grid = [(focal, shape) for shape in _SHAPES_TRIED for focal in focal_lengths(radius, shape, step=_FOCAL_STEP)]
    share = np.stack([_measure_shares(flipped, centre, focal, shape, poles) for focal, shape in grid])
    kept: list[tuple[FloatArray, float, float]] = []
    for place in np.argsort(-share, axis=None, kind="stable")[:400].tolist():
        row, column = divmod(place, poles.shape[0])
        pole, (focal, shape) = poles[column], grid[row]
        if all(np.arccos(np.clip(pole @ other, -1.0, 1.0)) > _DISTINCT for other, _, _ in kept):
            kept.append((pole, focal, shape))
        if len(kept) == _KEPT:
            break
    image = (mirrored, field.width)
    found = [_refine_turning(flipped, centre, pole, (focal, shape), image) for pole, focal, shape in kept]
    best = max(found, key=lambda one: one.share)
    if best.share > _LIKELY and best.shape > _CONFORMAL:
        # these turn alike with many focal lengths, each with a centre and a pole of its own: the stars decide
        for ratio in _OTHER_FOCAL:
            rough = (ratio * best.focal_px, best.shape)
            found.append(_refine_turning(flipped, best.centre, best.pole, rough, image, focal_within=_FOCAL_FIXED))
    return found


def unmirrored(pixels: FloatArray, width: int, *, mirrored: bool) -> FloatArray:
    """Return pixels (n, 2) of an image as a camera that is not mirrored has them."""
    return np.stack([width - 1.0 - pixels[:, 0], pixels[:, 1]], axis=-1) if mirrored else pixels


def focal_lengths(radius_px: tuple[float, float], shape: float, *, step: float) -> list[float]:
    """Return focal lengths, px, a factor apart, from the least to the greatest radius of 90 degrees off the axis."""
    least, greatest = (radius / float(angle_to_radius(np.array(0.5 * math.pi), shape)) for radius in radius_px)
    count = max(math.ceil(math.log(greatest / least) / math.log(step)), 1) + 1
    values: list[float] = np.geomspace(least, greatest, count).tolist()
    return values


def _make_poles(field: SearchRange, *, step: float) -> FloatArray:
    """Return directions (k, 3) in the camera's frame on rings about the axis, a step apart."""
    least, greatest = max(field.polar_rad[0], 0.0), min(field.polar_rad[1], math.pi)
    rings = []
    for polar in np.linspace(least, greatest, max(math.ceil((greatest - least) / step), 1) + 1).tolist():
        count = max(math.ceil(2.0 * math.pi * math.sin(polar) / step), 1)
        around = 2.0 * math.pi * np.arange(count) / count
        ring = [math.sin(polar) * np.cos(around), math.sin(polar) * np.sin(around), np.full(count, math.cos(polar))]
        rings.append(np.stack(ring, axis=-1))
    return np.concatenate(rings)


def _measure_shares(
    pairs: Sequence[Pair], centre: FloatArray, focal: float, shape: float, poles: FloatArray
) -> FloatArray:
    """Return (k,): the share of mapped detections on others less that of chance, the mean of the pairs."""
    total = np.zeros(poles.shape[0])
    for one in pairs:
        rays = _back_project(one.first[:_MAPPED], centre, focal, shape)
        onto = (one.second[:_MAPPED_ONTO] - centre) / focal
        angles = np.full(poles.shape[0], -one.turn)
        total += count_on_detections(rays, onto, Turns(poles, angles), shape=shape, reach=_REACH, largest=MAX_ANGLE)
    return total / len(pairs)


def _back_project(pixels: FloatArray, centre: FloatArray, focal: float, shape: float) -> FloatArray:
    """Return unit vectors (n, 3) in the camera's frame."""
    away = (pixels - centre) / focal
    radius = np.hypot(*away.T)
    angle = np.minimum(radius_to_angle(radius, shape), math.pi)
    scale = np.sin(angle) / np.maximum(radius, 1e-12)
    return np.stack([away[:, 0] * scale, away[:, 1] * scale, np.cos(angle)], axis=-1)


def _project_rays(rays: FloatArray, centre: FloatArray, focal: float, shape: float) -> FloatArray:
    across = np.hypot(rays[:, 0], rays[:, 1])
    radius = angle_to_radius(np.arctan2(across, rays[:, 2]), shape)
    return np.asarray(centre + focal * rays[:, :2] * (radius / np.maximum(across, 1e-12))[:, None])


def _refine_turning(
    pairs: Sequence[Pair],
    centre: FloatArray,
    pole: FloatArray,
    rough: tuple[float, float],
    image: tuple[bool, int],
    *,
    focal_within: float = 0.1,
) -> Turning:
    """Return a hypothesis by least squares of the distances from the nearest detections, ever closer ones."""
    from scipy.optimize import least_squares  # noqa: PLC0415 - the command line loads without it

    some = [Pair(one.first[:_REFINED_BY], one.second, one.turn) for one in pairs]
    start = np.array([math.log(rough[0]), *centre, 0.0, 0.0, rough[1]])
    spread = np.array([focal_within, 0.05 * rough[0], 0.05 * rough[0], 0.1, 0.1, 0.4])
    unknowns, reach = start, 1.5 * _REACH * rough[0]
    trees = [cKDTree(one.second) for one in some]
    for _ in range(_ROUNDS):
        found = _find_nearest(trees, _map_detections(some, pole, unknowns))
        near = [apart < reach for apart, _ in found]
        if sum(int(mask.sum()) for mask in near) < _FEWEST:
            break
        goal = [one.second[row[mask]] for one, (_, row), mask in zip(some, found, near, strict=True)]
        part = [Pair(one.first[mask], aim, one.turn) for one, mask, aim in zip(some, near, goal, strict=True)]

        def residual(at: FloatArray, part: list[Pair] = part) -> FloatArray:
            apart = [there - one.second for one, there in zip(part, _map_detections(part, pole, at), strict=True)]
            return np.asarray(np.r_[np.concatenate(apart).ravel(), _PRIOR_PX * (at - start) / spread])

        unknowns = least_squares(
            residual,
            unknowns,
            loss="soft_l1",
            f_scale=max(0.2 * reach, 0.5),
            x_scale=spread,
            max_nfev=_EVALUATIONS,
        ).x
        reach = max(0.5 * reach, _CLOSE_PX)
    lens, now = _split_lens(unknowns), _move_pole(pole, unknowns)
    close = np.concatenate(
        [tree.query(there)[0] for tree, there in zip(trees, _map_detections(some, pole, unknowns), strict=True)]
    )
    # within the search's reach, and as near as the right lens brings stars
    share = 0.5 * float(_measure_shares(pairs, *lens, now[None])[0]) + 0.5 * float(np.mean(close < _CLOSE_PX))
    return Turning(
        mirrored=image[0], focal_px=lens[1], shape=lens[2], centre=lens[0], pole=now, width=image[1], share=share
    )


def _find_nearest(trees: Sequence[cKDTree], there: Sequence[FloatArray]) -> list[tuple[FloatArray, IntArray]]:
    """Return distances (px) to the nearest detections, and their rows, of places in each second image."""
    found = [tree.query(places) for tree, places in zip(trees, there, strict=True)]
    return [(np.asarray(apart), np.asarray(row, dtype=np.int64)) for apart, row in found]


def _map_detections(pairs: Sequence[Pair], pole: FloatArray, unknowns: FloatArray) -> list[FloatArray]:
    """Return where the detections of the first images are in the second, (n, 2) px each."""
    lens, now = _split_lens(unknowns), _move_pole(pole, unknowns)
    return [_project_rays(turned(_back_project(one.first, *lens), now, -one.turn), *lens) for one in pairs]


def _split_lens(unknowns: FloatArray) -> tuple[FloatArray, float, float]:
    """Return centre, focal length and shape."""
    return unknowns[1:3], math.exp(unknowns[0]), float(unknowns[5])


def _move_pole(pole: FloatArray, unknowns: FloatArray) -> FloatArray:
    moved = pole + tangent_basis(pole) @ unknowns[3:5]
    return np.asarray(moved / np.linalg.norm(moved))
