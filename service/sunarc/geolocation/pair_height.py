"""Height of a cloud that two cameras see: where their view directions come nearest to one another.

Rays are straight, as for `clouds`. The error is that of the two calibrations, carried to the height by derivatives.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sunarc.common.array_types import FloatArray
from sunarc.common.errors import InputError
from sunarc.geolocation.locate import GeodeticPosition, geodetic_position, relative_frame
from sunarc.sky.site import Site

_STEP = 1e-6
"""Of the finite differences, radians: 1 cm at 10 km."""
_LEAST_ANGLE_RAD = 1e-3
_LEAST_SIGMAS = 4.0
"""Rays that enclose less are parallel; an angle known to a quarter bounds the height to about as much."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PairView:
    """View of the point by one camera.

    Attributes
    ----------
    site : where it stands.
    direction : (3,) unit vector in its own east-north-up.
    covariance : (3, 3) of the unit vector.
    """

    site: Site
    direction: FloatArray
    covariance: FloatArray


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PairHeight:
    """Height of a point that two cameras see.

    Attributes
    ----------
    height_m, sigma_m : above the first camera's altitude, along the curved Earth, and its 1-sigma.
    position_m : (3,) metres east, north and up of the first camera.
    geodetic : latitude, longitude and altitude, (1,) each.
    miss_m, miss_sigma_m : how far the rays pass one another, signed, and the 1-sigma of that: a miss of many sigmas is
        of two different points, of clocks that differ, or of a camera that turned.
    angle_deg : between the rays.
    """

    height_m: float
    sigma_m: float
    position_m: FloatArray
    geodetic: GeodeticPosition
    miss_m: float
    miss_sigma_m: float
    angle_deg: float


def pair_height(first: PairView, second: PairView) -> PairHeight:
    """Return the height of the point that two cameras see at the same time.

    The point on each ray that is nearest to the other ray is taken, and the mean of the two by the inverse squares of
    their distances from their cameras.

    Raises
    ------
    InputError
        Where a direction is not above the horizon, where the rays are parallel within their errors, and where they
        come nearest behind a camera.
    """
    base, axes = relative_frame(first.site, second.site)
    for name, view in (("pixel_a", first), ("pixel_b", second)):
        if not np.isfinite(view.direction).all() or view.direction[2] <= 0.0:
            raise InputError(field=name, problem="is not above the horizon", remedy="give a pixel of the sky")
    a, b = first.direction, axes @ second.direction
    tangents = [_make_tangents(a), _make_tangents(b)]
    spreads = [first.covariance, axes @ second.covariance @ axes.T]
    _require_angle(a, b, spreads)
    point, lengths, miss = _nearest_point_of_rays(a, b, base)
    if min(lengths) <= 0.0:
        raise InputError(
            field="pixel_b",
            problem="the rays move apart: they come nearest behind a camera",
            remedy="give pixels of one point of a cloud, of one time",
        )
    height_m = _height_above_site(point, first.site)
    variances = np.zeros(2)
    for number, (tangent, spread) in enumerate(zip(tangents, spreads, strict=True)):
        slopes = np.array([_height_derivatives((a, b), base, first.site, number, one) for one in tangent])
        variances += np.einsum("ik,ij,jk->k", slopes, tangent @ spread @ tangent.T, slopes)
    sigma_m, miss_sigma_m = np.sqrt(variances).tolist()
    return PairHeight(
        height_m=height_m,
        sigma_m=sigma_m,
        position_m=point,
        geodetic=geodetic_position(point[None], first.site),
        miss_m=miss,
        miss_sigma_m=miss_sigma_m,
        angle_deg=float(np.degrees(_angle_between(a, b))),
    )


def _angle_between(a: FloatArray, b: FloatArray) -> float:
    return float(np.arctan2(np.linalg.norm(np.cross(a, b)), a @ b))


def _require_angle(a: FloatArray, b: FloatArray, spreads: list[FloatArray]) -> None:
    angle = _angle_between(a, b)
    # the angle changes by what moves one direction towards the other
    toward = a - b
    toward = toward / max(float(np.linalg.norm(toward)), 1e-12)
    sigma = float(np.sqrt(sum(toward @ spread @ toward for spread in spreads)))
    if min(angle, np.pi - angle) < max(_LEAST_ANGLE_RAD, _LEAST_SIGMAS * sigma):
        raise InputError(
            field="pixel_b",
            problem=f"the rays are parallel: {np.degrees(angle):.3f} degrees apart, known to {np.degrees(sigma):.3f}",
            remedy="ask cameras that stand further apart, or of a cloud that does not lie in line with both",
        )


def _nearest_point_of_rays(
    a: FloatArray, b: FloatArray, base: FloatArray
) -> tuple[FloatArray, tuple[float, float], float]:
    """Return the point (3,) nearest to two rays, the lengths along both, and their distance there."""
    normal = np.cross(a, b)
    square = float(normal @ normal)
    along_a = float(np.cross(base, b) @ normal) / square
    along_b = float(np.cross(base, a) @ normal) / square
    weight = along_b**2 / (along_a**2 + along_b**2)  # the nearer camera's ray is off by less
    point = weight * along_a * a + (1.0 - weight) * (base + along_b * b)
    return point, (along_a, along_b), float(base @ normal) / square**0.5


def _height_above_site(point: FloatArray, site: Site) -> float:
    return float(geodetic_position(point[None], site).altitude[0]) - site.altitude


def _height_derivatives(
    pair: tuple[FloatArray, FloatArray], base: FloatArray, site: Site, moved: int, tangent: FloatArray
) -> tuple[float, float]:
    """Return by how much height and miss change with one direction along a tangent, metres per radian."""
    ends = []
    for sign in (1.0, -1.0):
        rays = list(pair)
        shifted = rays[moved] + sign * _STEP * tangent
        rays[moved] = shifted / np.linalg.norm(shifted)
        point, _, miss = _nearest_point_of_rays(rays[0], rays[1], base)
        ends.append((_height_above_site(point, site), miss))
    return (ends[0][0] - ends[1][0]) / (2.0 * _STEP), (ends[0][1] - ends[1][1]) / (2.0 * _STEP)


def _make_tangents(direction: FloatArray) -> FloatArray:
    """Return two unit vectors (2, 3) across a direction."""
    one = np.cross(direction, np.eye(3)[int(np.argmin(np.abs(direction)))])
    one = one / np.linalg.norm(one)
    return np.stack([one, np.cross(direction, one)])
