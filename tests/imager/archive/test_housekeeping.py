"""Disk space and temperature by hour and by day, on both engines, and for how long they are kept."""

from __future__ import annotations

from datetime import UTC, datetime, timedelta
from functools import reduce

import numpy as np
import pytest

from sunarc.imager.archive.archive import Archive
from sunarc.imager.archive.values import Housekeeping, merged

MIDNIGHT = datetime(2026, 5, 13, tzinfo=UTC)


def measured(hours: float, *, free: int | None = None, degrees: float | None = None) -> Housekeeping:
    """Return one measurement, so many hours after midnight."""
    time = MIDNIGHT + timedelta(hours=hours)
    return Housekeeping(
        time=time,
        disk_free_bytes=free,
        images_bytes=None if free is None else 100 - free,
        temperature_c=degrees,
        temperature_min_c=degrees,
        temperature_max_c=degrees,
        n_temperatures=int(degrees is not None),
    )


def test_measurements_of_an_hour_and_a_day_are_their_mean_least_and_greatest(archive: Archive) -> None:
    archive.housekeeping.add("roof", [measured(1.0, free=50, degrees=40.0), measured(1.9, free=30, degrees=43.0)])
    archive.housekeeping.add("roof", [measured(1.5, degrees=40.0), measured(2.0, free=90)])
    archive.housekeeping.add("other", [measured(1.0, free=1, degrees=-9.0)])
    later, earlier = archive.housekeeping.find("roof", step="hour")
    assert earlier == Housekeeping(
        time=MIDNIGHT + timedelta(hours=1),
        disk_free_bytes=30,
        images_bytes=70,
        temperature_c=41.0,
        temperature_min_c=40.0,
        temperature_max_c=43.0,
        n_temperatures=3,
    )
    assert later == Housekeeping(time=MIDNIGHT + timedelta(hours=2), disk_free_bytes=90, images_bytes=10)
    (day,) = archive.housekeeping.find("roof", step="day")
    assert day == merged(earlier, later, time=MIDNIGHT)
    assert (day.time, day.disk_free_bytes, day.images_bytes, day.temperature_c) == (MIDNIGHT, 30, 70, 41.0)


def test_the_order_and_the_parts_in_which_measurements_come_make_no_difference() -> None:
    rng = np.random.default_rng(3)
    parts = [measured(0.1, free=int(rng.integers(100)), degrees=float(rng.normal(40.0, 5.0))) for _ in range(50)]
    degrees = [part.temperature_c for part in parts if part.temperature_c is not None]
    for split in (1, 17, 49):
        halves = [reduce(lambda a, b: merged(a, b, time=MIDNIGHT), some) for some in (parts[split:], parts[:split])]
        whole = merged(*halves, time=MIDNIGHT)
        assert whole.temperature_c == pytest.approx(np.mean(degrees), abs=1e-10)
        assert (whole.temperature_min_c, whole.temperature_max_c) == (min(degrees), max(degrees))
        assert whole.n_temperatures == 50
        assert whole.disk_free_bytes == min(part.disk_free_bytes or 0 for part in parts)


def test_days_are_utc_days_and_bounds_are_half_open(archive: Archive) -> None:
    archive.housekeeping.add("roof", [measured(23.99, free=1), measured(24.0, free=2)])
    assert [one.time for one in archive.housekeeping.find("roof", step="day")] == [
        MIDNIGHT + timedelta(days=1),
        MIDNIGHT,
    ]
    found = archive.housekeeping.find("roof", step="day", since=MIDNIGHT, until=MIDNIGHT + timedelta(days=1))
    assert [one.disk_free_bytes for one in found] == [1]
    east = measured(0.5, free=7)
    archive.housekeeping.add("east", [Housekeeping(time=east.time.astimezone(tz=None), disk_free_bytes=7)])
    assert archive.housekeeping.find("east", step="hour")[0].time == MIDNIGHT


def test_hours_are_kept_for_92_days_and_days_for_five_years(archive: Archive) -> None:
    now = MIDNIGHT + timedelta(hours=1)
    ages = {"day": (91, 93, 1829, 1831), "hour": (91, 93)}
    archive.housekeeping.add("roof", [measured(-24.0 * age, free=age) for age in ages["day"]])
    archive.housekeeping.add("other", [measured(-24.0 * 2000, free=0)])
    assert archive.housekeeping.expire("roof", now=now) == 3 + 1  # hours of 93, 1829 and 1831 days, a day of 1831
    assert [one.disk_free_bytes for one in archive.housekeeping.find("roof", step="hour")] == [91]
    assert [one.disk_free_bytes for one in archive.housekeeping.find("roof", step="day")] == [91, 93, 1829]
    assert archive.housekeeping.expire("roof", now=now) == 0
    assert len(archive.housekeeping.find("other", step="hour")) == 1


def test_times_of_conditions_are_of_one_service_and_replaced_as_a_whole(archive: Archive) -> None:
    archive.conditions.replace_since("roof", {"disk_low": MIDNIGHT, "drift": MIDNIGHT + timedelta(hours=1)})
    archive.conditions.replace_since("", {"nightly_failed": MIDNIGHT})
    assert archive.conditions.times("roof") == {"disk_low": MIDNIGHT, "drift": MIDNIGHT + timedelta(hours=1)}
    archive.conditions.replace_since("roof", {"drift": MIDNIGHT})
    assert archive.conditions.times("roof") == {"drift": MIDNIGHT}
    archive.conditions.replace_since("roof", {})
    assert archive.conditions.times("roof") == {}
    assert archive.conditions.times("") == {"nightly_failed": MIDNIGHT}
