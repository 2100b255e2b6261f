"""The Cramér–Rao bound: how well an arc can tell a camera, for what each method holds to be known already.

A method's unknowns u make the camera's parameters β = B u to first order, with prior precisions Λ: the paper's are 20
parameters held to c1 = 0 and c2 = 0 exactly (t = 0), the service's 20 parameters with the priors of the lens.
"""

from __future__ import annotations

import math

import numpy as np
from scipy.linalg import null_space, solve_triangular

from sunarc.array_types import FloatArray
from sunarc.calibration.least_squares.priors import prior_knowledge
from sunarc.calibration.model.covariance import hemisphere
from sunarc.calibration.model.options import ImageCircle, LensTolerances, Method
from sunarc.optics.camera import FOCAL_LENGTH, PARAMETER_NAMES, RADIAL, RADIAL_ORDERS, Camera, Param
from sunarc.optics.forward import project_with_jacobian
from sunarc.optics.projections import ideal_radius
from sunarc.studies.trials import QUANTITIES

_RIGHT_ANGLE = math.pi / 2
_FREE = np.array([i for i, name in enumerate(PARAMETER_NAMES) if not name.startswith("translation")])
"""All but the translation."""


def cramer_rao_bound(camera: Camera, directions: FloatArray, *, method: Method, sigma_px: float) -> FloatArray:
    """Return the smallest 1-sigma of each of `QUANTITIES` that sightings allow (for an RMSE its own smallest size).

    Parameters
    ----------
    camera : the truth.
    directions : (n, 3) where the sun was sighted, east-north-up.
    method : whose prior knowledge counts.
    sigma_px : noise, px per axis.
    """
    if sigma_px <= 0.0:
        return np.zeros(len(QUANTITIES))
    basis, precision = prior_of(camera, method=method)
    on_arc = _rows(camera, directions) @ basis
    root = _covariance_root(np.concatenate([on_arc / sigma_px, np.diag(np.sqrt(precision))]))
    spread = np.linalg.norm(basis @ root, axis=-1)
    parameters = [spread[PARAMETER_NAMES.index(name)] for name in QUANTITIES[2:]]
    on_sky = _rows(camera, hemisphere()) @ basis
    return np.array([_rms(on_arc @ root), _rms(on_sky @ root), *parameters])


def prior_of(camera: Camera, *, method: Method) -> tuple[FloatArray, FloatArray]:
    """Return B (23, m) and the diagonal of Λ (m,)."""
    return _constraints(camera) if method == "paper" else _priors(camera)


def _constraints(camera: Camera) -> tuple[FloatArray, FloatArray]:
    """Return the directions in which c1 and c2 (skew 0, one focal length) let the parameters move, and no priors."""
    theta = np.linspace(0.0, _RIGHT_ANGLE, 181)
    powers = (theta / _RIGHT_ANGLE)[:, None] ** np.array(RADIAL_ORDERS)
    constraints = np.zeros((3, len(PARAMETER_NAMES)))
    constraints[0, RADIAL] = np.trapezoid(ideal_radius(camera.projection, theta)[:, None] * powers, theta, axis=0)
    constraints[1, FOCAL_LENGTH] = 1.0, -1.0
    constraints[2, Param.SKEW_PX] = 1.0
    basis = np.zeros((len(PARAMETER_NAMES), _FREE.size - 3))
    basis[_FREE] = null_space(constraints[:, _FREE])
    return basis, np.zeros(basis.shape[1])


def _priors(camera: Camera) -> tuple[FloatArray, FloatArray]:
    """Return the lens's whitened coordinates and the rotation, with the priors that the service starts from."""
    x, y = camera.principal_point_px
    circle = ImageCircle(x=x, y=y, radius=camera.focal_length_px[0] * math.sqrt(2.0))
    return prior_knowledge(camera, tolerances=LensTolerances(), circle=circle)


def _rows(camera: Camera, directions: FloatArray) -> FloatArray:
    """Return (2 n, 23): the derivatives of x and y by the parameters."""
    _, by_parameters, _ = project_with_jacobian(camera, directions)
    return by_parameters.reshape(-1, len(PARAMETER_NAMES))


def _covariance_root(rows: FloatArray) -> FloatArray:
    """Return R⁻¹ with R⁻¹ R⁻ᵀ = (A'A)⁻¹, by QR of A with its columns brought to one size."""
    size = np.linalg.norm(rows, axis=0)
    triangle = np.linalg.qr(rows / size, mode="r")
    return np.asarray(solve_triangular(triangle, np.eye(size.size)) / size[:, None])


def _rms(rows: FloatArray) -> float:
    """Return the root mean square 2-D distance of unit-variance combinations of rows (2 n, m)."""
    return float(np.sqrt(2.0 * np.mean(np.sum(rows**2, axis=-1))))
