"""Verdicts on wrong sites, clocks, hands and untold tilts, over sites drawn from the inhabited world.

    OMP_NUM_THREADS=1 python docs/studies/sites.py --sites 200 [--first 0] [--json rows.jsonl]

The sightings are of another generator than the fit's: the sun is pvlib's (SPA), the lens Kannala and Brandt's, noise is
white. Each site has one or four days, a mount that is level (Rayleigh, 1 degree), tilted by 3, or by 10 degrees. Each
slip is made at every site: the fit is given what an owner would type. A fit is right where its root mean square error
over the sky above 80 degrees of zenith angle is within three times what it states, or 0.1 degree.
"""

from __future__ import annotations

import argparse
import json
import math
from collections import Counter, defaultdict
from collections.abc import Iterable
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from pvlib.solarposition import get_solarposition
from scipy.spatial.transform import Rotation

from sunarc.calibration.calibrate import calibrate
from sunarc.calibration.model.options import CalibrationOptions
from sunarc.calibration.model.result import Calibration
from sunarc.calibration.model.sightings import Sightings
from sunarc.optics.inverse import unproject
from sunarc.optics.projections import Projection
from sunarc.sky.site import Site

FloatArray = NDArray[np.float64]

_REGIONS = (
    (8.0, 33.0, 70.0, 90.0, 1.7), (22.0, 42.0, 103.0, 122.0, 1.4), (-8.0, 20.0, 95.0, 125.0, 0.7),
    (36.0, 58.0, -9.0, 40.0, 0.75), (4.0, 14.0, -16.0, 12.0, 0.4), (-12.0, 15.0, 28.0, 45.0, 0.4),
    (-34.0, -16.0, 18.0, 33.0, 0.15), (25.0, 49.0, -123.0, -70.0, 0.37), (8.0, 28.0, -106.0, -66.0, 0.25),
    (-36.0, 5.0, -75.0, -36.0, 0.42), (24.0, 41.0, 26.0, 60.0, 0.35), (31.0, 44.0, 127.0, 145.0, 0.2),
    (-43.0, -27.0, 138.0, 176.0, 0.1),
)  # fmt: skip
"""Latitudes and longitudes of regions, degrees, and how many thousand million people live there."""
_SIZE, _NOISE_PX, _LOWEST_DEG = 1200, 0.2, 8.0
_KANNALA = (-0.012, 0.004, -0.002)
"""Coefficients of θ³, θ⁵ and θ⁷ over that of θ: no projection of ours."""
SLIPS = (
    "none", "none, tilt stated", "projection not told", "exchanged", "sign of latitude", "sign of longitude",
    "latitude 1°", "latitude 5°", "longitude 1°", "longitude 5°", "an hour", "15 minutes", "mirrored",
)  # fmt: skip
_OF_THE_POLE = {"camera_tilted_by_clock", "camera_tilted_by_longitude", "sightings_below_horizon"}
_FIRST_REMEDY = {
    "exchanged": {"camera_tilted_by_exchange", "sightings_below_horizon"},
    "sign of latitude": {"camera_tilted_by_latitude", "sightings_below_horizon", "other_handedness_fits"},
    "sign of longitude": _OF_THE_POLE,
    "latitude 5°": {"camera_tilted_by_latitude"},
    "longitude 5°": _OF_THE_POLE,
    "an hour": _OF_THE_POLE,
    "15 minutes": _OF_THE_POLE,
    "mirrored": {"other_handedness_fits", "mirroring_ambiguous"},
    "none": {"tilt_in_doubt"},
    "projection not told": {"tilt_in_doubt", "projection_ambiguous"},
}


class World(NamedTuple):
    """A camera at its site: rotation to camera axes (3, 3), focal length px, centre px, days, tilt in degrees."""

    site: tuple[float, float]
    turn: FloatArray
    focal_px: float
    center_px: FloatArray
    days: int
    tilt_deg: float


def drawn(number: int) -> World:
    """Return the world of a number."""
    rng = np.random.default_rng([53, number])
    shares = np.array([region[4] for region in _REGIONS])
    south, north, west, east, _ = _REGIONS[int(rng.choice(len(_REGIONS), p=shares / shares.sum()))]
    tilt = (float(min(rng.rayleigh(1.0), 2.5)), 3.0, 10.0)[number % 3]
    lean, azimuth = rng.uniform(0.0, 360.0, 2).tolist()
    # camera axes: x and y of the image and the optical axis, from east, north, up
    turn = Rotation.from_euler("zxz", [lean, tilt, azimuth], degrees=True).as_matrix()
    site = float(rng.uniform(south, north)), float(rng.uniform(west, east))
    focal, center = float(rng.normal(340.0, 6.0)), 0.5 * (_SIZE - 1) + rng.normal(0.0, 6.0, 2)
    return World(site, turn, focal, center, (1, 4)[number // 3 % 2], tilt)


def seen(world: World, directions: FloatArray, *, mirrored: bool = False) -> FloatArray:
    """Return pixels (n, 2) of directions (n, 3), east-north-up."""
    x, y, z = (directions @ world.turn).T
    theta, around = np.arctan2(np.hypot(x, y), z), np.arctan2(y, x)
    radius = world.focal_px * (theta + sum(k * theta ** (3 + 2 * n) for n, k in enumerate(_KANNALA)))
    pixels = world.center_px + radius[:, None] * np.stack([np.cos(around), np.sin(around)], axis=-1)
    if mirrored:
        pixels[:, 0] = _SIZE - 1 - pixels[:, 0]
    return np.asarray(pixels)


def sun(times: pd.DatetimeIndex, latitude: float, longitude: float) -> FloatArray:
    """Return apparent directions (n, 3) of the sun by pvlib."""
    angles = get_solarposition(times, latitude, longitude, method="nrel_numpy", temperature=12.0, pressure=101_325.0)
    zenith, azimuth = np.radians(angles["apparent_zenith"]), np.radians(angles["azimuth"])
    return np.stack([np.sin(zenith) * np.sin(azimuth), np.sin(zenith) * np.cos(azimuth), np.cos(zenith)], axis=-1)


def fitted(world: World, slip: str, number: int) -> Calibration:
    """Return what an owner gets who types a slip."""
    rng, (latitude, longitude) = np.random.default_rng([54, number]), world.site
    start = datetime(2024, 1, 1, tzinfo=UTC) + timedelta(days=int(rng.integers(0, 270)))
    step = {1: "5min", 4: "12min"}[world.days]
    noons = [start + timedelta(days=20 * day, hours=12.0 - longitude / 15.0) for day in range(world.days)]
    ranges = [pd.date_range(noon - timedelta(hours=9), noon + timedelta(hours=9), freq=step) for noon in noons]
    times = pd.DatetimeIndex(np.concatenate([one.to_numpy() for one in ranges]), tz="UTC")
    directions = sun(times, latitude, longitude)
    clear = (directions[:, 2] > math.sin(math.radians(_LOWEST_DEG))) & (rng.uniform(size=len(times)) > 0.15)
    pixels = seen(world, directions[clear], mirrored=slip == "mirrored")
    unix_s = times[clear].as_unit("ns").asi8 / 1e9 + {"an hour": 3600.0, "15 minutes": 900.0}.get(slip, 0.0)
    points = Sightings.of(unix_s=unix_s, pixels=pixels + rng.normal(0.0, _NOISE_PX, pixels.shape))
    way = (-1.0, 1.0)[number % 2]
    typed = {
        "exchanged": (longitude, latitude),
        "sign of latitude": (-latitude, longitude),
        "sign of longitude": (latitude, -longitude),
        "latitude 1°": (latitude + way, longitude),
        "latitude 5°": (latitude + 5.0 * way, longitude),
        "longitude 1°": (latitude, longitude + way),
        "longitude 5°": (latitude, longitude + 5.0 * way),
    }.get(slip, world.site)
    site = Site(latitude=typed[0], longitude=typed[1])
    stated = 15.0 if slip == "none, tilt stated" else None
    projection: Projection | Literal["auto"] = "auto" if slip == "projection not told" else "equidistant"
    options = CalibrationOptions(projection=projection, level_within_deg=stated)
    return calibrate(points, site=site, image_size=(_SIZE, _SIZE), options=options)


def error_deg(world: World, calibration: Calibration) -> float:
    """Return the root mean square error over the sky, degrees per axis."""
    i = np.arange(800) + 0.5
    up, azimuth = 1.0 - i / 800 * (1.0 - math.cos(math.radians(80.0))), math.pi * (1.0 + math.sqrt(5.0)) * i
    flat = np.sqrt(1.0 - up**2)
    sky = np.stack([flat * np.cos(azimuth), flat * np.sin(azimuth), up], axis=-1)
    found = unproject(calibration.camera, seen(world, sky))
    off = np.degrees(np.linalg.norm(found - sky, axis=-1))
    return float(np.sqrt(0.5 * np.mean(np.nan_to_num(off, nan=90.0) ** 2)))


def judged(number: int, slip: str) -> dict[str, Any] | None:
    """Return what came of a slip at a site; None where it cannot be typed, or is none there."""
    world = drawn(number)
    if slip == "exchanged" and abs(world.site[1]) > 90.0:
        return None
    found = fitted(world, slip, number)
    codes = [one.code for one in found.verdict.findings]
    error, stated = error_deg(world, found), found.sky_rms_deg
    right = error <= max(3.0 * stated, 0.1)
    outcome = ("right" if right else "wrong") if found.verdict.accepted else "refused"
    if outcome == "refused" and (
        codes[0] in _FIRST_REMEDY.get(slip, set())
        or (slip in ("none", "projection not told") and "tilt_in_doubt" in codes)
    ):
        outcome = "remedy"
    return {
        "site": number, "slip": slip, "days": world.days, "mount_deg": world.tilt_deg, "outcome": outcome,
        "error_deg": error, "stated_deg": stated, "fitted_tilt_deg": found.pose.theta_zz_deg, "codes": codes[:4],
    }  # fmt: skip


def table_of(rows: Iterable[dict[str, Any]]) -> str:
    """Return the table: a line a slip."""
    counts: dict[str, Counter[str]] = defaultdict(Counter)
    tilts: dict[str, list[float]] = defaultdict(list)
    for row in rows:
        counts[row["slip"]][row["outcome"]] += 1
        if row["outcome"] == "wrong":
            tilts[row["slip"]].append(row["fitted_tilt_deg"])
    lines = [
        "| slip | right | first remedy | refused otherwise | wrong | their largest tilt |",
        "|---|---|---|---|---|---|",
    ]
    for slip in SLIPS:
        n = counts[slip]
        largest = f"{max(tilts[slip]):.1f}°" if tilts[slip] else ""
        lines.append(f"| {slip} | {n['right']} | {n['remedy']} | {n['refused']} | {n['wrong']} | {largest} |")
    return "\n".join(lines)


def main() -> None:
    """Judge every slip at every site, and print the table."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--sites", type=int, default=200)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--json", type=Path, help="a line a fit, written as they end")
    parser.add_argument("--slips", nargs="*", default=SLIPS)
    asked, rows = parser.parse_args(), []
    for number in range(asked.first, asked.first + asked.sites):
        for slip in asked.slips:
            row = judged(number, slip)
            if row is not None:
                rows.append(row)
                if asked.json is not None:
                    with asked.json.open("a", encoding="utf-8") as out:
                        out.write(json.dumps(row) + "\n")
    print(table_of(rows))


if __name__ == "__main__":
    main()
