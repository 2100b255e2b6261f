"""What the first screen says of each state of a camera, in a browser: `tests.release.drills` serves the states."""

from __future__ import annotations

import re

import pytest
from tests.imager.web.test_dashboard import browser, in_a_browser, opened, words
from tests.release.drills import served

pytestmark = [pytest.mark.browser]
_BROKEN = r"\d (px|°|s|min|h|MB|GB|%)\b|\d ± | ± \d"
"""A number, a common space, and its unit: it may be broken between them."""


@in_a_browser
def test_by_night_the_first_sentence_says_so_and_when_the_sun_is_seen_again() -> None:
    with served("night") as address, browser() as chromium:
        page = opened(chromium, address).page
        page.wait_for_selector("#sky-now:not(:empty)", timeout=30_000)
        said = words(page, "#sky-now")
        assert said.startswith("Night at the camera, the sun 34° below the horizon: stars are observed until dawn")
        assert re.search(
            r"next image with the sun is expected at 2013-05-14 11:\d\d UTC · 06:\d\d America/Chicago", said
        )
        assert page.is_hidden("#state-text")
        page.wait_for_selector("#sky-time >> text=Last picture by day", timeout=30_000)


@in_a_browser
def test_a_sky_that_is_certain_in_part_says_where_it_is_not_and_what_improves_it() -> None:
    with served("photographs_map") as address, browser() as chromium:
        page = opened(chromium, address).page
        page.wait_for_selector("#improves:not(:empty)", timeout=30_000)
        assert re.fullmatch(r"Ready for \d\d % of the sky", words(page, "#health-word"))
        assert words(page, "#state-text") == "1-sigma is above 1.5° all round, below 35° of elevation"
        assert words(page, "#improves").startswith("it improves with sightings of the sun there, today from 22:")


@in_a_browser
def test_the_pixel_that_is_expected_by_a_doubtful_clock_names_the_clock() -> None:
    with served("clock") as address, browser() as chromium:
        page = opened(chromium, address).page
        page.wait_for_selector("#sun >> text=by a clock", timeout=30_000)
        sigma_px = float(re.findall(r"± ([\d.]+) px, by a clock that is right within 16 s", words(page, "#sun"))[0])
        assert 0.5 < sigma_px < 5.0


@in_a_browser
@pytest.mark.parametrize("width", [1440, 768, 390])
def test_what_to_do_after_a_move_and_its_button_stand_before_the_pictures(width: int) -> None:
    with served("bump") as address, browser() as chromium:
        page = opened(chromium, address, width=width, height=844).page
        page.wait_for_selector("#moves img", timeout=30_000)
        tops = [page.locator(one).first.bounding_box() for one in ("#moves .action", "#moves button", "#moves img")]
        assert all(tops)
        places = [one["y"] for one in tops if one]
        assert places == sorted(places)
        assert places[1] < 844
        assert "only where others rely on its old direction" in words(page, "#moves .action")
        assert "api.token_file" in words(page, "#moves form")
        assert "pose estimated 25 min ago" in words(page, "#headline")
        assert page.query_selector("#reasons [data-code=camera_moved]") is None  # said once


@in_a_browser
def test_a_camera_that_sent_no_image_is_not_said_to_have_missed_the_sun() -> None:
    with served("fresh") as address, browser() as chromium:
        page = opened(chromium, address).page
        page.wait_for_selector("#first-facts >> text=no image has come from the camera", timeout=30_000)
        assert page.get_attribute("#reasons li >> nth=0", "data-code") == "no_frame_yet"
        assert "sunarc points import" in page.inner_text("#reasons li >> nth=1")
        checks = words(page, "#first-checks")
        assert "camera: not known yet" in checks
        assert "the mark is" not in checks
        assert "`" not in page.inner_text("body")


@in_a_browser
def test_the_exposures_of_a_lost_camera_wait_for_it() -> None:
    with served("gone") as address, browser() as chromium:
        page = opened(chromium, address).page
        page.wait_for_selector("#workers >> text=waiting for the camera", timeout=30_000)
        assert len(page.query_selector_all("#workers >> text=waiting for the camera")) == 1


@in_a_browser
def test_without_its_camera_a_service_answers_directions_and_says_so() -> None:
    with served("gone") as address, browser() as chromium:
        page = opened(chromium, address).page
        page.wait_for_selector("#state-text >> text=no new frames come", timeout=30_000)
        assert words(page, "#state-text").endswith("directions are answered with the last calibration")


@in_a_browser
def test_after_a_change_of_focus_no_uncertainty_of_the_lens_before_is_shown() -> None:
    with served("lens") as address, browser() as chromium:
        page = opened(chromium, address).page
        page.wait_for_selector("#headline >> text=no calibration serves", timeout=30_000)
        assert "no calibration since" in words(page, "#state-text")
        assert "uncertainty" not in words(page, "header")


@in_a_browser
def test_a_full_disk_says_what_stops_and_what_goes_on() -> None:
    with served("full_disk") as address, browser() as chromium:
        page = opened(chromium, address, width=390).page
        page.wait_for_selector("#state-text >> text=No composite is kept", timeout=30_000)
        assert "sightings, calibration and answers go on" in words(page, "#state-text")
        page.wait_for_selector("#sun >> text=±", timeout=30_000)
        for place in ("header", "#reasons", "#sun", "#facts", "#sky-time", "#residual-sum"):
            assert re.search(_BROKEN, page.inner_text(place)) is None
