"""Simulated time runs as fast as it is told and leaves out the nights."""

from __future__ import annotations

from datetime import UTC, datetime

import numpy as np
import pytest

from sunarc.lab.simulation.imager import SceneTimeline
from sunarc.lab.simulation.truth import SGP
from sunarc.sky.site import Site
from sunarc.sky.sun import sun_angles

DUSK_S = datetime(2013, 5, 14, 1, 0, tzinfo=UTC).timestamp()


def test_time_runs_speed_times_as_fast_by_day() -> None:
    noon_s = datetime(2013, 5, 13, 18, tzinfo=UTC).timestamp()
    line = SceneTimeline(SGP, start_unix_s=noon_s, speed=300.0)
    assert [line.at(t) for t in (0.0, 1.0, 10.0)] == [noon_s, noon_s + 300.0, noon_s + 3000.0]


def test_nights_are_left_out() -> None:
    line = SceneTimeline(SGP, start_unix_s=DUSK_S, speed=600.0)
    times = np.array([line.at(0.5 * i) for i in range(500)])
    assert np.all(np.diff(times) > 0.0)
    assert np.all(sun_angles(times, SGP).apparent_zenith <= 92.2)
    assert times[-1] - times[0] > 2 * 86_400.0
    assert np.max(np.diff(times)) == pytest.approx(9.75 * 3600.0, abs=600.0)


def test_nights_can_be_kept() -> None:
    line = SceneTimeline(SGP, start_unix_s=DUSK_S, speed=600.0, skip_nights=False)
    assert line.at(36.0) == DUSK_S + 21_600.0


def test_the_polar_night_is_left_out_whole() -> None:
    svalbard = Site(latitude=79.0, longitude=12.0)
    november_s = datetime(2024, 11, 20, 12, tzinfo=UTC).timestamp()
    dawn = datetime.fromtimestamp(SceneTimeline(svalbard, start_unix_s=november_s, speed=1.0).at(0.0), tz=UTC)
    assert datetime(2025, 1, 25, tzinfo=UTC) < dawn < datetime(2025, 2, 20, tzinfo=UTC)


def test_the_midnight_sun_has_no_night() -> None:
    svalbard = Site(latitude=79.0, longitude=12.0)
    may_s = datetime(2024, 5, 20, 12, tzinfo=UTC).timestamp()
    line = SceneTimeline(svalbard, start_unix_s=may_s, speed=3600.0)
    assert [line.at(float(h)) for h in range(30)] == [may_s + 3600.0 * h for h in range(30)]


def test_a_change_of_speed_makes_no_step() -> None:
    noon_s = datetime(2013, 5, 13, 18, tzinfo=UTC).timestamp()
    line = SceneTimeline(SGP, start_unix_s=noon_s, speed=400.0)
    assert line.at(10.0) == noon_s + 4000.0
    line.set_speed(200.0, elapsed_s=10.0)
    assert line.at(10.0) == noon_s + 4000.0
    line.set_speed(100.0, elapsed_s=20.0)
    assert line.at(30.0) == noon_s + 7000.0
