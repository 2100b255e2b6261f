"""How much more probable the sightings are with each part of the lens model than without it."""

from __future__ import annotations

import math

import numpy as np

from sunarc.array_types import FloatArray, IntArray
from sunarc.calibration.fit.marginal_likelihood import MarginalFit, NormalEquations, Scales, marginal_fit
from sunarc.calibration.least_squares.priors import DECENTERING, RADIAL, Whitened
from sunarc.calibration.model.residual_field import WaveBasis

_PARTS = {"skew": slice(Whitened.SKEW, Whitened.SKEW + 1), "radial": RADIAL, "decentering": DECENTERING}

_MENTIONED = math.log(3.0)
"""Log odds below which a difference is "not worth more than a bare mention" (Kass and Raftery 1995)."""


def log_odds_of_parts(normal: NormalEquations, basis: WaveBasis, scales: Scales) -> dict[str, float]:
    """Return the log odds, natural and at even ones before, of each part of the lens model against its being zero.

    Parameters
    ----------
    normal : the equations about the fit.
    basis, scales : of the fit.

    Returns
    -------
    `skew`, `radial` (k2 … k9 beside the projection) and `decentering` (p1 and p2). `radial_terms` is how many of the
    eight shapes of the radial distortion, the largest first, are needed: the odds of all others are below 3 to 1.

    Notes
    -----
    The ratio of Savage and Dickey (J. Dickey, Annals of Mathematical Statistics 42, 1971): for a nested model the
    Bayes factor is the posterior density of the part at zero over the prior's, all else integrated out. Both densities
    are taken as Gaussian, at the scales of the fit.
    """
    fit = marginal_fit(normal, basis, scales)
    precision = normal.prior_precision(scales.radial_px, scales.decentering_px)
    odds = {name: log_bayes_factor(fit, precision, np.arange(part.start, part.stop)) for name, part in _PARTS.items()}
    return {**odds, "radial_terms": float(_radial_terms(fit, precision))}


def log_bayes_factor(fit: MarginalFit, precision: FloatArray, part: IntArray) -> float:
    """Return the log Bayes factor of unknowns (k,) being free, of prior precisions (p,), against their being zero."""
    mean, covariance = fit.unknowns[part], fit.covariance[np.ix_(part, part)]
    sharpness = np.linalg.slogdet(covariance)[1] + float(np.sum(np.log(precision[part])))
    return float(0.5 * (mean @ np.linalg.solve(covariance, mean) + sharpness))


def _radial_terms(fit: MarginalFit, precision: FloatArray) -> int:
    """Return the least number of radial shapes beyond which the odds of all others together are below 3 to 1."""
    # the last column of the prior's basis is its largest shape
    for count in range(RADIAL.stop - RADIAL.start):
        others = np.arange(RADIAL.start, RADIAL.stop - count)
        if not log_bayes_factor(fit, precision, others) > _MENTIONED:
            return count
    return RADIAL.stop - RADIAL.start
