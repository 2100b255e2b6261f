"""Sightings of the archive to tables, and tables to sightings."""

from __future__ import annotations

import csv
import json
from collections.abc import Iterable, Sequence
from dataclasses import fields
from datetime import date, datetime
from pathlib import Path
from typing import Any, TextIO, get_args

import numpy as np
from numpy.typing import NDArray

from sunarc.calibration.model.sightings import Sightings
from sunarc.common.array_types import FloatArray
from sunarc.common.errors import InputError, OutsideError
from sunarc.common.findings import Finding, joined
from sunarc.common.json_text import json_text
from sunarc.common.utc import rfc3339, utc_time
from sunarc.formats.csv_files import read_sightings, write_sightings
from sunarc.formats.exported import Table, Variable
from sunarc.formats.tables import netcdf_bytes
from sunarc.imager.archive.archive import Archive, open_archive
from sunarc.imager.archive.database.recovery import upgrade_present
from sunarc.imager.archive.database.schema import upgrade
from sunarc.imager.archive.values import (
    CameraRecord,
    Day,
    DayAir,
    Event,
    Housekeeping,
    HousekeepingStep,
    PoseEpoch,
    Refit,
    SunPoint,
)
from sunarc.imager.live.camera_record import known_camera, register_camera
from sunarc.imager.settings.model import Settings
from sunarc.optics.camera import inside_image
from sunarc.sky.directions import angular_distance
from sunarc.sky.night import SUN, body_directions
from sunarc.sky.site import PA_PER_HPA, Site
from sunarc.sources.files import read_lines, require_inside

_UNITS = {
    "x_px": "px",
    "y_px": "px",
    "sigma_px": "px",
    "exposure_us": "us",
    "clock_error_s": "s",
    "temperature_c": "degC",
    "pressure_hpa": "hPa",
}


def database_path(state: Path) -> Path:
    """Return the database file of a state folder."""
    return state / "sunarc.sqlite"


def export_everything(state: Path, folder: Path) -> dict[str, int]:
    """Write every table of a state folder's archive and return the number of rows by file.

    `calibrations/ID.json` are calibration documents; `sun_points.nc` holds the sightings' numbers once more, as
    NetCDF with units; times are UTC.

    Raises
    ------
    InputError : the folder exists and is not empty.
    OutsideError : it cannot be written.
    """
    try:
        if folder.exists() and any(folder.iterdir()):
            raise InputError(field="folder", problem=f"{folder} is not empty", remedy="name a new folder")
        with open_archive(database_path(state)) as archive:
            (folder / "calibrations").mkdir(parents=True, exist_ok=True)
            return _write_tables(archive, folder)
    except OSError as error:
        raise OutsideError(f"cannot write to {folder}: {error.strerror}; free some space, or name another") from None


def _write_tables(archive: Archive, folder: Path) -> dict[str, int]:
    cameras = archive.cameras.all()
    names = [camera.name for camera in cameras]
    points = [point for name in names for point in archive.sightings.find(name, body=None)]
    calibrations = [record for name in names for record in archive.calibrations.find(name)]
    for record in calibrations:
        _write_json(folder / "calibrations" / f"{record.id}.json", dict(record.document))
    epochs = [epoch for name in names for epoch in archive.epochs.find(name, include_closed=True)]
    return {
        "cameras.csv": _write_csv(folder / "cameras.csv", CameraRecord, cameras),
        "pose_epochs.csv": _write_csv(folder / "pose_epochs.csv", PoseEpoch, epochs),
        "sun_points.csv": _write_csv(folder / "sun_points.csv", SunPoint, points),
        "sun_points.nc": _write_netcdf(folder / "sun_points.nc", points),
        "days.csv": _write_csv(folder / "days.csv", Day, [day for name in names for day in archive.days.find(name)]),
        "day_air.csv": _write_csv(
            folder / "day_air.csv", DayAir, [air for name in names for air in archive.days.air(name)]
        ),
        "refits.csv": _write_csv(
            folder / "refits.csv", Refit, [fit for name in names for fit in archive.refits.find(name)]
        ),
        "events.csv": _write_csv(folder / "events.csv", Event, archive.events.find()),
        **{
            f"housekeeping_{step}.csv": _write_housekeeping(archive, folder, names, step)
            for step in get_args(HousekeepingStep)
        },
        "calibrations/": len(calibrations),
    }


def _write_housekeeping(archive: Archive, folder: Path, cameras: Sequence[str], step: HousekeepingStep) -> int:
    """Write disk space and temperature of all cameras; the folder has one imager's archive, so mostly of one."""
    rows = [row for camera in cameras for row in archive.housekeeping.find(camera, step=step)]
    return _write_csv(folder / f"housekeeping_{step}.csv", Housekeeping, rows)


def _list_columns(kind: type[Any]) -> list[str]:
    """Return the names of a table's columns: its fields; sentences stand where findings do, which come last."""
    names = [field.name for field in fields(kind)]
    sentences = "reason" if kind is SunPoint else "reasons"
    if "findings" not in names or not hasattr(kind, sentences):
        return names
    return [sentences if name == "findings" else name for name in names] + ["findings"]


def _write_csv(path: Path, kind: type[Any], values: Iterable[Any]) -> int:
    names = _list_columns(kind)
    written = 0
    with path.open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(names)
        for value in values:
            writer.writerow([table_cell(getattr(value, name)) for name in names])
            written += 1
    return written


def table_cell(value: Any) -> str | float | int:  # noqa: ANN401 - whatever a field holds
    """Return a value as a cell of a CSV table."""
    if value is None:
        return ""
    if isinstance(value, bool):
        return int(value)
    if isinstance(value, str | int | float):
        return value
    if isinstance(value, datetime):
        return rfc3339(value)
    if isinstance(value, date):
        return value.isoformat()
    return json.dumps(value, default=lambda one: one.as_json() if isinstance(one, Finding) else str(one))


def _write_json(path: Path, document: dict[str, Any]) -> None:
    path.write_text(json_text(document))


def _write_netcdf(path: Path, points: Sequence[SunPoint]) -> int:
    def column(name: str) -> FloatArray:
        values = (getattr(point, name) for point in points)
        return np.array([np.nan if value is None else value for value in values], dtype=np.float64)

    def variable(values: NDArray[Any], coordinates: str = "time", **attributes: str) -> Variable:
        said = {"coordinates": coordinates, **attributes} if coordinates else attributes
        return Variable(dimensions=("sighting",), values=values, attributes=said)

    variables = {name: variable(column(name), units=unit) for name, unit in _UNITS.items()} | {
        "accepted": variable(np.array([point.accepted for point in points], dtype=np.int8)),
        "verdict": variable(np.array([point.verdict for point in points], dtype=np.str_)),
        "time": variable(
            np.array([point.time.timestamp() for point in points], dtype=np.float64),
            coordinates="",
            units="seconds since 1970-01-01 00:00:00",
            calendar="standard",
            standard_name="time",
        ),
    }
    attributes = {
        "Conventions": "CF-1.10",
        "title": "sun sightings",
        "comment": "x right, y down, (0, 0) the centre of the top-left pixel; time: UTC, mid-exposure",
    }
    path.write_bytes(netcdf_bytes(Table(variables=variables, attributes=attributes)))
    return len(points)


_MOST_APART_DEG = 0.05
"""Of a stated direction from the body's: the refraction of other air and formulas near the horizon."""


def import_points(settings: Settings, path: Path, *, image_size: tuple[int, int] | None = None) -> tuple[int, int, int]:
    """Add a file's sightings to the archive; return how many were new, how many the file has, and how many are outside.

    Those outside the image are left out.

    A database that does not exist is made, an older one is migrated, and a camera that is not known is stored with
    the settings' site; nothing is written before the whole file was found good.

    Parameters
    ----------
    settings : camera name, site and state folder.
    path : the CSV file.
    image_size : width and height in px; from the archive, or from `camera.region`, unless given.

    Raises
    ------
    InputError : a row is wrong, many lie outside the image, the image size is not known, or the archive's camera is
        another one.
    """
    table = read_sightings(read_lines(path), name=path.name, site=settings.place)
    size = image_size or _read_archive_size(settings) or _get_settings_size(settings)
    if size is None:
        raise InputError(
            field="--image-size",
            problem=f"missing, and neither the archive nor camera.region has it for camera {settings.name!r}",
            remedy="give the width and height of its images in px, as --image-size 1748,1748",
        )
    require_inside(table.pixels, size, name=path.name)
    total, table = len(table), table.select(inside_image(table.pixels, size))
    _require_bodies(table, settings.place, path.name)
    upgrade_present(settings.archive)
    with open_archive(settings.archive) as archive:
        register_camera(archive, settings, size)
        imported = Finding("sighting_imported", {"file": path.name})
        return (
            archive.sightings.add(_make_sightings(settings, table, imported), first_epoch=joined([imported])),
            total,
            total - len(table),
        )


def write_points(settings: Settings, target: TextIO, *, since: datetime | None, until: datetime | None) -> int:
    """Write the accepted sightings as CSV and return how many, with the air where it was measured (`sighting_air`)."""
    with open_archive(settings.archive) as archive:
        points = archive.sightings.find(settings.name, since=since, until=until, accepted=True, body=None)
        placed = [(p, p.x_px, p.y_px) for p in points if p.x_px is not None and p.y_px is not None]
        air = archive.days.sighting_air(settings.name, [point for point, _, _ in placed])
    rows = [(p.time, x, y, p.sigma_px, p.body) for p, x, y in placed]
    if all(p.body == SUN for p, _, _ in placed):
        return write_sightings(target, rows, air=air)
    unix_s, body = np.array([p.time.timestamp() for p, _, _ in placed]), np.array([p.body for p, _, _ in placed])
    directions = body_directions(body, unix_s, settings.place, temperature=air[0], pressure=air[1])
    return write_sightings(target, rows, air=air, directions=directions)


def _read_archive_size(settings: Settings) -> tuple[int, int] | None:
    if settings.store is None:
        if not settings.database.is_file() or settings.database.stat().st_size == 0:
            return None
        upgrade(settings.database)
    with open_archive(settings.archive) as archive:
        known = known_camera(archive, settings)
    return None if known is None else known.image_size


def _get_settings_size(settings: Settings) -> tuple[int, int] | None:
    region = None if settings.camera is None else settings.camera.region
    return None if region is None else (region[2], region[3])


def _make_sightings(settings: Settings, table: Sightings, imported: Finding) -> list[SunPoint]:
    times = [utc_time(t) for t in table.unix_s]
    return [
        SunPoint(
            camera=settings.name,
            pose_epoch="",
            time=time,
            body=str(body),
            method="import",
            accepted=True,
            verdict="clear",
            findings=(imported,),
            x_px=float(x),
            y_px=float(y),
            sigma_px=_finite_or_none(sigma),
            temperature_c=_finite_or_none(temperature),
            pressure_hpa=_finite_or_none(pressure / PA_PER_HPA),
            clock_error_s=_finite_or_none(clock_error_s),
        )
        for time, (x, y), sigma, temperature, pressure, clock_error_s, body in zip(
            times,
            table.pixels,
            table.sigma_px,
            table.temperature,
            table.pressure,
            table.clock_error_s,
            table.body,
            strict=True,
        )
    ]


def _require_bodies(table: Sightings, site: Site, name: str) -> None:
    """Raise InputError where a stated direction is not that of the body: the archive has bodies, and no directions."""
    stated = np.isfinite(table.directions[:, 0])
    if not np.any(stated):
        return
    known = body_directions(table.body, table.unix_s, site, temperature=table.temperature, pressure=table.pressure)
    of_body = np.isfinite(known[:, 0])
    unknown = int(np.count_nonzero(stated & ~of_body))
    if unknown:
        raise InputError(
            field=f"{name}, body",
            problem=f"{unknown} sightings state a direction and no star (star:HIP32349) or planet that it belongs to",
            remedy="fit the file itself with sunarc calibrate, or leave these rows out",
        )
    apart_deg = np.degrees(angular_distance(table.directions[stated], known[stated]))
    worst = int(np.argmax(apart_deg))
    if apart_deg[worst] > _MOST_APART_DEG:
        raise InputError(
            field=f"{name}, zenith_deg",
            problem=f"{table.body[stated][worst]} was {apart_deg[worst]:.2f} degrees from the stated direction",
            remedy="correct the time, the direction, the body, or the site in the settings",
        )


def _finite_or_none(value: float) -> float | None:
    return None if np.isnan(value) else float(value)
