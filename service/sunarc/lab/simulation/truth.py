"""True cameras: the paper's own, and others drawn from distributions of lenses and mounts."""

from __future__ import annotations

import math

import numpy as np

from sunarc.common.array_types import FloatArray
from sunarc.optics.camera import Camera
from sunarc.optics.pose import PoseAngles, rotation_from_pose_angles
from sunarc.sky.site import Site

SGP = Site(latitude=36.604043, longitude=-97.484856, altitude=318.0)
"""The Southern Great Plains site of the paper's imager USI 1.8."""

IMAGE_SIZE = (1748, 1748)
_FOCAL_LENGTH_PX = 601.32
_RIGHT_ANGLE = math.pi / 2
_ORDERS = np.arange(2, 10)
_HORIZON_RADIUS_SQUARE = 2.0  # (2 sin 45°)², in focal lengths


def true_camera(lens_seed: int = 0) -> Camera:
    """Return a camera to be found again.

    Parameters
    ----------
    lens_seed : 0 is the paper's case 3 (Table 2) with a radial residual of ±1.7 px and a decentering of 0.9 px at the
        horizon; any other number draws a camera: smooth radial residual (1.5 px), decentering (0.6 px at the
        horizon), skew (0.006 px), centre and focal length off by a few px, any azimuth, up to 5° of tilt.

    Returns
    -------
    Equisolid, 1748×1748 px. The radial residual is orthogonal to the ideal projection over the sky (the paper's c1),
    so that the focal length keeps its meaning.
    """
    return _make_paper_camera() if lens_seed == 0 else _draw_camera(np.random.default_rng(lens_seed))


def _make_paper_camera() -> Camera:
    theta = np.linspace(0.0, _RIGHT_ANGLE, 401)
    x = theta / _RIGHT_ANGLE
    residual = _remove_projection_part(x**2 * (1.0 - x) * (0.75 - x), theta)
    first, second = _decentering_coefficients(0.9, math.radians(35.0))
    return Camera(
        width=IMAGE_SIZE[0],
        height=IMAGE_SIZE[1],
        projection="equisolid",
        focal_length_px=(_FOCAL_LENGTH_PX, _FOCAL_LENGTH_PX),
        skew_px=2.57e-3,
        principal_point_px=(871.96, 883.00),
        rotation_cam_enu=rotation_from_pose_angles(
            PoseAngles(phi_xz_deg=47.91, theta_zz_deg=2.46, psi_z_deg=140.16),
        ),
        radial=_fit_radial_coefficients(residual * (1.7 / _FOCAL_LENGTH_PX / np.max(np.abs(residual))), theta),
        decentering=(first, second, 0.0, 0.0),
    )


def _draw_camera(rng: np.random.Generator) -> Camera:
    focal_length = _FOCAL_LENGTH_PX + rng.normal(0.0, 3.0)
    theta = np.linspace(0.0, _RIGHT_ANGLE, 401)
    residual = _remove_projection_part(_draw_smooth_function(rng, theta) * (1.5 / focal_length), theta)
    first, second = _decentering_coefficients(0.6, rng.uniform(0.0, 2.0 * math.pi))
    pose = PoseAngles(
        phi_xz_deg=rng.uniform(-180.0, 180.0),
        theta_zz_deg=5.0 * math.sqrt(rng.uniform()),
        psi_z_deg=rng.uniform(0.0, 360.0),
    )
    return Camera(
        width=IMAGE_SIZE[0],
        height=IMAGE_SIZE[1],
        projection="equisolid",
        focal_length_px=(focal_length, focal_length + rng.normal(0.0, 0.012)),
        skew_px=rng.normal(0.0, 0.006),
        principal_point_px=(873.5 + rng.normal(0.0, 4.0), 873.5 + rng.normal(0.0, 4.0)),
        rotation_cam_enu=rotation_from_pose_angles(pose),
        radial=_fit_radial_coefficients(residual, theta),
        decentering=(first, second, rng.normal(0.0, 0.3), rng.normal(0.0, 0.3)),
    )


def _decentering_coefficients(horizon_px: float, heading: float) -> tuple[float, float]:
    """Return p1, p2 whose radial shift (Eq. 12) is at most `horizon_px` at the horizon, towards `heading`."""
    size = horizon_px / _FOCAL_LENGTH_PX / (3.0 * _HORIZON_RADIUS_SQUARE)
    return size * math.cos(heading), size * math.sin(heading)


def _draw_smooth_function(rng: np.random.Generator, theta: FloatArray) -> FloatArray:
    """Draw a smooth function of unit size that starts flat at 0 (Gaussian process, length 0.6 rad)."""
    covariance = np.exp(-0.5 * ((theta[:, None] - theta[None, :]) / 0.6) ** 2)
    values, vectors = np.linalg.eigh(covariance)
    drawn = vectors @ (np.sqrt(np.clip(values, 0.0, None)) * rng.standard_normal(theta.size))
    onset = theta**2 / (theta**2 + 0.3**2)
    return np.asarray(drawn * onset)


def _remove_projection_part(residual: FloatArray, theta: FloatArray) -> FloatArray:
    """Take the part along g0 out, by subtracting a multiple of x²·g0, which a lens can have too."""
    ideal = 2.0 * np.sin(theta / 2.0)
    bump = ideal * (theta / _RIGHT_ANGLE)
    return np.asarray(residual - bump * (np.trapezoid(residual * ideal, theta) / np.trapezoid(bump * ideal, theta)))


def _fit_radial_coefficients(residual: FloatArray, theta: FloatArray) -> tuple[float, ...]:
    """Fit k2 … k9 to a residual, exactly orthogonal to g0 (a Lagrange multiplier on c1)."""
    powers = (theta / _RIGHT_ANGLE)[:, None] ** _ORDERS
    constraint = np.trapezoid(powers * (2.0 * np.sin(theta / 2.0))[:, None], theta, axis=0)
    size = _ORDERS.size
    system = np.zeros((size + 1, size + 1))
    system[:size, :size] = powers.T @ powers + 1e-9 * np.eye(size)
    system[:size, size] = system[size, :size] = constraint
    solution = np.linalg.solve(system, np.append(powers.T @ residual, 0.0))
    return tuple(float(k) for k in solution[:size])
