"""Sightings read as columns, without an object per row, and those that a calibration was given."""

from __future__ import annotations

import hashlib
import zlib
from collections.abc import Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Any, cast

import numpy as np
from sqlalchemy import (
    ARRAY,
    BigInteger,
    ColumnElement,
    Connection,
    Select,
    any_,
    case,
    func,
    insert,
    literal,
    select,
    type_coerce,
    update,
)
from sqlalchemy import cast as sql_cast

from sunarc.calibration.selection import Candidates
from sunarc.common.array_types import FloatArray, IntArray, NameArray
from sunarc.common.errors import InputError, NotFoundError
from sunarc.imager.archive.database import tables
from sunarc.imager.archive.database.tables import calibration, is_number, stored_as, sun_point, used_sightings
from sunarc.imager.archive.days import daily_air, within_or_nan
from sunarc.imager.archive.values import SunPointColumns
from sunarc.sky.night import SUN
from sunarc.sky.site import PA_PER_HPA, PRESSURE_BOUNDS_PA, TEMPERATURE_BOUNDS_C

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
_DECISIVE = np.dtype([("time", "i8"), ("sigma", "f8"), ("clock", "f8"), ("epoch", "i8"), ("id", "i8")])
_UNMEASURED = -1e9
"""Stands for NULL while rows are read; no temperature and no pressure."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CandidateColumns:
    """Columns of the accepted sightings of the sun by which a fit selects, in no order.

    Attributes
    ----------
    candidates : n of them; the numbers of the pose epochs rise with their beginnings.
    epoch_ids : the pose epochs, by number.
    ids : (n,) the rows' keys.
    """

    candidates: Candidates
    epoch_ids: tuple[str, ...]
    ids: IntArray


def read_columns(
    connection: Connection,
    camera: str,
    filters: list[ColumnElement[bool]],
    *,
    others: bool = True,
    placed: bool = True,
) -> SunPointColumns:
    """Return the sightings of a camera that meet the conditions, in the order of their times.

    Without `others` none of them can be of another body than the sun. Without `placed` those whose image shows none
    any more are among them, at no place that means anything.
    """
    rows = _sort_by_time(_read_numbers(connection, filters, placed=placed))
    # few epochs and millions of rows: a row has its epoch's beginning, of which a camera has no two alike, and no name
    epochs = tables.pose_epoch.c
    named = select(_epoch_start_us(epochs.started_at), epochs.id).where(epochs.camera == camera)
    epoch_ids = {int(beginning): str(name) for beginning, name in connection.execute(named)}
    present, epoch = np.unique(rows["epoch"], return_inverse=True)
    temperature, pressure = _read_air(connection, camera, rows)
    return SunPointColumns(
        unix_s=rows["time"] / 1e6,
        pixels=np.stack([rows["x"], rows["y"]], axis=-1),
        sigma_px=_nan_for_negative(rows["sigma"]),
        clock_error_s=_nan_for_negative(rows["clock"]),
        epoch=epoch.astype(np.int64),
        epoch_ids=tuple(epoch_ids[beginning] for beginning in present.tolist()),
        ids=rows["id"].copy(),
        temperature=temperature,
        pressure=pressure,
        body=_read_body_names(connection, filters, rows["id"]) if others else np.full(rows.size, SUN),
    )


def read_candidates(connection: Connection, camera: str, filters: list[ColumnElement[bool]]) -> CandidateColumns:
    """Return the columns by which a fit selects, of a camera's sightings of the sun under the conditions, unordered.

    Half of the time that `read_columns` takes: of millions of sightings a fit uses thousands.
    """
    c, epochs = sun_point.c, tables.pose_epoch.c
    begun = select(epochs.id).where(epochs.camera == camera).order_by(_epoch_start_us(epochs.started_at), epochs.id)
    epoch_ids = tuple(str(name) for name in connection.scalars(begun))
    numbers_of = {name: index for index, name in enumerate(epoch_ids)}
    number = case(numbers_of, value=c.pose_epoch, else_=-1) if numbers_of else literal(-1)
    numbers = (c.time, _number_or(c.sigma_px, -1.0), _number_or(c.clock_error_s, -1.0), number, c.id)
    rows = _fetch_rows(connection, select(*numbers).where(*filters, c.body == SUN, *_sound_row_conditions()), _DECISIVE)
    rows = rows[rows["epoch"] >= 0]
    return CandidateColumns(
        candidates=Candidates(
            unix_s=rows["time"] / 1e6,
            sigma_px=_nan_for_negative(rows["sigma"]),
            clock_error_s=_nan_for_negative(rows["clock"]),
            epoch=rows["epoch"].copy(),
        ),
        epoch_ids=epoch_ids,
        ids=rows["id"].copy(),
    )


def listed(connection: Connection, ids: IntArray) -> ColumnElement[bool]:
    """Return the condition that a sighting's key is one of these: one parameter, however many there are."""
    if connection.dialect.name == "postgresql":
        return sun_point.c.id == any_(sql_cast(ids.tolist(), ARRAY(BigInteger)))
    return sun_point.c.id.in_(select(func.json_each(str(ids.tolist())).table_valued("value").c.value))


def _read_body_names(connection: Connection, filters: list[ColumnElement[bool]], ids: IntArray) -> NameArray:
    """Return the names of the bodies of rows (n,): few are not the sun, and only these are read as text."""
    if ids.size == 0:
        return np.full(0, SUN)
    c = sun_point.c
    named = {row.id: str(row.body) for row in connection.execute(select(c.id, c.body).where(*filters, c.body != SUN))}
    bodies = np.full(ids.size, SUN, dtype=f"U{max(map(len, [SUN, *named.values()]))}")
    rows = np.flatnonzero(np.isin(ids, np.array([*named], dtype=np.int64)))
    bodies[rows] = [named[key] for key in ids[rows].tolist()]
    return bodies


def _read_air(connection: Connection, camera: str, rows: np.ndarray[Any, Any]) -> tuple[FloatArray, FloatArray]:
    """Return temperature (°C) and pressure (Pa), (n,) each: measured with a sighting, else on its day; else NaN."""
    temperature = within_or_nan(rows["temperature"], TEMPERATURE_BOUNDS_C)
    pressure = within_or_nan(PA_PER_HPA * rows["pressure"], PRESSURE_BOUNDS_PA)
    of_day = daily_air(connection, camera, rows["time"] / 1e6)
    return (
        np.where(np.isnan(temperature), of_day[0], temperature),
        np.where(np.isnan(pressure), of_day[1], pressure),
    )


def _read_numbers(connection: Connection, filters: list[ColumnElement[bool]], *, placed: bool) -> np.ndarray[Any, Any]:
    """Return the rows' numbers, in no order: the database would take as long to sort them as to read them."""
    c, epochs = sun_point.c, tables.pose_epoch.c
    place: list[ColumnElement[Any]] = [c.x_px, c.y_px]
    numbers = (
        c.time,
        *(place if placed else [_number_or(column, _UNMEASURED) for column in place]),
        *(_number_or(c.sigma_px, -1.0), _number_or(c.clock_error_s, -1.0)),
        *(_number_or(c.temperature_c, _UNMEASURED), _number_or(c.pressure_hpa, _UNMEASURED)),
    )
    joined = sun_point.join(tables.pose_epoch, (c.pose_epoch == epochs.id) & (c.camera == epochs.camera))
    statement = select(*numbers, _epoch_start_us(epochs.started_at), c.id).select_from(joined)
    return _fetch_rows(connection, statement.where(*filters, *_sound_row_conditions(placed=placed)), _COLUMNS)


def _sound_row_conditions(*, placed: bool = True) -> list[ColumnElement[bool]]:
    """Return the conditions that a row has a time and a place: a hand or a bad disk may have written other values."""
    c = sun_point.c
    return [stored_as(c.time, "integer"), *([is_number(c.x_px), is_number(c.y_px)] if placed else [])]


def _fetch_rows(connection: Connection, statement: Select[Any], columns: np.dtype[np.void]) -> np.ndarray[Any, Any]:
    """Return the rows of a query of numbers, as the driver gives them: without an object for each."""
    return np.fromiter(cast("Iterable[tuple[float, ...]]", connection.execute(statement).cursor), dtype=columns)


def _sort_by_time(rows: np.ndarray[Any, Any]) -> np.ndarray[Any, Any]:
    """Return rows in the order of their times and keys; from an index by time they come so already."""
    if np.all(np.diff(rows["time"]) > 0):
        return rows
    return np.asarray(rows[np.lexsort((rows["id"], rows["time"]))])


def _epoch_start_us(started_at: ColumnElement[Any]) -> ColumnElement[int]:
    """Return the stored beginning of an epoch, µs; a value that is not a number, written by hand, counts as 1970."""
    return case((stored_as(started_at, "integer"), type_coerce(started_at, BigInteger)), else_=0)


def _number_or(column: ColumnElement[Any], otherwise: float) -> ColumnElement[Any]:
    """Return a column's numbers; a value that is not a number, written by hand, counts as unknown."""
    return case((is_number(column), column), else_=otherwise)


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


def sightings_used_by(connection: Connection, calibration_id: str) -> SunPointColumns:
    """Return the sightings that a calibration was given, as they were.

    Raises
    ------
    NotFoundError : nothing was kept for this calibration.
    InputError : they were changed or deleted since.
    """
    row = connection.execute(
        select(used_sightings, calibration.c.camera)
        .join(calibration, calibration.c.id == used_sightings.c.calibration)
        .where(used_sightings.c.calibration == calibration_id)
    ).one_or_none()
    if row is None:
        raise NotFoundError(
            field="id",
            problem=f"no sightings were kept with calibration {calibration_id}",
            remedy="name one that a refit made, see `sunarc calibrations list`",
        )
    try:
        ids, epochs = _unpack_keys(row.ids), [(str(name), int(start)) for name, start in row.epochs]
        air = _unpack_air(row.air, ids.size)
        measured = _unpack_measured(row.sigma, ids.size)
    except (TypeError, ValueError, zlib.error):
        raise _changed_sighting_error(calibration_id, "the list of its sightings is damaged") from None
    whole = measured is not None and len(measured) > 1
    found = read_columns(connection, row.camera, [listed(connection, ids)], placed=not whole)
    if found.ids.size != ids.size:
        raise _changed_sighting_error(
            calibration_id, f"{ids.size - found.ids.size} of its {ids.size} sightings are gone"
        )
    columns = _apply_measured(_restore_former_values(found, epochs, air), measured)
    # Rows of the same keys may have been edited since: the fit would not be the same.
    if _compute_digest(columns) != row.digest:
        raise _changed_sighting_error(calibration_id, "its sightings were changed since")
    return columns


def keep_used(connection: Connection, camera: str, calibration_id: str, columns: SunPointColumns) -> None:
    """Store which sightings a calibration rests on, and their former values where they were changed during its fit."""
    starts = np.searchsorted(columns.epoch, np.arange(len(columns.epoch_ids)))  # epochs follow each other in time
    digest = _compute_digest(columns)
    now = read_columns(connection, camera, [listed(connection, columns.ids)])
    connection.execute(
        insert(used_sightings).values(
            calibration=calibration_id,
            ids=_pack_keys(columns.ids),
            digest=digest,
            epochs=[[name, int(start)] for name, start in zip(columns.epoch_ids, starts, strict=True)],
            air=_pack_air(columns),
            sigma=None if _compute_digest(now) == digest else _pack_measured(columns),
        )
    )


def keep_sigma(connection: Connection, camera: str) -> None:
    """Store with each calibration of a camera the sigma of its sightings, before the sightings' own is changed."""
    c = used_sightings.c
    for row in connection.execute(_select_camera(camera).where(c.sigma.is_(None))).all():
        with suppress(TypeError, ValueError, zlib.error):  # a damaged list cannot be solved again anyway
            found = read_columns(connection, camera, [listed(connection, _unpack_keys(row.ids))])
            kept = update(used_sightings).where(c.calibration == row.calibration)
            connection.execute(kept.values(sigma=_pack_rows(found.sigma_px)))


def keep_measured(connection: Connection, camera: str, changing: Sequence[ColumnElement[bool]]) -> None:
    """Store with calibrations of a camera the measurements of their sightings, before some of these are changed."""
    ids = np.fromiter(connection.scalars(select(sun_point.c.id).where(*changing)), dtype=np.int64)
    if ids.size == 0:
        return
    for row in connection.execute(_select_camera(camera)).all():
        with suppress(InputError, TypeError, ValueError, zlib.error):  # what is damaged cannot be solved again anyway
            if np.isin(ids, _unpack_keys(row.ids)).any():
                measured = _pack_measured(sightings_used_by(connection, row.calibration))
                kept = update(used_sightings).where(used_sightings.c.calibration == row.calibration)
                connection.execute(kept.values(sigma=measured))


def _select_camera(camera: str) -> Select[tuple[str, bytes]]:
    c = used_sightings.c
    used = select(c.calibration, c.ids).join(calibration, calibration.c.id == c.calibration)
    return used.where(calibration.c.camera == camera)


def copy_used(connection: Connection, calibration_id: str, *, to: str) -> None:
    """Store the same sightings as the inputs of a copy of a calibration."""
    row = connection.execute(select(used_sightings).where(used_sightings.c.calibration == calibration_id)).one_or_none()
    if row is not None:
        connection.execute(insert(used_sightings).values({**row._mapping, "calibration": to}))  # noqa: SLF001 - public


def _restore_former_values(found: SunPointColumns, epochs: list[tuple[str, int]], air: FloatArray) -> SunPointColumns:
    """Return sightings in the pose epochs and in the air (2, n) that they had when the calibration was made."""
    starts = np.array([start for _, start in epochs])
    return replace(
        found,
        epoch=np.searchsorted(starts, np.arange(found.ids.size), side="right").astype(np.int64) - 1,
        epoch_ids=tuple(name for name, _ in epochs),
        temperature=air[0],
        pressure=air[1],
    )


def _pack_keys(ids: IntArray) -> bytes:
    """Return keys as steps, compressed: a few thousand take a few kilobytes."""
    # Keys rise by small steps: their differences compress to a few bits each.
    return zlib.compress(np.diff(ids, prepend=0).astype("<i8").tobytes(), 9)


def _unpack_keys(packed: bytes) -> IntArray:
    return np.cumsum(np.frombuffer(zlib.decompress(packed), dtype="<i8")).astype(np.int64)


def _pack_air(columns: SunPointColumns) -> bytes | None:
    """Return temperature and pressure, compressed; None where nothing was measured. A day's is given later, or anew."""
    air = np.stack([columns.temperature, columns.pressure])
    return None if np.all(np.isnan(air)) else _pack_rows(air)


def _unpack_air(packed: bytes | None, count: int) -> FloatArray:
    """Return temperature and pressure, (2, n); NaN where nothing was kept."""
    if packed is None:
        return np.full((2, count), np.nan)
    return _unpack_rows(packed).reshape(2, count)


def _pack_measured(columns: SunPointColumns) -> bytes:
    """Return all that the digest holds but the times: pixels, sigma and the clock's error."""
    return _pack_rows(np.vstack([columns.pixels.T, columns.sigma_px, columns.clock_error_s]))


def _unpack_measured(packed: bytes | None, count: int) -> FloatArray | None:
    """Return sigma (1, n), or x, y, sigma, clock error (4, n), as a calibration was given them; None: as they are."""
    return None if packed is None else _unpack_rows(packed).reshape(-1, count)


def _pack_rows(rows: FloatArray) -> bytes:
    return zlib.compress(rows.astype("<f8").tobytes(), 9)


def _unpack_rows(packed: bytes) -> FloatArray:
    return np.frombuffer(zlib.decompress(packed), dtype="<f8").astype(np.float64)


def _apply_measured(columns: SunPointColumns, measured: FloatArray | None) -> SunPointColumns:
    if measured is None:
        return columns
    if len(measured) == 1:
        return replace(columns, sigma_px=measured[0])
    return replace(columns, pixels=measured[:2].T.copy(), sigma_px=measured[2], clock_error_s=measured[3])


def _compute_digest(columns: SunPointColumns) -> str:
    """Return a digest that changes when a sighting that counted is changed."""
    digest = hashlib.sha256()
    for column in (columns.unix_s, columns.pixels, columns.sigma_px, columns.clock_error_s):
        digest.update(np.ascontiguousarray(column, dtype="<f8").tobytes())
    return digest.hexdigest()


def _changed_sighting_error(calibration_id: str, problem: str) -> InputError:
    return InputError(
        field=f"calibration {calibration_id}",
        problem=problem,
        remedy="take the sightings from a backup (sunarc db backup), or calibrate anew",
    )
