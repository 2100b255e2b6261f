from __future__ import annotations

from datetime import date

import numpy as np
import pytest

from sunarc.calibration import DayOptions, SunPoints, decide_day, measure_day
from sunarc.errors import InputError
from sunarc.optics import project
from sunarc.simulation import SGP, true_camera
from sunarc.sky import Site, day_bounds_unix_s, sun_angles, sun_directions

LIMA = Site(latitude=-12.05, longitude=-77.04, altitude=150.0)


def day_of(site: Site, day: date, *, sigma_px: float = 0.003, every_s: float = 300.0) -> SunPoints:
    begin, end = day_bounds_unix_s(day, longitude=site.longitude)
    times = np.arange(begin, end, every_s)
    times = times[sun_angles(times, site).apparent_zenith < 89.6]
    noise = np.random.default_rng(0).normal(0.0, sigma_px, (times.size, 2))
    return SunPoints(unix_s=times, pixels=project(true_camera(), sun_directions(times, site)) + noise)


@pytest.mark.parametrize(
    ("site", "day"),
    [
        pytest.param(SGP, date(2013, 5, 13), id="mid-latitude"),
        pytest.param(LIMA, date(2013, 10, 25), id="sun-through-the-zenith"),
        pytest.param(Site(latitude=78.92, longitude=11.93), date(2013, 5, 13), id="midnight-sun"),
    ],
)
def test_a_precise_clear_day_lies_wholly_on_its_arc(site: Site, day: date) -> None:
    points = day_of(site, day)
    measure = measure_day(points, site=site, n_possible=len(points))
    assert measure.n_on_arc == measure.n == len(points)
    assert decide_day(measure).kind == "clear"


def test_the_scatter_about_the_arc_is_the_noise() -> None:
    points = day_of(SGP, date(2013, 5, 13), sigma_px=0.5, every_s=30.0)
    measure = measure_day(points, site=SGP, n_possible=len(points))
    assert measure.core_sd_px == pytest.approx(0.5, rel=0.1)
    assert measure.rmsd_px == pytest.approx(0.5 * np.sqrt(2.0), rel=0.1)


def test_a_day_of_which_little_was_seen_is_cloudy_or_unusable() -> None:
    points = day_of(SGP, date(2013, 5, 13))
    n = len(points)
    morning = measure_day(points.select(np.arange(0, n // 4)), site=SGP, n_possible=n)
    assert decide_day(morning).kind == "cloudy"
    hour = measure_day(points.select(np.arange(60, 70)), site=SGP, n_possible=n)
    assert decide_day(hour).kind == "unusable"
    assert decide_day(measure_day(points.select([]), site=SGP, n_possible=n)).kind == "unusable"


def test_false_sightings_leave_the_arc_and_make_the_day_partly_clear() -> None:
    points = day_of(SGP, date(2013, 5, 13))
    wrong = np.random.default_rng(1).random(len(points)) < 0.3
    pixels = points.pixels + wrong[:, None] * [12.0, -9.0]
    measure = measure_day(SunPoints(unix_s=points.unix_s, pixels=pixels), site=SGP, n_possible=len(points))
    assert measure.n_on_arc == len(points) - wrong.sum()
    assert decide_day(measure).kind == "partly"


def test_thresholds_that_make_no_sense_are_refused() -> None:
    with pytest.raises(InputError, match="partly_share, clear_share"):
        DayOptions(clear_share=0.2, partly_share=0.5)
