"""Cross-checks of neighbouring cameras: who is named, rightly and wrongly, of what was injected, and where nothing was.

    python docs/studies/cross_checks.py [--networks N] [--cameras N...]

A network is made by nothing of sunarc's: each camera's daily rotation is white noise of 3, 2 and 4 thousandths of a
degree and a season of a hundredth, on 60 % of 90 days, and what the case adds. On day 60 the first camera changes, or
several do. On five nights until day 80 the last 60 days are compared, as the hub does. Of each network is counted who
was named in any of these nights, slow turns apart: the right camera with its cause, as `moved` alone, with another
cause, on another day, or another camera. `unconfirmed` is a change that too few neighbours show: of no camera by name;
`alone:` is what would be named without them.
"""

from __future__ import annotations

import argparse
import json
from collections import Counter
from collections.abc import Callable
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from sunarc.changes.daily_rotations import DailyRotations
from sunarc.changes.fleet import FEWEST_AGREEING, agreeing, explain_step, find_steps
from sunarc.sky.site import Site

Array = NDArray[np.float64]
Random = np.random.Generator
LATITUDE = 36.6
SITE = Site(latitude=LATITUDE, longitude=-97.5)
SIGMA = np.array([0.003, 0.002, 0.004])
DAYS, CHANGED, WINDOW, NIGHTS = 90, 60, 60, (64, 68, 72, 76, 80)


def plain(_rng: Random, cameras: int) -> Array:
    """Return nothing beside noise and season."""
    return np.zeros((cameras, DAYS, 3))


def heavy(rng: Random, cameras: int) -> Array:
    """Return days of cloud that draws the sightings aside: one in ten, five times the noise."""
    return (rng.random((cameras, DAYS, 1)) < 0.1) * rng.normal(0.0, 5.0 * SIGMA, (cameras, DAYS, 3))


def drifting(rng: Random, cameras: int) -> Array:
    """Return a bias with a memory of a week, as large as the noise."""
    made = rng.normal(0.0, 0.5 * SIGMA, (cameras, DAYS, 3))
    for day in range(1, DAYS):
        made[:, day] += 0.87 * made[:, day - 1]
    return made


def common(rng: Random, cameras: int) -> Array:
    """Return what all have alike: a large bias with a memory, and a step near the day of the change."""
    one = 4.0 * drifting(rng, 1)
    one[:, CHANGED + int(rng.integers(-9, 9)) :] += rng.normal(0.0, 0.05, 3)
    return np.repeat(one, cameras, axis=0)


def settling(rng: Random, cameras: int) -> Array:
    """Return masts that settle by 0.1 degrees about any axis, within weeks from a day on, every second camera."""
    made = np.zeros((cameras, DAYS, 3))
    for camera in range(1, cameras, 2):
        since = np.maximum(np.arange(DAYS) - rng.integers(0, CHANGED), 0)
        made[camera] = np.outer(0.1 * (1.0 - np.exp(-since / 20.0)), direction(rng))
    return made


def walking(rng: Random, cameras: int) -> Array:
    """Return mounts that walk by 0.002 degrees a day."""
    return np.cumsum(rng.normal(0.0, 0.002, (cameras, DAYS, 3)), axis=1)


def direction(rng: Random) -> Array:
    """Return any axis."""
    axis = rng.normal(size=3)
    return np.asarray(axis / np.linalg.norm(axis))


POLE = np.array([0.0, np.cos(np.radians(LATITUDE)), np.sin(np.radians(LATITUDE))])
CASES: dict[str, Callable[[Random, int], Array]] = {
    one.__name__: one for one in (plain, heavy, drifting, common, settling, walking)
}
CHANGES: dict[str, Callable[[Random], Array] | None] = {
    "none": None,
    "clock": lambda _rng: -POLE * 4.0 * 15.0 / 3600.0,  # 4 s ahead
    "north": lambda _rng: np.array([0.0, 0.0, 0.1]),
    "moved": lambda rng: 0.05 * direction(rng),
}


def network(rng: Random, extra: Array, *, understated: float) -> list[DailyRotations]:
    """Return the rotations of cameras whose days state a sigma that is too small by a factor."""
    made, days = [], np.arange(DAYS)
    for of_camera in extra:
        season = np.outer(np.sin(2.0 * np.pi * (days / 365.0 + rng.random())), rng.normal(0.0, 0.01, 3))
        rotation = season + of_camera + rng.normal(0.0, SIGMA, (DAYS, 3))
        shown = rng.random(DAYS) < 0.6
        stated = np.broadcast_to(np.diag(SIGMA**2) / understated**2, (int(shown.sum()), 3, 3)).copy()
        made.append(DailyRotations(day=days[shown].astype(float), rotation_deg=rotation[shown], covariance_deg2=stated))
    return made


def until(one: DailyRotations, night: int) -> DailyRotations:
    """Return the days that are compared in a night."""
    near = (one.day > night - WINDOW) & (one.day <= night)
    return DailyRotations(
        day=one.day[near], rotation_deg=one.rotation_deg[near], covariance_deg2=one.covariance_deg2[near]
    )


def named(cameras: list[DailyRotations], changed: int, cause: str) -> tuple[set[str], list[tuple[float, bool]]]:
    """Return what was said in the nights, with and without agreement (`alone:`), and each confidence with its truth."""
    said, sure = set[str](), list[tuple[float, bool]]()
    for night in NIGHTS:
        compared = [until(one, night) for one in cameras]
        for number, step in enumerate(find_steps(compared)):
            if step is None:
                continue
            explained, confidence = explain_step(step, before=SITE, after=SITE)
            if explained.cause == "slow_turn":
                continue
            what = "wrong camera" if number >= changed else "right"
            if what == "right" and abs(step.time - CHANGED) >= 5.0:
                what = "other day"
            elif what == "right" and explained.cause != cause:
                what = "moved" if explained.cause == "moved" else "other cause"
            agreed = agreeing(compared, number, step) >= FEWEST_AGREEING
            said |= {f"alone: {what}", what if agreed else "unconfirmed"}
            if agreed:
                sure.append((confidence, what == "right"))
    return said, sure


def main() -> None:
    """Print shares of networks, as JSON lines."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--networks", type=int, default=20, help="of each case, change and number of cameras")
    parser.add_argument("--cameras", type=int, nargs="+", default=[3, 4, 6])
    parser.add_argument("--changed", type=int, default=1, help="how many cameras change alike on the same day")
    parser.add_argument("--understated", type=float, default=1.0, help="by how much days state too small a sigma")
    parser.add_argument("--seed", type=int, default=1)
    asked = parser.parse_args()
    pooled, sure = Counter[tuple[int, str, str]](), list[tuple[float, bool]]()
    for cameras in asked.cameras:
        for case, extra_of in CASES.items():
            for change, size_of in CHANGES.items():
                rng = np.random.default_rng([asked.seed, cameras])
                counts = Counter[str]()
                for _ in range(asked.networks):
                    extra = extra_of(rng, cameras)
                    if size_of is not None:
                        extra[: asked.changed, CHANGED:] += size_of(rng)
                    changed = asked.changed if size_of is not None else 0
                    said, of_network = named(network(rng, extra, understated=asked.understated), changed, change)
                    counts.update(said)
                    sure += of_network
                shares = {what: round(n / asked.networks, 2) for what, n in sorted(counts.items())}
                print(json.dumps({"cameras": cameras, "case": case, "change": change} | shares), flush=True)
                which = "none" if size_of is None else "one"
                pooled.update({(cameras, which, what): n for what, n in counts.items()})
                pooled[cameras, which, "networks"] += asked.networks
    for (cameras, which, what), n in sorted(pooled.items()):
        print(json.dumps({"cameras": cameras, "changed": which, what: n}))
    edges = (0.0, 0.5, 0.8, 0.95, 0.99, 1.01)
    for low, high in pairwise(edges):
        right = [truth for stated, truth in sure if low <= stated < high]
        if right:
            print(json.dumps({"confidence": [low, high], "named": len(right), "cause right": round(np.mean(right), 2)}))


if __name__ == "__main__":
    main()
