"""Lens, pose and handedness of a camera by the pattern of the bright stars of one image at a known time and place.

A hypothesis is a lens (focal length, shape), where the zenith is in the camera's frame, and a handedness. Each pair of
a bright star and a detection that are as far off the axis votes for the angle about the axis that brings one onto the
other; the right hypothesis has many votes for one angle, a wrong one as many for all. How probable it is that chance
brings as many stars onto detections is judged afterwards, by a camera that has been refined (`chance_of`).
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.spatial import cKDTree

from sunarc import _kernels
from sunarc.common.array_types import FloatArray, IntArray
from sunarc.optics.camera import Camera
from sunarc.optics.forward import project_fast
from sunarc.optics.pose import rotation_matrix, rotation_vector
from sunarc.stars.sky_turn import (
    MAX_ANGLE,
    focal_lengths,
    nearest_projection,
    radial_for,
    radius_to_angle,
)

_STARS, _LOWEST = 80, math.sin(math.radians(12.0))
"""Bright stars that are looked for, and the sine of the height from which on."""
_DETECTIONS = 160
"""Bright detections on the sky among which."""
_REACH = math.radians(2.2)
"""How far off its place a star may be for a hypothesis of the grid."""
_TILT_STEP = math.radians(2.8)
_FOCAL_STEP = 1.055
_SHAPES = (-0.5, 0.0, 0.5)
_BINS = 180
"""Of the angle about the axis; three neighbours are taken together, 6 degrees."""
_NEAR_AXIS = math.radians(8.0)
"""Stars nearer to the axis say little of the angle about it."""
_KEPT_A_LENS, _DISTINCT = 6, math.cos(math.radians(5.0))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Bright:
    """Bright detections and stars: the input of the pattern search.

    Attributes
    ----------
    stars : (n, 3) directions of the bright stars, east-north-up, the brightest first.
    away : (m, 2) px from where the axis is looked for to the bright detections, likewise; x right, y down.
    """

    stars: FloatArray
    away: FloatArray


class Pattern(NamedTuple):
    """A hypothesis: votes beyond chance (a logarithm), the lens, and the turn (3, 3) into the camera's frame."""

    score: float
    mirrored: bool
    focal_px: float
    shape: float
    rotation: FloatArray


class _TiltedStars(NamedTuple):
    """The stars for each trial tilt of the camera's axis, in the order of their angles off the axis.

    tilts: (k, 3, 3). off_axis: radians. key: of the bin of a vote for detections in bin 0.
    """

    tilts: FloatArray
    off_axis: FloatArray
    key: IntArray


def bright_stars(directions: FloatArray, magnitude: FloatArray) -> FloatArray:
    """Return the directions (n, 3) of the stars that are looked for, of stars (k, 3) and magnitudes (k,) behind air."""
    high = np.flatnonzero(directions[:, 2] > _LOWEST)
    return np.asarray(directions[high[np.argsort(magnitude[high], kind="stable")[:_STARS]]])


def patterns(bright: Bright, *, radius_px: tuple[float, float], max_tilt: float, most: int) -> list[Pattern]:
    """Return the hypotheses of either handedness with most votes, distinct ones, the best first.

    Parameters
    ----------
    bright : stars and detections.
    radius_px : least and greatest of 90 degrees off the axis.
    max_tilt : of the axis from the zenith, radians.
    most : hypotheses that are returned.
    """
    if min(bright.stars.shape[0], bright.away.shape[0]) < 3:
        return []
    turned = _turn_stars(bright.stars, _make_tilts(max_tilt))
    lenses = [(focal, shape) for shape in _SHAPES for focal in focal_lengths(radius_px, shape, step=_FOCAL_STEP)]
    found = [one for focal, shape in lenses for one in _search_lens(bright.away, turned, focal, shape)]
    found.sort(key=lambda one: -one.score)
    kept: list[Pattern] = []
    for one in found:
        if all(
            one.mirrored != other.mirrored or 0.5 * (float(np.sum(one.rotation * other.rotation)) - 1.0) < _DISTINCT
            for other in kept
        ):
            kept.append(one)
        if len(kept) == most:
            break
    return kept


def _make_tilts(greatest: float) -> FloatArray:
    """Return turns (k, 3, 3) that take the zenith to places about the axis, a step apart."""
    rings = [np.zeros((1, 3))]
    for tilt in np.arange(_TILT_STEP, greatest + 0.5 * _TILT_STEP, _TILT_STEP).tolist():
        count = max(math.ceil(2.0 * math.pi * math.sin(tilt) / _TILT_STEP), 6)
        about = 2.0 * math.pi * np.arange(count) / count
        rings.append(tilt * np.stack([np.cos(about), np.sin(about), np.zeros(count)], axis=-1))
    return np.asarray(rotation_matrix(np.concatenate(rings)))


def _turn_stars(stars: FloatArray, tilts: FloatArray) -> _TiltedStars:
    x, y, z = np.moveaxis(stars @ np.swapaxes(tilts, -1, -2), -1, 0).reshape(3, -1)
    off_axis = np.arctan2(np.hypot(x, y), z)
    order = np.argsort(off_axis, kind="stable")
    order = order[off_axis[order] > _NEAR_AXIS]
    key = order // stars.shape[0] * 2 * _BINS + _BINS - _bin_index(np.arctan2(y[order], x[order]))
    return _TiltedStars(tilts, off_axis[order], key)


def _bin_index(angle: FloatArray) -> IntArray:
    return np.floor(angle * (_BINS / (2.0 * math.pi))).astype(np.int64) % _BINS


def _search_lens(away: FloatArray, turned: _TiltedStars, focal: float, shape: float) -> Iterator[Pattern]:
    """Yield the best hypotheses of one lens, of either handedness."""
    angle = radius_to_angle(np.hypot(*away.T) / focal, shape)
    used = np.flatnonzero(angle < MAX_ANGLE)[:_DETECTIONS]
    first, last = (np.searchsorted(turned.off_axis, angle[used] + side) for side in (-_REACH, _REACH))
    for mirrored, x in ((False, away[used, 0]), (True, -away[used, 0])):
        place = _bin_index(np.arctan2(away[used, 1], x))
        window = _kernels.votes_of_pairs(turned.key, first, last, place, turned.tilts.shape[0], _BINS)
        mean = np.maximum(window.mean(axis=-1), 1.0)
        tilts = np.argsort(-_improbability(window.max(axis=-1), mean), kind="stable")[:_KEPT_A_LENS]
        score = _improbability(window[tilts], mean[tilts, None])
        for row in np.argpartition(-score, _KEPT_A_LENS, axis=None)[:_KEPT_A_LENS].tolist():
            tilt, middle = divmod(row, _BINS)
            about = rotation_matrix(np.array([0.0, 0.0, middle * 2.0 * math.pi / _BINS]))
            yield Pattern(float(score[tilt, middle]), mirrored, focal, shape, about @ turned.tilts[tilts[tilt]])


def _improbability(votes: IntArray, usual: FloatArray) -> FloatArray:
    """Return the logarithm of how improbable so many votes are where so many are usual; it rises with the votes."""
    score = votes * np.log(np.maximum(votes, 1.0) / usual) - (votes - usual)
    return np.where(votes > usual, score, 0.0)


def pattern_camera(pattern: Pattern, centre: tuple[float, float], image_size: tuple[int, int]) -> Camera:
    """Return a hypothesis as a camera whose axis is at a place of the image as a camera that is not mirrored has it."""
    projection = nearest_projection(pattern.shape)
    return Camera(
        width=image_size[0],
        height=image_size[1],
        projection=projection,
        focal_length_px=(pattern.focal_px, pattern.focal_px),
        principal_point_px=centre,
        rotation_cam_enu=rotation_vector(pattern.rotation),
        radial=radial_for(pattern.shape, projection),
        mirrored=pattern.mirrored,
        max_angle=math.radians(100.0),
    )


# How probable it is that a camera which was fitted to an image's detections matches so many stars by chance.

_OF_FOCAL = (0.02, 0.008, 0.004)
"""Distance of near lights, focal lengths."""
_FAINTEST = (3.0, 4.0)
_FITTED_BY = 5
"""Stars that determine the ten unknowns of a refined camera."""
_TURNS = np.radians(np.arange(25.0, 340.0, 25.0))
_FEWEST = 12


def log10_chance(camera: Camera, stars: FloatArray, magnitude: FloatArray, detections: FloatArray) -> float:
    """Return the logarithm of how many cameras would match an image as well by chance, of all that could be fitted.

    A camera is determined by five stars; so many cameras there are as ways to take five stars for five detections. Of
    the other stars each is met by chance with a probability that is measured: as many as meet a detection when the
    predicted places are turned about the axis. The number of cameras times the binomial probability of as many or more
    matches is what is expected by chance (L. Moisan, B. Stival, IJCV 57, 2004). The best of six limits of magnitude and
    radii counts, the choice being paid for.

    Parameters
    ----------
    camera : fitted to the detections.
    stars, magnitude : (n, 3) directions within the image, and (n,).
    detections : (m, 2) px, the brightest first.
    """
    places, best = project_fast(camera, stars), 0.0
    axis = project_fast(camera, rotation_matrix(camera.rotation_cam_enu)[2:])[0]
    for faintest in _FAINTEST:
        some = places[(magnitude <= faintest) & np.isfinite(places[:, 0])]
        if some.shape[0] < _FEWEST or detections.shape[0] < _FEWEST:
            continue
        near = cKDTree(detections[: 2 * some.shape[0] + 20])
        turned = _turned_places(some, axis)
        apart = np.asarray(near.query(turned)[0])
        tests = _log10_ways(some.shape[0], _FITTED_BY) + _FITTED_BY * math.log10(near.n) + math.log10(_CHOICES)
        for of_focal in _OF_FOCAL:
            radius = of_focal * camera.focal_length_px[0]
            met = _count_matched(near, some, radius)
            share = (np.count_nonzero(apart < radius) + 1.0) / (apart.size + 1.0)
            if met > _FITTED_BY:
                best = min(best, tests + _log10_tail(met - _FITTED_BY, some.shape[0] - _FITTED_BY, share))
    return best


_CHOICES = 2 * len(_OF_FOCAL) * len(_FAINTEST)
"""Handednesses, radii and limits of magnitude."""


def _log10_ways(count: int, taken: int) -> float:
    """Return the logarithm of how many ways there are to take some of so many."""
    ways = math.lgamma(count + 1) - math.lgamma(taken + 1) - math.lgamma(count - taken + 1)
    return ways / math.log(10.0)


def _log10_tail(least: int, count: int, share: float) -> float:
    """Return the logarithm of the binomial probability of so many or more."""
    odds = math.log10(share), math.log10(max(1.0 - share, 1e-12))
    terms = [_log10_ways(count, k) + k * odds[0] + (count - k) * odds[1] for k in range(least, count + 1)]
    return max(terms) + math.log10(sum(10.0 ** (term - max(terms)) for term in terms))


def _count_matched(detections: cKDTree, places: FloatArray, radius: float) -> int:
    """Return how many detections are nearest to a star within the radius; each counts once."""
    apart, row = detections.query(places)
    return int(np.unique(np.asarray(row)[np.asarray(apart) < radius]).size)


def _turned_places(places: FloatArray, axis: FloatArray) -> FloatArray:
    """Return places (n, 2) turned about the axis by many angles, (angles * n, 2)."""
    cosine, sine = np.cos(_TURNS), np.sin(_TURNS)
    matrices = np.stack([cosine, -sine, sine, cosine], axis=-1).reshape(-1, 2, 2)
    return np.asarray((axis + (places - axis) @ np.swapaxes(matrices, -1, -2)).reshape(-1, 2))
