"""Covariance where the decentering's higher coefficients are not known: a mixture over them.

The decentering is a product, (p1, p2) × (1 + p3 θ² + p4 θ⁴). A part of a day's arc leaves p3 and p4 open, and the other
unknowns depend on them along a curve, or have two optima of opposite sign: the Gaussian about one optimum is then far
too narrow. So p3 and p4 are integrated out on a grid of their prior, and the covariance is that of the mixture about
the fit that is returned. Given p3 and p4 the decentering is exactly linear in p1 and p2, and nearly always all else is
linear about the fit, as it is taken to be in every covariance: each place is a linear fit with its evidence, by sums
over the sightings that are made once. Where the residuals at the plausible places contradict that, each place is solved
on the whole lens.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from sunarc.array_types import FloatArray
from sunarc.calibration.fit.field_posterior import seen_field
from sunarc.calibration.fit.hyperparameter_marginalisation import PosteriorCovariance
from sunarc.calibration.fit.marginal_likelihood import ROUNDING, Scales, Turned, general_inverses, normal_sums
from sunarc.calibration.fit.normal_equations import LinearSystem, converged_in_axes, log_determinants
from sunarc.calibration.least_squares.priors import DECENTERING, HIGHER
from sunarc.calibration.least_squares.problem import Problem

_SPACING = 1.0
_NODES = np.array(list(itertools.product(np.arange(-2.0, 2.5, _SPACING), repeat=2)))
"""Values of p3 and p4 in units of their prior's 1-sigma: they hold 98 % of it in each."""
_CELL = math.log(_SPACING**2 / (2.0 * math.pi))
_RIDGE = 1e-12
_KNOWN = 0.15
"""1-sigma of p3 and p4, in units of the prior's, below which they are known and the Gaussian holds."""
_PRODUCTS = 4
_WIDEST = 3.0
"""p3 and p4 of a fit, in units of their prior's 1-sigma: one spacing beyond the places."""
_PLAUSIBLE = 1e-3
"""Probability from which on a place counts in the test of linearity."""
_CURVED = 0.3
"""Departure of twice the log posterior from the linear fit's: it changes a share by a sixth."""


class Conditionals(NamedTuple):
    """Fits where p3 and p4 are known, k of them.

    shift (k, p): of the unknowns, from the free fit; covariance (k, p, p) of them; penalty (k,): twice the negative log
    posterior; log_evidence (k,), but for one constant. coefficients (k, 2, m) of the field, and cross (k, 2, p, m) with
    the unknowns.
    """

    shift: FloatArray
    covariance: FloatArray
    penalty: FloatArray
    log_evidence: FloatArray
    coefficients: FloatArray
    cross: FloatArray


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class BilinearSums:
    """Sums over the bins for a prediction that is linear in p unknowns and in the products p1 p3, p1 p4, p2 p3, p2 p4.

    Attributes
    ----------
    information, pull : (p + 4, p + 4), (p + 4,) of the unknowns and the products, the field integrated out.
    square : what the field leaves of the squares of the residuals.
    precision, at : (p,) of the prior; and the unknowns that the sums are about.
    turned, shrink : the sums in the field's axes, and its shrinkage, under the scales.
    """

    information: FloatArray
    pull: FloatArray
    square: float
    precision: FloatArray
    at: FloatArray
    turned: Turned
    shrink: FloatArray

    @classmethod
    def about(cls, problem: Problem, system: LinearSystem, unknowns: FloatArray, scales: Scales) -> BilinearSums:
        """Return the sums of a system about some unknowns (p,)."""
        rows = np.concatenate([system.rows, *_by_products(problem, system, unknowns)], axis=-1)
        normal = normal_sums(
            rows,
            system.basis_values,
            system.residual,
            system.observed.information,
            at=unknowns,
            ff=system.basis_products,
            n_unit=system.n_unit,
        )
        turned = Turned.of(normal, system.basis, scales.length_px)
        shrink = turned.axes.shrinkage(np.array([scales.amplitude_px]))[0]
        return cls(
            information=normal.jj + ROUNDING * np.diag(np.diag(normal.jj)) - turned.absorbed(shrink),
            pull=normal.jr - turned.explained(shrink),
            square=normal.rr - float(np.sum(shrink * turned.residual**2)),
            precision=normal.prior_precision(scales.radial_px, scales.decentering_px),
            at=unknowns,
            turned=turned,
            shrink=shrink,
        )

    def free(self) -> Conditionals:
        """Return the fit with p3 and p4 free: the only one, k = 1."""
        p = self.at.size
        return self._fits(np.eye(p + _PRODUCTS, p)[None], np.zeros((1, p + _PRODUCTS)), self.at)

    def conditional(self, places: FloatArray) -> Conditionals:
        """Return the fits with p3 and p4 held at places (k, 2), in units of their prior's 1-sigma."""
        p, count = self.at.size, places.shape[0]
        away = places - self.at[HIGHER]
        columns, offset = np.tile(np.eye(p + _PRODUCTS, p), (count, 1, 1)), np.zeros((count, p + _PRODUCTS))
        columns[:, HIGHER, HIGHER] = 0.0
        for number, of_first in enumerate(range(DECENTERING.start, DECENTERING.stop)):
            products = slice(p + 2 * number, p + 2 * number + 2)
            columns[:, products, of_first] = away
            offset[:, products] = away * self.at[of_first]
        others = self.at.copy()
        others[HIGHER] = 0.0
        fits = self._fits(columns, offset, others)
        fits.covariance[:, HIGHER] = fits.covariance[:, :, HIGHER] = fits.cross[:, :, HIGHER] = 0.0
        fits.shift[:, HIGHER] = away
        return fits

    def _fits(self, columns: FloatArray, offset: FloatArray, begin: FloatArray) -> Conditionals:
        """Return the fits of unknowns about `begin` (p,).

        The columns' factors are offset (k, p + 4) plus columns (k, p + 4, p) times the step of the unknowns.
        """
        back = columns.swapaxes(-1, -2)
        matrix = back @ self.information @ columns + np.diag(self.precision)
        vector = (back @ (self.pull - offset @ self.information)[..., None])[..., 0] - self.precision * begin
        covariance = general_inverses(matrix, np.zeros((1, begin.size)))
        step = (covariance @ vector[..., None])[..., 0]
        # where the step begins
        penalty = self.square + np.sum(offset * (offset @ self.information - 2.0 * self.pull), axis=1)
        penalty = penalty + self.precision @ begin**2 - np.sum(step * vector, axis=1)
        determinant = log_determinants(matrix) - np.sum(np.log(self.precision))
        moved = offset + (columns @ step[..., None])[..., 0]
        return Conditionals(
            shift=step,
            covariance=covariance,
            penalty=penalty,
            log_evidence=-0.5 * (penalty + determinant),
            coefficients=self.turned.coefficients(self.shrink, moved),
            cross=-((covariance @ back)[:, None] @ (self.turned.rows * self.shrink)) @ self.turned.axes.transform.T,
        )

    def true_penalty(self, problem: Problem, system: LinearSystem, shift: FloatArray) -> float:
        """Return twice the negative log posterior of the whole lens where the unknowns have moved by a shift (p,)."""
        at = self.at + shift
        residual = problem.residuals(at, system.observed)
        weighed = residual.T * system.observed.information
        in_axes = (weighed @ system.basis_values) @ self.turned.axes.transform
        fitted = float(np.sum(weighed * residual.T)) - float(np.sum(self.shrink * in_axes**2))
        others = at.copy()
        others[HIGHER] = 0.0
        return fitted + float(self.precision @ others**2)


def _by_products(problem: Problem, system: LinearSystem, unknowns: FloatArray) -> list[FloatArray]:
    """Return two times (b, 2, 2): derivatives of the prediction by p1 p3 and p1 p4, and by p2 p3 and p2 p4."""
    found = []
    for one in range(DECENTERING.start, DECENTERING.stop):
        # those by p3 and p4 are linear in p1 and p2: where one of them is 1 and the other 0, they are those sought
        unit = unknowns.copy()
        unit[DECENTERING] = 0.0
        unit[one] = 1.0
        found.append(problem.linearised(unit, system.observed)[1][..., HIGHER])
    return found


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
    sums = BilinearSums.about(problem, system, unknowns, scales)
    free, nodes = sums.free(), sums.conditional(_NODES)
    share = _shares(free, nodes)
    if not _is_linear(sums, problem, system, nodes, share):
        nodes = _of_whole_lens(problem, system, unknowns, scales)
        share = _shares(free, nodes)
    moments = nodes.covariance + nodes.shift[:, :, None] * nodes.shift[:, None, :]
    excess = np.tensordot(share, moments - free.covariance, 1)
    part, positive = _positive_part(excess, free.covariance[0])
    covariance = posterior.covariance + part
    if mean is None:
        return posterior._replace(covariance=covariance)
    field_shift = (nodes.coefficients - mean)[:, :, None, :]
    with_field = np.tensordot(share, nodes.cross + nodes.shift[:, None, :, None] * field_shift - free.cross, 1)
    field = replace(posterior.field, cross=posterior.field.cross + positive @ with_field)
    return PosteriorCovariance(covariance, seen_field(field, system.normal(), covariance))


def _shares(free: Conditionals, nodes: Conditionals) -> FloatArray:
    """Return (k,): how probable the places are.

    The free fit takes part: where the grid misses the optimum, the Gaussian about it holds.
    """
    log_mass = np.r_[free.log_evidence, nodes.log_evidence - 0.5 * np.sum(_NODES**2, axis=1) + _CELL]
    share = np.exp(log_mass - np.max(log_mass))
    return np.asarray((share / share.sum())[1:])


def _is_linear(
    sums: BilinearSums, problem: Problem, system: LinearSystem, nodes: Conditionals, share: FloatArray
) -> bool:
    """Return whether the whole lens is, at all plausible places, about as probable as the linear fits are.

    A fit far beyond the places says nothing of them.
    """
    if float(np.max(np.abs(sums.at[HIGHER]))) > _WIDEST:
        return False
    for one in np.flatnonzero(share > _PLAUSIBLE):
        if abs(sums.true_penalty(problem, system, nodes.shift[one]) - nodes.penalty[one]) > _CURVED:
            return False
    return True


def _of_whole_lens(problem: Problem, system: LinearSystem, unknowns: FloatArray, scales: Scales) -> Conditionals:
    """Return the conditional fits of the whole lens, p3 and p4 in its prior's mean and not in its basis."""
    in_axes, transform = system.in_field_axes(scales)
    prior, start, found = problem.prior, unknowns.copy(), []
    start[HIGHER] = 0.0
    for place in _NODES:
        basis = prior.basis.copy()
        basis[:, HIGHER] = 0.0
        held = replace(problem, prior=replace(prior, mean=prior.mean + prior.basis[:, HIGHER] @ place, basis=basis))
        rest = converged_in_axes(held, in_axes, scales, start)
        fit = rest.fit.with_coefficients_on(transform)
        shift = rest.unknowns - unknowns
        shift[HIGHER] = place - unknowns[HIGHER]
        fit.covariance[HIGHER] = fit.covariance[:, HIGHER] = fit.cross[:, HIGHER] = 0.0
        found.append((shift, fit.covariance, math.nan, rest.log_evidence, fit.coefficients, fit.cross))
    return Conditionals(*(np.array(column) for column in zip(*found, strict=True)))


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
