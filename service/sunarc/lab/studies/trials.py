"""One fit of a simulated arc, and many of them: every trial draws from its own seed, whoever runs it."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from datetime import date
from functools import cache
from multiprocessing import get_context

import numpy as np

from sunarc.calibration.answers.covariance import hemisphere
from sunarc.calibration.fit.assemble import tidied
from sunarc.calibration.fit.effects import add_effects
from sunarc.calibration.fit.marginal_likelihood import HyperparameterGrid, prior_precision
from sunarc.calibration.fit.robust_fit import make_hyperparameter_grid, robust_rounds
from sunarc.calibration.model.options import CalibrationOptions, ImageCircle, Method
from sunarc.calibration.model.sightings import Sightings, filter_sightings
from sunarc.calibration.noise import NoiseGroups
from sunarc.calibration.paper import fit_as_paper
from sunarc.calibration.solve.levenberg_marquardt import information, most_probable
from sunarc.calibration.solve.priors import Whitened
from sunarc.calibration.solve.problem import FitProblem
from sunarc.calibration.start.initial_guess import level_camera, single_problem
from sunarc.calibration.start.multistart import SMALLEST_SIGMA_PX, distance_sigmas
from sunarc.common.array_types import FloatArray
from sunarc.common.robust_statistics import robust_sigma
from sunarc.imager.runtime.child_process import one_thread_each
from sunarc.lab.simulation.truth import SGP, true_camera
from sunarc.optics.camera import Camera
from sunarc.optics.forward import project
from sunarc.optics.projections import angle_limit
from sunarc.sky.days import day_bounds_unix_s
from sunarc.sky.site import Site
from sunarc.sky.sun import sun_angles, sun_directions

LARGEST_ZENITH_DEG = 89.6
"""Up to this apparent zenith angle the paper's detector found the sun (section 3.3)."""
SYNTHETIC_DAY = date(2013, 5, 13)
"""The day of the paper's Fig. 3."""


def arcs(camera: Camera, days: Sequence[date], *, cadence_s: float = 30.0) -> Sightings:
    """Return the arcs of solar days at the Southern Great Plains, one moment every `cadence_s` while the sun is up.

    Its directions are known, and it is where the camera sees it.
    """
    bounds = [day_bounds_unix_s(day, longitude=SGP.longitude) for day in days]
    times = np.concatenate([np.arange(begin, end, cadence_s) for begin, end in bounds])
    times = times[sun_angles(times, SGP).apparent_zenith < LARGEST_ZENITH_DEG]
    directions = sun_directions(times, SGP)
    return Sightings(unix_s=times, directions=directions, pixels=project(camera, directions))


_SETTLING = 3
_STEPS = 10


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Batch:
    """Common data of many fits of one geometry: times and directions, and cameras near a known one.

    Directions, bins, scales to try and the lens's prior are made once. The search for a start is left out, since all
    begin at the known camera, and so is the uncertainty: what is returned is the camera that `calibrate` returns.

    Attributes
    ----------
    camera : where all fits begin: the true camera of a simulation, or the first fit.
    options : of the fits.
    usable : the sightings that count in every set; their detections are those of the first set.
    groups, grid : of the robust rounds.
    problem : the camera sought, its prior about the first image circle.
    """

    camera: Camera
    options: CalibrationOptions
    usable: Sightings
    groups: NoiseGroups
    grid: HyperparameterGrid
    problem: FitProblem

    @classmethod
    def near(
        cls, camera: Camera, points: Sightings, *, site: Site, options: CalibrationOptions, circle: ImageCircle
    ) -> Batch:
        """Return the common data of the fits of sightings like these.

        Parameters
        ----------
        camera : near the cameras that are sought: within some px over the sky.
        points : one set, of one pose.
        site : where the camera stands.
        options : how to fit; projection and mirroring are the camera's.
        circle : the image circle of the set.
        """
        options = replace(options, projection=camera.projection, mirrored="yes" if camera.mirrored else "no")
        usable, camera = filter_sightings(points, site=site), camera.lens_alone()
        return cls(
            camera=camera,
            options=options,
            usable=usable,
            groups=NoiseGroups.of(usable),
            grid=make_hyperparameter_grid(camera, options),
            problem=single_problem(usable, camera, options, circle),
        )

    def fitted(self, pixels: FloatArray, circle: ImageCircle) -> Camera:
        """Return the camera that a set of detections (n, 2), in the order of the points, and its image circle give."""
        observed = replace(self.usable, pixels=pixels[self.usable.index])
        if self.options.method == "paper":
            found = fit_as_paper(observed, [self.camera], options=self.options, quickly=True).cameras[0]
        else:
            found = self._fit_robust(observed, self._make_problem(circle))
        return tidied(found, self.options)

    def _make_problem(self, circle: ImageCircle) -> FitProblem:
        size, prior = (self.camera.width, self.camera.height), self.problem.prior
        first, mean = level_camera(circle, image_size=size, options=self.options), prior.mean.copy()
        mean[: Whitened.RADIAL] = *first.focal_length_px, 0.0, *first.principal_point_px
        return replace(self.problem, prior=replace(prior, mean=mean))

    def _fit_robust(self, observed: Sightings, problem: FitProblem) -> Camera:
        plain = self._fit_without_field(observed, problem)
        problem, observed = add_effects(problem, plain, observed, outwards_px=self.options.outwards_px)
        found = robust_rounds(problem, observed, plain, groups=self.groups, grid=self.grid)
        camera, mean = found.camera(), found.field_mean
        return camera if mean is None else replace(camera, displacement=found.grid.basis.displacement(mean))

    def _fit_without_field(self, observed: Sightings, problem: FitProblem) -> FloatArray:
        """Return the unknowns of the robust fit from the known camera: the weights by turns with the bins' solution."""
        tolerances, bins = self.options.tolerances, self.groups.bins
        precision = prior_precision(problem.size, tolerances.radial_px, tolerances.decentering_px)
        at = problem.unknowns([self.camera])
        for _ in range(_SETTLING):
            sigma = robust_sigma(distance_sigmas(problem, observed, at), floor=SMALLEST_SIGMA_PX)
            weighed = information(problem.residuals(at, observed), observed, sigma)
            means = bins.observations(observed, problem, at, information=weighed)
            at = most_probable(problem, means, at, precision=precision, iterations=_STEPS, tolerance=1e-4).unknowns
        return at


QUANTITIES = (
    "arc_rmse_px",
    "sky_rmse_px",
    "focal_length_x_px",
    "focal_length_y_px",
    "principal_point_x_px",
    "principal_point_y_px",
)
"""Result of a trial: the true error on the arc (Eq. 28) and over the sky, and four of its parameters."""

_CHUNK = 8
"""Trials handed to a process at a time: a tenth of a second of work, against half a millisecond to hand over one."""
_CIRCLE_ERROR_PX = 2.0
"""How well a Hough transform finds the image circle, per coordinate."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Trial:
    """One fit to be made.

    Attributes
    ----------
    method : of the fit.
    sigma_px : noise, px per axis.
    seed : the same for all methods, so that they are given the same sightings.
    """

    method: Method
    sigma_px: float
    seed: tuple[int, ...]


def run_trial(trial: Trial) -> tuple[float, ...]:
    """Fit once, from the true camera on, and return `QUANTITIES`."""
    rng = np.random.default_rng(trial.seed)
    truth, arc = true_camera(0), synthetic_arc()
    pixels = arc.pixels + rng.normal(0.0, trial.sigma_px, arc.pixels.shape)
    fit = _common_fit_inputs(trial.method).fitted(pixels, found_circle(rng, truth))
    on_arc, on_sky = true_error(fit, truth, arc.directions), true_error(fit, truth, hemisphere())
    return on_arc, on_sky, *fit.focal_length_px, *fit.principal_point_px


@cache
def synthetic_arc() -> Sightings:
    """Return the paper's synthetic arc (Fig. 3): 1673 moments of 13 May 2013."""
    return arcs(true_camera(0), [SYNTHETIC_DAY])


@cache
def _common_fit_inputs(method: Method) -> Batch:
    """Return the common data of all fits by a method."""
    truth, arc = true_camera(0), synthetic_arc()
    return Batch.near(
        truth,
        Sightings.of(unix_s=arc.unix_s, pixels=arc.pixels),
        site=SGP,
        options=CalibrationOptions(method=method),
        circle=found_circle(np.random.default_rng(0), truth),
    )


def found_circle(rng: np.random.Generator, truth: Camera) -> ImageCircle:
    """Return the image circle as it would be found in an image, off by about 2 px."""
    dx, dy, dr = rng.normal(0.0, _CIRCLE_ERROR_PX, 3)
    x, y = truth.principal_point_px
    return ImageCircle(x=x + dx, y=y + dy, radius=truth.focal_length_px[0] * math.sqrt(2.0) + dr)


def true_error(fit: Camera, truth: Camera, directions: FloatArray) -> float:
    """Return the root mean square distance in px between where two cameras see directions (Eq. 28).

    A fit that would not answer for a direction is judged there too, by its formula.
    """
    widest = angle_limit(truth.projection) * (1.0 - 1e-9)
    found, true = (project(replace(camera, max_angle=widest), directions) for camera in (fit, truth))
    square = np.sum((found - true) ** 2, axis=-1)
    return float(np.sqrt(np.mean(square)))


def run_trials(trials: Sequence[Trial], *, jobs: int = 1, after_each: Callable[[], None] = lambda: None) -> FloatArray:
    """Run trials, in so many processes, and return (n, len(QUANTITIES)) in the order given."""
    rows = []
    for row in _map_trials(run_trial, trials, jobs=jobs):
        rows.append(row)
        after_each()
    return np.array(rows, dtype=np.float64).reshape(-1, len(QUANTITIES))


def _map_trials(
    work: Callable[[Trial], tuple[float, ...]], trials: Iterable[Trial], *, jobs: int
) -> Iterator[tuple[float, ...]]:
    if jobs <= 1:
        yield from map(work, trials)
        return
    one_thread_each()  # read by the processes that are started
    with ProcessPoolExecutor(jobs, mp_context=get_context("spawn")) as pool:
        yield from pool.map(work, trials, chunksize=_CHUNK)
