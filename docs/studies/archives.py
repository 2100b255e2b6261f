"""Epochs of archives whose cameras are bumped, given other lenses, drift, or have wrong clocks, against the truth.

    OMP_NUM_THREADS=1 python docs/studies/archives.py --seeds 6

Each archive is a table of sightings in photographs: 20 to 60 suns a day, hours of cloud without one, noise whose scale
differs by day and sky and has tails, a bias along the radius, reflections of the sun. The generator shares no code with
what is judged: sun, refraction and lens are those of `independent_world`, times and noise of this file. Printed are,
by kind of trouble, the changes that were found with their cause, between sightings within an hour of the true ones;
with another cause; missed; and reported where there was none. Then the epochs that are accepted and wrong by more than
3 times what they state over the sky, with zenith angles below 80 degrees, in some camera that they are said to hold
for; and by zenith angle the share of the sky within the stated 95 %.
"""

from __future__ import annotations

import argparse
import itertools
import math
import time
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from independent_world import FloatArray, Lens, Place, hemisphere, sun, turn
from numpy.typing import NDArray

from sunarc.archives.fit import CameraSightings, Final, final_analysis, first_analysis
from sunarc.archives.states import ArchiveCamera
from sunarc.calibration.answers.covariance import project_with_covariance
from sunarc.calibration.model.options import CalibrationOptions
from sunarc.calibration.model.sightings import Sightings
from sunarc.sky.site import Site

DAY_S, HOUR_S = 86_400.0, 3600.0
BANDS_DEG = (0.0, 30.0, 60.0, 75.0, 86.0)
_WITHIN_S = 1.0 * HOUR_S
_WITHIN_95 = 5.991
"""Chi-square of two degrees of freedom."""


class Spell(NamedTuple):
    """From a true time on: the camera, how far its clock is ahead, and what changed."""

    since: float
    lens: Lens
    ahead_s: float = 0.0
    cause: str = "start"


class Archive(NamedTuple):
    """Sightings at their stated times, the spell of each (n,), and when each was (n,)."""

    points: Sightings
    spells: list[Spell]
    of_spell: NDArray[np.int64]
    place: Place
    size: int


def lens_of(rng: np.random.Generator, size: int) -> Lens:
    """Draw a camera: tilted by some degrees, a radial residual of some pixels."""
    kind = str(rng.choice(["equidistant", "equisolid", "stereographic"]))
    share = {"equidistant": 0.6, "equisolid": 0.66, "stereographic": 0.46}[kind]
    focal = 0.5 * size * share * float(rng.uniform(0.9, 1.05))
    waves = rng.normal(0.0, 0.003, 3) * np.array([1.0, 0.7, 0.4])
    tilt = turn(np.append(np.radians(rng.normal(0.0, 2.0, 2)), 0.0))

    def residual(angle: FloatArray) -> FloatArray:
        bent = [wave * (np.sin((n + 2) * angle) - (n + 2) * np.sin(angle)) for n, wave in enumerate(waves)]
        return np.asarray(focal * np.sum(bent, axis=0))

    return Lens(
        projection=kind,
        focal_px=focal,
        center_px=(size - 1) / 2.0 + rng.normal(0.0, 0.01 * size, 2),
        residual_px=residual,
        decentering=rng.normal(0.0, 4e-4, 2),
        pose=tilt @ turn(np.array([0.0, 0.0, rng.uniform(0.0, 2.0 * math.pi)])),
    )


def refocused(lens: Lens, share: float) -> Lens:
    """Return a camera with a lens whose focal length differs by a share."""
    return replace(lens, focal_px=lens.focal_px * (1.0 + share))


def _sign(rng: np.random.Generator) -> float:
    return float(rng.choice([-1.0, 1.0]))


Drawn = tuple[np.random.Generator, Lens, FloatArray]
"""Chance, the camera at the start, and some times within the archive at which it changes."""


def _bump(given: Drawn) -> list[Spell]:
    rng, lens, at = given
    return [Spell(at[0], lens.moved(rng, rng.uniform(0.8, 5.0)), cause="moved")]


def _small_bump(given: Drawn) -> list[Spell]:
    rng, lens, at = given
    return [Spell(at[0], lens.moved(rng, rng.uniform(0.2, 0.8)), cause="moved")]


def _lens(given: Drawn) -> list[Spell]:
    rng, lens, at = given
    other = replace(
        refocused(lens, _sign(rng) * rng.uniform(0.02, 0.1)), center_px=lens.center_px + rng.normal(0, 3, 2)
    )
    return [Spell(at[0], other.moved(rng, rng.uniform(0.0, 1.0)), cause="lens")]


def _small_lens(given: Drawn) -> list[Spell]:
    rng, lens, at = given
    return [Spell(at[0], refocused(lens, _sign(rng) * rng.uniform(0.005, 0.02)), cause="lens")]


def _bump_and_lens(given: Drawn) -> list[Spell]:
    rng, lens, at = given
    moved = lens.moved(rng, 3.0)
    late = at[0] + 2.0 * DAY_S + rng.uniform(-3.0, 3.0) * HOUR_S
    return [Spell(at[0], moved, cause="moved"), Spell(late, refocused(moved, 0.08), cause="lens")]


def _clock(given: Drawn) -> list[Spell]:
    rng, lens, at = given
    ahead = _sign(rng) * float(np.exp(rng.uniform(math.log(240.0), math.log(4.0 * HOUR_S))))
    return [Spell(at[0], lens, ahead, "clock"), Spell(at[1], lens, 0.0, "clock")]


def _summer(given: Drawn) -> list[Spell]:
    rng, lens, at = given
    return [Spell(at[0], lens, _sign(rng) * HOUR_S, "clock")]


def _drift(given: Drawn) -> list[Spell]:
    """Return a camera that sinks a little every quarter of a day: no change, and nothing that holds for all days."""
    rng, lens, _ = given
    axis, rate = rng.normal(size=3), rng.uniform(0.01, 0.06)
    steps = np.arange(1, 4 * 40)
    turns = np.radians(0.25 * rate * steps)[:, None] * axis / np.linalg.norm(axis)
    return [
        Spell(given[2][2] + 0.25 * DAY_S * n, replace(lens, pose=turn(one) @ lens.pose), cause="")
        for n, one in zip(steps.tolist(), turns, strict=True)
    ]


def _clock_drift(given: Drawn) -> list[Spell]:
    rng, lens, at = given
    rate = _sign(rng) * rng.uniform(2.0, 30.0)
    return [Spell(at[2] + 0.25 * DAY_S * n, lens, 0.25 * n * rate, "") for n in range(1, 4 * 40)]


CASES: dict[str, Callable[[Drawn], list[Spell]]] = {
    "still": lambda _: [], "bump": _bump, "small bump": _small_bump, "lens": _lens, "small lens": _small_lens,
    "bump, lens": _bump_and_lens, "clock": _clock, "summer": _summer, "drift": _drift, "clock drift": _clock_drift,
}  # fmt: skip


def draw(rng: np.random.Generator, case: str) -> Archive:
    """Draw an archive."""
    place = Place(latitude=_sign(rng) * rng.uniform(20.0, 58.0), longitude=rng.uniform(-170.0, 170.0), altitude=300.0)
    size, days = int(rng.choice([480, 600, 960])), int(rng.integers(8, 15))
    apart, per_day = int(rng.choice([1, 1, 2])), int(rng.integers(20, 61))
    noon = 1.7e9 // DAY_S * DAY_S + 0.5 * DAY_S - 240.0 * place.longitude + DAY_S * int(rng.integers(0, 365))
    lens = lens_of(rng, size)
    changes = noon + DAY_S * apart * np.array([rng.integers(2, days // 2), rng.integers(days // 2 + 1, days - 1), 0.0])
    changes[:2] += rng.uniform(-4.0, 4.0, 2) * HOUR_S
    spells = [Spell(0.0, lens), *CASES[case]((rng, lens, changes - np.array([0.0, 0.0, 0.5 * DAY_S])))]
    times = np.concatenate([_times(rng, place, noon + DAY_S * apart * day, per_day) for day in range(days)])
    of_spell = np.searchsorted([one.since for one in spells], times, side="right") - 1
    pixels, sigma = _seen(rng, times, of_spell, spells, place)
    stated = times + np.array([spells[n].ahead_s for n in of_spell.tolist()])
    inside = np.all((pixels > 0) & (pixels < size), axis=1)
    rows = np.flatnonzero(inside)[np.argsort(stated[inside], kind="stable")]
    points = Sightings.of(unix_s=stated[rows], pixels=pixels[rows], sigma_px=sigma[rows])
    return Archive(points, spells, of_spell[rows].astype(np.int64), place, size)


def _times(rng: np.random.Generator, place: Place, noon: float, count: int) -> FloatArray:
    """Return when the sun is seen on a day, without the hours of cloud."""
    every = np.arange(noon - 9.0 * HOUR_S, noon + 9.0 * HOUR_S, 60.0)
    every = every[sun(every, place)[:, 2] > math.sin(math.radians(3.0))]
    times = every[np.linspace(0, every.size - 1, count).astype(int)] + rng.uniform(0.0, 20.0)
    for _ in range(int(rng.integers(0, 4))):
        begin = noon + rng.uniform(-7.0, 5.0) * HOUR_S
        times = times[(times < begin) | (times > begin + rng.uniform(0.5, 3.0) * HOUR_S)]
    return np.asarray(times)


def _seen(
    rng: np.random.Generator, times: FloatArray, of_spell: NDArray[np.int64], spells: list[Spell], place: Place
) -> tuple[FloatArray, FloatArray]:
    """Return the pixels (n, 2) that a detector finds, and the sigma that it states (n,)."""
    directions = sun(times, place)
    pixels = np.empty((times.size, 2))
    for number in np.unique(of_spell).tolist():
        rows = of_spell == number
        pixels[rows] = spells[number].lens.project(directions[rows])
    lens = spells[0].lens
    outwards = (pixels - lens.center_px) / lens.focal_px
    bias = rng.normal(0.0, 0.15) * outwards * np.linalg.norm(outwards, axis=1, keepdims=True)
    day = np.floor((times + 240.0 * place.longitude) / DAY_S)
    scale = np.ones(times.size)
    thin = np.zeros(times.size, dtype=bool)
    for one in np.unique(day).tolist():
        rows = day == one
        scale[rows] = float(np.exp(rng.normal(math.log(0.35), 0.35)))
        thin[rows] = rng.random(int(rows.sum())) < rng.choice([0.05, 0.2, 0.4])
    size = scale * np.where(thin, rng.uniform(2.0, 5.0, times.size), 1.0)
    noise = size[:, None] * rng.standard_t(5, (times.size, 2)) * math.sqrt(0.6)
    found = pixels + bias + noise
    false = rng.random(times.size) < rng.uniform(0.0, 0.06)
    found[false] = 2.0 * lens.center_px - pixels[false] + rng.normal(0.0, 3.0, (int(false.sum()), 2))
    return found, np.where(thin, 1.0, 0.5)


class Outcome(NamedTuple):
    """Counts of what was found, accepted epochs that are wrong, and the z² (n,) of the sky by zenith angle (n,)."""

    counts: Counter[str]
    wrong: list[str]
    square: FloatArray
    zenith_deg: FloatArray


def judged(archive: Archive) -> Outcome:
    """Return what the analysis of an archive says, against the truth."""
    camera = ArchiveCamera(
        Site(latitude=archive.place.latitude, longitude=archive.place.longitude, altitude=archive.place.altitude),
        (archive.size, archive.size),
        CalibrationOptions(),
    )
    given = CameraSightings(archive.points, camera)
    rough = first_analysis(given)
    if not rough.states:
        return Outcome(Counter({f"no epochs: {rough.findings[0].code}": 1}), [], np.zeros(0), np.zeros(0))
    final = final_analysis(given._replace(states=rough.states))
    said, wrong, square, zenith = changes_said(archive, final), list[str](), [np.zeros(0)], [np.zeros(0)]
    for n, epoch in enumerate(final.epochs):
        pose = final.states[epoch.state].pose
        if pose not in final.fitted:
            said["crash"] += 1
            continue
        calibration = final.fitted[pose].calibration
        if not calibration.verdict.accepted:
            said[f"refused: {calibration.verdict.findings[0].code}"] += 1
            continue
        said["accepted"] += 1
        stated = archive.points.unix_s
        valid = (stated >= epoch.start_unix_s) & (stated <= epoch.end_unix_s)
        z, at, ratio = errors_over_sky(archive, np.unique(archive.of_spell[valid]), calibration)
        square.append(z)
        zenith.append(at)
        if ratio > 3.0:
            wrong.append(f"epoch {n + 1} of {len(final.epochs)} ({epoch.cause}): {ratio:.1f}")
    return Outcome(said, wrong, np.concatenate(square), np.concatenate(zenith))


def changes_said(archive: Archive, final: Final) -> Counter[str]:
    """Return how the changes that were found are to the true ones."""
    said, stated = Counter[str](), archive.points.unix_s
    found = [(one.cause, before.end_unix_s, one.start_unix_s) for before, one in itertools.pairwise(final.epochs)]
    first = {int(number): int(np.argmax(archive.of_spell == number)) for number in np.unique(archive.of_spell)}
    for number, spell in enumerate(archive.spells):
        if spell.cause not in ("moved", "lens", "clock") or number not in first:
            continue
        low, high = float(stated[max(first[number] - 1, 0)]) - _WITHIN_S, float(stated[first[number]]) + _WITHIN_S
        near = [one for one in found if one[1] <= high and one[2] >= low]
        if not near:
            said["missed"] += 1
            continue
        found.remove(near[0])
        said["right" if near[0][0] == spell.cause else f"{near[0][0]} for {spell.cause}"] += 1
    for one in found:
        said[f"false {one[0]}"] += 1
    return said


def errors_over_sky(
    archive: Archive, numbers: NDArray[np.int64], calibration: object
) -> tuple[FloatArray, FloatArray, float]:
    """Return z² and zenith angles over the sky in the spell with most sightings, and the worst error over stated."""
    sky = hemisphere(600)
    sky = sky[sky[:, 2] > math.cos(math.radians(BANDS_DEG[-1]))]
    predicted, covariance = project_with_covariance(calibration, sky)  # type: ignore[arg-type]
    zenith = np.degrees(np.arccos(sky[:, 2]))
    within = zenith < 80.0
    ratios, squares = [], []
    counts = [int(np.sum(archive.of_spell == number)) for number in numbers.tolist()]
    for number in numbers.tolist():
        off = predicted - archive.spells[number].lens.project(sky)
        stated = np.trace(covariance, axis1=1, axis2=2)
        ratios.append(math.sqrt(float(np.nanmean(np.sum(off**2, axis=1)[within]) / np.nanmean(stated[within]))))
        squares.append(np.einsum("ni,nij,nj->n", off, np.linalg.inv(covariance), off))
    most = int(np.argmax(counts))
    seen = np.isfinite(squares[most])
    return squares[most][seen], zenith[seen], max(ratios)


def rows_of(cases: list[str], seeds: range) -> Iterator[tuple[str, int, Outcome, float]]:
    """Yield what was said of each archive, and the seconds that it took."""
    for case in cases:
        for seed in seeds:
            begun = time.process_time()
            outcome = judged(draw(np.random.default_rng((seed, list(CASES).index(case))), case))
            yield case, seed, outcome, time.process_time() - begun


def main() -> None:
    """Print a line for each archive, then a table by case."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=6)
    parser.add_argument("--first", type=int, default=0, help="the first seed")
    parser.add_argument("--cases", nargs="*", choices=tuple(CASES), default=list(CASES))
    asked = parser.parse_args()
    total: dict[str, Counter[str]] = {case: Counter() for case in asked.cases}
    squares, zeniths = [], []
    for case, seed, outcome, took in rows_of(asked.cases, range(asked.first, asked.first + asked.seeds)):
        outcome.counts["wrong"] += len(outcome.wrong)
        total[case] += outcome.counts
        squares.append(outcome.square)
        zeniths.append(outcome.zenith_deg)
        said = ", ".join(f"{n} {one}" for one, n in sorted(outcome.counts.items()) if n)
        print(f"{case} {seed}: {said} {'; '.join(outcome.wrong)} ({took:.0f} s)", flush=True)
    for case, counted in total.items():
        print(f"| {case} | {', '.join(f'{one} {n}' for one, n in counted.most_common() if n)} |")
    square, zenith = np.concatenate(squares), np.concatenate(zeniths)
    for low, high in itertools.pairwise(BANDS_DEG):
        part = square[(zenith >= low) & (zenith < high)]
        within, z = np.mean(part < _WITHIN_95), np.sqrt(np.mean(part) / 2)
        print(f"| {low:.0f} to {high:.0f} | within 95 %: {within:.3f} | z {z:.2f} |")


if __name__ == "__main__":
    main()
