"""A second generator of the benchmark's rounds: it shares no code with the first, nor with what is judged.

    python docs/studies/benchmark_second.py --cases 12 --seed 7 --out ROUND

Suns are SOFA's, lenses and domes are those of `independent_world.py`, and one is held by no formula of
the fit. Written are `cases/` and `truth/`, as docs/benchmark/README.md has them.
"""

from __future__ import annotations

import argparse
import csv
import hashlib
import json
import math
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path

import independent_world as world
import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
LENSES = ("equisolid", "equidistant", "stereographic", "nonsquare", "decentred", "dome", "smeared", "polynomial")
CONDITIONS = ("clear", "correlated", "heavy_tailed", "half_day", "moved_mount", "drifting_clock", "ten_minutes")
_QUERIES, _STEP_DEG, _MOUNT_DEG = 300, 0.005, 5.0
_POLYNOMIAL = np.array([0.0, -0.004, 0.011, -0.009])
"""Of the angle's third to sixth powers, in focal lengths: 3 px at the horizon that change over 20 degrees."""


def lens_of(kind: str, rng: np.random.Generator) -> world.Lens:
    """Draw a lens of a kind."""
    drawn = world.drawn_lens(rng, decentering_px=5.0 if kind == "decentred" else None)
    if kind in {"equidistant", "stereographic"}:
        focal = drawn.focal_px * {"equidistant": 0.88, "stereographic": 0.7}[kind]
        return replace(drawn, projection=kind, focal_px=focal)
    if kind == "nonsquare":
        return replace(drawn, wide=1.0 + float(rng.uniform(0.01, 0.05)))
    if kind == "dome":
        return replace(drawn, bend=world.dome(rng, displaced_mm=3.0))
    if kind == "smeared":
        return replace(drawn, smear=world.smooth_field(rng, size_px=0.3, length_px=400.0))
    if kind == "polynomial":
        focal = drawn.focal_px * 0.88
        signs = rng.choice([-1.0, 1.0])

        def residual(angle: FloatArray) -> FloatArray:
            powers = (np.asarray(angle)[..., None] / 1.6) ** np.arange(3, 7)
            return np.asarray(signs * focal * (powers @ _POLYNOMIAL) + 1.5 * np.sin(7.0 * angle) * angle)

        return replace(drawn, projection="equidistant", focal_px=focal, residual_px=residual)
    return drawn


def errors_of(condition: str, rng: np.random.Generator, count: int) -> FloatArray:
    """Draw the errors (count, 2) of sightings, px."""
    noise = rng.normal(0.0, 0.3, (count, 2))
    if condition == "correlated":
        for k in range(1, count):
            noise[k] = 0.9 * noise[k - 1] + math.sqrt(0.19) * noise[k]
    if condition == "heavy_tailed":
        far = rng.random(count) < 0.2
        noise[far] += rng.standard_t(2, (int(far.sum()), 2)) * 4.0
    return noise


def tangents(directions: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return unit vectors towards larger zenith angles, and towards larger azimuths."""
    east, north, up = directions.T
    flat = np.hypot(east, north)
    down = np.stack([up * east / flat, up * north / flat, -flat], axis=-1)
    return down, np.stack([north / flat, -east / flat, np.zeros_like(flat)], axis=-1)


def angles(directions: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return zenith angles and azimuths, degrees."""
    east, north, up = directions.T
    return np.degrees(np.arctan2(np.hypot(east, north), up)), np.degrees(np.arctan2(east, north)) % 360.0


def inside(pixels: FloatArray) -> NDArray[np.bool_]:
    """Return which pixels are of the image."""
    return np.asarray(np.all((pixels >= 0.0) & (pixels <= world.SIZE - 1.0), axis=-1))


def table(path: Path, header: str, rows: list[list[str]]) -> None:
    """Write a table."""
    with path.open("w", newline="", encoding="utf-8") as file:
        csv.writer(file, lineterminator="\n").writerows([header.split(","), *rows])


def write_truth(path: Path, lens: world.Lens, apparent: FloatArray, rng: np.random.Generator) -> FloatArray:
    """Write what is true of pixels all over the sky, and return these (m, 2)."""
    every = world.hemisphere(4 * _QUERIES)[:-4]
    seen = lens.project(every)
    rows = np.flatnonzero(inside(seen))
    rows = np.sort(rng.permutation(rows)[:_QUERIES])
    asked, sky = seen[rows], every[rows]
    slopes = []
    for side in tangents(sky):
        step = math.radians(_STEP_DEG) * side
        ends = [lens.project(sky + sign * step) for sign in (1.0, -1.0)]
        slopes.append((ends[0] - ends[1]) / (2.0 * _STEP_DEG))
    axis = rng.normal(size=3)
    turned = sky @ world.turn(math.radians(_MOUNT_DEG) * axis / np.linalg.norm(axis)).T
    fallback = np.degrees(np.arccos(np.clip(np.sum(turned * sky, axis=-1), -1.0, 1.0)))
    track = np.degrees(np.arccos(np.clip((sky @ apparent.T).max(axis=-1), -1.0, 1.0)))
    columns = np.column_stack([asked, *angles(sky), track, *slopes, fallback])
    table(
        path,
        "x_px,y_px,zenith_deg,azimuth_deg,track_deg,dx_dzenith,dy_dzenith,dx_dazimuth,dy_dazimuth,fallback_deg",
        [[f"{value:.6f}" for value in row] for row in columns],
    )
    return asked


def made(number: int, seed: int, cases: Path, truth: Path) -> tuple[str, dict[str, object]]:
    """Write a case and its truth, and return its name and what it is."""
    rng, name = np.random.default_rng([seed, number, 2]), f"t{number:03d}"
    kind, condition = LENSES[number % len(LENSES)], CONDITIONS[number % len(CONDITIONS)]
    lens, place = lens_of(kind, rng), world.drawn_place(rng)
    few = condition == "ten_minutes"
    times = world.times_of(
        rng, place, days=1 if few or condition == "half_day" else 2, cadence_s=20.0 if few else 120.0
    )
    if few:
        times = times[len(times) // 3 :][:30]
    if condition == "half_day":
        times = times[: len(times) // 2] if rng.random() < 0.5 else times[len(times) // 2 :]
    later = lens.moved(rng, float(rng.uniform(0.5, 3.0))) if condition == "moved_mount" else lens
    part, sun = len(times) // 2, world.sun(times, place)
    pixels = np.concatenate([lens.project(sun[:part]), later.project(sun[part:])])
    pixels = pixels + errors_of(condition, rng, len(times))
    recorded = times + (
        rng.uniform(-8.0, 8.0) * (times - times[0]) / 864_000.0 if condition == "drifting_clock" else 0.0
    )
    kept = inside(pixels) & np.all(np.isfinite(pixels), axis=-1)
    recorded, pixels = recorded[kept], pixels[kept]
    apparent = world.sun(recorded, place)
    asked = write_truth(truth / f"{name}.csv", later, apparent, rng)
    folder = cases / name
    folder.mkdir(parents=True, exist_ok=True)
    table(folder / "queries.csv", "x_px,y_px", [[f"{x:.6f}", f"{y:.6f}"] for x, y in asked])
    moments = [datetime.fromtimestamp(float(t), UTC).isoformat(timespec="milliseconds")[:-6] + "Z" for t in recorded]
    table(
        folder / "sightings.csv",
        "time_utc,x_px,y_px,sigma_px,body,zenith_deg,azimuth_deg,apparent_zenith_deg,apparent_azimuth_deg",
        [
            [moment, f"{x:.6f}", f"{y:.6f}", "", "sun", "", "", f"{zenith:.6f}", f"{azimuth:.6f}"]
            for moment, (x, y), zenith, azimuth in zip(moments, pixels, *angles(apparent), strict=True)
        ],
    )
    facts = {"latitude": place.latitude, "longitude": place.longitude, "altitude": place.altitude}
    size = {"width": world.SIZE, "height": world.SIZE, "projection": None if kind == "polynomial" else lens.projection}
    (folder / "case.json").write_text(json.dumps({"case": name, "part": "second", **facts, **size}, indent=1) + "\n")
    return name, {"lens": kind, "condition": condition, "answerable": not few}


def main() -> None:
    """Write a round."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cases", type=int, default=60)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--out", type=Path, required=True)
    chosen = parser.parse_args()
    cases, truth = chosen.out / "cases", chosen.out / "truth"
    truth.mkdir(parents=True, exist_ok=True)
    about = dict(made(number, chosen.seed, cases, truth) for number in range(chosen.cases))
    stated = {"format": 1, "part": "second", "seed": str(chosen.seed), "cases": about}
    (truth / "benchmark.json").write_text(json.dumps(stated, indent=1) + "\n")
    digest = hashlib.sha256()
    for path in sorted(truth.glob("*.*")):
        digest.update(path.name.encode() + b"\0" + path.read_bytes() + b"\0")
    listed = {"format": 1, "part": "second", "truth_sha256": digest.hexdigest(), "cases": list(about)}
    (cases / "benchmark.json").write_text(json.dumps(listed, indent=1) + "\n")
    print(f"{chosen.cases} cases in {cases}, their truth in {truth}, SHA-256 {digest.hexdigest()}")


if __name__ == "__main__":
    main()
