"""The fleet page in a browser: what is wrong with a camera is in words on it, and nothing else is asked."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path

import pytest
from axe_playwright_python.sync_playwright import Axe
from playwright.sync_api import Browser, Page
from tests.api.test_dashboard import browser, in_a_browser, opened, serving_app
from tests.api.test_hub import CHECKS, TOKEN, save_checks
from tests.fixtures.archive import make_empty
from tests.fixtures.fleet import NOW, feed, new_imager, sighting

from sunarc.api.app import create_hub_app
from sunarc.api.options import ApiOptions
from sunarc.api.routes.feed import token_digest
from sunarc.archive.archive import open_archive
from sunarc.archive.fleet.feed_rows import Refusal
from sunarc.runtime.status import StatusSnapshot

pytestmark = [pytest.mark.browser, in_a_browser]


@pytest.fixture
def address(tmp_path: Path) -> Iterator[str]:
    """Serve a hub of three cameras: one with a wrong clock, one that turns slowly, one with nothing."""
    make_empty(tmp_path / "hub.sqlite")
    with open_archive(tmp_path / "hub.sqlite") as archive:
        for number, name in enumerate(("gate", "mast", "roof")):
            archive.feeds.add_token(name, token_digest(TOKEN + name), now=NOW, former_until=NOW)
            with new_imager(tmp_path, name) as imager:
                imager.sightings.add([sighting(number, camera=name)])
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
    return [rows.nth(n).locator("th, td").all_text_contents() for n in range(rows.count())]


def test_an_alarm_of_a_cross_check_is_in_the_headline_the_table_and_its_own_rows(
    chromium: Browser, address: str, tmp_path: Path
) -> None:
    page = opened(chromium, address)
    page.page.wait_for_selector("#checks tr")
    assert "2 of 3" in page.page.inner_text("#verdict")  # a wrong clock, and a quarantine
    shown = [(row[0], row[8]) for row in cells(page.page, "cameras")]
    assert shown == [("roof", "! clock, clock by clouds"), ("mast", "✓ nothing"), ("gate", "· slow turn")]
    assert page.page.locator("#map .degraded").count() == 1
    wrong, slow = cells(page.page, "checks")
    assert wrong == [
        "roof", "! clock, clock by clouds", "2026-05-09", "2.12 ± 0.11 s", "0.00883 ± 0.00047°", "0.0009 ± 0.002°",
        "2.4 ± 0.4 s", "gate",
    ]  # fmt: skip
    assert (slow[0], slow[1], slow[6]) == ("gate", "· slow turn", "–")
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
