"""Obstruction masks and horizons of a rendered sky, against what was rendered.

    python docs/studies/obstructions.py [--worlds N] [--first SEED] [--pictures FOLDER]

prints, for each world, the intersection over union (IoU) with the truth after a clear day and after five days of mixed
sky, the horizon's errors, the days until a crane is in the mask and until it is out again, false obstructions after a
week of clouds, and what a week of fog makes.
"""

from __future__ import annotations

import argparse
import math
import time as clock
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray
from obstruction_world import Weather, World

from sunarc.imaging.horizon import horizon_profile
from sunarc.imaging.obstructions import (
    HIDDEN,
    SOILED,
    UNKNOWN,
    ObstructionMask,
    cell_grid,
    no_sums,
    obstruction_mask,
    updated_sums,
)
from sunarc.optics.camera import Camera
from sunarc.optics.forward import project
from sunarc.optics.pose import rotation_vector

MIXED: tuple[Sequence[Weather], ...] = (
    ("clear",),
    ("scattered", "clear", "broken"),
    ("overcast", "broken", "scattered"),
    ("haze", "clear"),
    ("broken", "overcast"),
)


def camera_of(world: World, moved: NDArray[np.float64] | None = None) -> Camera:
    """Return the world's camera in sunarc's terms; `moved`: turned as by `World.bumped`."""
    centre, angle = (world.n - 1) / 2.0, math.radians(world.rotation_deg)
    sine, cosine = math.sin(angle), math.cos(angle)
    turn = np.array([[-cosine, -sine, 0.0], [sine, -cosine, 0.0], [0.0, 0.0, 1.0]])
    camera = Camera(
        width=world.n,
        height=world.n,
        projection="equidistant",
        focal_length_px=(world.focal_px, world.focal_px),
        principal_point_px=(centre, centre),
        rotation_cam_enu=rotation_vector(turn),
        max_angle=math.radians(92.0),
    )
    at = project(camera, world.directions[[world.n // 4], [world.n // 3]])
    if not np.allclose(at, [[world.n // 3, world.n // 4]], atol=1e-6):
        raise SystemExit(f"the axes differ: {at}")
    return camera if moved is None else replace(camera, rotation_cam_enu=rotation_vector(turn @ moved.T))


class Learner:
    """The sums of a world's camera."""

    def __init__(self, world: World) -> None:
        self.world, self.camera = world, camera_of(world)
        self.grid = cell_grid(self.camera)
        self.sums = no_sums(self.grid)
        self.seconds: list[float] = []

    def day(self, day: int, weather: Sequence[Weather], *, crane: bool = False, every_min: float = 10.0) -> None:
        """Show a day's images."""
        times = self.world.times(day, every_min=every_min)
        for k, time in enumerate(times):
            image = self.world.frame(time, weather[k * len(weather) // len(times)], crane=crane)
            begun = clock.process_time()
            self.sums = updated_sums(self.sums, image, self.grid, sun=self.world.sun(time), unix_s=time.timestamp())
            self.seconds.append(clock.process_time() - begun)

    def mask(self) -> ObstructionMask:
        """Return the mask by the images shown so far."""
        return obstruction_mask(self.sums, self.grid)

    def iou(self, *, crane: bool = False) -> float:
        """Return the intersection over union with the truth above the horizon, pixel by pixel."""
        sky = self.world.elevation > 0.0
        found, truth = self.mask().hidden()[sky], self.world.truth(crane=crane)[sky]
        return float(np.sum(found & truth) / np.sum(found | truth))

    def false_share(self, *, crane: bool = False) -> float:
        """Return the share of the free sky that is called hidden, away from edges by 1 degree (blurred by the lens)."""
        near = cv2.dilate(self.world.truth(crane=crane).astype(np.uint8), np.ones((5, 5), np.uint8)) > 0
        sky = (self.world.elevation > 0.0) & ~near
        return float(np.mean(self.mask().hidden()[sky]))

    def crane_share(self) -> float:
        """Return the share of the crane that is in the mask."""
        alone = self.world.crane & ~self.world.truth(crane=False) & (self.world.elevation > 0.0)
        return float(np.mean(self.mask().hidden()[alone]))

    def draw(self, path: Path, *, crane: bool = False) -> None:
        """Write the mask over an image: hidden red, soiled blue, unknown yellow; truth's border green."""
        noon = self.world.times(0)[len(self.world.times(0)) // 2]
        image = self.world.frame(noon, "clear", crane=crane)
        grey = image if image.ndim == 2 else image[..., 0]
        scaled = np.clip(grey / np.quantile(grey, 0.9) * 200.0, 0, 255).astype(np.uint8)
        picture = np.repeat(scaled[..., None], 3, axis=-1)
        state = self.mask().image()
        for value, colour in ((HIDDEN, (0, 0, 255)), (SOILED, (255, 0, 0)), (UNKNOWN, (0, 255, 255))):
            picture[state == value] = picture[state == value] // 2 + np.array(colour, np.uint8) // 2
        border = cv2.morphologyEx(
            self.world.truth(crane=crane).astype(np.uint8), cv2.MORPH_GRADIENT, np.ones((3, 3), np.uint8)
        )
        picture[border > 0] = (0, 255, 0)
        cv2.imwrite(str(path), picture)


def horizon_errors(learner: Learner, *, crane: bool = False) -> tuple[float, float]:
    """Return the share of azimuths with a sharp edge that are within 0.5 degrees, and of all within 2 sigma."""
    found = horizon_profile(learner.mask())
    around = np.stack([learner.world.horizon_deg(crane=crane, azimuth_deg=np.arange(360.0) + k) for k in OFFSETS])
    truth, sharp = np.median(around, axis=0), np.ptp(around, axis=0) < SHARP_DEG
    error = np.abs(found.elevation_deg - truth)
    return float(np.mean(error[sharp] < 0.5)), float(np.mean(error < 2.0 * found.sigma_deg))


OFFSETS = np.linspace(-0.5, 0.5, 11)
SHARP_DEG = 0.5
"""Range of the true horizon within a degree of azimuth, below which its edge is sharp."""


def study(world: World, pictures: Path | None) -> str:
    """Return one line of results of a world."""
    name = f"{world.n}-{world.seed}{'' if world.linear else '-jpeg'}"
    learner = Learner(world)
    learner.day(0, MIXED[0])
    one_day, edge = learner.iou(), horizon_errors(learner)
    if pictures is not None:
        learner.draw(pictures / f"day1-{name}.png")
    for day in range(1, 5):
        learner.day(day, MIXED[day])
    five_days, five_edge, false = learner.iou(), horizon_errors(learner), learner.false_share()
    came = _days_until(learner, 5, crane=True, pictures=pictures)
    gone = _days_until(learner, 12, crane=False, pictures=None)
    return (
        f"{name:14} IoU {one_day:.3f} {five_days:.3f}  within 0.5° {edge[0]:.2f} {five_edge[0]:.2f}  within 2σ "
        f"{edge[1]:.2f} {five_edge[1]:.2f}  false {100 * false:.3f} %  crane after {came} gone after {gone} d  "
        f"{1000 * float(np.median(learner.seconds)):.1f} ms  {dict(learner.sums.counts)}"
    )


def _days_until(learner: Learner, first: int, *, crane: bool, pictures: Path | None) -> int | None:
    """Return after how many days of mixed sky the crane is in the mask (half of it), or out of it (all but a tenth)."""
    for day in range(7):
        learner.day(first + day, MIXED[(day + 1) % len(MIXED)], crane=crane)
        share = learner.crane_share()
        if share > 0.5 if crane else share < 0.1:
            if pictures is not None:
                learner.draw(pictures / f"crane-{learner.world.n}-{learner.world.seed}.png", crane=crane)
            return day + 1
    return None


def week(world: World, weather: Weather) -> str:
    """Return the mask of a week of one weather, and its hidden part once a clear day follows."""
    learner = Learner(world)
    for day in range(7):
        learner.day(day, [weather], every_min=20.0)
    ready, alone = learner.sums.is_ready, learner.false_share()
    learner.day(7, ["clear"])
    after = (learner.iou(), 100.0 * learner.false_share())
    then = f"after a clear day IoU {after[0]:.3f} false {after[1]:.3f} %"
    return f"{weather:10} ready {ready}  false {100 * alone:.3f} %; {then}"


def main() -> None:
    """Print the study."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--worlds", type=int, default=4)
    parser.add_argument("--first", type=int, default=0, help="Seed of the first world.")
    parser.add_argument("--size", type=int, default=640)
    parser.add_argument("--pictures", type=Path)
    asked = parser.parse_args()
    for seed in range(asked.first, asked.first + asked.worlds):
        jpeg = seed % 2 == 1
        print(study(World(n=asked.size, seed=seed, linear=not jpeg, text=jpeg), asked.pictures), flush=True)
    for weather in ("fog", "overcast", "bank", "thin", "broken"):
        print(week(World(n=asked.size, seed=asked.first + 100, linear=False, text=True), weather), flush=True)


if __name__ == "__main__":
    main()
