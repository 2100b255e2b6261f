"""What each of the four searches for a change says of troubles that look alike.

    OMP_NUM_THREADS=1 python docs/studies/pose_changes.py --seeds 3

A camera stands still, is bumped, drifts, settles, has its clock set or its lens changed, sees cloud that draws the
detections aside three times a day, or is knocked aside for one afternoon. Three troubles look like another one: a turn
about the celestial pole like a clock that was set (`pole`), another focus by 1 %, after which the sun is seen only low,
like a turn (`low`), and a bump within a day of 12 sightings like false ones (`few`). The generator shares no code with
what is judged: sun, refraction, lens and cloud are formulas of this file. Printed is how often each search said what;
online also where the host reports that its clock was set (`clock set`), and where nothing watches it (`unwatched`).
"""

from __future__ import annotations

import argparse
import time
from collections import Counter
from collections.abc import Callable
from functools import partial

import numpy as np
from numpy.typing import NDArray

from sunarc.archives.fit import CameraSightings, final_analysis, first_analysis
from sunarc.archives.states import ArchiveCamera
from sunarc.calibration.calibrate import calibrate
from sunarc.calibration.evidence import DAYS
from sunarc.calibration.model.options import CalibrationOptions
from sunarc.calibration.model.sightings import Sightings
from sunarc.changes.daily_rotations import DailyRotations, daily_rotations, step_gains
from sunarc.changes.fleet import explain_step, find_steps
from sunarc.changes.online import update_window
from sunarc.changes.record import find_pose_steps
from sunarc.changes.values import Sighting, SightingWindow, WatchOptions
from sunarc.sky.site import Site
from sunarc.sky.sun import sun_directions

FloatArray = NDArray[np.float64]
CASES = ("still", "bump", "drift", "settling", "clock", "cloud", "afternoon", "lens", "pole", "low", "few")
SITE, SIZE, DAY_S = Site(latitude=46.0, longitude=7.5, altitude=900.0), (960, 960), 86_400.0
OPTIONS = CalibrationOptions(projection="equidistant", mirrored="no")
START = 1_715_040_000.0
"""7 May 2024, 0 h UTC."""
FOCAL, NOISE_PX, LATE_S = 300.0, 0.25, 10.3 * 3600.0
"""px/rad; 1-sigma; the hour of a change."""
LOW_H, LOW_LATE_S = (4.4, 6.4), 5.2 * 3600.0
"""Hours of a sun between 3 and 23 degrees above the horizon, and that of a change among them."""
POLE = np.array([0.0, np.cos(np.radians(SITE.latitude)), np.sin(np.radians(SITE.latitude))])


def sun(unix_s: FloatArray) -> FloatArray:
    """Return the sun's apparent directions (n, 3), east-north-up (Meeus 1998, chapter 25; Bennett 1982)."""
    days = (unix_s + 69.0) / DAY_S + 2_440_587.5 - 2_451_545.0
    mean, about = np.radians(280.46646 + 0.98564736 * days), np.radians(357.52911 + 0.98560028 * days)
    long = mean + np.radians(1.914602 * np.sin(about) + 0.019993 * np.sin(2 * about) - 0.00569)
    tilt = np.radians(23.439291 - 3.563e-7 * days)
    ascension, declination = (
        np.arctan2(np.cos(tilt) * np.sin(long), np.cos(long)),
        np.arcsin(np.sin(tilt) * np.sin(long)),
    )
    turned = np.radians(280.46061837 + 360.98564736629 * (unix_s / DAY_S + 2_440_587.5 - 2_451_545.0))
    hour, north = turned + np.radians(SITE.longitude) - ascension, np.radians(SITE.latitude)
    up = np.arcsin(np.sin(north) * np.sin(declination) + np.cos(north) * np.cos(declination) * np.cos(hour))
    azimuth = np.arctan2(-np.cos(declination) * np.sin(hour), np.sin(declination) * np.cos(north)
                         - np.cos(declination) * np.cos(hour) * np.sin(north))  # fmt: skip
    degrees = np.degrees(up)
    up = up + np.radians(0.9 * 1.02 / 60.0 / np.tan(np.radians(degrees + 10.3 / (degrees + 5.11))))
    return np.stack([np.cos(up) * np.sin(azimuth), np.cos(up) * np.cos(azimuth), np.sin(up)], axis=-1)


def turn(vectors: FloatArray, rotation: FloatArray) -> FloatArray:
    """Return vectors (n, 3) turned by rotations (3,) or (n, 3), radians (Rodrigues)."""
    angle = np.linalg.norm(rotation, axis=-1, keepdims=True)
    axis = rotation / np.maximum(angle, 1e-12)
    along = np.sum(axis * vectors, axis=-1, keepdims=True)
    turned = vectors * np.cos(angle) + np.cross(axis, vectors) * np.sin(angle) + axis * along * (1.0 - np.cos(angle))
    return np.asarray(turned)


def turned_deg(case: str, since_s: FloatArray, scale: float) -> FloatArray:
    """Return by how much the camera stands turned so long after the change, degrees."""
    days = np.maximum(since_s, 0.0) / DAY_S
    if case == "drift":
        return np.asarray(0.06 * scale * days)
    if case == "settling":
        return np.asarray(0.3 * scale * -np.expm1(-days / 2.0))
    afternoon = (since_s >= 0.0) & (since_s < 0.4 * DAY_S)
    return (
        scale * np.where(since_s >= 0.0, 0.3, 0.0)
        if case in {"bump", "pole", "few"}
        else np.where(afternoon, 0.7 * (case == "afternoon"), 0.0)
    )


def times_of(days: range, count: int, *, case: str = "", day: int = 0) -> FloatArray:
    """Return when the sun is seen: `count` times from 6 to 16 h UTC of each day, fewer or lower ones by the case."""
    return np.concatenate(
        [
            START + DAY_S * one + 3600.0 * np.linspace(
                *(LOW_H if case == "low" and one >= day else (6.0, 16.0)), 12 if (case, one) == ("few", day) else count
            )
            for one in days
        ]
    )  # fmt: skip


def changed_at(case: str, day: int) -> float:
    """Return when a case's change is made, s."""
    return START + DAY_S * day + (LOW_LATE_S if case == "low" else LATE_S)


def axis_of(rng: np.random.Generator, case: str) -> FloatArray:
    """Return the axis (3,) of a turn."""
    axis = rng.normal(size=3)
    return np.asarray(POLE if case == "pole" else axis / np.linalg.norm(axis))


def directions(rng: np.random.Generator, case: str, unix_s: FloatArray, *, day: int, scale: float = 1.0) -> FloatArray:
    """Return where the sun is in the frame of a camera, from whose pose a case takes it after the change on a day."""
    since, axis = unix_s - changed_at(case, day), axis_of(rng, case)
    late = np.where(since >= 0.0, 60.0 * scale, 0.0) if case == "clock" else 0.0
    return turn(sun(unix_s - late), np.radians(turned_deg(case, since, scale))[:, None] * axis)


def pixels(rng: np.random.Generator, case: str, unix_s: FloatArray, *, day: int, scale: float) -> FloatArray:
    """Return where an equidistant camera sees the sun, px."""
    pose = np.random.default_rng(int(rng.integers(1 << 30))).normal(0.0, 0.06, 3) + np.array([0.0, 0.0, 1.0])
    x, y, z = turn(directions(rng, case, unix_s, day=day, scale=scale), pose).T
    focal = FOCAL * np.where(unix_s >= changed_at(case, day), {"lens": 1.04, "low": 1.01}.get(case, 1.0), 1.0)
    radius = focal * np.arctan2(np.hypot(x, y), z)
    seen = np.stack([484.0 - radius * x / np.hypot(x, y), 476.0 - radius * y / np.hypot(x, y)], axis=-1)
    if case == "cloud":
        for begin in np.unique(unix_s // DAY_S) * DAY_S:
            for _ in range(3):
                long, at = rng.uniform(300.0, 3000.0), begin + rng.uniform(6.0, 15.5) * 3600.0
                share = (unix_s - at) / long
                shape = np.where(
                    (share > 0.0) & (share < 1.0),
                    np.sin(np.pi * np.clip(share, 0.0, 1.0)) ** rng.uniform(0.3, 2.0),
                    0.0,
                )
                seen = seen + shape[:, None] * rng.normal(0.0, 4.0, 2)
    noise = rng.normal(0.0, NOISE_PX, seen.shape)
    false = rng.random(unix_s.size) < 0.02
    return seen + noise + np.where(false[:, None], rng.uniform(-200.0, 200.0, seen.shape), 0.0)


def points(rng: np.random.Generator, case: str, unix_s: FloatArray, *, day: int, scale: float = 1.0) -> Sightings:
    """Return sightings."""
    seen = pixels(rng, case, unix_s, day=day, scale=scale)
    return Sightings.of(unix_s=unix_s, pixels=seen, sigma_px=np.full(unix_s.size, NOISE_PX))


def dated(unix_s: float, case: str, day: int) -> str:
    """Return whether a change is dated to within half an hour, or the hour between two of few sightings."""
    return "" if abs(unix_s - changed_at(case, day)) < (3600.0 if case == "few" else 1800.0) else " misdated"


def within_record(rng: np.random.Generator, case: str) -> list[str]:
    """Return the steps of the pose in ten days."""
    seen = points(rng, case, times_of(range(10), 150, case=case, day=5), day=5)
    steps = find_pose_steps(seen, site=SITE, image_size=SIZE, options=OPTIONS)
    return ["step" + dated(step.time, case, 5) for step in steps]


def archive(rng: np.random.Generator, case: str) -> list[str]:
    """Return the causes of the epochs in eight days; troubles are four times as large."""
    seen = points(rng, case, times_of(range(8), 40, case=case, day=4), day=4, scale=4.0)
    camera = ArchiveCamera(SITE, SIZE, OPTIONS)
    final = final_analysis(CameraSightings(seen, camera, first_analysis(CameraSightings(seen, camera)).states))
    return [epoch.cause + dated(epoch.start_unix_s, case, 4) for epoch in final.epochs[1:]]


def online(rng: np.random.Generator, case: str, *, clock_stepped: bool | None = False) -> list[str]:
    """Return the first change in three days of a sighting every two minutes, with the other causes that it may have."""
    seen = points(
        rng, case, np.concatenate([times_of(range(6), 80), times_of(range(6, 9), 300, case=case, day=6)]), day=6
    )
    lens = calibrate(seen.select(seen.unix_s < START + 6 * DAY_S), site=SITE, image_size=SIZE, options=OPTIONS)
    after = seen.select(seen.unix_s >= START + 6 * DAY_S)
    watch, where = SightingWindow(), sun_directions(after.unix_s, SITE)
    for unix_s, pixel, direction in zip(after.unix_s.tolist(), after.pixels, where, strict=True):
        one = Sighting(unix_s=unix_s, pixel=tuple(pixel), direction=tuple(direction), sigma_px=NOISE_PX)
        watch, change = update_window(
            watch, one, calibration=lens, site=SITE, options=WatchOptions(), clock_stepped=clock_stepped
        )
        if change is not None:
            return [" or ".join((change.cause, *change.perhaps)) + dated(change.time, case, 6)]
    return []


def neighbours(rng: np.random.Generator, case: str) -> list[str]:
    """Return what the last of 45 nights says of three cameras; the first has a trouble, a tenth as large, on day 30."""
    group = []
    for number in range(3):
        trouble = case if number == 0 else "still"
        unix_s = times_of(range(45), 60)
        seen = directions(rng, trouble, unix_s, day=30, scale=0.1)
        if trouble == "cloud":
            seen = seen + (rng.random(unix_s.size // 60) < 0.3).repeat(60)[:, None] * rng.normal(
                0.0, 2e-4, (unix_s.size // 60, 3)
            ).repeat(60, axis=0)
        seen = turn(seen, rng.normal(0.0, 5e-5, (45, 3)).repeat(60, axis=0)) + rng.normal(0.0, 5e-4, seen.shape)
        observed = seen / np.linalg.norm(seen, axis=-1, keepdims=True)
        day = np.floor((unix_s - START) / DAY_S)
        group.append(daily_rotations(day, observed=observed, expected=sun_directions(unix_s, SITE)))
    steps = find_steps(group)
    said = [None if step is None else explain_step(step, before=SITE, after=SITE)[0] for step in steps]
    return [
        one.cause + ("" if number == 0 else " of a neighbour") + ("" if abs(one.time - 30.0) <= 2.0 else " misdated")
        for number, one in enumerate(said)
        if one is not None
    ]


def long_record(rng: np.random.Generator, case: str) -> list[str]:
    """Return where the rotations of 40 days step; troubles are a fifth as large."""
    day = np.arange(40.0)
    since = START + DAY_S * day + 13.0 * 3600.0 - (START + DAY_S * 20 + LATE_S)
    rotation = np.outer(turned_deg(case, since, 0.2), axis_of(rng, case)) + rng.normal(0.0, 0.012, (40, 3))
    rotation += np.outer(np.sin(day / 58.0 + rng.uniform(0.0, 6.0)), rng.normal(0.0, 0.02, 3))
    if case == "cloud":
        rotation += (rng.random(40) < 0.15)[:, None] * rng.normal(0.0, 0.06, (40, 3))
    covariance = np.broadcast_to(1e-4 * np.eye(3), (40, 3, 3))
    gain = step_gains(DailyRotations(day=day, rotation_deg=rotation, covariance_deg2=covariance))
    return ["step" + ("" if abs(int(np.argmax(gain)) - 20) <= 2 else " misdated")] if gain.max() > DAYS.gain else []


SEARCHES: dict[str, Callable[[np.random.Generator, str], list[str]]] = {
    "online": online,
    "clock set": partial(online, clock_stepped=True),
    "unwatched": partial(online, clock_stepped=None),
    "record": within_record,
    "archive": archive,
    "neighbours": neighbours,
    "days": long_record,
}


def main() -> None:
    """Print what was said, by search and case."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--first", type=int, default=0, help="the first seed")
    parser.add_argument("--search", choices=tuple(SEARCHES), nargs="*", default=tuple(SEARCHES))
    parser.add_argument("--case", choices=CASES, nargs="*", default=CASES)
    asked = parser.parse_args()
    for name in asked.search:
        for number, case in [one for one in enumerate(CASES) if one[1] in asked.case]:
            begun, said = time.process_time(), Counter[str]()
            for seed in range(asked.first, asked.first + asked.seeds):
                rng = np.random.default_rng((seed, number))
                said[
                    " and ".join(
                        f"{n} {one}" if n > 1 else one for one, n in Counter(SEARCHES[name](rng, case)).items()
                    )
                    or "nothing"
                ] += 1
            took = (time.process_time() - begun) / asked.seeds
            print(
                f"| {name} | {case} | {', '.join(f'{one} {n}' for one, n in said.most_common())} | {took:.1f} s |",
                flush=True,
            )


if __name__ == "__main__":
    main()
