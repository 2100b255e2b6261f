"""How often a camera is found by one night's stars alone: rightly, wrongly, or not.

    OMP_NUM_THREADS=1 python docs/studies/blind_start.py --lenses 20 [--kinds clear partly] [--late 0 3600]

Each lens is drawn at random: equidistant, equisolid or stereographic, 150 to 200 degrees across, 640 to 2048 px, tilted
by up to 15 degrees in any direction, mirrored or not, at 55 S to 65 N, its radius off the ideal by 0.4 % of the focal
length, its centre by 2 % of the image. Four images an hour apart. A camera is right where the median of its error over
the sky is below 1 px and at most 1 % of its stars are false.
"""

from __future__ import annotations

import argparse
import math
import time
from dataclasses import replace

import nights
import numpy as np
import population as pop

from sunarc.calibration.answers.covariance import hemisphere
from sunarc.optics.camera import Camera
from sunarc.optics.forward import project
from sunarc.optics.pose import PoseAngles, rotation_from_pose_angles
from sunarc.optics.projections import ideal_radius
from sunarc.sky.night import night_sky
from sunarc.sky.site import Site
from sunarc.stars.blind_start import BlindOptions, NightDetections, blind_start

KINDS = {
    "clear": nights.Night(sigma_px=0.15, faint=150),
    "hazy: 40 % not seen": nights.Night(sigma_px=0.25, faint=80, lost=0.4),
    "town: 65 % not seen": nights.Night(sigma_px=0.3, faint=20, lost=0.65),
    "partly: half behind cloud": nights.Night(sigma_px=0.15, faint=150, cloud_share=0.5, satellites=5),
    "200 hot pixels": nights.Night(sigma_px=0.15, faint=150, hot_pixels=200),
    "overcast": nights.Night(faint=100, lost=1.0, hot_pixels=60),
}
IMAGES, GAP_S = 4, 3600.0


def drawn(seed: int) -> tuple[np.random.Generator, Site, Camera, float]:
    """Return a site, a camera there, and the time of its first image."""
    rng = np.random.default_rng(seed)
    site = Site(latitude=float(rng.uniform(-55, 65)), longitude=float(rng.uniform(-180, 180)), altitude=200.0)
    width = int(rng.integers(640, 2049))
    height = round(width * float(rng.choice([1.0, 1.0, 0.75])))
    projection, across = str(rng.choice(["equidistant", "equisolid", "stereographic"])), rng.uniform(150.0, 200.0)
    short = min(width, height)
    edge = float(ideal_radius(projection, math.radians(0.5 * across)))  # type: ignore[arg-type]
    focal = 0.5 * short * rng.uniform(0.9, 1.05) / edge
    pose = PoseAngles(phi_xz_deg=rng.uniform(-180, 180), theta_zz_deg=rng.uniform(0, 15), psi_z_deg=rng.uniform(0, 360))
    camera = Camera(
        width=width,
        height=height,
        projection=projection,  # type: ignore[arg-type]
        focal_length_px=(focal, focal),
        principal_point_px=(
            0.5 * (width - 1) + rng.normal(0.0, 0.02 * short), 0.5 * (height - 1) + rng.normal(0.0, 0.02 * short),
        ),
        rotation_cam_enu=rotation_from_pose_angles(pose),
        mirrored=bool(rng.integers(2)),
        max_angle=math.radians(0.5 * across),
    )  # fmt: skip
    camera = replace(camera, radial=tuple(pop.radial_coefficients(rng, camera, scale_px=0.004 * focal, length=0.6)))
    day = 86_400.0 * (18_500 + int(rng.integers(3000)))
    midnight = day - site.longitude * 240.0
    return rng, site, camera, midnight + rng.uniform(-3.0, 0.0) * 3600.0


def night_images(
    seed: int, night: nights.Night, late_s: float
) -> tuple[Site, Camera, list[NightDetections], list[list[str]]]:
    """Return the images of a night, with the sky of a clock that is late, and the true names of the detections."""
    rng, site, camera, begin = drawn(seed)
    images, names = [], []
    size = np.array([camera.width, camera.height])
    for when in (begin + GAP_S * np.arange(IMAGES)).tolist():
        stars, known = nights.detections(rng, camera, night_sky(when, site, faintest=5.5), night)
        inside = np.flatnonzero(np.all((stars.pixels > 0.0) & (stars.pixels < size - 1.0), axis=-1))
        sky = night_sky(when + late_s, site, faintest=5.5)
        images.append(NightDetections(unix_s=when, stars=stars.select(inside), sky=sky))
        names.append([known[row] for row in inside])
    return site, camera, images, names


def one(seed: int, night: nights.Night, late_s: float) -> tuple[str, int, int, float, str]:
    """Return right, wrong or refused; false and all named stars; the error, px; and why."""
    site, camera, images, names = night_images(seed, night, late_s)
    found = blind_start(images, site, image_size=(camera.width, camera.height), options=BlindOptions())
    why = found.findings[0].code
    if not found.accepted or found.camera is None:
        return "refused", 0, 0, math.nan, why
    false = total = 0
    rows = zip(images, names, found.predicted, found.stars, found.matches, strict=True)
    for image, known, predicted, stars, matches in rows:
        truth = {tuple(pixel): name for pixel, name in zip(image.stars.pixels.tolist(), known, strict=True)}
        named = zip(matches.star, matches.detection, strict=True)
        wrong = [truth[tuple(stars.pixels[row].tolist())] != str(predicted.names[star]) for star, row in named]
        false, total = false + sum(wrong), total + len(wrong)
    sky = hemisphere(200)
    sky = sky[sky[:, 2] > 0.3]
    error = float(np.nanmedian(np.linalg.norm(project(found.camera, sky) - project(camera, sky), axis=-1)))
    return ("right" if error < 1.0 and false <= 0.01 * total else "wrong"), false, total, error, why


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(prog="blind_start.py", description=__doc__)
    parser.add_argument("--lenses", type=int, default=20)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--kinds", nargs="*", default=list(KINDS), help="words that begin a kind's name")
    parser.add_argument("--late", nargs="*", type=float, default=[0.0], help="seconds that the clock is wrong")
    asked = parser.parse_args()
    print(f"{'night':28s} clock  right refused wrong  false stars  error px (median)  processor s  refusals")
    for name, night in KINDS.items():
        if not any(name.startswith(kind) for kind in asked.kinds):
            continue
        for late in asked.late:
            begin = time.process_time()
            rows = [one(seed, night, late) for seed in range(asked.first, asked.first + asked.lenses)]
            spent = (time.process_time() - begin) / len(rows)
            count = {kind: sum(row[0] == kind for row in rows) for kind in ("right", "refused", "wrong")}
            errors = [row[3] for row in rows if row[0] == "right"] or [math.nan]
            why = sorted({row[4] for row in rows if row[0] == "refused"})
            codes = ", ".join(f"{sum(row[4] == code for row in rows)} {code}" for code in why)
            print(
                f"{name:28s}{late:6.0f} {count['right']:6d} {count['refused']:7d} {count['wrong']:5d}"
                f"  {sum(row[1] for row in rows):4d} of {sum(row[2] for row in rows):6d} {np.median(errors):12.2f}"
                f"  {spent:14.1f}  {codes}",
                flush=True,
            )


if __name__ == "__main__":
    main()
