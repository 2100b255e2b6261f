"""The error over the whole sky of clear days, and of the same days with clear nights.

    OMP_NUM_THREADS=1 python docs/studies/night.py --lenses 24 [--days 4] [--field 0.3] [--case usual drawn bent]

The day's calibration (0.03 px) predicts the stars of the night, they are matched, and 150 of them are chosen as the
service does; both go into the second fit. Stars are displaced outwards by coma (0.13 px at the edge), as the rendered
ones are. Prints the median over lenses of the root mean square, the median and the 90th percentile over the sky of the
error (px, of the prediction, the lens's unmodelled field included), how much of the sky lies within the stated 95 %
(south and north), and of how many lenses the error with stars is more than 1.1 times that without.
"""

from __future__ import annotations

import argparse
import dataclasses
import functools
from typing import Any, NamedTuple

import nights
import numpy as np
import population as pop
from coverage_statistics import CHI_SQUARE_95, bootstrap_interval, squared_sigmas
from numpy.typing import NDArray

from sunarc.calibration.answers.covariance import hemisphere, project_with_covariance
from sunarc.calibration.calibrate import calibrate
from sunarc.calibration.fit.effects import DECENTRED_PX, OFFSET_PX, POSE_DIFFERENCE_DEG
from sunarc.calibration.fit.marginal_likelihood import DECENTERING_LOG_SIGMA, RADIAL_LOG_SIGMA
from sunarc.calibration.model.options import CalibrationOptions
from sunarc.calibration.model.result import Calibration
from sunarc.calibration.model.sightings import Kind, Sightings
from sunarc.calibration.selection import MOST_STARS, image_parts, pick_surest_in_parts
from sunarc.calibration.solve.priors import LENS, N_LENS, Whitened, lens_prior, precisions
from sunarc.common.array_types import stacked
from sunarc.detection.stars.matching import match_stars
from sunarc.optics.camera import PRINCIPAL_POINT, Camera
from sunarc.optics.forward import project
from sunarc.sky.days import solar_days
from sunarc.sky.night import NightSky
from sunarc.sky.refraction import ASSUMED_AIR_SD, DAILY_AIR_SD, raised, refraction_rad
from sunarc.sky.sun import sun_directions

FloatArray = NDArray[np.float64]
_IMAGE = (pop.SIZE, pop.SIZE)
_BENT_PX, _MOST_A_FRAME = 1.0, 30
"""As the worker of the night has them."""
_DAYS_APART = 9.0
_SEASON_S = 91.0 * 86_400.0
_FIRST_DAY = int(solar_days(np.array([pop.MAY_13]), longitude=0.0)[0]) - 2


class Case(NamedTuple):
    """What a night does that the day does not: see `nights.Night`.

    Moments are shifted by `late_s`; `wrong` of the matches are, by 1 to 10 px; `south`: no stars in the north.
    `drawn`: the lens, coma, bending and refraction are drawn as the fit's priors have them (decision 0009 for the air).
    """

    night: dict[str, Any]
    late_s: float = 0.0
    wrong: float = 0.0
    south: bool = False
    drawn: bool = False


CASES = {
    "usual": Case({}),
    "drawn": Case({}, drawn=True),
    "without coma": Case({"coma_px": 0.0}),
    "bent": Case({"bent_deg": 0.03}),
    "bent far": Case({"bent_deg": 0.15}),
    "twice the coma": Case({"coma_px": 0.26}),
    "decentred coma": Case({"coma_px": 0.13, "coma_decentred": 0.5}),
    "2 % wrong": Case({}, wrong=0.02),
    "20 % wrong": Case({}, wrong=0.2),
    "south half": Case({}, south=True),
    "three months later": Case({}, late_s=_SEASON_S),
    "twice the stated noise": Case({"noise_factor": 2.0}),
    "clock 20 s late": Case({"clock_s": 20.0}),
}


class Air:
    """Error of the assumed refraction, as in decision 0009: a share of all days, and one of each."""

    def __init__(self, rng: np.random.Generator, *, drawn: bool) -> None:
        self._common = ASSUMED_AIR_SD * rng.standard_normal() if drawn else 0.0
        self._daily = DAILY_AIR_SD * rng.standard_normal(400) if drawn else np.zeros(400)

    def raised(self, directions: FloatArray, unix_s: FloatArray) -> FloatArray:
        """Return directions (n, 3) as they are in this air."""
        day = solar_days(unix_s, longitude=pop.SGP.longitude) - _FIRST_DAY
        return raised(directions, refraction_rad(directions, pop.SGP) * (self._common + self._daily[day]))


def fitted(points: Sightings) -> Calibration:
    """Return the fit of sightings by one who knows the projection."""
    return calibrate(points, site=pop.SGP, image_size=_IMAGE, options=CalibrationOptions())


def stars_of(
    rng: np.random.Generator,
    camera: Camera,
    day: Calibration,
    moments: FloatArray,
    *,
    night: nights.Night,
    air: Air,
    case: Case,
) -> Sightings:
    """Return the stars of nights, matched with what the day's calibration predicts, the surest of each image."""
    times, pixels, sigma, directions = [], [], [], []
    for when in moments:
        sky: NightSky = nights.sky_of(float(when))
        here = dataclasses.replace(night, raised=functools.partial(air.raised, unix_s=np.full(1, when)))
        stars, _ = nights.detections(rng, camera, sky, here)
        expected = nights.predicted(day, float(when), within_px=_BENT_PX)
        matched = match_stars(stars, expected)
        place = {str(name): row for row, name in enumerate(sky.names)}
        toward = sky.directions[[place[str(expected.names[row])] for row in matched.star]].reshape(-1, 3)
        shown = toward[:, 1] < 0.0 if case.south else np.ones(len(toward), dtype=bool)
        found = stars.select(matched.detection[shown])
        chosen = pick_surest_in_parts(image_parts(found.pixels, _IMAGE), found.sigma_px, _MOST_A_FRAME)
        wrong = rng.uniform(size=chosen.size) < case.wrong
        angle, far = rng.uniform(0.0, 2.0 * np.pi, chosen.size), rng.uniform(1.0, 10.0, chosen.size) * wrong
        times.append(np.full(chosen.size, when))
        pixels.append(found.pixels[chosen] + far[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=-1))
        sigma.append(found.sigma_px[chosen])
        directions.append(toward[shown][chosen])
    return Sightings.of(
        unix_s=np.concatenate(times),
        pixels=np.concatenate(pixels),
        sigma_px=np.concatenate(sigma),
        directions=np.concatenate(directions),
        kind=np.full(sum(map(len, times)), Kind.STAR),
        clock_error_s=0.0,
    )


def detected(camera: Camera, times: FloatArray, noise: FloatArray, *, field: pop.Field | None, air: Air) -> Sightings:
    """Return the sun's sightings."""
    pixels = project(camera, air.raised(sun_directions(times, pop.SGP), times))
    pixels = pixels if field is None else pixels + field(pixels)
    return Sightings.of(unix_s=times, pixels=pixels + noise, sigma_px=np.full(times.size, 0.03), clock_error_s=0.0)


def together(first: Sightings, second: Sightings) -> Sightings:
    """Return both."""
    return stacked([first, second])


def error_of(fit: Calibration, camera: Camera, field: pop.Field | None) -> FloatArray:
    """Return rms, median and P90 of the error over the sky (px), the coverage south and north, and the stated rms.

    Of what both the true camera and the one found answer: at the horizon the radius of a lens may no longer grow.
    """
    sky = hemisphere(1000)
    sky = sky[np.isfinite(project(camera, sky)[:, 0] + project(fit.camera, sky)[:, 0])]
    truth = project(camera, sky)
    truth = truth if field is None else truth + field(truth)
    pixels, covariance = project_with_covariance(fit, sky)
    error = pixels - truth
    covered = squared_sigmas(error, covariance) < CHI_SQUARE_95
    size = np.linalg.norm(error, axis=-1)
    north = sky[:, 1] > 0.0
    stated = np.sqrt(np.trace(covariance, axis1=-2, axis2=-1).mean())
    return np.array(
        [
            np.sqrt(np.mean(size**2)), np.median(size), np.quantile(size, 0.9), covered[~north].mean(),
            covered[north].mean(), stated,
        ]
    )  # fmt: skip


def prior_lens(rng: np.random.Generator, camera: Camera) -> Camera:
    """Return a camera of the same pose, centre and focal length, all else of the lens drawn as the fit's prior has it.

    The scales of the radial distortion and of the decentering are log-normal about their tolerances.
    """
    tolerances = CalibrationOptions().tolerances
    prior = lens_prior(camera, tolerances=tolerances, circle=None, field_angle=np.pi / 2)
    radial = tolerances.radial_px * np.exp(RADIAL_LOG_SIGMA * rng.standard_normal())
    decentering = tolerances.decentering_px * np.exp(DECENTERING_LOG_SIGMA * rng.standard_normal())
    z = rng.standard_normal(N_LENS) / np.sqrt(precisions(radial, decentering))
    z[[Whitened.FOCAL_LENGTH, Whitened.CENTER_X, Whitened.CENTER_Y]] = 0.0
    vector = camera.to_vector()
    vector[LENS] = prior.lens(z)
    vector[PRINCIPAL_POINT] = camera.principal_point_px
    return camera.replace_parameters(vector)


class Truth(NamedTuple):
    """A lens, what no model of it knows, its air and its days, and the fit of these alone."""

    camera: Camera
    field: pop.Field | None
    air: Air
    sun: Sightings
    day: Calibration


@functools.lru_cache(maxsize=2)
def truth_of(seed: int, *, days: int, field_px: float, drawn: bool) -> Truth:
    """Return a lens and its days; the same pose, field and noise whether lens and air are drawn or not."""
    rng = np.random.default_rng(seed)
    camera = pop.random_camera(rng)
    if drawn:
        camera = prior_lens(np.random.default_rng((seed, 3)), camera)
    field = pop.smooth_field(rng, amplitude_px=field_px, length_px=425.0) if field_px else None
    times = pop.sun_track(np.arange(days, dtype=float) * _DAYS_APART, cadence_s=30.0)
    air = Air(np.random.default_rng((seed, 1)), drawn=drawn)
    sun = detected(camera, times, pop.white_noise(rng, times.size, 0.03), field=field, air=air)
    return Truth(camera, field, air, sun, fitted(sun))


def night_of(truth: Truth, seed: int, asked: argparse.Namespace, case: Case) -> Sightings:
    """Return the stars of a lens's nights that its second fit is given."""
    hours = np.arange(asked.frames) - (asked.frames - 1) / 2.0
    nightly = np.arange(asked.days, dtype=float)[:, None] * _DAYS_APART * 86_400.0
    moments = nights.MIDNIGHT + case.late_s + (nightly + 3600.0 * hours).ravel()
    rng = np.random.default_rng((seed, 2))
    drawn: dict[str, Any] = {}
    if case.drawn:
        drawn = {
            "coma_px": 0.0,
            "offset_px": OFFSET_PX * rng.standard_normal(3),
            "decentred_px": DECENTRED_PX * rng.standard_normal(2),
            "bent_deg": POSE_DIFFERENCE_DEG * np.linalg.norm(rng.standard_normal(3)),
        }
    night = nights.Night(sigma_px=asked.star_sigma, field=truth.field, **{**drawn, **case.night})
    stars = stars_of(rng, truth.camera, truth.day, moments, night=night, air=truth.air, case=case)
    if asked.stars < len(stars):
        stars = stars.select(pick_surest_in_parts(image_parts(stars.pixels, _IMAGE), stars.sigma_px, asked.stars))
    return stars


def one_lens(seed: int, asked: argparse.Namespace, case: Case) -> tuple[FloatArray, FloatArray, str]:
    """Return the errors of the days alone and with the nights, and what the second fit says."""
    truth = truth_of(seed, days=asked.days, field_px=asked.field, drawn=case.drawn)
    stars = night_of(truth, seed, asked, case)
    both = fitted(together(truth.sun, stars)) if len(stars) else truth.day
    left_out = [one.text for one in both.verdict.findings if one.code == "night_contradicts_day"]
    said = f"{len(stars)} stars of {np.sqrt(np.mean(stars.sigma_px**2)):.3f} px; {left_out or both.night}"
    return error_of(truth.day, truth.camera, truth.field), error_of(both, truth.camera, truth.field), said


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(prog="night.py", description=__doc__)
    parser.add_argument("--lenses", type=int, default=24)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--days", type=int, default=1, help="and nights, 9 days apart")
    parser.add_argument("--frames", type=int, default=8, help="images of a night, an hour apart")
    parser.add_argument("--stars", type=int, default=MOST_STARS, help="of those stored, as the service chooses them")
    parser.add_argument("--star-sigma", type=float, default=0.1, help="px, of a star of V 3")
    parser.add_argument("--field", type=float, default=0.0, help="px, of the lens, that no model knows")
    parser.add_argument("--case", choices=CASES, nargs="+", default=["usual"])
    parser.add_argument("--each", action="store_true", help="print every lens")
    asked = parser.parse_args()
    rows: dict[str, list[tuple[FloatArray, FloatArray, str]]] = {name: [] for name in asked.case}
    for seed in range(asked.first, asked.first + asked.lenses):
        for name, found in rows.items():
            found.append(one_lens(seed, asked, CASES[name]))
            if asked.each:
                for error in found[-1][:2]:
                    print(name, seed, " ".join(f"{value:.4f}" for value in error))
                print(name, seed, found[-1][2], flush=True)
    print(f"{asked.days} day(s) and night(s), {asked.lenses} lenses, field {asked.field} px")
    print("                            rms  median     P90  P90 of rms  stated   within 95 %: south, north (intervals)")
    for name, found in rows.items():
        first, second = (np.array([row[column] for row in found]) for column in (0, 1))
        print(_line(f"{name}, day", first))
        print(_line(f"{name}, and night", second))
        worse = second[:, 0] / first[:, 0]
        print(f"{'':22s} worse with stars: {np.mean(worse > 1.1):.2f} of the lenses, at most {worse.max():.2f} times")


def _line(name: str, found: FloatArray) -> str:
    rms, middle, most = np.median(found[:, :3], axis=0)
    shares = [
        f"{half.mean():.3f} ({low:.3f} to {high:.3f})"
        for half, (low, high) in ((half, bootstrap_interval(half)) for half in found[:, 3:5].T)
    ]
    return (
        f"{name:24s}{rms:8.4f}{middle:8.4f}{most:8.4f}{np.quantile(found[:, 0], 0.9):10.4f}"
        f"{np.median(found[:, 5]):10.4f}   {', '.join(shares)}"
    )


if __name__ == "__main__":
    main()
