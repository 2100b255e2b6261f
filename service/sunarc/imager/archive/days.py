"""Days and nights: the air that was measured, counts of sightings, verdicts of nights, images of the present one."""

from __future__ import annotations

import logging
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from datetime import date, datetime
from functools import partial
from typing import Any, Literal

import numpy as np
from pydantic import TypeAdapter, ValidationError
from sqlalchemy import Connection, RowMapping, delete, func, select, update

from sunarc.common.array_types import FloatArray
from sunarc.common.errors import InputError, NotFoundError
from sunarc.common.findings import Finding, from_json
from sunarc.imager.archive.database import tables
from sunarc.imager.archive.database.store import Part, given, read_records, upsert
from sunarc.imager.archive.database.tables import camera as cameras
from sunarc.imager.archive.database.tables import day, day_air, night_image
from sunarc.imager.archive.events import insert_event, log_event
from sunarc.imager.archive.values import Day, DayAir, Event, Night, SunPoint, field_values, unusable_night
from sunarc.sky.days import date_to_day, solar_date, solar_days
from sunarc.sky.site import PA_PER_HPA, PRESSURE_BOUNDS_HPA, PRESSURE_BOUNDS_PA, TEMPERATURE_BOUNDS_C, Site


class DayStore(Part):
    """The solar days: their verdicts, and the air that was measured on them."""

    def set_air(self, air: DayAir) -> DayAir:
        """Write a day's air in place of an earlier one, and return the stored one; with neither value, remove it.

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
        with self._database.writing() as connection:
            if connection.scalar(select(cameras.c.name).where(cameras.c.name == air.camera)) is None:
                raise NotFoundError(
                    field="camera",
                    problem=f"the archive has no camera {air.camera}",
                    remedy="wait until it has answered once, or import sightings of it",
                )
            stored = read_records(connection, select(day_air).where(*this), DayAir)
            if stored and _get_air_values(stored[0]) == _get_air_values(air):
                return stored[0]
            if _get_air_values(air) == (None, None):
                connection.execute(delete(day_air).where(*this))
            else:
                upsert(connection, day_air, field_values(air), key=["camera", "date"])
        return air

    def air(self, camera: str, *, since: date | None = None, until: date | None = None) -> tuple[DayAir, ...]:
        """Return the measured air of the days with `since` <= date < `until`, the first one first."""
        with self._database.reading() as connection:
            return _read_air(connection, camera, since=since, until=until)

    def sighting_air(self, camera: str, points: Sequence[SunPoint]) -> tuple[FloatArray, FloatArray]:
        """Return temperature (°C) and pressure (Pa) at sightings, (n,) each: their own, else their day's, else NaN."""
        unix_s = np.array([point.time.timestamp() for point in points], dtype=np.float64)
        with self._database.reading() as connection:
            of_day = daily_air(connection, camera, unix_s)
        measured = _make_air_arrays(points)
        temperature, pressure = (np.where(np.isnan(own), day, own) for own, day in zip(measured, of_day, strict=True))
        return temperature, pressure

    def site_in_measured_air(self, camera: str, site: Site, day: date) -> Site:
        """Return a camera's site with the measured air of a solar day; with its own where nothing was measured."""
        with self._database.reading() as connection:
            found = read_records(
                connection, select(day_air).where(day_air.c.camera == camera, day_air.c.date == day), DayAir
            )
        if not found:
            return site
        temperature, pressure = _make_air_arrays(found)
        return site.replace_air(temperature=_none_for_nan(temperature[0]), pressure=_none_for_nan(pressure[0]))

    def site_with_air_at(self, camera: str, site: Site, time: datetime) -> Site:
        """Return a camera's site in the measured air of the solar day of a moment, as `site_in_measured_air`."""
        return self.site_in_measured_air(camera, site, solar_date(time.timestamp(), longitude=site.longitude))

    def count(self, camera: str) -> Mapping[str, int]:
        """Return how many days have each verdict."""
        return self._database.counts(select(day.c.verdict, func.count()).where(day.c.camera == camera), day.c.verdict)

    def save(self, day: Day) -> None:
        """Write a day's verdict, in place of an earlier one."""
        with self._database.writing() as connection:
            upsert(connection, tables.day, field_values(day), key=["camera", "date"])

    def find(
        self, camera: str, *, since: date | None = None, until: date | None = None, limit: int | None = None
    ) -> tuple[Day, ...]:
        """Return the days with `since` <= date < `until` that have a verdict, the newest first."""
        c = tables.day.c
        filters = given((c.camera.__eq__, camera), (c.date.__ge__, since), (c.date.__lt__, until))
        return self._database.records(select(tables.day).where(*filters).order_by(c.date.desc()).limit(limit), Day)


def daily_air(connection: Connection, camera: str, unix_s: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return temperature (°C) and pressure (Pa) of the solar days of times (n,), (n,) each; NaN where not measured."""
    unknown = np.full((2, unix_s.size), np.nan)
    longitude = connection.scalar(select(cameras.c.longitude).where(cameras.c.name == camera))
    of_days = _read_air(connection, camera) if unix_s.size else ()
    if not of_days or longitude is None:
        return unknown[0], unknown[1]
    day = solar_days(unix_s, longitude=longitude)
    days = np.array([date_to_day(air.date) for air in of_days])
    # A day after the last known one would be beyond the end; it differs from the last, and is NaN below.
    index = np.minimum(np.searchsorted(days, day), days.size - 1)
    temperature, pressure = _make_air_arrays(of_days)
    is_measured = days[index] == day
    return np.where(is_measured, temperature[index], np.nan), np.where(is_measured, pressure[index], np.nan)


def within_or_nan(values: FloatArray, bounds: tuple[float, float]) -> FloatArray:
    """Return values (n,), with NaN for those out of bounds, so that a value written by hand does not stop a fit."""
    return np.where((values >= bounds[0]) & (values <= bounds[1]), values, np.nan)


def _read_air(
    connection: Connection, camera: str, *, since: date | None = None, until: date | None = None
) -> tuple[DayAir, ...]:
    c = day_air.c
    filters = given((c.camera.__eq__, camera), (c.date.__ge__, since), (c.date.__lt__, until))
    return read_records(connection, select(day_air).where(*filters).order_by(c.date), DayAir)


def _make_air_arrays(measured: Sequence[DayAir | SunPoint]) -> tuple[FloatArray, FloatArray]:
    """Return temperature (°C) and pressure (Pa), (n,) each; NaN where not measured."""
    numbers = np.array(
        [(_number_or_nan(air.temperature_c), _number_or_nan(air.pressure_hpa)) for air in measured], dtype=np.float64
    ).reshape(-1, 2)
    temperature = within_or_nan(numbers[:, 0], TEMPERATURE_BOUNDS_C)
    return temperature, within_or_nan(PA_PER_HPA * numbers[:, 1], PRESSURE_BOUNDS_PA)


def _number_or_nan(value: object) -> float:
    return float(value) if isinstance(value, int | float) else np.nan


def _none_for_nan(value: float) -> float | None:
    return None if np.isnan(value) else float(value)


def _get_air_values(air: DayAir) -> tuple[float | None, float | None]:
    return air.temperature_c, air.pressure_hpa


def _require_within(field: str, value: float | None, bounds: tuple[float, float]) -> None:
    low, high = bounds
    if value is not None and not low <= value <= high:  # NaN is not
        raise InputError(
            field=field, problem=f"{value:g} is not within {low:g} to {high:g}", remedy="give °C and hPa, or null"
        )


_log = logging.getLogger(__name__)

NightImageKind = Literal["stars", "moon"]


@dataclass(frozen=True, slots=True, kw_only=True)
class NightImage:
    """An image of the night without its pixels.

    Attributes
    ----------
    time, kind : middle of the exposure; whether its stars or its moon were looked for.
    exposure_us, gain_db, pixel_format, full_scale, binning : of the frame.
    width, height : of the frame, px.
    serial : of the camera.
    clock_error_s : bound of the error of `time` when the image was taken, seconds.
    halo : light about the bright stars; None without.
    digest : checksum of the frame's counts.
    n_repeated : frames of the night until then that were the one before once more.
    measured : arrays in NumPy's npz.
    picture : JPEG of the best image until then; None where a former one is better.
    """

    time: datetime
    kind: NightImageKind
    exposure_us: float
    gain_db: float
    pixel_format: str
    full_scale: int
    width: int
    height: int
    binning: int
    serial: str
    clock_error_s: float
    measured: bytes
    halo: float | None = None
    digest: int = 0
    n_repeated: int = 0
    picture: bytes | None = None


_NIGHT = TypeAdapter(Night)
_COLUMNS = [column for column in night_image.c if column.name not in {"camera", "n_tries"}]


class NightStore(Part):
    """The nights: their verdicts, and the images of those that have none yet."""

    def add_image(self, camera: str, image: NightImage, *, keep_since: datetime) -> None:
        """Store an image of the night, and remove those of its kind from before `keep_since`."""
        c = night_image.c
        row = {"camera": camera, "n_tries": 0, **field_values(image)}
        with self._database.writing(camera=camera) as connection:
            upsert(connection, night_image, row, key=["camera", "time", "kind"])
            connection.execute(delete(night_image).where(c.camera == camera, c.kind == image.kind, c.time < keep_since))

    def images(self, camera: str) -> tuple[NightImage, ...]:
        """Return the images of a camera's nights without a verdict, the oldest first."""
        c = night_image.c
        return self._database.records(select(*_COLUMNS).where(c.camera == camera).order_by(c.time, c.kind), NightImage)

    def begin_verdict(self, camera: str) -> int:
        """Count that the verdict of the stored images is begun, and return how often it was, this time included."""
        c = night_image.c
        with self._database.writing(camera=camera) as connection:
            connection.execute(update(night_image).where(c.camera == camera).values(n_tries=c.n_tries + 1))
            tries = select(func.max(c.n_tries)).where(c.camera == camera)
            return int(connection.scalar(tries) or 0)

    def save(self, night: Night, *, event: Event | None = None, drops_images: bool = False) -> None:
        """Write a night's verdict in place of an earlier one, with its event: both, or neither.

        Parameters
        ----------
        night : judged.
        event : entry of /v1/events.
        drops_images : whether the stored images were those of this night, and are removed.
        """
        with self._database.writing() as connection:
            upsert(connection, tables.night, night_columns(night), key=["camera", "date"])
            stored = None if event is None else insert_event(connection, event)
            if drops_images:
                _drop_images(connection, night.camera)
        if stored is not None:
            log_event(stored)

    def drop_images(self, camera: str) -> None:
        """Remove the images of a night that gets no verdict."""
        with self._database.writing() as connection:
            _drop_images(connection, camera)

    def find(
        self,
        camera: str,
        *,
        since: datetime | None = None,
        until: datetime | None = None,
        limit: int | None = None,
    ) -> tuple[Night, ...]:
        """Return the nights that were judged at `since` <= time < `until`, the newest first.

        One that lacks a value is `unusable`, with the finding `night_damaged`; one whose date cannot be read is left
        out, and logged.
        """
        c = tables.night.c
        filters = given((c.camera.__eq__, camera), (c.decided_at.__ge__, since), (c.decided_at.__lt__, until))
        statement = select(tables.night).where(*filters).order_by(c.decided_at.desc(), c.date.desc()).limit(limit)
        with self._database.reading() as connection:
            rows = connection.execute(statement).mappings().all()
        return tuple(night for night in map(_make_night, rows) if night is not None)


def _drop_images(connection: Connection, camera: str) -> None:
    connection.execute(delete(night_image).where(night_image.c.camera == camera))


def night_columns(night: Night) -> dict[str, Any]:
    """Return the columns of a night."""
    return {one.name: getattr(night, one.name) for one in fields(night)}


def _make_night(row: RowMapping) -> Night | None:
    """Return the night of a row; None without a date or a time."""
    lacking = next((column.key for column in tables.night.c if not column.nullable and row[column.key] is None), None)
    if lacking is None:
        return Night(**row)
    _log.warning("a night of %s is damaged: its %s cannot be read", row["camera"], lacking)
    if row["date"] is None or row["decided_at"] is None:
        return None
    why = Finding("night_damaged", {"field": lacking})
    return unusable_night(
        row["camera"], row["date"], findings=(why,), decided_at=row["decided_at"], n_images=row["n_images"] or 0
    )


def event_night(camera: str, time: datetime, details: Mapping[str, Any]) -> Night | None:
    """Return the night that the event of an imager before revision 0017 is of; None where it names none.

    What such an event leaves out is not known, or 0 of what is counted; without its images the night is damaged.

    Parameters
    ----------
    camera, time, details : of the event; its details.
    """
    if not {"date", "verdict"} <= details.keys():
        return None
    listed = details.get("findings")
    try:
        evening = date.fromisoformat(str(details["date"]))
    except ValueError:
        return None
    of_night = partial(unusable_night, camera, evening, decided_at=time)
    blank = night_columns(of_night(findings=(), n_images=0))
    values = (
        blank
        | {name: value for name, value in details.items() if name in blank}
        | {"n_images": details.get("n_images")}
    )
    why = tuple(from_json(one) for one in listed) if isinstance(listed, list) else ()
    try:
        return _NIGHT.validate_python(values | {"findings": why})
    except ValidationError as error:
        damaged = Finding("night_damaged", {"field": str(error.errors()[0]["loc"][0])})
        return of_night(findings=(damaged,), n_images=0)
