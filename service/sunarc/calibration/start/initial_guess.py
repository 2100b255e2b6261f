"""Where a fit starts: focal length and centre from the image circle or by search, the pose by Wahba's problem.

Reference: G. Wahba, "A least squares estimate of satellite attitude", SIAM Review 7 (1965); solved by the singular
value decomposition.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import replace

import numpy as np

from sunarc.calibration.model.options import CalibrationOptions, ImageCircle
from sunarc.calibration.model.sightings import Sightings
from sunarc.calibration.solve.levenberg_marquardt import most_probable
from sunarc.calibration.solve.priors import N_LENS, Whitened, lens_prior, precisions
from sunarc.calibration.solve.problem import FitProblem, problem_for
from sunarc.common.array_types import FloatArray, IntArray
from sunarc.common.robust_statistics import cauchy_weights, robust_sigma
from sunarc.optics.camera import Camera
from sunarc.optics.forward import rising_limit
from sunarc.optics.inverse import calibrated, unproject
from sunarc.optics.pose import rotation_matrix, rotation_vector, rotation_vectors, smallest_rotation
from sunarc.optics.projections import angle_limit, ideal_angle, ideal_radius

LARGEST_TILT = math.radians(75.0)
_SEARCHED_SIGHTINGS = 160
_FOCAL_FACTORS = np.geomspace(0.35, 4.0, 22)


def level_camera(circle: ImageCircle | None, *, image_size: tuple[int, int], options: CalibrationOptions) -> Camera:
    """Return a level camera, its x axis to the east: K0 of the image circle (Eqs. 21, 22).

    Without a circle its field is 180 degrees (perspective: 120) across the image's shorter side.
    """
    width, height = image_size
    mirrored, projection = options.mirrored == "yes", options.assumed_projection
    flat = projection == "perspective"
    if circle is None:
        angle, radius = math.radians(60.0) if flat else math.pi / 2, 0.5 * min(image_size)
        center = ((width - 1) / 2.0, (height - 1) / 2.0)
    else:
        angle, radius = min(math.radians(circle.angle_deg), math.radians(80.0) if flat else math.pi / 2), circle.radius
        center = (width - 1.0 - circle.x if mirrored else circle.x, circle.y)
    focal = radius / float(ideal_radius(projection, angle))
    return Camera(
        width=width,
        height=height,
        projection=projection,
        focal_length_px=(focal, focal),
        principal_point_px=center,
        rotation_cam_enu=(0.0, 0.0, 0.0),
        mirrored=mirrored,
        max_angle=math.radians(options.max_angle_deg),
    )


def wahba(camera: Camera, observed: Sightings, *, rounds: int = 4) -> tuple[Camera, float]:
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
    matrices, misfits = _solve_rotations(_rays_of_sightings(camera, observed), observed.directions, rounds=rounds)
    misfit = float(misfits[0])
    turned = replace(camera, rotation_cam_enu=rotation_vector(matrices[0])) if math.isfinite(misfit) else camera
    return turned, misfit


def _rays_of_sightings(camera: Camera, observed: Sightings) -> FloatArray:
    """Return (3, 1, n): the directions that a camera sees the sightings in, in its own frame."""
    return unproject(as_far_as_it_rises(camera), observed.pixels).T[:, None]


def _solve_rotations(rays: FloatArray, world: FloatArray, *, rounds: int = 4) -> tuple[FloatArray, FloatArray]:
    """Return the rotations (c, 3, 3) of cameras, and how well their rays (3, c, n) then meet directions (n, 3).

    That is the median angle left over in radians, (c,); infinite where too few rays are finite.
    """
    good = np.isfinite(rays[0])
    rays = np.where(good, rays, 0.0)
    count, row = np.maximum(np.sum(good, axis=1), 1), np.arange(rays.shape[1])
    weight, matrix, middle = good.astype(np.float64), np.empty((row.size, 3, 3)), np.empty(row.size)
    for _ in range(rounds):
        left, _, right = np.linalg.svd(np.moveaxis((weight * rays) @ world, 0, 1))
        # Kabsch: without the sign a plane of directions is explained as well by a reflection
        left[..., 2] *= (np.linalg.det(left) * np.linalg.det(right))[:, None]
        matrix = left @ right
        x, y, z = np.moveaxis(matrix @ world.T, 1, 0)
        chord = np.sqrt(np.maximum(2.0 - 2.0 * (x * rays[0] + y * rays[1] + z * rays[2]), 0.0))
        ordered = np.sort(np.where(good, chord, 3.0), axis=1)  # no chord is longer than 2
        middle = 0.5 * (ordered[row, (count - 1) // 2] + ordered[row, count // 2])
        weight = good * cauchy_weights(chord, scale=np.maximum(middle, 1e-9)[:, None])
    return matrix, np.where(count < max(3.0, 0.5 * len(world)), math.inf, middle)


def as_far_as_it_rises(camera: Camera) -> Camera:
    """Return a level camera whose field ends where its image radius stops rising."""
    return replace(camera, rotation_cam_enu=(0.0, 0.0, 0.0), max_angle=rising_limit(camera, up_to=math.pi))


def candidates(observed: Sightings, guess: Camera, *, known: bool, best: int) -> list[Camera]:
    """Return turned cameras to try, the most promising first.

    Parameters
    ----------
    observed : sightings of one pose epoch.
    guess : the camera to search around.
    known : whether the guess comes from an image circle: then it is taken as it is; else ideal lenses of other focal
        lengths, all of the guess's centre, which the fit that follows moves.
    best : how many at most.
    """
    thin = observed.thinned(_SEARCHED_SIGHTINGS)
    factors = np.ones(1) if known else _FOCAL_FACTORS
    matrices, misfits = _solve_rotations(
        _rays_of_sightings(guess, thin) if known else _rays_of_ideal_lenses(guess, factors, thin), thin.directions
    )
    upright = np.isfinite(misfits) & (matrices[:, 2, 2] >= math.cos(LARGEST_TILT))
    order = [k for k in np.argsort(misfits, kind="stable").tolist() if upright[k]]
    x, y = guess.focal_length_px
    return [
        replace(
            guess,
            focal_length_px=(x * float(factors[k]), y * float(factors[k])),
            rotation_cam_enu=rotation_vector(matrices[k]),
        )
        for k in order[:best]
    ]


def _rays_of_ideal_lenses(camera: Camera, factors: FloatArray, observed: Sightings) -> FloatArray:
    """Return (3, c, n): directions of sightings in ideal lenses with focal lengths scaled by factors (c,)."""
    x, y = calibrated(camera, observed.pixels)
    around, angle = np.arctan2(y, x), ideal_angle(camera.projection, np.hypot(x, y) / factors[:, None])
    sine = np.sin(angle)
    return np.stack([sine * np.cos(around), sine * np.sin(around), np.cos(angle)])


def tilt(camera: Camera) -> float:
    """Return the angle between the optical axis and the vertical in radians."""
    axis = rotation_matrix(camera.rotation_cam_enu)[2]
    return math.atan2(math.hypot(axis[0], axis[1]), axis[2])


# From candidates to one camera an epoch that is surely near the right minimum.

_TRIED = 4
"""Candidates that are fitted. With three, one of 207 hard cases ended 5 half squares higher; with four, none."""
_THIN = 120
_POLISHED = 2
_TILT_SIGMA = math.radians(25.0)
_SEARCH_RADIAL_PX = 20.0
_SEARCH_DECENTERING_PX = 3.0


def first_cameras(
    observed: Sightings, guess: Camera, *, known: bool, options: CalibrationOptions, circle: ImageCircle | None
) -> tuple[list[Camera], float]:
    """Return a camera for every epoch, one lens, and the cost of the epoch that the lens was found from.

    The epoch with the most sightings gives the lens; the others' poses follow from it. The guess is searched around,
    see `candidates`.
    """
    unnumbered = replace(observed, epoch=np.zeros(1, dtype=np.int64))
    of_epochs = [unnumbered.select(observed.epoch == epoch) for epoch in range(int(observed.epoch.max()) + 1)]
    main = max(of_epochs, key=len)
    lens, cost = guess, math.inf
    if tried := candidates(main, guess, known=known, best=_TRIED):
        thin = main.thinned(_THIN)
        # one problem for all: ideal lenses differ in the focal length alone, which has no prior here
        problem = single_problem(thin, tried[0], options, circle)
        rough = [_fit_candidate(problem, thin, camera, whole=False, focal_prior=known) for camera in tried]
        rough.sort(key=lambda pair: pair[1])
        finer = [
            _fit_candidate(single_problem(thin, camera, options, circle), thin, camera, whole=True)
            for camera, _ in rough[:_POLISHED]
        ]
        lens, cost = min(finer, key=lambda pair: pair[1])
    return [lens if one is main else wahba(lens, one)[0] for one in of_epochs], cost


def _fit_candidate(
    problem: FitProblem, observed: Sightings, camera: Camera, *, whole: bool, focal_prior: bool = True
) -> tuple[Camera, float]:
    """Fit one candidate: focal length, centre and pose, or the whole of it, the radial part loosely."""
    unknowns = problem.unknowns([camera])
    precision = np.concatenate([precisions(_SEARCH_RADIAL_PX, _SEARCH_DECENTERING_PX), np.full(3, 1e-12)])
    if not focal_prior:
        precision[Whitened.FOCAL_LENGTH] = 1e-12
    free = np.ones(problem.size, dtype=bool)
    if not whole:
        free[:N_LENS] = False
        free[[Whitened.FOCAL_LENGTH, Whitened.CENTER_X, Whitened.CENTER_Y]] = True
    for _ in range(3):
        distance = np.linalg.norm(problem.residuals(unknowns, observed), axis=-1)
        sigma = robust_sigma(distance, share=0.5, floor=0.3)
        unknowns = most_probable(
            problem, observed, unknowns, precision=precision, sigma=sigma, free=free, iterations=12, tolerance=1e-3
        ).unknowns
    found = problem.camera(unknowns)
    return replace(found, max_angle=camera.max_angle), candidate_misfit(problem, unknowns, precision, observed, found)


def candidate_misfit(
    problem: FitProblem, unknowns: FloatArray, precision: FloatArray, observed: Sightings, camera: Camera
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
    observed: Sightings,
    camera: Camera,
    options: CalibrationOptions,
    circle: ImageCircle | None,
    *,
    n_epochs: int = 1,
) -> FitProblem:
    """Return the problem of fitting a camera near one that is known."""
    prior = lens_prior(
        camera, tolerances=options.tolerances, circle=circle, field_angle=field_angle(camera, observed, options)
    )
    return problem_for(camera, prior, n_epochs=n_epochs, max_angle=math.radians(options.max_angle_deg))


def field_angle(camera: Camera, observed: Sightings, options: CalibrationOptions) -> float:
    """Return the largest angle off the axis, in radians, that the lens shows or the sun was seen at."""
    limit = min(angle_limit(camera.projection) * 0.999, math.radians(max(options.max_angle_deg, 30.0)))
    cosine = unproject(as_far_as_it_rises(camera), observed.pixels)[:, 2]
    cosine = cosine[np.isfinite(cosine)]
    furthest = math.acos(float(np.clip(np.min(cosine, initial=1.0), -1.0, 1.0)))
    if camera.projection == "perspective":
        return min(max(furthest * 1.05, math.radians(20.0)), math.radians(80.0))
    return min(max(furthest, math.pi / 2), limit)


# The turn that most sightings agree on, when the camera may look anywhere and many sightings are false.
#
# Every sighting names the smallest turn that explains it, every pair of them a whole rotation; the one that most others
# agree with closely is taken, a small one before a large one.

_MAX_SIGHTINGS = 64
_PAIRS = 400
_CLOSE_SIGMAS = 4.0
_SMALL_ROTATION = 0.5
"""How many agreeing sightings a turn ten times as large must bring."""
_LEAST_SEPARATION = 1e-4
"""Radians; two directions that are nearer span no plane that a rotation could be read from."""
_SEED = 20130513


def ransac_rotation(camera: Camera, directions: FloatArray, pixels: FloatArray, sigma_px: FloatArray) -> FloatArray:
    """Return the turn (3,) of a camera about its own axes, radians, that sightings ask for; 0 where they ask for none.

    Parameters
    ----------
    camera : its lens and its pose so far.
    directions, pixels : (n, 3) where the sun was, (n, 2) where it was seen.
    sigma_px : (n,) how far a true sighting may lie off for other reasons.
    """
    rays = unproject(as_far_as_it_rises(camera), pixels)
    world = directions @ rotation_matrix(camera.rotation_cam_enu).T
    good = np.flatnonzero(np.all(np.isfinite(rays), axis=-1))
    if good.size == 0:
        return np.zeros(3)
    thin = good[np.unique(np.linspace(0, good.size - 1, _MAX_SIGHTINGS).astype(int))]
    focal = 0.5 * (camera.focal_length_px[0] + camera.focal_length_px[1])
    turns = np.concatenate(
        [np.zeros((1, 3)), smallest_rotation(world[thin], rays[thin]), _rotations_from_pairs(world[thin], rays[thin])]
    )
    matrices = rotation_matrix(turns)
    separation = np.linalg.norm(np.einsum("kij,nj->kni", matrices, world[thin]) - rays[thin], axis=-1)
    off = separation / (_CLOSE_SIGMAS * sigma_px[thin] / focal)
    # a soft count: 1 for a sighting close by, 1/2 at the limit, nothing far off
    agreed = np.sum(1.0 / (1.0 + off**4), axis=1)
    size = np.log(np.maximum(np.linalg.norm(turns, axis=-1), 1e-4))
    return np.asarray(turns[int(np.argmax(agreed - _SMALL_ROTATION * size / np.log(10.0)))])


def _rotations_from_pairs(world: FloatArray, rays: FloatArray) -> FloatArray:
    """Return (k, 3): the rotations that pairs of sightings name."""
    pairs = np.array(list(itertools.combinations(range(world.shape[0]), 2)), dtype=np.int64).reshape(-1, 2)
    if pairs.shape[0] > _PAIRS:
        pairs = np.random.default_rng(_SEED).choice(pairs, _PAIRS, replace=False)
    separation = np.minimum(
        _distances_in_pairs(world, pairs), _distances_in_pairs(rays, pairs)
    )  # a frozen camera sees one pixel for all
    pairs = pairs[separation > _LEAST_SEPARATION]
    if pairs.shape[0] == 0:
        return np.zeros((0, 3))
    matrix = triads(rays, pairs) @ np.swapaxes(triads(world, pairs), -1, -2)
    return rotation_vectors(matrix)


def _distances_in_pairs(vectors: FloatArray, pairs: IntArray) -> FloatArray:
    return np.asarray(np.linalg.norm(vectors[pairs[:, 0]] - vectors[pairs[:, 1]], axis=-1))


def triads(vectors: FloatArray, pairs: IntArray) -> FloatArray:
    """Return (k, 3, 3): right-handed axes that each pair spans, its middle first."""
    first, second = vectors[pairs[:, 0]], vectors[pairs[:, 1]]
    middle = first + second
    normal = np.cross(first, second)
    middle = middle / np.maximum(np.linalg.norm(middle, axis=-1, keepdims=True), 1e-12)
    normal = normal / np.maximum(np.linalg.norm(normal, axis=-1, keepdims=True), 1e-12)
    return np.stack([middle, normal, np.cross(middle, normal)], axis=-1)
