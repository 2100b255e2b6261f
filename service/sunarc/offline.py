"""Answers from files, with no service running: what the command line does at once and prints."""

from __future__ import annotations

import json
import uuid
from collections.abc import Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, TextIO

import cv2
import numpy as np
from numpy.typing import NDArray

import sunarc
from sunarc.archive import (
    SunPoint,
    backup,
    check,
    open_archive,
    read_pairs,
    read_sightings,
    upgrade,
    write_columns,
    write_sightings,
)
from sunarc.calibration import (
    Calibration,
    CalibrationOptions,
    SunPoints,
    calibrate,
    from_document,
    project_with_covariance,
    to_document,
    unproject_with_sigma,
)
from sunarc.clock import Clock
from sunarc.detection import Detection, DiscOptions, Sensor, detect_sun
from sunarc.errors import InputError
from sunarc.settings import Settings
from sunarc.sky import Site, angles_from_direction, direction_from_angles
from sunarc.studies import write_calibration_plots

_DIRECTION_PLACES = 10
_PIXEL_PLACES = 8


def calibrate_file(
    path: Path,
    *,
    site: Site,
    image_size: tuple[int, int],
    options: CalibrationOptions,
    clock: Clock,
    plots: Path | None = None,
) -> dict[str, Any]:
    """Fit a file of sightings, draw what it says into a folder where one is named, and return the document."""
    table = read_sightings(_lines(path), name=path.name)
    _require_inside(table.pixels, image_size, name=path.name)
    points = SunPoints(unix_s=table.unix_s, pixels=table.pixels, sigma_px=table.sigma_px)
    solved = calibrate(points, site=site, image_size=image_size, options=options)
    if plots is not None:
        write_calibration_plots(solved, points, folder=plots)
    now = clock.now()
    first = datetime.fromtimestamp(float(table.unix_s.min()), UTC) if table.unix_s.size else now
    return to_document(
        solved,
        id=uuid.uuid4().hex,
        camera=path.stem,
        state="candidate" if solved.verdict.accepted else "refused",
        created_at=now,
        valid_from=first,
        valid_until=None,
        pose_epoch="",
        software_version=sunarc.__version__,
    )


def detect_in_files(paths: Sequence[Path], *, method: str) -> list[dict[str, Any]]:
    """Look for the sun in image files of which nothing else is known."""
    return [_detected(path, method=method) for path in paths]


def project_csv(calibration: Path, source: TextIO, target: TextIO) -> None:
    """Read zenith_deg,azimuth_deg and write x_px,y_px,sigma_px,cov_xx,cov_xy,cov_yy,inside."""
    solved = _calibration(calibration)
    angles = read_pairs(source, columns=("zenith_deg", "azimuth_deg"), name="standard input")
    direction = direction_from_angles(zenith_deg=angles[:, 0], azimuth_deg=angles[:, 1])
    pixels, covariance = project_with_covariance(solved, direction)
    camera = solved.camera
    inside = np.all((pixels >= -0.5) & (pixels <= [camera.width - 0.5, camera.height - 0.5]), axis=-1)
    columns = {
        "x_px": pixels[:, 0],
        "y_px": pixels[:, 1],
        "sigma_px": np.sqrt(np.trace(covariance, axis1=-2, axis2=-1) / 2.0),
        "cov_xx": covariance[:, 0, 0],
        "cov_xy": covariance[:, 0, 1],
        "cov_yy": covariance[:, 1, 1],
        "inside": inside.astype(np.float64),
    }
    write_columns(target, columns, places=dict.fromkeys(columns, _DIRECTION_PLACES) | {"inside": 0})


def unproject_csv(calibration: Path, source: TextIO, target: TextIO) -> None:
    """Read x_px,y_px and write zenith_deg,azimuth_deg,sigma_deg,inside."""
    pixels = read_pairs(source, columns=("x_px", "y_px"), name="standard input")
    direction, sigma_deg, inside = unproject_with_sigma(_calibration(calibration), pixels)
    zenith, azimuth = angles_from_direction(direction)
    columns = {
        "zenith_deg": zenith,
        "azimuth_deg": azimuth,
        "sigma_deg": sigma_deg,
        "inside": np.asarray(inside, dtype=np.float64),
    }
    write_columns(target, columns, places=dict.fromkeys(columns, _DIRECTION_PLACES) | {"inside": 0})


def import_points(settings: Settings, path: Path) -> tuple[int, int]:
    """Add a file's sightings to the archive; return how many were new, and how many the file has."""
    table = read_sightings(_lines(path), name=path.name)
    archive = open_archive(settings.database)
    known = {camera.name: camera for camera in archive.cameras()}
    if settings.name not in known:
        raise InputError(
            field="name",
            problem=f"the archive knows no camera {settings.name!r}",
            remedy="start the service once with this camera, or correct the name",
        )
    camera = known[settings.name]
    _require_inside(table.pixels, (camera.width, camera.height), name=path.name)
    times = [datetime.fromtimestamp(t, UTC) for t in table.unix_s]
    points = [
        SunPoint(
            camera=settings.name,
            pose_epoch=archive.epoch_at(settings.name, time, reason=f"imported from {path.name}").id,
            time=time,
            method="import",
            accepted=True,
            verdict="clear",
            reason=f"imported from {path.name}",
            x_px=float(x),
            y_px=float(y),
            sigma_px=None if np.isnan(sigma) else float(sigma),
        )
        for time, (x, y), sigma in zip(times, table.pixels, table.sigma_px, strict=True)
    ]
    return archive.add_sun_points(points), len(points)


def export_points(settings: Settings, target: TextIO, *, since: datetime | None, until: datetime | None) -> int:
    """Write the accepted sightings as CSV and return how many."""
    archive = open_archive(settings.database)
    points = archive.sun_points(settings.name, since=since, until=until, accepted=True)
    return write_sightings(
        target,
        (
            (point.time, point.x_px, point.y_px, point.sigma_px, point.body)
            for point in points
            if point.x_px is not None and point.y_px is not None
        ),
    )


def upgrade_database(state: Path) -> str:
    """Create or migrate the database of a state folder and say what was done."""
    path = database_of(state)
    existed = path.exists()
    copy = upgrade(path)
    if copy is not None:
        return f"{path} was upgraded; the former one is kept as {copy.name}"
    return f"{path} is up to date" if existed else f"{path} was made"


def check_database(state: Path) -> dict[str, Any]:
    """Return what a look at the database told."""
    found = check(database_of(state))
    return {
        "sound": found.sound,
        "revision": found.revision,
        "head": found.head,
        "integrity": list(found.integrity),
        "rows": dict(found.rows),
    }


def backup_database(state: Path, target: Path) -> str:
    """Copy the database and say where to."""
    return f"copied to {backup(database_of(state), target)}"


def database_of(state: Path) -> Path:
    """Return the database file of a state folder."""
    return state / "sunarc.sqlite"


def _detected(path: Path, *, method: str) -> dict[str, Any]:
    image = read_image(path)
    sensor = Sensor.from_full_well(full_scale=int(np.iinfo(image.dtype).max))
    found: Detection = detect_sun(image, sensor=sensor, expectation=None, options=DiscOptions())
    return {"file": str(path), **{name: getattr(found, name) for name in Detection.__slots__}}


def read_image(path: Path) -> NDArray[np.uint8] | NDArray[np.uint16]:
    """Read an image file as it is, 8 or 16 bit."""
    encoded = np.frombuffer(_read(path), dtype=np.uint8)
    image = cv2.imdecode(encoded, cv2.IMREAD_UNCHANGED) if encoded.size else None
    if image is not None and image.dtype == np.uint8:
        return image.astype(np.uint8)
    if image is not None and image.dtype == np.uint16:
        return image.astype(np.uint16)
    raise InputError(field=str(path), problem="is no 8 or 16 bit image", remedy="give a whole PNG, JPEG or TIFF file")


def _read(path: Path) -> bytes:
    try:
        return path.read_bytes()
    except OSError as error:
        raise InputError(
            field=str(path), problem=error.strerror or str(error), remedy="name a file that can be read"
        ) from None


def _lines(path: Path) -> list[str]:
    try:
        return _read(path).decode().splitlines()
    except UnicodeDecodeError:
        raise InputError(field=str(path), problem="is not text", remedy="give a CSV file in UTF-8") from None


def _calibration(path: Path) -> Calibration:
    try:
        document = json.loads(_read(path))
    except ValueError:
        raise InputError(field=str(path), problem="is not JSON", remedy="give a calibration document") from None
    return from_document(document)


def _require_inside(pixels: NDArray[np.float64], image_size: tuple[int, int], *, name: str) -> None:
    outside = np.flatnonzero(np.any((pixels < -0.5) | (pixels > np.array(image_size) - 0.5), axis=-1))
    if outside.size:
        x, y = pixels[outside[0]]
        raise InputError(
            field=f"{name}, sighting {outside[0] + 1}",
            problem=f"pixel ({x:g}, {y:g}) is outside the {image_size[0]}x{image_size[1]} image",
            remedy="correct the row, or the image size",
        )
