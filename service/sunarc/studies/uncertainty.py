"""The paper's Figs. 4 and 5 made again: how an arc's noise becomes an error of the calibration."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from sunarc.array_types import FloatArray
from sunarc.calibration.model.options import Method
from sunarc.simulation.truth import true_camera
from sunarc.studies.bound import cramer_rao_bound
from sunarc.studies.trials import QUANTITIES, Trial, run_trials, synthetic_arc

Row = dict[str, str | int | float]

LARGEST_SIGMA_PX = 10.0
QUANTILES: Mapping[str, float] = {"p05": 0.05, "p25": 0.25, "median": 0.5, "p75": 0.75, "p95": 0.95}


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Uncertainty:
    """What the trials came to.

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
) -> Uncertainty:
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
    return Uncertainty(
        methods=tuple(methods), sigma_px=sigmas, seed=seed, trials=dict(zip(methods, results, strict=True)), bound=bound
    )


def true_values() -> FloatArray:
    """Return the truth of `QUANTITIES`: no error, and the true camera's parameters."""
    truth = true_camera(0)
    return np.array([0.0, 0.0, *truth.focal_length_px, *truth.principal_point_px])


def distribution_rows(study: Uncertainty) -> list[Row]:
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


def trial_rows(study: Uncertainty) -> list[Row]:
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
