"""What back-projecting a million pixels costs: from the table, exactly, and by OpenCV's fisheye model.

    OMP_NUM_THREADS=1 python docs/studies/back_projection_speed.py [--pixels 1000000] [--repeats 7]

Prints processor milliseconds per million pixels on one thread (the least of the repeats) for lenses of 1748 × 1748 px,
with and without decentering and with a displacement, and how far the table's directions are from the exact ones, as px
in the image. OpenCV's is the equidistant lens with its four odd powers, which has no decentering: its own inverse, and
how far that misses the pixels that it was given.
"""

from __future__ import annotations

import argparse
import math
from dataclasses import replace
from functools import partial

import cv2
import numpy as np
import population as pop
from fit_speed import cost_ms
from numpy.typing import NDArray

from sunarc.optics.camera import Camera
from sunarc.optics.displacement import wave_basis
from sunarc.optics.forward import project
from sunarc.optics.inverse import unproject
from sunarc.optics.inverse_table import inverse_table

FloatArray = NDArray[np.float64]

_FIELD_PX = 0.3
_EDGE_DEG = 89.0
"""OpenCV's model ends below a right angle."""


def lenses() -> dict[str, Camera]:
    """Return the cameras that are measured."""
    full = pop.random_camera(np.random.default_rng(4))
    basis = wave_basis(width=pop.SIZE, height=pop.SIZE, shortest_px=300.0, longest_px=600.0)
    spread = _FIELD_PX * np.sqrt(basis.variances(length_px=425.0))
    drawn = spread * np.random.default_rng(5).standard_normal((2, spread.size))
    fisheye = replace(
        full,
        projection="equidistant",
        focal_length_px=(540.0, 540.0),
        skew_px=0.0,
        radial=(0.0, -0.01, 0.0, 0.004, 0.0, -0.002, 0.0, 0.0005),
        decentering=(0.0,) * 4,
    )
    return {
        "radial polynomial": replace(full, decentering=(0.0,) * 4),
        "and decentering": full,
        "and displacement": replace(full, displacement=basis.displacement(drawn)),
        "odd powers alone": fisheye,
    }


def pixels_of(camera: Camera, count: int) -> FloatArray:
    """Return pixels (count, 2) spread over the image circle."""
    rng = np.random.default_rng(6)
    sine, azimuth = (
        math.sin(math.radians(_EDGE_DEG) / 2.0),
        rng.uniform(0.0, 2.0 * math.pi, count),
    )
    theta = 2.0 * np.arcsin(sine * np.sqrt(rng.uniform(0.0, 1.0, count)))
    level = np.stack(
        [
            np.sin(theta) * np.cos(azimuth),
            np.sin(theta) * np.sin(azimuth),
            np.cos(theta),
        ],
        axis=-1,
    )
    return project(replace(camera, rotation_cam_enu=(0.0, 0.0, 0.0)), level)


def ours(camera: Camera, pixels: FloatArray, repeats: int) -> str:
    """Return what the table and the exact inverse cost, and how far the table is off."""
    table = inverse_table(camera)
    tabulated = 1e6 / len(pixels) * cost_ms(partial(table.directions, pixels), repeats)
    exact = 1e6 / len(pixels) * cost_ms(partial(unproject, camera, pixels), 1)
    apart = float(np.nanmax(np.abs(project(camera, table.directions(pixels)) - pixels)))
    return f"table {tabulated:7.1f} ms, {apart:.0e} px; exact {exact:8.1f} ms"


def by_opencv(camera: Camera, pixels: FloatArray, repeats: int) -> str:
    """Return what OpenCV's own inverse costs and misses by."""
    scale = [(2.0 / math.pi) ** n for n in (3, 5, 7, 9)]
    distortion = np.array([k * s for k, s in zip(camera.radial[1::2], scale, strict=True)])
    (fx, fy), (x0, y0) = camera.focal_length_px, camera.principal_point_px
    matrix = np.array([[fx, 0.0, x0], [0.0, fy, y0], [0.0, 0.0, 1.0]])
    given = pixels[:, None]

    def undistorted() -> FloatArray:
        return np.asarray(cv2.fisheye.undistortPoints(given, matrix, distortion), dtype=np.float64)

    took = 1e6 / len(pixels) * cost_ms(undistorted, repeats)
    found = undistorted()[:, 0]
    good = np.all(found > -1e5, axis=-1)  # OpenCV writes -1e6 where its iteration did not converge
    again = cv2.fisheye.distortPoints(found[good][:, None], matrix, distortion)[:, 0]
    off = float(np.max(np.abs(again - pixels[good])))
    return f"{took:13.1f} ms, {off:.0e} px, no answer for {1.0 - good.mean():.1%}"


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--pixels", type=int, default=1_000_000)
    parser.add_argument("--repeats", type=int, default=7)
    chosen = parser.parse_args()
    cv2.setNumThreads(1)
    for name, camera in lenses().items():
        print(
            f"{name:26s}{ours(camera, pixels_of(camera, chosen.pixels), chosen.repeats)}",
            flush=True,
        )
    print(f"{'cv2.fisheye':26s}{by_opencv(camera, pixels_of(camera, chosen.pixels), chosen.repeats)}")


if __name__ == "__main__":
    main()
