"""How many sun exposures of a clear day are accepted in binned frames, and the calibration that comes of them.

    .venv/bin/python docs/studies/binned_sun.py --binning 2 --every 240

A bare lens: the sun saturates at the camera's shortest exposure (1 µs), so that means over clipped pixels are fitted.
"""

from __future__ import annotations

import argparse
from datetime import UTC, datetime
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sunarc.calibration.answers.covariance import hemisphere, project_with_covariance, sigma_px
from sunarc.calibration.calibrate import calibrate
from sunarc.calibration.model.sightings import Sightings
from sunarc.common.array_types import Image
from sunarc.detection.disc.detect import detect_sun
from sunarc.imager.cameras.frame import CameraInfo, Frame
from sunarc.imager.workers.exposures import SunExposures
from sunarc.imager.workers.options import SensorOptions, frame_sensor
from sunarc.imaging.exposure import SunExposureOptions
from sunarc.lab.simulation.options import SceneOptions, SensorModel
from sunarc.lab.simulation.scene import Scene
from sunarc.lab.simulation.truth import SGP, true_camera
from sunarc.optics.forward import project
from sunarc.sky.sun import sun_angles

FULL_SCALE = 4095
START_S = datetime(2013, 5, 13, 11, tzinfo=UTC).timestamp()


class Day(NamedTuple):
    """Slots with the sun up, and the accepted sightings: times (n,), pixels (n, 2), errors (n,) px of the image."""

    slots: int
    accepted_slots: int
    unix_s: NDArray[np.float64]
    pixels: NDArray[np.float64]
    error_px: NDArray[np.float64]


def binned(image: Image, n: int) -> NDArray[np.uint16]:
    """Return the means over n by n pixels, as a camera's averaging mode rounds them down."""
    height, width = image.shape[0] // n, image.shape[1] // n
    means = image[: height * n, : width * n].reshape(height, n, width, n).mean(axis=(1, 3))
    return np.asarray(means, dtype=np.float64).astype(np.uint16)


def live(binning: int, *, every_s: float) -> Day:
    """Take the sun exposures of a day as the service would, without a calibration, and detect."""
    scene = Scene(true_camera(), SGP, options=SceneOptions(weather=("clear",)), sensor=SensorModel())
    zenith = [0.0]
    control = SunExposures(SunExposureOptions(), apparent_zenith=lambda: zenith[0])
    info = CameraInfo(
        address="", vendor="", model="", serial="", width=1, height=1, pixel_format="Mono12", full_scale=FULL_SCALE,
        exposure_min_us=1.0, exposure_max_us=1e7, exposure_step_us=1.0,
    )  # fmt: skip
    slots, accepted = 0, 0
    found: list[tuple[float, float, float, float]] = []
    for unix_s in START_S + np.arange(0.0, 15.0 * 3600.0, every_s):
        zenith[0] = float(sun_angles(unix_s, SGP).apparent_zenith)
        if zenith[0] >= 89.6:
            continue
        before, slots = len(found), slots + 1
        for number, exposure_us in enumerate(control.choose(info)):
            start_us = round((unix_s + 0.1 * number) * 1e6)
            middle_s = start_us * 1e-6 + exposure_us * 0.5e-6
            frame = Frame(
                image=binned(scene.render(start_us, exposure_us=exposure_us, full_scale=FULL_SCALE), binning),
                time=datetime.fromtimestamp(middle_s, UTC), exposure_us=exposure_us, gain_db=0.0, pixel_format="Mono12",
                full_scale=FULL_SCALE, frame_id=1, binning=binning,
            )  # fmt: skip
            sensor = frame_sensor(frame, SensorOptions(black_level_fraction=0.0078))
            seen = detect_sun(frame.image, sensor=sensor, exposure_us=exposure_us)
            control.report(frame, seen)
            if seen.accepted and seen.x_px is not None and seen.y_px is not None:
                true = (scene.sun_pixel(middle_s) - 0.5 * (binning - 1)) / binning
                off = float(np.hypot(seen.x_px - true[0], seen.y_px - true[1]))
                found.append((middle_s, seen.x_px, seen.y_px, off))
        accepted += len(found) > before
    rows = np.array(found).reshape(-1, 4)
    return Day(slots, accepted, rows[:, 0], rows[:, 1:3], rows[:, 3])


def sky_error_px(day: Day, binning: int) -> tuple[float, float]:
    """Return the calibration's error over the sky and its stated 1-sigma, px of the sensor."""
    truth = true_camera()
    solved = calibrate(
        Sightings.of(unix_s=day.unix_s, pixels=day.pixels), site=SGP,
        image_size=(truth.width // binning, truth.height // binning),
    )  # fmt: skip
    directions = hemisphere(600)
    pixels, covariance = project_with_covariance(solved, directions)
    off = pixels * binning + 0.5 * (binning - 1) - project(truth, directions)
    stated = binning * np.sqrt(np.nanmean(2.0 * sigma_px(covariance) ** 2))
    return float(np.sqrt(np.nanmean(np.sum(off**2, axis=-1)))), float(stated)


def main() -> None:
    """Print a line of the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--binning", type=int, default=2)
    parser.add_argument("--every", type=float, default=240.0, help="seconds from slot to slot")
    options = parser.parse_args()
    day = live(options.binning, every_s=options.every)
    error, stated = sky_error_px(day, options.binning)
    rms = options.binning * float(np.sqrt(np.mean(day.error_px**2)))
    print("| binning | slots accepted | error of a sighting, px of the sensor | over the sky, px | stated |")
    print("|---|---|---|---|---|")
    print(f"| {options.binning} | {day.accepted_slots} of {day.slots} | {rms:.4f} | {error:.3f} | {stated:.3f} |")


if __name__ == "__main__":
    main()
