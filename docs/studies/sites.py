"""Verdicts on wrong sites, clocks, hands and projections, over sites drawn from the inhabited world.

    OMP_NUM_THREADS=1 python docs/studies/sites.py --sites 200 --json rows.jsonl

The sightings are of another generator than the fit's: the sun is pvlib's (SPA), the lens Kannala and Brandt's, noise is
white. Every slip is made once at each site: the fit is given what an owner would type. Days (one, four), mount (level:
Rayleigh, 1 degree; tilted by 3; by 10) and statement (no limit of the tilt; the next multiple of five above it) are
drawn for each site and slip: each of the twelve once in twelve sites. A file of rows is continued.

A fit is right where its root mean square error over the sky above 80 degrees of zenith angle is within three times what
it states, or 0.1 degree. Nothing can tell a slip whose sightings are those of a camera that is level to what is stated
(5 degrees where nothing is): the sun's directions as typed are the true ones turned (or reflected) as a whole, to odds
of 22,000 to 1 with any radius of the lens and any strength of the refraction, and at most 3 % are below the horizon.
"""

from __future__ import annotations

import argparse
import json
import math
from collections import Counter, defaultdict
from collections.abc import Sequence
from datetime import UTC, datetime, timedelta
from itertools import product
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
from sunarc.calibration.verdict import add_stated_clock
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
_ASKED_DEG, _SHOWN, _BELOW, _SIGMAS = 5.0, 10.0, 0.03, 3.0
"""Tilt above which a camera is asked about; log odds and share of suns below the horizon that show a wrong place;
stated sigmas by which a fitted tilt may differ."""
_SET = -math.sin(math.radians(0.5667))
"""Height of a sun that refraction no longer lifts above the horizon: pvlib's is without refraction there."""
SLIPS = (
    "none", "projection not stated", "exchanged", "sign of latitude", "sign of longitude", "latitude 1°", "latitude 5°",
    "longitude 1°", "longitude 5°", "an hour", "15 minutes", "mirrored",
)  # fmt: skip
CELLS = tuple(product((1, 4), (0.0, 3.0, 10.0), (False, True)))
"""Days; tilt of the mount in degrees, 0: drawn; whether its limit is stated."""
_LIMIT_DEG = {0.0: 5.0, 3.0: 5.0, 10.0: 15.0}
"""Limit that is stated for a mount: the next multiple of five above its tilt."""
_OTHER_HAND = {"other_handedness_fits", "other_handedness_alone_fits"}
_OF_THE_POLE = {"camera_tilted_by_clock", "camera_tilted_by_longitude", "sightings_below_horizon"}
_FIRST_REMEDY = {
    "exchanged": {"camera_tilted_by_exchange", "sightings_below_horizon"},
    "sign of latitude": {
        "camera_tilted_by_latitude", "sightings_below_horizon", "latitude_of_other_sign_fits",
        *_OTHER_HAND,
    },
    "sign of longitude": _OF_THE_POLE,
    "latitude 1°": {"camera_tilted_by_latitude"},
    "latitude 5°": {"camera_tilted_by_latitude"},
    "longitude 1°": _OF_THE_POLE,
    "longitude 5°": _OF_THE_POLE,
    "an hour": _OF_THE_POLE,
    "15 minutes": _OF_THE_POLE,
    "mirrored": {*_OTHER_HAND, "latitude_of_other_sign_fits", "mirroring_ambiguous"},
}  # fmt: skip
_AHEAD_S = {"an hour": 3600.0, "15 minutes": 900.0}


class World(NamedTuple):
    """A camera at its site: rotation to camera axes (3, 3), focal length px, centre px, days, tilt in degrees.

    The limit, degrees, is what its owner states of the tilt; None where nothing is stated.
    """

    site: tuple[float, float]
    turn: FloatArray
    focal_px: float
    center_px: FloatArray
    days: int
    tilt_deg: float
    limit_deg: float | None


def drawn(number: int, slip: str) -> World:
    """Return the world of a site's number, with the days and the mount of a slip."""
    rng = np.random.default_rng([53, number])
    shares = np.array([region[4] for region in _REGIONS])
    south, north, west, east, _ = _REGIONS[int(rng.choice(len(_REGIONS), p=shares / shares.sum()))]
    order = np.random.default_rng([55, SLIPS.index(slip), number // len(CELLS)]).permutation(len(CELLS))
    days, mount, stated = CELLS[int(order[number % len(CELLS)])]
    tilt = mount or float(min(rng.rayleigh(1.0), 2.5))
    lean, azimuth = rng.uniform(0.0, 360.0, 2).tolist()
    # camera axes: x and y of the image and the optical axis, from east, north, up
    turn = Rotation.from_euler("zxz", [lean, tilt, azimuth], degrees=True).as_matrix()
    site = float(rng.uniform(south, north)), float(rng.uniform(west, east))
    focal, center = float(rng.normal(340.0, 6.0)), 0.5 * (_SIZE - 1) + rng.normal(0.0, 6.0, 2)
    return World(site, turn, focal, center, days, tilt, _LIMIT_DEG[mount] if stated else None)


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


class Day(NamedTuple):
    """The sightings of a world as an owner types them: the rows, true and typed directions (n, 3), the typed site."""

    points: Sightings
    directions: FloatArray
    typed: FloatArray
    site: Site


def observed(world: World, slip: str, number: int) -> Day:
    """Return the sightings with a slip."""
    rng, (latitude, longitude) = np.random.default_rng([54, number]), world.site
    start = datetime(2024, 1, 1, tzinfo=UTC) + timedelta(days=int(rng.integers(0, 270)))
    step = {1: "5min", 4: "12min"}[world.days]
    noons = [start + timedelta(days=20 * day, hours=12.0 - longitude / 15.0) for day in range(world.days)]
    ranges = [pd.date_range(noon - timedelta(hours=9), noon + timedelta(hours=9), freq=step) for noon in noons]
    times = pd.DatetimeIndex(np.concatenate([one.to_numpy() for one in ranges]), tz="UTC")
    directions = sun(times, latitude, longitude)
    clear = (directions[:, 2] > math.sin(math.radians(_LOWEST_DEG))) & (rng.uniform(size=len(times)) > 0.15)
    times, directions = times[clear], directions[clear]
    pixels = seen(world, directions, mirrored=slip == "mirrored")
    stamped = times + pd.Timedelta(seconds=_AHEAD_S.get(slip, 0.0))
    points = Sightings.of(
        unix_s=stamped.as_unit("ns").asi8 / 1e9, pixels=pixels + rng.normal(0.0, _NOISE_PX, pixels.shape)
    )
    typed = typed_site(world, slip, number)
    return Day(points, directions, sun(stamped, *typed), Site(latitude=typed[0], longitude=typed[1]))


def typed_site(world: World, slip: str, number: int) -> tuple[float, float]:
    """Return the latitude and longitude that are typed."""
    (latitude, longitude), way = world.site, (-1.0, 1.0)[number % 2]
    return {
        "exchanged": (longitude, latitude),
        "sign of latitude": (-latitude, longitude),
        "sign of longitude": (latitude, -longitude),
        "latitude 1°": (latitude + way, longitude),
        "latitude 5°": (latitude + 5.0 * way, longitude),
        "longitude 1°": (latitude, longitude + way),
        "longitude 5°": (latitude, longitude + 5.0 * way),
    }.get(slip, world.site)


def fitted(world: World, day: Day, slip: str) -> Calibration:
    """Return the fit that the owner gets; no bound of the clock is stated."""
    projection: Projection | Literal["auto"] = "auto" if slip == "projection not stated" else "equidistant"
    options = CalibrationOptions(projection=projection, level_within_deg=world.limit_deg)
    return add_stated_clock(calibrate(day.points, site=day.site, image_size=(_SIZE, _SIZE), options=options), None)


class Apparent(NamedTuple):
    """The camera as which a slip's sightings show the true one: its tilt, and what tells them apart.

    Tilt in degrees; log odds of the noise, with any radius of the lens; share of the suns below the horizon as typed.
    """

    tilt_deg: float
    log_odds: float
    below: float


def apparent(world: World, day: Day, slip: str) -> Apparent:
    """Return the camera as which the sightings of a slip show the true one."""
    u, _, v = np.linalg.svd(day.typed.T @ day.directions)
    way = np.sign(np.linalg.det(u @ v)) * (-1.0 if slip == "mirrored" else 1.0)
    turn = u @ np.diag([1.0, 1.0, way]) @ v  # the typed directions are the true ones turned
    up = day.typed[:, 2] > 0.0
    true, typed = day.directions[up], day.typed[up] @ turn
    tilt = math.degrees(math.acos(float(np.clip(turn[2] @ world.turn[:, 2], -1.0, 1.0))))
    x, y, z = (true @ world.turn).T
    theta, around = np.arctan2(np.hypot(x, y), z), np.arctan2(y, x)
    outwards = np.stack([np.cos(around), np.sin(around)], axis=-1)
    at = seen(world, true)
    turns = [seen(world, Rotation.from_rotvec(1e-4 * axis).apply(true)) - at for axis in np.eye(3)]
    # a sun that is lifted by a ten-thousandth more than Bennett's refraction
    lifted = np.degrees(np.arcsin(day.typed[up, 2]))
    lifts = 1e-4 / np.tan(np.radians(lifted + 7.31 / (lifted + 4.4)))[:, None] * np.array([0.0, 0.0, 1.0])
    refraction = [seen(world, true + lifts @ turn) - at]
    lens = [outwards * theta[:, None] ** power for power in (1, 3, 5, 7)]
    center = [np.broadcast_to(one, at.shape) for one in np.eye(2)]
    design = np.array([*turns, *lens, *center, *refraction]).reshape(10, -1).T
    off = (seen(world, typed) - at).ravel()
    scale = np.maximum(np.linalg.norm(design, axis=0), 1e-12)
    left = off - design / scale @ np.linalg.lstsq(design / scale, off, rcond=None)[0]
    return Apparent(tilt, 0.5 * float(left @ left) / _NOISE_PX**2, float(np.mean(day.typed[:, 2] < _SET)))


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
    """Return the outcome of a slip at a site; None where it cannot be typed."""
    world = drawn(number, slip)
    if abs(typed_site(world, slip, number)[0]) > 90.0:
        return None
    day = observed(world, slip, number)
    seems, found = apparent(world, day, slip), fitted(world, day, slip)
    codes = [one.code for one in found.verdict.findings]
    error, sigma = error_deg(world, found), found.sky_rms_deg
    right = error <= max(3.0 * sigma, 0.1)
    limit = world.limit_deg or _ASKED_DEG
    hidden = seems.tilt_deg <= limit + _SIGMAS * sigma and seems.log_odds < _SHOWN and seems.below <= _BELOW
    if found.verdict.accepted:
        outcome = "right" if right else "hidden" if hidden else "wrong"
    else:
        asked = slip in ("none", "projection not stated") and world.tilt_deg > limit and "tilt_in_doubt" in codes
        outcome = "remedy" if asked or codes[0] in _FIRST_REMEDY.get(slip, set()) else "refused"
    return {
        "site": number, "slip": slip, "stated": world.limit_deg is not None, "days": world.days,
        "mount_deg": world.tilt_deg, "place": world.site, "outcome": outcome, "error_deg": error, "sigma_deg": sigma,
        "fitted_tilt_deg": found.pose.theta_zz_deg, "seems": seems._asdict(),
        "line": bool({"site_assumed", "clock_unbounded"} <= set(codes)),
        "first": dict(found.verdict.findings[0].data), "codes": codes,
    }  # fmt: skip


def table_of(rows: Sequence[dict[str, Any]]) -> str:
    """Return the table: a line a slip and statement."""
    counts: dict[tuple[str, bool], Counter[str]] = defaultdict(Counter)
    wrong: dict[tuple[str, bool], list[dict[str, Any]]] = defaultdict(list)
    for row in rows:
        key = row["slip"], row["stated"]
        counts[key][row["outcome"]] += 1
        if row["outcome"] in ("wrong", "hidden"):
            wrong[key].append(row)
    heads = (
        *("slip", "tilt stated", "right", "first remedy", "refused otherwise", "wrong: nothing can tell; else"),
        *("their largest tilt", "of them without the line"),
    )
    lines = [f"| {' | '.join(heads)} |", "|---" * len(heads) + "|"]
    for slip, stated in product(SLIPS, (False, True)):
        n, bad = counts[slip, stated], wrong[slip, stated]
        largest = f"{max(row['fitted_tilt_deg'] for row in bad):.1f}°" if bad else ""
        without = sum(not row["line"] for row in bad)
        lines.append(
            f"| {slip} | {'yes' if stated else 'no'} | {n['right']} | {n['remedy']} | {n['refused']} "
            f"| {n['hidden']}; {n['wrong']} | {largest} | {without} |"
        )
    return "\n".join(lines)


def main() -> None:
    """Judge every slip at every site, and print the table."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--sites", type=int, default=200)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--json", type=Path, required=True, help="a line a fit, written as they end; continued")
    parser.add_argument("--slips", nargs="*", default=SLIPS)
    asked, rows = parser.parse_args(), []
    if asked.json.exists():
        rows = [json.loads(line) for line in asked.json.read_text(encoding="utf-8").splitlines()]
    done = {(row["site"], row["slip"]) for row in rows}
    for number, slip in product(range(asked.first, asked.first + asked.sites), asked.slips):
        if (number, slip) in done:
            continue
        row = judged(number, slip)
        if row is None:
            continue
        rows.append(row)
        with asked.json.open("a", encoding="utf-8") as out:
            out.write(json.dumps(row) + "\n")
    print(table_of(rows))


if __name__ == "__main__":
    main()
