"""What a day's sightings are worth, and the image circle."""

from __future__ import annotations

from dataclasses import replace
from datetime import date, timedelta
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from sunarc.calibration.model.sightings import Sightings
from sunarc.calibration.quality.day_arcs import arc_length_deg, smooth_arc
from sunarc.calibration.quality.day_quality import DayMeasure, days_left_out, decide_day, measure_day
from sunarc.common.errors import InputError
from sunarc.imaging.image_circle import find_image_circle
from sunarc.sky.site import Site

if TYPE_CHECKING:
    from tests.fixtures.clear_day import Simulated, Simulator

    from sunarc.calibration.quality.day_quality import DayKind


def test_a_clear_day_is_clear(clear_day: Simulated) -> None:
    measure = measure_day(clear_day.points, site=clear_day.site, cadence_s=120.0)
    assert measure.date == "2013-05-13"
    assert measure.n_on_arc == pytest.approx(measure.n_possible, abs=12)
    assert measure.sd_px < 0.2
    assert measure.arc_deg > 170.0
    assert decide_day(measure).kind == "clear"


def test_clouds_make_it_partly_cloudy_or_unusable(clear_day: Simulated) -> None:
    kinds = []
    for share in (0.4, 0.85, 0.98):
        kept = np.random.default_rng(1).random(len(clear_day.points)) > share
        measure = measure_day(clear_day.points.select(kept), site=clear_day.site, cadence_s=120.0)
        kinds.append(decide_day(measure).kind)
    assert kinds == ["partly", "cloudy", "unusable"]


def test_outliers_do_not_bend_the_arc(clear_day: Simulated) -> None:
    pixels = clear_day.points.pixels.copy()
    bad = np.random.default_rng(2).random(pixels.shape[0]) < 0.25
    pixels[bad] += [8.0, -5.0]
    measure = measure_day(Sightings.of(unix_s=clear_day.points.unix_s, pixels=pixels), site=clear_day.site)
    assert measure.n_on_arc == pytest.approx(int(np.sum(~bad)), abs=6)


def test_midnight_sun_is_one_day(simulator: Simulator) -> None:
    site = Site(latitude=79.0, longitude=12.0)
    seen = simulator(site=site)
    measure = measure_day(seen.points, site=site, cadence_s=120.0)
    assert measure.n_possible == 720
    assert decide_day(measure).kind == "clear"


def test_a_bracket_counts_as_one_cycle(clear_day: Simulated) -> None:
    some = clear_day.points.select(slice(0, None, 2))
    again = Sightings.of(unix_s=some.unix_s + 0.5, pixels=some.pixels)
    both = Sightings.of(
        unix_s=np.concatenate([some.unix_s, again.unix_s]), pixels=np.concatenate([some.pixels, again.pixels])
    )
    measure = measure_day(both, site=clear_day.site, cadence_s=120.0)
    assert measure.n == 2 * len(some)
    assert measure.n_cycles == pytest.approx(len(some), abs=3)
    assert decide_day(measure).kind == "partly"  # every second cycle, however many frames each has


def test_a_day_on_which_the_camera_was_moved_has_two_arcs(clear_day: Simulated) -> None:
    half = np.arange(len(clear_day.points)) >= len(clear_day.points) // 2
    pixels = clear_day.points.pixels + np.where(half[:, None], [3.0, 2.0], 0.0)
    moved = Sightings.of(unix_s=clear_day.points.unix_s, pixels=pixels, epoch=half.astype(np.int64))
    measure = measure_day(moved, site=clear_day.site, cadence_s=120.0)
    assert decide_day(measure).kind == "clear"
    assert measure.sd_px < 0.2


def test_a_doubtful_clock_makes_a_day_unusable_and_says_so(clear_day: Simulated) -> None:
    doubt = np.where(np.arange(len(clear_day.points)) % 3 > 0, 60.0, 0.01)
    points = Sightings.of(unix_s=clear_day.points.unix_s, pixels=clear_day.points.pixels, clock_error_s=doubt)
    verdict = decide_day(measure_day(points, site=clear_day.site, cadence_s=120.0))
    assert verdict.kind == "unusable"
    (found,) = verdict.findings
    assert found.code == "day_clock_uncertain"
    assert float(found.data["share"]) == pytest.approx(0.67, abs=0.01)


def test_the_solid_angle_is_that_of_the_band_that_was_seen(clear_day: Simulated) -> None:
    whole = measure_day(clear_day.points, site=clear_day.site, cadence_s=120.0)
    half = measure_day(clear_day.points.select(slice(0, None, 1)).select(slice(0, 200)), site=clear_day.site)
    assert whole.solid_angle_sr == pytest.approx(np.radians(whole.arc_deg) * np.radians(2.0), rel=0.4)
    assert half.solid_angle_sr < 0.7 * whole.solid_angle_sr


def test_a_fit_leaves_cloudy_days_out_unless_there_is_nothing_better() -> None:
    first = date(1970, 1, 2)
    kinds: tuple[DayKind, ...] = ("clear", "cloudy", "unusable", "partly")
    assert days_left_out({first + timedelta(days=i): kind for i, kind in enumerate(kinds)}) == (2, 3)
    assert days_left_out({first: "cloudy", date(1970, 1, 5): "unusable"}) == (4,)
    assert days_left_out({}) == ()


def test_no_sightings_are_unusable(clear_day: Simulated) -> None:
    nothing = clear_day.points.select(slice(0, 0))
    assert decide_day(measure_day(nothing, site=clear_day.site)).kind == "unusable"


def test_image_circle_is_found_to_a_pixel() -> None:
    y, x = np.mgrid[0:900, 0:1100]
    distance = np.hypot(x - 563.3, y - 441.7)
    sky = np.where(distance < 398.5, 90.0 + 40.0 * np.cos(distance / 300.0), 6.0)
    image = np.clip(sky + np.random.default_rng(0).normal(0.0, 2.0, sky.shape), 0.0, 255.0).astype(np.uint8)
    image[300:320, 600:620] = 255
    circle = find_image_circle(image)
    assert circle is not None
    assert (circle.x, circle.y) == pytest.approx((563.3, 441.7), abs=1.0)
    assert circle.radius == pytest.approx(398.5, abs=1.5)


def test_a_frame_without_a_circle_has_none() -> None:
    assert find_image_circle(np.full((600, 600), 40, dtype=np.uint8)) is None


def test_what_is_no_frame_is_refused() -> None:
    with pytest.raises(InputError):
        find_image_circle(np.zeros(10))


@pytest.mark.parametrize(("first", "last"), [(-1.5, 1.5), (0.9, 1.4), (-1.4, -0.9), (2.9, 3.4)])
def test_an_arc_of_ninth_order_is_met_exactly_at_any_time_of_the_day(first: float, last: float) -> None:
    angle = np.linspace(first, last, 80)
    share = np.linspace(-1.0, 1.0, 80)
    pixels = np.stack([300.0 + 200.0 * share**9 - 90.0 * share**4, 150.0 * share - 80.0 * share**8], axis=-1)
    wrapped = (angle + np.pi) % (2.0 * np.pi) - np.pi
    arc, residual, weight = smooth_arc(pixels, wrapped)
    np.testing.assert_allclose(arc, pixels, atol=1e-8)
    np.testing.assert_allclose(residual, 0.0, atol=1e-8)
    assert np.all(weight > 0.99)


@pytest.mark.parametrize(("clock_error_s", "doubtful"), [(1.9, 0.0), (2.1, 1.0)])
def test_a_clock_is_doubtful_from_two_seconds_on(clear_day: Simulated, clock_error_s: float, doubtful: float) -> None:
    """The sky turns by 15.04 arc seconds a second: 0.008 degrees in 2 s."""
    some = clear_day.points.select(slice(0, None, 20))
    points = Sightings.of(unix_s=some.unix_s, pixels=some.pixels, clock_error_s=np.array(clock_error_s))
    assert measure_day(points, site=clear_day.site).doubtful_clock == doubtful


def test_a_tenth_of_doubtful_sightings_that_were_left_out_is_told_and_leaves_the_day_clear(
    clear_day: Simulated,
) -> None:
    kept = clear_day.points.select(np.arange(len(clear_day.points)) % 10 > 0)
    measure = measure_day(kept, site=clear_day.site, cadence_s=120.0, doubtful_clock=0.1)
    assert (measure.doubtful_clock, measure.n, decide_day(measure).kind) == (0.1, len(kept), "clear")
    nothing = measure_day(kept.select(slice(0, 0)), site=clear_day.site, doubtful_clock=1.0)
    assert (nothing.doubtful_clock, decide_day(nothing).kind) == (1.0, "unusable")


@pytest.mark.parametrize(
    ("changed", "kind", "last"),
    [
        ({}, "clear", "day_scatter"),
        ({"n_on_arc": 20}, "clear", "day_scatter"),
        ({"n_on_arc": 19}, "unusable", "day_too_few_sightings"),
        ({"arc_deg": 15.1}, "clear", "day_scatter"),
        ({"arc_deg": 14.9}, "unusable", "day_arc_too_short"),
        ({"doubtful_clock": 0.49}, "clear", "day_scatter"),
        ({"doubtful_clock": 0.51}, "unusable", "day_clock_uncertain"),
        ({"n_cycles": 80}, "clear", "day_scatter"),
        ({"n_cycles": 79}, "partly", "day_scatter"),
        ({"n_cycles": 30}, "partly", "day_scatter"),
        ({"n_cycles": 29}, "cloudy", "day_share_on_arc"),
        ({"sd_px": 1.4}, "clear", "day_scatter"),
        ({"sd_px": 1.6}, "partly", "day_scatter"),
        ({"lowest_share": 0.81}, "clear", "day_scatter"),
        ({"lowest_share": 0.79}, "partly", "day_share_uncertain"),
        ({"n_possible": 101, "n_cycles": 20}, "cloudy", "day_slots_missed"),
        ({"n_possible": 99, "n_cycles": 20}, "cloudy", "day_share_on_arc"),
    ],
)
def test_a_day_is_of_a_kind_by_what_was_measured(changed: dict[str, Any], kind: str, last: str) -> None:
    usual = DayMeasure(
        n=100, n_on_arc=90, n_cycles=90, n_possible=100, n_observed=100, lowest_share=0.9, sd_px=0.2, arc_deg=120.0,
        doubtful_clock=0.0,
    )  # fmt: skip
    found = decide_day(replace(usual, **changed))
    assert (found.kind, found.findings[-1].code) == (kind, last)


def test_a_gap_of_a_day_s_way_counts_as_five_degrees() -> None:
    angle = np.radians([0.0, 4.0, 9.1, 20.0, 22.0])
    directions = np.stack([np.cos(angle), np.sin(angle), np.zeros(5)], axis=-1)
    assert arc_length_deg(directions) == pytest.approx(4.0 + 5.0 + 5.0 + 2.0, abs=1e-9)
