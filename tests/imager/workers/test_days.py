"""Days of which slots were missed: judged, refitted and served by what was observed."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from .long_run import CLEAR, CLOUDY, FIRST_DAY, LongRun


@pytest.mark.parametrize(
    ("missed", "begins", "most_observed"), [(0.5, 0.0, 240), (0.85, 0.0, 90), (0.0, 0.4, 260), (0.3, 0.3, 220)]
)
def test_a_clear_day_with_missed_slots_is_clear_and_fitted(
    tmp_path: Path, missed: float, begins: float, most_observed: int
) -> None:
    run = LongRun(tmp_path, seed=4)
    night = run.day(FIRST_DAY, replace(CLEAR, missed=missed, begins=begins))
    (day,) = run.archive.days.find("roof")
    run.archive.close()
    assert day.n_observed is not None
    assert 40 <= day.n_observed <= most_observed
    assert (night.verdict, night.refit) == ("clear", "accepted"), day.reasons
    assert night.error_px <= 0.6  # as of a day of which nothing was missed


def test_a_cloudy_day_with_missed_slots_stays_cloudy(tmp_path: Path) -> None:
    run = LongRun(tmp_path, seed=4, cadence_s=60.0)
    night = run.day(FIRST_DAY, replace(CLOUDY, missed=0.4))
    run.archive.close()
    assert (night.verdict, night.refit) == ("cloudy", "")
