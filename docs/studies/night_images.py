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
from collections.abc import Iterable, Iterator
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import numpy as np
from coverage_statistics import CHI_SQUARE_95, squared_sigmas

from sunarc.calibration.answers.covariance import hemisphere, project_with_covariance
from sunarc.calibration.calibrate import calibrate
from sunarc.calibration.model.options import CalibrationOptions
from sunarc.calibration.model.result import Calibration
from sunarc.common.utc import utc_time
from sunarc.formats.calibration_document import to_document
from sunarc.imager.archive.archive import Archive, CameraArchive, open_archive
from sunarc.imager.archive.database.schema import upgrade
from sunarc.imager.archive.values import CameraRecord, Refit, SunPoint
from sunarc.imager.cameras.frame import Frame
from sunarc.imager.runtime.loop import DropOldestQueue
from sunarc.imager.runtime.status import StatusRegistry
from sunarc.imager.workers.calibrating.refit import RefitTask, next_task
from sunarc.imager.workers.night.exposures import NightCapture, NightExposures
from sunarc.imager.workers.night.night import NightWorker
from sunarc.imager.workers.options import SensorOptions
from sunarc.lab.simulation.options import SceneOptions, SimulatedNight
from sunarc.lab.simulation.scene import Scene
from sunarc.lab.simulation.truth import SGP, true_camera
from sunarc.optics.camera import Camera
from sunarc.optics.forward import project
from sunarc.sky.night import body_directions
from sunarc.sky.sun import sun_angles, sun_directions

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
    """One camera with its archive, its day and its worker of the night.

    Parameters
    ----------
    lens : the true camera.
    seed : draws the noise of the day.
    day : the fit of that day, where it was made before.
    served : the calibration that names the stars; the day's unless given.
    """

    def __init__(
        self, lens: Camera, *, seed: int, day: Calibration | None = None, served: Calibration | None = None
    ) -> None:
        self.lens = lens
        self._folder = tempfile.TemporaryDirectory()
        path = Path(self._folder.name) / "sunarc.sqlite"
        upgrade(path)
        self.archive: Archive = open_archive(path)
        self.archive.cameras.save(CameraRecord.at(SGP, name="roof", width=lens.width, height=lens.height))
        self.camera = CameraArchive(self.archive, name="roof", site=SGP)
        self.now = datetime(2013, 5, 26, 12, tzinfo=UTC)
        self._add_day(np.random.default_rng(seed + 100))
        self.day = self.fitted() if day is None else day
        document = to_document(
            served or self.day, id="day", camera="roof", state="candidate", created_at=DARK,
            valid_from=DARK - timedelta(days=1), valid_until=None, pose_epoch="roof-1", software_version="0",
        )  # fmt: skip
        self.archive.calibrations.add(document)
        self.archive.calibrations.activate("day")

    def close(self) -> None:
        """Remove the archive."""
        self.archive.close()
        self._folder.cleanup()

    def _add_day(self, rng: np.random.Generator) -> None:
        times = datetime(2013, 5, 13, 6, tzinfo=UTC).timestamp() + np.arange(0.0, 86_400.0, 120.0)
        times = times[sun_angles(times, SGP).apparent_zenith < 88.0]
        pixels = project(self.lens, sun_directions(times, SGP)) + rng.normal(0.0, SUN_PX, (times.size, 2))
        self.archive.epochs.at("roof", utc_time(float(times[0])), reason="first frame")
        self.archive.sightings.add(
            SunPoint(
                camera="roof", pose_epoch="roof-1", time=utc_time(time), method="disc", accepted=True, verdict="clear",
                x_px=x, y_px=y, sigma_px=SUN_PX,
            )
            for time, (x, y) in zip(times.tolist(), pixels.tolist(), strict=True)
        )  # fmt: skip

    def fitted(self) -> Calibration:
        """Return the fit of all that the archive has."""
        task = next_task(self.camera, cadence_s=120.0, options=CalibrationOptions(), circle=None, now=self.now)
        if not isinstance(task, RefitTask):
            raise TypeError(f"nothing to solve: {task}")
        problem = task.problem
        return calibrate(problem.points, site=problem.site, image_size=problem.image_size, options=problem.options)

    def night(self, begin: datetime, frames: Iterable[Frame], *, late_s: float = 0.0) -> tuple[dict[str, Any], int]:
        """Return the verdict of a night whose frames are dated too late, and how many of its sightings are false."""
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
        for frame in frames:
            dated = replace(frame, time=frame.time + timedelta(seconds=late_s))
            times.append(dated.time.timestamp())
            worker.look_at(dated)
        worker.finish()
        (event,) = self.archive.events.find("roof", kind="night", limit=1)
        stars = self.archive.sightings.columns("roof", body=None, since=begin)
        stars = stars.select((stars.body != "sun") & np.isin(stars.unix_s, times))
        true = project(self.lens, body_directions(stars.body, stars.unix_s - late_s, SGP))
        return dict(event.details), int(np.sum(np.linalg.norm(stars.pixels - true, axis=-1) > 1.0))


def frames_of(scene: Scene, begin: datetime, count: int) -> Iterator[Frame]:
    """Yield the images of a night, evenly over its hours."""
    for number in range(count):
        start = begin + timedelta(hours=HOURS * number / count)
        yield Frame(
            image=scene.render(int(start.timestamp() * 1e6), exposure_us=EXPOSURE_US),
            time=start + timedelta(microseconds=0.5 * EXPOSURE_US), exposure_us=EXPOSURE_US, gain_db=0.0,
            pixel_format="Mono12", full_scale=4095, frame_id=number,
        )  # fmt: skip


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
        camera = SimulatedImager(true_camera(seed), seed=seed)
        if asked.fits:
            scene = Scene(camera.lens, SGP, options=SceneOptions(seed=seed, night=SimulatedNight()))
            camera.night(DARK, frames_of(scene, DARK, asked.frames))
            fits.append(errors(camera.day, camera.lens) + errors(camera.fitted(), camera.lens))
            print(f"lens {seed}: {' '.join(f'{value:.4f}' for value in fits[-1])}", flush=True)
            continue
        for number, name in enumerate(asked.nights):
            evening, weather, options = NIGHTS[name]
            begin = evening + timedelta(minutes=number)  # the archive takes no two sightings of a star at one moment
            sky: Any = {"seed": seed, "weather": (weather,), "night": SimulatedNight(**options)}
            scene = Scene(camera.lens, SGP, options=SceneOptions(**sky))
            found.setdefault(name, []).append(camera.night(begin, frames_of(scene, begin, asked.frames)))
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
