"""Sightings as columns, and what of them a fit can use."""

from __future__ import annotations

import math

import numpy as np
import pytest
from numpy.typing import NDArray
from tests.fixtures.calibration import SGP

from sunarc.calibration.model.sightings import Sightings, filter_sightings
from sunarc.common.errors import InputError
from sunarc.optics.camera import inside_image
from sunarc.sky.refraction import ASSUMED_AIR_SD, DAILY_AIR_SD, MEASURED_AIR_SD, refraction_rad
from sunarc.sky.sun import sun_angles, sun_directions

FloatArray = NDArray[np.float64]

NOON = 1_368_403_200.0 + 43_200.0 + 97.484856 * 240.0
"""13 May 2013, local mean solar noon at SGP: day 15 838 since 1970."""


def _points(times: FloatArray, **columns: object) -> Sightings:
    pixels = np.stack([300.0 + 0.01 * (times - NOON), 200.0 + 0.005 * (times - NOON)], axis=-1)
    return Sightings.of(unix_s=times, pixels=pixels, **columns)  # type: ignore[arg-type]


def _around_noon(count: int = 20, *, step_s: float = 600.0) -> FloatArray:
    return np.asarray(NOON + step_s * (np.arange(count, dtype=np.float64) - count // 2))


def test_scalars_are_broadcast_and_columns_cannot_be_written() -> None:
    points = _points(_around_noon(3), sigma_px=0.2, epoch=1)
    assert points.sigma_px.tolist() == [0.2] * 3
    assert points.epoch.tolist() == [1, 1, 1]
    assert points.epoch.dtype == np.int64
    assert np.all(np.isnan(points.clock_error_s))
    assert np.all(np.isnan(points.temperature))
    with pytest.raises(ValueError, match="read-only"):
        points.pixels[0, 0] = 1.0
    with pytest.raises(ValueError, match="read-only"):
        points.unix_s[0] = 1.0


def test_the_columns_are_copies() -> None:
    times = _around_noon(3)
    points = _points(times)
    times[0] = 0.0
    assert points.unix_s[0] != 0.0


def test_no_sightings_are_sightings() -> None:
    points = Sightings.of(unix_s=np.zeros(0), pixels=np.zeros(0))
    assert len(points) == 0
    assert points.pixels.shape == (0, 2)
    assert len(filter_sightings(points, site=SGP)) == 0


def test_a_selection_keeps_the_columns_together() -> None:
    times = _around_noon(4)
    points = _points(times, sigma_px=np.arange(4.0), epoch=np.arange(4), pressure=1e5 + np.arange(4.0))
    some = points.select(np.array([3, 1]))
    assert some.unix_s.tolist() == times[[3, 1]].tolist()
    assert some.sigma_px.tolist() == [3.0, 1.0]
    assert some.epoch.tolist() == [3, 1]
    assert some.pressure.tolist() == [100_003.0, 100_001.0]


@pytest.mark.parametrize(
    "wrong",
    [
        {"epoch": np.array([0.5, 0.0, 0.0])},
        {"epoch": np.array([-1, 0, 0])},
        {"epoch": np.array([np.nan, 0.0, 0.0])},
        {"sigma_px": np.ones(2)},
        {"sigma_px": np.array(["a", "b", "c"])},
        {"clock_error_s": np.ones((3, 1))},
    ],
)
def test_columns_that_are_none_are_refused(wrong: dict[str, object]) -> None:
    with pytest.raises(InputError):
        _points(_around_noon(3), **wrong)


def test_the_usable_ones_are_in_the_order_of_epoch_and_time() -> None:
    times = _around_noon(6)[[3, 1, 5, 0, 2, 4]]
    points = _points(times, epoch=np.array([0, 0, 1, 1, 0, 0]))
    usable = filter_sightings(points, site=SGP)
    assert usable.epoch.tolist() == [0, 0, 0, 0, 1, 1]
    assert np.all(np.diff(usable.unix_s[:4]) > 0)
    np.testing.assert_array_equal(usable.unix_s, times[usable.index])
    np.testing.assert_array_equal(usable.pixels, points.pixels[usable.index])
    np.testing.assert_allclose(usable.directions, sun_directions(usable.unix_s, SGP), atol=1e-12)


def test_what_is_not_finite_doubled_or_below_the_horizon_is_left_out_and_counted() -> None:
    times = np.r_[_around_noon(10), np.nan, np.inf, 1e12, _around_noon(10)[4], NOON + 43_200.0]
    points = _points(times)
    pixels = points.pixels.copy()
    pixels[0, 1] = np.nan
    usable = filter_sightings(Sightings.of(unix_s=times, pixels=np.nan_to_num(pixels, nan=np.nan)), site=SGP)
    assert usable.index.tolist() == list(range(1, 10))
    assert len(usable.filtering.dropped) == 3  # not finite, below the horizon, of a time already there


def test_one_time_may_stand_in_two_epochs() -> None:
    times = np.array([NOON, NOON])
    assert len(filter_sightings(_points(times, epoch=np.array([0, 1])), site=SGP)) == 2
    assert len(filter_sightings(_points(times), site=SGP)) == 1


def test_a_sun_a_degree_below_the_horizon_still_counts() -> None:
    times = NOON + np.arange(0.0, 43_200.0, 20.0)
    usable = filter_sightings(_points(times), site=SGP)
    lowest = sun_angles(usable.unix_s, SGP).apparent_zenith.max()
    assert 90.9 < lowest < 91.1


def test_days_are_local_mean_solar_days() -> None:
    times = NOON + np.array([-86_400.0, 0.0, 86_400.0])
    assert filter_sightings(_points(times), site=SGP).day.tolist() == [15_837, 15_838, 15_839]


def test_sigmas_are_relative_to_their_median_and_bounded() -> None:
    times = _around_noon(7)
    sigma = np.array([0.1, 0.2, 0.2, 0.4, np.nan, 0.001, 100.0])
    usable = filter_sightings(_points(times, sigma_px=sigma), site=SGP)
    # the median of the six stated ones is 0.2
    np.testing.assert_allclose(usable.sigma_px, [0.5, 1.0, 1.0, 2.0, 1.0, 1.0 / 3.0, 10.0])
    np.testing.assert_array_equal(filter_sightings(_points(times), site=SGP).sigma_px, 1.0)
    np.testing.assert_array_equal(filter_sightings(_points(times, sigma_px=-1.0), site=SGP).sigma_px, 1.0)


def test_the_refraction_s_causes_are_the_measured_the_assumed_and_each_day_s_air() -> None:
    times = NOON + np.array([-86_400.0, 0.0, 86_400.0]) + 20_000.0
    usable = filter_sightings(_points(times, temperature=np.array([np.nan, 20.0, np.nan])), site=SGP)
    refraction = refraction_rad(usable.directions, SGP)
    share = usable.refraction_sd / refraction[:, None]
    measured = [MEASURED_AIR_SD, 0.0, 0.0, 0.0, 0.0]
    expected = [
        [0.0, ASSUMED_AIR_SD, DAILY_AIR_SD, 0.0, 0.0],
        measured,
        [0.0, ASSUMED_AIR_SD, 0.0, 0.0, DAILY_AIR_SD],
    ]
    np.testing.assert_allclose(share, expected, atol=1e-12)
    assert (MEASURED_AIR_SD, ASSUMED_AIR_SD, DAILY_AIR_SD) == (0.01, 0.04, 0.015)


def test_a_long_record_has_eight_runs_of_days() -> None:
    times = NOON + 86_400.0 * np.arange(20.0)
    found = filter_sightings(_points(times), site=SGP).refraction_sd
    assert found.shape == (20, 2 + 8)
    assert np.all(np.count_nonzero(found[:, 2:], axis=1) == 1)
    assert np.count_nonzero(found[:, 2:], axis=0).max() == 3


def test_measured_air_moves_the_sun() -> None:
    times = np.array([NOON + 23_000.0])
    plain = filter_sightings(_points(times), site=SGP).directions
    cold = filter_sightings(_points(times, temperature=-30.0, pressure=101_000.0), site=SGP).directions
    assert 1e-5 < float(np.linalg.norm(plain - cold)) < math.radians(0.1)


@pytest.mark.parametrize("beyond_px", [0.0, 2.0])
def test_an_image_ends_with_the_outer_edges_of_its_outer_pixels(beyond_px: float) -> None:
    for inwards, inside in ((0.01, True), (-0.01, False)):
        end = beyond_px - inwards
        places = np.array([[-0.5 - end, 5.0], [5.0, -0.5 - end], [639.5 + end, 5.0], [5.0, 479.5 + end]])
        assert inside_image(places, (640, 480), beyond_px=beyond_px).tolist() == [inside] * 4
