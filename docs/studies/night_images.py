"""Rendered nights through the service's own worker: what is named, what is false, and what a fit gains.

    OMP_NUM_THREADS=1 python docs/studies/night_images.py --lenses 6 [--nights "broken clouds"] [--fits]

Each lens of the simulator (a coma of 0.6 px, twinkling, a town, satellites, aircraft, warm pixels; 5 s, 12 bit) is
calibrated by one clear day of the sun (0.03 px); its nights of five kinds are rendered and given to the worker of the
night. A match is false where the star's true pixel is more than 1 px from the detection. With --fits the sightings of
the clear night go into a fit with the day's, and both are compared with the true camera.
"""

from __future__ import annotations

import argparse
import math
import tempfile
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import numpy as np
from coverage_statistics import CHI_SQUARE_95, squared_sigmas

from sunarc.archive import Archive, CameraArchive, CameraRecord, Refit, SunPoint, open_archive, upgrade
from sunarc.calibration import (
    Calibration,
    CalibrationOptions,
    calibrate,
    hemisphere,
    project_with_covariance,
    to_document,
)
from sunarc.cameras import Frame
from sunarc.optics import Camera, project
from sunarc.runtime.status import StatusRegistry
from sunarc.simulation import SGP, NightOptions, Scene, SceneOptions, true_camera
from sunarc.sky import body_directions, sun_angles, sun_directions
from sunarc.utc import utc_time
from sunarc.workers import DropOldestQueue, NightCapture, NightExposures, NightWorker, SensorOptions
from sunarc.workers.calibrating.refit_task import Task, next_task

DARK = datetime(2013, 5, 14, 3, 30, tzinfo=UTC)
FULL_MOON = datetime(2013, 5, 25, 4, 0, tzinfo=UTC)
NIGHTS: dict[str, tuple[datetime, str, dict[str, Any]]] = {
    "clear": (DARK, "clear", {}),
    "broken clouds": (DARK, "broken", {"satellites": 2.0, "aircraft": 1.0}),
    "veil": (DARK, "veil", {}),
    "full moon": (FULL_MOON, "clear", {}),
    "town": (DARK, "clear", {"city": 15.5, "airglow": 18.5}),
}
EXPOSURE_US, HOURS = 5e6, 6.5
SUN_PX = 0.03


class SimulatedImager:
    """One camera with its archive, its day and its worker of the night."""

    def __init__(self, seed: int) -> None:
        self.lens: Camera = true_camera(seed)
        folder = Path(tempfile.mkdtemp())
        upgrade(folder / "sunarc.sqlite")
        self.archive: Archive = open_archive(folder / "sunarc.sqlite")
        self.archive.save_camera(CameraRecord.at(SGP, name="roof", width=self.lens.width, height=self.lens.height))
        self.camera = CameraArchive(self.archive, name="roof", site=SGP)
        self.now = datetime(2013, 5, 26, 12, tzinfo=UTC)
        self._add_day(np.random.default_rng(seed + 100))
        self.day = self.fitted()
        document = to_document(
            self.day, id="day", camera="roof", state="candidate", created_at=DARK, valid_from=DARK - timedelta(days=1),
            valid_until=None, pose_epoch="roof-1", software_version="0",
        )  # fmt: skip
        self.archive.add_calibration(document)
        self.archive.activate("day")

    def _add_day(self, rng: np.random.Generator) -> None:
        times = datetime(2013, 5, 13, 6, tzinfo=UTC).timestamp() + np.arange(0.0, 86_400.0, 120.0)
        times = times[sun_angles(times, SGP).apparent_zenith < 88.0]
        pixels = project(self.lens, sun_directions(times, SGP)) + rng.normal(0.0, SUN_PX, (times.size, 2))
        self.archive.epoch_at("roof", utc_time(float(times[0])), reason="first frame")
        self.archive.add_sun_points(
            SunPoint(
                camera="roof", pose_epoch="roof-1", time=utc_time(time), method="disc", accepted=True, verdict="clear",
                x_px=x, y_px=y, sigma_px=SUN_PX,
            )
            for time, (x, y) in zip(times.tolist(), pixels.tolist(), strict=True)
        )  # fmt: skip

    def fitted(self) -> Calibration:
        """Return the fit of all that the archive has."""
        task = next_task(self.camera, cadence_s=120.0, options=CalibrationOptions(), circle=None, now=self.now)
        if not isinstance(task, Task):
            raise TypeError(f"nothing to solve: {task}")
        problem = task.problem
        return calibrate(problem.points, site=problem.site, image_size=problem.image_size, options=problem.options)

    def night(self, begin: datetime, scene: Scene, frames: int) -> tuple[dict[str, Any], int]:
        """Return the verdict of a night, and how many of its sightings are false."""
        worker = NightWorker(
            NightCapture(NightExposures(), DropOldestQueue(capacity=4)),
            camera=self.camera,
            options=SensorOptions(black_level_fraction=32.0 / 4095.0),
            apparent_zenith=lambda: 90.0,
            clock_error_s=lambda _: 0.01,
            trusted=lambda: True,
            now=lambda: begin + timedelta(hours=8),
            request_refit=lambda reason: Refit(id="r", camera="roof", requested_at=begin, reason=reason),
            board=StatusRegistry(version="0", started_at=begin, monotonic=lambda: 0.0),
        )
        times: list[float] = []
        for number in range(frames):
            start = begin + timedelta(hours=HOURS * number / frames)
            image = scene.render(int(start.timestamp() * 1e6), exposure_us=EXPOSURE_US)
            middle = start + timedelta(microseconds=0.5 * EXPOSURE_US)
            times.append(middle.timestamp())
            worker.look_at(
                Frame(
                    image=image, time=middle, exposure_us=EXPOSURE_US, gain_db=0.0, pixel_format="Mono12",
                    full_scale=4095, frame_id=number,
                )
            )  # fmt: skip
        worker.finish()
        (event,) = self.archive.events("roof", kind="night", limit=1)
        stars = self.archive.sun_point_columns("roof", body=None, since=begin)
        stars = stars.select((stars.body != "sun") & np.isin(stars.unix_s, times))
        true = project(self.lens, body_directions(stars.body, stars.unix_s, SGP))
        return dict(event.details), int(np.sum(np.linalg.norm(stars.pixels - true, axis=-1) > 1.0))


def errors(fit: Calibration, lens: Camera) -> list[float]:
    """Return the RMS error (px) north and south to 85 degrees, and the share within the stated 95 %."""
    sky = hemisphere(1500)
    sky = sky[sky[:, 2] > math.cos(math.radians(85.0))]
    pixels, covariance = project_with_covariance(fit, sky)
    error = pixels - project(lens, sky)
    inside = squared_sigmas(error, covariance) < CHI_SQUARE_95
    north = sky[:, 1] > 0.0
    square = np.sum(error**2, axis=-1)
    return [float(np.sqrt(square[half].mean())) for half in (north, ~north)] + [
        float(inside[half].mean()) for half in (north, ~north)
    ]


def main() -> None:
    """Print both tables."""
    parser = argparse.ArgumentParser(prog="night_images.py", description=__doc__)
    parser.add_argument("--lenses", type=int, default=6)
    parser.add_argument("--first", type=int, default=1)
    parser.add_argument("--frames", type=int, default=8, help="images of a night")
    parser.add_argument("--nights", nargs="*", default=list(NIGHTS), help="the kinds of nights")
    parser.add_argument("--fits", action="store_true", help="fit the clear nights with the days")
    asked = parser.parse_args()
    found: dict[str, list[tuple[dict[str, Any], int]]] = {}
    fits: list[list[float]] = []
    for seed in range(asked.first, asked.first + asked.lenses):
        camera = SimulatedImager(seed)
        if asked.fits:
            scene = Scene(camera.lens, SGP, options=SceneOptions(seed=seed, night=NightOptions()))
            camera.night(DARK, scene, asked.frames)
            fits.append(errors(camera.day, camera.lens) + errors(camera.fitted(), camera.lens))
            print(f"lens {seed}: {' '.join(f'{value:.4f}' for value in fits[-1])}", flush=True)
            continue
        for number, name in enumerate(asked.nights):
            evening, weather, options = NIGHTS[name]
            begin = evening + timedelta(minutes=number)  # the archive takes no two sightings of a star at one moment
            sky: Any = {"seed": seed, "weather": (weather,), "night": NightOptions(**options)}
            scene = Scene(camera.lens, SGP, options=SceneOptions(**sky))
            found.setdefault(name, []).append(camera.night(begin, scene, asked.frames))
    for name, rows in found.items():
        verdicts = ", ".join(sorted(details["verdict"] for details, _ in rows))
        images, accepted, stored = (
            sum(details[key] for details, _ in rows) for key in ("n_images", "n_accepted", "n_stored")
        )
        matched = np.median([details["n_matched"] for details, _ in rows])
        false = sum(wrong for _, wrong in rows)
        print(f"{name:15s} {accepted} of {images} images, {matched:.0f} stars, {false} false of {stored}: {verdicts}")
    if fits:
        every = np.array(fits)
        print("              RMS px: north, south   within 95 %: north, south")
        for name, part in (("day", every[:, :4]), ("day and night", every[:, 4:])):
            middle = np.median(part[:, :2], axis=0)
            print(f"{name:14s}{middle[0]:10.4f} {middle[1]:8.4f} {part[:, 2].mean():12.3f} {part[:, 3].mean():8.3f}")


if __name__ == "__main__":
    main()
