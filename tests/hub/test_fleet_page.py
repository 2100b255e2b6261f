"""The fleet page in a browser: what is wrong with a camera is in words on it, and nothing else is asked."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import replace
from datetime import timedelta
from pathlib import Path
from typing import Any

import pytest
from axe_playwright_python.sync_playwright import Axe
from playwright.sync_api import Browser, Page
from tests.fixtures.archive import make_empty
from tests.fixtures.fleet import NOW, feed, new_imager, sighting
from tests.hub.test_hub import CHECKS, TOKEN, save_checks
from tests.imager.web.test_dashboard import browser, in_a_browser, opened, serving_app

from sunarc.hub.archive import open_hub_archive
from sunarc.hub.feed_routes import token_digest
from sunarc.hub.feeds import FeedStore, HubRun
from sunarc.hub.serving import create_hub_app
from sunarc.imager.archive.feed_rows import FleetCamera, Refusal
from sunarc.imager.runtime.status import StatusSnapshot
from sunarc.imager.web.options import ApiOptions

pytestmark = [pytest.mark.browser, in_a_browser]


@pytest.fixture
def address(tmp_path: Path) -> Iterator[str]:
    """Serve a hub of three cameras: one with a wrong clock, one that turns slowly, one with nothing."""
    make_empty(tmp_path / "hub.sqlite")
    with open_hub_archive(tmp_path / "hub.sqlite") as archive:
        for number, name in enumerate(("gate", "mast", "roof")):
            archive.feeds.add_token(name, token_digest(TOKEN + name), now=NOW, former_until=NOW)
            with new_imager(tmp_path, name) as imager:
                imager.sightings.add([sighting(number, camera=name, time=NOW - timedelta(hours=12))])
                imager.outbox.queue_status(
                    {"health": "ready", "disk_free_bytes": 8e10, "clock_error_s": 0.01, "drift_deg": 0.002}
                )
                feed(imager, archive, name)
        archive.feeds.refuse(
            camera="mast", installation="5f1d", refusal=Refusal(reason="second_installation", text="two"), now=NOW
        )
        save_checks(archive, *CHECKS)
        status = StatusSnapshot(version="1", started_at=NOW)
        app = create_hub_app(archive=archive, status=lambda: status, now=lambda: NOW, options=ApiOptions())
        with serving_app(app) as served:
            yield served


@pytest.fixture
def chromium() -> Iterator[Browser]:
    with browser() as found:
        yield found


def cells(page: Page, table: str) -> list[list[str]]:
    rows = page.locator(f"#{table} tr")
    texts = (rows.nth(n).locator("th, td").all_text_contents() for n in range(rows.count()))
    return [[text.replace("\u00a0", " ") for text in row] for row in texts]  # of numbers and their units


def test_an_alarm_of_a_cross_check_is_in_the_headline_the_table_and_its_own_rows(
    chromium: Browser, address: str, tmp_path: Path
) -> None:
    page = opened(chromium, address)
    page.page.wait_for_selector("#checks tr")
    assert "2 of 3" in page.page.inner_text("#verdict")  # the third is not calibrated: that is a start
    shown = [(row[0], row[9]) for row in cells(page.page, "cameras")]
    assert shown == [("roof", "! clock, clock by clouds"), ("mast", "✓ nothing"), ("gate", "· slow turn")]
    assert page.page.locator("#map .attention").count() == 2
    assert "clock 2.12 ± 0.11 s ahead since 2026-05-09: by 3 neighbours" in cells(page.page, "cameras")[0][2]
    wrong, slow = cells(page.page, "checks")
    assert wrong == [
        "roof", "! clock, clock by clouds", "2026-05-09", "3 of 4, 0.98", "2.12 ± 0.11 s",
        "0.00883 ± 0.00047°", "0.0009 ± 0.002°",
        "2.4 ± 0.4 s", "gate, mast, yard, pole",
    ]  # fmt: skip
    assert (slow[0], slow[1], slow[7]) == ("gate", "· slow turn", "–")
    assert re.findall(r"\d+", page.page.inner_text("#checks-about")) == ["2026", "05", "14", "3", "1"]
    assert page.complaints == []
    assert all(asked.startswith(address) for asked in page.asked)
    page.page.screenshot(path=tmp_path / "fleet.png", full_page=True)


@pytest.mark.parametrize("dark", [False, True])
def test_everyone_can_read_it_on_a_telephone_too(chromium: Browser, address: str, dark: bool) -> None:  # noqa: FBT001
    for width in (1400, 390):
        page = opened(chromium, address, width=width, dark=dark)
        page.page.wait_for_selector("#checks tr")
        found = Axe().run(page.page)
        assert found.response["violations"] == [], found.generate_report()
        assert page.page.evaluate("document.documentElement.scrollWidth") <= width


ILL: dict[str, tuple[dict[str, Any], dict[str, Any]]] = {
    "silent": ({"received_at": NOW - timedelta(hours=2)}, {}),
    "not_ready": ({}, {"health": "not_ready", "conditions": ["camera_lost"]}),
    "drift": ({}, {"drift_deg": 3.02}),
    "no_sighting": ({"last_sighting_at": NOW - timedelta(days=9)}, {}),
    "disk": ({}, {"disk_free_bytes": 0}),
    "calibration_uncertain": ({"sky_rms_deg": 0.9}, {}),
    "quarantine": ({"n_quarantined": 3}, {}),
    "uncalibrated": ({"calibration": None, "calibrated_at": None, "sky_rms_deg": None}, {}),
}
"""Codes of eight that are ill in eight ways, and what of them is not as it is to be; neighbours show a ninth."""


def of_fleet(number: int, changes: dict[str, Any], reported: dict[str, Any]) -> FleetCamera:
    status = {"health": "ready", "conditions": [], "drift_deg": 0.004, "disk_free_bytes": 8e10, "clock_error_s": 0.01}
    values = {
        "camera": f"station-{number:02d}",
        "latitude": 36.6 + 0.05 * (number // 8),
        "longitude": -97.5 + 0.06 * (number % 8),
        "altitude": 318.0,
        "received_at": NOW - timedelta(seconds=20),
        "last_sighting_at": NOW - timedelta(hours=12),
        "calibration": "a",
        "calibrated_at": NOW,
        "sky_rms_deg": 0.012 + 0.001 * number,
        "status_at": NOW,
    }
    return FleetCamera(**{**values, "status": status | reported, **changes})


@pytest.fixture
def fifty(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[str]:
    """Serve a hub of fifty cameras: every sixth of the first ones is ill, and by its neighbours the last."""
    ill = {6 * n + 1: changes for n, changes in enumerate(ILL.values())}
    cameras = tuple(of_fleet(number, *ill.get(number, ({}, {}))) for number in range(50))
    hubs = tuple(HubRun(address=f"fleet:{port}", version="0.4.0", started_at=NOW) for port in (8080, 8081))
    monkeypatch.setattr(FeedStore, "fleet", lambda _self: cameras)
    monkeypatch.setattr(FeedStore, "hubs", lambda _self: hubs)
    make_empty(tmp_path / "hub.sqlite")
    with open_hub_archive(tmp_path / "hub.sqlite") as archive:
        save_checks(
            archive, *(replace(one, camera=f"station-{n}") for one, n in zip(CHECKS, (47, 48, 49), strict=True))
        )
        status = StatusSnapshot(version="1", started_at=NOW)
        app = create_hub_app(archive=archive, status=lambda: status, now=lambda: NOW, options=ApiOptions())
        with serving_app(app) as served:
            yield served


def test_of_fifty_cameras_nine_that_are_ill_in_nine_ways_are_named_first_on_one_screen(
    chromium: Browser, fifty: str, tmp_path: Path
) -> None:
    for width in (1440, 390):
        page = opened(chromium, fifty, width=width)
        page.page.wait_for_selector("#cameras tr")
        assert page.page.evaluate("document.documentElement.scrollWidth") <= width
        page.page.screenshot(path=tmp_path / f"fleet-{width}.png", full_page=True)
        if width == 1440:
            assert "8 of 50" in page.page.inner_text("#verdict")
            assert "2 hubs" in page.page.inner_text("#headline")
            rows = cells(page.page, "cameras")
            assert [bool(row[2] != "–") for row in rows] == [True] * 9 + [False] * 41
            assert {row[1].split(" ", 1)[1] for row in rows[9:]} == {"ready"}
            bottom = page.page.evaluate("document.querySelector('#cameras').getBoundingClientRect().bottom")
            assert bottom <= 900.0
        assert page.complaints == []
