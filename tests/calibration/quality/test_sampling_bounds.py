"""Wilson's lower bound for a finite population, by hand, by its definition and against simulated days."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.optimize import brentq
from scipy.stats import norm

from sunarc.calibration.quality.day_quality import PERIOD_S, DaySampling, fully_observed, measure_sampling


def test_the_bound_is_where_the_score_test_rejects() -> None:
    """Wilson (1927): the p at which (share - p) / sqrt(p (1 - p) f / n) is the 95 % quantile, f for what was missed."""
    sampling = DaySampling(n_observed=40, n_span=200, n_periods=60)
    share, factor = 30.0 / 40.0, 1.0 - 40.0 / 200.0

    def score(p: float) -> float:
        return (share - p) / math.sqrt(p * (1.0 - p) * factor / 40.0) - float(norm.ppf(0.95))

    assert sampling.lowest_share(30) == pytest.approx(float(brentq(score, 0.01, share)), rel=1e-3)


def test_periods_bound_the_independent_samples() -> None:
    many, few = (DaySampling(n_observed=100, n_span=1000, n_periods=n) for n in (100, 5))
    assert few.lowest_share(80) < many.lowest_share(80) - 0.1
    expected = DaySampling(n_observed=5, n_span=50, n_periods=5)
    assert few.lowest_share(80) == pytest.approx(expected.lowest_share(4))


@pytest.mark.parametrize("n_on_arc", [0, 30, 50, 70])
def test_where_all_was_observed_the_share_is_the_bound(n_on_arc: int) -> None:
    assert DaySampling(n_observed=50, n_span=50, n_periods=9).lowest_share(n_on_arc) == min(n_on_arc / 50.0, 1.0)


def test_nothing_observed_has_no_share() -> None:
    assert DaySampling(n_observed=0, n_span=0, n_periods=0).lowest_share(0) == 0.0


def test_the_bound_holds_in_95_percent_of_simulated_days() -> None:
    rng, held = np.random.default_rng(1), []
    for _ in range(1500):
        clear = rng.random(300) < 0.8
        seen = rng.choice(300, 60, replace=False)
        sampling = DaySampling(n_observed=60, n_span=300, n_periods=60)
        held.append(sampling.lowest_share(int(clear[seen].sum())) <= clear.mean())
    assert 0.93 < np.mean(held) < 0.985


def test_slots_and_periods_are_counted_once() -> None:
    times = np.array([0.0, 10.0, 29.9, 30.0, 599.0, 600.0, 1500.0, np.nan])
    found = measure_sampling(times, cadence_s=30.0, n_possible=1000)
    # slots 0, 1, 19, 20, 50; periods of 600 s: 0, 1, 2
    assert (found.n_observed, found.n_span, found.n_periods) == (5, 51, 3)
    assert PERIOD_S == 600.0


def test_the_span_is_no_longer_than_what_is_possible_and_no_shorter_than_what_was_observed() -> None:
    times = 30.0 * np.array([0.0, 1.0, 2.0, 90.0])
    assert measure_sampling(times, cadence_s=30.0, n_possible=20).n_span == 20
    assert measure_sampling(times, cadence_s=30.0, n_possible=2).n_span == 4
    empty = measure_sampling(np.zeros(0), cadence_s=30.0, n_possible=20)
    assert (empty.n_observed, empty.n_span, empty.n_periods) == (0, 0, 0)


def test_a_day_that_counts_as_observed_has_its_share() -> None:
    day = fully_observed(700)
    assert (day.n_observed, day.n_span, day.n_periods) == (700, 700, 700)
    assert day.lowest_share(560) == pytest.approx(0.8)
