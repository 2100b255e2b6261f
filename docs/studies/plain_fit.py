"""The error over the sky beside that of a plain least-squares fit of the same sightings.

    OMP_NUM_THREADS=1 python docs/studies/plain_fit.py --lenses 12 [--rho 0.9] [--sigma 0.5] [--terms 3]

The plain fit is scipy's `least_squares` with its soft L1 loss: focal length, centre, pose, two coefficients of
decentering and some of the radius with wide priors, begun 2 degrees from the truth. Printed for every lens, and as
medians: RMS errors over the sky, px, and their ratio.
"""

from __future__ import annotations

import argparse

import numpy as np
import population as pop
from numpy.typing import NDArray
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from sunarc.calibration.answers.covariance import hemisphere
from sunarc.calibration.calibrate import calibrate
from sunarc.optics.camera import Camera
from sunarc.optics.forward import project
from sunarc.optics.pose import rotation_matrix

FloatArray = NDArray[np.float64]


def plain_pixels(unknowns: FloatArray, directions: FloatArray) -> FloatArray:
    """Return pixels (n, 2) of directions (n, 3): an equisolid lens with powers of the angle and Brown's p1 and p2."""
    (focal, x0, y0), turn, (p1, p2), radial = unknowns[:3], unknowns[3:6], unknowns[6:8], unknowns[8:]
    ray = directions @ Rotation.from_rotvec(turn).as_matrix().T
    angle, across = np.arctan2(np.hypot(ray[:, 0], ray[:, 1]), ray[:, 2]), np.hypot(ray[:, 0], ray[:, 1])
    powers = (angle[:, None] / (np.pi / 2.0)) ** np.arange(2, 2 + radial.size)
    radius = 2.0 * np.sin(angle / 2.0) + powers @ radial
    x, y = ray[:, 0] / across * radius, ray[:, 1] / across * radius
    square = radius**2
    x, y = x + p1 * (square + 2.0 * x * x) + 2.0 * p2 * x * y, y + p2 * (square + 2.0 * y * y) + 2.0 * p1 * x * y
    return np.stack([x0 + focal * x, y0 + focal * y], axis=-1)


def plain_fit(
    truth: Camera, directions: FloatArray, pixels: FloatArray, *, sigma_px: float, terms: int, rng: np.random.Generator
) -> FloatArray:
    """Return the unknowns of the plain fit."""
    tilted = Rotation.from_rotvec(np.radians(2.0) * np.array(rng.normal(size=3)) / np.sqrt(3.0)).as_matrix()
    turn = Rotation.from_matrix(tilted @ rotation_matrix(truth.rotation_cam_enu)).as_rotvec()
    middle = (pop.SIZE - 1) / 2.0
    start = np.array([600.0, middle, middle, *turn, *np.zeros(2 + terms)])
    # what a maker of lenses knows: 2 % of the focal length, the centre to 10 px, 3 px of distortion at the edge
    spread = np.array([12.0, 10.0, 10.0, *[np.inf] * 3, *[2e-4] * 2, *[0.005] * terms])

    def residuals(unknowns: FloatArray) -> FloatArray:
        off = (plain_pixels(unknowns, directions) - pixels) / sigma_px
        return np.concatenate([off.ravel(), (unknowns - start) / spread])

    scale = np.array([*[1.0] * 3, *[1e-3] * 3, *[1e-4] * 2, *[1e-3] * terms])
    found = least_squares(residuals, start, loss="soft_l1", f_scale=2.0, x_scale=scale)
    return np.asarray(found.x)


def main() -> None:
    """Print a line a lens, and the medians."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--lenses", type=int, default=12)
    parser.add_argument("--rho", type=float, default=0.9)
    parser.add_argument("--sigma", type=float, default=0.5)
    parser.add_argument("--terms", type=int, default=3)
    chosen = parser.parse_args()
    sky, sun, rows = hemisphere(1000), pop.track((0,), cadence_s=30.0), []
    for seed in range(1000, 1000 + chosen.lenses):
        rng = np.random.default_rng(seed)
        truth = pop.random_camera(rng)
        noise = pop.correlated_noise(rng, sun.unix_s.size, chosen.sigma, chosen.rho)
        points = pop.sightings_of(truth, sun.unix_s, sun.directions, noise, field=None)
        fit = calibrate(points, site=pop.SGP, image_size=(pop.SIZE, pop.SIZE))
        plain = plain_fit(
            truth,
            sun.directions,
            project(truth, sun.directions) + noise,
            sigma_px=chosen.sigma,
            terms=chosen.terms,
            rng=rng,
        )
        expected = project(truth, sky)
        errors = [project(fit.camera, sky) - expected, plain_pixels(plain, sky) - expected]
        rows.append([float(np.sqrt(np.nanmean(np.sum(error**2, axis=-1)))) for error in errors])
        print(seed, f"ours {rows[-1][0]:.3f} px, plain {rows[-1][1]:.3f} px, {fit.verdict.accepted}", flush=True)
    ours, plain_px = np.array(rows).T
    print(
        f"median: ours {np.median(ours):.3f} px, plain {np.median(plain_px):.3f}; ratio of the medians "
        f"{np.median(ours) / np.median(plain_px):.2f}, median ratio {np.median(ours / plain_px):.2f}"
    )


if __name__ == "__main__":
    main()
