"""What the dashboard shows before the first full fit: the sun found, what to check, the north, and when a fit comes."""

from __future__ import annotations

import re
from dataclasses import replace
from datetime import timedelta
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from playwright.sync_api import Page
from tests.fixtures.calibrations import SITE
from tests.fixtures.served import LENS, NOON, Made, calibration, sightings
from tests.imager.web.test_dashboard import CUT_OFF, browser, in_a_browser, is_accessible, opened, serving, words

from sunarc.calibration.model.result import Verdict
from sunarc.common.findings import Finding
from sunarc.formats.calibration_document import to_document
from sunarc.imager.archive.values import SunPoint
from sunarc.imager.runtime.status import CameraStatus, ClockStatus, Reason, condition
from sunarc.optics.forward import project
from sunarc.sky.sun import sun_directions

FIRST = "#first:not([hidden])"
NORTHS = ((4, 24.0), (6, 11.0), (12, 4.0), (40, 1.3))
"""Sightings, and the 1-sigma of the north of the pose by them, degrees."""


@pytest.fixture
def new(make: Any, tmp_path: Path) -> Made:  # noqa: ANN401 - a fixture that is a function
    """Make an application on a camera that was mounted this morning, with a picture of the sky."""
    y, x = np.mgrid[0 : LENS.height, 0 : LENS.width]
    at = project(LENS, sun_directions(NOON.timestamp(), SITE))
    picture = 60.0 + 190.0 * np.exp(-np.hypot(x - at[0], y - at[1]) / 40.0)
    cv2.imwrite(str(tmp_path / "sky_hdr.jpg"), picture.astype(np.uint8))
    made: Made = make(image=tmp_path / "sky_hdr.jpg")
    made.board.note(
        camera=CameraStatus(name="roof", connected=True, model="Test", serial="1"),
        clock=ClockStatus(synchronised=True, max_error_s=0.01),
        last_frame_at=NOON,
    )
    made.board.set_condition("no_calibration", condition("no_calibration"))
    return made


def see(made: Made, *, since_minutes: float, mirrored: bool = False) -> list[SunPoint]:
    """Store the sun's sightings of the last minutes before noon, a minute apart."""
    lens = replace(LENS, mirrored=mirrored)
    points = [
        point for point in sightings(NOON, every_s=60.0, camera=lens) if point.accepted
        and point.time > NOON - timedelta(minutes=since_minutes)
    ]  # fmt: skip
    made.archive.sightings.add(points)
    made.board.note(last_sighting_at=points[-1].time)
    return points


def serve_first_poses(made: Made) -> None:
    """Serve the poses of the first minutes one after the other, and set the condition of the last."""
    for n, sigma_deg in NORTHS:
        north = {"n": n, "north_sigma_deg": sigma_deg, "top_azimuth_deg": 121.0}
        posed = calibration()
        known = Verdict(accepted=True, findings=(Finding("provisional"), Finding("first_pose", north)))
        written = to_document(
            replace(posed, verdict=known), id=f"pose{n}", camera="roof", state="candidate",
            created_at=NOON - timedelta(minutes=60 - n), valid_from=NOON - timedelta(hours=2), valid_until=None,
            pose_epoch="roof-1", software_version="0.1.0",
        )  # fmt: skip
        made.archive.calibrations.activate(made.archive.calibrations.add(written).id)
    made.board.set_condition("no_calibration", None)
    made.board.set_condition(
        "first_pose_provisional", Reason.of(Finding("first_pose_provisional", {"sigma_deg": 1.6, **north}))
    )


def fact(page: Page, name: str) -> str:
    return words(page, f"#first-facts dt:text-is('{name}') + dd")


@pytest.mark.browser
@in_a_browser
def test_the_first_hours_on_the_page(new: Made) -> None:
    with serving(new) as address, browser() as chromium:
        first = opened(chromium, address)
        page = first.page
        page.wait_for_selector(FIRST, timeout=30_000)
        page.wait_for_selector("#first-checks >> text=36.60° N", timeout=30_000)
        page.wait_for_selector("#first-facts >> text=none of them was evaluated for the sun yet", timeout=30_000)
        assert "clock: synchronised" in words(page, "#first-checks")
        # the day ends at midnight of local mean solar time, 97.485 degrees west: at 6:30 UTC
        assert "evaluated at 2013-05-14 06:29" in fact(page, "First full fit")
        assert "the sun sets at 2013-05-14 01:" in fact(page, "First full fit")
        is_accessible(page)
        last = see(new, since_minutes=2.5)[-1]
        x, y = last.x_px or 0.0, last.y_px or 0.0
        new.board.set_condition("first_sun", condition("first_sun", n=3, least=4, x_px=x, y_px=y))
        page.reload()
        page.wait_for_selector("#first-facts >> text=3 of 4 sightings", timeout=30_000)
        page.wait_for_selector("#first-facts >> text=found 3 times", timeout=30_000)
        assert f"x {x:.0f}, y {y:.0f}" in fact(page, "Sun in the image")
        assert "not yet" in fact(page, "Its path")
        see(new, since_minutes=60.0)
        new.board.set_condition("first_sun", None)
        serve_first_poses(new)
        page.reload()
        page.wait_for_selector("#first-north .x-mark >> nth=3", timeout=30_000, state="attached")
        assert "± 1.3° (1-sigma) after 40 sightings" in fact(page, "North")
        assert "azimuth 121°, south-east" in fact(page, "North")
        assert re.findall(r"[\d.]+", words(page, "#first-north-sum"))[-2:] == ["24", "1.3"]
        assert "provisional" in words(page, "#first-title")
        assert page.query_selector("#overlay .first-way") is not None
        is_accessible(page)
        phone = opened(chromium, address, width=360, height=740, dark=True)
        phone.page.wait_for_selector("#first-north .x-mark", timeout=30_000, state="attached")
        assert phone.page.evaluate("document.documentElement.scrollWidth") <= 360
        assert phone.page.evaluate(CUT_OFF) == []
        is_accessible(phone.page)
        assert first.complaints == phone.complaints == []


@pytest.mark.browser
@in_a_browser
@pytest.mark.parametrize("mirrored", [False, True])
def test_which_way_the_sun_goes_is_said_beside_the_way_it_must_go(new: Made, *, mirrored: bool) -> None:
    today = see(new, since_minutes=140.0, mirrored=mirrored)
    new.archive.sightings.add([replace(one, time=one.time - timedelta(days=1)) for one in today])
    with serving(new) as address, browser() as chromium:
        page = opened(chromium, address).page
        page.wait_for_selector("#first-facts >> text=about the image", timeout=30_000)
        page.wait_for_selector("#first-facts >> text=moves counter-clockwise", timeout=30_000)
        way = fact(page, "Its path")
        assert way.startswith("clockwise" if mirrored else "counter-clockwise")
        assert ("calibration.mirrored" in way) == mirrored
        turned, expected = map(float, re.findall(r"by (?:about )?(\d+)°", way))
        assert turned == pytest.approx(expected, rel=0.5)  # of today alone
        assert "first_pose.lens_prior" in fact(page, "North")


@pytest.mark.browser
@in_a_browser
def test_a_refused_first_pose_is_said_with_its_remedy_and_a_full_fit_ends_the_section(new: Made, made: Made) -> None:
    see(new, since_minutes=20.0)
    refusal = condition("first_pose_refused", reason="the sun moves as in a mirrored image", remedy="reverse X")
    new.board.set_condition("first_pose_refused", refusal)
    with serving(new) as address, browser() as chromium:
        page = opened(chromium, address).page
        page.wait_for_selector("#first-checks .warn >> text=mounting", timeout=30_000)
        assert "reverse X" in words(page, "#first-checks")
    with serving(made) as address, browser() as chromium:
        page = opened(chromium, address).page
        page.wait_for_selector("#overlay .expected", timeout=30_000, state="attached")
        assert page.is_hidden("#first")
