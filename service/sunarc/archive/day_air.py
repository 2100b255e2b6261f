"""The measured air of solar days, for the refraction of their sightings and of the sun's predicted position."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from datetime import date, datetime

import numpy as np
from sqlalchemy import Connection, delete, select

from sunarc.archive.rows import upsert
from sunarc.archive.store import Store, given, values_of
from sunarc.archive.tables import camera as cameras
from sunarc.archive.tables import day_air
from sunarc.archive.values import DayAir, SunPoint
from sunarc.array_types import FloatArray
from sunarc.errors import InputError, NotFoundError
from sunarc.sky.days import day_of_date, solar_date, solar_days
from sunarc.sky.site import PA_PER_HPA, PRESSURE_BOUNDS_HPA, PRESSURE_BOUNDS_PA, TEMPERATURE_BOUNDS_C, Site


class MeasuredAir(Store):
    """The part of the archive with the measured air of days."""

    def set_day_air(self, air: DayAir) -> DayAir:
        """Write a day's air in place of an earlier one, and return what is kept; with neither value, remove it.

        The same values again change nothing, `set_at` included.

        Raises
        ------
        InputError : a value is out of bounds.
        NotFoundError : the archive does not know the camera.
        """
        _require_within("temperature_c", air.temperature_c, TEMPERATURE_BOUNDS_C)
        _require_within("pressure_hpa", air.pressure_hpa, PRESSURE_BOUNDS_HPA)
        c = day_air.c
        this = (c.camera == air.camera, c.date == air.date)
        with self._writing() as connection:
            if connection.scalar(select(cameras.c.name).where(cameras.c.name == air.camera)) is None:
                raise NotFoundError(
                    field="camera",
                    problem=f"the archive has no camera {air.camera}",
                    remedy="wait until it has answered once, or import sightings of it",
                )
            stored = values_of(connection, select(day_air).where(*this), DayAir)
            if stored and _values(stored[0]) == _values(air):
                return stored[0]
            if _values(air) == (None, None):
                connection.execute(delete(day_air).where(*this))
            else:
                upsert(connection, day_air, asdict(air), key=["camera", "date"])
        return air

    def day_air(self, camera: str, *, since: date | None = None, until: date | None = None) -> tuple[DayAir, ...]:
        """Return the measured air of the days with `since` <= date < `until`, the first one first."""
        with self._reading() as connection:
            return _read(connection, camera, since=since, until=until)

    def air_of(self, camera: str, points: Sequence[SunPoint]) -> tuple[FloatArray, FloatArray]:
        """Return temperature (°C) and pressure (Pa) at sightings, (n,) each: their own, else their day's, else NaN."""
        unix_s = np.array([point.time.timestamp() for point in points], dtype=np.float64)
        with self._reading() as connection:
            of_day = air_of_days(connection, camera, unix_s)
        measured = _numbers(points)
        temperature, pressure = (np.where(np.isnan(own), day, own) for own, day in zip(measured, of_day, strict=True))
        return temperature, pressure

    def site_on(self, camera: str, site: Site, day: date) -> Site:
        """Return a camera's site in the measured air of a solar day; in the site's own where nothing was measured."""
        with self._reading() as connection:
            found = values_of(
                connection, select(day_air).where(day_air.c.camera == camera, day_air.c.date == day), DayAir
            )
        if not found:
            return site
        temperature, pressure = _numbers(found)
        return site.with_air(temperature=_or_none(temperature[0]), pressure=_or_none(pressure[0]))

    def site_at(self, camera: str, site: Site, time: datetime) -> Site:
        """Return a camera's site in the measured air of the solar day of a moment, as `site_on`."""
        return self.site_on(camera, site, solar_date(time.timestamp(), longitude=site.longitude))


def air_of_days(connection: Connection, camera: str, unix_s: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return temperature (°C) and pressure (Pa) of the solar days of times (n,), (n,) each; NaN where not measured."""
    unknown = np.full((2, unix_s.size), np.nan)
    longitude = connection.scalar(select(cameras.c.longitude).where(cameras.c.name == camera))
    of_days = _read(connection, camera) if unix_s.size else ()
    if not of_days or longitude is None:
        return unknown[0], unknown[1]
    day = solar_days(unix_s, longitude=longitude)
    days = np.array([day_of_date(air.date) for air in of_days])
    # A day after the last known one would be beyond the end; it differs from the last, and is NaN below.
    index = np.minimum(np.searchsorted(days, day), days.size - 1)
    temperature, pressure = _numbers(of_days)
    is_measured = days[index] == day
    return np.where(is_measured, temperature[index], np.nan), np.where(is_measured, pressure[index], np.nan)


def within_or_nan(values: FloatArray, bounds: tuple[float, float]) -> FloatArray:
    """Return values (n,), NaN for those out of bounds: what was written by hand must not stop a fit."""
    return np.where((values >= bounds[0]) & (values <= bounds[1]), values, np.nan)


def _read(
    connection: Connection, camera: str, *, since: date | None = None, until: date | None = None
) -> tuple[DayAir, ...]:
    c = day_air.c
    filters = given((c.camera.__eq__, camera), (c.date.__ge__, since), (c.date.__lt__, until))
    return values_of(connection, select(day_air).where(*filters).order_by(c.date), DayAir)


def _numbers(measured: Sequence[DayAir | SunPoint]) -> tuple[FloatArray, FloatArray]:
    """Return temperature (°C) and pressure (Pa), (n,) each; NaN where not measured."""
    numbers = np.array(
        [(_number(air.temperature_c), _number(air.pressure_hpa)) for air in measured], dtype=np.float64
    ).reshape(-1, 2)
    temperature = within_or_nan(numbers[:, 0], TEMPERATURE_BOUNDS_C)
    return temperature, within_or_nan(PA_PER_HPA * numbers[:, 1], PRESSURE_BOUNDS_PA)


def _number(value: object) -> float:
    return float(value) if isinstance(value, int | float) else np.nan


def _or_none(value: float) -> float | None:
    return None if np.isnan(value) else float(value)


def _values(air: DayAir) -> tuple[float | None, float | None]:
    return air.temperature_c, air.pressure_hpa


def _require_within(field: str, value: float | None, bounds: tuple[float, float]) -> None:
    low, high = bounds
    if value is not None and not low <= value <= high:  # NaN is not
        raise InputError(
            field=field, problem=f"{value:g} is not within {low:g} to {high:g}", remedy="give °C and hPa, or null"
        )
