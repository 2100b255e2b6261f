"""Where a fit starts: focal length and centre from the image circle or by search, the pose by Wahba's problem.

Reference: G. Wahba, "A least squares estimate of satellite attitude", SIAM Review 7 (1965); solved by the singular
value decomposition.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import replace

import numpy as np

from sunarc.array_types import FloatArray, IntArray
from sunarc.calibration.least_squares.problem import Observations
from sunarc.calibration.model.options import CalibrationOptions, ImageCircle
from sunarc.optics.camera import Camera
from sunarc.optics.inverse import unproject
from sunarc.optics.pose import rotation_vector
from sunarc.optics.projections import ideal_radius
from sunarc.optics.stretch import rising_limit
from sunarc.robust_statistics import cauchy_weights

LARGEST_TILT = math.radians(75.0)
_MAX_SIGHTINGS = 160
_FOCAL_FACTORS = np.geomspace(0.35, 4.0, 22)
_CENTER_STEPS = (-0.08, 0.0, 0.08)


def camera_from_circle(circle: ImageCircle, *, image_size: tuple[int, int], options: CalibrationOptions) -> Camera:
    """Return K0 (Eqs. 21, 22): a level camera, its x axis to the east, from the image circle."""
    mirrored = options.mirrored == "yes"
    angle = math.radians(circle.angle_deg)
    limit = math.radians(80.0) if options.projection == "perspective" else math.pi / 2
    focal = circle.radius / float(ideal_radius(options.projection, min(angle, limit) if angle > limit else angle))
    x = image_size[0] - 1.0 - circle.x if mirrored else circle.x
    return _level(image_size, options, focal, (x, circle.y), mirrored=mirrored)


def camera_from_size(*, image_size: tuple[int, int], options: CalibrationOptions) -> Camera:
    """Return a level camera whose field is 180 degrees (perspective: 120) across the image's shorter side."""
    angle = math.radians(60.0) if options.projection == "perspective" else math.pi / 2
    focal = 0.5 * min(image_size) / float(ideal_radius(options.projection, angle))
    center = ((image_size[0] - 1) / 2.0, (image_size[1] - 1) / 2.0)
    return _level(image_size, options, focal, center, mirrored=options.mirrored == "yes")


def _level(
    image_size: tuple[int, int],
    options: CalibrationOptions,
    focal: float,
    center: tuple[float, float],
    *,
    mirrored: bool,
) -> Camera:
    return Camera(
        width=image_size[0],
        height=image_size[1],
        projection=options.projection,
        focal_length_px=(focal, focal),
        principal_point_px=center,
        rotation_cam_enu=(0.0, 0.0, 0.0),
        mirrored=mirrored,
        max_angle=math.radians(options.max_angle_deg),
    )


def wahba(camera: Camera, observed: Observations, *, rounds: int = 4) -> tuple[Camera, float]:
    """Return the camera turned so that its rays meet the sun's directions, and how well they do.

    Parameters
    ----------
    camera : a lens; its pose does not count.
    observed : sightings of one pose epoch.
    rounds : rotations found in turn, sightings that lie off counting less and less.

    Returns
    -------
    The turned camera, and the median angle left over in radians; infinite where too few pixels have a ray.
    """
    rays = unproject(as_far_as_it_rises(camera), observed.pixels)
    matrices, misfits = _turns(rays[None], observed.directions, rounds=rounds)
    misfit = float(misfits[0])
    turned = replace(camera, rotation_cam_enu=rotation_vector(matrices[0])) if math.isfinite(misfit) else camera
    return turned, misfit


def _turns(rays: FloatArray, world: FloatArray, *, rounds: int = 4) -> tuple[FloatArray, FloatArray]:
    """Return the rotations (c, 3, 3) of cameras, and how well their rays (c, n, 3) then meet directions (n, 3).

    That is the median angle left over in radians, (c,); infinite where too few rays are finite.
    """
    good = np.all(np.isfinite(rays), axis=-1)
    count = np.sum(good, axis=1)
    rays = np.where(good[..., None], rays, 0.0)
    weight, matrix, middle = good.astype(np.float64), np.empty((len(rays), 3, 3)), np.empty(len(rays))
    for _ in range(rounds):
        left, _, right = np.linalg.svd(np.swapaxes(weight[..., None] * rays, 1, 2) @ world)
        # Kabsch: without the sign a plane of directions is explained as well by a reflection
        left[..., 2] *= (np.linalg.det(left) * np.linalg.det(right))[:, None]
        matrix = left @ right
        chord = np.linalg.norm(rays - world @ np.swapaxes(matrix, 1, 2), axis=-1)
        middle = _medians(np.where(good, chord, 3.0), count)  # no chord is longer than 2
        weight = good * cauchy_weights(chord, scale=np.maximum(middle, 1e-9)[:, None])
    return matrix, np.where(count < max(3.0, 0.5 * len(world)), math.inf, middle)


def _medians(values: FloatArray, count: IntArray) -> FloatArray:
    """Return the medians (c,) of the smallest so many of the values (c, n)."""
    ordered, row, known = np.sort(values, axis=1), np.arange(len(values)), np.maximum(count, 1)
    return np.asarray(0.5 * (ordered[row, (known - 1) // 2] + ordered[row, known // 2]))


def as_far_as_it_rises(camera: Camera) -> Camera:
    """Return the camera level, answering at every angle up to which its radius rises."""
    return replace(camera, rotation_cam_enu=(0.0, 0.0, 0.0), max_angle=rising_limit(camera, up_to=math.pi))


def candidates(observed: Observations, guess: Camera, *, known: bool, best: int) -> list[Camera]:
    """Return turned cameras to try, the most promising first.

    Parameters
    ----------
    observed : sightings of one pose epoch.
    guess : focal length and centre to search around.
    known : whether the guess comes from an image circle: then it is taken as it is.
    best : how many at most.
    """
    thin = observed.select(np.unique(np.linspace(0, len(observed) - 1, _MAX_SIGHTINGS).astype(int)))
    factors = np.array([1.0]) if known else _FOCAL_FACTORS
    steps = (0.0,) if known else _CENTER_STEPS
    size = min(guess.width, guess.height)
    level = as_far_as_it_rises(guess)  # up to the same angle at any focal length
    lenses = []
    for factor, dx, dy in itertools.product(factors, steps, steps):
        focal = guess.focal_length_px[0] * float(factor)
        center = (guess.principal_point_px[0] + dx * size, guess.principal_point_px[1] + dy * size)
        lenses.append(replace(level, focal_length_px=(focal, focal), principal_point_px=center))
    matrices, misfits = _turns(np.stack([unproject(lens, thin.pixels) for lens in lenses]), thin.directions)
    upright = np.isfinite(misfits) & (matrices[:, 2, 2] >= math.cos(LARGEST_TILT))
    order = [int(k) for k in np.argsort(misfits, kind="stable") if upright[k]]
    return [
        replace(lenses[k], rotation_cam_enu=rotation_vector(matrices[k]), max_angle=guess.max_angle)
        for k in order[:best]
    ]


def tilt(camera: Camera) -> float:
    """Return the angle between the optical axis and the vertical in radians."""
    x, y, z = camera.rotation_cam_enu
    angle = math.sqrt(x * x + y * y + z * z)
    if angle < 1e-12:
        return 0.0
    lean = (1.0 - math.cos(angle)) * (x * x + y * y) / angle**2
    return math.acos(max(-1.0, min(1.0, 1.0 - lean)))
