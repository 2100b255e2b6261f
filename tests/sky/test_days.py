from __future__ import annotations

from datetime import UTC, date, datetime, timedelta

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sunarc.sky.days import day_bounds_unix_s, solar_date
from sunarc.sky.directions import angular_distance
from sunarc.sky.site import Site
from sunarc.sky.sun import hour_angle, sun_angles, sun_directions

LONGITUDES = st.floats(-180.0, 180.0)
DATES = st.dates(date(1980, 1, 1), date(2080, 1, 1))
geometry = settings(derandomize=True, deadline=None)

DATE_LINE = Site(latitude=-41.0, longitude=175.0)
TROPIC = Site(latitude=-12.0, longitude=-77.0)
MIDNIGHT_SUN = Site(latitude=79.0, longitude=12.0)


def day_of(site: Site, day: date, *, step_s: float = 60.0) -> np.ndarray:
    start, end = day_bounds_unix_s(day, longitude=site.longitude)
    return np.arange(start, end, step_s)


@geometry
@given(day=DATES, longitude=LONGITUDES)
def test_days_follow_one_another_without_gap_or_overlap(day: date, longitude: float) -> None:
    start, end = day_bounds_unix_s(day, longitude=longitude)
    assert end == day_bounds_unix_s(day + timedelta(days=1), longitude=longitude)[0]
    assert end - start == pytest.approx(86_400.0, abs=1e-5)


@geometry
@given(day=DATES, longitude=LONGITUDES, fraction=st.floats(1e-6, 1.0 - 1e-6))
def test_every_moment_of_a_day_bears_its_date(day: date, longitude: float, fraction: float) -> None:
    start, end = day_bounds_unix_s(day, longitude=longitude)
    assert solar_date(start + fraction * (end - start), longitude=longitude) == day


@geometry
@given(unix_s=st.floats(0.0, 4e9), longitude=LONGITUDES)
def test_every_moment_lies_within_the_bounds_of_its_date(unix_s: float, longitude: float) -> None:
    start, end = day_bounds_unix_s(solar_date(unix_s, longitude=longitude), longitude=longitude)
    assert start - 1e-5 <= unix_s < end + 1e-5  # the date is cut at the microsecond


def test_beyond_the_date_line_the_day_begins_at_noon_of_the_day_before() -> None:
    start, _ = day_bounds_unix_s(date(2026, 5, 2), longitude=DATE_LINE.longitude)
    assert datetime.fromtimestamp(start, UTC) == datetime(2026, 5, 1, 12, 20, tzinfo=UTC)
    assert solar_date(start - 1.0, longitude=DATE_LINE.longitude) == date(2026, 5, 1)
    assert solar_date(start, longitude=DATE_LINE.longitude) == date(2026, 5, 2)


def test_either_side_of_the_date_line_is_a_day_apart() -> None:
    noon_utc = datetime(2026, 5, 2, 12, 1, tzinfo=UTC).timestamp()
    assert solar_date(noon_utc, longitude=180.0) == date(2026, 5, 3)
    assert solar_date(noon_utc, longitude=-180.0) == date(2026, 5, 2)


@pytest.mark.parametrize("site", [DATE_LINE, TROPIC, MIDNIGHT_SUN], ids=["41 S 175 E", "12 S", "79 N"])
@pytest.mark.parametrize("day", [date(2026, 5, 2), date(2026, 11, 3)])
def test_a_day_is_cut_where_the_sun_is_lowest(site: Site, day: date) -> None:
    times = day_of(site, day)
    lowest = times[np.argmax(sun_angles(times, site).zenith)]
    start, end = times[0], times[-1]
    equation_of_time_s = 17.0 * 60.0
    assert min(lowest - start, end - lowest) < equation_of_time_s
    assert abs(float(hour_angle(start, site))) > np.pi - np.radians(equation_of_time_s / 240.0)


def test_on_the_date_line_one_day_holds_one_whole_arc() -> None:
    zenith = sun_angles(day_of(DATE_LINE, date(2026, 5, 2)), DATE_LINE).zenith
    crossings = np.flatnonzero(np.diff(zenith < 90.0))
    assert len(crossings) == 2
    assert zenith[crossings[0]] > zenith[crossings[0] + 1]


def test_at_12_south_the_sun_goes_through_the_zenith_and_its_direction_has_no_seam() -> None:
    times = day_of(TROPIC, date(2026, 2, 17), step_s=10.0)
    assert sun_angles(times, TROPIC).zenith.min() < 0.5
    steps = np.degrees(angular_distance(sun_directions(times[1:], TROPIC), sun_directions(times[:-1], TROPIC)))
    up = sun_angles(times[1:], TROPIC).zenith < 89.0
    assert steps[up].max() < 10.0 * 0.00418  # the sky turns by 15.04 degrees an hour, whatever the azimuth does


def test_at_79_north_in_may_the_sun_never_sets_and_goes_all_round() -> None:
    times = day_of(MIDNIGHT_SUN, date(2026, 5, 20))
    angles = sun_angles(times, MIDNIGHT_SUN)
    assert angles.apparent_zenith.max() < 82.0
    assert angles.azimuth.min() < 1.0
    assert angles.azimuth.max() > 359.0
    steps = np.degrees(
        angular_distance(sun_directions(times[1:], MIDNIGHT_SUN), sun_directions(times[:-1], MIDNIGHT_SUN))
    )
    assert steps.max() < 60.0 * 0.0042


def test_at_79_north_in_december_the_sun_never_rises() -> None:
    assert sun_angles(day_of(MIDNIGHT_SUN, date(2026, 12, 20)), MIDNIGHT_SUN).zenith.min() > 100.0


@pytest.mark.parametrize("site", [DATE_LINE, TROPIC, MIDNIGHT_SUN], ids=["41 S 175 E", "12 S", "79 N"])
def test_the_hour_angle_runs_evenly_from_east_to_west(site: Site) -> None:
    times = day_of(site, date(2026, 5, 20))
    angle = np.unwrap(hour_angle(times, site))
    np.testing.assert_allclose(np.diff(angle), 2.0 * np.pi * 60.0 / 86_400.0, rtol=1e-3)
    highest = np.argmin(sun_angles(times, site).zenith)
    assert abs(float(hour_angle(times[highest], site))) < np.radians(0.3)  # within the minute of upper transit
    morning = times[highest] - 3600.0
    assert float(hour_angle(morning, site)) < 0.0
