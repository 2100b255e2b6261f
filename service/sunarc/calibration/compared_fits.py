"""Log evidence of cameras that were found from the same sightings, all with the noise and the weights of one of them.

With noise and weights of its own each would have a likelihood of its own. Those of the lowest robust cost are taken.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import NamedTuple, TypeVar

import numpy as np

from sunarc.calibration.fit.marginal_likelihood import HyperparameterGrid, log_evidence, log_weights
from sunarc.calibration.fit.normal_equations import linear_system
from sunarc.calibration.fit.robust_fit import FitState
from sunarc.calibration.model.sightings import Sightings
from sunarc.calibration.solve.problem import Bins, FitProblem
from sunarc.calibration.start.multistart import SMALLEST_SIGMA_PX, distance_sigmas
from sunarc.common.array_types import FloatArray
from sunarc.common.robust_statistics import robust_sigma, tukey_loss

Name = TypeVar("Name")


class ComparedLens(NamedTuple):
    """Camera to be compared by evidence: the sightings of its fit, and the scales tried."""

    problem: FitProblem
    observed: Sightings
    unknowns: FloatArray
    grid: HyperparameterGrid


def compare_log_evidences(fits: Mapping[Name, FitState]) -> dict[Name, float]:
    """Return the log evidence of each finished fit of the same sightings over the best one's, 0 for the best."""
    lenses = {name: ComparedLens(one.problem, one.observed, one.unknowns, one.grid) for name, one in fits.items()}
    best = fits[closest(lenses)]
    return log_evidences(lenses, best.groups.bins, best.noise.information)


def closest(lenses: Mapping[Name, ComparedLens]) -> Name:
    """Return the name of the camera of the lowest robust cost, at one scale for all."""
    distances = {name: distance_sigmas(one.problem, one.observed, one.unknowns) for name, one in lenses.items()}
    sigma = min(robust_sigma(distance, floor=SMALLEST_SIGMA_PX) for distance in distances.values())
    return min(distances, key=lambda name: float(np.sum(tukey_loss(distances[name], sigma=sigma))))


@np.errstate(invalid="ignore", over="ignore")
def log_evidences(lenses: Mapping[Name, ComparedLens], bins: Bins, information: FloatArray) -> dict[Name, float]:
    """Return the log evidence of each over the best one's, the sightings of some information (n,), px⁻².

    It is over lens and pose (Laplace's approximation), the scales of the residual distortion, and those of the field.
    Minus infinity for all where none comes near the sightings.
    """
    found: dict[Name, float] = {}
    for name, (problem, observed, at, grid) in lenses.items():
        system = linear_system(problem, observed, bins, at, information=information, basis=grid.basis)
        value = log_evidence(log_weights(system.normal(), grid))
        found[name] = -math.inf if math.isnan(value) else value  # a camera may miss the sightings by 1e11 px
    best = max(found.values())
    return {name: value - best if math.isfinite(best) else value for name, value in found.items()}
