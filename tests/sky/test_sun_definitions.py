"""Directions, refraction, air mass, solar days and hour angles, against definitions, tables and pvlib."""

from __future__ import annotations

import math
from dataclasses import replace
from datetime import UTC, date, datetime, timedelta, timezone

import numpy as np
import pandas as pd
import pvlib
import pytest
from numpy.typing import NDArray

from sunarc.common.errors import InputError
from sunarc.sky.days import day_bounds_unix_s, solar_date
from sunarc.sky.directions import angles_from_direction, angular_distance, direction_from_angles
from sunarc.sky.ephemeris import SECONDS_PER_JULIAN_YEAR, terrestrial_minus_universal_s
from sunarc.sky.refraction import ASSUMED_AIR_SD, DAILY_AIR_SD, MEASURED_AIR_SD, raised, refraction_rad, upward
from sunarc.sky.site import Site, relative_air_mass
from sunarc.sky.sun import SOLAR_RADIUS, find_next_sun_unix_s, hour_angle, sun_angles, sun_directions

FloatArray = NDArray[np.float64]
STANDARD = Site(latitude=36.6, longitude=-97.5, pressure=101_000.0, temperature=10.0)
GOLDEN = Site(latitude=39.742476, longitude=-105.1786, altitude=1830.14, pressure=82_000.0, temperature=11.0)
GOLDEN_TIME = datetime(2003, 10, 17, 12, 30, 30, tzinfo=timezone(timedelta(hours=-7))).timestamp()


def at_elevation(degrees: float | FloatArray) -> FloatArray:
    return direction_from_angles(zenith_deg=90.0 - np.asarray(degrees), azimuth_deg=77.0)


@pytest.mark.parametrize(
    ("elevation", "arcminutes", "tolerance"),
    [
        # refraction at apparent altitudes, 1010 hPa and 10 °C: the Nautical Almanac, to 0.1' (Bennett is good to 0.07')
        (0.0, 34.5, 0.1),
        (1.0, 24.3, 0.15),
        (5.0, 9.9, 0.12),
        (10.0, 5.3, 0.12),
        (20.0, 2.6, 0.12),
        (45.0, 1.0, 0.06),
        (70.0, 0.4, 0.05),
        (90.0, 0.0, 0.002),
    ],
)
def test_the_refraction_is_the_almanac_s(elevation: float, arcminutes: float, tolerance: float) -> None:
    found = math.degrees(float(refraction_rad(at_elevation(elevation), STANDARD))) * 60.0
    assert found == pytest.approx(arcminutes, abs=tolerance)
    assert found >= 0.0


def test_the_refraction_is_bennett_s_formula_digit_for_digit() -> None:
    for elevation in (0.0, 0.5, 3.0, 17.0, 44.0, 80.0):
        cotangent = 1.0 / math.tan(math.radians(elevation + 7.31 / (elevation + 4.4)))
        for pressure, temperature in ((101_000.0, 10.0), (70_000.0, -20.0), (102_500.0, 38.0)):
            site = replace(STANDARD, pressure=pressure, temperature=temperature)
            expected = cotangent / 60.0 * (pressure / 101_000.0) * (283.0 / (273.0 + temperature))
            found = math.degrees(float(refraction_rad(at_elevation(elevation), site)))
            assert found == pytest.approx(expected, rel=1e-9)


def test_below_the_horizon_the_refraction_is_that_of_the_horizon() -> None:
    found = refraction_rad(at_elevation(np.array([0.0, -1.0, -60.0])), STANDARD)
    np.testing.assert_allclose(found, found[0], rtol=1e-12)
    assert math.degrees(float(found[0])) == pytest.approx(0.575, abs=0.005)


def test_a_vector_that_rounding_made_too_long_still_has_a_refraction() -> None:
    found = float(refraction_rad([0.0, 0.0, 1.0 + 2.3e-16], STANDARD))
    assert 0.0 <= found < 1e-6


def test_the_refraction_undoes_that_of_pvlib_s_position_algorithm() -> None:
    # pvlib refracts true elevations by Saemundsson's formula, whose inverse Bennett's is to 0.07' above 5 degrees
    true = np.linspace(0.3, 89.0, 60)
    for site in (STANDARD, replace(STANDARD, pressure=84_000.0, temperature=-15.0)):
        theirs = pvlib.spa.atmospheric_refraction_correction(site.pressure_pa / 100.0, site.temperature, true, 0.5667)
        found = np.degrees(refraction_rad(at_elevation(true + theirs), site))
        off = np.abs(found - theirs) * 60.0
        assert np.max(off) < 0.5
        assert 0.001 < np.max(off[true > 5.0]) < 0.07  # another formula, not the same


def test_the_refraction_falls_with_height_as_its_formula_s_derivative() -> None:
    for elevation in (1.0, 10.0, 50.0):
        step = 1e-4
        lower, upper = refraction_rad(at_elevation(np.array([elevation - step, elevation + step])), STANDARD)
        argument = math.radians(elevation + 7.31 / (elevation + 4.4))
        slope = -(1.0 / math.sin(argument) ** 2) * math.radians(1.0 - 7.31 / (elevation + 4.4) ** 2)
        assert math.degrees(float(upper - lower)) * 60.0 / (2.0 * step) == pytest.approx(slope, rel=1e-5)


def test_upward_is_the_derivative_of_a_direction_by_its_height() -> None:
    rng = np.random.default_rng(2)
    zenith, azimuth = rng.uniform(1.0, 179.0, 40), rng.uniform(0.0, 360.0, 40)
    step = 1e-4
    higher, lower = (direction_from_angles(zenith_deg=zenith + s, azimuth_deg=azimuth) for s in (-step, step))
    quotient = (higher - lower) / math.radians(2.0 * step)
    found = upward(direction_from_angles(zenith_deg=zenith, azimuth_deg=azimuth))
    np.testing.assert_allclose(found, quotient, atol=1e-9)
    np.testing.assert_allclose(np.linalg.norm(found, axis=-1), 1.0, atol=1e-14)


def test_at_the_zenith_and_the_nadir_nothing_leads_upward() -> None:
    poles = np.array([[0.0, 0.0, 1.0], [0.0, 0.0, -1.0]])
    np.testing.assert_array_equal(upward(poles), np.zeros((2, 3)))
    np.testing.assert_allclose(raised(poles, 0.0), poles, atol=0.0)


def test_raised_turns_by_exactly_the_angle_and_back() -> None:
    rng = np.random.default_rng(6)
    directions = direction_from_angles(zenith_deg=rng.uniform(5.0, 120.0, 30), azimuth_deg=rng.uniform(0, 360.0, 30))
    angle = rng.uniform(-0.05, 0.05, 30)
    found = raised(directions, angle)
    np.testing.assert_allclose(angular_distance(found, directions), np.abs(angle), atol=1e-14)
    np.testing.assert_allclose(np.linalg.norm(found, axis=-1), 1.0, atol=1e-14)
    np.testing.assert_allclose(raised(found, -angle), directions, atol=1e-14)
    quotient = (raised(directions, 1e-6) - raised(directions, -1e-6)) / 2e-6
    np.testing.assert_allclose(quotient, upward(directions), atol=1e-9)


def test_the_air_s_doubt_is_what_its_sentences_say() -> None:
    # 10 K of 285 K and 1.5 % of pressure; 2 K; 4 K and 0.6 %
    assert math.hypot(10.0 / 285.0, 0.015) == pytest.approx(ASSUMED_AIR_SD, rel=0.1)
    assert 2.0 / 285.0 < MEASURED_AIR_SD < 2.0 * 2.0 / 285.0
    assert math.hypot(4.0 / 285.0, 0.006) == pytest.approx(DAILY_AIR_SD, rel=0.1)


def test_the_sun_s_radius_is_959_63_arcseconds() -> None:
    assert math.degrees(SOLAR_RADIUS) * 3600.0 == pytest.approx(959.63, abs=0.2)


@pytest.mark.parametrize("zenith", [0.0, 30.0, 60.0, 75.0, 85.0, 89.0, 90.0])
def test_the_air_mass_is_pvlib_s(zenith: float) -> None:
    theirs = pvlib.atmosphere.get_relative_airmass(zenith, model="kastenyoung1989")
    assert float(relative_air_mass(zenith)) == pytest.approx(float(theirs), rel=1e-12)


def test_the_air_mass_is_kasten_and_young_s_table_and_stays_that_of_the_horizon_below_it() -> None:
    # their table: 1.0 at the zenith, 1.9939 at 60°, 5.5841 … at 80°, 38 at the horizon
    found = relative_air_mass([0.0, 60.0, 80.0, 90.0, 95.0, -3.0])
    np.testing.assert_allclose(found[:4], [0.99971, 1.9939, 5.585, 37.92], rtol=1e-3)
    assert found[4] == found[3]
    assert found[5] == found[0]


def test_angles_go_round_the_compass_and_back() -> None:
    zenith, azimuth = np.meshgrid([0.001, 30.0, 90.0, 150.0, 179.999], np.arange(0.0, 360.0, 22.5))
    found = angles_from_direction(3.7 * direction_from_angles(zenith_deg=zenith, azimuth_deg=azimuth))
    np.testing.assert_allclose(found[0], zenith, atol=1e-10)
    np.testing.assert_allclose((found[1] - azimuth + 180.0) % 360.0, 180.0, atol=1e-8)
    assert np.all((found[1] >= 0.0) & (found[1] < 360.0))
    quotient = direction_from_angles(zenith_deg=90.0, azimuth_deg=1.0)
    np.testing.assert_allclose(quotient, [math.sin(math.radians(1.0)), math.cos(math.radians(1.0)), 0.0], atol=1e-15)


def test_distances_broadcast_and_equal_the_arc_cosine_at_large_angles() -> None:
    first = direction_from_angles(zenith_deg=[10.0, 50.0, 100.0], azimuth_deg=[0.0, 120.0, 300.0])
    found = angular_distance(first[:, None], first[None])
    assert found.shape == (3, 3)
    np.testing.assert_allclose(np.cos(found), first @ first.T, atol=1e-14)
    np.testing.assert_allclose(np.diag(found), 0.0, atol=1e-15)


def test_the_papers_example_as_a_direction() -> None:
    # Reda and Andreas, table A5.1: zenith 50.11162, azimuth 194.34024; our own ΔT is 2.5 s off
    found = sun_directions(GOLDEN_TIME, GOLDEN)
    zenith, azimuth = math.radians(50.11162), math.radians(194.34024)
    expected = [
        math.sin(zenith) * math.sin(azimuth), math.sin(zenith) * math.cos(azimuth), math.cos(zenith),
    ]  # fmt: skip
    assert 0.0 <= math.degrees(float(angular_distance(found, expected))) < 1e-4
    angles = sun_angles(GOLDEN_TIME, GOLDEN)
    # ΔE = 0.016332 degrees there
    assert float(angles.zenith - angles.apparent_zenith) == pytest.approx(0.016332, abs=2e-6)


def test_the_hour_angle_of_the_papers_example() -> None:
    # topocentric local hour angle H' = 11.10629 degrees
    assert math.degrees(float(hour_angle(GOLDEN_TIME, GOLDEN))) == pytest.approx(11.10629, abs=1e-4)


def test_refraction_fades_below_the_horizon_and_the_true_zenith_ignores_the_air() -> None:
    times = GOLDEN_TIME + np.arange(0.0, 86_400.0, 900.0)
    angles, vacuum = sun_angles(times, GOLDEN), sun_angles(times, GOLDEN, pressure=0.0)
    np.testing.assert_allclose(angles.zenith, vacuum.zenith, atol=1e-12)
    np.testing.assert_allclose(vacuum.apparent_zenith, vacuum.zenith, atol=1e-12)
    night = angles.zenith > 91.0
    np.testing.assert_allclose(angles.apparent_zenith[night], angles.zenith[night], atol=1e-12)
    high = angles.zenith < 89.0
    assert np.all(angles.apparent_zenith[high] < angles.zenith[high])


def test_measured_air_goes_by_its_density() -> None:
    low = GOLDEN_TIME + 4.5 * 3600.0
    assumed = sun_angles(low, GOLDEN)
    halved = sun_angles(low, GOLDEN, pressure=41_000.0)
    cold = sun_angles(low, GOLDEN, temperature=-20.0)
    shift = float(assumed.zenith - assumed.apparent_zenith)
    assert float(halved.zenith - halved.apparent_zenith) == pytest.approx(shift / 2.0, rel=1e-6)
    assert float(cold.zenith - cold.apparent_zenith) == pytest.approx(shift * 284.0 / 253.0, rel=1e-6)
    nothing = sun_angles([low, low], GOLDEN, temperature=[np.nan, -20.0], pressure=np.nan)
    np.testing.assert_allclose(nothing.apparent_zenith, [assumed.apparent_zenith, cold.apparent_zenith], atol=1e-12)


def test_delta_t_is_pvlib_s_of_the_month_at_each_time_s_mean() -> None:
    for year, month in ((1995, 1), (2016, 7), (2026, 12)):
        start = datetime(year, month, 1, tzinfo=UTC).timestamp()
        expected = float(pvlib.spa.calculate_deltat(year, month))
        assert terrestrial_minus_universal_s(np.array([start])) == pytest.approx(expected, abs=0.1)
        assert terrestrial_minus_universal_s(np.array([start - 1e6, start + 1e6])) == pytest.approx(expected, abs=0.1)
    assert SECONDS_PER_JULIAN_YEAR == 365.25 * 86_400.0


@pytest.mark.parametrize("longitude", [-180.0, -179.99, -0.25, 0.0, 179.99, 180.0])
@pytest.mark.parametrize("day", [date(1970, 1, 1), date(2024, 2, 29), date(2026, 12, 31)])
def test_the_days_at_the_edges_of_the_map_are_86400_seconds_and_named_by_their_noon(
    longitude: float, day: date
) -> None:
    start, end = day_bounds_unix_s(day, longitude=longitude)
    assert end - start == 86_400.0
    midnight_utc = datetime(day.year, day.month, day.day, tzinfo=UTC).timestamp()
    assert start == midnight_utc - longitude / 15.0 * 3600.0
    assert [solar_date(t, longitude=longitude) for t in (start, (start + end) / 2.0, end - 1e-3)] == [day] * 3
    assert solar_date(end + 1e-3, longitude=longitude) == day + timedelta(days=1)
    assert solar_date(start - 1e-3, longitude=longitude) == day - timedelta(days=1)


@pytest.mark.parametrize("latitude", [-90.0, -89.9, 89.9, 90.0])
def test_at_the_poles_every_day_holds_one_turn_of_the_sun_at_its_declination(latitude: float) -> None:
    site = Site(latitude=latitude, longitude=0.0)
    start, end = day_bounds_unix_s(date(2026, 6, 21), longitude=0.0)
    angles = sun_angles(np.arange(start, end, 600.0), site)
    expected = 90.0 - math.copysign(23.43, latitude)
    np.testing.assert_allclose(angles.zenith, expected, atol=0.15)
    turned = np.unwrap(np.radians(angles.azimuth))
    assert abs(float(turned[-1] - turned[0])) == pytest.approx(2.0 * math.pi * 143.0 / 144.0, rel=1e-3)


@pytest.mark.parametrize("longitude", [-180.0, -97.5, 0.0, 180.0])
def test_noon_of_the_mean_sun_is_noon_but_for_the_equation_of_time(longitude: float) -> None:
    # equation of time: +16.4 min on 3 November, -14.2 min on 11 February (Astronomical Almanac)
    site = Site(latitude=10.0, longitude=longitude)
    for day, minutes in ((date(2026, 11, 3), 16.4), (date(2026, 2, 11), -14.2), (date(2026, 9, 1), 0.0)):
        start, end = day_bounds_unix_s(day, longitude=longitude)
        found = math.degrees(float(hour_angle((start + end) / 2.0, site))) * 4.0
        assert found == pytest.approx(minutes, abs=0.4)


def test_hour_angles_run_from_minus_to_plus_half_a_turn_on_both_halves_of_the_earth() -> None:
    for latitude in (-60.0, 0.0, 60.0):
        site = Site(latitude=latitude, longitude=0.0)
        start, end = day_bounds_unix_s(date(2026, 3, 20), longitude=0.0)
        found = hour_angle(np.linspace(start, end, 25), site)
        assert np.all(np.abs(found) <= math.pi)
        assert np.all(np.diff(found[1:-1]) > 0.0)
        np.testing.assert_allclose(found[6], -math.pi / 2.0, atol=0.04)  # six o'clock: in the east


@pytest.mark.parametrize(
    ("field", "low", "high", "beyond"),
    [
        ("latitude", -90.0, 90.0, 1e-9),
        ("longitude", -180.0, 180.0, 1e-9),
        ("altitude", -500.0, 9000.0, 1e-6),
        ("temperature", -60.0, 60.0, 1e-9),
        ("pressure", 30_000.0, 110_000.0, 1e-6),
    ],
)
def test_the_bounds_of_a_site_belong_to_it_and_what_lies_beyond_does_not(
    field: str, low: float, high: float, beyond: float
) -> None:
    place = {"latitude": 0.0, "longitude": 0.0}
    for value in (low, high):
        assert getattr(Site(**{**place, field: value}), field) == value
    for value in (low - beyond, high + beyond):
        with pytest.raises(InputError) as caught:
            Site(**{**place, field: value})
        assert caught.value.field == f"site.{field}"


def test_a_site_without_further_words_lies_at_sea_level_in_12_degrees() -> None:
    site = Site(latitude=1.0, longitude=2.0)
    assert (site.altitude, site.temperature, site.pressure) == (0.0, 12.0, None)
    assert site.pressure_pa == pytest.approx(101_325.0, rel=1e-4)


@pytest.mark.parametrize("zenith_deg", [89.6, 102.0])
@pytest.mark.parametrize("latitude", [-36.85, 0.0, 52.0])
def test_the_sun_is_next_where_pvlib_has_it_cross_the_zenith_angle(latitude: float, zenith_deg: float) -> None:
    site, start = Site(latitude=latitude, longitude=10.0, pressure=101_000.0, temperature=10.0), GOLDEN_TIME
    for rising in (True, False):
        found = find_next_sun_unix_s(start, site, zenith_deg=zenith_deg, rising=rising)
        times = start + np.arange(0.0, 90_000.0, 10.0)
        stamps = pd.to_datetime(times, unit="s", utc=True)
        zenith = pvlib.solarposition.get_solarposition(stamps, latitude, 10.0, pressure=101_000.0, temperature=10.0)
        holds = (zenith["apparent_zenith"].to_numpy() < zenith_deg) == rising
        assert found == pytest.approx(times[np.argmax(holds)], abs=15.0)
        again = find_next_sun_unix_s(found, site, zenith_deg=zenith_deg, rising=rising)
        assert again == found  # where it holds already


def test_in_the_polar_night_the_sun_is_next_in_spring_and_never_at_a_zenith_it_does_not_reach() -> None:
    polar = Site(latitude=78.2, longitude=15.6, pressure=101_000.0, temperature=-10.0)
    december = datetime(2025, 12, 1, 12, tzinfo=UTC).timestamp()
    back = datetime.fromtimestamp(find_next_sun_unix_s(december, polar, zenith_deg=90.0, rising=True), UTC)
    assert date(2026, 2, 12) <= back.date() <= date(2026, 2, 20)  # the sun is back over Longyearbyen's horizon
    assert math.isnan(find_next_sun_unix_s(december, polar, zenith_deg=20.0, rising=True))
