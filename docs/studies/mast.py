"""Two years of a mast whose lens follows the season: refits on clear days, and the served camera on every day.

    OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 python docs/studies/mast.py [--masts 2] [--first 0] [--every 6]
        [--cadence 2400] [--share 3e-4 2e-3]

The sun, lens and weather are those of `independent_world` and of this file: no code is shared with the fit. The focal
length follows the year by a share of itself either way; a third of the days from spring to autumn is clear, a sixth
half clear, and no day of winter is. Every few clear days the sightings so far are selected, fitted and judged against
the calibration in use, as the service does. On every fifth day that calibration, by the uncertainty that it has by
then, is compared with the camera of that day, over the upper hemisphere inside the image: it is right where the root
mean square of its error is within its stated 95 %. Printed for each mast: refits by their result, the share of right
days of all and of those within a fortnight of the last refit, and the worst true over stated.
"""

from __future__ import annotations

import argparse
import math
from collections import Counter
from dataclasses import dataclass, field, replace

import independent_world as world
import numpy as np
from independent_world import FloatArray, Lens

from sunarc.calibration.acceptance import unseen_points
from sunarc.calibration.answers.ageing import age_step_days, aged
from sunarc.calibration.answers.covariance import project_with_covariance
from sunarc.calibration.calibrate import calibrate
from sunarc.calibration.model.options import CalibrationOptions
from sunarc.calibration.model.result import Calibration
from sunarc.calibration.model.sightings import Sightings
from sunarc.calibration.projection_choice import options_as_served
from sunarc.calibration.selection import select_sightings
from sunarc.calibration.verdict import accept
from sunarc.sky.site import Site

_DAYS, _SIGMA_PX, _YEAR = 730, 0.1, 365.25
_RIGHT = math.sqrt(-math.log(0.05))
"""Of two axes together 95 % lie within this many root mean squares."""
_SKY = world.hemisphere(400)


@dataclass(frozen=True, eq=False)
class Mast:
    """A mast: its place, lens, sightings by day, which days are clear, their noons and the focal length's changes."""

    place: world.Place
    lens: Lens
    times: list[FloatArray]
    pixels: list[FloatArray]
    clear: list[bool]
    noon: FloatArray
    grown: FloatArray

    def camera(self, day: int) -> Lens:
        """Return the lens of a day."""
        grown, center = float(self.grown[day]), self.lens.center_px
        return replace(self.lens, smear=lambda pixels: grown * (pixels - center))


def drawn_mast(rng: np.random.Generator, share: float, cadence_s: float) -> Mast:
    """Draw two years from the first of April on."""
    place, lens = world.drawn_place(rng), world.drawn_lens(rng)
    day = np.arange(_DAYS, dtype=np.float64)
    noon = 1_711_929_600.0 + 43_200.0 - 240.0 * place.longitude + 86_400.0 * day
    summer = np.cos(2.0 * math.pi * (day - 100.0) / _YEAR) * math.copysign(1.0, place.latitude)
    winter = summer < -0.5
    kind = rng.choice(["clear", "half", "cloud"], _DAYS, p=[0.33, 0.17, 0.5])
    kind[winter] = "cloud"
    lag = np.cos(2.0 * math.pi * (day - 100.0 - rng.uniform(10.0, 40.0)) / _YEAR) * math.copysign(1.0, place.latitude)
    mast = Mast(place, lens, [], [], [bool(one == "clear") for one in kind], noon, share * lag)
    for number, (at, weather) in enumerate(zip(noon.tolist(), kind.tolist(), strict=True)):
        times = at + np.arange(-30_000.0, 30_000.0, cadence_s)
        if weather == "half":
            times = times[rng.random(times.size) < 0.4]
        if weather == "cloud":
            times = times[:0]
        directions = world.sun(times, place) if times.size else np.zeros((0, 3))
        pixels = mast.camera(number).project(directions) + rng.normal(0.0, _SIGMA_PX, (times.size, 2))
        seen = (directions[:, 2] > math.sin(math.radians(2.0))) & np.all(
            (pixels > 1.0) & (pixels < world.SIZE - 2.0), axis=-1
        )
        mast.times.append(times[seen])
        mast.pixels.append(pixels[seen])
    return mast


@dataclass(eq=False)
class Service:
    """Service of a mast: the calibration in use, the outcomes of its refits, and the days' ratios."""

    site: Site
    served: Calibration | None = None
    refits: Counter[str] = field(default_factory=Counter)
    ratios: list[float] = field(default_factory=list)
    fresh: list[bool] = field(default_factory=list)
    shares: list[float] = field(default_factory=list)

    def refit(self, points: Sightings) -> None:
        """Fit the sightings so far, and serve the fit where it is accepted."""
        some = points.select(select_sightings(points, site=self.site).index)
        options = options_as_served(CalibrationOptions(projection="equisolid", mirrored="no"), self.served)
        solved = calibrate(
            some,
            site=self.site,
            image_size=(world.SIZE, world.SIZE),
            options=options,
            tilt_known=self.served is not None,
        )
        verdict = accept(solved, self.served, unseen=None if self.served is None else unseen_points(some, self.served))
        state = "accepted" if verdict.accepted else "kept" if verdict.marginal else "refused"
        self.refits[state if verdict.accepted else f"{state} {verdict.findings[0].code}"] += 1
        if verdict.accepted:
            self.served = replace(solved, verdict=verdict)

    def compare(self, lens: Lens, unix_s: float, *, is_fresh: bool) -> None:
        """Compare the calibration in use with the camera of a time, soon after the last refit or not."""
        if self.served is None:
            return
        true = lens.project(_SKY)
        inside = np.all((true > 0.0) & (true < world.SIZE - 1.0), axis=-1)
        now = aged(self.served, age_step_days(self.served, unix_s))
        predicted, covariance = project_with_covariance(now, _SKY[inside])
        off = predicted - true[inside]
        known = np.all(np.isfinite(predicted), axis=-1)
        off, covariance = off[known], covariance[known]
        square = np.sum(off * np.linalg.solve(covariance, off[..., None])[..., 0], axis=-1)
        stated = float(np.mean(np.trace(covariance, axis1=1, axis2=2)))
        self.fresh.append(is_fresh)
        self.ratios.append(math.sqrt(float(np.mean(np.sum(off**2, axis=-1))) / stated))
        self.shares.append(float(np.mean(square < -2.0 * math.log(0.05))))


def lived(mast: Mast, every: int) -> Service:
    """Return the outcomes of the service."""
    place = mast.place
    service = Service(Site(latitude=place.latitude, longitude=place.longitude, altitude=place.altitude))
    n_clear, last = 0, 0
    for day, is_clear in enumerate(mast.clear):
        if is_clear and n_clear % every == 0:
            points = Sightings.of(
                unix_s=np.concatenate(mast.times[: day + 1]), pixels=np.concatenate(mast.pixels[: day + 1])
            )
            service.refit(points)
            last = day
        n_clear += is_clear
        if day % 5 == 0:
            service.compare(mast.camera(day), float(mast.noon[day]), is_fresh=day - last <= 14)
    return service


def main() -> None:
    """Print a line for each mast."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--masts", type=int, default=2)
    parser.add_argument("--first", type=int, default=0, help="the first seed")
    parser.add_argument("--every", type=int, default=6, help="clear days from one refit to the next")
    parser.add_argument("--cadence", type=float, default=2400.0, help="seconds between sightings")
    parser.add_argument("--share", type=float, nargs="+", default=[3e-4, 2e-3], help="of the focal length")
    chosen = parser.parse_args()
    for seed in range(chosen.first, chosen.first + chosen.masts):
        for share in chosen.share:
            mast = drawn_mast(np.random.default_rng((1957, seed)), share, chosen.cadence)
            found = lived(mast, chosen.every)
            ratios = np.array(found.ratios)
            right, fresh = ratios <= _RIGHT, np.array(found.fresh)
            print(
                f"season {share:g}, mast {seed}: refits {dict(found.refits)}; days right {np.mean(right):.3f} of "
                f"{right.size}, {np.mean(right[fresh]):.3f} of {fresh.sum()} fresh; within 95 % of the sky "
                f"{np.mean(found.shares):.3f}; true over stated: {np.median(ratios):.2f}, worst {ratios.max():.2f}",
                flush=True,
            )


if __name__ == "__main__":
    main()
