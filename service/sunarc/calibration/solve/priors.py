"""Prior of a lens before the sun is seen: Gaussian priors from tolerances, in whitened coordinates.

The lens's 17 parameters are β = mean + basis z, with z of independent unit variance but for the residual radial
distortion and the decentering, whose scales are found in the data. The residual radial distortion is a Gaussian process
over the angle off the axis, put onto the powers of Eq. 9 by least squares; what of it a change of focal length explains
is projected out, which is the paper's c1 as a gauge.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from enum import IntEnum
from functools import lru_cache

import numpy as np

from sunarc.calibration.model.options import ImageCircle, LensTolerances
from sunarc.common.array_types import FloatArray
from sunarc.optics.camera import (
    FOCAL_LENGTH,
    PARAMETER_NAMES,
    POSE,
    PRINCIPAL_POINT,
    RADIAL_ORDERS,
    TRANSLATION,
    Camera,
    Param,
)
from sunarc.optics.projections import Projection, ideal_radius

FREE = np.delete(np.array(Param), TRANSLATION)
"""Unknowns of the robust method of one camera: everything but the translation, the pose at `POSE` as among all."""
FREE_NAMES = tuple(PARAMETER_NAMES[i] for i in FREE)
LENS = np.delete(FREE, POSE)
"""Where the lens's parameters stand among all."""
N_LENS = LENS.size


class Whitened(IntEnum):
    """Place of each of the lens's whitened coordinates in z: as `LENS`, αx and αy as mean and difference."""

    FOCAL_LENGTH = 0
    ASPECT = 1
    SKEW = 2
    CENTER_X = 3
    CENTER_Y = 4
    RADIAL = 5
    P1 = 13
    P2 = 14
    P3 = 15
    P4 = 16


STRETCH = [Whitened.ASPECT, Whitened.SKEW]
"""Where z holds the effect of pixels that are not square."""
RADIAL = slice(Whitened.RADIAL, Whitened.P1)
"""Where z holds the residual radial distortion."""
DECENTERING = slice(Whitened.P1, Whitened.P3)
"""Where z holds p1 and p2."""
HIGHER = slice(Whitened.P3, Whitened.P4 + 1)
"""Where z holds p3 and p4."""
LENS_PARTS = {
    "focal length": np.array([Whitened.FOCAL_LENGTH]),
    "centre": np.array([Whitened.CENTER_X, Whitened.CENTER_Y]),
    "radial distortion": np.arange(RADIAL.start, RADIAL.stop),
    "decentering": np.arange(DECENTERING.start, HIGHER.stop),
}
"""Places of the coordinates whose spread between units has a scale of its own; skew and aspect have none."""

_GRID = 181
_GAUGE = 0.3
"""How much of the residual radial distortion (root mean square) may still be a change of focal length."""
_ROUGHNESS = 0.25
"""Share of the distortion that is not smooth at all, so that no shape is impossible."""
_RIDGE = 1e-10
"""Held against the square of each coefficient: powers that together are nearly zero but at the axis stay small. Of 36
published lens curves this makes the evidence greater by 32 in log likelihood, projecting the gauge out by as much more.
"""
_SMALLEST_SHARE = 1e-14
_RIGHT_ANGLE = math.pi / 2


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LensPrior:
    """β = mean + basis z of the lens; z has unit variances; its radial and its decentering part are in px.

    Attributes
    ----------
    mean : (17,)
    basis : (17, 17)
    """

    mean: FloatArray
    basis: FloatArray

    def lens(self, z: FloatArray) -> FloatArray:
        """Return the lens's parameters of whitened coordinates."""
        return np.asarray(self.mean + self.basis @ z)

    def whitened(self, camera: Camera) -> FloatArray:
        """Return the whitened coordinates of a camera's lens."""
        return np.asarray(np.linalg.lstsq(self.basis, camera.to_vector()[LENS] - self.mean)[0])


WIDE_ASPECT, WIDE_SKEW = 0.02, 0.003
"""1-sigma of the aspect ratio and of the skew, in focal lengths, of images whose pixels are not square: stretched by
who scaled them, or by a sensor's clock."""


def free_pixel_aspect(prior: LensPrior) -> LensPrior:
    """Return the prior of a lens behind pixels that need not be square."""
    basis, focal = prior.basis.copy(), float(np.mean(prior.mean[FOCAL_LENGTH]))
    basis[FOCAL_LENGTH, Whitened.ASPECT] = 0.5 * WIDE_ASPECT * focal, -0.5 * WIDE_ASPECT * focal
    basis[Whitened.SKEW, Whitened.SKEW] = WIDE_SKEW * focal
    return replace(prior, basis=basis)


def precisions(radial_px: float, decentering_px: float) -> FloatArray:
    """Return the prior precisions of z, (17,), for the two scales that the data choose."""
    result = np.ones(N_LENS)
    result[RADIAL] = 1.0 / radial_px**2
    result[DECENTERING] = 1.0 / decentering_px**2
    return result


def lens_prior(
    camera: Camera, *, tolerances: LensTolerances, circle: ImageCircle | None, field_angle: float
) -> LensPrior:
    """Return the prior of a lens.

    Parameters
    ----------
    camera : the camera that the fit starts from: its focal length is the scale of all.
    tolerances : how far the lens may be from the ideal.
    circle : the image circle, where there is one.
    field_angle : radians off the axis up to which the residual radial distortion is evaluated.
    """
    focal = 0.5 * (camera.focal_length_px[0] + camera.focal_length_px[1])
    edge = float(ideal_radius(camera.projection, min(field_angle, _RIGHT_ANGLE)))
    center, focal_sd = _center_and_focal(camera, focal, tolerances, circle)
    mean = np.zeros(N_LENS)
    mean[: Whitened.RADIAL] = focal, focal, 0.0, *center[:2]
    basis = np.zeros((N_LENS, N_LENS))
    basis[FOCAL_LENGTH, Whitened.FOCAL_LENGTH] = focal_sd
    basis[FOCAL_LENGTH, Whitened.ASPECT] = 0.5 * tolerances.aspect_px, -0.5 * tolerances.aspect_px
    basis[Whitened.SKEW, Whitened.SKEW] = tolerances.skew_px
    basis[PRINCIPAL_POINT, PRINCIPAL_POINT] = center[2] * np.eye(2)
    basis[RADIAL, RADIAL] = radial_basis(camera, length=math.radians(tolerances.radial_length_deg), upto=field_angle)
    basis[DECENTERING, DECENTERING] = np.eye(2) / (3.0 * focal * edge**2)
    basis[HIGHER, HIGHER] = tolerances.decentering_higher * np.eye(2)
    return LensPrior(mean=mean, basis=basis)


def _center_and_focal(
    camera: Camera, focal: float, tolerances: LensTolerances, circle: ImageCircle | None
) -> tuple[tuple[float, float, float], float]:
    """Return the prior's x0, y0 with their sigma, and the focal length's sigma, px."""
    if circle is None:
        center_sd = tolerances.center_fraction * min(camera.width, camera.height)
        center = ((camera.width - 1) / 2.0, (camera.height - 1) / 2.0, center_sd)
        return center, tolerances.focal_length_fraction * focal
    x = camera.width - 1.0 - circle.x if camera.mirrored else circle.x
    return (x, circle.y, tolerances.circle_center_px), tolerances.circle_focal_length_px


def radial_basis(camera: Camera, *, length: float, upto: float) -> FloatArray:
    """Return (8, 8): k2 … k9 per 1 px of residual radial distortion, its columns independent.

    Parameters
    ----------
    camera : gives the projection and the focal length.
    length : radians over which the distortion changes.
    upto : radians, the largest angle of the basis.
    """
    focal = 0.5 * (camera.focal_length_px[0] + camera.focal_length_px[1])
    to_coefficients, kernel, share = _radial_process(camera.projection, length, upto)
    to_coefficients, share = to_coefficients / focal, share / focal
    covariance = to_coefficients @ kernel @ to_coefficients.T + np.outer(share, share)
    # a kernel this smooth has fewer than eight ways to bend: the rest is kept tiny, not zero
    values, vectors = np.linalg.eigh(covariance)
    return np.asarray(vectors * np.sqrt(np.maximum(values, _SMALLEST_SHARE * values[-1])))


@lru_cache(maxsize=16)
def _radial_process(projection: Projection, length: float, upto: float) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the coefficients (8, 181) by the process at 181 angles, its covariance, and those (8,) of the gauge.

    They are of a focal length of 1 px.
    """
    theta = np.linspace(0.0, upto, _GRID)
    kernel = np.exp(-0.5 * ((theta[:, None] - theta) / length) ** 2) + _ROUGHNESS**2 * np.eye(_GRID)
    powers = (theta / _RIGHT_ANGLE)[:, None] ** np.array(RADIAL_ORDERS)
    ideal = ideal_radius(projection, theta)
    ideal = ideal / np.linalg.norm(ideal)
    # the process lives at 181 angles; least squares carries what of it is orthogonal to the ideal projection onto
    # those shapes of the eight powers of Eq. 9 that are, too
    shapes = np.linalg.svd((ideal @ powers)[None])[2][1:].T
    normal = shapes.T @ (powers.T @ powers + _RIDGE * np.eye(len(RADIAL_ORDERS))) @ shapes
    to_coefficients = shapes @ np.linalg.solve(normal, (powers @ shapes).T)
    kept = to_coefficients, kernel, np.linalg.lstsq(powers, ideal)[0] * math.sqrt(_GRID) * _GAUGE
    for array in kept:
        array.setflags(write=False)
    return kept
