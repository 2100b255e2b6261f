"""Coverage of the stated covariance after a part of the first day: the arc from sunrise on, 2 to 9 hours long.

    OMP_NUM_THREADS=1 python docs/studies/part_day.py --lenses 16 [--hours H]… [--sigma PX]… [--field PX]…

Prints, for every case, the median over lenses of the true and of the stated error over the hemisphere (degrees, 1-sigma
per axis), the mean and the lowest quartile of the share of directions, spread evenly over the hemisphere, within the
stated 95 %, and the share of fits that their own verdict accepts. The sightings are 300 s apart.
"""

from __future__ import annotations

import argparse

import numpy as np
import population as pop
from coverage_statistics import CHI_SQUARE_95, squared_sigmas
from numpy.typing import NDArray

from sunarc.calibration.answers.covariance import hemisphere, project_with_covariance
from sunarc.calibration.calibrate import calibrate
from sunarc.calibration.model.sightings import Sightings
from sunarc.lab.simulation.truth import true_camera
from sunarc.optics.forward import local_stretch, project
from sunarc.sky.sun import sun_directions

FloatArray = NDArray[np.float64]


def one_lens(
    seed: int, *, hours: float, sigma_px: float, field_px: float, simulator: bool = False
) -> tuple[float, float, float, bool]:
    """Return the true and the stated error over the sky (degrees), the share covered, and the verdict."""
    rng = np.random.default_rng(seed)
    truth = true_camera(seed - 1000) if simulator else pop.random_camera(rng)
    count = round(hours * 12.0)
    times = pop.sun_track(np.zeros(1), cadence_s=300.0)[:count]
    field = pop.smooth_field(np.random.default_rng(seed), amplitude_px=field_px, length_px=425.0)

    def seen(directions: FloatArray) -> FloatArray:
        pixels = project(truth, directions)
        return np.asarray(pixels + field(pixels))

    pixels = seen(sun_directions(times, pop.SGP)) + rng.normal(0.0, sigma_px, (count, 2))
    points = Sightings.of(unix_s=times, pixels=pixels, clock_error_s=0.0)
    fit = calibrate(points, site=pop.SGP, image_size=(pop.SIZE, pop.SIZE))
    sky = hemisphere(1000)
    found, covariance = project_with_covariance(fit, sky)
    error = found - seen(sky)
    square = squared_sigmas(error, covariance)
    turned = np.linalg.solve(local_stretch(truth, sky), error[..., None])[..., 0]
    true_deg = float(np.degrees(np.sqrt(0.5 * np.nanmean(np.sum(turned**2, axis=-1)))))
    return true_deg, fit.sky_rms_deg, float(np.mean(square < CHI_SQUARE_95)), fit.verdict.accepted


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--lenses", type=int, default=16)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--hours", type=float, action="append")
    parser.add_argument("--sigma", type=float, action="append")
    parser.add_argument("--field", type=float, action="append")
    parser.add_argument("--simulator", action="store_true", help="the lenses of `sunarc simulate --lens-seed`")
    parser.add_argument("--verbose", action="store_true")
    chosen = parser.parse_args()
    print(f"{'hours':>6s}{'sigma':>7s}{'field':>7s}{'true':>9s}{'stated':>9s}{'cover':>8s}{'P25':>8s}{'served':>8s}")
    for hours in chosen.hours or (2.0, 4.0, 9.0):
        for sigma in chosen.sigma or (0.003, 0.03):
            for field in chosen.field or (0.0, 0.1, 0.3):
                seeds = range(1000 + chosen.first, 1000 + chosen.first + chosen.lenses)
                found = np.array(
                    [
                        one_lens(s, hours=hours, sigma_px=sigma, field_px=field, simulator=chosen.simulator)
                        for s in seeds
                    ]
                )
                if chosen.verbose:
                    print(np.round(found, 3))
                true, stated, cover, served = found.T
                print(
                    f"{hours:6.1f}{sigma:7.3f}{field:7.2f}{np.median(true):9.4f}{np.median(stated):9.4f}"
                    f"{np.mean(cover):8.3f}{np.quantile(cover, 0.25):8.3f}{np.mean(served):8.2f}",
                    flush=True,
                )


if __name__ == "__main__":
    main()
