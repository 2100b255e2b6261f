from __future__ import annotations

import asyncio
import re
import shutil
import socket
import threading
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from datetime import timedelta
from pathlib import Path
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np
import pytest
import uvicorn
from axe_playwright_python.sync_playwright import Axe
from playwright.sync_api import Browser, Page, sync_playwright
from tests.fixtures.calibrations import SITE, chosen_calibration
from tests.fixtures.served import LENS, NOON, REFUSED, TOKEN, document, write_image

from sunarc.common.findings import Finding
from sunarc.imager.archive.move_pictures import MovePictures
from sunarc.imager.archive.values import TO_ACKNOWLEDGE, Event, SunPoint
from sunarc.imager.runtime.status import Reason, condition
from sunarc.optics.forward import project
from sunarc.optics.inverse import unproject
from sunarc.sky.sun import sun_directions

if TYPE_CHECKING:
    from tests.fixtures.served import Made

STATIC = Path(__file__).parents[3] / "service" / "sunarc" / "imager" / "web" / "static"
SCRIPTS = sorted(path.name for path in STATIC.glob("*.js") if path.name != "fleet.js")  # of the hub's page
FILES = {
    "/": "text/html",
    "/docs": "text/html",
    "/static/docs/docs.js": "text/javascript",
    "/static/dashboard.css": "text/css",
} | {f"/static/{name}": "text/javascript" for name in SCRIPTS}
CHROMIUM = shutil.which("chromium")
in_a_browser = pytest.mark.skipif(CHROMIUM is None, reason="chromium is not installed")


def code() -> str:
    return "\n".join((STATIC / name).read_text() for name in SCRIPTS)


@pytest.mark.parametrize(("path", "kind"), FILES.items())
def test_the_page_asks_nobody_else(made: Made, path: str, kind: str) -> None:
    answer = made.client.get(path)
    assert answer.status_code == 200
    assert answer.headers["content-type"].startswith(kind)
    assert set(re.findall(r"https?://[^\"' ]+", answer.text)) <= {"http://www.w3.org/2000/svg"}


def test_the_page_keeps_to_its_own_policy(made: Made) -> None:
    page = made.client.get("/").text
    assert not re.search(r"<script(?![^>]*src=)|<style|\sstyle=|\son\w+=", page)
    assert not re.search(r"innerHTML|outerHTML|insertAdjacentHTML|document\.write|\beval\(", code())


def test_every_place_that_the_scripts_fill_is_on_the_page(made: Made) -> None:
    page = made.client.get("/").text
    wanted = set(re.findall(r'\$\("([\w-]+)"\)', code())) | set(re.findall(r'fill(?:Rows|Facts)\("([\w-]+)"', code()))
    assert len(wanted) > 15
    assert wanted <= set(re.findall(r'id="([\w-]+)"', page))


def test_every_route_that_the_scripts_ask_is_served(made: Made) -> None:
    written = re.findall(r'(?:ask|askImage|listen)\(["`](/[^"?`]+)', code())
    names = {"${date}": "{night}", "${event}": "{event_id}", "${side}": "{side}"}
    asked = {re.sub(r"\$\{[\w.]+\}", lambda found: names[found[0]], path) for path in written}
    assert asked <= set(made.client.get("/openapi.json").json()["paths"])
    assert asked >= {"/v1/overlay", "/v1/difference", "/v1/geolocate", "/v1/image/latest", "/v1/events/stream"}


@contextmanager
def serving(made: Made, *, app: Any = None) -> Iterator[str]:  # noqa: ANN401 - an application, or what counts for it
    with serving_app(app or made.app) as address:
        yield address


@contextmanager
def serving_app(app: Any) -> Iterator[str]:  # noqa: ANN401 - an application, or what counts for it
    with socket.create_server(("127.0.0.1", 0)) as listening:
        server = uvicorn.Server(uvicorn.Config(app, log_level="warning"))
        thread = threading.Thread(target=server.run, kwargs={"sockets": [listening]})
        thread.start()
        try:
            yield f"http://127.0.0.1:{listening.getsockname()[1]}/"
        finally:
            server.should_exit = True
            thread.join()


@dataclass
class Opened:
    """A page, what its console said, and whom it asked."""

    page: Page
    complaints: list[str] = field(default_factory=list)
    asked: list[str] = field(default_factory=list)


@contextmanager
def browser() -> Iterator[Browser]:
    with sync_playwright() as playwright:
        arguments = ["--no-sandbox", "--disable-gpu", "--disable-background-networking"]
        chromium = playwright.chromium.launch(executable_path=CHROMIUM, args=arguments)
        try:
            yield chromium
        finally:
            chromium.close()


def opened(chromium: Browser, address: str, *, width: int = 1400, height: int = 1000, dark: bool = False) -> Opened:
    context = chromium.new_context(
        viewport={"width": width, "height": height}, color_scheme="dark" if dark else "light"
    )
    page = Opened(context.new_page())
    page.page.on("console", lambda message: page.complaints.append(message.text))
    page.page.on("pageerror", lambda error: page.complaints.append(str(error)))
    page.page.on("request", lambda request: page.asked.append(request.url))
    page.page.goto(address)
    return page


def words(page: Page, selector: str) -> str:
    """Return a text as it is shown, with common spaces between numbers and their units."""
    return page.inner_text(selector).replace("\u00a0", " ")


def shown(page: Page) -> None:
    for selector in ("#overlay .expected", ".calendar button", "#sigma path", "#by-time .x-mark", "#image[src]"):
        page.wait_for_selector(selector, timeout=30_000, state="attached")


CUT_OFF = """() => [...document.querySelectorAll("main td, main p, main dd")]
  .filter((one) => one.getBoundingClientRect().right > innerWidth).map((one) => one.textContent)"""
CUT_LABELS = """() => [...document.querySelectorAll("svg.plot")].flatMap((plot) => {
  const frame = plot.getBoundingClientRect();
  return [...plot.querySelectorAll("text")].filter((one) => {
    const box = one.getBoundingClientRect();
    return box.left < frame.left - 1 || box.right > frame.right + 1;
  }).map((one) => `${plot.id}: ${one.textContent}`);
})"""
"""Labels of plots that their frame cuts off."""
MARKER = """() => {
  const box = document.querySelector("#overlay path.expected").getBoundingClientRect();
  const image = document.querySelector("#image");
  const frame = image.getBoundingClientRect();
  const x = (box.left + box.width / 2 - frame.left) / frame.width;
  const y = (box.top + box.height / 2 - frame.top) / frame.height;
  return [x * 1748 - 0.5, y * 1748 - 0.5];
}"""


PLACE_OF = """([x, y]) => {
  const frame = document.querySelector("#picture").getBoundingClientRect();
  const part = document.querySelector("#overlay").viewBox.baseVal;
  const at = [(x - part.x) / part.width, (y - part.y) / part.height];
  return [frame.left + at[0] * frame.width, frame.top + at[1] * frame.height, at.every((one) => one > 0 && one < 1)];
}"""


@pytest.fixture
def picture(tmp_path: Path) -> Path:
    """Draw the sky at noon, as large as the camera's image."""
    y, x = np.mgrid[0 : LENS.height, 0 : LENS.width]
    at = project(LENS, sun_directions(NOON.timestamp(), SITE))
    sky = 60.0 + 190.0 * np.exp(-np.hypot(x - at[0], y - at[1]) / 40.0)
    cv2.imwrite(str(tmp_path / "sky_hdr.jpg"), sky.astype(np.uint8))
    return tmp_path / "sky_hdr.jpg"


@pytest.fixture
def pictured(make: Any, made: Made, picture: Path) -> Made:  # noqa: ANN401 - a fixture that is a function
    """Make the application of `made` with a whole picture."""
    whole: Made = make(image=picture, history="filled")
    for worker in made.board.snapshot().workers:
        whole.board.set_worker(worker)
    whole.board.note(last_frame_at=NOON, last_sighting_at=NOON)
    return whole


@pytest.mark.browser
@in_a_browser
def test_the_dashboard_in_a_browser(pictured: Made) -> None:
    sun = project(LENS, sun_directions(NOON.timestamp(), SITE))
    n_operations = sum(map(len, pictured.client.get("/openapi.json").json()["paths"].values()))
    with serving(pictured) as address, browser() as chromium:
        desktop = opened(chromium, address)
        shown(desktop.page)
        assert desktop.page.evaluate(MARKER) == pytest.approx(sun.tolist(), abs=1.0)
        assert desktop.page.get_attribute("#health", "data-health") == "ready"
        assert words(desktop.page, f"#calibrations [data-code={REFUSED.code}]") == REFUSED.text
        shows_conditions_by_their_codes(desktop.page, pictured)
        updates_live(desktop.page, pictured)
        has_a_history(desktop.page)
        can_be_used_by_keyboard(desktop.page)
        can_be_asked(desktop.page, sun.tolist())
        shows_events_by_kind(desktop.page, pictured)
        compares_calibrations(desktop.page)
        is_accessible(desktop.page)
        phone = opened(chromium, address, width=360, height=740, dark=True)
        shown(phone.page)
        assert phone.page.evaluate("document.documentElement.scrollWidth") <= 360
        assert phone.page.evaluate(CUT_OFF) == []
        assert phone.page.evaluate(CUT_LABELS) == []
        is_accessible(phone.page)
        docs = opened(chromium, f"{address}docs", width=360, height=740)
        docs.page.wait_for_selector("#back_project", timeout=30_000)
        assert len(docs.page.query_selector_all(".operation")) == n_operations
        assert "zenith_deg" in words(docs.page, "#back_project")
        assert docs.page.evaluate("document.documentElement.scrollWidth") <= 360
        is_accessible(docs.page)
        docs.page.fill("#search", "height_sigma_m cloud")
        assert docs.page.is_hidden("#back_project")
        assert docs.page.is_visible("#geolocate")
        assert docs.page.is_hidden("#routes a[href='#back_project']")
        docs.page.fill("#search", "")
        assert docs.page.is_visible("#back_project")
        for one in (desktop, phone, docs):
            assert one.complaints == []
            assert {url.split("/")[2] for url in one.asked if not url.startswith("blob:")} == {address.split("/")[2]}


def shows_conditions_by_their_codes(page: Page, made: Made) -> None:
    """Check that a condition is shown with its severity, what to do if anything, and its code."""
    made.board.set_condition("images_unreadable", condition("images_unreadable", error="the disk is gone"))
    made.board.set_condition("no_frame_yet", Reason.of(Finding("not_mirrored"), code="no_frame_yet"))
    unreadable = "#reasons li[data-code=images_unreadable][data-severity=degraded]"
    page.wait_for_selector(f"{unreadable} .action", timeout=10_000)
    assert "since 2013-05-13 09:30" in words(page, f"{unreadable} small")
    assert words(page, f"{unreadable} code") == "images_unreadable"
    page.wait_for_selector("#reasons li[data-code=no_frame_yet]", timeout=10_000)
    assert page.query_selector("#reasons li[data-code=no_frame_yet] .action") is None  # its action is "none"
    assert "[object" not in words(page, "body")
    assert page.get_attribute("#health", "data-health") == "attention"
    made.board.set_condition("images_unreadable", None)
    made.board.set_condition("no_frame_yet", None)
    page.wait_for_selector("#health[data-health=ready]", timeout=10_000)


def updates_live(page: Page, made: Made) -> None:
    """Check that what changes on the board is on the page within seconds, without a reload."""
    made.board.set_worker(replace(made.board.snapshot().workers[0], state="failed", last_error="the cable is cut"))
    made.board.note(last_frame_at=NOON + timedelta(seconds=30))
    page.wait_for_selector("#workers >> text=the cable is cut", timeout=10_000)
    page.wait_for_selector("#facts >> text=18:30:30", timeout=10_000)


def has_a_history(page: Page) -> None:
    """Check that the accepted calibrations are drawn, and only those within the span that is chosen."""
    assert len(page.query_selector_all("#history-sigma .x-mark")) == 2  # of three, one was refused
    assert len(page.query_selector_all("#history-counts .bar")) == 2  # clear and hidden, of one day
    assert len(page.query_selector_all("#history-disk .x-mark")) == 1  # one day
    page.select_option("#history-span", "7")
    assert len(page.query_selector_all("#history-sigma .x-mark")) == 1  # made eight days after the other
    assert words(page, "#history-sum").startswith("1 accepted")
    page.wait_for_selector("#history-disk .x-mark >> nth=2", timeout=10_000)  # now by hour
    assert len(page.query_selector_all("#history-temperature .range")) == 2  # of three hours one has no temperature
    assert "per hour" in words(page, "#temperature-sum")
    assert page.evaluate(CUT_LABELS) == []


def can_be_asked(page: Page, sun: list[float]) -> None:
    """Check that a tap on the enlarged sky is answered for the pixel that is there, with a cloud at the height."""
    page.click("#zoom-in")
    page.click("#zoom-in")
    assert page.evaluate("document.querySelector('#overlay').viewBox.baseVal.width") == pytest.approx(LENS.width / 4.0)
    for _ in range(100):  # the page's policy forbids what wait_for_function does
        if page.evaluate("document.querySelector('#image').naturalWidth") == LENS.width:
            break
        page.wait_for_timeout(100)
    else:
        pytest.fail("the enlarged image was not loaded")
    assert page.evaluate(MARKER) == pytest.approx(sun, abs=1.0)  # the image and what is drawn over it move together
    page.fill("#ask-height", "1500")
    page.locator("#picture").scroll_into_view_if_needed()
    at = page.evaluate(PLACE_OF, [900.0, 860.0])
    assert at[2]
    page.mouse.click(at[0], at[1])
    page.wait_for_selector("#asked dd", timeout=10_000)
    x, y = float(page.input_value("#ask-x")), float(page.input_value("#ask-y"))
    expected = unproject(LENS, np.array([x, y]))
    found = words(page, "#asked")
    zenith, azimuth, sigma = (float(one) for one in re.findall(r"(\d+\.\d+)°", found)[:3])
    assert zenith == pytest.approx(np.degrees(np.arccos(expected[2])), abs=2e-3)
    assert azimuth == pytest.approx(np.degrees(np.arctan2(expected[0], expected[1])) % 360.0, abs=0.02)
    assert 0.001 < sigma < 0.02
    assert "Cloud at 1500 m" in found
    latitude = float(re.findall(r"(\d+\.\d+)° N", found)[0])
    assert latitude == pytest.approx(SITE.latitude + 1500.0 * expected[1] / expected[2] / 111_000.0, abs=1e-4)
    page.click("#zoom-whole")
    assert page.evaluate("document.querySelector('#overlay').viewBox.baseVal.width") == LENS.width


def shows_events_by_kind(page: Page, made: Made) -> None:
    """Check that events are asked for by kind and severity, however many others came since."""
    old = Event(time=NOON - timedelta(days=40), kind="bump", severity="alarm", text="it was moved", camera="roof")
    made.archive.events.add(old)
    for number in range(60):
        time = NOON - timedelta(minutes=number)
        made.archive.events.add(Event(time=time, kind="clock", severity="info", text=f"step {number}", camera="roof"))
    page.fill("#event-kind", "bump")
    page.click("#events-form button")
    # the live page may have shown the event among the others before it was asked for by its kind
    page.wait_for_selector("#events tbody tr:only-child >> text=it was moved", timeout=10_000)
    assert page.is_hidden("#events-older")
    page.fill("#event-kind", "")
    page.select_option("#event-severity", "info")
    page.click("#events-form button")
    page.wait_for_selector("#events >> text=step 49", timeout=10_000)
    page.click("#events-older")
    page.wait_for_selector("#events >> text=step 59", timeout=10_000)


def compares_calibrations(page: Page) -> None:
    """Check that two calibrations are compared, and drawn."""
    page.select_option("#compare-one", "second")
    page.select_option("#compare-other", "first")
    page.click("#compare-form button")
    page.wait_for_selector("#compare path", timeout=10_000)
    assert "differ by 0° RMS" in words(page, "#compare-sum")  # of one camera


def can_be_used_by_keyboard(page: Page) -> None:
    """Check that the tab key reaches what can be done, that focus is seen, and that the keys do it."""
    page.evaluate("document.activeElement.blur()")
    reached = []
    for _ in range(45):
        page.keyboard.press("Tab")
        reached.append(page.evaluate("document.activeElement.className + '#' + document.activeElement.id"))
        assert page.evaluate("getComputedStyle(document.activeElement).outlineStyle") != "none"
        if "cell" in reached[-1]:
            break
    assert reached[0].startswith("skip")
    assert "cell" in reached[-1]
    before = words(page, "#day")
    page.keyboard.press("Enter")
    assert words(page, "#day") != before
    page.focus("input[name=unit]:checked")
    page.keyboard.press("ArrowRight")
    assert "distance, degrees" in words(page, "#by-time-legend")


def is_accessible(page: Page) -> None:
    found = Axe().run(page).response["violations"]
    assert [(one["impact"], one["id"], one["nodes"][0]["html"]) for one in found] == []


class Counting:
    """An application whose answers are counted, head and body, by path."""

    def __init__(self, app: Any) -> None:  # noqa: ANN401 - an application
        self._app = app
        self.bytes: Counter[str] = Counter()
        self.asked: Counter[str] = Counter()

    async def __call__(self, scope: Any, receive: Any, send: Any) -> None:  # noqa: ANN401 - ASGI's
        async def counted(message: Any) -> None:  # noqa: ANN401
            if message["type"] == "http.response.start":
                self.asked[scope["path"]] += 1
                self.bytes[scope["path"]] += 80 + sum(len(name) + len(value) + 4 for name, value in message["headers"])
            elif message["type"] == "http.response.body":
                self.bytes[scope["path"]] += len(message.get("body", b"")) + 8
            await send(message)

        await self._app(scope, receive, counted)


@pytest.mark.browser
@in_a_browser
def test_an_idle_page_loads_little(pictured: Made) -> None:
    """Let 10 minutes pass on the page, with a frame every 30 s, and extrapolate: 0.5 MB/h beside the thumbnails."""
    counting = Counting(pictured.app)
    with serving(pictured, app=counting) as address, browser() as chromium:
        context = chromium.new_context(viewport={"width": 1400, "height": 1000})
        page = context.new_page()
        page.clock.install()
        page.goto(address)
        page.clock.run_for(2000)
        shown(page)
        counting.bytes.clear()
        counting.asked.clear()
        for step in range(20):
            pictured.board.note(last_frame_at=NOON + timedelta(seconds=30 * (step + 1)))
            for _ in range(3):
                page.clock.run_for(10_000)
                page.wait_for_timeout(150)
        for _ in range(20):  # what is asked meanwhile is answered
            page.wait_for_timeout(50)
    hourly = {path: 6 * count for path, count in counting.bytes.items()}
    hourly.pop("/v1/image/latest", 0)  # it is the same all the time, and the browser has it
    assert {"/v1/status", "/v1/events/stream", "/v1/sun", "/v1/sun-points"} <= set(hourly)
    assert 50_000 < sum(hourly.values()) < 1_000_000, hourly
    assert counting.asked["/v1/image/latest"] <= 2  # once in ten minutes: 0.6 MB/h at 100 kB each


@pytest.mark.browser
@in_a_browser
def test_when_the_service_ends_the_page_says_so_within_five_seconds(pictured: Made) -> None:
    with browser() as chromium, socket.create_server(("127.0.0.1", 0)) as listening:
        config = uvicorn.Config(pictured.app, log_level="error", timeout_graceful_shutdown=1)
        server = uvicorn.Server(config)
        thread = threading.Thread(target=server.run, kwargs={"sockets": [listening]})
        thread.start()
        try:
            page = opened(chromium, f"http://127.0.0.1:{listening.getsockname()[1]}/").page
            shown(page)
            assert page.get_attribute("#health", "data-health") != "gone"
        finally:
            server.should_exit = True
            thread.join()
        listening.close()
        page.wait_for_selector("#health[data-health=gone]", timeout=5_000)


class Late:
    """An application whose first answer about all events comes three seconds late."""

    def __init__(self, app: Any) -> None:  # noqa: ANN401 - an application
        self._app = app
        self.late = 0

    async def __call__(self, scope: Any, receive: Any, send: Any) -> None:  # noqa: ANN401 - ASGI's
        if scope.get("path") == "/v1/events" and b"kind=" not in scope["query_string"] and not self.late:
            self.late += 1
            await asyncio.sleep(3.0)
        await self._app(scope, receive, send)


@pytest.mark.browser
@in_a_browser
def test_a_late_answer_replaces_no_newer_one(pictured: Made) -> None:
    pictured.archive.events.add(Event(time=NOON, kind="bump", severity="alarm", text="it was moved", camera="roof"))
    pictured.archive.events.add(Event(time=NOON, kind="clock", severity="info", text="a step", camera="roof"))
    late = Late(pictured.app)
    with serving(pictured, app=late) as address, browser() as chromium:
        page = opened(chromium, address).page
        for _ in range(200):
            if late.late:
                break
            page.wait_for_timeout(50)
        page.fill("#event-kind", "bump")
        page.click("#events-form button")
        page.wait_for_selector("#events >> text=it was moved", timeout=20_000)
        page.wait_for_timeout(4_000)
        assert late.late == 1
        assert len(page.query_selector_all("#events tbody tr")) == 1


def _rejected(number: int) -> SunPoint:
    """Return one of many looks after noon at which something far from the sun was found."""
    return SunPoint(
        camera="roof",
        pose_epoch="roof-1",
        time=NOON + timedelta(seconds=number),
        method="disc",
        accepted=False,
        verdict="cloudy",
        x_px=300.0,
        y_px=300.0 + number,
    )


@pytest.mark.browser
@in_a_browser
def test_what_the_dashboard_sums_up_is_of_the_accepted_sightings_and_of_cycles(make: Any, picture: Path) -> None:  # noqa: ANN401 - a fixture that is a function
    made: Made = make(image=picture, history="filled")
    made.archive.sightings.add(_rejected(number) for number in range(1200))
    days = made.archive.days.find("roof")
    made.archive.days.save(replace(days[0], n=435, n_cycles=379, n_possible=418, decided_at=NOON))
    points = made.client.get("/v1/sun-points?residuals=true&accepted=true").json()["sun_points"]
    rmse = float(np.sqrt(np.mean([point["residual"]["distance_px"] ** 2 for point in points])))
    assert 0.02 < rmse < 0.07
    with serving(made) as address, browser() as chromium:  # of a service that has seen no frame since its start
        page = opened(chromium, address).page
        shown(page)
        summary = words(page, "#residual-sum")
        assert f"last {len(points)} accepted sightings" in summary
        assert float(re.findall(r": ([\d.]+) px", summary)[0]) == pytest.approx(rmse, rel=0.01)
        page.click(f"button[data-date='{days[0].date}']")
        assert "sun seen in 379 of 418 cycles" in words(page, "#day")
        page.click(f"button[data-date='{days[1].date}']")  # of a version that did not count cycles
        assert "700 sightings" in words(page, "#day")
        assert page.is_visible("#image")
        assert "Last sighting at" in words(page, "#sun")
        assert "not yet" not in words(page, "#sun")


@pytest.mark.browser
@in_a_browser
def test_where_reading_needs_a_token_the_page_asks_for_it(make: Any, picture: Path, tmp_path: Path) -> None:  # noqa: ANN401 - a fixture that is a function
    (tmp_path / "reading").write_text("a reading token of this test")
    locked: Made = make(image=picture, history="filled", read_token_file=tmp_path / "reading")
    locked.board.note(last_frame_at=NOON)
    with serving(locked) as address, browser() as chromium:
        page = opened(chromium, address).page
        page.wait_for_selector("#token-form:not([hidden])")
        assert page.get_attribute("#health", "data-health") == "locked"
        page.fill("#token", "a reading token of this test")
        page.keyboard.press("Enter")
        shown(page)
        assert page.is_hidden("#token-form")
        assert "token" not in page.url


@pytest.mark.browser
@in_a_browser
def test_expected_and_seen_are_of_the_time_of_the_picture(make: Any, tmp_path: Path) -> None:  # noqa: ANN401 - a fixture that is a function
    """Show a picture of 18:00 at 18:30: a sighting of 18:00 is drawn, not the last one."""
    taken = NOON - timedelta(minutes=30)
    image = write_image(tmp_path, "20130513T180000.000Z_hdr.jpg")
    made: Made = make(image=image, history="filled", timezone="Pacific/Auckland", is_replay=True)
    made.board.note(last_frame_at=NOON, last_sighting_at=NOON)
    sun = project(LENS, sun_directions(taken.timestamp(), SITE))
    with serving(made) as address, browser() as chromium:
        page = opened(chromium, address).page
        shown(page)
        page.wait_for_selector("#overlay .seen", state="attached")
        both = "2013-05-13 18:00:00 UTC · 2013-05-14 06:00 Pacific/Auckland"
        assert words(page, "#sky-time") == f"Picture taken {both} (30 min ago)"
        assert page.evaluate(MARKER) == pytest.approx(sun.tolist(), abs=1.0)
        assert page.evaluate(MARKER.replace("path.expected", ".seen")) == pytest.approx(sun.tolist(), abs=1.0)
        assert float(np.hypot(*(sun - project(LENS, sun_directions(NOON.timestamp(), SITE))))) > 30.0
        assert re.search(r"\d px apart, 1-sigma 0\.\d+ px per axis", words(page, "#sun"))
        assert "18:30:00 UTC" in words(page, "#replay")


@pytest.mark.browser
@in_a_browser
def test_a_change_of_the_camera_stays_on_top_until_it_is_acknowledged_with_the_token(pictured: Made) -> None:
    moved = Event(
        time=NOON, kind="bump", severity="alarm", text="moved by 2.5°", camera="roof", details={TO_ACKNOWLEDGE: True}
    )
    with serving(pictured) as address, browser() as chromium:
        page = opened(chromium, address).page
        shown(page)
        assert page.is_hidden("#moves")
        pictured.archive.events.add(moved)
        page.wait_for_selector("#moves h2 >> text=moved by 2.5°", timeout=10_000)
        is_accessible(page)
        page.fill("#moves input[type=password]", "not the token")
        page.click("#moves button")
        page.wait_for_selector("#moves [role=status]:not(:empty)")
        page.fill("#moves input[type=password]", TOKEN)
        page.click("#moves button")
        page.wait_for_selector("#moves", state="hidden", timeout=10_000)
    (stored,) = pictured.archive.events.find("roof", kind="bump")
    assert (stored.details["acknowledged_because"], stored.to_acknowledge) == ("seen", False)


@pytest.mark.browser
@in_a_browser
def test_the_pictures_of_a_change_are_shown_as_soon_as_they_are_kept(make: Any, picture: Path, tmp_path: Path) -> None:  # noqa: ANN401 - a fixture that is a function
    kept = MovePictures(tmp_path / "moves")
    made: Made = make(image=picture, moves=kept)
    moved = Event(
        time=NOON, kind="bump", severity="alarm", text="moved by 2.5°", camera="roof", details={TO_ACKNOWLEDGE: True}
    )
    event = made.archive.events.add(moved)
    with serving(made) as address, browser() as chromium:
        page = opened(chromium, address).page
        page.wait_for_selector("#moves h2", timeout=30_000)
        assert page.locator("#moves img").count() == 0
        kept.remember(picture, sighted_at=NOON - timedelta(minutes=5))
        kept.keep(event, picture, sighted_at=NOON + timedelta(minutes=1))
        made.archive.events.add(Event(time=NOON, kind="start", severity="info", text="started"))
        page.wait_for_selector("#moves figcaption >> text=After: 2013-05-13 18:31:00 UTC", timeout=10_000)
        assert page.locator("#moves img").count() == 2


@pytest.mark.browser
@in_a_browser
def test_a_map_with_uncertain_parts_has_classes_and_is_ready_for_a_share_of_the_sky(make: Any, picture: Path) -> None:  # noqa: ANN401 - a fixture that is a function
    made: Made = make(image=picture)
    names = ("principal_point_x_px", "principal_point_y_px", "rotation_x", "rotation_y", "rotation_z", "k2", "k5")
    wide = np.diag([4.0, 4.0, 1e-5, 1e-5, 1e-5, 1e-5, 8e-2])
    known = chosen_calibration(LENS, names=names, covariance=wide, orders=np.array([[1, 1], [2, 1]]))
    written = document("few", solved=known)
    made.archive.calibrations.activate(made.archive.calibrations.add(written).id)
    made.board.note(last_frame_at=NOON)
    found = made.client.get("/v1/uncertainty").json()
    values = [value for row in found["sigma_deg"] for value in row if value is not None]
    assert max(values) > 10.0
    assert 0.3 < found["share_within"] < 0.7
    with serving(made) as address, browser() as chromium:
        page = opened(chromium, address).page
        page.wait_for_selector("#sigma path", state="attached")
        page.wait_for_selector(f"#health-word >> text=Ready for {int(100 * found['share_within'])} % of the sky")
        few = found["share_within"] < 0.5
        assert page.get_attribute("#health", "data-health") == ("attention" if few else "ready")
        assert len(page.query_selector_all("#sigma path[class^=shade]")) == 6
        ends = [float(one) for one in re.findall(r"≤ ([\d.]+)°", words(page, "#sigma-scale"))]
        assert ends == sorted(ends)
        assert max(values) <= ends[-1] < 1.1 * max(values)
