"""The error over the whole sky, and how honest the stated covariance is, for random lenses.

    OMP_NUM_THREADS=1 python docs/studies/sky_error.py --lenses 30 [--case NAME]…

Prints, for every case, the median and the 90th percentile over lenses of the root mean square error of the forward
model over the hemisphere (px), the same on the sun's own track, and the mean 95 % coverage of the stated covariance:
over the sky, within 20 degrees of the track, and beyond 40 degrees from it; then the error over the sky of the same
cameras without the mean of the field, and the largest ratio of the error with to that without.
"""

from __future__ import annotations

import argparse
import time
from dataclasses import dataclass

import numpy as np
import population as pop
from coverage_statistics import CHI_SQUARE_95, degrees_from_track, every_so_many, squared_sigmas
from numpy.typing import NDArray

from sunarc.calibration.answers.covariance import hemisphere, project_with_covariance
from sunarc.calibration.calibrate import calibrate
from sunarc.calibration.model.options import CalibrationOptions
from sunarc.optics.forward import project

FloatArray = NDArray[np.float64]


@dataclass(frozen=True, slots=True, kw_only=True)
class Case:
    """What is simulated."""

    days: tuple[int, ...] = (0,)
    sigma_px: float = 0.5
    field_px: float = 0.0
    rho: float = 0.0
    cloud_sd_px: float = 0.0
    cloud_share: float = 0.0
    biased_share: float = 0.0
    cadence_s: float = 30.0


_FOUR = (0, 1, 20, 29)
_TEN = (0, 1, 9, 19, 20, 21, 25, 27, 28, 29)
_YEAR = tuple(range(0, 360, 6))

CASES = {
    "1 day": Case(),
    "4 days": Case(days=_FOUR),
    "10 days": Case(days=_TEN),
    "60 days": Case(days=_YEAR),
    "1 day, field": Case(field_px=0.3),
    "4 days, field": Case(days=_FOUR, field_px=0.3),
    "60 days, field": Case(days=_YEAR, field_px=0.3),
    "1 day, AR 0.9": Case(rho=0.9),
    "4 days, AR 0.9": Case(days=_FOUR, rho=0.9),
    "fine, 1 day": Case(sigma_px=0.03),
    "fine, 4 days": Case(sigma_px=0.03, days=_FOUR),
    "fine, 1 day, field": Case(sigma_px=0.03, field_px=0.3),
    "fine, 4 days, field": Case(sigma_px=0.03, days=_FOUR, field_px=0.3),
    "fine, 60 days, field": Case(sigma_px=0.03, days=_YEAR, field_px=0.3),
    "clouds, case 5": Case(sigma_px=0.43, cloud_sd_px=5.2, cloud_share=0.22, days=(25,)),
    "clouds, case 4": Case(sigma_px=0.43, cloud_sd_px=2.5, cloud_share=0.12, days=_TEN),
    "biased 40 %": Case(sigma_px=0.43, biased_share=0.4),
    "biased 50 %": Case(sigma_px=0.43, biased_share=0.5),
}


def noise_of(case: Case, rng: np.random.Generator, n: int) -> FloatArray:
    """Draw the noise of a case."""
    if case.rho > 0.0:
        return pop.correlated_noise(rng, n, case.sigma_px, case.rho)
    if case.cloud_share > 0.0:
        return pop.cloud_noise(rng, n, core_px=case.sigma_px, sd_px=case.cloud_sd_px, share=case.cloud_share)
    noise = pop.white_noise(rng, n, case.sigma_px)
    if case.biased_share > 0.0:
        return pop.biased_outliers(rng, noise, share=case.biased_share, offset_px=9.4)
    return noise


def one_lens(case: Case, seed: int, options: CalibrationOptions, verbose: bool) -> FloatArray:
    """Return sky error, track error, coverage (sky, near, far), and what `main` prints beside, of one lens."""
    rng = np.random.default_rng(seed)
    truth = pop.random_camera(rng)
    sun = pop.track(case.days, cadence_s=case.cadence_s)
    field = pop.smooth_field(rng, amplitude_px=case.field_px, length_px=425.0) if case.field_px > 0.0 else None
    noise = noise_of(case, rng, sun.unix_s.size)
    points = pop.sightings_of(truth, sun.unix_s, sun.directions, noise, field=field)
    begin = time.perf_counter()
    fit = calibrate(points, site=pop.SGP, image_size=(pop.SIZE, pop.SIZE), options=options)
    took = time.perf_counter() - begin
    sky, places = hemisphere(1000), every_so_many(sun.directions)
    found, covariance = project_with_covariance(fit, sky)
    expected = pop.seen_at(truth, sky, field)
    error = found - expected
    square = squared_sigmas(error, covariance)
    covered = square < CHI_SQUARE_95
    away = degrees_from_track(sky, places)
    on_track = project(fit.camera, places) - pop.seen_at(truth, places, field)
    stated = float(np.sqrt(np.mean(np.trace(covariance, axis1=1, axis2=2))))
    result = np.array(
        [
            _rms(error), _rms(on_track), covered.mean(), covered[away < 20.0].mean(), covered[away > 40.0].mean(),
            stated, took, fit.field.amplitude_px, _rms(project(fit.camera.lens_alone(), sky) - expected),
        ]
    )  # fmt: skip
    if verbose:
        said = f"A {fit.field.amplitude_px:.4f} L {fit.field.length_px:.0f} radial {fit.evidence.radial_px:.2f}"
        sigma = f"sigma {fit.evidence.sigma_px:.4f} inflation {fit.evidence.inflation:.2f}"
        print("   ", seed, np.round(result[:7], 4), said, sigma, fit.verdict.accepted, flush=True)
    return result


def _rms(error: FloatArray) -> float:
    return float(np.sqrt(np.nanmean(np.sum(error**2, axis=-1))))


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--lenses", type=int, default=30)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--case", action="append", choices=list(CASES))
    parser.add_argument("--verbose", action="store_true")
    chosen = parser.parse_args()
    heads = ("sky med", "P90", "track", "cover", "near", "far", "stated", "s", "field", "alone", "P90", "ratio")
    print(f"{'case':22s}" + "".join(f"{head:>8s}" for head in heads))
    for name in chosen.case or CASES:
        seeds = range(chosen.first, chosen.first + chosen.lenses)
        rows = np.array([one_lens(CASES[name], 1000 + s, CalibrationOptions(), chosen.verbose) for s in seeds])
        sky, track = np.median(rows[:, 0]), np.mean(rows[:, 1])
        cover = rows[:, 2:5].mean(axis=0)
        print(
            f"{name:22s}{sky:8.4f}{np.quantile(rows[:, 0], 0.9):8.4f}{track:8.4f}"
            + "".join(f"{share:8.3f}" for share in cover)
            + f"{np.median(rows[:, 5]):8.4f}{rows[:, 6].mean():8.2f}{np.sqrt(np.mean(rows[:, 7] ** 2)):8.3f}"
            + f"{np.median(rows[:, 8]):8.4f}{np.quantile(rows[:, 8], 0.9):8.4f}"
            + f"{np.max(rows[:, 0] / rows[:, 8]):8.3f}",
            flush=True,
        )


if __name__ == "__main__":
    main()
