"""How often a night is matched by a right and by a wrong calibration, and how many matches are false.

    OMP_NUM_THREADS=1 python docs/studies/night_matching.py --lenses 25

Each lens is calibrated by a clear day of its own (sigma 0.03 px, or 0.03 px and a field of 0.3 px that no model knows);
its prediction is then matched with one image of the night, or with a wrong one.
"""

from __future__ import annotations

import argparse
import math
from dataclasses import replace

import nights
import numpy as np
import population as pop

from sunarc.calibration.calibrate import calibrate
from sunarc.calibration.model.options import CalibrationOptions
from sunarc.calibration.model.result import Calibration
from sunarc.detection.stars.matching import match_stars, sky_motion, standing_still
from sunarc.optics.camera import Camera
from sunarc.optics.pose import rotation_matrix, rotation_vector

NIGHTS = {
    "clear": nights.Night(),
    "hazy: a third is not seen": nights.Night(lost=0.33, sigma_px=0.2),
    "half behind cloud": nights.Night(cloud_share=0.5),
    "10 satellites": nights.Night(satellites=10),
    "300 hot pixels": nights.Night(hot_pixels=300),
    "300 hot pixels, two images": nights.Night(hot_pixels=300),
    "overcast: lamps and noise": nights.Night(lost=1.0, hot_pixels=60),
}
WRONG = ("lens 10 % off", "lens 2 % off", "north 90 degrees off", "north 5 degrees off", "mirrored",
         "clock 10 minutes off", "clock 1 hour off", "another camera")  # fmt: skip


def day_of(rng: np.random.Generator, camera: Camera, field: pop.Field | None) -> Calibration:
    """Return the calibration of one clear day."""
    times = pop.sun_track(np.zeros(1), cadence_s=60.0)
    points = pop.sightings(camera, times, pop.white_noise(rng, times.size, 0.03), field=field)
    return calibrate(points, site=pop.SGP, image_size=(pop.SIZE, pop.SIZE), options=CalibrationOptions())


def wrong_camera(name: str, camera: Camera, rng: np.random.Generator) -> tuple[Camera, float]:
    """Return a camera that is wrong as a name says, and by how many seconds the clock is."""
    focal = camera.focal_length_px
    turn = {"north 90 degrees off": 90.0, "north 5 degrees off": 5.0}.get(name, 0.0)
    scale = {"lens 10 % off": 1.1, "lens 2 % off": 1.02}.get(name, 1.0)
    late = {"clock 10 minutes off": 600.0, "clock 1 hour off": 3600.0}.get(name, 0.0)
    if name == "another camera":
        return pop.random_camera(rng), 0.0
    about = rotation_matrix((0.0, 0.0, math.radians(turn)))
    return replace(
        camera,
        focal_length_px=(focal[0] * scale, focal[1] * scale),
        rotation_cam_enu=rotation_vector(rotation_matrix(camera.rotation_cam_enu) @ about),
        mirrored=name == "mirrored",
    ), late


def main() -> None:
    """Print the two tables."""
    parser = argparse.ArgumentParser(prog="night_matching.py", description=__doc__)
    parser.add_argument("--lenses", type=int, default=25)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--field", type=float, default=0.3, help="px")
    asked = parser.parse_args()
    good: dict[str, list[tuple[int, int, int]]] = {}
    bad: dict[str, list[tuple[int, int]]] = {}
    for seed in range(asked.first, asked.first + asked.lenses):
        rng = np.random.default_rng(seed)
        camera = pop.random_camera(rng)
        field = pop.smooth_field(rng, amplitude_px=asked.field, length_px=425.0) if asked.field else None
        day = day_of(rng, camera, field)
        when = nights.MIDNIGHT + 86_400.0 * float(rng.integers(365)) + float(rng.uniform(-2.0, 2.0)) * 3600.0
        sky = nights.sky_of(when)
        for name, night in NIGHTS.items():
            stars, names = nights.detections(rng, camera, sky, replace(night, field=field))
            expected = nights.predicted(day, when)
            if name.endswith("two images"):
                later, _ = nights.detections(rng, camera, nights.sky_of(when + 1800.0), replace(night, field=field))
                moved = sky_motion(stars, expected, nights.predicted(day, when + 1800.0))
                still = standing_still(stars, later, moved_px=moved)
                stars, names = stars.select(~still), [names[row] for row in np.flatnonzero(~still)]
            matched = match_stars(stars, expected)
            wrong = int(np.sum(~nights.is_right(names, expected, matched.star, matched.detection)))
            good.setdefault(name, []).append((int(matched.accepted), matched.star.size, wrong))
        stars, names = nights.detections(rng, camera, sky, nights.Night(field=field))
        for name in WRONG:
            false, late = wrong_camera(name, day.camera, rng)
            for within in (0.0, 1.0, 2.0, 4.0, 8.0):
                expected = nights.predicted(nights.with_camera(day, false), when + late, within_px=within)
                matched = match_stars(stars, expected)
                right = nights.is_right(names, expected, matched.star, matched.detection)
                bad.setdefault(name, []).append((int(matched.accepted), int(matched.accepted and right.mean() < 0.99)))
    print(f"{'right calibration':30s} accepted  stars (median)  false matches")
    for name, rows in good.items():
        accepted, count, wrong = np.array(rows).T
        usual = float(np.median(count[accepted > 0])) if accepted.any() else 0.0
        print(f"{name:30s} {accepted.sum():3d} of {accepted.size:3d}  {usual:7.0f}  {wrong.sum():6d} of {count.sum()}")
    print(f"{'wrong calibration':30s} accepted, of them with wrong stars (0, 1, 2, 4, 8 px beside its own uncertainty)")
    for name, found in bad.items():
        accepted, false_stars = np.array(found).sum(axis=0)
        print(f"{name:30s} {accepted:3d} of {len(found):3d}  {false_stars}")


if __name__ == "__main__":
    main()
