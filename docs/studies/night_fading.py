"""Whether the light that stars lose in a night tells dew on the dome from haze: magnitudes drawn, without images.

    OMP_NUM_THREADS=1 python docs/studies/night_fading.py --nights 60

In each image the brightness of the stars to V 4 above 12 degrees is fitted by a level above the air and an extinction
for each air mass. Dew takes the same share everywhere, haze a share of each air mass: printed is by how much the
level falls from the first third of nine images to the last, magnitudes, and by how much the extinction grows.
"""

from __future__ import annotations

import argparse
from functools import cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from sunarc.common.robust_statistics import biweights, mad_sigma
from sunarc.lab.simulation.truth import SGP
from sunarc.sky.directions import angles_from_direction
from sunarc.sky.night import night_sky
from sunarc.sky.site import relative_air_mass

BEGIN_UNIX_S = 1_368_421_200.0
"""2013-05-13 05:00 UTC: night at the site until 10 h."""
IMAGES, STEP_S = 9, 2400.0
LARGEST_ZENITH_DEG = 78.0
EXTINCTION, CHANGE = 0.25, 0.02
"""Magnitudes an air mass of the clear sky, and its 1-sigma from image to image."""
COLOUR_MAG, NOISE_MAG = 0.15, 0.05
"""1-sigma of what a star differs from its V by its colour, the same in all images, and of one measurement."""
FAINTEST_SEEN = 5.75
"""V, with the light that is lost: fainter ones are not detected."""
FEWEST = 25
CASES = (
    ("clear", 0.0), ("dew", 0.3), ("dew", 0.4), ("haze", 0.4), ("haze", 0.8), ("near the ground", 0.4),
    ("from one side", 0.4), ("from one side", 0.8), ("in patches", 0.4), ("in patches", 0.8),
)  # fmt: skip

Array = NDArray[np.float64]


class Image(NamedTuple):
    """Stars above the horizon: names, V, air mass, zenith angle and azimuth in radians, (n,) each."""

    names: NDArray[Any]
    magnitude: Array
    air_mass: Array
    zenith: Array
    azimuth: Array


@cache
def image(number: int) -> Image:
    """Return the stars of an image of the night."""
    sky = night_sky(BEGIN_UNIX_S + number * STEP_S, SGP, faintest=4.0)
    zenith, azimuth = (np.asarray(angle) for angle in angles_from_direction(sky.directions))
    up = zenith < LARGEST_ZENITH_DEG
    air = relative_air_mass(zenith[up])
    return Image(sky.names[up], sky.magnitude[up], air, np.radians(zenith[up]), np.radians(azimuth[up]))


def lost(one: Image, kind: str, size: float, side: float, rng: np.random.Generator) -> Array:
    """Return the magnitudes that a dome or the air takes of the stars, (n,)."""
    if kind == "dew":
        return np.full(one.air_mass.size, size)
    haze = size * one.air_mass
    if kind == "near the ground":
        return np.asarray(haze * np.sqrt(one.air_mass) / 1.5)
    if kind == "from one side":
        return np.asarray(haze * (1.0 + np.sin(one.zenith) * np.cos(one.azimuth - side)))
    if kind == "in patches":
        return np.asarray(haze * rng.lognormal(-0.3, 0.8, haze.size))
    return np.asarray(haze)


def level_and_extinction(brightness: Array, air_mass: Array) -> Array:
    """Return the level above the air and the magnitudes an air mass of one image, without its outliers."""
    design, weight = np.column_stack([np.ones(air_mass.size), -air_mass]), np.ones(air_mass.size)
    for _ in range(12):
        rows = np.sqrt(weight)
        found = np.linalg.lstsq(design * rows[:, None], brightness * rows, rcond=None)[0]
        residual = brightness - design @ found
        weight = biweights(residual / (4.7 * max(mad_sigma(residual), 0.02)))
    return np.asarray(found)


def night(rng: np.random.Generator, kind: str, size: float) -> tuple[float, float]:
    """Return by how much the level falls and the extinction grows in one night that a loss comes into."""
    colours = dict(zip(image(0).names.tolist(), rng.normal(0.0, COLOUR_MAG, image(0).names.size), strict=True))
    side, fits = rng.uniform(0.0, 2.0 * np.pi), []
    for number in range(IMAGES):
        one = image(number)
        own = np.array([colours.setdefault(name, rng.normal(0.0, COLOUR_MAG)) for name in one.names.tolist()])
        clear = (EXTINCTION + rng.normal(0.0, CHANGE)) * one.air_mass
        loss = clear + number / (IMAGES - 1) * lost(one, kind, size, side, rng)
        seen = one.magnitude + loss < FAINTEST_SEEN
        if int(seen.sum()) >= FEWEST:
            brightness = own - loss + rng.normal(0.0, NOISE_MAG, loss.size)
            fits.append(level_and_extinction(brightness[seen], one.air_mass[seen]))
    third = len(fits) // 3
    if third == 0:
        return np.nan, np.nan
    first, last = np.median(fits[:third], axis=0), np.median(fits[-third:], axis=0)
    return float(first[0] - last[0]), float(last[1] - first[1])


def main() -> None:
    """Print a row for each kind of night."""
    parser = argparse.ArgumentParser(prog="night_fading.py", description=__doc__)
    parser.add_argument("--nights", type=int, default=60, help="of each kind")
    parser.add_argument("--seed", type=int, default=1, help="of the random numbers")
    asked = parser.parse_args()
    rng = np.random.default_rng(asked.seed)
    print("| what comes | magnitudes | fall of the level: 1 %, median, 99 % | growth of the extinction, median |")
    print("|---|---|---|---|")
    for kind, size in CASES:
        found = np.array([night(rng, kind, size) for _ in range(asked.nights)])
        low, middle, high = np.nanpercentile(found[:, 0], [1.0, 50.0, 99.0])
        print(
            f"| {kind} | {size} | {low:.2f}, {middle:.2f}, {high:.2f} | {np.nanmedian(found[:, 1]):.2f} |", flush=True
        )


if __name__ == "__main__":
    main()
