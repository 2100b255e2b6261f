"""All that the archive holds, in files that any tool reads: CSV, JSON and NetCDF."""

from __future__ import annotations

import csv
import json
from collections.abc import Iterable, Sequence
from dataclasses import fields
from datetime import date, datetime
from pathlib import Path
from typing import Any, get_args

import numpy as np
from numpy.typing import NDArray

from sunarc.archive.archive import Archive, open_archive
from sunarc.archive.housekeeping_values import Housekeeping, HousekeepingStep
from sunarc.archive.values import CameraRecord, Day, DayAir, Event, PoseEpoch, Refit, SunPoint
from sunarc.array_types import FloatArray
from sunarc.errors import InputError, OutsideError
from sunarc.exports.discovery import Table, Variable
from sunarc.exports.tables import netcdf_bytes
from sunarc.findings import Finding
from sunarc.utc import rfc3339

_UNITS = {
    "x_px": "px",
    "y_px": "px",
    "sigma_px": "px",
    "exposure_us": "us",
    "clock_error_s": "s",
    "temperature_c": "degC",
    "pressure_hpa": "hPa",
}


def database_of(state: Path) -> Path:
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
        with open_archive(database_of(state)) as archive:
            (folder / "calibrations").mkdir(parents=True, exist_ok=True)
            return _write(archive, folder)
    except OSError as error:
        raise OutsideError(f"cannot write to {folder}: {error.strerror}; free some space, or name another") from None


def _write(archive: Archive, folder: Path) -> dict[str, int]:
    cameras = archive.cameras()
    names = [camera.name for camera in cameras]
    points = [point for name in names for point in archive.sun_points(name, body=None)]
    calibrations = [record for name in names for record in archive.calibrations(name)]
    for record in calibrations:
        _write_json(folder / "calibrations" / f"{record.id}.json", dict(record.document))
    epochs = [epoch for name in names for epoch in archive.epochs(name, include_closed=True)]
    return {
        "cameras.csv": _write_csv(folder / "cameras.csv", CameraRecord, cameras),
        "pose_epochs.csv": _write_csv(folder / "pose_epochs.csv", PoseEpoch, epochs),
        "sun_points.csv": _write_csv(folder / "sun_points.csv", SunPoint, points),
        "sun_points.nc": _write_netcdf(folder / "sun_points.nc", points),
        "days.csv": _write_csv(folder / "days.csv", Day, [day for name in names for day in archive.days(name)]),
        "day_air.csv": _write_csv(
            folder / "day_air.csv", DayAir, [air for name in names for air in archive.day_air(name)]
        ),
        "refits.csv": _write_csv(folder / "refits.csv", Refit, [fit for name in names for fit in archive.refits(name)]),
        "events.csv": _write_csv(folder / "events.csv", Event, archive.events()),
        **{
            f"housekeeping_{step}.csv": _write_housekeeping(archive, folder, names, step)
            for step in get_args(HousekeepingStep)
        },
        "calibrations/": len(calibrations),
    }


def _write_housekeeping(archive: Archive, folder: Path, cameras: Sequence[str], step: HousekeepingStep) -> int:
    """Write disk space and temperature of all cameras; the folder has one imager's archive, so mostly of one."""
    rows = [row for camera in cameras for row in archive.housekeeping(camera, step=step)]
    return _write_csv(folder / f"housekeeping_{step}.csv", Housekeeping, rows)


def _columns(kind: type[Any]) -> list[str]:
    """Return the names of a table's columns: its fields; sentences stand where findings do, which come last."""
    names = [field.name for field in fields(kind)]
    if not hasattr(kind, "reasons"):
        return names
    return ["reasons" if name == "findings" else name for name in names] + ["findings"]


def _write_csv(path: Path, kind: type[Any], values: Iterable[Any]) -> int:
    names = _columns(kind)
    written = 0
    with path.open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(names)
        for value in values:
            writer.writerow([_cell(getattr(value, name)) for name in names])
            written += 1
    return written


def _cell(value: Any) -> str | float | int:  # noqa: ANN401 - whatever a field holds
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
    path.write_text(json.dumps(document, indent=1, allow_nan=False) + "\n")


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
