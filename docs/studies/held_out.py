"""Parts of real-like tracks, fitted and held against the sightings that they left out, with the guard and without.

    OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 python docs/studies/held_out.py --tracks 200 [--first 0] [--nasty 4]

Every track of `real_like_tracks` is cut (by turns, with its seed) into a third, every second, fifth or tenth sighting
and itself as a whole, or into two thirds, a half and alternating blocks of half an hour. Each part is fitted; where the
fit is accepted, the sightings of the rest that neither cloud nor a gross error moved are predicted. They lie within the
stated 95 % where their distance is within the ellipse of the stated covariance and of the noise that the generator gave
them. With --nasty the same is done with cameras and clocks that the fit has no model for, made here: a lens whose
radius has a kink, a camera on its side, detections that wander, a clock that drifts within the day, a camera turned by
0.1 degrees between two days, pixels that are 1.03 wide.

Printed for every case, before (the fit alone) and after (with parts held against the fit): parts,
how many are accepted, the share of their held-out sightings within the stated 95 %, how many accepted fits have one
beyond 5 sigma; and how many of those accepted before were right (error at most twice what they state, root mean squares
over the sky that the image shows, and no held-out sighting beyond 5 sigma), and how many of these are refused. With
--most DEG fits that state more are not counted, before and after.
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from real_like_tracks import Draw, Lens, Track, real_like_track
from scipy.spatial.transform import Rotation

from sunarc.calibration.answers.covariance import hemisphere, project_with_covariance
from sunarc.calibration.calibrate import calibrate
from sunarc.calibration.model.result import Calibration
from sunarc.sky.sun import sun_directions

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]

_WITHIN = -2.0 * math.log(0.05)
_FAR = 5.0
_RIGHT = 2.0
_BLOCK_S = 1800.0


class Part(NamedTuple):
    """One part of a track, fitted: see the module's docstring.

    accepted : before and after. shares, furthest : of the held-out sightings within 95 %, and the furthest in sigmas,
        before and after; NaN where nothing is held out. n : how many are. ratio : of true and stated error over the
        sky, before.
    """

    case: str
    cut: str
    accepted: tuple[bool, bool]
    shares: tuple[float, float]
    furthest: tuple[float, float]
    n: int
    ratio: float
    codes: str


def cuts(track: Track, seed: int) -> Iterator[tuple[str, BoolArray]]:
    """Yield names and masks (n,) of what is fitted."""
    time, rows = track.points.unix_s, np.arange(len(track.points))
    third, half = 3 * rows // rows.size, 2 * rows // rows.size
    block = np.floor((time - time[0]) / _BLOCK_S).astype(int) % 2
    thin = (2, 5, 10)[seed % 3]
    if seed % 2:
        yield "third", third == seed % 3
        yield f"every {thin}", rows % thin == 0
        yield "whole", np.ones(rows.size, dtype=bool)
    else:
        yield "two thirds", third != seed % 3
        yield "half", half == seed // 2 % 2
        yield "blocks", block == seed // 2 % 2


def noise_px(track: Track, directions: FloatArray) -> FloatArray:
    """Return the 1-sigma per axis that the generator gives sightings in some directions, px."""
    sigma = track.sigma_px * (1.0 + (1.0 - directions[:, 2]) ** 2)
    return np.asarray(np.hypot(sigma, math.sqrt(1.0 / 12.0) if track.drawn.rounded else 0.0))


def sigmas(fit: Calibration, pixels: FloatArray, directions: FloatArray, noise: FloatArray) -> FloatArray:
    """Return (n,): squares of the distances between pixels and prediction, in what is stated; infinite: not seen."""
    predicted, covariance = project_with_covariance(fit, directions)
    square = np.full(pixels.shape[0], np.inf)
    seen = np.all(np.isfinite(predicted), axis=-1)
    whole = covariance[seen] + noise[seen, None, None] ** 2 * np.eye(2)
    off = (pixels - predicted)[seen]
    square[seen] = np.einsum("ni,ni->n", off, np.linalg.solve(whole, off[..., None])[..., 0])
    return square


def sky_ratio(fit: Calibration, track: Track) -> float:
    """Return the true error over the stated one, root mean squares over the sky inside the image."""
    sky = hemisphere(600)
    true = track.true_pixels(sky)
    inside = np.all((true > 0.0) & (true < np.array(track.image_size)), axis=-1)
    predicted, covariance = project_with_covariance(fit, sky[inside])
    seen = np.all(np.isfinite(predicted), axis=-1)
    if not np.any(seen):
        return math.inf
    error = np.sum((predicted - true[inside])[seen] ** 2, axis=-1)
    return math.sqrt(float(np.mean(error)) / float(np.mean(np.trace(covariance[seen], axis1=1, axis2=2))))


class Case(NamedTuple):
    """A track, and the noise beside its own that its sightings have, px per axis."""

    track: Track
    noise_px: float = 0.0


def _plain(seed: int, **fixed: object) -> Track:
    """Return a clear day of a lens that is as the fit expects it."""
    draw = Draw(projection="equidistant", cloud="none", thin=1, half_day=False, gaps=False, rounded=False, tilt_deg=3.0)
    return real_like_track(seed, replace(draw, **fixed))  # type: ignore[arg-type]


def _seen_by(track: Track, lens: Lens, turns: tuple[Rotation, ...]) -> Track:
    """Return the track as another lens sees it, in the last of some poses from the second day on."""
    directions = sun_directions(track.points.unix_s, track.site)
    late = track.points.unix_s - track.points.unix_s[0] > 50_000.0
    before, after = (lens.project(turn.apply(directions)) for turn in (turns[0], turns[-1]))
    seen = track.points.pixels + np.where(late[:, None], after, before) - track.true_pixels(directions)
    shown = np.all(np.isfinite(seen), axis=-1)
    points = replace(track.points, pixels=seen).select(shown)
    clouded, wrong = track.clouded[shown], track.wrong[shown]
    return replace(track, points=points, lens=lens, turns=turns, clouded=clouded, wrong=wrong)


def kinked(seed: int) -> Case:
    """Return a lens whose radial residual has a corner at 30 to 60 degrees, 3 to 8 px at the edge."""
    track, rng = _plain(seed), np.random.default_rng((1, seed))
    corner, steep = math.radians(rng.uniform(30.0, 60.0)), rng.choice([-1.0, 1.0]) * rng.uniform(4.0, 10.0)

    def residual(theta: FloatArray) -> FloatArray:
        return np.asarray(steep * np.maximum(theta - corner, 0.0))

    return Case(_seen_by(track, replace(track.lens, residual_px=residual), track.turns))


def on_its_side(seed: int) -> Case:
    """Return a camera tilted by 45 to 60 degrees."""
    return Case(_plain(seed, tilt_deg=float(np.random.default_rng((2, seed)).uniform(45.0, 60.0))))


def wandering(seed: int) -> Case:
    """Return detections that wander by 1 px per axis, with a memory of half an hour."""
    track, rng = _plain(seed), np.random.default_rng((3, seed))
    steps = rng.normal(0.0, 1.0, (len(track.points), 2))
    rho = math.exp(-1.0 / 30.0)
    for row in range(1, steps.shape[0]):
        steps[row] = rho * steps[row - 1] + math.sqrt(1.0 - rho**2) * steps[row]
    return Case(track.with_pixels(track.points.pixels + steps), 1.0)


def drifting(seed: int) -> Case:
    """Return a clock that gains 20 to 120 s in the course of the day."""
    track, gain = _plain(seed), np.random.default_rng((4, seed)).uniform(20.0, 120.0)
    time = track.points.unix_s
    late = time + gain * (time - time[0]) / np.ptp(time)
    return Case(replace(track, points=replace(track.points, unix_s=late)))


def turned(seed: int) -> Case:
    """Return a camera that was turned by 0.1 degrees between two days."""
    track, rng = _plain(seed, days=2, cadence_s=120.0), np.random.default_rng((5, seed))
    axis = rng.normal(0.0, 1.0, 3)
    after = Rotation.from_rotvec(math.radians(0.1) * axis / np.linalg.norm(axis)) * track.turns[0]
    return Case(_seen_by(track, track.lens, (track.turns[0], after)))


class _Stretched(Lens):
    """A lens before a sensor whose pixels are 1.03 wide."""

    def project(self, rays: FloatArray) -> FloatArray:
        pixels = Lens.project(self, rays)
        return np.asarray((pixels - self.center_px) / np.array([1.03, 1.0]) + self.center_px)


def stretched(seed: int) -> Case:
    """Return pixels that are 1.03 wide."""
    track = _plain(seed)
    lens = _Stretched(**{name: getattr(track.lens, name) for name in Lens.__dataclass_fields__})
    return Case(_seen_by(track, lens, track.turns))


NASTY: dict[str, Callable[[int], Case]] = {
    "kink": kinked,
    "on its side": on_its_side,
    "wandering": wandering,
    "clock drift": drifting,
    "0.1° between days": turned,
    "pixels 1.03 wide": stretched,
}


def judged(case: Case, name: str, cut: str, mask: BoolArray, *, most_deg: float) -> Part:
    """Return what a part's fit comes to, before and after."""
    track = case.track
    fit = calibrate(track.points.select(mask), site=track.site, image_size=track.image_size, options=track.options)
    widening = fit.evidence.held_out.get("widening", 1.0)
    plain = replace(
        fit,
        covariance=fit.covariance / widening**2,
        field=fit.field.widened(1.0 / widening),
        sky_rms_deg=fit.sky_rms_deg / widening,
    )
    against = {finding.code for finding in fit.verdict.findings} if not fit.verdict.accepted else set()
    by_guard = {"held_out_contradicts"}
    if plain.sky_rms_deg <= track.options.max_sky_deg:
        by_guard.add("direction_sigma_too_large")
    before = against <= by_guard and plain.sky_rms_deg <= most_deg
    accepted = before, fit.verdict.accepted and fit.sky_rms_deg <= most_deg
    out = ~mask & ~track.clouded & ~track.wrong
    shares, furthest = (math.nan, math.nan), (math.nan, math.nan)
    if np.any(out) and fit.evidence.n_used:
        directions = sun_directions(track.points.unix_s[out], track.site)
        noise = np.hypot(noise_px(track, directions), case.noise_px)
        squares = [sigmas(one, track.points.pixels[out], directions, noise) for one in (plain, fit)]
        shares = float(np.mean(squares[0] <= _WITHIN)), float(np.mean(squares[1] <= _WITHIN))
        furthest = math.sqrt(float(np.max(squares[0]))), math.sqrt(float(np.max(squares[1])))
    ratio = sky_ratio(plain, track) if fit.evidence.n_used else math.inf
    return Part(name, cut, accepted, shares, furthest, int(np.sum(out)), ratio, " ".join(sorted(against)))


def line(name: str, parts: list[Part]) -> str:
    """Return a row of the table."""
    cells = []
    for after in (0, 1):
        mine = [part for part in parts if part.accepted[after]]
        held = [part for part in mine if part.n and math.isfinite(part.shares[after])]
        within = sum(part.shares[after] * part.n for part in held) / max(sum(part.n for part in held), 1)
        far = sum(part.furthest[after] > _FAR for part in held)
        cells.append(f"{len(mine)} | {within:.3f} | {far} of {len(held)}" if held else f"{len(mine)} | - | -")
    right = [part for part in parts if part.accepted[0] and part.ratio <= _RIGHT and not part.furthest[0] > _FAR]
    refused = sum(not part.accepted[1] for part in right)
    return f"| {name} | {len(parts)} | {cells[0]} | {cells[1]} | {refused} of {len(right)} |"


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--tracks", type=int, default=200)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--nasty", type=int, default=0)
    parser.add_argument("--most", type=float, default=math.inf)
    parser.add_argument("--verbose", action="store_true")
    chosen = parser.parse_args()
    cases: list[tuple[str, int, Callable[[int], Case]]] = [
        ("real-like", seed, lambda seed: Case(real_like_track(seed)))
        for seed in range(chosen.first, chosen.first + chosen.tracks)
    ]
    cases += [(name, seed, make) for name, make in NASTY.items() for seed in range(chosen.nasty)]
    found: list[Part] = []
    for name, seed, make in cases:
        case = make(seed)
        for cut, mask in cuts(case.track, seed):
            found.append(judged(case, name, cut, mask, most_deg=chosen.most))
            if chosen.verbose:
                print(seed, *found[-1], flush=True)
    print(
        "| case | parts | accepted | within 95 % | beyond 5 sigma | accepted | within 95 % | beyond 5 sigma | refused |"
    )
    print(f"|{'---|' * 9}")
    real = [part for part in found if part.case == "real-like"]
    for cut in dict.fromkeys(part.cut for part in real):
        print(line(cut, [part for part in real if part.cut == cut]))
    for name in dict.fromkeys(part.case for part in found):
        print(line(name, [part for part in found if part.case == name]))


if __name__ == "__main__":
    main()
