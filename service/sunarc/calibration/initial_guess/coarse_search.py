"""From candidates to one camera an epoch that is surely in the right valley."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from sunarc.array_types import FloatArray
from sunarc.calibration.initial_guess.candidates import (
    LARGEST_TILT,
    as_far_as_it_rises,
    camera_from_circle,
    camera_from_size,
    candidates,
    tilt,
    wahba,
)
from sunarc.calibration.least_squares.priors import N_LENS, Whitened, lens_prior, precisions
from sunarc.calibration.least_squares.problem import Observations, Problem, problem_for
from sunarc.calibration.least_squares.solve import most_probable
from sunarc.calibration.model.options import CalibrationOptions, ImageCircle
from sunarc.calibration.robust_loss import robust_sigma
from sunarc.optics.camera import Camera
from sunarc.optics.inverse import unproject
from sunarc.optics.projections import angle_limit

_TRIED = 10
_THIN = 120
_POLISHED = 3
_TILT_SIGMA = math.radians(25.0)
_SEARCH_RADIAL_PX = 20.0
_SEARCH_DECENTERING_PX = 3.0


def first_cameras(
    observed: Observations,
    *,
    image_size: tuple[int, int],
    options: CalibrationOptions,
    circle: ImageCircle | None,
    start: Camera | None,
) -> tuple[list[Camera], float]:
    """Return a camera for every epoch, one lens, and the cost of the epoch that the lens was found from.

    The epoch with the most sightings gives the lens; the others' poses follow from it.
    """
    epochs = np.unique(observed.epoch)
    counts = [int(np.sum(observed.epoch == e)) for e in epochs]
    main = int(epochs[int(np.argmax(counts))])
    one = _of_epoch(observed, main)
    lens, cost = _best_single(one, image_size=image_size, options=options, circle=circle, start=start)
    cameras = [lens if e == main else wahba(lens, _of_epoch(observed, int(e)))[0] for e in range(int(epochs[-1]) + 1)]
    return cameras, cost


def _of_epoch(observed: Observations, epoch: int) -> Observations:
    in_epoch = observed.select(observed.epoch == epoch)
    return replace(in_epoch, epoch=np.zeros(len(in_epoch), dtype=np.int64))


def _best_single(
    observed: Observations,
    *,
    image_size: tuple[int, int],
    options: CalibrationOptions,
    circle: ImageCircle | None,
    start: Camera | None,
) -> tuple[Camera, float]:
    if start is not None:
        guess, known = start, True
    elif circle is not None:
        guess, known = camera_from_circle(circle, image_size=image_size, options=options), True
    else:
        guess, known = camera_from_size(image_size=image_size, options=options), False
    tried = candidates(observed, guess, known=known, best=_TRIED)
    if not tried:
        return guess, math.inf
    thin = observed.select(np.unique(np.linspace(0, len(observed) - 1, _THIN).astype(int)))
    rough = [_polished(thin, camera, options, circle, stage=1) for camera in tried]
    rough.sort(key=lambda pair: pair[1])
    finer = [_polished(thin, camera, options, circle, stage=3) for camera, _ in rough[:_POLISHED]]
    return min(finer, key=lambda pair: pair[1])


def _polished(
    observed: Observations, camera: Camera, options: CalibrationOptions, circle: ImageCircle | None, *, stage: int
) -> tuple[Camera, float]:
    """Fit one candidate: stage 1 focal length, centre and pose; stage 3 everything, the radial part loosely."""
    problem = single_problem(observed, camera, options, circle)
    unknowns = problem.unknowns([camera])
    precision = np.concatenate([precisions(_SEARCH_RADIAL_PX, _SEARCH_DECENTERING_PX), np.full(3, 1e-12)])
    free = np.ones(problem.size, dtype=bool)
    if stage == 1:
        free[:N_LENS] = False
        free[[Whitened.FOCAL_LENGTH, Whitened.CENTER_X, Whitened.CENTER_Y]] = True
    for _ in range(3):
        distance = np.linalg.norm(problem.residuals(unknowns, observed), axis=-1)
        sigma = robust_sigma(distance, share=0.5, floor=0.3)
        unknowns = most_probable(
            problem, observed, unknowns, precision=precision, sigma=sigma, free=free, iterations=12, tolerance=1e-3
        ).unknowns
    found = problem.camera(unknowns)
    return replace(found, max_angle=camera.max_angle), _misfit(problem, unknowns, precision, observed, found)


def _misfit(
    problem: Problem, unknowns: FloatArray, precision: FloatArray, observed: Observations, camera: Camera
) -> float:
    """Return how implausible a candidate is, in half squares: scatter, prior, tilt."""
    residual = problem.residuals(unknowns, observed)
    distance = np.linalg.norm(residual, axis=-1) * np.sqrt(observed.information)
    scale = robust_sigma(distance, share=0.5, floor=0.05)
    scatter = 0.3 * len(observed) * math.log(scale**2 + float(np.median(distance)) ** 2 / 1.386)
    prior = 0.5 * float(np.sum(precision * unknowns**2))
    lean = tilt(camera)
    beyond = math.inf if lean > LARGEST_TILT or camera.focal_length_px[0] <= 0.0 else 0.0
    return scatter + prior + 0.5 * (lean / _TILT_SIGMA) ** 2 + beyond


def single_problem(
    observed: Observations,
    camera: Camera,
    options: CalibrationOptions,
    circle: ImageCircle | None,
    *,
    n_epochs: int = 1,
) -> Problem:
    """Return the problem of fitting a camera near one that is known."""
    prior = lens_prior(
        camera, tolerances=options.tolerances, circle=circle, field_angle=field_angle(camera, observed, options)
    )
    return problem_for(camera, prior, n_epochs=n_epochs, max_angle=math.radians(options.max_angle_deg))


def field_angle(camera: Camera, observed: Observations, options: CalibrationOptions) -> float:
    """Return the largest angle off the axis, in radians, that the lens shows or the sun was seen at."""
    limit = min(angle_limit(camera.projection) * 0.999, math.radians(max(options.max_angle_deg, 30.0)))
    cosine = unproject(as_far_as_it_rises(camera), observed.pixels)[:, 2]
    cosine = cosine[np.isfinite(cosine)]
    furthest = math.acos(float(np.clip(np.min(cosine, initial=1.0), -1.0, 1.0)))
    if camera.projection == "perspective":
        return min(max(furthest * 1.05, math.radians(20.0)), math.radians(80.0))
    return min(max(furthest, math.pi / 2), limit)
