"""Clocks by the edges of clouds: one cloud field over cameras with clocks and losses of their own."""

from __future__ import annotations

import numpy as np
import pytest

from sunarc.common.array_types import FloatArray
from sunarc.hub.clocks import Lag, clock_offsets
from sunarc.hub.cloud_edges import SunSeries, cloud_lag

TRIANGLE = np.array([[0.0, 0.0], [800.0, 300.0], [-400.0, 900.0]])
HEXAGON = np.array([[0.0, 0.0], [800.0, 300.0], [-400.0, 900.0], [-700.0, -600.0], [500.0, -900.0], [900.0, -200.0]])
NEAR = TRIANGLE / 40.0


def one_sky(rng: np.random.Generator, delays_s: FloatArray, *, lost: float = 0.1) -> list[SunSeries]:
    """Return what cameras see of one row of clouds that reaches each with its delay; some exposures are lost."""
    edges = np.cumsum(rng.uniform(60.0, 1500.0, 60))
    series = []
    for number, delay in enumerate(delays_s.tolist()):
        times = np.arange(0.0, 30_000.0, 30.0) + 7.0 * number
        times = times[rng.random(len(times)) > lost]
        true_s = times - delay
        series.append(SunSeries(unix_s=1.78e9 + times, seen=np.searchsorted(edges, true_s) % 2 == 0))
    return series


@pytest.mark.parametrize("delay_s", [0.0, 2.0, -75.0, 3600.0])
def test_the_lag_of_two_cameras_is_that_of_their_clouds(delay_s: float) -> None:
    rng = np.random.default_rng(1)
    off = []
    for _ in range(20):
        first, second = one_sky(rng, np.array([0.0, delay_s]))
        found = cloud_lag(first, second)
        assert found is not None
        off.append((found[0] - delay_s) / found[1])
    assert np.abs(off).max() < 5.0
    assert 0.3 < np.std(off) < 1.6


def test_a_clear_day_and_two_skies_have_no_lag() -> None:
    rng = np.random.default_rng(2)
    first, second = one_sky(rng, np.zeros(1))[0], one_sky(rng, np.zeros(1))[0]
    assert cloud_lag(first, second) is None
    clear = SunSeries(unix_s=first.unix_s, seen=np.ones(len(first.seen), dtype=bool))
    assert cloud_lag(clear, clear) is None
    nothing = SunSeries(unix_s=np.zeros(0), seen=np.zeros(0, dtype=bool))
    assert cloud_lag(first, nothing) is None


def lags_of(rng: np.random.Generator, clocks: FloatArray, places: FloatArray, *, days: int = 30) -> list[Lag]:
    mean, noise_s = rng.normal(0.0, 0.05, 2), 4.0
    found = []
    for day in range(days):
        arrival = places @ (mean + rng.normal(0.0, 0.1, 2)) + clocks
        arrival = arrival + rng.normal(0.0, noise_s / np.sqrt(2.0), len(places))
        for a in range(len(places)):
            found += [
                Lag(day=day, first=a, second=b, lag_s=float(arrival[b] - arrival[a]), sigma_s=noise_s)
                for b in range(a + 1, len(places))
            ]
    return found


@pytest.mark.parametrize(("places", "sigma_s"), [(TRIANGLE, (30.0, 70.0)), (HEXAGON, (1.0, 6.0)), (NEAR, (0.7, 2.0))])
def test_a_clock_is_found_within_its_stated_error(places: FloatArray, sigma_s: tuple[float, float]) -> None:
    rng = np.random.default_rng(3)
    clocks = np.zeros(len(places))
    clocks[1] = 20.0
    off = []
    for _ in range(30):
        found = clock_offsets(lags_of(rng, clocks, places), east_north_m=places)
        assert sigma_s[0] < found.sigma_s[1] < sigma_s[1]
        off.append((found.offset_s[1] - 20.0) / found.sigma_s[1])
    assert np.abs(np.mean(off)) < 0.6
    assert 0.3 < np.std(off) < 1.5


def test_a_lag_of_another_cloud_is_left_out() -> None:
    rng = np.random.default_rng(4)
    lags = lags_of(rng, np.array([0.0, 5.0, 0.0]), NEAR)
    wild = [Lag(day=40, first=0, second=1, lag_s=3000.0, sigma_s=4.0)]
    found, plain = (clock_offsets(some, east_north_m=NEAR) for some in (lags + wild, lags))
    assert found.n_lags == plain.n_lags
    assert found.offset_s == pytest.approx(plain.offset_s)


def test_cameras_without_lags_have_no_clock() -> None:
    found = clock_offsets([], east_north_m=NEAR)
    assert np.isnan(found.offset_s).all()
    one_pair = [Lag(day=day, first=0, second=2, lag_s=3.0, sigma_s=2.0) for day in range(9)]
    found = clock_offsets(one_pair, east_north_m=NEAR)
    assert np.isnan(found.offset_s).tolist() == [False, True, False]
    assert found.offset_s[2] == pytest.approx(3.0, abs=1.0)
    assert found.offset_s[0] == pytest.approx(-found.offset_s[2])
