"""What is asked of the sightings, against the same question asked of a list."""

from __future__ import annotations

import sqlite3
import threading
from contextlib import closing
from dataclasses import asdict, replace
from datetime import datetime, timedelta
from pathlib import Path

import numpy as np
import pytest
from tests.fixtures.stores import NOON, ROOF

from sunarc.detection.values import Detection
from sunarc.imager.archive.archive import Archive, open_archive
from sunarc.imager.archive.database.schema import check, downgrade, known_revisions, upgrade
from sunarc.imager.archive.sightings import make_sun_point
from sunarc.imager.archive.values import SunPoint
from sunarc.sky.days import solar_date
from sunarc.sky.site import Site

COUNT = 60


def minute(number: float) -> datetime:
    return NOON + timedelta(minutes=number)


@pytest.fixture
def points(archive: Archive) -> list[SunPoint]:
    """Return sightings of every kind, stored in another order than that of their times."""
    rng = np.random.default_rng(1)
    epoch = archive.epochs.at("roof", NOON, reason="first frame").id
    made = [
        SunPoint(
            camera="roof",
            pose_epoch=epoch,
            time=minute(number),
            method="disc" if rng.uniform() < 0.7 else "paper",
            accepted=bool(rng.uniform() < 0.6),
            verdict="clear",
            x_px=float(rng.uniform(0.0, 1747.0)),
            y_px=float(rng.uniform(0.0, 1747.0)),
            sigma_px=float(rng.uniform(0.01, 0.2)) if rng.uniform() < 0.8 else None,
            clock_error_s=float(rng.uniform(0.0, 4.0)) if rng.uniform() < 0.8 else None,
            exposure_us=20.0,
        )
        for number in range(COUNT)
    ]
    archive.sightings.add(made[i] for i in rng.permutation(COUNT))
    return made


def within(point: SunPoint, since: float | None, until: float | None) -> bool:
    return (since is None or point.time >= minute(since)) and (until is None or point.time < minute(until))


BOUNDS: list[tuple[float | None, float | None]] = [
    (None, None),
    (10, None),
    (None, 10),
    (10, 30),
    (10.5, 10.6),
    (30, 10),
]


@pytest.mark.parametrize(("since", "until"), BOUNDS)
@pytest.mark.parametrize("accepted", [None, True, False])
def test_sightings_are_those_from_since_to_before_until(
    archive: Archive, points: list[SunPoint], since: float | None, until: float | None, *, accepted: bool | None
) -> None:
    found = archive.sightings.find(
        "roof",
        since=None if since is None else minute(since),
        until=None if until is None else minute(until),
        accepted=accepted,
    )
    assert list(found) == [p for p in points if within(p, since, until) and accepted in {None, p.accepted}]


@pytest.mark.parametrize("limit", [0, 1, 7, COUNT, COUNT + 1])
@pytest.mark.parametrize("newest_first", [False, True])
def test_a_limit_takes_the_first_of_the_order(
    archive: Archive, points: list[SunPoint], limit: int, *, newest_first: bool
) -> None:
    found = archive.sightings.find("roof", newest_first=newest_first, limit=limit)
    assert list(found) == (points[::-1] if newest_first else points)[:limit]


@pytest.mark.parametrize("page", [1, 7, 20])
def test_pages_that_begin_after_the_last_time_have_every_sighting_once(
    archive: Archive, points: list[SunPoint], page: int
) -> None:
    found: list[SunPoint] = []
    since = None
    while part := archive.sightings.find("roof", since=since, limit=page):
        found += part
        since = part[-1].time + timedelta(microseconds=1)
    assert found == points


@pytest.mark.parametrize("limit_s", [0.0, 1.0, 4.0])
def test_a_clock_bound_that_is_not_known_counts_as_none(
    archive: Archive, points: list[SunPoint], limit_s: float
) -> None:
    found = archive.sightings.find("roof", largest_clock_error_s=limit_s)
    assert list(found) == [p for p in points if (p.clock_error_s or 0.0) <= limit_s]


def test_columns_are_the_accepted_sightings_column_by_column(archive: Archive, points: list[SunPoint]) -> None:
    columns = archive.sightings.columns("roof")
    accepted = [p for p in points if p.accepted]
    np.testing.assert_array_equal(columns.unix_s, [p.time.timestamp() for p in accepted])
    np.testing.assert_array_equal(columns.pixels, [(p.x_px, p.y_px) for p in accepted])
    for name in ("sigma_px", "clock_error_s"):
        given = [np.nan if getattr(p, name) is None else getattr(p, name) for p in accepted]
        np.testing.assert_array_equal(getattr(columns, name), given)


@pytest.mark.parametrize("method", ["disc", "paper"])
def test_columns_of_one_method_have_no_others(archive: Archive, points: list[SunPoint], method: str) -> None:
    columns = archive.sightings.columns("roof", method=method)
    expected = [p.time.timestamp() for p in points if p.accepted and p.method == method]
    np.testing.assert_array_equal(columns.unix_s, expected)


def test_a_mask_of_columns_is_the_mask_of_each(archive: Archive, points: list[SunPoint]) -> None:
    columns = archive.sightings.columns("roof")
    mask = columns.pixels[:, 0] > 800.0
    picked = columns.select(mask)
    assert 0 < picked.ids.size < len(points)
    for name in ("unix_s", "pixels", "sigma_px", "ids"):
        np.testing.assert_array_equal(getattr(picked, name), getattr(columns, name)[mask])


def test_the_newest_sighting_is_of_a_trusted_clock(archive: Archive, points: list[SunPoint]) -> None:
    trusted = [p.time for p in points if (p.clock_error_s or 0.0) <= 0.5]
    assert archive.sightings.newest_time("roof", largest_clock_error_s=0.5) == max(trusted)
    assert archive.sightings.newest_time("mast", largest_clock_error_s=0.5) is None


def test_of_threads_that_store_the_same_sightings_each_is_stored_once(archive: Archive, points: list[SunPoint]) -> None:
    later = [replace(p, time=p.time + timedelta(days=1)) for p in points]
    added: list[int] = []
    threads = [threading.Thread(target=lambda: added.append(archive.sightings.add(later))) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert sum(added) == COUNT
    assert len(archive.sightings.find("roof")) == 2 * COUNT


def test_no_sightings_are_no_write(archive: Archive) -> None:
    assert archive.sightings.add([]) == 0


def test_an_archives_day_air_is_that_of_the_solar_day(archive: Archive) -> None:
    site = Site(latitude=ROOF.latitude, longitude=ROOF.longitude, altitude=ROOF.altitude)
    assert archive.days.site_with_air_at("roof", site, NOON) == site
    assert (
        archive.days.site_in_measured_air("roof", site, solar_date(NOON.timestamp(), longitude=site.longitude)) == site
    )


def test_a_sighting_has_every_number_of_its_detection() -> None:
    numbers = {
        "x_px": 1.0, "y_px": 2.0, "sigma_px": 3.0, "peak_fraction": 4.0, "background_fraction": 5.0, "radius_px": 6.0,
        "ellipticity": 7.0, "residual_chi2": 8.0, "snr": 9.0, "saturated_px": 10,
    }  # fmt: skip
    found = Detection(method="disc", accepted=True, verdict="veiled", findings=(), **numbers)  # type: ignore[arg-type]
    point = make_sun_point(found, camera="roof", pose_epoch="e", time=NOON, exposure_us=20.0, clock_error_s=0.5)
    assert numbers.items() <= asdict(point).items()
    assert (point.method, point.accepted, point.verdict) == ("disc", True, "veiled")
    assert (point.exposure_us, point.clock_error_s, point.time, point.pose_epoch) == (20.0, 0.5, NOON, "e")


@pytest.mark.parametrize("revision", known_revisions()[-4:-1])
def test_sightings_survive_the_way_down_to_a_revision_and_up_again(
    archive: Archive, path: Path, points: list[SunPoint], revision: str
) -> None:
    archive.close()
    downgrade(path, revision)
    assert check(path).revision == revision
    upgrade(path)
    with open_archive(path) as opened:
        assert list(opened.sightings.find("roof")) == points


@pytest.mark.parametrize("damage", ["time = 'torn'", "x_px = 'torn'", "y_px = NULL", "exposure_us = 'torn'"])
def test_a_damaged_row_is_in_no_answer_and_keeps_no_other_out(
    archive: Archive, path: Path, points: list[SunPoint], damage: str
) -> None:
    accepted = [p for p in points if p.accepted]
    first = "SELECT min(time) FROM sun_point WHERE accepted"
    with closing(sqlite3.connect(path)) as connection, connection:
        connection.execute(f"UPDATE sun_point SET {damage} WHERE time = ({first})")  # noqa: S608 - of a test
    assert list(archive.sightings.find("roof", accepted=True)) == accepted[1:]


@pytest.mark.parametrize("column", ["sigma_px", "clock_error_s", "temperature_c", "snr"])
def test_a_text_in_the_place_of_a_number_counts_as_not_known(
    archive: Archive, path: Path, points: list[SunPoint], column: str
) -> None:
    with closing(sqlite3.connect(path)) as connection, connection:
        connection.execute(f"UPDATE sun_point SET {column} = 'torn'")  # noqa: S608 - of a test
    found = archive.sightings.find("roof")
    assert [getattr(p, column) for p in found] == [None] * len(points)
