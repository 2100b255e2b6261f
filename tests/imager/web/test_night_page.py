"""The nights over HTTP and on the dashboard: the picture, the names in it, the verdicts in the calendar, the charts."""

from __future__ import annotations

import re
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from playwright.sync_api import Page
from pydantic import TypeAdapter
from tests.fixtures.nights import judged
from tests.fixtures.served import LENS, Made, write_image
from tests.imager.web.test_dashboard import (
    CUT_LABELS,
    CUT_OFF,
    browser,
    in_a_browser,
    is_accessible,
    opened,
    serving,
    words,
)
from tests.imager.web.test_nights import NUMBERS, PARTS

from sunarc.common.findings import Finding
from sunarc.imager.archive.images import DiskOptions, ImageStore
from sunarc.imager.archive.values import NightBand, NightSeries
from sunarc.imager.workers.night.images import night_picture, store_picture

MIDNIGHT = datetime(2013, 5, 13, 6, 0, tzinfo=UTC)
BODIES: list[dict[str, Any]] = [
    {"body": "moon", "title": "Moon", "pixel": [500.0, 1300.0], "magnitude": -9.0, "found": None, "lit": 0.2},
    {"body": "saturn", "title": "Saturn", "pixel": [900.0, 1250.0], "magnitude": 0.4, "found": True},
    {"body": "star:HIP69673", "title": "Arcturus", "pixel": [700.0, 800.0], "magnitude": 0.0, "found": True},
    {"body": "star:HIP91262", "title": "Vega", "pixel": [1200.0, 700.0], "magnitude": 0.2, "found": False},
    {"body": "star:HIP5", "title": "HIP 5", "pixel": [1000.0, 400.0], "magnitude": 3.2, "found": True},
]


@pytest.fixture
def store(tmp_path: Path) -> ImageStore:
    """Return a store with the picture of one night."""
    store = ImageStore(tmp_path / "images", options=DiskOptions(keep_free_mb=64.0))
    rng = np.random.default_rng(1)
    sky = rng.poisson(150.0, (LENS.height, LENS.width)).astype(np.float64)
    for one in BODIES:
        x, y = (round(value) for value in one["pixel"])
        sky[y - 3 : y + 4, x - 3 : x + 4] += 3000.0 * 10.0 ** (-0.2 * max(one["magnitude"], 0.0))
    picture = night_picture(np.clip(sky, 0, 4095).astype(np.uint16), MIDNIGHT, 5)
    store_picture(store, picture, BODIES, calibration="second", image_size=(LENS.width, LENS.height))
    return store


@pytest.fixture
def nightly(make: Any, store: ImageStore, tmp_path: Path) -> Made:  # noqa: ANN401 - a fixture that is a function
    """Make an application on a filled archive with three nights, the middle one with a picture."""
    made: Made = make(image=write_image(tmp_path), history="filled", images=store)
    for day, verdict in ((11, "cloudy"), (12, "clear"), (13, "moonlit")):
        date, time = f"2013-05-{day}", datetime(2013, 5, day, 12, tzinfo=UTC) + timedelta(days=1)
        why = (Finding("night_images", {"n": 46, "images": 48, "cloud_fraction": 0.1}),)
        images = {**PARTS["images"], "time": [f"{date}T05:00:00Z", f"{date}T06:00:00Z"]}
        images = {name: (column * 2)[:2] for name, column in images.items()}
        series = TypeAdapter(NightSeries).validate_python(images)
        parts: dict[str, Any] = {"zenith_bands": (NightBand(**PARTS["zenith_bands"][0]),), "images": series}
        made.archive.nights.save(judged(date, at=time, verdict=verdict, findings=why, **NUMBERS, **parts))
    return made


def test_the_picture_of_a_night_and_the_names_in_it_are_served(nightly: Made) -> None:
    answer = nightly.client.get("/v1/nights/2013-05-12/image")
    assert answer.headers["content-type"] == "image/jpeg"
    assert answer.headers["sunarc-time"] == "2013-05-13T06:00:00Z"
    picture = cv2.imdecode(np.frombuffer(answer.content, np.uint8), cv2.IMREAD_UNCHANGED)
    assert picture is not None
    assert picture.shape == (1024, 1024)
    again = nightly.client.get("/v1/nights/2013-05-12/image", headers={"if-none-match": answer.headers["etag"]})
    assert (again.status_code, again.content) == (304, b"")
    bodies = nightly.client.get("/v1/nights/2013-05-12/bodies").json()
    assert (bodies["calibration"], bodies["image_size"]) == ("second", [LENS.width, LENS.height])
    assert [{**one, "lit": one.get("lit")} for one in BODIES] == bodies["bodies"]
    listed = nightly.client.get("/v1/nights").json()["nights"]
    assert {night["night"]: night["picture"] for night in listed} == {
        "2013-05-13": False, "2013-05-12": True, "2013-05-11": False,
    }  # fmt: skip
    for path in ("image", "bodies"):
        assert nightly.client.get(f"/v1/nights/2013-05-11/{path}").status_code == 404
        assert nightly.client.get(f"/v1/nights/2013-05-13/{path}").status_code == 404
        assert nightly.client.get(f"/v1/nights/yesterday/{path}").status_code == 422


def test_a_damaged_file_of_names_is_no_internal_error(nightly: Made, store: ImageStore) -> None:
    ((_, path),) = store.between(kind="night.json", limit=1)
    path.write_text("{")
    assert nightly.client.get("/v1/nights/2013-05-12/bodies").status_code == 503


def test_the_pictures_of_nights_are_no_composites_and_go_with_their_age(nightly: Made, store: ImageStore) -> None:
    assert nightly.client.get("/v1/images").json()["images"] == []
    assert store.usage().images_bytes > 1000
    taken, time = datetime(2013, 5, 13, 6, tzinfo=UTC), MIDNIGHT + timedelta(hours=12)
    nightly.archive.nights.save(judged("2013-05-12", at=time, verdict="clear", picture_time=taken, **NUMBERS))
    assert [one["picture"] for one in nightly.client.get("/v1/nights").json()["nights"]] == [False, True, False]
    assert store.expire(MIDNIGHT + timedelta(days=1)) == 2
    assert [one["picture"] for one in nightly.client.get("/v1/nights").json()["nights"]] == [False, False, False]
    assert nightly.client.get("/v1/nights/2013-05-12/image").status_code == 404


AT = """([x, y]) => {
  const frame = document.querySelector("#night-picture").getBoundingClientRect();
  const part = document.querySelector("#night-overlay").viewBox.baseVal;
  const at = [(x - part.x) / part.width, (y - part.y) / part.height];
  return [frame.left + at[0] * frame.width, frame.top + at[1] * frame.height];
}"""


@pytest.mark.browser
@in_a_browser
def test_a_night_on_the_page(nightly: Made) -> None:
    with serving(nightly) as address, browser() as chromium:
        desktop = opened(chromium, address)
        page = desktop.page
        page.wait_for_selector("#night:not([hidden]) #night-facts dd", timeout=60_000)
        assert "2013-05-13" in words(page, "#night-title")
        assert page.is_hidden("#night-picture")  # of this one there is none
        assert page.is_hidden("#night-said")
        assert page.is_hidden("#night-legend")
        assert [one.inner_text() for one in page.query_selector_all(".calendar .night")] == ["☾", "☁", "★"]  # by week
        page.click(".calendar .night.clear")
        page.wait_for_selector("#night-overlay .night-found >> nth=2", timeout=60_000, state="attached")
        assert len(page.query_selector_all("#night-overlay .night-missed")) == 1
        assert len(page.query_selector_all("#night-overlay .night-other")) == 1
        assert {one.text_content() for one in page.query_selector_all("#night-overlay text")} == {"Moon", "Saturn"}
        assert "3 of 4 bright stars" in words(page, "#night-said")
        facts = words(page, "#night-facts")
        assert "0.05 mag fainter at its end" in facts
        assert "11 sightings in 12 slots" in facts
        assert "–" not in facts.replace("0–30°", "")  # what is not known is left out
        names_what_is_pointed_at(page)
        assert len(page.query_selector_all("#nights-limits .x-mark")) == 3
        assert len(page.query_selector_all("#night-limits .x-mark")) == 2
        assert page.evaluate(CUT_LABELS) == []
        is_accessible(page)
        phone = opened(chromium, address, width=360, height=740, dark=True)
        phone.page.wait_for_selector(".calendar .night.clear", timeout=60_000)
        phone.page.click(".calendar .night.clear")
        phone.page.wait_for_selector("#night-overlay .night-missed", timeout=60_000, state="attached")
        assert phone.page.evaluate("document.documentElement.scrollWidth") <= 360
        assert phone.page.evaluate(CUT_OFF) == []
        is_accessible(phone.page)
        assert desktop.complaints + phone.complaints == []  # of a night without a picture none is requested


def names_what_is_pointed_at(page: Page) -> None:
    """Check that pointing, tapping and the keys name a star, and that nothing near names nothing."""
    page.locator("#night-picture").scroll_into_view_if_needed()
    x, y = page.evaluate(AT, [1205.0, 705.0])
    page.mouse.move(x, y)
    page.wait_for_selector("#night-said >> text=Vega (HIP 91262): magnitude 0.2, predicted there, not detected")
    x, y = page.evaluate(AT, [695.0, 805.0])
    page.mouse.click(x, y)
    page.wait_for_selector("#night-said >> text=Arcturus")
    assert "Arcturus" in {one.text_content() for one in page.query_selector_all("#night-overlay text")}
    page.focus("#night-body")
    page.select_option("#night-body", label="Moon")
    page.wait_for_selector("#night-said >> text=20 % lit")
    x, y = page.evaluate(AT, [1600.0, 1600.0])
    page.mouse.click(x, y)
    page.wait_for_selector("#night-said >> text=3 of 4 bright stars")


@pytest.mark.browser
@in_a_browser
def test_a_night_without_a_calibration_on_the_page(make: Any, store: ImageStore, tmp_path: Path) -> None:  # noqa: ANN401
    made: Made = make(image=write_image(tmp_path), history="filled", images=store)
    store_picture(store, night_picture(np.eye(64, dtype=np.uint16), MIDNIGHT, 9), [], calibration=None, image_size=None)
    why = (Finding("night_without_calibration"),)
    made.archive.nights.save(judged("2013-05-12", at=MIDNIGHT + timedelta(hours=5), findings=why, n_images=45))
    with serving(made) as address, browser() as chromium:
        desktop = opened(chromium, address)
        page = desktop.page
        page.wait_for_selector("#night-said >> text=no star is identified", timeout=60_000)
        assert page.is_visible("#night-picture")
        assert page.is_hidden("#night-legend")
        facts = words(page, "#night-facts")
        assert re.search(r"\b45\b", facts)
        assert [word for word in ("–", "NaN", "undefined", "null", "0 of 0") if word in facts] == []
        assert page.is_hidden("#nights-course")
        assert desktop.complaints == []
        is_accessible(page)
