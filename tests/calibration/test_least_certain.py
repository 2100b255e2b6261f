"""The part of the sky in which a calibration is less certain, in words: against cameras whose uncertainty is chosen."""

from __future__ import annotations

from dataclasses import replace
from datetime import UTC, datetime

import numpy as np
import pytest
from tests.fixtures.calibrations import SITE, chosen_calibration

from sunarc.calibration.answers import least_certain as subject
from sunarc.calibration.answers.least_certain import LeastCertain, find_least_certain
from sunarc.common.array_types import BoolArray, FloatArray
from sunarc.optics.camera import Camera
from sunarc.sky.directions import angles_from_direction
from sunarc.sky.site import Site
from sunarc.sky.sun import sun_angles

LENS = Camera(
    width=1200, height=1200, projection="equidistant", focal_length_px=(370.0, 370.0),
    principal_point_px=(599.5, 599.5), rotation_cam_enu=(0.0, 0.0, 0.4), radial=(0.0,) * 8, decentering=(0.0,) * 4,
)  # fmt: skip
ORDERS = np.array([[1, 1], [2, 1]])
EQUINOX = datetime(2025, 3, 20, 18, 0, tzinfo=UTC).timestamp()
UP = chosen_calibration(LENS, names=("principal_point_x_px",), covariance=np.diag([0.01]), orders=ORDERS)


def part(monkeypatch: pytest.MonkeyPatch, bad: object, site: Site = SITE, now: float = EQUINOX) -> LeastCertain | None:
    """Return the part where a condition on zenith angle and azimuth holds: 3 degrees there, .1 elsewhere."""

    def sigma(_calibration: object, directions: FloatArray) -> FloatArray:
        zenith, azimuth = angles_from_direction(directions)
        return np.where(bad(np.asarray(zenith), np.asarray(azimuth)), 3.0, 0.1)  # type: ignore[operator]

    monkeypatch.setattr(subject, "sigma_deg", sigma)
    return find_least_certain(UP, site, limit_deg=1.5, unix_s=now)


def off(azimuth: FloatArray, towards: float) -> FloatArray:
    return np.abs((azimuth - towards + 180.0) % 360.0 - 180.0)


def test_a_certain_sky_has_no_such_part(monkeypatch: pytest.MonkeyPatch) -> None:
    assert part(monkeypatch, lambda zenith, _: zenith < -1.0) is None


def test_a_low_northern_sky_is_named_and_the_sun_is_never_there(monkeypatch: pytest.MonkeyPatch) -> None:
    found = part(monkeypatch, lambda zenith, azimuth: (zenith > 70.0) & (off(azimuth, 0.0) < 25.0))
    assert found is not None
    assert found.text == "towards the north, below 20° of elevation"
    assert (found.sun_times, found.sun_next) == ((), None)
    assert "night.enabled" in found.remedy(observes_stars=False)
    assert "night.enabled" not in found.remedy(observes_stars=True)


def test_a_ring_at_the_horizon_is_all_round_and_the_sun_is_there_after_it_rises(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    found = part(monkeypatch, lambda zenith, _: zenith > 65.0, now=EQUINOX - 6.0 * 3600.0)
    assert found is not None
    assert found.text == "all round, below 25° of elevation"
    assert len(found.sun_times) == 2
    for first, last in found.sun_times:
        zenith = sun_angles(np.linspace(first, last - 300.0, 20), SITE).apparent_zenith
        assert np.all((zenith > 61.0) & (zenith <= 90.0))
        assert 1.4 * 3600.0 < last - first < 2.6 * 3600.0
    assert found.remedy(observes_stars=False).startswith("it improves with sightings of the sun there, today from ")


def test_hours_that_are_past_are_left_out_and_after_the_last_those_of_tomorrow_are_named(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    # at 97.5 degrees west the equinox's sun rises at 12:37 and sets at 00:42 UTC; the solar day ends at 06:30 UTC
    noon, night = (part(monkeypatch, lambda z, _: z > 65.0, now=EQUINOX + h * 3600.0) for h in (0.0, 9.0))
    assert noon is not None
    assert night is not None
    assert (len(noon.sun_times), noon.sun_is_tomorrow) == (1, False)
    assert noon.sun_times[0][0] > EQUINOX
    assert "today from 22:" in noon.remedy(observes_stars=False)
    assert (len(night.sun_times), night.sun_is_tomorrow) == (2, True)
    assert night.sun_times[0][0] > EQUINOX + 9.0 * 3600.0
    assert "tomorrow from 12:" in night.remedy(observes_stars=False)


def test_a_part_that_the_sun_reaches_in_another_season_has_its_date(monkeypatch: pytest.MonkeyPatch) -> None:
    found = part(monkeypatch, lambda zenith, azimuth: (zenith < 22.0) & (off(azimuth, 180.0) < 180.0))
    assert found is not None
    assert found.text.endswith("above 65° of elevation")
    # at 36.6 degrees north the sun culminates at a zenith angle of 22 degrees where its declination is 14.6: 29 April
    assert found.sun_times == ()
    assert found.sun_next is not None
    assert abs((found.sun_next - datetime(2025, 4, 29, tzinfo=UTC).date()).days) <= 6


def test_two_sides_and_a_side_across_north_are_each_one_range(monkeypatch: pytest.MonkeyPatch) -> None:
    sides = part(monkeypatch, lambda _, azimuth: (off(azimuth, 90.0) < 22.0) | (off(azimuth, 270.0) < 22.0))
    across = part(monkeypatch, lambda zenith, azimuth: (off(azimuth, 0.0) < 68.0) & (zenith > 40.0))
    assert sides is not None
    assert across is not None
    assert sides.text == "towards the east and the west, at all elevations"
    assert across.directions == ("north-west to north-east",)


def test_in_auckland_the_sun_is_in_the_north(monkeypatch: pytest.MonkeyPatch) -> None:
    def northern(zenith: FloatArray, azimuth: FloatArray) -> BoolArray:
        return (zenith > 30.0) & (off(azimuth, 0.0) < 25.0)

    auckland = replace(SITE, latitude=-36.85, longitude=174.76)
    found = part(monkeypatch, northern, auckland)
    assert found is not None
    assert found.sun_times


def test_a_camera_of_few_sightings_far_from_the_centre_is_uncertain_low_down() -> None:
    wide = np.diag([1e-5, 8e-2])
    calibration = chosen_calibration(LENS, names=("k2", "k5"), covariance=wide, orders=ORDERS)
    found = find_least_certain(calibration, SITE, limit_deg=1.5, unix_s=EQUINOX)
    assert found is not None
    assert found.directions == ()
    assert found.from_deg == 0.0
    assert 10.0 <= found.to_deg <= 60.0
