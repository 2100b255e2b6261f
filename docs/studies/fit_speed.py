"""What a fit costs, and the solver beside scipy's least squares: the same start, residuals and priors.

    OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 python docs/studies/fit_speed.py [--repeats 5]

Prints processor milliseconds (the least of the repeats) of whole calls of `calibrate` for one and ten days: by both
methods, projection and handedness being stated, and by the robust one where neither is. Then those of the solver alone
with the ratio to scipy's with numeric and with analytic derivatives, and by how many px the answers differ.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np
import population as pop
from numpy.typing import NDArray
from scipy.optimize import least_squares

from sunarc.calibration.calibrate import calibrate
from sunarc.calibration.fit.marginal_likelihood import prior_precision
from sunarc.calibration.model.options import CalibrationOptions, ImageCircle
from sunarc.calibration.model.sightings import Sightings, filter_sightings
from sunarc.calibration.solve.levenberg_marquardt import most_probable
from sunarc.calibration.solve.priors import lens_prior
from sunarc.calibration.solve.problem import problem_for
from sunarc.imager.runtime.child_process import keep_freed_memory
from sunarc.optics.camera import Camera

FloatArray = NDArray[np.float64]

_TEN = (0, 1, 9, 19, 20, 21, 25, 27, 28, 29)
_SIGMA_PX = 0.5


def cost_ms(work: Callable[[], object], repeats: int) -> float:
    """Return the least processor time of some calls after a first one, ms."""
    work()
    found = []
    for _ in range(repeats):
        began = time.process_time()
        work()
        found.append(time.process_time() - began)
    return 1e3 * min(found)


def drawn(days: tuple[int, ...]) -> tuple[Camera, Sightings, ImageCircle]:
    """Return a camera, its sightings on days, and the image circle as it would be found."""
    rng = np.random.default_rng(5)
    camera = pop.random_camera(rng)
    times = pop.sun_track(np.array(days, dtype=np.float64))
    points = pop.sightings(camera, times, pop.white_noise(rng, times.size, _SIGMA_PX))
    x, y = camera.principal_point_px
    return camera, points, ImageCircle(x=x + 1.0, y=y - 1.0, radius=camera.focal_length_px[0] * np.sqrt(2.0) + 1.5)


def whole_fits(repeats: int) -> None:
    """Print what `calibrate` costs."""
    for days in ((0,), _TEN):
        camera, points, circle = drawn(days)
        stated = CalibrationOptions(projection=camera.projection, mirrored="no")
        asked = {"robust": stated, "paper": replace(stated, method="paper"), "nothing stated": CalibrationOptions()}
        for name, options in asked.items():
            fit = partial(
                calibrate, points, site=pop.SGP, image_size=(pop.SIZE, pop.SIZE), options=options, circle=circle
            )
            took = cost_ms(fit, repeats)
            print(f"{name:16s}{len(days):3d} days {len(points):6d} sightings {took:8.0f} ms", flush=True)


def solver_alone(repeats: int) -> None:
    """Print what the solver costs beside scipy's."""
    camera, points, circle = drawn((0,))
    seen = filter_sightings(points, site=pop.SGP)
    seen = replace(seen, information=seen.information / _SIGMA_PX**2)
    prior = lens_prior(camera, tolerances=CalibrationOptions().tolerances, circle=circle, field_angle=np.pi / 2)
    problem = problem_for(camera, prior, n_epochs=1)
    precision = prior_precision(problem.size, 2.0, 0.7)
    start = problem.unknowns([camera]) + 0.01
    root = np.sqrt(np.repeat(seen.information, 2))

    def misfit(at: FloatArray) -> FloatArray:
        return np.concatenate([-root * problem.residuals(at, seen).ravel(), np.sqrt(precision) * at])

    def slopes(at: FloatArray) -> FloatArray:
        rows = problem.linearised(at, seen)[1].reshape(-1, problem.size)
        return np.concatenate([root[:, None] * rows, np.diag(np.sqrt(precision))])

    def solved() -> FloatArray:
        return most_probable(problem, seen, start, precision=precision, tolerance=1e-12).unknowns

    ours = cost_ms(solved, repeats)
    print(f"solver alone {ours:8.2f} ms")
    for name, jac in (("numeric", "2-point"), ("analytic", slopes)):
        scipys = partial(least_squares, misfit, start, jac=jac, method="lm", x_scale="jac", ftol=1e-12)  # type: ignore[arg-type]
        took = cost_ms(scipys, repeats)
        off = problem.residuals(scipys().x, seen) - problem.residuals(solved(), seen)
        print(f"scipy, {name:8s}{took:10.2f} ms, {took / ours:6.1f} times, {np.max(np.abs(off)):.1e} px apart")


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--repeats", type=int, default=5)
    repeats = parser.parse_args().repeats
    keep_freed_memory()  # as the process of a refit does
    whole_fits(repeats)
    solver_alone(repeats)


if __name__ == "__main__":
    main()
