"""Poor data get a refused verdict with reasons, malformed input one InputError; nothing else."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pytest
from tests.fixtures.clear_day import SGP
from tests.fixtures.finding_codes import codes

from sunarc.calibration.calibrate import calibrate
from sunarc.calibration.model.options import CalibrationOptions, ImageCircle, LensTolerances, PaperOptions
from sunarc.calibration.model.sightings import Sightings
from sunarc.common.errors import InputError
from sunarc.sky.site import Site

if TYPE_CHECKING:
    from tests.fixtures.clear_day import Simulated, Simulator

SIZE = (1748, 1748)


def _refused(points: Sightings, site: Site) -> list[str]:
    found = calibrate(points, site=site, image_size=SIZE)
    assert not found.verdict.accepted
    assert found.verdict.findings
    return codes(found.verdict.findings)


def test_no_sightings(clear_day: Simulated) -> None:
    assert _refused(Sightings.of(unix_s=np.zeros(0), pixels=np.zeros((0, 2))), clear_day.site) == ["too_few_sightings"]


def test_too_few_sightings(clear_day: Simulated) -> None:
    assert "too_few_sightings" in _refused(clear_day.points.select(slice(0, 8)), clear_day.site)


def test_one_minute_only(clear_day: Simulated) -> None:
    times = clear_day.points.unix_s[200] + np.linspace(0.0, 60.0, 60)
    pixels = clear_day.points.pixels[200] + np.linspace(0.0, 0.3, 60)[:, None]
    assert "arc_too_short" in _refused(Sightings.of(unix_s=times, pixels=pixels), clear_day.site)


def test_all_on_one_pixel(clear_day: Simulated) -> None:
    pixels = np.full_like(clear_day.points.pixels, 800.0)
    assert _refused(Sightings.of(unix_s=clear_day.points.unix_s, pixels=pixels), clear_day.site) == ["static_sightings"]


def test_nothing_but_nan(clear_day: Simulated) -> None:
    pixels = np.full_like(clear_day.points.pixels, np.nan)
    assert "dropped_not_finite" in _refused(Sightings.of(unix_s=clear_day.points.unix_s, pixels=pixels), clear_day.site)


def test_duplicate_times_count_once(clear_day: Simulated) -> None:
    times = np.repeat(clear_day.points.unix_s[:10], 30)
    assert "dropped_duplicate_time" in _refused(Sightings.of(unix_s=times, pixels=np.zeros((300, 2))), clear_day.site)


def test_random_pixels(clear_day: Simulated) -> None:
    pixels = np.random.default_rng(0).uniform(0.0, 1748.0, clear_day.points.pixels.shape)
    _refused(Sightings.of(unix_s=clear_day.points.unix_s, pixels=pixels), clear_day.site)


def test_some_nan_and_some_doubles_do_no_harm(clear_day: Simulated) -> None:
    times = np.r_[clear_day.points.unix_s, clear_day.points.unix_s[:5], np.nan]
    pixels = np.r_[clear_day.points.pixels, clear_day.points.pixels[:5], [[3.0, 4.0]]]
    found = calibrate(Sightings.of(unix_s=times, pixels=pixels), site=clear_day.site, image_size=SIZE)
    assert found.verdict.accepted, found.verdict.reasons
    assert {"dropped_not_finite", "dropped_duplicate_time"} <= set(codes(found.verdict.findings))


@pytest.mark.parametrize("swapped", [False, True])
def test_a_mirrored_track_says_so(clear_day: Simulated, swapped: bool) -> None:  # noqa: FBT001
    x, y = clear_day.points.pixels.T
    pixels = np.stack([y, x] if swapped else [SIZE[0] - 1 - x, y], axis=1)
    found = calibrate(Sightings.of(unix_s=clear_day.points.unix_s, pixels=pixels), site=clear_day.site, image_size=SIZE)
    assert not found.verdict.accepted
    first = found.verdict.findings[0]
    assert (first.code, first.data["mirrored"]) in {
        ("other_handedness_fits", "yes"),
        ("other_handedness_alone_fits", "yes"),
    }


def test_what_is_refused_for_another_reason_is_not_called_mirrored(clear_day: Simulated) -> None:
    late = Sightings.of(unix_s=clear_day.points.unix_s + 3600.0, pixels=clear_day.points.pixels)
    assert "other_handedness_fits" not in _refused(late, clear_day.site)


def test_an_image_size_that_is_too_large_is_doubted(clear_day: Simulated) -> None:
    right = calibrate(clear_day.points, site=clear_day.site, image_size=SIZE)
    assert "image_size_doubtful" not in codes(right.verdict.findings)
    found = calibrate(clear_day.points, site=clear_day.site, image_size=(2048, 2048))
    assert "image_size_doubtful" in codes(found.verdict.findings)


def test_times_an_hour_off_say_what_else_would_explain_it(clear_day: Simulated) -> None:
    late = Sightings.of(unix_s=clear_day.points.unix_s + 3600.0, pixels=clear_day.points.pixels)
    assert "camera_tilted_by_clock" in _refused(late, clear_day.site)


@pytest.mark.parametrize(("latitude", "longitude", "hours"), [(-1.0, 1.0, 0.0), (1.0, -1.0, 0.0), (1.0, 1.0, 3.0)])
def test_a_sun_below_the_horizon_tells_a_wrong_site_or_clock(
    clear_day: Simulated, latitude: float, longitude: float, hours: float
) -> None:
    site, points = clear_day.site, clear_day.points
    wrong = Site(latitude=latitude * site.latitude, longitude=longitude * site.longitude, altitude=site.altitude)
    late = Sightings.of(unix_s=points.unix_s + 3600.0 * hours, pixels=points.pixels)
    assert "sightings_below_horizon" in _refused(late, wrong)


def test_a_few_false_sightings_after_sunset_do_no_harm(clear_day: Simulated) -> None:
    times = np.r_[clear_day.points.unix_s, clear_day.points.unix_s[-1] + 3600.0 + 60.0 * np.arange(5.0)]
    pixels = np.r_[clear_day.points.pixels, 200.0 + 50.0 * np.arange(10.0).reshape(5, 2)]
    found = calibrate(Sightings.of(unix_s=times, pixels=pixels), site=clear_day.site, image_size=SIZE)
    assert found.verdict.accepted, found.verdict.reasons
    assert "dropped_below_horizon" in codes(found.verdict.findings)


def test_an_hour_of_sun_is_too_little_for_a_first_fit(simulator: Simulator) -> None:
    day = simulator(sigma_px=0.5, cadence_s=60.0).points
    assert "direction_sigma_too_large" in _refused(day.select(slice(420, 480)), SGP)
    found = calibrate(day, site=SGP, image_size=SIZE)
    assert found.verdict.accepted
    assert found.sky_rms_deg < 0.3


def test_sightings_beside_the_image_are_left_out(clear_day: Simulated) -> None:
    times, pixels = clear_day.points.unix_s, clear_day.points.pixels.copy()
    pixels[7, 0] = SIZE[0] - 0.46
    found = calibrate(Sightings.of(unix_s=times, pixels=pixels), site=clear_day.site, image_size=SIZE)
    assert found.verdict.accepted
    assert {one.code: one.data for one in found.verdict.findings}["dropped_outside_image"] == {"n": 1}
    assert found.left_out is not None
    assert 7 in found.left_out


@pytest.mark.parametrize(
    ("times", "pixels"),
    [(np.zeros(3), np.zeros((2, 2))), (np.zeros(3), np.zeros((3, 3))), (np.zeros((3, 1)), np.zeros((3, 2)))],
)
def test_columns_that_do_not_belong_together(times: np.ndarray, pixels: np.ndarray) -> None:
    with pytest.raises(InputError):
        Sightings.of(unix_s=times, pixels=pixels)


def test_impossible_choices() -> None:
    for wrong in ({"method": "magic"}, {"projection": "mercator"}, {"mirrored": "perhaps"}, {"max_rmse_px": -1.0}):
        with pytest.raises(InputError):
            CalibrationOptions(**wrong)
    with pytest.raises(InputError):
        LensTolerances(radial_px=0.0)
    with pytest.raises(InputError):
        PaperOptions(pose_start="guess")  # type: ignore[arg-type]
    with pytest.raises(InputError):
        ImageCircle(x=1.0, y=2.0, radius=-3.0)


def test_no_image_size(clear_day: Simulated) -> None:
    with pytest.raises(InputError):
        calibrate(clear_day.points, site=clear_day.site, image_size=(0, 10))
