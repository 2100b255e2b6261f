"""Cross-checks of neighbouring cameras: false alarms in a camera-year, and what is found of what was injected.

    python docs/studies/cross_checks.py [--networks N] [--injected N]

Three cameras have daily rotations against one calibration, on 60 % of the days: white noise of 3, 2 and 4 thousandths
of a degree, a bias by the season, and what each case adds. Every night the last 60 days are compared, as the hub does.
A change that is reported again within 10 days of its day counts once. A slow turn is no alarm.

What is injected steps in one of the cameras on day 200, beside what each case adds. Within 20 days that camera is named
with the right cause, or as `moved` alone, and an alarm of another camera, day or cause comes, or does not.
"""

from __future__ import annotations

import argparse
import json
from collections import Counter
from collections.abc import Callable

import numpy as np

from sunarc.array_types import FloatArray
from sunarc.calibration.changes.daily_rotations import DailyRotations
from sunarc.calibration.changes.values import Cause
from sunarc.cross_checks.rotation_steps import explain_step, find_steps, rotation_of_site
from sunarc.sky.days import SECONDS_PER_DEGREE
from sunarc.sky.site import Site, pole_enu

SITE = Site(latitude=36.6, longitude=-97.5)
COVARIANCE = np.diag([0.003, 0.002, 0.004]) ** 2
CAMERAS, DAYS, WINDOW = 3, 365, 60
WHITE_DEG = np.sqrt(np.diag(COVARIANCE))
Random = np.random.Generator


def plain(_rng: Random) -> FloatArray:
    """Return nothing beside noise and season."""
    return np.zeros((CAMERAS, DAYS, 3))


def heavy(rng: Random) -> FloatArray:
    """Return days of cloud that draws the sightings aside: one in ten, five times the noise."""
    return (rng.random((CAMERAS, DAYS, 1)) < 0.1) * rng.normal(0.0, 5.0 * WHITE_DEG, (CAMERAS, DAYS, 3))


def drifting(rng: Random) -> FloatArray:
    """Return a bias with a memory of a week, as large as the noise."""
    bias = np.zeros((CAMERAS, DAYS, 3))
    for day in range(1, DAYS):
        bias[:, day] = 0.87 * bias[:, day - 1] + rng.normal(0.0, 0.5 * WHITE_DEG, (CAMERAS, 3))
    return bias


def common(rng: Random) -> FloatArray:
    """Return what all have alike: a bias of twice the noise with a memory, and three steps in the year."""
    one = 4.0 * drifting(rng)[:1]
    for day in rng.integers(0, DAYS, 3).tolist():
        one[:, day:] += rng.normal(0.0, 0.02, 3)
    return np.repeat(one, CAMERAS, axis=0)


def settling(rng: Random) -> FloatArray:
    """Return masts that settle by 0.1 degrees about any axis, within weeks from a day in the year on."""
    made = np.zeros((CAMERAS, DAYS, 3))
    for camera in range(CAMERAS):
        axis = rng.normal(size=3)
        since = np.maximum(np.arange(DAYS) - rng.integers(0, DAYS), 0)
        made[camera] = np.outer(0.1 * (1.0 - np.exp(-since / 20.0)), axis / np.linalg.norm(axis))
    return made


def walking(rng: Random) -> FloatArray:
    """Return mounts that walk by 0.002 degrees a day."""
    return np.cumsum(rng.normal(0.0, 0.002, (CAMERAS, DAYS, 3)), axis=1)


CASES: dict[str, Callable[[Random], FloatArray]] = {
    one.__name__: one for one in (plain, heavy, drifting, common, settling, walking)
}


def network(rng: Random, extra: FloatArray) -> list[DailyRotations]:
    """Return the rotations of three cameras over a year."""
    days = np.arange(DAYS)
    made = []
    for camera in range(CAMERAS):
        season = np.outer(np.sin(2.0 * np.pi * (days / DAYS + rng.random())), rng.normal(0.0, 0.01, 3))
        rotation = season + extra[camera] + rng.normal(0.0, WHITE_DEG, (DAYS, 3))
        shown = rng.random(DAYS) < 0.6
        made.append(
            DailyRotations(
                day=days[shown].astype(np.float64),
                rotation_deg=rotation[shown],
                covariance_deg2=np.broadcast_to(COVARIANCE, (int(shown.sum()), 3, 3)).copy(),
            )
        )
    return made


def window(one: DailyRotations, night: int) -> DailyRotations:
    """Return the days that are compared in a night."""
    near = (one.day > night - WINDOW) & (one.day <= night)
    return DailyRotations(
        day=one.day[near], rotation_deg=one.rotation_deg[near], covariance_deg2=one.covariance_deg2[near]
    )


def alarms(cameras: list[DailyRotations]) -> Counter[str]:
    """Return how many different steps are reported in the year, by cause."""
    last = [-99.0] * CAMERAS
    counts: Counter[str] = Counter()
    for night in range(20, DAYS):
        for number, step in enumerate(find_steps([window(one, night) for one in cameras])):
            if step is not None:
                if abs(step.day - last[number]) > 10.0:
                    counts[explain_step(step, before=SITE, after=SITE).cause] += 1
                last[number] = step.day
    return counts


INJECTED_DAY, WITHIN = 200, 20
RESTATED = Site(latitude=36.6, longitude=-97.48)
INJECTED: dict[Cause, tuple[FloatArray, Site]] = {
    "clock": (-pole_enu(SITE) * 4.0 / SECONDS_PER_DEGREE, SITE),
    "longitude": (rotation_of_site(SITE, RESTATED), RESTATED),
    "north": (np.array([0.0, 0.0, 0.1]), SITE),
}
"""4 s of a clock, 0.02 degrees of a stated longitude, 0.1 degrees of north."""


def decided(cameras: list[DailyRotations], cause: Cause, after: Site) -> set[str]:
    """Return what was said in the nights after the first camera changed: `right`, `moved` of it, `wrong`."""
    found = set()
    for night in range(INJECTED_DAY + 3, INJECTED_DAY + WITHIN + 1):
        for number, step in enumerate(find_steps([window(one, night) for one in cameras])):
            if step is None:
                continue
            near = number == 0 and abs(step.day - INJECTED_DAY) < 5.0
            named = explain_step(step, before=SITE, after=after if near else SITE).cause
            if named != "slow_turn":
                found.add("right" if near and named == cause else "moved" if near and named == "moved" else "wrong")
    return found


def injections(name: str, case: Callable[[Random], FloatArray], n: int) -> None:
    """Print in which share of the networks what was injected was named rightly, and else."""
    for cause, (size, after) in INJECTED.items():
        rng = np.random.default_rng(2)
        counts: Counter[str] = Counter()
        for _ in range(n):
            extra = case(rng)
            extra[0, INJECTED_DAY:] += size
            found = decided(network(rng, extra), cause, after)
            counts["right"] += "right" in found
            counts["moved alone"] += "moved" in found and "right" not in found
            counts["wrong beside"] += "wrong" in found
        shares = {word: round(count / n, 2) for word, count in counts.items()}
        print(json.dumps({"case": name, "injected": cause, "networks": n, "shares": shares}), flush=True)


def main() -> None:
    """Print false alarms in a camera-year by case, and what was found of what was injected, as JSON lines."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--networks", type=int, default=20, help="of three cameras and a year, each case")
    parser.add_argument("--injected", type=int, default=100, help="networks of each case and each injected change")
    asked = parser.parse_args()
    for name, case in CASES.items():
        rng = np.random.default_rng(1)
        total: Counter[str] = Counter()
        for _ in range(asked.networks):
            total += alarms(network(rng, case(rng)))
        years = asked.networks * CAMERAS
        rates = {cause: round(count / years, 3) for cause, count in sorted(total.items())}
        false = round(sum(rate for cause, rate in rates.items() if cause != "slow_turn"), 2)
        print(json.dumps({"case": name, "camera_years": years, "a_camera_year": rates, "alarms": false}), flush=True)
        injections(name, case, asked.injected)


if __name__ == "__main__":
    main()
