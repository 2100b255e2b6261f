"""The solve with the field marginalised, in numpy: what the compiled steps are compared with."""

from __future__ import annotations

from sunarc.array_types import FloatArray
from sunarc.calibration.fit.marginal_likelihood import MarginalFit, Scales, marginal_fit, penalty
from sunarc.calibration.fit.normal_equations import LinearSystem
from sunarc.calibration.solve.problem import FitProblem

STEPS, HALVINGS, REST = 8, 6, 1e-3


def converged_reference(
    problem: FitProblem, system: LinearSystem, scales: Scales
) -> tuple[FloatArray, MarginalFit, float]:
    """Return the unknowns, the linear fit and the gain that `irls_converged` returns."""
    normal = system.normal()
    now = begin = penalty(normal, system.basis, scales)
    for _ in range(STEPS):
        best = marginal_fit(normal, system.basis, scales)
        if best.gain < REST:
            break
        step, gain = best.unknowns - system.at, 0.0
        for halving in range(HALVINGS):
            trial = system.moved(problem, system.at + 0.5**halving * step)
            trial_normal = trial.normal()
            gain = now - penalty(trial_normal, system.basis, scales)
            if gain > 0.0:
                system, normal, now = trial, trial_normal, now - gain
                break
        if gain < REST:
            break
    return system.at, marginal_fit(normal, system.basis, scales), begin - now
