"""The bins' equations, and the solve with the field marginalised."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

from sunarc.array_types import BoolArray, FloatArray, IntArray
from sunarc.calibration.fit.field_axes import BasisProducts
from sunarc.calibration.fit.marginal_likelihood import (
    MarginalFit,
    NormalEquations,
    Scales,
    marginal_fit,
    normal_sums,
    penalty,
)
from sunarc.calibration.least_squares.problem import Observations, Problem
from sunarc.calibration.least_squares.time_bins import Bins
from sunarc.calibration.model.residual_field import WaveBasis

_STEPS = 8
_HALVINGS = 6
_REST = 1e-3
"""Gain in twice the log posterior below which a solve rests: a thirtieth of a sigma."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LinearSystem:
    """residual = rows · change of the unknowns + basis values · coefficients + noise, one line a bin.

    Attributes
    ----------
    observed : (b) one observation a bin, its pixel such that the residual is the bin's mean.
    rows : (b, 2, p); basis_values: (b, m); residual: (b, 2) px; at: (p,) where it was made.
    basis_products : products of the basis functions over the bins, the same for every camera.
    basis : the field's basis functions.
    member : (n,) the bin of every sighting.
    n_unit : how many of the last unknowns have unit prior variance: systematic errors and the refraction's.
    """

    observed: Observations
    rows: FloatArray
    basis_values: FloatArray
    residual: FloatArray
    at: FloatArray
    basis_products: BasisProducts
    basis: WaveBasis
    member: IntArray
    n_unit: int

    def normal(self) -> NormalEquations:
        """Return the sums over all bins."""
        return normal_sums(
            self.rows,
            self.basis_values,
            self.residual,
            self.observed.information,
            at=self.at,
            ff=self.basis_products,
            n_unit=self.n_unit,
        )

    def normal_of(self, which: BoolArray) -> NormalEquations:
        """Return the sums over the bins that are picked."""
        picked = self.rows[which], self.basis_values[which], self.residual[which], self.observed.information[which]
        return normal_sums(*picked, at=self.at, n_unit=self.n_unit)

    def moved(self, problem: Problem, at: FloatArray) -> LinearSystem:
        """Return the system about other unknowns."""
        residual, rows = problem.linearised(at, self.observed)
        return replace(self, residual=residual, rows=rows, at=at, n_unit=problem.n_unit)


def linear_system(
    problem: Problem,
    observed: Observations,
    bins: Bins,
    unknowns: FloatArray,
    *,
    information: FloatArray,
    basis: WaveBasis,
) -> LinearSystem:
    """Return the equations of sightings about some unknowns.

    The basis is evaluated where the model predicts the sun. Evaluated where it was detected, a field x_detected with a
    change of the lens by -x_modelled would be the noise itself, and a large enough field would explain it away.
    """
    gathered, residual = bins.gathered(observed, problem.residuals(unknowns, observed), information)
    offset, rows = problem.linearised(unknowns, gathered)
    basis_values = basis.values(gathered.pixels - offset)
    return LinearSystem(
        observed=replace(gathered, pixels=gathered.pixels + residual - offset),
        rows=rows,
        basis_values=basis_values,
        residual=residual,
        at=unknowns,
        basis_products=BasisProducts(matrix=basis_values.T @ (basis_values * gathered.information[:, None])),
        basis=basis,
        member=bins.member,
        n_unit=problem.n_unit,
    )


class AtRest(NamedTuple):
    """Where the steps came to rest: the equations there, their sums, the linear fit from there, and what was gained."""

    system: LinearSystem
    normal: NormalEquations
    fit: MarginalFit
    gain: float

    @property
    def unknowns(self) -> FloatArray:
        """The most probable unknowns, (p,)."""
        return self.system.at


def irls_converged(problem: Problem, system: LinearSystem, scales: Scales) -> AtRest:
    """Return the most probable unknowns and field: Gauss-Newton with halved steps."""
    normal = system.normal()
    now = begin = penalty(normal, system.basis, scales)
    for _ in range(_STEPS):
        best = marginal_fit(normal, system.basis, scales)
        if best.gain < _REST:
            return AtRest(system, normal, best, begin - now)
        step, gain = best.unknowns - system.at, 0.0
        # Gauss-Newton may overshoot where the lens bends: half a step still gains if the direction is right
        for halving in range(_HALVINGS):
            trial = system.moved(problem, system.at + 0.5**halving * step)
            trial_normal = trial.normal()
            gain = now - penalty(trial_normal, system.basis, scales)
            if gain > 0.0:
                system, normal, now = trial, trial_normal, now - gain
                break
        if gain < _REST:
            break
    return AtRest(system, normal, marginal_fit(normal, system.basis, scales), begin - now)
