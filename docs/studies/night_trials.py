"""Hundreds of bad nights: what is named, what of it is false, and which fits are worse for it.

    OMP_NUM_THREADS=1 python docs/studies/night_trials.py --nights 300
    OMP_NUM_THREADS=1 python docs/studies/night_trials.py --nights 300 --rendered

Every ten nights have a lens of their own, calibrated by one clear day of the sun (0.03 px). There are broken clouds,
haze, a moon, a town, or all of it; in all nights satellites, hot pixels, and lamps at the horizon that blink. The
detections are made (`nights`), or found by the worker of the night in images rendered at 640 to 1024 px, with
veils, aircraft, warm pixels and a moving glow. The stars of a night that the worker would request a refit for go into a
fit with the day's sun, and the service's own acceptance decides on it. A sighting is false where it is not the star's
(its true pixel is more than 1 px off). Every third night is looked at once more with a wrong calibration.
"""

from __future__ import annotations

import argparse
import math
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime, timedelta
from typing import Any, NamedTuple

import night as clear_nights
import nights
import numpy as np
import population as pop
from night_images import DARK, FULL_MOON, SimulatedImager, errors, frames_of
from night_matching import WRONG, wrong_camera
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from sunarc.calibration.model.result import Calibration
from sunarc.calibration.model.sightings import Kind, Sightings
from sunarc.calibration.selection import MOST_STARS, image_parts, pick_surest_in_parts
from sunarc.calibration.verdict import accept
from sunarc.common.array_types import stacked
from sunarc.detection.values import Stars
from sunarc.imager.cameras.frame import Frame
from sunarc.imager.workers.night.night import decide_night, summarize_night
from sunarc.lab.simulation.options import SceneOptions, SensorModel, SimulatedNight
from sunarc.lab.simulation.scene import Scene
from sunarc.lab.simulation.truth import SGP, true_camera
from sunarc.optics.camera import Camera
from sunarc.stars.views import StarView, match_views

SIZES = (640, 874, 1024)
KINDS = ("broken clouds", "haze", "moon", "town", "all of it")
NIGHTS_A_LENS = 10
ELECTRONS_A_COUNT = 20_000.0 / 4095.0
ENOUGH_STARS, BENT_PX, MOST_A_FRAME = 50, 1.0, 30
"""As the worker of the night has them."""
IMAGE = (pop.SIZE, pop.SIZE)


def scaled(camera: Camera, size: int) -> Camera:
    """Return a square camera with fewer pixels across."""
    share = size / camera.width
    (fx, fy), (x, y) = camera.focal_length_px, camera.principal_point_px
    middle = ((x + 0.5) * share - 0.5, (y + 0.5) * share - 0.5)
    return replace(
        camera, width=size, height=size, focal_length_px=(fx * share, fy * share), skew_px=camera.skew_px * share,
        principal_point_px=middle,
    )  # fmt: skip


class Sky(NamedTuple):
    """A night: when it begins, the scene, lamps at the horizon, and the counts of a glow that moves."""

    begin: datetime
    scene: Scene
    lamps: NDArray[np.float64]
    glow: float


def sky_of(kind: str, lens: Camera, seed: int) -> Sky:
    """Return a night of a kind."""
    rng = np.random.default_rng([seed, 41])
    every = kind == "all of it"
    night: dict[str, Any] = {"satellites": 2.0, "aircraft": 1.0, "warm_spots": int(rng.integers(20, 200))}
    night |= {"star_e_per_s": 50_000.0, "extinction": rng.uniform(0.15, 0.35)}
    begin = DARK + timedelta(days=int(rng.integers(0, 45)), minutes=float(rng.uniform(0.0, 30.0)))
    weather = "clear"
    if kind == "broken clouds" or (every and rng.uniform() < 0.5):
        weather = "broken"
    elif kind == "haze" or every:
        weather, night["extinction"] = "veil", rng.uniform(0.3, 0.9)
    if kind == "moon" or every:
        begin = FULL_MOON + timedelta(days=float(rng.uniform(-4.0, 4.0)) // 1.0 + 29.0 * int(rng.integers(0, 2)))
    if kind == "town" or every:
        night |= {"city": rng.uniform(15.0, 17.5), "airglow": rng.uniform(18.5, 20.5), "city_azimuth_deg": 17.0 * seed}
    options: dict[str, Any] = {"seed": seed, "weather": (weather,), "night": SimulatedNight(**night)}
    sensor = SensorModel(hot_pixels=int(rng.integers(20, 300)))
    scene = Scene(lens, SGP, options=SceneOptions(**options), sensor=sensor)
    count = int(rng.integers(3, 12)) if kind == "town" or every else int(rng.integers(0, 4))
    angle, far = rng.uniform(0.0, 2.0 * np.pi, count), rng.uniform(1.15, 1.4, count) * lens.focal_length_px[0]
    place = np.array(lens.principal_point_px) + far[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    lamps = np.column_stack([place, 10.0 ** rng.uniform(1.5, 4.5, count), rng.uniform(0.7, 2.0, count)])
    return Sky(begin, scene, lamps, rng.uniform(20.0, 200.0) if every else 0.0)


def images_of(sky: Sky, count: int, seed: int) -> Iterator[Frame]:
    """Yield the images of a night, with its lamps, each on or off, and its glow."""
    rng = np.random.default_rng([seed, 43])
    for frame in frames_of(sky.scene, sky.begin, count):
        light = np.zeros(frame.image.shape)
        rows, columns = np.indices(frame.image.shape)
        for x, y, counts, width in sky.lamps[rng.uniform(size=len(sky.lamps)) < 0.6]:
            light += counts * np.exp(-0.5 * ((columns - x) ** 2 + (rows - y) ** 2) / width**2)
        if sky.glow:
            arcs = gaussian_filter(rng.standard_normal(light.shape), 0.03 * len(light), mode="wrap")
            light += sky.glow * np.maximum(arcs / arcs.std(), 0.0)
        light += np.sqrt(light / ELECTRONS_A_COUNT) * rng.standard_normal(light.shape)
        image = np.clip(np.rint(frame.image + light), 0, frame.full_scale).astype(np.uint16)
        yield replace(frame, image=image)


@dataclass
class Tally:
    """What the nights of one kind came to."""

    verdicts: Counter[str] = field(default_factory=Counter)
    images: int = 0
    named: int = 0
    stored: int = 0
    false: int = 0
    fits: int = 0
    left_out: int = 0
    refused: int = 0
    outside: list[float] = field(default_factory=list)
    error_px: list[tuple[float, float]] = field(default_factory=list)

    def add_night(self, details: dict[str, Any], false: int) -> None:
        """Count a night."""
        self.verdicts[details["verdict"]] += 1
        self.images += details["n_images"]
        self.named += details.get("n_accepted", 0)
        self.stored += details.get("n_stored", 0)
        self.false += false

    def add_fit(self, day: Calibration, both: Calibration, lens: Camera) -> str:
        """Count a fit, and its errors where it would be served; return what it was."""
        self.fits += 1
        self.left_out += any(one.code == "night_contradicts_day" for one in both.verdict.findings)
        decision = accept(both, day)
        if not decision.accepted:
            self.refused += 1
            return f"refused: {[one.code for one in decision.findings]}"
        first, second = errors(day, lens), errors(both, lens)
        self.error_px.append((_whole(first), _whole(second)))
        self.outside.append(1.0 - 0.5 * (second[2] + second[3]))
        return f"{self.error_px[-1][0]:.4f} to {self.error_px[-1][1]:.4f} px"

    def row(self) -> str:
        """Return the row of a table."""
        verdicts = ", ".join(f"{count} {verdict}" for verdict, count in self.verdicts.most_common())
        nights = f"{verdicts} | {self.named} of {self.images} | {self.false} of {self.stored}"
        fits = f"{self.fits} | {self.left_out}, {self.refused}"
        if not self.error_px:
            return f"{nights} | {fits} | | |"
        day, both = np.array(self.error_px).T
        worse = both / day
        middle = f"{np.median(day):.3f} to {np.median(both):.3f}, {day.max():.2f} to {both.max():.3f}"
        counts = f"{np.sum(worse > 1.1)}, {np.sum(worse > 2.0)} ({worse.max():.1f})"
        return f"{nights} | {fits} | {middle} | {counts} | {1.0 - np.mean(self.outside):.3f} |"


def _whole(found: list[float]) -> float:
    return math.sqrt(0.5 * (found[0] ** 2 + found[1] ** 2))


def wrong_start(name: str, day: Calibration, rng: np.random.Generator) -> tuple[Calibration, float]:
    """Return a calibration that is wrong as a name says, of the day's uncertainty, and how late frames are dated."""
    if name == "another camera":
        camera, late = scaled(pop.random_camera(rng), day.camera.width), 0.0
    else:
        camera, late = wrong_camera(name, day.camera, rng)
    return replace(day, camera=camera, poses=(camera.rotation_cam_enu,)), late


View = tuple[float, Stars, list[str]]
"""Moment, detections and their names ("" for what is no star) of an image."""


class Made:
    """Nights of made detections of one lens."""

    def __init__(self, seed: int) -> None:
        rng = np.random.default_rng([seed, 61])
        self.lens = pop.random_camera(rng)
        times = pop.sun_track(np.zeros(1), cadence_s=120.0)
        air = clear_nights.Air(rng, drawn=False)
        self.sun = clear_nights.detected(self.lens, times, pop.white_noise(rng, times.size, 0.03), field=None, air=air)
        self.day = clear_nights.fitted(self.sun)

    def night(self, kind: str, seed: int, count: int) -> list[View]:
        """Return moments, detections and their names of a night."""
        rng = np.random.default_rng([seed, 67])
        every = kind == "all of it"
        cloud = rng.uniform(0.2, 0.7) if kind == "broken clouds" or every else 0.0
        lost = {"broken clouds": 0.05, "haze": 0.3, "moon": 0.35, "town": 0.4, "all of it": 0.35}[kind]
        lost += rng.uniform(-0.05, 0.2)
        night = nights.Night(
            sigma_px=0.2 if kind in {"haze", "all of it"} else 0.1, cloud_share=cloud, lost=lost,
            satellites=int(rng.poisson(2.0)), hot_pixels=int(rng.integers(20, 300)), hot_seed=seed,
            faint=int(rng.integers(50, 400)),
        )  # fmt: skip
        begin = nights.MIDNIGHT + 3600.0 * rng.uniform(-3.0, -2.0) + 86_400.0 * int(rng.integers(0, 45))
        lamps = self._lamps(rng)
        found = []
        for number in range(count):
            when = begin + number * 6.0 * 3600.0 / count
            stars, names = nights.detections(rng, self.lens, nights.sky_of(when), night)
            lit = lamps.select(rng.uniform(size=len(lamps)) < 0.6)
            both = stacked([stars, lit])
            order = np.argsort(-both.flux, kind="stable")
            names = names + [""] * len(lit)
            found.append((when, both.select(order), [names[row] for row in order]))
        return found

    def _lamps(self, rng: np.random.Generator) -> Stars:
        count = int(rng.integers(3, 20))
        angle, far = rng.uniform(0.0, 2.0 * np.pi, count), rng.uniform(1.15, 1.4, count)
        place = np.stack([np.cos(angle), np.sin(angle)], axis=-1) * (far * self.lens.focal_length_px[0])[:, None]
        one, flux = np.ones(count), 10.0 ** (-0.4 * rng.uniform(0.0, 5.0, count))
        return Stars(
            pixels=place + self.lens.principal_point_px, sigma_px=0.1 * one, flux=flux, snr=1500.0 * flux,
            peak_fraction=0.5 * one, width_px=1.2 * one, ellipticity=0.1 * one, saturated=one < 0.0,
        )  # fmt: skip

    def looked_at(self, found: list[View], served: Calibration, tally: Tally, *, late_s: float = 0.0) -> str:
        """Count a night and its fit, as the worker of the night makes them; return what it was."""
        views = [
            StarView(
                unix_s=when + late_s, sky=nights.sky_of(when + late_s), stars=stars,
                predicted=nights.predicted(served, when + late_s, within_px=BENT_PX), camera=served.camera,
            )
            for when, stars, _ in found
        ]  # fmt: skip
        matched = match_views(views)
        verdict, _ = decide_night(summarize_night(views, matched), moonlit_share=0.0)
        columns: dict[str, list[Any]] = {"unix_s": [], "pixels": [], "sigma_px": [], "directions": []}
        false = 0
        for (_, stars, names), view, one in zip(found, views, matched, strict=True):
            if not one.matches.accepted:
                continue
            every = one.stars.select(one.matches.detection)
            chosen = pick_surest_in_parts(image_parts(every.pixels, IMAGE), every.sigma_px, MOST_A_FRAME)
            true = {tuple(pixel): name for pixel, name in zip(stars.pixels.tolist(), names, strict=True)}
            named = np.array(one.names(view))[chosen]
            pixels = every.pixels[chosen]
            false += sum(true[tuple(p)] != name for p, name in zip(pixels.tolist(), named.tolist(), strict=True))
            columns["unix_s"].append(np.full(chosen.size, view.unix_s))
            columns["pixels"].append(pixels)
            columns["sigma_px"].append(every.sigma_px[chosen])
            columns["directions"].append(one.directions(view)[chosen])
        stored = sum(part.size for part in columns["sigma_px"])
        accepted = len(columns["sigma_px"])
        details = {"verdict": verdict, "n_images": len(views), "n_accepted": accepted, "n_stored": stored}
        tally.add_night(details, false)
        said = f"{verdict}, {false} false of {stored}"
        if verdict not in {"clear", "partly"} or stored < ENOUGH_STARS:
            return said
        joined = {name: np.concatenate(parts) for name, parts in columns.items()}
        stars_found = Sightings.of(**joined, kind=np.full(stored, Kind.STAR))
        parts_of = image_parts(stars_found.pixels, IMAGE)
        stars_found = stars_found.select(pick_surest_in_parts(parts_of, stars_found.sigma_px, MOST_STARS))
        both = clear_nights.fitted(clear_nights.together(self.sun, stars_found))
        return f"{said}, {tally.add_fit(self.day, both, self.lens)}"


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(prog="night_trials.py", description=__doc__)
    parser.add_argument("--nights", type=int, default=300)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--images", type=int, default=5, help="of a night")
    parser.add_argument("--rendered", action="store_true", help="render the images")
    parser.add_argument("--each", action="store_true", help="print every night")
    asked = parser.parse_args()
    right: dict[str, Tally] = {kind: Tally() for kind in KINDS}
    wrong: dict[str, Tally] = {name: Tally() for name in WRONG}
    one = rendered_nights(asked, right, wrong) if asked.rendered else made_nights(asked, right, wrong)
    for said in one:
        if asked.each:
            print(said, flush=True)
    print("| night | verdicts | images named | false of stored | fits | night left out, refused ", end="")
    print("| error of those served, day to both: median, largest | worse by 1.1, by 2 (most) | within 95 % |")
    for title, tallies in (("right", right), ("wrong", wrong)):
        print(title)
        for name, tally in tallies.items():
            print(f"| {name} | {tally.row()}")


def made_nights(asked: argparse.Namespace, right: dict[str, Tally], wrong: dict[str, Tally]) -> Iterator[str]:
    """Count nights of made detections; yield what each was."""
    lens = None
    for seed in range(asked.first, asked.first + asked.nights):
        if lens is None or seed % NIGHTS_A_LENS == 0:
            lens = Made(seed // NIGHTS_A_LENS)
        kind = KINDS[seed % len(KINDS)]
        found = lens.night(kind, seed, asked.images)
        said = lens.looked_at(found, lens.day, right[kind])
        if seed % 3 == 0:
            name = WRONG[seed // 3 % len(WRONG)]
            served, late = wrong_start(name, lens.day, np.random.default_rng([seed, 47]))
            said += f"; {name}: " + lens.looked_at(found, served, wrong[name], late_s=late)
        yield f"{seed} {kind} {said}"


def rendered_nights(asked: argparse.Namespace, right: dict[str, Tally], wrong: dict[str, Tally]) -> Iterator[str]:
    """Count nights that are rendered; yield what each was."""
    day, number = None, -1
    for seed in range(asked.first, asked.first + asked.nights):
        if day is None or seed // NIGHTS_A_LENS != number:
            number = seed // NIGHTS_A_LENS
            lens, day = scaled(true_camera(1 + number), SIZES[number % len(SIZES)]), None
        kind = KINDS[seed % len(KINDS)]
        sky = sky_of(kind, lens, seed)
        images = list(images_of(sky, asked.images, seed))
        imager = SimulatedImager(lens, seed=number, day=day)
        day = imager.day
        said = one_night(imager, sky, images, right[kind])
        if seed % 3 == 0:
            name = WRONG[seed // 3 % len(WRONG)]
            served, late = wrong_start(name, day, np.random.default_rng([seed, 47]))
            other = SimulatedImager(lens, seed=number, day=day, served=served)
            said += f"; {name}: " + one_night(other, sky, images, wrong[name], late_s=late)
        yield f"{seed} {lens.width} px {kind} {said}"


def one_night(imager: SimulatedImager, sky: Sky, images: list[Frame], tally: Tally, *, late_s: float = 0.0) -> str:
    """Count a night and, where the worker would ask for one, its fit; return what it was."""
    details, false = imager.night(sky.begin, images, late_s=late_s)
    tally.add_night(details, false)
    stored = details.get("n_stored", 0)
    said = f"{details['verdict']}, {false} false of {stored}"
    if details["verdict"] in {"clear", "partly"} and stored >= ENOUGH_STARS:
        imager.now = sky.begin.astimezone(UTC) + timedelta(days=1)
        said += ", " + tally.add_fit(imager.day, imager.fitted(), imager.lens)
    imager.close()
    return said


if __name__ == "__main__":
    main()
