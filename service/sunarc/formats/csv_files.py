"""CSV files of sightings, directions and pixels; an error names the line and the column."""

from __future__ import annotations

import csv
import itertools
import math
import re
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from datetime import datetime
from typing import TextIO

import numpy as np

from sunarc.calibration.model.sightings import Sightings
from sunarc.common.array_types import FloatArray, IntArray
from sunarc.common.errors import InputError
from sunarc.common.utc import DAY_S, parse_time, rfc3339
from sunarc.sky.directions import angles_from_direction, direction_from_angles
from sunarc.sky.night import SUN, body_directions
from sunarc.sky.site import PA_PER_HPA, PRESSURE_BOUNDS_HPA, TEMPERATURE_BOUNDS_C, Site

SIGHTING_COLUMNS = ("time_utc", "x_px", "y_px", "sigma_px", "body")
_REQUIRED = ("time_utc", "x_px", "y_px")
_AIR_COLUMNS = ("temperature_c", "pressure_hpa")
_DIRECTION_COLUMNS = ("zenith_deg", "azimuth_deg")
_CLOCK_BOUNDS_S = (0.0, DAY_S)
_SEPARATORS = (",", ";", "\t")
_DECIMAL_COMMA = re.compile(r"^(\s*[+-]?\d*),(\d+(?:[eE][+-]?\d+)?\s*)$")
_ZENITH_BOUNDS_DEG, _AZIMUTH_BOUNDS_DEG = (0.0, 180.0), (-360.0, 360.0)


def read_sightings(lines: Iterable[str], *, name: str, site: Site | None = None) -> Sightings:
    """Read sightings: `time_utc,x_px,y_px` and the optional columns.

    These are `sigma_px`, `body`, `zenith_deg,azimuth_deg`, `temperature_c`, `pressure_hpa` and `clock_error_s`. Times
    are ISO 8601 with Z; the header is required, other columns are ignored. A zenith angle and an azimuth (apparent,
    clockwise from north) override the body; without them the body is the sun, or one whose direction the site gives.
    What is not stated is NaN. A `camera` column names one camera; an `epoch` column then numbers the pose epochs,
    as in the tables of `sunarc reanalyse`.

    Parameters
    ----------
    lines : the file, or any lines.
    name : what to call it in an error.
    site : where the camera stands, for stars, planets and the moon by their names; None: their angles are needed.

    Raises
    ------
    InputError : naming the line and column, the problem and the remedy.
    """
    points, wheres = read_unplaced(lines, name=name)
    return with_named_bodies(points, site, wheres=wheres)


def read_unplaced(lines: Iterable[str], *, name: str) -> tuple[Sightings, list[str]]:
    """Read sightings as `read_sightings` does, but bodies by their names have no direction yet; and where each stands.

    They are complete after `with_named_bodies`.
    """
    wheres: list[str] = []
    of_camera: list[tuple[str, str]] = []
    rows: list[tuple[float, ...]] = []
    body: list[str] = []
    for where, row in _rows(lines, name=name, required=_REQUIRED):
        direction = _direction(row, where=where)
        wheres.append(where)
        of_camera.append((row.get("camera") or "", row.get("epoch") or ""))
        body.append((row.get("body") or "").strip() or "sun")
        rows.append(
            (
                parse_time(row["time_utc"], where=f"{where}, time_utc").timestamp(),
                _number(row["x_px"], where=f"{where}, x_px"),
                _number(row["y_px"], where=f"{where}, y_px"),
                _sigma(row.get("sigma_px"), where=f"{where}, sigma_px"),
                _between(row.get("temperature_c"), *TEMPERATURE_BOUNDS_C, where=f"{where}, temperature_c"),
                PA_PER_HPA * _between(row.get("pressure_hpa"), *PRESSURE_BOUNDS_HPA, where=f"{where}, pressure_hpa"),
                _between(row.get("clock_error_s"), *_CLOCK_BOUNDS_S, where=f"{where}, clock_error_s"),
                *direction,
            )
        )
    columns = np.array(rows, dtype=np.float64).reshape(-1, 9)
    return Sightings.of(
        epoch=_epochs(of_camera, columns[:, 0], name=name),
        unix_s=columns[:, 0],
        pixels=columns[:, 1:3],
        sigma_px=columns[:, 3],
        temperature=columns[:, 4],
        pressure=columns[:, 5],
        clock_error_s=columns[:, 6],
        directions=direction_from_angles(zenith_deg=columns[:, 7], azimuth_deg=columns[:, 8]),
        body=np.array(body, dtype=np.str_),
    ), wheres


def with_named_bodies(points: Sightings, site: Site | None, *, wheres: Sequence[str]) -> Sightings:
    """Return sightings whose bodies other than the sun have the directions that a site gives their names.

    Parameters
    ----------
    points : a stated direction is kept.
    site : None: every body but the sun needs a stated direction.
    wheres : where each row stands, for errors.

    Raises
    ------
    InputError
        Naming the first row whose body is not known.
    """
    named = np.flatnonzero(np.isnan(points.directions[:, 0]) & (points.body != SUN))
    if not named.size:
        return points
    found = np.full((named.size, 3), np.nan)
    if site is not None:
        air = {"temperature": points.temperature[named], "pressure": points.pressure[named]}
        found = body_directions(points.body[named], points.unix_s[named], site, **air)
    unknown = np.flatnonzero(np.isnan(found[:, 0]))
    if unknown.size:
        row = int(named[unknown[0]])
        raise InputError(
            field=f"{wheres[row]}, body",
            problem=f"{str(points.body[row])!r} is not known",
            remedy="give its zenith_deg and azimuth_deg, or sun sightings",
        )
    directions = np.array(points.directions)
    directions[named] = found
    return replace(points, directions=directions)


def _epochs(of_camera: Sequence[tuple[str, str]], unix_s: FloatArray, *, name: str) -> IntArray:
    """Return the pose epochs (n,) of rows in the order of their first times (`unix_s`, (n,)).

    InputError where the rows are of several cameras.
    """
    cameras = sorted({camera for camera, _ in of_camera})
    if len(cameras) > 1:
        raise InputError(
            field=f"{name}, camera",
            problem=f"has rows of {len(cameras)} cameras: {', '.join(cameras[:3])}",
            remedy="give the rows of one camera",
        )
    if cameras in ([], [""]):
        return np.zeros(len(of_camera), dtype=np.int64)
    names, of_row = np.unique([epoch for _, epoch in of_camera], return_inverse=True)
    begins = np.full(names.size, np.inf)
    np.minimum.at(begins, of_row, unix_s)
    order = np.argsort(begins, kind="stable")  # as text "10" stands before "2"
    return np.argsort(order)[of_row].astype(np.int64)


def _direction(row: dict[str, str], *, where: str) -> tuple[float, float]:
    """Return the stated zenith angle and azimuth, degrees; NaN for both where the sun is meant."""
    zenith, azimuth = (
        _between(row.get(column), *bounds, where=f"{where}, {column}")
        for column, bounds in zip(_DIRECTION_COLUMNS, (_ZENITH_BOUNDS_DEG, _AZIMUTH_BOUNDS_DEG), strict=True)
    )
    if math.isnan(zenith) != math.isnan(azimuth):
        missing = _DIRECTION_COLUMNS[0] if math.isnan(zenith) else _DIRECTION_COLUMNS[1]
        raise InputError(field=f"{where}, {missing}", problem="is empty beside the other angle", remedy="give both")
    return zenith, azimuth


def write_sightings(
    target: TextIO,
    rows: Iterable[tuple[datetime, float, float, float | None, str]],
    *,
    air: tuple[FloatArray, FloatArray] | None = None,
    directions: FloatArray | None = None,
) -> int:
    """Write sightings as `read_sightings` reads them, and return how many.

    Parameters
    ----------
    target : where to.
    rows : time, x (px), y (px), 1-sigma (px) and body of each.
    air : temperature (°C) and pressure (Pa) of each, (n,), NaN where not measured; without it, or where it has only
        NaN, the two columns are left out.
    directions : apparent ones of each, (n, 3), east-north-up, of what is not the sun; None leaves the columns out.
    """
    writer = csv.writer(target, lineterminator="\n")
    measured = air is not None and not np.all(np.isnan(air))
    angles = () if directions is None else angles_from_direction(directions)
    header = (*SIGHTING_COLUMNS, *(_AIR_COLUMNS if measured else ()), *(_DIRECTION_COLUMNS if angles else ()))
    writer.writerow(header)
    count = 0
    for time, x, y, sigma, body in rows:
        stamp = rfc3339(time, timespec="microseconds")
        cells = [stamp, f"{x:.6f}", f"{y:.6f}", "" if sigma is None else f"{sigma:.6f}", body]
        if air is not None and measured:
            cells += [_cell(air[0][count], places=3), _cell(air[1][count] / PA_PER_HPA, places=3)]
        cells += [_cell(column[count], places=6) for column in angles]
        writer.writerow(cells)
        count += 1
    return count


def read_pairs(lines: Iterable[str], *, columns: tuple[str, str], name: str) -> FloatArray:
    """Read two columns of numbers, (n, 2); `InputError` names line and column."""
    rows = [
        tuple(_number(row[column], where=f"{where}, {column}") for column in columns)
        for where, row in _rows(lines, name=name, required=columns)
    ]
    return np.array(rows, dtype=np.float64).reshape(-1, 2)


def _between(text: str | None, low: float, high: float, *, where: str) -> float:
    """Return a number within limits; NaN for an empty cell."""
    if not (text or "").strip():
        return math.nan
    value = _number(str(text), where=where)
    if not low <= value <= high:
        raise InputError(field=where, problem=f"{value:g} is not within {low:g} to {high:g}", remedy="correct the cell")
    return value


def write_columns(target: TextIO, columns: dict[str, FloatArray], *, places: dict[str, int]) -> None:
    """Write columns of numbers with so many decimal places; NaN is an empty cell."""
    writer = csv.writer(target, lineterminator="\n")
    writer.writerow(columns)
    for row in zip(*columns.values(), strict=True):
        writer.writerow(_cell(value, places=places[column]) for column, value in zip(columns, row, strict=True))


def _cell(value: float, *, places: int) -> str:
    return "" if math.isnan(value) else f"{value:.{places}f}"


def _rows(lines: Iterable[str], *, name: str, required: Sequence[str]) -> Iterator[tuple[str, dict[str, str]]]:
    """Yield each row with its place; columns are separated as in the header, by commas, semicolons or tabs.

    Where it is not by commas, a comma within a number is its decimal point: spreadsheets of most languages write so.
    """
    given = iter(lines)
    begin: list[str] = []
    while not (begin and begin[-1].strip()) and (line := next(given, None)) is not None:
        begin.append(line)
    separator = max(_SEPARATORS, key=begin[-1].count) if begin else _SEPARATORS[0]
    reader = csv.reader(itertools.chain(begin, given), delimiter=separator)
    header = next((row for row in reader if row), None)
    if header is None:
        raise InputError(field=name, problem="is empty", remedy=f"give a header with {','.join(required)}")
    # Spreadsheets begin a file with a byte order mark, which would hide the first column.
    names = [cell.strip().lstrip("\ufeff") for cell in header]
    missing = [column for column in required if column not in names]
    if missing:
        raise InputError(
            field=f"{name}, line {reader.line_num}",
            problem=f"no column {', '.join(missing)} in the header",
            remedy=f"the header must name {','.join(required)}, separated by commas, semicolons or tabs",
        )
    for row in reader:
        if not any(cell.strip() for cell in row):
            continue
        where = f"{name}, line {reader.line_num}"
        if len(row) != len(names):
            raise InputError(
                field=where,
                problem=f"{len(row)} cells for {len(names)} columns",
                remedy="write one cell a column; where numbers have decimal commas, separate the columns by semicolons",
            )
        cells = row if separator == "," else [_DECIMAL_COMMA.sub(r"\1.\2", cell) for cell in row]
        yield where, dict(zip(names, cells, strict=True))


def _number(text: str, *, where: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise InputError(field=where, problem=f"{text!r} is not a finite number", remedy="write a decimal number")
    return value


def _sigma(text: str | None, *, where: str) -> float:
    if text is None or not text.strip():
        return math.nan
    value = _number(text, where=where)
    if value <= 0.0:
        raise InputError(field=where, problem=f"{text!r} is not positive", remedy="give the 1-sigma per axis in px")
    return value
