"""Covariance where the decentering's higher coefficients are not known: a mixture over them.

The decentering is a product, (p1, p2) × (1 + p3 θ² + p4 θ⁴). A part of a day's arc leaves p3 and p4 open, and the other
unknowns depend on them along a curve, or have two optima of opposite sign: the Gaussian about one optimum is then far
too narrow. Given p3 and p4 the model is nearly linear, so they are integrated out on a grid of their prior: each place
is a conditional fit with its evidence, and the covariance is that of the mixture about the fit that is returned.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from sunarc.array_types import FloatArray
from sunarc.calibration.fit.field_posterior import seen_field
from sunarc.calibration.fit.hyperparameter_marginalisation import PosteriorCovariance
from sunarc.calibration.fit.marginal_likelihood import Scales, marginal_fit
from sunarc.calibration.fit.normal_equations import LinearSystem, converged_in_axes, weighing_of
from sunarc.calibration.fit.steps_kernel import Weighing
from sunarc.calibration.least_squares.priors import HIGHER
from sunarc.calibration.least_squares.problem import Problem

_SPACING = 1.0
_NODES = tuple(itertools.product(np.arange(-2.0, 2.5, _SPACING), repeat=2))
"""Values of p3 and p4 in units of their prior's 1-sigma: they hold 98 % of it in each."""
_CELL = math.log(_SPACING**2 / (2.0 * math.pi))
_RIDGE = 1e-12
_KNOWN = 0.15
"""1-sigma of p3 and p4, in units of the prior's, below which they are known and the Gaussian holds."""


class _Conditional(NamedTuple):
    """Second moments about the free fit where p3 and p4 are known, and the log evidence of that cell.

    moments (p, p) of the unknowns; cross (2, p, m) with the field's coefficients, where it is predicted.
    """

    moments: FloatArray
    cross: FloatArray | None
    log_evidence: float


def mixed_over_decentering(  # noqa: PLR0917 - the fit, piece by piece
    posterior: PosteriorCovariance,
    problem: Problem,
    system: LinearSystem,
    unknowns: FloatArray,
    scales: Scales,
    mean: FloatArray | None = None,
) -> PosteriorCovariance:
    """Return the covariance with p3 and p4 integrated out.

    Parameters
    ----------
    posterior : the covariance about the fit, all unknowns taken as Gaussian.
    problem, system : of the fit; the system about `unknowns`.
    unknowns : the fit, (p,).
    scales : those of the fit.
    mean : (2, m) coefficients of the field in the prediction; None: it has no part there.
    """
    inner = posterior.covariance[HIGHER, HIGHER]
    if float(np.sqrt(np.max(np.diag(inner)))) < _KNOWN:
        return posterior
    normal = system.normal()
    free = marginal_fit(normal, system.basis, scales)
    in_axes = system.in_field_axes(scales)
    weighing = weighing_of(problem, in_axes[0], scales)
    conditionals = [_conditional(problem, in_axes, unknowns, node, scales, mean, weighing) for node in _NODES]
    # the free fit takes part: where the grid misses the optimum, the Gaussian about it holds
    about_fit = converged_in_axes(problem, in_axes[0], scales, unknowns, steps=0, weighing=weighing)
    log_mass = np.array([about_fit.log_evidence, *(node.log_evidence for node in conditionals)])
    share = np.exp(log_mass - np.max(log_mass))
    share = (share / share.sum())[1:]
    excess = np.tensordot(share, np.stack([node.moments - free.covariance for node in conditionals]), 1)
    part, positive = _positive_part(excess, free.covariance)
    covariance = posterior.covariance + part
    crosses = [node.cross - free.cross for node in conditionals if node.cross is not None]
    if not crosses:
        return posterior._replace(covariance=covariance)
    with_field = np.tensordot(share, np.stack(crosses), 1)
    field = replace(posterior.field, cross=posterior.field.cross + positive @ with_field)
    return PosteriorCovariance(covariance, seen_field(field, normal, covariance))


def _positive_part(excess: FloatArray, reference: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return a symmetric matrix (p, p) without what it takes from a covariance, in units of that one.

    And the projection (p, p) that does so.
    """
    scale = np.sqrt(np.diag(reference))
    # in units of the Gaussian's covariance, positive and negative parts do not depend on the unknowns' units
    root = np.linalg.cholesky(reference / np.outer(scale, scale) + _RIDGE * np.eye(scale.size))
    left = np.linalg.solve(root, excess / np.outer(scale, scale))
    values, vectors = np.linalg.eigh(np.linalg.solve(root, left.T))
    shape = (scale[:, None] * root) @ vectors
    back = np.linalg.solve(root, np.diag(1.0 / scale))
    return (shape * np.maximum(values, 0.0)) @ shape.T, (shape * (values > 0.0)) @ vectors.T @ back


def _conditional(  # noqa: PLR0917 - the fit, piece by piece
    problem: Problem,
    in_axes: tuple[LinearSystem, FloatArray],
    unknowns: FloatArray,
    node: tuple[float, ...],
    scales: Scales,
    field_mean: FloatArray | None,
    weighing: Weighing | None = None,
) -> _Conditional:
    """Return the fit with p3 and p4 held at a place; see `LinearSystem.in_field_axes`."""
    fixed = np.array(node)
    basis = problem.prior.basis.copy()
    mean = problem.prior.mean + basis[:, HIGHER] @ fixed
    basis[:, HIGHER] = 0.0
    conditioned = replace(problem, prior=replace(problem.prior, mean=mean, basis=basis))
    start = unknowns.copy()
    start[HIGHER] = 0.0
    system, transform = in_axes
    rest = converged_in_axes(conditioned, system, scales, start, weighing=weighing)
    covariance = rest.fit.covariance.copy()
    covariance[HIGHER] = covariance[:, HIGHER] = 0.0
    shift = rest.unknowns - unknowns
    shift[HIGHER] = fixed - unknowns[HIGHER]
    cross = None
    if field_mean is not None:
        there = rest.fit.with_coefficients_on(transform)
        cross = there.cross.copy()
        cross[:, HIGHER] = 0.0
        cross = cross + shift[:, None] * (there.coefficients - field_mean)[:, None, :]
    return _Conditional(
        moments=covariance + np.outer(shift, shift),
        cross=cross,
        log_evidence=rest.log_evidence - 0.5 * float(fixed @ fixed) + _CELL,
    )
