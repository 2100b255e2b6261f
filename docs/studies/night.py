"""The error over the whole sky of one clear day, and of the same day with one clear night.

    OMP_NUM_THREADS=1 python docs/studies/night.py --lenses 24 [--field 0.3]

The day's calibration (one clear day, 0.03 px) predicts the stars of the night; what is matched goes with the day's
sightings into the second fit. Prints the median and the 90th percentile over lenses of the root mean square error over
the hemisphere (px, of the prediction, the lens's unmodelled field included), its median and 90th percentile over the
sky, and how much of the sky lies within the stated 95 % (south and north halves).
"""

from __future__ import annotations

import argparse

import nights
import numpy as np
import population as pop
from coverage_statistics import CHI_SQUARE_95, squared_sigmas
from numpy.typing import NDArray

from sunarc.calibration import (
    Calibration,
    CalibrationOptions,
    SunPoints,
    calibrate,
    hemisphere,
    project_with_covariance,
)
from sunarc.detection.stars.matching import match_stars
from sunarc.optics import Camera, project
from sunarc.sky import NightSky

FloatArray = NDArray[np.float64]


def fitted(points: SunPoints) -> Calibration:
    """Return the fit of sightings by one who knows the projection."""
    return calibrate(points, site=pop.SGP, image_size=(pop.SIZE, pop.SIZE), options=CalibrationOptions())


def stars_of(
    rng: np.random.Generator, camera: Camera, day: Calibration, night: nights.Night, moments: FloatArray
) -> SunPoints:
    """Return the stars of a night, matched with what the day's calibration predicts."""
    times, pixels, sigma, directions = [], [], [], []
    for when in moments:
        sky: NightSky = nights.sky_of(float(when))
        stars, _ = nights.detections(rng, camera, sky, night)
        expected = nights.predicted(day, float(when))
        matched = match_stars(stars, expected)
        place = {str(name): row for row, name in enumerate(sky.names)}
        times.append(np.full(matched.star.size, when))
        pixels.append(stars.pixels[matched.detection])
        sigma.append(stars.sigma_px[matched.detection])
        directions.append(sky.directions[[place[str(expected.names[row])] for row in matched.star]].reshape(-1, 3))
    return SunPoints(
        unix_s=np.concatenate(times),
        pixels=np.concatenate(pixels),
        sigma_px=np.concatenate(sigma),
        directions=np.concatenate(directions),
    )


def together(first: SunPoints, second: SunPoints) -> SunPoints:
    """Return both."""
    names = ("unix_s", "pixels", "sigma_px", "directions")
    return SunPoints(**{name: np.concatenate([getattr(first, name), getattr(second, name)]) for name in names})


def error_of(fit: Calibration, camera: Camera, field: pop.Field | None) -> FloatArray:
    """Return rms, median and P90 of the error over the sky (px), and the coverage south and north."""
    sky = hemisphere(1000)
    truth = project(camera, sky)
    truth = truth if field is None else truth + field(truth)
    pixels, covariance = project_with_covariance(fit, sky)
    error = pixels - truth
    covered = squared_sigmas(error, covariance) < CHI_SQUARE_95
    size = np.linalg.norm(error, axis=-1)
    north = sky[:, 1] > 0.0
    return np.array(
        [
            np.sqrt(np.mean(size**2)), np.median(size), np.quantile(size, 0.9), covered[~north].mean(),
            covered[north].mean(),
        ]
    )  # fmt: skip


def one_lens(seed: int, asked: argparse.Namespace) -> tuple[FloatArray, FloatArray, int]:
    """Return the errors of the day alone and with the night, and how many stars were matched."""
    rng = np.random.default_rng(seed)
    camera = pop.random_camera(rng)
    field = pop.smooth_field(rng, amplitude_px=asked.field, length_px=425.0) if asked.field else None
    times = pop.sun_track(np.arange(asked.days, dtype=float) * 9.0, cadence_s=30.0)
    sun = pop.sightings(camera, times, pop.white_noise(rng, times.size, 0.03), field=field)
    sun = SunPoints(unix_s=sun.unix_s, pixels=sun.pixels, sigma_px=np.full(times.size, 0.03))
    day = fitted(sun)
    moments = nights.MIDNIGHT + 3600.0 * (np.arange(asked.frames) - (asked.frames - 1) / 2.0)
    stars = stars_of(rng, camera, day, nights.Night(sigma_px=asked.star_sigma, field=field), moments)
    if asked.stars < len(stars):
        stars = stars.select(rng.permutation(len(stars))[: asked.stars])
    both = fitted(together(sun, stars)) if len(stars) else day
    return error_of(day, camera, field), error_of(both, camera, field), len(stars)


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(prog="night.py", description=__doc__)
    parser.add_argument("--lenses", type=int, default=24)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--days", type=int, default=1)
    parser.add_argument("--frames", type=int, default=6, help="images of the night, an hour apart")
    parser.add_argument("--stars", type=int, default=150, help="of those matched, at random")
    parser.add_argument("--star-sigma", type=float, default=0.1, help="px, of a star of V 3")
    parser.add_argument("--field", type=float, default=0.0, help="px, of the lens, that no model knows")
    asked = parser.parse_args()
    rows = [one_lens(seed, asked) for seed in range(asked.first, asked.first + asked.lenses)]
    print(f"{asked.days} day(s), field {asked.field} px, stars {np.median([row[2] for row in rows]):.0f}")
    print("              rms: median, P90     over the sky: median, P90    within 95 %: south, north")
    for name, column in (("day", 0), ("day and night", 1)):
        found = np.array([row[column] for row in rows])
        rms, south, north = found[:, 0], found[:, 3].mean(), found[:, 4].mean()
        print(
            f"{name:14s}{np.median(rms):8.4f} {np.quantile(rms, 0.9):8.4f}"
            f"{np.median(found[:, 1]):12.4f} {np.median(found[:, 2]):8.4f} {south:18.3f} {north:8.3f}"
        )


if __name__ == "__main__":
    main()
