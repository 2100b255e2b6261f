"""What a day's sightings are worth, and the image circle."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pytest

from sunarc.calibration import SunPoints, decide_day, find_image_circle, measure_day
from sunarc.errors import InputError
from sunarc.sky import Site

if TYPE_CHECKING:
    from tests.calibration.conftest import Simulated, Simulator


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
    measure = measure_day(SunPoints(unix_s=clear_day.points.unix_s, pixels=pixels), site=clear_day.site)
    assert measure.n_on_arc == pytest.approx(int(np.sum(~bad)), abs=6)
    assert measure.core_sd_px < 0.1


def test_midnight_sun_is_one_day(simulator: Simulator) -> None:
    site = Site(latitude=79.0, longitude=12.0)
    seen = simulator(site=site)
    measure = measure_day(seen.points, site=site, cadence_s=120.0)
    assert measure.n_possible == 720
    assert decide_day(measure).kind == "clear"


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
