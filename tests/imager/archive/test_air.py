"""The measured air of days: kept, bounded, and part of what a fit and its reproduction are given."""

from __future__ import annotations

import io
import sqlite3
from contextlib import closing
from dataclasses import replace
from datetime import UTC, date, datetime, timedelta
from typing import TYPE_CHECKING

import numpy as np
import pytest
from tests.fixtures.stores import NOON

from sunarc.common.errors import InputError, NotFoundError
from sunarc.formats.csv_files import read_sightings, write_sightings
from sunarc.imager.archive.database.schema import downgrade, upgrade
from sunarc.imager.archive.values import DayAir, SunPoint
from sunarc.sky.site import Site

from .test_calibrations import document

if TYPE_CHECKING:
    from pathlib import Path

    from sunarc.imager.archive.archive import Archive

SITE = Site(latitude=36.604, longitude=-97.485, altitude=318.0)
WARM = DayAir(camera="roof", date=NOON.date(), temperature_c=35.0, pressure_hpa=975.0, set_at=NOON)


def point(time: datetime, *, temperature_c: float | None = None, pressure_hpa: float | None = None) -> SunPoint:
    return SunPoint(
        camera="roof", pose_epoch="roof-1", time=time, method="import", accepted=True, verdict="clear", x_px=500.0,
        y_px=900.0, temperature_c=temperature_c, pressure_hpa=pressure_hpa,
    )  # fmt: skip


def test_a_days_air_is_kept_replaced_and_removed(archive: Archive) -> None:
    later = replace(WARM, set_at=NOON + timedelta(days=1))
    assert archive.days.set_air(WARM) == WARM
    assert archive.days.set_air(later) == WARM, "the same again changes nothing"
    cooler = replace(later, temperature_c=20.0, pressure_hpa=None)
    assert archive.days.set_air(cooler) == cooler
    assert archive.days.air("roof") == (cooler,)
    archive.days.set_air(replace(later, temperature_c=None, pressure_hpa=None))
    assert archive.days.air("roof") == ()


@pytest.mark.parametrize(
    ("field", "accepted", "refused"),
    [
        ("temperature_c", (-60.0, 60.0), (-60.1, 60.1, np.nan, np.inf)),
        ("pressure_hpa", (300.0, 1100.0), (299.9, 1100.1, np.nan)),
    ],
)
def test_air_out_of_bounds_is_refused(
    archive: Archive, field: str, accepted: tuple[float, ...], refused: tuple[float, ...]
) -> None:
    def warm(value: float) -> DayAir:
        return replace(WARM, temperature_c=value) if field == "temperature_c" else replace(WARM, pressure_hpa=value)

    for value in accepted:
        assert getattr(archive.days.set_air(warm(value)), field) == value
    for value in refused:
        with pytest.raises(InputError, check=lambda error: error.field == field):
            archive.days.set_air(warm(value))


def test_air_of_an_unknown_camera_is_refused(archive: Archive) -> None:
    with pytest.raises(NotFoundError, check=lambda error: error.field == "camera"):
        archive.days.set_air(replace(WARM, camera="cellar"))


def test_sightings_carry_the_air_of_their_solar_day_and_their_own_comes_first(archive: Archive) -> None:
    first = datetime(2013, 5, 13, tzinfo=UTC) + timedelta(hours=97.485 / 15.0)  # local mean midnight
    second = timedelta(seconds=2)
    times = (
        first - second,
        first + second,
        NOON,
        first + timedelta(days=1) - second,
        first + timedelta(days=1, seconds=2),
    )
    archive.sightings.add(point(time, temperature_c=30.0 if time == NOON else None) for time in times)
    archive.days.set_air(WARM)
    columns = archive.sightings.columns("roof")
    assert columns.temperature.tolist() == pytest.approx([np.nan, 35.0, 30.0, 35.0, np.nan], nan_ok=True)
    assert columns.pressure.tolist() == pytest.approx([np.nan, 97_500.0, 97_500.0, 97_500.0, np.nan], nan_ok=True)
    picked = columns.select(np.array([1, 2]))
    assert picked.temperature.tolist() == [35.0, 30.0]


def test_the_site_of_a_day_is_in_its_air(archive: Archive) -> None:
    archive.days.set_air(replace(WARM, pressure_hpa=None))
    warm = archive.days.site_with_air_at("roof", SITE, NOON)
    assert warm == replace(SITE, temperature=35.0)
    assert archive.days.site_with_air_at("roof", SITE, NOON + timedelta(days=1)) == SITE
    assert archive.days.site_in_measured_air("roof", SITE, NOON.date()) == warm


def test_a_calibration_is_reproduced_in_the_air_that_it_was_made_with(archive: Archive) -> None:
    archive.sightings.add(point(NOON + timedelta(minutes=n)) for n in range(20))
    archive.days.set_air(WARM)
    archive.calibrations.add(document("warm"), used=archive.sightings.columns("roof"))
    archive.days.set_air(replace(WARM, temperature_c=None, pressure_hpa=None))
    archive.calibrations.add(document("assumed"), used=archive.sightings.columns("roof"))
    archive.days.set_air(replace(WARM, temperature_c=-5.0))
    warm, assumed = archive.calibrations.sightings_given_to("warm"), archive.calibrations.sightings_given_to("assumed")
    assert set(warm.temperature.tolist()) == {35.0}
    assert set(warm.pressure.tolist()) == {97_500.0}
    assert np.all(np.isnan(assumed.temperature))


def test_a_damaged_air_of_a_calibration_is_named(archive: Archive, path: Path) -> None:
    archive.sightings.add([point(NOON)])
    archive.days.set_air(WARM)
    archive.calibrations.add(document("a"), used=archive.sightings.columns("roof"))
    with closing(sqlite3.connect(path)) as connection, connection:
        connection.execute("UPDATE used_sightings SET air = x'00'")
    with pytest.raises(InputError, match="damaged"):
        archive.calibrations.sightings_given_to("a")


def test_what_was_written_by_hand_and_is_no_air_counts_as_not_measured(archive: Archive, path: Path) -> None:
    archive.sightings.add([point(NOON, temperature_c=30.0), point(NOON + timedelta(days=1))])
    archive.days.set_air(WARM)
    with closing(sqlite3.connect(path)) as connection, connection:
        connection.execute("UPDATE sun_point SET temperature_c = 'warm', pressure_hpa = 3")
        connection.execute("UPDATE day_air SET temperature_c = 400, pressure_hpa = 'high'")
    columns = archive.sightings.columns("roof")
    assert np.all(np.isnan(columns.temperature))
    assert np.all(np.isnan(columns.pressure))
    assert archive.days.site_with_air_at("roof", SITE, NOON) == SITE


def test_an_older_revision_keeps_the_sightings_and_a_newer_one_has_no_air(archive: Archive, path: Path) -> None:
    archive.sightings.add([point(NOON, temperature_c=30.0)])
    archive.days.set_air(WARM)
    archive.close()
    copy = downgrade(path, "0008")
    with closing(sqlite3.connect(path)) as connection:
        assert connection.execute("SELECT count(*) FROM sun_point").fetchone() == (1,)
        assert connection.execute("SELECT name FROM sqlite_master WHERE name = 'day_air'").fetchall() == []
    upgrade(path)
    with closing(sqlite3.connect(path)) as connection:
        assert connection.execute("SELECT temperature_c, pressure_hpa FROM sun_point").fetchall() == [(None, None)]
        assert connection.execute("SELECT * FROM day_air").fetchall() == []
    with closing(sqlite3.connect(copy)) as connection:
        assert connection.execute("SELECT temperature_c FROM day_air").fetchone() == (35.0,)


def test_a_table_has_the_air_columns_where_air_was_measured() -> None:
    rows = [(NOON, 1.0, 2.0, None, "sun"), (NOON + timedelta(minutes=1), 3.0, 4.0, 0.02, "sun")]
    nan = float("nan")
    measured, assumed = io.StringIO(), io.StringIO()
    write_sightings(measured, rows, air=(np.array([35.25, nan]), np.array([nan, 97_512.0])))
    write_sightings(assumed, rows, air=(np.array([nan, nan]), np.array([nan, nan])))
    assert assumed.getvalue().splitlines()[0] == "time_utc,x_px,y_px,sigma_px,body"
    table = read_sightings(measured.getvalue().splitlines(), name="points.csv")
    assert table.temperature.tolist() == pytest.approx([35.25, nan], nan_ok=True)
    assert table.pressure.tolist() == pytest.approx([nan, 97_512.0], nan_ok=True)


def test_the_days_are_those_asked_for(archive: Archive) -> None:
    for day in (11, 12, 13):
        archive.days.set_air(replace(WARM, date=date(2013, 5, day)))
    found = archive.days.air("roof", since=date(2013, 5, 12), until=date(2013, 5, 13))
    assert [air.date.day for air in found] == [12]
