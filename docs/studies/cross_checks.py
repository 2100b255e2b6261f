"""Cross-checks of neighbouring cameras: false alarms in a camera-year, and what is found of what was injected.

    python docs/studies/cross_checks.py [--networks N]

Three cameras have daily rotations against one calibration, on 60 % of the days: white noise of 3, 2 and 4 thousandths
of a degree, a bias by the season, and what each case adds. Every night the last 60 days are compared, as the hub does.
A step that is reported again within 10 days of its day counts once.
"""

from __future__ import annotations

import argparse
import json
from collections import Counter
from collections.abc import Callable

import numpy as np

from sunarc.array_types import FloatArray
from sunarc.cross_checks import DailyRotations, explain_step, find_steps
from sunarc.sky import Site

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


def main() -> None:
    """Print false alarms in a camera-year by case, as JSON lines."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--networks", type=int, default=20, help="of three cameras and a year, each case")
    asked = parser.parse_args()
    for name, case in CASES.items():
        rng = np.random.default_rng(1)
        total: Counter[str] = Counter()
        for _ in range(asked.networks):
            total += alarms(network(rng, case(rng)))
        years = asked.networks * CAMERAS
        rates = {cause: round(count / years, 3) for cause, count in sorted(total.items())}
        print(json.dumps({"case": name, "camera_years": years, "a_camera_year": rates}), flush=True)


if __name__ == "__main__":
    main()
