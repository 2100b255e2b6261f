"""The valleys of the decentering: (p1, p2) × (1, p3, p4) is a product, and one sign of it hides the other.

From p = 0 a fit cannot feel p3 and p4, and walks into the valley that lies nearest, which is often not the deepest. So
the higher coefficients are held at several places in turn, the rest is solved, and the best two are let go.
"""

from __future__ import annotations

import itertools

import numpy as np

from sunarc.array_types import FloatArray
from sunarc.calibration.least_squares.priors import DECENTERING, HIGHER
from sunarc.calibration.least_squares.problem import Observations, Problem
from sunarc.calibration.least_squares.solve import most_probable

_STARTS = tuple(itertools.product((-1.5, 1.5), (-2.0, 0.0, 2.0)))
_LET_GO = 2


def best_of_starts(problem: Problem, observed: Observations, start: FloatArray, *, precision: FloatArray) -> FloatArray:
    """Return the unknowns at the bottom of the deepest valley that was found.

    Parameters
    ----------
    problem : the camera sought.
    observed : sightings with their information, outliers gone.
    start : unknowns near the truth but for the decentering.
    precision : prior precisions of the unknowns.
    """
    free = np.ones(problem.size, dtype=bool)
    free[HIGHER] = False
    tried = [most_probable(problem, observed, start, precision=precision, iterations=15)]
    for decentering in _STARTS:
        at = start.copy()
        at[DECENTERING] = 0.0
        at[HIGHER] = decentering
        tried.append(most_probable(problem, observed, at, precision=precision, free=free, iterations=4, tolerance=1e-4))
    promising = sorted(tried[1:], key=lambda one: one.cost)[:_LET_GO]
    freed = [most_probable(problem, observed, one.unknowns, precision=precision, iterations=15) for one in promising]
    return min([tried[0], *freed], key=lambda one: one.cost).unknowns
