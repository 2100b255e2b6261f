"""How often a day of which slots were missed is called clear, against what its clouds were.

    .venv/bin/python docs/studies/missed_slots.py --days 300

Days at the SGP site with a slot a minute, clouds and gaps of exponential lengths (their sum 5 to 60 min, log-uniform),
sky covers from 0 to 60 %, 0.05 px of noise; each day under each pattern of missed slots. The truth is the share of all
slots between the first and the last observed one in which the sun was to be seen.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sunarc.calibration.model.sightings import Sightings
from sunarc.calibration.quality.day_quality import decide_day, measure_day
from sunarc.lab.simulation.truth import true_camera
from sunarc.optics.camera import Camera
from sunarc.optics.forward import project
from sunarc.sky.site import Site
from sunarc.sky.sun import sun_angles, sun_directions

BoolArray = NDArray[np.bool_]
FloatArray = NDArray[np.float64]

SITE = Site(latitude=36.604043, longitude=-97.484856, altitude=318.0)
CADENCE_S = 60.0
NOISE_PX = 0.05
_MIDNIGHT = 1_368_403_200.0 + 97.484856 * 240.0  # local mean solar, 13 May 2013
CLOUDY_BELOW, CLEAR_ABOVE = 0.7, 0.9
"""True shares that no verdict "clear", and no other one, is right for; between them either will do."""

Pattern = Callable[[np.random.Generator, BoolArray], BoolArray]


@dataclass(frozen=True, slots=True, kw_only=True)
class Judged:
    """A day's verdict, and the true share of its span in which the sun was to be seen."""

    kind: str
    share: float


def spells(rng: np.random.Generator, n: int, *, on: float, off: float) -> BoolArray:
    """Return n slots of alternating spells whose lengths are exponential with these means, in slots."""
    state, place, out = bool(rng.random() < on / max(on + off, 1e-9)), 0.0, np.zeros(n, dtype=bool)
    while place < n:
        length = rng.exponential(max(on if state else off, 1e-3))
        out[round(place) : round(place + length)] = state
        place, state = place + length, not state
    return out


def clouds(rng: np.random.Generator, n: int) -> BoolArray:
    """Return in which of n slots the sun is to be seen."""
    period, cover = np.exp(rng.uniform(np.log(5.0), np.log(60.0))), rng.uniform(0.0, 0.6)
    return spells(rng, n, on=period * (1.0 - cover), off=period * cover)


def one_burst(rng: np.random.Generator, clear: BoolArray, *, slots: int) -> BoolArray:
    """Return one run of observed slots at the beginning and one at the end, with a few hours between."""
    del rng
    index = np.arange(clear.size)
    return (index < slots) | (index >= clear.size - slots)


PATTERNS: dict[str, Pattern] = {
    "none missed": lambda _, clear: np.ones(clear.size, dtype=bool),
    "half missed": lambda rng, clear: rng.random(clear.size) < 0.5,
    "nine tenths missed": lambda rng, clear: rng.random(clear.size) < 0.1,
    "bursts of 5 in 15 min": lambda rng, clear: spells(rng, clear.size, on=5.0, off=10.0),
    "bursts of 10 in 60 min": lambda rng, clear: spells(rng, clear.size, on=10.0, off=50.0),
    "first and last hour": lambda rng, clear: one_burst(rng, clear, slots=60),
    "first and last 15 min": lambda rng, clear: one_burst(rng, clear, slots=15),
    "from 15:00 on": lambda _, clear: np.arange(clear.size) >= 0.7 * clear.size,
    "the morning, half missed": lambda rng, clear: (
        (np.arange(clear.size) < 0.5 * clear.size) & (rng.random(clear.size) < 0.5)
    ),
    "25 slots": lambda rng, clear: np.isin(np.arange(clear.size), rng.choice(clear.size, 25, replace=False)),
}


class Days:
    """Draws days and judges them."""

    def __init__(self, *, seed: int, camera: Camera | None = None) -> None:
        self._rng = np.random.default_rng(seed)
        times = _MIDNIGHT + np.arange(0.0, 86_400.0, CADENCE_S)
        self.times: FloatArray = times[sun_angles(times, SITE).apparent_zenith < 89.6] + 0.5
        self._track = project(true_camera() if camera is None else camera, sun_directions(self.times, SITE))

    def clouds(self) -> BoolArray:
        """Return a day's sky: in which slots the sun is to be seen."""
        return clouds(self._rng, self.times.size)

    def observed(self, pattern: str, clear: BoolArray) -> BoolArray:
        """Return which slots are observed."""
        return PATTERNS[pattern](self._rng, clear)

    def judge(self, clear: BoolArray, observed: BoolArray) -> Judged:
        """Return the verdict of a day."""
        seen, pixels = clear & observed, self._track + self._rng.normal(0.0, NOISE_PX, self._track.shape)
        measure = measure_day(
            Sightings.of(unix_s=self.times[seen], pixels=pixels[seen]),
            site=SITE,
            n_possible=self.times.size,
            observed_unix_s=self.times[observed],
            cadence_s=CADENCE_S,
        )
        span = np.flatnonzero(observed)
        share = float(np.mean(clear[span[0] : span[-1] + 1])) if span.size else 0.0
        return Judged(kind=decide_day(measure).kind, share=share)


def table(n_days: int, *, seed: int = 1) -> dict[str, list[Judged]]:
    """Return the verdicts of some days under every pattern."""
    days = Days(seed=seed)
    judged: dict[str, list[Judged]] = {pattern: [] for pattern in PATTERNS}
    for number in range(n_days):
        clear = np.ones(days.times.size, dtype=bool) if number % 5 == 0 else days.clouds()
        for pattern, found in judged.items():
            found.append(days.judge(clear, days.observed(pattern, clear)))
    return judged


def false_clear(judged: list[Judged]) -> tuple[int, int]:
    """Return how many days with too much cloud were called clear, and how many such days there were."""
    cloudy = [day for day in judged if day.share < CLOUDY_BELOW]
    return sum(day.kind == "clear" for day in cloudy), len(cloudy)


def clear_found(judged: list[Judged]) -> tuple[int, int]:
    """Return how many days with hardly any cloud were called clear, and how many such days there were."""
    clear = [day for day in judged if day.share > CLEAR_ABOVE]
    return sum(day.kind == "clear" for day in clear), len(clear)


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--days", type=int, default=300, help="for each pattern")
    parser.add_argument("--seed", type=int, default=1)
    options = parser.parse_args()
    print("| slots missed | called clear, of days under 70 % | called clear, of days over 90 % | unusable |")
    print("|---|---|---|---|")
    for pattern, judged in table(options.days, seed=options.seed).items():
        (false, cloudy), (right, clear) = false_clear(judged), clear_found(judged)
        unusable = sum(day.kind == "unusable" for day in judged)
        print(f"| {pattern} | {false} of {cloudy} | {right} of {clear} | {unusable} of {len(judged)} |")


if __name__ == "__main__":
    main()
