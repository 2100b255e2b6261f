"""Simulation-based calibration: how far truths from the prior are from fits, in units of the stated covariance.

    OMP_NUM_THREADS=1 python docs/studies/ranks.py --lenses 60 [--case NAME]… [--jobs 2]

Every lens has a field or none as the fit's own prior has it: none in 6 of 10, else an amplitude of 0.3 px within a
factor of 3 (log-normal, bounded at 1.5 px), and a length of 0.16 to 0.36 of the image. u is the smallest share for
which what is stated holds the error of a direction's pixel; it is uniform from 0 to 1 where the statement is right.
Printed for every case: the share of the sky in each tenth of u (0.10 expected), the share below 0.95 (the coverage),
and its 95 % interval by bootstrap over lenses. Reference: S. Talts et al., "Validating Bayesian inference algorithms
with simulation-based calibration", arXiv 1804.06788.
"""

from __future__ import annotations

import argparse
import math
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from typing import NamedTuple

import numpy as np
import population as pop
from coverage_statistics import bootstrap_interval, within_stated
from numpy.typing import NDArray

from sunarc.calibration.answers.covariance import hemisphere, project_with_covariance
from sunarc.calibration.calibrate import calibrate
from sunarc.calibration.model.options import CalibrationOptions

FloatArray = NDArray[np.float64]

_NO_FIELD, _USUAL_PX, _FACTOR, _LARGEST_PX = 0.6, 0.3, 3.0, 1.5
FIELD_LENGTHS = (0.16, 0.36)
"""Of the fields, as shares of the image."""
_SKY = hemisphere(400)
_SHARES = (0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 0.95)


class Case(NamedTuple):
    """Days of sightings, and their noise."""

    days: tuple[int, ...]
    sigma_px: float


CASES = {
    "0.5 px, 1 day": Case((0,), 0.5),
    "0.5 px, 4 days": Case((0, 1, 20, 29), 0.5),
    "0.5 px, 3 days in a row": Case((0, 1, 2), 0.5),
    "0.1 px, 1 day": Case((0,), 0.1),
    "0.03 px, 1 day": Case((0,), 0.03),
    "0.03 px, 4 days": Case((0, 1, 20, 29), 0.03),
}


def amplitude_px(rng: np.random.Generator) -> float:
    """Draw the amplitude of a field from the fit's prior; 0 for none."""
    if rng.uniform() < _NO_FIELD:
        return 0.0
    while True:
        drawn = _USUAL_PX * math.exp(math.log(_FACTOR) * rng.normal())
        if rng.uniform() < math.exp(-0.5 * (drawn / _LARGEST_PX) ** 2):
            return drawn


def ranks(seed: int, case: Case) -> FloatArray:
    """Return (10,): of the sky of one lens, what lies within the stated `_SHARES`."""
    rng = np.random.default_rng([seed, 2026])
    amplitude, length = amplitude_px(rng), pop.SIZE * math.exp(rng.uniform(*np.log(FIELD_LENGTHS)))
    truth = pop.random_camera(rng)
    sun = pop.track(case.days)
    field = pop.smooth_field(rng, amplitude_px=amplitude, length_px=length) if amplitude else None
    noise = pop.white_noise(rng, sun.unix_s.size, case.sigma_px)
    points = pop.sightings_of(truth, sun.unix_s, sun.directions, noise, field=field)
    fit = calibrate(
        points, site=pop.SGP, image_size=(pop.SIZE, pop.SIZE), options=CalibrationOptions(level_within_deg=60.0)
    )
    found, covariance = project_with_covariance(fit, _SKY)
    error = found - pop.seen_at(truth, _SKY, field)
    return np.asarray(within_stated(fit, found, error, covariance, _SHARES).mean(axis=0))


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--lenses", type=int, default=60)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--case", action="append", choices=list(CASES))
    parser.add_argument("--jobs", type=int, default=1)
    chosen = parser.parse_args()
    print("| case | share of the sky by tenths of u | coverage (interval) |\n|---|---|---|")
    for name in chosen.case or CASES:
        with ProcessPoolExecutor(chosen.jobs) as pool:
            seeds = range(chosen.first, chosen.first + chosen.lenses)
            found = np.array(list(pool.map(partial(ranks, case=CASES[name]), seeds)))
        tenths = np.diff(np.r_[0.0, found[:, :9].mean(axis=0), 1.0])
        covered = found[:, 9]
        low, high = bootstrap_interval(covered)
        shares = " ".join(f"{share:.2f}" for share in tenths)
        print(f"| {name} | {shares} | {covered.mean():.3f} ({low:.3f} to {high:.3f}) |", flush=True)


if __name__ == "__main__":
    main()
