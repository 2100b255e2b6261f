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

from sunarc.array_types import FloatArray
from sunarc.calibration.answers.covariance import hemisphere
from sunarc.calibration.calibrate import Batch
from sunarc.calibration.model.options import CalibrationOptions, ImageCircle, Method
from sunarc.calibration.model.sightings import Sightings
from sunarc.optics.camera import Camera
from sunarc.optics.forward import project
from sunarc.optics.projections import angle_limit
from sunarc.runtime.child_process import one_thread_each
from sunarc.simulation.truth import SGP, true_camera
from sunarc.sky.days import day_bounds_unix_s
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
"""Trials handed to a process at a time: a tenth of a second of work, beside half a millisecond to hand over one."""
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
    fit = _batch(trial.method).fitted(pixels, circle=found_circle(rng, truth))
    on_arc, on_sky = true_error(fit, truth, arc.directions), true_error(fit, truth, hemisphere())
    return on_arc, on_sky, *fit.focal_length_px, *fit.principal_point_px


@cache
def synthetic_arc() -> Sightings:
    """Return the paper's synthetic arc (Fig. 3): 1673 moments of 13 May 2013."""
    return arcs(true_camera(0), [SYNTHETIC_DAY])


@cache
def _batch(method: Method) -> Batch:
    """Return what all fits by a method share."""
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
    for row in _mapped(run_trial, trials, jobs=jobs):
        rows.append(row)
        after_each()
    return np.array(rows, dtype=np.float64).reshape(-1, len(QUANTITIES))


def _mapped(
    work: Callable[[Trial], tuple[float, ...]], trials: Iterable[Trial], *, jobs: int
) -> Iterator[tuple[float, ...]]:
    if jobs <= 1:
        yield from map(work, trials)
        return
    one_thread_each()  # read by the processes that are started
    with ProcessPoolExecutor(jobs, mp_context=get_context("spawn")) as pool:
        yield from pool.map(work, trials, chunksize=_CHUNK)
