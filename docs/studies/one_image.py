"""How often one image of the night gives a camera: rightly, wrongly, or not; its judge shares no code with the search.

    OMP_NUM_THREADS=1 python docs/studies/one_image.py --lenses 20 [--kinds clear "half"] [--rendered]

Cameras are drawn (`one_image_world`): four shapes of lens, focal lengths of 0.6 to 1.7 of what the image suggests,
tilted by up to 15 degrees, mirrored or not, at 55 S to 65 N. Under "wrong" the time or the place that is stated is not
the true one (the cameras are then level to 3 degrees, as most mounts are): no camera is right. Right is a camera with
the true handedness whose error is below 1 px (median over the sky down to 75 degrees) and of whose names at most 1 %
are false.
"""

from __future__ import annotations

import argparse
import math
import time
from collections import Counter

import numpy as np
import one_image_world as world
from numpy.typing import NDArray

from sunarc.detection.stars.detect import detect_stars
from sunarc.detection.values import Stars
from sunarc.optics.forward import project
from sunarc.sky.night import night_sky
from sunarc.sky.site import Site
from sunarc.stars.blind_start import BlindOptions, BlindStart, NightDetections, blind_start

KINDS = {
    "clear": world.Sky(),
    "town": world.Sky(limit=3.8, faint=30, lost=0.1),
    "half behind a bank of cloud": world.Sky(clouds=0.5, edges=40),
    "half behind patches of cloud": world.Sky(clouds=0.5, patches=True, edges=60),
    "150 hot pixels": world.Sky(hot=150),
    "moon": world.Sky(limit=4.0, glare_deg=25.0, faint=40),
    "lamps, trails, text, cloud, moon": world.Sky(
        limit=4.5, clouds=0.3, edges=40, hot=40, lamps=12, trail=1, text=20, glare_deg=20.0
    ),
}
FALSE = {
    "overcast: hot pixels, lamps, edges": world.Sky(stars=False, hot=120, lamps=20, edges=120, faint=60),
    "overcast: hot pixels, cosmic rays": world.Sky(stars=False, hot=60, rays=300, faint=0),
    "overcast: text, trails, few lights": world.Sky(stars=False, hot=15, lamps=8, text=30, trail=3, faint=15),
}
WRONG = {  # hours of the clock, degrees of latitude and longitude
    "wrong: clock by an hour": (1.0, 0.0, 0.0),
    "wrong: clock by 2 to 11 hours": (math.nan, 0.0, 0.0),
    "wrong: longitude's sign": (0.0, 0.0, math.inf),
    "wrong: latitude by 25 to 60 degrees": (0.0, math.nan, 0.0),
    "wrong: another site": (0.0, math.inf, math.nan),
    "a tilt: latitude by 8 to 18 degrees": (0.0, -math.inf, 0.0),
}
"""The last is what a tilt of as much looks like: accepted where it is said that the camera is tilted."""
MADE = {**KINDS, **FALSE, **dict.fromkeys(WRONG, KINDS["clear"])}


def detections(shot: world.Shot) -> Stars:
    """Return what a detector gives."""
    one = np.ones(shot.flux.size)
    return Stars(
        pixels=shot.pixels, sigma_px=shot.sigma, flux=shot.flux, snr=1500.0 * shot.flux, peak_fraction=0.5 * one,
        width_px=1.2 * one, ellipticity=0.1 * one, saturated=one < 0.0,
    )  # fmt: skip


def stated(rng: np.random.Generator, kind: str, latitude: float, longitude: float) -> tuple[float, float, float]:
    """Return by how many seconds the stated time is late, and the stated place."""
    hours, north, east = WRONG.get(kind, (0.0, 0.0, 0.0))
    hours = (
        float(rng.choice([-1, 1]) * rng.uniform(2.0, 11.0)) if math.isnan(hours) else hours * rng.choice([-1.0, 1.0])
    )
    if math.isnan(north) or north < 0.0:
        least, most = (25.0, 60.0) if math.isnan(north) else (8.0, 18.0)
        latitude -= math.copysign(float(rng.uniform(least, most)), latitude)
    elif math.isinf(north):
        latitude = float(rng.uniform(-60.0, 65.0))
    longitude = -longitude if math.isinf(east) else longitude
    if math.isnan(east):
        longitude = float(rng.uniform(-180.0, 180.0))
    return 3600.0 * hours, float(np.clip(latitude, -80.0, 80.0)), longitude


def one(
    kind: str, seed: int, *, rendered: bool = False, level_within: float | None = None
) -> tuple[str, str, float, float, int, int]:
    """Return right, wrong or refused; why; the error, px; the chance; and false and all names."""
    rng = np.random.default_rng(seed)
    latitude, longitude = rng.uniform(-55.0, 65.0), rng.uniform(-180.0, 180.0)
    if abs(longitude) < 20.0 and "sign" in kind:
        longitude += math.copysign(20.0, longitude)
    wrong = kind in WRONG
    lens = world.draw_lens(rng, tilt_deg=3.0 if wrong else 15.0)
    when = 1.6e9 + rng.uniform(0.0, 2.0e8)
    directions, magnitude = world.equatorial(when)
    directions = world.horizontal(directions, when, latitude, longitude)
    shot = world.shoot(rng, lens, MADE[kind], directions, magnitude)
    late, latitude, longitude = stated(rng, kind, latitude, longitude)
    site = Site(latitude=latitude, longitude=longitude, altitude=0.0)
    sky = night_sky(when + late, site, faintest=5.5)
    seen = detect_stars(world.render(rng, lens, MADE[kind], shot), full_scale=255) if rendered else detections(shot)
    image = NightDetections(unix_s=when + late, stars=seen, sky=sky)
    known = BlindOptions(level_within_deg=level_within)
    found = blind_start([image], site, image_size=lens.size, options=known)
    why, chance = (
        found.findings[0].code,
        [one.data["log10_chance"] for one in found.findings if "log10_chance" in one.data],
    )
    if not found.accepted or found.camera is None:
        return "refused", why, math.nan, float(chance[0]) if chance else math.nan, 0, 0
    places = rng.standard_normal((600, 3))
    places /= np.linalg.norm(places, axis=-1, keepdims=True)
    places = places[places[:, 2] > math.cos(math.radians(75.0))]
    apart = np.linalg.norm(project(found.camera, places) - lens.pixels(places), axis=-1)
    error = float(np.nanmedian(apart))
    false, total = names(found, lens.pixels(directions))
    tilted = any(finding.code.startswith("camera_tilted") for finding in found.findings)
    wrong = wrong and not (kind.startswith("a tilt") and tilted)
    if kind.startswith("a tilt"):
        return "wrong" if wrong else "right", why, math.nan, float(chance[0]), false, total
    good = not wrong and kind not in FALSE and error < 1.0 and found.camera.mirrored == lens.mirrored
    return "right" if good and false <= 0.01 * total else "wrong", why, error, float(chance[0]), false, total


def names(found: BlindStart, places: NDArray[np.float64]) -> tuple[int, int]:
    """Return how many named detections are further than 3 px from any light of the sky, and how many are named."""
    false = total = 0
    for stars, matches in zip(found.stars, found.matches, strict=True):
        pixels = stars.pixels[matches.detection]
        apart = np.linalg.norm(pixels[:, None] - places[np.isfinite(places[:, 0])], axis=-1).min(axis=-1)
        false, total = false + int(np.sum(apart > 3.0)), total + pixels.shape[0]
    return false, total


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(prog="one_image.py", description=__doc__)
    parser.add_argument("--lenses", type=int, default=20)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--kinds", nargs="*", default=[*KINDS, *FALSE, *WRONG], help="words that begin a kind's name")
    parser.add_argument("--rendered", action="store_true", help="draw images, and detect the stars in them")
    parser.add_argument("--level-within", type=float, help="how level the cameras are said to stand, degrees")
    asked = parser.parse_args()
    print(f"{'image':36s} right refused wrong  error, px (median, 90 %)  false names  log10 chance  s  why refused")
    for kind in [*KINDS, *FALSE, *WRONG]:
        if not any(kind.startswith(word) for word in asked.kinds):
            continue
        begin = time.process_time()
        seeds = range(asked.first, asked.first + asked.lenses)
        rows = [one(kind, n, rendered=asked.rendered, level_within=asked.level_within) for n in seeds]
        spent = (time.process_time() - begin) / len(rows)
        count = Counter(row[0] for row in rows)
        errors = np.array([row[2] for row in rows if row[0] == "right"] or [math.nan])
        chances = np.array([row[3] for row in rows])
        why = Counter(row[1] for row in rows if row[0] == "refused")
        print(
            f"{kind:36s} {count['right']:5d} {count['refused']:7d} {count['wrong']:5d}  {np.median(errors):6.2f}"
            f" {np.quantile(errors, 0.9):6.2f}  {sum(row[4] for row in rows):4d} of {sum(row[5] for row in rows):6d}"
            f"  {np.nanmin(chances) if np.isfinite(chances).any() else math.nan:7.1f}  {spent:4.1f}  {dict(why)}",
            flush=True,
        )


if __name__ == "__main__":
    main()
