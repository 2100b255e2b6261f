"""What a calibration states where something is not as it assumes: true beside stated errors over the sky.

    OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 python docs/studies/wrong_assumptions.py [--rows NAME]… [--lenses 6]
        [--processes 1] [--first 0] [--list] [--chance 300]

The worlds are those of `independent_world`: no code is shared with the fit. Printed for every row, over its lenses: how
many are accepted (two counts: those, and those that are refused), by which codes others are refused, and of those
accepted the root mean squares of the true and of the stated error over the upper hemisphere inside the image, px, the
worst ratio of both, and the shares of directions within the stated 50 and 95 % (of the least favourable lens, too);
then the same ratio for those refused, and those refused that were right: stated at most 1.6 times too small.
Where a camera moves, the truth is how it stands at the end. With --chance accepted fits are also held against draws of
their own ensembles in place of the truth: the row's worst ratio where what is stated is right, in 50 and 95 % of runs.
"""

from __future__ import annotations

import argparse
import itertools
import math
import multiprocessing
from collections import Counter
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import NamedTuple

import independent_world as world
import numpy as np
from independent_world import FloatArray, Lens, World

from sunarc.calibration.answers.covariance import project_with_covariance
from sunarc.calibration.answers.error_model import draw_ensemble
from sunarc.calibration.model.options import CalibrationOptions
from sunarc.calibration.model.result import Calibration
from sunarc.calibration.model.sightings import Sightings
from sunarc.changes.record import calibrate_moved
from sunarc.sky.site import Site

_WITHIN_50, _WITHIN_95 = -2.0 * math.log(0.5), -2.0 * math.log(0.05)
_RIGHT = 1.6
_DIRECTIONS = 800
_CADENCE_S = 60.0

Drawn = Callable[[np.random.Generator], World]
Change = Callable[[np.random.Generator, World], World]


def plain(rng: np.random.Generator, *, days: int, sigma_px: float = 0.05, lens: Lens | None = None) -> World:
    """Draw clear days of a camera that is as the fit assumes."""
    place, camera = world.drawn_place(rng), world.drawn_lens(rng) if lens is None else lens
    return seen(rng, camera, place, world.times_of(rng, place, days=days, cadence_s=_CADENCE_S), sigma_px)


def seen(rng: np.random.Generator, lens: Lens, place: world.Place, unix_s: FloatArray, sigma_px: float) -> World:
    """Return what a camera shows of the sun inside its image."""
    pixels = lens.project(world.sun(unix_s, place)) + rng.normal(0.0, sigma_px, (unix_s.size, 2))
    inside = np.all((pixels > 1.0) & (pixels < world.SIZE - 2.0), axis=-1)
    return World(place=place, lens=lens, unix_s=unix_s[inside], pixels=pixels[inside], sigma_px=sigma_px)


def again(rng: np.random.Generator, drawn: World, lens: Lens) -> World:
    """Return the same times as another lens shows them."""
    return seen(rng, lens, drawn.place, drawn.unix_s, drawn.sigma_px)


def wide_pixels(rng: np.random.Generator, drawn: World, *, wide: float) -> World:
    """Make pixels wider than high."""
    return again(rng, drawn, replace(drawn.lens, wide=wide))


def outwards(_: np.random.Generator, drawn: World) -> World:
    """Detect 0.1 px outwards along the radius."""
    off = drawn.pixels - drawn.lens.center_px
    return replace(drawn, pixels=drawn.pixels + 0.1 * off / np.linalg.norm(off, axis=-1)[:, None])


def drifting(rng: np.random.Generator, drawn: World) -> World:
    """Let the clock gain half a second an hour, right at some moment of the day."""
    right = rng.uniform(drawn.unix_s[0], drawn.unix_s[-1])
    return replace(drawn, unix_s=drawn.unix_s + 0.5 * (drawn.unix_s - right) / 3600.0)


def moving(
    rng: np.random.Generator, drawn: World, *, degrees: tuple[float, float], share: tuple[float, float]
) -> World:
    """Move the camera once, at a share of the sightings."""
    after = drawn.lens.moved(rng, rng.uniform(*degrees))
    late = np.arange(drawn.unix_s.size) >= rng.uniform(*share) * drawn.unix_s.size
    if share[0] == share[1]:  # between two days
        late = drawn.unix_s > np.median(drawn.unix_s)
    pixels = np.where(late[:, None], after.project(world.sun(drawn.unix_s, drawn.place)), drawn.pixels)
    pixels[late] += rng.normal(0.0, drawn.sigma_px, (int(late.sum()), 2))
    return replace(drawn, lens=after, pixels=pixels)


def turning(rng: np.random.Generator, drawn: World, *, deg_per_h: float = 0.0, sway_deg: float = 0.0) -> World:
    """Turn the mount about an axis within every day: by so much an hour from noon, or to and fro with the sun."""
    axis = rng.normal(size=3)
    axis /= np.linalg.norm(axis)
    hours = (drawn.unix_s / 3600.0 + drawn.place.longitude / 15.0) % 24.0 - 12.0
    angle = np.radians(deg_per_h * hours + sway_deg * np.sin(hours * math.pi / 12.0))
    towards = world.sun(drawn.unix_s, drawn.place)
    # a mount that turns sees the sky turn the other way; angles of a degree at most
    towards = towards - angle[:, None] * np.cross(axis, towards)
    pixels = drawn.lens.project(towards / np.linalg.norm(towards, axis=-1, keepdims=True))
    return replace(drawn, pixels=pixels + rng.normal(0.0, drawn.sigma_px, pixels.shape))


def rescaled(rng: np.random.Generator, drawn: World, *, scale: float = 1.0, crop_px: float = 0.0) -> World:
    """Let a program scale and crop the pictures of the later days otherwise: the camera is that of the last."""
    late = drawn.unix_s > np.median(drawn.unix_s)
    towards = rng.normal(size=2)
    moved = crop_px * towards / np.linalg.norm(towards)

    def changed(pixels: FloatArray) -> FloatArray:
        return np.asarray((scale - 1.0) * pixels + moved)

    pixels = np.where(late[:, None], drawn.pixels + changed(drawn.pixels), drawn.pixels)
    return replace(drawn, pixels=pixels, lens=replace(drawn.lens, smear=changed))


def stepped(_: np.random.Generator, drawn: World, *, clock_s: float) -> World:
    """Let the clock run ahead on the earlier days; it is right on the last."""
    late = drawn.unix_s > np.median(drawn.unix_s)
    return replace(drawn, unix_s=drawn.unix_s + clock_s * ~late)


def cut(_: np.random.Generator, drawn: World) -> World:
    """Cut pixels to whole numbers."""
    return replace(drawn, pixels=np.floor(drawn.pixels))


def in_minutes(rng: np.random.Generator, drawn: World) -> World:
    """Cut times to whole minutes, of exposures at 37 s."""
    minute = np.floor(drawn.unix_s / 60.0) * 60.0
    return replace(again_at(rng, drawn, minute + 37.0), unix_s=minute)


def morning(rng: np.random.Generator, drawn: World) -> World:
    """Keep the first six hours, beside a field of 0.3 px."""
    lens = replace(drawn.lens, smear=world.smooth_field(rng, size_px=0.3, length_px=425.0))
    early = drawn.unix_s < drawn.unix_s[0] + 6.0 * 3600.0
    return again(rng, replace(drawn, unix_s=drawn.unix_s[early]), lens)


def few(rng: np.random.Generator, drawn: World) -> World:
    """Keep twenty sightings."""
    kept = np.sort(rng.choice(drawn.unix_s.size, 20, replace=False))
    return replace(drawn, unix_s=drawn.unix_s[kept], pixels=drawn.pixels[kept])


def kinked(rng: np.random.Generator, drawn: World) -> World:
    """Bend the radius at 30 to 60 degrees: 2 to 6 px at the horizon."""
    corner, steep = math.radians(rng.uniform(30.0, 60.0)), rng.choice([-1.0, 1.0]) * rng.uniform(3.0, 6.0)
    smooth = drawn.lens.residual_px

    def residual(angle: FloatArray) -> FloatArray:
        return np.asarray(smooth(angle) + steep * np.maximum(angle - corner, 0.0))

    return again(rng, drawn, replace(drawn.lens, residual_px=residual))


def domed(rng: np.random.Generator, drawn: World) -> World:
    """Put the lens 3 to 8 mm beside the centre of its dome."""
    return again(rng, drawn, replace(drawn.lens, bend=world.dome(rng, displaced_mm=rng.uniform(3.0, 8.0))))


def rolling(rng: np.random.Generator, drawn: World) -> World:
    """Read the rows one after the other in 8 s, the time being that of the middle row."""
    late = 8.0 * (drawn.pixels[:, 1] / world.SIZE - 0.5)
    return again_at(rng, drawn, drawn.unix_s + late)


def again_at(rng: np.random.Generator, drawn: World, truly_s: FloatArray) -> World:
    """Return the sun of other times with the times that are recorded."""
    pixels = drawn.lens.project(world.sun(truly_s, drawn.place))
    return replace(drawn, pixels=pixels + rng.normal(0.0, drawn.sigma_px, pixels.shape))


def mixed(rng: np.random.Generator, drawn: World) -> World:
    """Show some runs of ten minutes by another lens of the same kind in the same place."""
    other = world.drawn_lens(rng)
    other = replace(other, pose=drawn.lens.pose, center_px=drawn.lens.center_px + rng.normal(0.0, 1.0, 2))
    other = replace(other, focal_px=drawn.lens.focal_px + rng.normal(0.0, 1.0))
    theirs = rng.random(drawn.unix_s.size // 10 + 1)[np.arange(drawn.unix_s.size) // 10] < 0.4
    pixels = np.where(theirs[:, None], other.project(world.sun(drawn.unix_s, drawn.place)), drawn.pixels)
    pixels[theirs] += rng.normal(0.0, drawn.sigma_px, (int(theirs.sum()), 2))
    return replace(drawn, pixels=pixels)


def in_steps(_: np.random.Generator, drawn: World) -> World:
    """Round to whole pixels."""
    return replace(drawn, pixels=np.round(drawn.pixels))


def ghost(rng: np.random.Generator, drawn: World) -> World:
    """In half of the day draw every second sighting towards a reflection, 2 to 5 px at the horizon."""
    late = drawn.unix_s > np.median(drawn.unix_s)
    hit = late & (rng.random(late.size) < 0.5)
    towards = (drawn.lens.center_px - drawn.pixels) / (2.0**0.5 * drawn.lens.focal_px) * rng.uniform(2.0, 5.0)
    return replace(drawn, pixels=drawn.pixels + towards * hit[:, None])


def seasonal(weeks: int, share: float, *, step_weeks: int = 1) -> Drawn:
    """Return the generator of a day a week by a lens whose focal length follows the year; its camera is the last."""

    def drawn(rng: np.random.Generator) -> World:
        place, lens = world.drawn_place(rng), world.drawn_lens(rng)
        noon = 1_746_100_800.0 - 240.0 * place.longitude
        days = noon + 7.0 * 86_400.0 * step_weeks * np.arange(weeks // step_weeks)
        times = (days[:, None] + np.arange(-32_400.0, 32_400.0, 600.0)).ravel()
        times = times[world.sun(times, place)[:, 2] > math.sin(math.radians(2.0))]
        warm = np.cos(2.0 * math.pi * (times / 86_400.0 - 20_300.0) / 365.25 + rng.uniform(0.0, 0.5))
        # a radius that grows about the centre, whatever the lens
        pixels = lens.center_px + (1.0 + share * warm[:, None]) * (
            lens.project(world.sun(times, place)) - lens.center_px
        )
        pixels += rng.normal(0.0, 0.15, pixels.shape)
        inside = np.all((pixels > 1.0) & (pixels < world.SIZE - 2.0), axis=-1)
        grown, center = share * float(warm[-1]), lens.center_px
        now = replace(lens, smear=lambda pixels: grown * (pixels - center))
        return World(place=place, lens=now, unix_s=times[inside], pixels=pixels[inside], sigma_px=0.15)

    return drawn


def row(days: int, change: Change | None = None, *, sigma_px: float = 0.05) -> Drawn:
    """Return what draws the worlds of a row."""

    def drawn(rng: np.random.Generator) -> World:
        made = plain(rng, days=days, sigma_px=sigma_px)
        return made if change is None else change(rng, made)

    return drawn


def decentred(rng: np.random.Generator) -> World:
    """Draw a lens with 5 px of decentering at the horizon, one day."""
    return plain(rng, days=1, lens=world.drawn_lens(rng, decentering_px=5.0))


_BETWEEN = partial(moving, degrees=(0.1, 0.1), share=(0.5, 0.5))
_WITHIN = partial(moving, degrees=(0.05, 0.5), share=(0.3, 0.7))
ROWS: dict[str, tuple[Drawn, int]] = {
    "nothing, 1 day": (row(1), 12),
    "nothing, 4 days": (row(4), 12),
    "nothing, 1 day, sigma 0.3": (row(1, sigma_px=0.3), 12),
    "nothing, 4 days, sigma 0.3": (row(4, sigma_px=0.3), 12),
    "pixels 1.03 wide, 1 day": (row(1, partial(wide_pixels, wide=1.03)), 6),
    "pixels 1.03 wide, 4 days": (row(4, partial(wide_pixels, wide=1.03)), 6),
    "pixels 1.02 wide, 1 day": (row(1, partial(wide_pixels, wide=1.02)), 6),
    "pixels 1.005 wide, 1 day": (row(1, partial(wide_pixels, wide=1.005)), 6),
    "0.1 px outwards, 1 day": (row(1, outwards), 6),
    "0.1 px outwards, 4 days": (row(4, outwards), 6),
    "clock drifts, 1 day": (row(1, drifting), 6),
    "moved between days": (row(4, _BETWEEN), 6),
    "moved within a day": (row(1, _WITHIN), 12),
    "clock steps by 18 s, 4 days": (row(4, partial(stepped, clock_s=18.0)), 6),
    "turns 0.02 deg/h, 1 day": (row(1, partial(turning, deg_per_h=0.02)), 6),
    "turns 0.05 deg/h, 1 day": (row(1, partial(turning, deg_per_h=0.05)), 6),
    "turns 0.03 deg/h, 4 days": (row(4, partial(turning, deg_per_h=0.03)), 6),
    "sways 0.3 deg with the sun, 1 day": (row(1, partial(turning, sway_deg=0.3)), 6),
    "sways 0.3 deg with the sun, 4 days": (row(4, partial(turning, sway_deg=0.3)), 6),
    "resized by 0.998, 4 days": (row(4, partial(rescaled, scale=0.998)), 6),
    "resized by 0.9995, 4 days": (row(4, partial(rescaled, scale=0.9995)), 6),
    "cropped by 1 px, 4 days": (row(4, partial(rescaled, crop_px=1.0)), 6),
    "a morning beside a field": (row(1, morning), 6),
    "decentering 5 px, 1 day": (decentred, 6),
    "20 sightings of 4 days": (row(4, few), 12),
    "kink, 1 day": (row(1, kinked), 6),
    "kink, 4 days": (row(4, kinked), 6),
    "dome, 1 day": (row(1, domed), 6),
    "dome, 4 days": (row(4, domed), 6),
    "rolling shutter, 1 day": (row(1, rolling), 6),
    "two lenses, 1 day": (row(1, mixed), 6),
    "whole pixels, 1 day": (row(1, in_steps), 6),
    "pixels cut, 4 days": (row(4, cut), 6),
    "whole minutes, 4 days": (row(4, in_minutes), 6),
    "ghost in half the day": (row(1, ghost), 6),
    "season 3e-4, 26 weeks": (seasonal(26, 3e-4), 6),
    "season 3e-4, 52 weeks": (seasonal(52, 3e-4), 6),
    "season 2e-3, 104 weeks": (seasonal(104, 2e-3, step_weeks=2), 6),
    "no season, 52 weeks": (seasonal(52, 0.0), 6),
    "200 easy days": (row(1, sigma_px=0.3), 200),
}
"""What draws a world, and of how many lenses by default."""


class Outcome(NamedTuple):
    """One lens: mean squares of the true and stated errors, px²; shares within 50 and 95 %; the held-out check.

    drawn: the ratios with draws of the fit's ensemble as the truth.
    """

    accepted: bool
    codes: tuple[str, ...]
    true: float
    stated: float
    within_50: float
    within_95: float
    held_out: dict[str, float]
    drawn: list[float]

    @property
    def ratio(self) -> float:
        """Return true over stated error."""
        return math.sqrt(self.true / self.stated)


def drawn_ratios(fit: Calibration, sky: FloatArray, *, draws: int, seed: int) -> list[float]:
    """Return the ratios of true over stated error that draws of a fit's own ensemble have as the truth."""
    pixels, covariance = project_with_covariance(fit, sky)
    stated = np.nanmean(np.trace(covariance, axis1=1, axis2=2))
    ensemble = draw_ensemble(fit, draws=draws, seed=seed, calibration_id="study")
    off = (ensemble.project(draw, sky) - pixels for draw in ensemble)
    return [math.sqrt(np.nanmean(np.sum(one**2, axis=-1)) / stated) for one in off]


def outcome(name: str, seed: int, *, draws: int = 0) -> Outcome:
    """Return what a lens of a row comes to."""
    rng = np.random.default_rng((36, sum(name.encode()), seed))
    made = ROWS[name][0](rng)
    place = made.place
    fit = calibrate_moved(
        Sightings.of(unix_s=made.unix_s, pixels=made.pixels),
        site=Site(latitude=place.latitude, longitude=place.longitude, altitude=place.altitude),
        image_size=(world.SIZE, world.SIZE),
        options=CalibrationOptions(projection="equisolid"),
    ).calibration
    sky = world.hemisphere(_DIRECTIONS)
    true = made.lens.project(sky)
    inside = np.all((true > 0.0) & (true < world.SIZE - 1.0), axis=-1)
    predicted, covariance = project_with_covariance(fit, sky[inside])
    off = predicted - true[inside]
    known = np.all(np.isfinite(predicted), axis=-1)
    off, covariance = off[known], covariance[known]
    square = np.sum(off * np.linalg.solve(covariance, off[..., None])[..., 0], axis=-1)
    return Outcome(
        accepted=fit.verdict.accepted,
        codes=() if fit.verdict.accepted else tuple(finding.code for finding in fit.verdict.findings),
        true=float(np.mean(np.sum(off**2, axis=-1))),
        stated=float(np.mean(np.trace(covariance, axis1=1, axis2=2))),
        within_50=float(np.mean(square < _WITHIN_50)),
        within_95=float(np.mean(square < _WITHIN_95)),
        held_out=dict(fit.evidence.held_out),
        drawn=drawn_ratios(fit, sky[inside], draws=draws, seed=seed) if draws and fit.verdict.accepted else [],
    )


def line(name: str, found: list[Outcome]) -> str:
    """Return a row of the table."""
    taken, refused = [one for one in found if one.accepted], [one for one in found if not one.accepted]
    codes = Counter(code for one in refused for code in one.codes)
    cells = [name, f"{len(taken)} + {len(refused)}", " ".join(f"{code} {n}" for code, n in codes.most_common(3))]
    if taken:
        true, stated = (math.sqrt(float(np.mean([getattr(one, key) for one in taken]))) for key in ("true", "stated"))
        middle = float(np.median([math.sqrt(one.true) for one in taken]))
        stated_middle = float(np.median([math.sqrt(one.stated) for one in taken]))
        within = [[getattr(one, key) for one in taken] for key in ("within_50", "within_95")]
        cells += [f"{middle:.3f}, {true:.3f}", f"{stated_middle:.3f}, {stated:.3f}"]
        worst = np.max([one.drawn for one in taken], axis=0)
        chance = " (chance {:.2f}, {:.2f})".format(*np.quantile(worst, (0.5, 0.95))) if worst.size else ""
        cells += [f"{max(one.ratio for one in taken):.2f}{chance}"]
        cells += [f"{np.mean(share):.2f} ({min(share):.2f})" for share in within]
    else:
        cells += ["-"] * 5
    cells += [f"{max(one.ratio for one in refused):.2f}" if refused else "-"]
    cells += [f"{sum(one.ratio <= _RIGHT for one in refused)}"]
    return "| " + " | ".join(cells) + " |"


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rows", action="append", help="rows whose names begin so; all")
    parser.add_argument("--lenses", type=int, help="of every row; by default its own number")
    parser.add_argument("--first", type=int, default=0, help="the first seed")
    parser.add_argument("--processes", type=int, default=1)
    parser.add_argument("--chance", type=int, default=0, metavar="DRAWS", help="of each fit's ensemble as the truth")
    parser.add_argument("--list", action="store_true", help="print a line a lens, too")
    chosen = parser.parse_args()
    names = [name for name in ROWS if chosen.rows is None or name.startswith(tuple(chosen.rows))]
    jobs = [(n, seed) for n in names for seed in range(chosen.first, chosen.first + (chosen.lenses or ROWS[n][1]))]
    print(
        "| row | taken + refused | codes | true: median, RMS | stated | ratio | 50 % | 95 % | refused: ratio | right |"
    )
    print(f"|{'---|' * 10}", flush=True)
    with multiprocessing.get_context("spawn").Pool(chosen.processes, maxtasksperchild=100) as pool:
        results = pool.imap(partial(_outcome, draws=chosen.chance), jobs)
        for name, mine in itertools.groupby(zip(jobs, results, strict=True), key=lambda item: item[0][0]):
            found = []
            for (_, seed), one in mine:
                found.append(one)
                if chosen.list:
                    print(f"{name} {seed}: ratio {one.ratio:.2f}", one._replace(drawn=[]), flush=True)
            print(line(name, found), flush=True)


def _outcome(job: tuple[str, int], *, draws: int) -> Outcome:
    return outcome(*job, draws=draws)


if __name__ == "__main__":
    main()
