"""CSV files of sightings, directions and pixels; an error names the line and the column."""

from __future__ import annotations

import csv
import itertools
import math
import re
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import replace
from datetime import datetime
from functools import partial
from typing import NamedTuple, TextIO, TypeVar

import numpy as np

from sunarc.calibration.model.sightings import Sightings
from sunarc.common.array_types import FloatArray, IntArray, NameArray
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
_DIRECTION_BOUNDS = (0.0, 180.0), (-360.0, 360.0)


class RowPlaces(NamedTuple):
    """Places of rows for errors: the text before the number of each, and the numbers, (n,)."""

    text: str
    number: IntArray

    def of(self, row: int) -> str:
        """Return the place of a row as text."""
        return f"{self.text} {self.number[row]}"


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
    return name_bodies(points, site, wheres=wheres)


def read_unplaced(lines: Iterable[str], *, name: str) -> tuple[Sightings, RowPlaces]:
    """Read sightings as `read_sightings` does, but bodies by their names have no direction yet; and where each stands.

    They are complete after `name_bodies`.
    """
    parts = [
        _read_to_first_fault(_read_unplaced_rows, part)
        for part in _split_into_parts(lines, name=name, required=_REQUIRED)
    ]
    columns = np.concatenate([np.zeros((0, 9)), *(one.columns for one in parts)])
    epochs = _number_epochs([one.of_camera for one in parts], [one.columns[:, 0] for one in parts], name=name)
    return Sightings.of(
        epoch=epochs,
        unix_s=columns[:, 0],
        pixels=columns[:, 1:3],
        sigma_px=columns[:, 3],
        temperature=columns[:, 4],
        pressure=columns[:, 5],
        clock_error_s=columns[:, 6],
        directions=direction_from_angles(zenith_deg=columns[:, 7], azimuth_deg=columns[:, 8]),
        body=np.concatenate([np.zeros(0, dtype=np.str_), *(one.body for one in parts)]),
    ), RowPlaces(f"{name}, line", np.concatenate([np.zeros(0, dtype=np.int64), *(one.line for one in parts)]))


class _UnplacedRows(NamedTuple):
    """Some rows of sightings: line (n,); columns (n, 9): time, x, y, sigma, air, clock's error and angles.

    body (n,), of_camera: the camera and the epoch of each row, those alone that differ where all are alike.
    """

    line: IntArray
    columns: FloatArray
    body: NameArray
    of_camera: list[tuple[str, str]]


def _read_unplaced_rows(part: _CsvRows) -> _UnplacedRows:
    """Return the sightings of some rows."""
    zenith, azimuth = (part.within(*one) for one in zip(_DIRECTION_COLUMNS, _DIRECTION_BOUNDS, strict=True))
    alone = np.flatnonzero(np.isnan(zenith) != np.isnan(azimuth))
    if alone.size:
        missing = _DIRECTION_COLUMNS[0 if math.isnan(zenith[alone[0]]) else 1]
        where = part.where(int(alone[0]), missing)
        raise InputError(field=where, problem="is empty beside the other angle", remedy="give both")
    columns = (
        part.times("time_utc"),
        part.numbers("x_px"),
        part.numbers("y_px"),
        part.read("sigma_px", _parse_sigma),
        part.within(_AIR_COLUMNS[0], TEMPERATURE_BOUNDS_C),
        PA_PER_HPA * part.within(_AIR_COLUMNS[1], PRESSURE_BOUNDS_HPA),
        part.within("clock_error_s", _CLOCK_BOUNDS_S),
        zenith,
        azimuth,
    )
    body = part.cells.get("body")
    names = np.full(len(part.line), SUN) if body is None else np.array([one.strip() or SUN for one in body])
    camera, epoch = (part.cells.get(name) or [""] for name in ("camera", "epoch"))
    n = max(len(camera), len(epoch))
    of_camera = list(zip(camera * (n // len(camera)), epoch * (n // len(epoch)), strict=True))
    return _UnplacedRows(part.line, np.stack(columns, axis=-1), names, of_camera)


def name_bodies(points: Sightings, site: Site | None, *, wheres: RowPlaces) -> Sightings:
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
            field=f"{wheres.of(row)}, body",
            problem=f"{str(points.body[row])!r} is not known",
            remedy="give its zenith_deg and azimuth_deg, or sun sightings",
        )
    directions = np.array(points.directions)
    directions[named] = found
    return replace(points, directions=directions)


def _number_epochs(of_parts: Sequence[list[tuple[str, str]]], unix_s: Sequence[FloatArray], *, name: str) -> IntArray:
    """Return the pose epochs (n,) of rows in the order of their first times (of each part, (n,)).

    InputError where the rows are of several cameras.
    """
    n = sum(one.size for one in unix_s)
    cameras = sorted({camera for part in of_parts for camera, _ in part})
    if len(cameras) > 1:
        raise InputError(
            field=f"{name}, camera",
            problem=f"has rows of {len(cameras)} cameras: {', '.join(cameras[:3])}",
            remedy="give the rows of one camera",
        )
    if cameras in ([], [""]):
        return np.zeros(n, dtype=np.int64)
    of_rows = [
        np.broadcast_to([epoch for _, epoch in part], time.size) for part, time in zip(of_parts, unix_s, strict=True)
    ]
    names, of_row = np.unique(np.concatenate(of_rows), return_inverse=True)
    begins = np.full(names.size, np.inf)
    np.minimum.at(begins, of_row, np.concatenate(unix_s))
    order = np.argsort(begins, kind="stable")  # as text "10" stands before "2"
    return np.argsort(order)[of_row].astype(np.int64)


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
            cells += [_format_cell(air[0][count], places=3), _format_cell(air[1][count] / PA_PER_HPA, places=3)]
        cells += [_format_cell(column[count], places=6) for column in angles]
        writer.writerow(cells)
        count += 1
    return count


def read_pairs(lines: Iterable[str], *, columns: tuple[str, str], name: str) -> FloatArray:
    """Read two columns of numbers, (n, 2); `InputError` names line and column."""

    def read_both(part: _CsvRows) -> FloatArray:
        return np.stack([part.numbers(column) for column in columns], axis=-1)

    parts = _split_into_parts(lines, name=name, required=columns)
    return np.concatenate([np.zeros((0, 2)), *(_read_to_first_fault(read_both, part) for part in parts)])


def write_columns(target: TextIO, columns: dict[str, FloatArray], *, places: dict[str, int]) -> None:
    """Write columns of numbers with so many decimal places; NaN is an empty cell."""
    writer = csv.writer(target, lineterminator="\n")
    writer.writerow(columns)
    for row in zip(*columns.values(), strict=True):
        writer.writerow(_format_cell(value, places=places[column]) for column, value in zip(columns, row, strict=True))


def _format_cell(value: float, *, places: int) -> str:
    return "" if math.isnan(value) else f"{value:.{places}f}"


_ROWS = 20_000
"""Rows that are read together: enough to be quick, few enough to take little memory."""
_UTC = re.compile(r"\d{4}-\d\d-\d\d[T ]\d\d:\d\d:\d\d(\.\d{1,6})?Z")


_Read = TypeVar("_Read")


class _CsvRows(NamedTuple):
    """Some rows of a file: its name; the line of each, (n,); the cells of each column."""

    name: str
    line: IntArray
    cells: dict[str, list[str]]

    def row(self, row: int) -> _CsvRows:
        """Return one row."""
        return _CsvRows(
            self.name, self.line[row : row + 1], {key: cells[row : row + 1] for key, cells in self.cells.items()}
        )

    def where(self, row: int, column: str) -> str:
        """Return the place of a cell as text."""
        return f"{self.name}, line {self.line[row]}, {column}"

    def read(self, column: str, read: Callable[..., float]) -> FloatArray:
        """Return the values (n,) that a function reads from the cells and their places; NaN without the column."""
        cells = self.cells.get(column)
        if cells is None:
            return np.full(self.line.size, np.nan)
        return np.array([read(cell, where=self.where(row, column)) for row, cell in enumerate(cells)], dtype=np.float64)

    def numbers(self, column: str) -> FloatArray:
        """Return a column of finite numbers, (n,)."""
        try:
            values = np.fromiter(map(float, self.cells[column]), np.float64, self.line.size)
        except ValueError:
            return self.read(column, _parse_finite)
        return values if np.all(np.isfinite(values)) else self.read(column, _parse_finite)

    def within(self, column: str, bounds: tuple[float, float]) -> FloatArray:
        """Return a column of numbers within bounds, (n,); NaN where a cell is empty, and without the column."""
        return self.read(column, partial(_parse_bounded, bounds=bounds))

    def times(self, column: str) -> FloatArray:
        """Return a column of times, (n,), seconds since 1970-01-01 UTC."""
        cells = self.cells[column]
        if all(map(_UTC.fullmatch, cells)):  # the usual form, which numpy reads by itself
            try:
                microseconds = np.array([cell[:-1] for cell in cells], dtype="datetime64[us]").astype(np.int64)
            except ValueError:
                return self.read(column, _parse_unix_s)
            return np.asarray(microseconds / 1e6)
        return self.read(column, _parse_unix_s)


def _parse_unix_s(text: str, *, where: str) -> float:
    return parse_time(text, where=where).timestamp()


def _split_into_parts(lines: Iterable[str], *, name: str, required: Sequence[str]) -> Iterator[_CsvRows]:
    """Yield the rows some at a time; columns are separated as in the header, by commas, semicolons or tabs.

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
    rows = ((reader.line_num, row) for row in reader if any(cell.strip() for cell in row))
    while some := list(itertools.islice(rows, _ROWS)):
        whole = list(itertools.takewhile(lambda item: len(item[1]) == len(names), some))
        columns = [list(column) for column in zip(*(row for _, row in whole), strict=True)]
        if separator != ",":
            columns = [[_DECIMAL_COMMA.sub(r"\1.\2", cell) for cell in column] for column in columns]
        if whole:
            numbers = np.fromiter((number for number, _ in whole), np.int64, len(whole))
            yield _CsvRows(name, numbers, dict(zip(names, columns, strict=True)))
        if len(whole) < len(some):
            number, row = some[len(whole)]
            raise InputError(
                field=f"{name}, line {number}",
                problem=f"{len(row)} cells for {len(names)} columns",
                remedy="write one cell a column; where numbers have decimal commas, separate the columns by semicolons",
            )


def _read_to_first_fault(read: Callable[[_CsvRows], _Read], part: _CsvRows) -> _Read:
    """Return the values that a function reads from rows; InputError names the first row that is at fault."""
    try:
        return read(part)
    except InputError:
        for row in range(part.line.size):
            read(part.row(row))
        raise


def _parse_finite(text: str, *, where: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise InputError(field=where, problem=f"{text!r} is not a finite number", remedy="write a decimal number")
    return value


def _parse_sigma(text: str, *, where: str) -> float:
    if not text.strip():
        return math.nan
    value = _parse_finite(text, where=where)
    if value <= 0.0:
        raise InputError(field=where, problem=f"{text!r} is not positive", remedy="give the 1-sigma per axis in px")
    return value


def _parse_bounded(text: str, *, bounds: tuple[float, float], where: str) -> float:
    """Return a number within limits; NaN for an empty cell."""
    if not text.strip():
        return math.nan
    (low, high), value = bounds, _parse_finite(text, where=where)
    if not low <= value <= high:
        raise InputError(field=where, problem=f"{value:g} is not within {low:g} to {high:g}", remedy="correct the cell")
    return value
