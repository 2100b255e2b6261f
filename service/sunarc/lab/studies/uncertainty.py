"""The paper's Figs. 4 and 5 made again: how an arc's noise becomes an error of the calibration."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import null_space, solve_triangular

from sunarc.calibration.answers.covariance import hemisphere
from sunarc.calibration.model.options import ImageCircle, LensTolerances, Method
from sunarc.calibration.solve.priors import LENS, N_LENS, lens_prior, precisions
from sunarc.common.array_types import FloatArray
from sunarc.lab.simulation.truth import true_camera
from sunarc.lab.studies.trials import QUANTITIES, Trial, run_trials, synthetic_arc
from sunarc.optics.camera import FOCAL_LENGTH, PARAMETER_NAMES, POSE, RADIAL, RADIAL_ORDERS, Camera, Param
from sunarc.optics.forward import project_with_jacobian
from sunarc.optics.projections import ideal_radius

Row = dict[str, str | int | float]

LARGEST_SIGMA_PX = 10.0
QUANTILES: Mapping[str, float] = {"p05": 0.05, "p25": 0.25, "median": 0.5, "p75": 0.75, "p95": 0.95}


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class UncertaintyStudy:
    """Result of the trials.

    Attributes
    ----------
    methods : of the fits.
    sigma_px : (levels,) noise, px per axis.
    seed : of all trials.
    trials : by method, (levels, trials, len(QUANTITIES)).
    bound : by method, (levels, len(QUANTITIES)): the Cramér–Rao bound.
    """

    methods: tuple[Method, ...]
    sigma_px: FloatArray
    seed: int
    trials: Mapping[Method, FloatArray]
    bound: Mapping[Method, FloatArray]


def study_uncertainty(
    *,
    methods: Sequence[Method],
    levels: int = 41,
    trials: int = 25,
    seed: int = 1,
    jobs: int = 1,
    after_each: Callable[[], None] = lambda: None,
) -> UncertaintyStudy:
    """Fit the synthetic arc of 13 May 2013 again and again, with noise from 0 to 10 px per axis.

    Parameters
    ----------
    methods : of the fits; all are given the same sightings.
    levels : number of noise levels (the paper's S = 41).
    trials : fits at each level (the paper's 1000).
    seed : of everything that is drawn.
    jobs : processes.
    after_each : called after every fit.
    """
    sigmas = np.linspace(0.0, LARGEST_SIGMA_PX, levels)
    todo = [
        Trial(method=method, sigma_px=float(sigma), seed=(seed, level, number))
        for method in methods
        for level, sigma in enumerate(sigmas)
        for number in range(trials)
    ]
    results = run_trials(todo, jobs=jobs, after_each=after_each).reshape(len(methods), levels, trials, len(QUANTITIES))
    truth, arc = true_camera(0), synthetic_arc()
    bound = {
        method: np.array(
            [cramer_rao_bound(truth, arc.directions, method=method, sigma_px=float(sigma)) for sigma in sigmas]
        )
        for method in methods
    }
    return UncertaintyStudy(
        methods=tuple(methods), sigma_px=sigmas, seed=seed, trials=dict(zip(methods, results, strict=True)), bound=bound
    )


def true_values() -> FloatArray:
    """Return the truth of `QUANTITIES`: no error, and the true camera's parameters."""
    truth = true_camera(0)
    return np.array([0.0, 0.0, *truth.focal_length_px, *truth.principal_point_px])


def distribution_rows(study: UncertaintyStudy) -> list[Row]:
    """Return one row a method, level and quantity: truth, mean, quantiles, and the bound."""
    return [
        {
            "method": method,
            "sigma_px": float(sigma),
            "quantity": quantity,
            "n_trials": study.trials[method].shape[1],
            "truth": float(true_values()[column]),
            "mean": float(np.mean(study.trials[method][level, :, column])),
            **{name: float(np.quantile(study.trials[method][level, :, column], q)) for name, q in QUANTILES.items()},
            "bound": float(study.bound[method][level, column]),
        }
        for method in study.methods
        for level, sigma in enumerate(study.sigma_px)
        for column, quantity in enumerate(QUANTITIES)
    ]


def trial_rows(study: UncertaintyStudy) -> list[Row]:
    """Return one row a fit."""
    return [
        {
            "method": method,
            "sigma_px": float(sigma),
            "trial": number,
            **dict(zip(QUANTITIES, map(float, row), strict=True)),
        }
        for method in study.methods
        for level, sigma in enumerate(study.sigma_px)
        for number, row in enumerate(study.trials[method][level])
    ]


# The Cramér–Rao bound: how well an arc can tell a camera, for what each method holds to be known already.
#
# A method's unknowns u make the camera's parameters β = B u to first order, with prior precisions Λ: the paper's are
# 20
# parameters held to c1 = 0 and c2 = 0 exactly (t = 0), the service's 20 parameters with the priors of the lens.

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
    basis, precision = make_prior(camera, method=method)
    on_arc = _compute_derivatives(camera, directions) @ basis
    root = _compute_covariance_root(np.concatenate([on_arc / sigma_px, np.diag(np.sqrt(precision))]))
    spread = np.linalg.norm(basis @ root, axis=-1)
    parameters = [spread[PARAMETER_NAMES.index(name)] for name in QUANTITIES[2:]]
    on_sky = _compute_derivatives(camera, hemisphere()) @ basis
    return np.array([_rms_distance(on_arc @ root), _rms_distance(on_sky @ root), *parameters])


def make_prior(camera: Camera, *, method: Method) -> tuple[FloatArray, FloatArray]:
    """Return B (23, m) and the diagonal of Λ (m,)."""
    return _make_constraints(camera) if method == "paper" else _make_priors(camera)


def _make_constraints(camera: Camera) -> tuple[FloatArray, FloatArray]:
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


def _make_priors(camera: Camera) -> tuple[FloatArray, FloatArray]:
    """Return the lens's whitened coordinates and the rotation, with the priors that the service starts from."""
    x, y = camera.principal_point_px
    circle = ImageCircle(x=x, y=y, radius=camera.focal_length_px[0] * math.sqrt(2.0))
    usual = LensTolerances()
    basis = np.zeros((len(PARAMETER_NAMES), N_LENS + 3))
    basis[LENS, :N_LENS] = lens_prior(camera, tolerances=usual, circle=circle, field_angle=_RIGHT_ANGLE).basis
    basis[POSE, N_LENS:] = np.eye(3)
    return basis, np.concatenate([precisions(usual.radial_px, usual.decentering_px), np.zeros(3)])


def _compute_derivatives(camera: Camera, directions: FloatArray) -> FloatArray:
    """Return (2 n, 23): the derivatives of x and y by the parameters."""
    _, by_parameters, _ = project_with_jacobian(camera, directions)
    return by_parameters.reshape(-1, len(PARAMETER_NAMES))


def _compute_covariance_root(rows: FloatArray) -> FloatArray:
    """Return R⁻¹ with R⁻¹ R⁻ᵀ = (A'A)⁻¹, by QR of A with its columns brought to one size."""
    size = np.linalg.norm(rows, axis=0)
    triangle = np.linalg.qr(rows / size, mode="r")
    return np.asarray(solve_triangular(triangle, np.eye(size.size)) / size[:, None])


def _rms_distance(rows: FloatArray) -> float:
    """Return the root mean square 2-D distance of unit-variance combinations of rows (2 n, m)."""
    return float(np.sqrt(2.0 * np.mean(np.sum(rows**2, axis=-1))))
