"""A day is judged by the slots in which the sun was observed, and missed slots are no clouds."""

from __future__ import annotations

import importlib.util
import sys
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING

import numpy as np
import pytest
from tests.fixtures.finding_codes import codes

from sunarc.calibration.model.sightings import Sightings
from sunarc.calibration.quality.day_quality import DaySampling, DayVerdict, decide_day, measure_day, measure_sampling

if TYPE_CHECKING:
    from numpy.typing import NDArray
    from tests.fixtures.clear_day import Simulated

STUDY = Path(__file__).parents[3] / "docs" / "studies" / "missed_slots.py"


@pytest.fixture(scope="module")
def study() -> ModuleType:
    specification = importlib.util.spec_from_file_location("missed_slots", STUDY)
    assert specification is not None
    assert specification.loader is not None
    module = importlib.util.module_from_spec(specification)
    sys.modules["missed_slots"] = module
    specification.loader.exec_module(module)
    return module


def verdict(day: Simulated, *, observed: NDArray[np.bool_], seen: NDArray[np.bool_]) -> DayVerdict:
    points: Sightings = day.points.select(observed & seen)
    times = day.points.unix_s[observed]
    return decide_day(measure_day(points, site=day.site, observed_unix_s=times, cadence_s=120.0))


def every(day: Simulated) -> NDArray[np.bool_]:
    return np.ones(len(day.points), dtype=bool)


def test_a_clear_day_of_which_nine_tenths_of_the_slots_were_missed_is_clear(clear_day: Simulated) -> None:
    observed = np.zeros(len(clear_day.points), dtype=bool)
    observed[np.random.default_rng(3).choice(observed.size, 45, replace=False)] = True
    found = verdict(clear_day, observed=observed, seen=every(clear_day))
    assert found.kind == "clear"
    assert codes(found.findings)[:2] == ["day_share_on_arc", "day_slots_missed"]
    assert found.findings[0].data == {"share": 1.0, "n_observed": 45}


def test_a_day_that_began_at_three_in_the_afternoon_counts_for_what_it_has(clear_day: Simulated) -> None:
    afternoon = np.arange(len(clear_day.points)) > 0.7 * len(clear_day.points)
    assert verdict(clear_day, observed=afternoon, seen=every(clear_day)).kind == "clear"
    half_cloudy = np.arange(len(clear_day.points)) % 2 == 0
    assert verdict(clear_day, observed=afternoon, seen=half_cloudy).kind == "partly"


def test_clouds_in_observed_slots_are_clouds(clear_day: Simulated) -> None:
    observed = np.arange(len(clear_day.points)) % 2 == 0
    seen = np.random.default_rng(4).random(len(clear_day.points)) < 0.2
    assert verdict(clear_day, observed=observed, seen=seen).kind == "cloudy"


def test_clouds_exactly_in_the_observed_slots_leave_nothing_to_use(clear_day: Simulated) -> None:
    observed = np.arange(len(clear_day.points)) % 2 == 0
    assert verdict(clear_day, observed=observed, seen=~observed).kind == "unusable"


def test_too_few_observed_slots_do_not_make_a_clear_day_and_the_reason_says_so(clear_day: Simulated) -> None:
    observed = np.zeros(len(clear_day.points), dtype=bool)
    observed[np.random.default_rng(3).choice(observed.size, 25, replace=False)] = True
    seen = every(clear_day)
    seen[np.flatnonzero(observed)[[5, 15]]] = False
    found = verdict(clear_day, observed=observed, seen=seen)
    assert found.kind == "partly"
    assert (found.findings[-1].code, found.findings[-1].data["n_observed"]) == ("day_share_uncertain", 25)


@pytest.mark.parametrize(
    ("sampling", "n_on_arc", "low", "high"),
    [
        (DaySampling(n_observed=400, n_span=400, n_periods=80), 320, 0.8, 0.8),  # all observed: nothing to infer
        (DaySampling(n_observed=200, n_span=400, n_periods=80), 170, 0.78, 0.81),
        (DaySampling(n_observed=45, n_span=400, n_periods=40), 45, 0.93, 0.95),
        (DaySampling(n_observed=60, n_span=800, n_periods=2), 60, 0.3, 0.5),  # two bursts are two samples
        (DaySampling(n_observed=0, n_span=0, n_periods=0), 0, 0.0, 0.0),
    ],
)
def test_the_lower_bound_knows_how_many_independent_samples_there_are(
    sampling: DaySampling, n_on_arc: int, low: float, high: float
) -> None:
    assert low <= sampling.lowest_share(n_on_arc) <= high


def test_exposures_of_one_slot_count_once_and_unknown_times_not_at_all() -> None:
    found = measure_sampling(np.array([30.5, 31.0, np.nan, 95.0, 1000.0]), cadence_s=30.0, n_possible=20)
    assert found == DaySampling(n_observed=3, n_span=20, n_periods=2)


def test_false_and_right_clear_days_of_the_study(study: ModuleType) -> None:
    for pattern, judged in study.table(40, seed=2).items():
        (false, cloudy), (right, clear) = study.false_clear(judged), study.clear_found(judged)
        assert cloudy >= 8, pattern
        assert false == 0, pattern
        needed = {"first and last 15 min": 0.0, "25 slots": 0.6, "first and last hour": 0.6}.get(pattern, 0.85)
        assert right >= needed * clear, pattern
