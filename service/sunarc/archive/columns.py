"""Sightings read as columns, without an object per row; cells that are no number are skipped."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any, cast

import numpy as np
from sqlalchemy import BigInteger, ColumnElement, Connection, Subquery, case, func, select, type_coerce

from sunarc.archive import tables
from sunarc.archive.day_air import air_of_days, within_or_nan
from sunarc.archive.tables import sun_point
from sunarc.archive.types import stored_as
from sunarc.archive.values import SunPointColumns
from sunarc.array_types import FloatArray, IntArray, NameArray
from sunarc.sky import PA_PER_HPA, PRESSURE_BOUNDS_PA, TEMPERATURE_BOUNDS_C

_LEVELS = np.dtype([("time", "i8"), ("level", "f8")])
_EXTRAPOLATED_AT_MOST = 100.0
_COLUMNS = np.dtype(
    [
        ("time", "i8"),
        *((name, "f8") for name in ("x", "y", "sigma", "clock", "temperature", "pressure")),
        ("epoch", "i8"),
        ("id", "i8"),
    ]
)
SUN = "sun"
"""The body of most sightings."""
_UNMEASURED = -1e9
"""Stands for NULL while rows are read; no temperature and no pressure."""


def read_columns(
    connection: Connection, camera: str, filters: list[ColumnElement[bool]], *, others: bool = True
) -> SunPointColumns:
    """Return the sightings of a camera that meet the conditions, in the order of their times.

    Without `others` none of them can be of another body than the sun.
    """
    # Few epochs and millions of rows: a row has its epoch's number in the order of time, and no name.
    numbered = _numbered_epochs(camera)
    rows = _numbers(connection, numbered, filters)
    ids = [str(name) for name in connection.scalars(select(numbered.c.id).order_by(numbered.c.number))]
    present, epoch = np.unique(rows["epoch"], return_inverse=True)
    temperature, pressure = _air(connection, camera, rows)
    return SunPointColumns(
        unix_s=rows["time"] / 1e6,
        pixels=np.stack([rows["x"], rows["y"]], axis=-1),
        sigma_px=_nan_for_negative(rows["sigma"]),
        clock_error_s=_nan_for_negative(rows["clock"]),
        epoch=epoch.astype(np.int64),
        epoch_ids=tuple(ids[index] for index in present.tolist()),
        ids=rows["id"].copy(),
        temperature=temperature,
        pressure=pressure,
        body=_bodies(connection, filters, rows["id"]) if others else np.full(rows.size, SUN),
    )


def _bodies(connection: Connection, filters: list[ColumnElement[bool]], ids: IntArray) -> NameArray:
    """Return the names of the bodies of rows (n,): few are not the sun, and only these are read as text."""
    c = sun_point.c
    named = {row.id: row.body for row in connection.execute(select(c.id, c.body).where(*filters, c.body != SUN))}
    return np.array([named.get(key, SUN) for key in ids.tolist()], dtype=np.str_)


def _air(connection: Connection, camera: str, rows: np.ndarray[Any, Any]) -> tuple[FloatArray, FloatArray]:
    """Return temperature (°C) and pressure (Pa), (n,) each: measured with a sighting, else on its day; else NaN."""
    temperature = within_or_nan(rows["temperature"], TEMPERATURE_BOUNDS_C)
    pressure = within_or_nan(PA_PER_HPA * rows["pressure"], PRESSURE_BOUNDS_PA)
    of_day = air_of_days(connection, camera, rows["time"] / 1e6)
    return (
        np.where(np.isnan(temperature), of_day[0], temperature),
        np.where(np.isnan(pressure), of_day[1], pressure),
    )


def _numbered_epochs(camera: str) -> Subquery:
    """Return the ids of a camera's pose epochs, with their numbers in the order of time from 0 on."""
    epochs = tables.pose_epoch.c
    number = func.row_number().over(order_by=(epochs.started_at, epochs.id)) - 1
    return select(epochs.id, number.label("number")).where(epochs.camera == camera).subquery()


def _numbers(connection: Connection, epochs: Subquery, filters: list[ColumnElement[bool]]) -> np.ndarray[Any, Any]:
    c = sun_point.c
    numbers = (
        *(c.time, c.x_px, c.y_px, _number_or(c.sigma_px, -1.0), _number_or(c.clock_error_s, -1.0)),
        *(_number_or(c.temperature_c, _UNMEASURED), _number_or(c.pressure_hpa, _UNMEASURED)),
    )
    sound = [stored_as(c.time, "integer"), *(stored_as(column, "real") for column in (c.x_px, c.y_px))]
    joined = sun_point.join(epochs, c.pose_epoch == epochs.c.id)
    statement = (
        select(*numbers, epochs.c.number, c.id).select_from(joined).where(*filters, *sound).order_by(c.time, c.id)
    )
    result = connection.execute(statement)
    cursor = cast("Iterable[tuple[float, ...]]", result.cursor)
    return np.fromiter(cursor, dtype=_COLUMNS)


def _number_or(column: ColumnElement[Any], otherwise: float) -> ColumnElement[Any]:
    """Return a column's numbers; what a hand wrote there that is none counts as unknown."""
    return case((stored_as(column, "real"), column), else_=otherwise)


def _nan_for_negative(column: np.ndarray[Any, Any]) -> np.ndarray[Any, np.dtype[np.float64]]:
    return np.where(column < 0.0, np.nan, column)


def read_levels(connection: Connection, filters: list[ColumnElement[bool]]) -> tuple[FloatArray, FloatArray]:
    """Return times (unix seconds) and the discs' levels over full scale in 1 µs."""
    c = sun_point.c
    limited = case((c.peak_fraction > _EXTRAPOLATED_AT_MOST, _EXTRAPOLATED_AT_MOST), else_=c.peak_fraction)
    peak = limited - func.coalesce(c.background_fraction, 0.0)
    result = connection.execute(select(c.time, peak / c.exposure_us).where(*filters, c.exposure_us > 0.0, peak > 0.0))
    rows = np.fromiter(cast("Iterable[tuple[float, ...]]", result.cursor), dtype=_LEVELS)
    return rows["time"] / 1e6, rows["level"].copy()


def read_times(connection: Connection, filters: list[ColumnElement[bool]]) -> FloatArray:
    """Return the times of all rows that meet the conditions, s since 1970-01-01 UTC (n,), in no order."""
    c = sun_point.c
    times = select(type_coerce(c.time, BigInteger)).where(*filters, stored_as(c.time, "integer"))
    return np.fromiter(connection.scalars(times), dtype=np.float64) / 1e6
