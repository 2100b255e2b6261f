"""The bins' equations, and the solve with the field marginalised."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from sunarc.calibration.fit.marginal_likelihood import (
    RIDGE,
    ROUNDING,
    BasisProducts,
    FieldAxes,
    MarginalFit,
    NormalEquations,
    PriorScales,
    inverses,
    normal_sums,
    prior_precision,
)
from sunarc.calibration.model.sightings import Sightings
from sunarc.calibration.solve.priors import N_LENS
from sunarc.calibration.solve.problem import Bins, FitProblem, Sighted, camera_vectors, residuals_and_jacobian
from sunarc.common.array_types import BoolArray, FloatArray
from sunarc.common.robust_statistics import is_shown
from sunarc.optics.displacement import WaveBasis
from sunarc.optics.forward import Optics

_STEPS = 8
_HALVINGS = 6
_SAME_PLACE_PX = 0.02
"""A field changes by less than a ten-thousandth of itself over this: its shortest length is hundreds of px."""
_TELLS_NOTHING = 1e-14
"""Share of a coefficient's prior variance that sightings take away, below which they do not determine it."""
_LEAST_GAIN = 1e-3
"""Gain in twice the log posterior below which a solve ends: a thirtieth of a sigma."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LinearSystem:
    """residual = rows · change of the unknowns + basis values · coefficients + noise, one line a bin.

    Attributes
    ----------
    observed : (b) one observation a bin, its pixel such that the residual is the bin's mean.
    rows : (b, 2, p); basis_values: (b, m); residual: (b, 2) px; at: (p,) where it was made.
    basis_products : products of the basis functions over the bins, the same for every camera.
    basis : the field's basis functions.
    n_unit : how many of the last unknowns have unit prior variance: those of shared errors.
    """

    observed: Sightings
    rows: FloatArray
    basis_values: FloatArray
    residual: FloatArray
    at: FloatArray
    basis_products: BasisProducts
    basis: WaveBasis
    n_unit: int

    def normal(self) -> NormalEquations:
        """Return the sums over all bins."""
        every = self.rows, self.basis_values, self.residual, self.observed.information
        return normal_sums(*every, at=self.at, ff=self.basis_products, n_unit=self.n_unit)

    def sum_bins(self, which: BoolArray) -> NormalEquations:
        """Return the sums over the bins that are picked."""
        picked = self.rows[which], self.basis_values[which], self.residual[which], self.observed.information[which]
        return normal_sums(*picked, at=self.at, n_unit=self.n_unit)

    def in_field_axes(self, scales: PriorScales) -> tuple[LinearSystem, FloatArray]:
        """Return the system with the field in its axes under some scales, few as they are, and these axes (m, r).

        Under these scales it says what the whole one does; coefficients (..., r) times the axes' transpose are those of
        the basis.
        """
        axes = self.basis_products.axes(self.basis, scales.length_px)
        measured = scales.amplitude_px**2 * axes.information > _TELLS_NOTHING
        transform = np.ascontiguousarray(axes.transform[:, measured])
        own = FieldAxes(np.eye(transform.shape[1]), axes.information[measured])
        products = BasisProducts(matrix=np.diag(own.information), _axes={scales.length_px: own})
        return replace(self, basis_values=self.basis_values @ transform, basis_products=products), transform

    def moved(self, problem: FitProblem, at: FloatArray) -> LinearSystem:
        """Return the system linearised about other unknowns."""
        residual, rows = problem.linearised(at, self.observed)
        return replace(self, residual=residual, rows=rows, at=at, n_unit=problem.n_unit)


def linear_system(
    problem: FitProblem,
    observed: Sightings,
    bins: Bins,
    unknowns: FloatArray,
    *,
    information: FloatArray,
    basis: WaveBasis,
) -> LinearSystem:
    """Return the equations of sightings about some unknowns.

    The basis is evaluated where the model predicts the sun. Evaluated where it was detected, a field x_detected with a
    change of the lens by -x_modelled would be the noise itself, and a large enough field would explain it away. A
    sighting where the lens sees nothing takes no part.
    """
    residuals = problem.residuals(unknowns, observed)
    gathered, residual = bins.gathered(observed, residuals, information * is_shown(residuals))
    offset, rows = problem.linearised(unknowns, gathered)
    basis_values = basis.values(gathered.pixels - offset)
    weighed = basis_values * np.sqrt(gathered.information)[:, None]
    return LinearSystem(
        observed=replace(gathered, pixels=gathered.pixels + residual - offset),
        rows=rows,
        basis_values=basis_values,
        residual=residual,
        at=unknowns,
        basis_products=BasisProducts(matrix=weighed.T @ weighed),
        basis=basis,
        n_unit=problem.n_unit,
    )


def system_about(
    problem: FitProblem, observed: Sightings, bins: Bins, system: LinearSystem, unknowns: FloatArray
) -> LinearSystem:
    """Return the equations about other unknowns, the sightings' information as of a system that is there.

    Where the predictions hardly move, the field's basis functions and their products stay those of that system.
    """
    moved = system.moved(problem, unknowns)
    if np.max(np.abs(moved.residual - system.residual), initial=0.0) < _SAME_PLACE_PX:
        return moved
    return linear_system(problem, observed, bins, unknowns, information=observed.information, basis=system.basis)


class Converged(NamedTuple):
    """Point where the steps converged: the unknowns (p,), the linear fit from there, the gain.

    The gain is of twice the log posterior.
    """

    unknowns: FloatArray
    fit: MarginalFit
    gain: float


def most_probable_with_field(problem: FitProblem, system: LinearSystem, scales: PriorScales) -> Converged:
    """Return the most probable unknowns and field by Gauss-Newton with halved steps.

    The weights stay: the rounds renew them.
    """
    in_axes, transform = system.in_field_axes(scales)
    equations = _Equations.of(problem, in_axes, scales)
    at = np.array(system.at, dtype=np.float64)
    sums = equations.about(at)
    begin = sums.penalty
    for _ in range(_STEPS):
        step, promise = sums.step()
        if promise < _LEAST_GAIN:
            break
        gain = 0.0
        # Gauss-Newton may overshoot where the lens bends: half a step still gains if the direction is right. No damping
        # as in Levenberg-Marquardt: the start is a robust fit, and the priors keep the matrix positive
        for halving in range(_HALVINGS):
            trial = at + 0.5**halving * step
            there = equations.about(trial)
            gain = sums.penalty - there.penalty
            if gain > 0.0:
                at, sums = trial, there
                break
        if not gain >= _LEAST_GAIN:
            break
    return Converged(at, sums.fit(at, equations).transform_coefficients(transform), begin - sums.penalty)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Equations:
    """Terms of a solve's equations, wherever it stands.

    Attributes
    ----------
    optics, sighted, mean, basis : of the problem and its bins, as the kernels take them.
    root : (b,) of the bins' information, 1/px.
    field : (r, b) the field's basis functions in its axes, each bin times its root, each axis times its spread: what
        such products have, the field takes from the sightings.
    spread : (r,) roots of the posterior variances along the axes.
    precision : (p,) of the prior.
    """

    optics: Optics
    sighted: Sighted
    mean: FloatArray
    basis: FloatArray
    root: FloatArray
    field: FloatArray
    spread: FloatArray
    precision: FloatArray

    @classmethod
    def of(cls, problem: FitProblem, system: LinearSystem, scales: PriorScales) -> _Equations:
        """Return the equations of a system in the field's axes under given scales."""
        axes, root = system.basis_products.axes(system.basis, scales.length_px), np.sqrt(system.observed.information)
        spread = np.sqrt(axes.posterior_variances(np.array([scales.amplitude_px]))[0])
        return cls(
            optics=problem.kernel_numbers(),
            sighted=problem.sighted(system.observed),
            mean=problem.prior.mean,
            basis=np.ascontiguousarray(problem.prior.basis),
            root=root,
            field=np.ascontiguousarray((system.basis_values * root[:, None] * spread).T),
            spread=spread,
            precision=prior_precision(problem.size, scales.radial_px, scales.decentering_px, n_unit=problem.n_unit),
        )

    def about(self, at: FloatArray) -> _Sums:
        """Return the sums about some unknowns (p,)."""
        shared = at.size - self.sighted.systematic_px.shape[2]
        vectors = camera_vectors(self.mean, self.basis, at, (shared - N_LENS) // 3)
        left, columns = residuals_and_jacobian(self.optics, vectors, self.sighted, at[shared:], self.basis)
        left *= self.root
        columns *= self.root
        rows, of_field = self.field @ columns.swapaxes(1, 2), left @ self.field.T
        own = np.sum(columns @ columns.swapaxes(1, 2), axis=0)
        flat = rows.reshape(-1, at.size)
        pull = np.sum(columns @ left[..., None], axis=(0, 2))
        return _Sums(
            matrix=own - flat.T @ flat + np.diag(self.precision + ROUNDING * np.diag(own)),
            vector=pull - of_field.ravel() @ flat - self.precision * at,
            rows=rows,
            left=of_field,
            penalty=float(np.sum(left**2) - np.sum(of_field**2) + self.precision @ at**2),
        )


class _Sums(NamedTuple):
    """Sums of the equations about given unknowns, the field integrated out.

    matrix (p, p), vector (p,): information on the unknowns, prior and rounding in it, and pull. rows (2, r, p), left
    (2, r): products of the weighed field with derivatives and residuals. penalty: twice the negative log posterior.
    """

    matrix: FloatArray
    vector: FloatArray
    rows: FloatArray
    left: FloatArray
    penalty: float

    def step(self) -> tuple[FloatArray, float]:
        """Return the step (p,) and its expected gain; 0 where the equations cannot be solved."""
        scale = 1.0 / np.sqrt(np.maximum(np.diag(self.matrix), 1e-300))
        scaled = self.matrix * scale[:, None] * scale + RIDGE * np.eye(scale.size)
        try:
            np.linalg.cholesky(scaled)  # raises where it is not positive
            step = scale * np.linalg.solve(scaled, scale * self.vector)
        except np.linalg.LinAlgError:
            return np.zeros(scale.size), 0.0
        return step, float(step @ self.vector)

    def fit(self, at: FloatArray, equations: _Equations) -> MarginalFit:
        """Return the linear fit from some unknowns."""
        covariance = inverses(self.matrix)
        step = covariance @ self.vector
        return MarginalFit(
            unknowns=at + step,
            gain=float(step @ self.vector),
            coefficients=equations.spread * (self.left - self.rows @ step),
            covariance=covariance,
            cross=-(covariance @ np.swapaxes(self.rows, -1, -2)) * equations.spread,
        )
