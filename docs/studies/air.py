"""Coverage of the stated covariance where the air is not the one assumed: sightings in 35 or -5 °C, 12 °C assumed.

    OMP_NUM_THREADS=1 python docs/studies/air.py --lenses 16 [--days N]… [--sigma PX]… [--true-air C]… [--measured]

Prints, for every case, the median over lenses of the root mean square error of the camera over the hemisphere (px), the
median of what is stated, and the mean share of directions, spread evenly over the hemisphere, within the stated 95 %.
With `--measured` the fit is given the temperature of the air. With `--daily K` the temperature also scatters from day
to day with that standard deviation.
"""

from __future__ import annotations

import argparse
from dataclasses import replace

import numpy as np
import population as pop
from coverage_statistics import CHI_SQUARE_95, squared_sigmas
from numpy.typing import NDArray

from sunarc.calibration.answers.covariance import hemisphere, project_with_covariance
from sunarc.calibration.calibrate import calibrate
from sunarc.calibration.model.sightings import Sightings
from sunarc.optics.forward import project
from sunarc.sky.sun import sun_directions

FloatArray = NDArray[np.float64]

_DAYS = {1: (0,), 2: (0, 1), 4: (0, 1, 20, 29), 10: (0, 1, 9, 19, 20, 21, 25, 27, 28, 29)}


def one_lens(
    seed: int, *, days: int, sigma_px: float, temperature: float, daily_k: float = 0.0, measured: bool = False
) -> tuple[float, float, float]:
    """Return the true and the stated error over the sky (px) and the share of the sky within the stated 95 %."""
    rng = np.random.default_rng(seed)
    truth = pop.random_camera(rng)
    pixels, times, air = [], [], []
    for day in _DAYS[days]:
        track = pop.sun_track(np.array([float(day)]), cadence_s=120.0)
        degrees = temperature + daily_k * rng.standard_normal()
        seen = project(truth, sun_directions(track, replace(pop.SGP, temperature=degrees)))
        pixels.append(seen + rng.normal(0.0, sigma_px, seen.shape))
        times.append(track)
        air.append(np.full(track.size, degrees))
    known = {"temperature": np.concatenate(air)} if measured else {}
    points = Sightings.of(unix_s=np.concatenate(times), pixels=np.concatenate(pixels), clock_error_s=0.0, **known)
    fit = calibrate(points, site=pop.SGP, image_size=(pop.SIZE, pop.SIZE))
    sky = hemisphere(1000)
    found, covariance = project_with_covariance(fit, sky)
    error = found - project(truth, sky)
    square = squared_sigmas(error, covariance)
    stated = float(np.sqrt(np.mean(np.trace(covariance, axis1=1, axis2=2))))
    return float(np.sqrt(np.mean(np.sum(error**2, axis=-1)))), stated, float(np.mean(square < CHI_SQUARE_95))


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--lenses", type=int, default=16)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--days", type=int, action="append", choices=list(_DAYS))
    parser.add_argument("--sigma", type=float, action="append")
    parser.add_argument("--true-air", type=float, action="append")
    parser.add_argument("--daily", type=float, default=0.0)
    parser.add_argument("--measured", action="store_true")
    chosen = parser.parse_args()
    print(f"{'sigma':>6s}{'air':>6s}{'days':>6s}{'sky':>9s}{'stated':>9s}{'cover':>8s}{'worst':>8s}")
    for sigma in chosen.sigma or (0.03, 0.4):
        for temperature in chosen.true_air or (12.0, 35.0, -5.0):
            for days in chosen.days or _DAYS:
                found = [
                    one_lens(
                        seed,
                        days=days,
                        sigma_px=sigma,
                        temperature=temperature,
                        daily_k=chosen.daily,
                        measured=chosen.measured,
                    )
                    for seed in range(1000 + chosen.first, 1000 + chosen.first + chosen.lenses)
                ]
                error, stated, cover = np.array(found).T
                print(
                    f"{sigma:6.2f}{temperature:6.0f}{days:6d}{np.median(error):9.4f}{np.median(stated):9.4f}"
                    f"{np.mean(cover):8.3f}{np.min(cover):8.3f}",
                    flush=True,
                )


if __name__ == "__main__":
    main()
