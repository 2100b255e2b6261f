"""Rotations: vectors, matrices, and the three angles of the paper's Table 2."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from sunarc import _kernels
from sunarc.common.array_types import FloatArray
from sunarc.sky.directions import angles_from_direction


class PoseAngles(NamedTuple):
    """The camera's pose in degrees (Table 2).

    phi_xz_deg : azimuth of the camera's x axis, counter-clockwise from east, about the vertical.
    theta_zz_deg : tilt of the optical axis from the vertical.
    psi_z_deg : azimuth that the optical axis leans towards, clockwise from north.
    """

    phi_xz_deg: float
    theta_zz_deg: float
    psi_z_deg: float


def rotation_matrix(rotation_cam_enu: ArrayLike) -> FloatArray:
    """Return the (3, 3) matrix that takes east-north-up to the camera frame, from its rotation vector in radians."""
    vector = np.array(rotation_cam_enu, dtype=np.float64)
    if vector.ndim > 1:
        return _rotation_matrices(vector)
    # a fit needs one at a time, thousands of times
    return _kernels.rotation_and_jacobian(vector)[0]


def rotation_vector(matrix_cam_enu: ArrayLike) -> tuple[float, float, float]:
    """Return the rotation vector in radians of a (3, 3) rotation matrix."""
    x, y, z = rotation_vectors(np.asarray(matrix_cam_enu, dtype=np.float64)[None])[0]
    return float(x), float(y), float(z)


def _rotation_matrices(vectors: FloatArray) -> FloatArray:
    """Return the matrices (n, 3, 3) of rotation vectors (n, 3), by Rodrigues' formula."""
    angle = np.linalg.norm(vectors, axis=-1)[..., None, None]
    x, y, z = np.moveaxis(vectors, -1, 0)
    nil = np.zeros_like(x)
    cross = np.stack([np.stack(row, axis=-1) for row in ((nil, -z, y), (z, nil, -x), (-y, x, nil))], axis=-2)
    sine, half = np.sinc(angle / np.pi), np.sinc(angle / (2.0 * np.pi))
    return np.asarray(np.eye(3) + sine * cross + 0.5 * half**2 * (cross @ cross))


def rotation_vectors(matrices: FloatArray) -> FloatArray:
    """Return the rotation vectors (n, 3), of at most half a turn, of rotation matrices (n, 3, 3).

    They come from the unit quaternion by its largest component (Shepperd 1978), which keeps all digits at any angle.
    """
    m = np.asarray(matrices, dtype=np.float64)
    diagonal = np.diagonal(m, axis1=-2, axis2=-1)
    trace = np.sum(diagonal, axis=-1, keepdims=True)
    # 4 q q', the rows and columns being w, x, y, z
    products = np.empty((*m.shape[:-2], 4, 4))
    products[..., 0, 0] = 1.0 + trace[..., 0]
    for k, (i, j) in enumerate(((1, 2), (2, 0), (0, 1))):
        products[..., k + 1, k + 1] = 1.0 + 2.0 * diagonal[..., k] - trace[..., 0]
        products[..., 0, k + 1] = products[..., k + 1, 0] = m[..., j, i] - m[..., i, j]
        products[..., i + 1, j + 1] = products[..., j + 1, i + 1] = m[..., i, j] + m[..., j, i]
    largest = np.argmax(np.diagonal(products, axis1=-2, axis2=-1), axis=-1)
    quaternion = np.take_along_axis(products, largest[..., None, None], axis=-2)[..., 0, :]
    quaternion = quaternion / np.linalg.norm(quaternion, axis=-1, keepdims=True)
    quaternion *= np.where(quaternion[..., :1] < 0.0, -1.0, 1.0)
    axis = quaternion[..., 1:]
    sine = np.linalg.norm(axis, axis=-1, keepdims=True)
    angle = 2.0 * np.arctan2(sine, quaternion[..., :1])
    return np.asarray(axis * (2.0 / np.sinc(angle / (2.0 * np.pi))))


def rotation_between(first: ArrayLike, second: ArrayLike) -> float:
    """Return the angle in radians of the rotation from one pose to another, both as rotation vectors."""
    turn = rotation_matrix(first) @ rotation_matrix(second).T
    return float(np.linalg.norm(rotation_vector(turn)))


def smallest_rotation(first: FloatArray, second: FloatArray) -> FloatArray:
    """Return (..., 3): the smallest rotation vector, radians, that takes unit vectors (..., 3) to others."""
    axis = np.cross(first, second)
    sine, cosine = np.linalg.norm(axis, axis=-1), np.sum(first * second, axis=-1)
    return np.asarray(axis * (np.arctan2(sine, cosine) / np.maximum(sine, 1e-12))[..., None])


def pose_angles(rotation_cam_enu: ArrayLike) -> PoseAngles:
    """Return the Table 2 angles of a pose.

    The direction of the tilt is meaningless for a level camera and is then given as 0.
    """
    matrix = rotation_matrix(rotation_cam_enu)
    tilt, lean = (float(angle) for angle in angles_from_direction(matrix[2]))
    phi = math.degrees(math.atan2(matrix[0, 1], matrix[0, 0]))
    return PoseAngles(phi_xz_deg=phi, theta_zz_deg=tilt, psi_z_deg=lean if tilt > 0.0 else 0.0)


def rotation_from_pose_angles(angles: PoseAngles) -> tuple[float, float, float]:
    """Return the rotation vector of a pose given by its Table 2 angles (tilt below 90 degrees).

    The x axis is orthogonal to the optical axis and has the azimuth phi_xz in the horizontal plane.
    """
    tilt, lean, phi = (math.radians(a) for a in (angles.theta_zz_deg, angles.psi_z_deg, angles.phi_xz_deg))
    z_axis = np.array([math.sin(tilt) * math.sin(lean), math.sin(tilt) * math.cos(lean), math.cos(tilt)])
    heading = np.array([math.cos(phi), math.sin(phi)])
    x_axis = np.array([*heading, -float(heading @ z_axis[:2]) / z_axis[2]])
    x_axis /= np.linalg.norm(x_axis)
    return rotation_vector(np.stack([x_axis, np.cross(z_axis, x_axis), z_axis]))


def right_jacobian(rotation_cam_enu: ArrayLike) -> FloatArray:
    """Return the right Jacobian of the rotation group: exp(w + dw) = exp(w) exp(J dw) to first order.

    Reference: J. Solà et al., "A micro Lie theory", arXiv 1812.01537, Eq. 143.
    """
    return _kernels.rotation_and_jacobian(np.array(rotation_cam_enu, dtype=np.float64))[1]
