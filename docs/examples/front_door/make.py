"""Makes the files of this folder: `python docs/examples/front_door/make.py`.

The simulator's camera of the paper's site sees the sun in exposures of microseconds (`sun.csv`); a smaller one takes
ordinary pictures through a day (`pictures/`) and one of the night (`night.png`). The two calibrations are fits of them.
"""

from __future__ import annotations

from datetime import UTC, datetime
from pathlib import Path

import cv2
import numpy as np

import sunarc
from sunarc.common.array_types import FloatArray, Image
from sunarc.common.utc import utc_time
from sunarc.formats.csv_files import write_sightings
from sunarc.lab.simulation.made_archive import photograph
from sunarc.lab.simulation.truth import SGP, true_camera
from sunarc.optics.camera import Camera
from sunarc.optics.forward import project
from sunarc.optics.pose import PoseAngles, rotation_from_pose_angles
from sunarc.sky.night import night_sky
from sunarc.sky.sun import sun_angles, sun_directions

FOLDER = Path(__file__).parent
SITE = sunarc.Site(latitude=SGP.latitude, longitude=SGP.longitude, altitude_m=SGP.altitude)
DAWN = datetime(2013, 5, 13, 11, 44, tzinfo=UTC).timestamp()
SIZE = 360
SMALL = Camera(
    width=SIZE,
    height=SIZE,
    projection="equisolid",
    focal_length_px=(122.0, 122.0),
    principal_point_px=(180.6, 178.9),
    rotation_cam_enu=rotation_from_pose_angles(PoseAngles(47.91, 2.46, 140.16)),
)
NIGHT = datetime(2013, 5, 14, 5, 0, tzinfo=UTC).timestamp()


def times(step_s: float, highest_zenith_deg: float) -> FloatArray:
    """Return times of a day at which the sun is up, seconds since 1970-01-01 UTC."""
    found = DAWN + np.arange(0.0, 15 * 3600.0, step_s)
    return found[sun_angles(found, SGP).apparent_zenith < highest_zenith_deg]


def write_suns(rng: np.random.Generator) -> None:
    """Write 455 sightings of a clear day, with a noise of 0.15 px."""
    unix_s = times(107.0, 88.0)
    pixels = project(true_camera(0), sun_directions(unix_s, SGP)) + rng.normal(0.0, 0.15, (unix_s.size, 2))
    rows = [(utc_time(t), x, y, 0.15, "sun") for t, (x, y) in zip(unix_s.tolist(), pixels.tolist(), strict=True)]
    with (FOLDER / "sun.csv").open("w") as file:
        write_sightings(file, rows)


def write_pictures(rng: np.random.Generator) -> None:
    """Write a picture every 15 minutes of the day."""
    (FOLDER / "pictures").mkdir(exist_ok=True)
    unix_s = times(900.0, 80.0)
    for time, sun in zip(unix_s.tolist(), project(SMALL, sun_directions(unix_s, SGP)), strict=True):
        path = FOLDER / "pictures" / f"{utc_time(time):%Y%m%dT%H%M%SZ}.jpg"
        jpeg = cv2.imencode(".jpg", photograph(SIZE, sun, rng), [cv2.IMWRITE_JPEG_QUALITY, 75])[1]
        path.write_bytes(jpeg.tobytes())


def night_image(rng: np.random.Generator) -> Image:
    """Return what an exposure of seconds shows of the stars."""
    sky = night_sky(NIGHT, SGP, faintest=4.5)
    image = np.full((SIZE, SIZE), 12.0)
    rows, columns = np.mgrid[:SIZE, :SIZE]
    for (x, y), magnitude in zip(project(SMALL, sky.directions), sky.magnitude, strict=True):
        if np.isfinite(x):
            near = (slice(max(int(y) - 6, 0), int(y) + 7), slice(max(int(x) - 6, 0), int(x) + 7))
            distance = np.hypot(columns[near] - x, rows[near] - y)
            image[near] += 1800.0 * 10.0 ** (-0.4 * magnitude) * np.exp(-0.5 * distance**2)
    return np.clip(np.round(image + rng.normal(0.0, 1.0, image.shape)), 0, 255).astype(np.uint8)


def main() -> None:
    """Write all of them."""
    rng = np.random.default_rng(1)
    write_suns(rng)
    write_pictures(rng)
    (FOLDER / "night.png").write_bytes(cv2.imencode(".png", night_image(rng))[1].tobytes())
    fitted = sunarc.calibrate(sunarc.read_sightings(FOLDER / "sun.csv"), SITE, image_size=(1748, 1748))
    found = [
        sunarc.find_sun(path, time=datetime.strptime(path.stem, "%Y%m%dT%H%M%SZ").replace(tzinfo=UTC))
        for path in sorted((FOLDER / "pictures").glob("*.jpg"))
    ]
    small = sunarc.calibrate(sunarc.Sightings.from_found(found), SITE, image_size=(SIZE, SIZE), name="pictures")
    for name, calibration in (("calibration", fitted), ("pictures", small)):
        print(calibration)
        calibration.save(FOLDER / f"{name}.json")


if __name__ == "__main__":
    main()
