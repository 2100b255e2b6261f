"""How well the moon is located by its lit limb, beside the bound of Cramér and Rao and the middle of its light.

    OMP_NUM_THREADS=1 python docs/studies/moon.py [--moons 30]

Rendered by brute force (a sphere with seas in sunlight, three laws of brightness, an astigmatic point spread with
wings, shot and read noise of a 12 bit sensor of 20,000 electrons; tests/detection/moon/rendering.py), at random places,
limb angles and peaks of 0.2 to 0.8. Bound: of counts with that noise, everything but the place known.
"""

from __future__ import annotations

import argparse
import math
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from tests.detection.moon.rendering import READ_E, WELL_E, Moon, render
from tests.detection.moon.test_detect import drawn, error, look

_STEP_PX = 0.05


def bound_px(moon: Moon) -> float:
    """Return the least 1-sigma per axis of an estimate without bias, px, of the noise alone."""
    full = 2**moon.bits - 1
    images = [
        render(replace(moon, x=moon.x + dx, y=moon.y + dy), noise=False).astype(float)
        for dx, dy in ((-_STEP_PX, 0.0), (_STEP_PX, 0.0), (0.0, -_STEP_PX), (0.0, _STEP_PX))
    ]
    slopes = np.stack([images[1] - images[0], images[3] - images[2]]) / (2.0 * _STEP_PX) * WELL_E / full
    variance = images[0] * WELL_E / full + READ_E**2
    information = np.einsum("iab,jab->ij", slopes / variance, slopes)
    return float(math.sqrt(0.5 * np.trace(np.linalg.inv(information))))


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(prog="moon.py", description=__doc__)
    parser.add_argument("--moons", type=int, default=30)
    asked = parser.parse_args()
    rng = np.random.default_rng(3)
    print(
        "radius px, colours, phase deg: error px (rms per axis), stated, error / stated, bound, middle of light off px"
    )
    for radius, bayer in ((2.7, None), (2.7, "RGGB"), (5.0, None)):
        for phase in (5.0, 45.0, 90.0, 125.0, 150.0):
            errors, sigmas, bounds, off = [], [], [], []
            for number in range(asked.moons):
                law = ("mixed", "seeliger", "lambert")[number % 3]
                moon = drawn(rng, radius_px=radius, bayer=bayer, phase_deg=phase, law=law)
                found = look(moon, seed=number, off=rng.normal(0.0, 1.0, 2))
                if not found.accepted or found.sigma_px is None:
                    print(f"refused: {found.findings[0].code}")
                    continue
                errors.append(error(moon, found))
                sigmas.append(found.sigma_px)
                if number < 3:
                    bounds.append(bound_px(moon))
                off.append(float(np.linalg.norm(moon.centroid_px - [moon.x, moon.y])))
            rms = float(np.sqrt(np.mean(np.square(errors))))
            ratio = float(np.sqrt(np.mean(np.square(np.array(errors) / np.array(sigmas)[:, None]))))
            print(
                f"{radius} {bayer or 'mono'} {phase:5.0f}: {rms:.3f} {np.median(sigmas):.3f} {ratio:.2f} "
                f"{np.median(bounds):.4f} {np.median(off):.2f}",
                flush=True,
            )


if __name__ == "__main__":
    main()
