"""Look at the dashboard of a running demo in Chromium: pictures, and how far the drawn sun is from the true one.

    deploy/demo --days 2 --speed 300 --state DIR --port 8080 &
    .venv/bin/python docs/studies/dashboard.py http://127.0.0.1:8080/ DIR/truth.json --into docs

waits until there is a calibration and the sun is up, writes dashboard.png (and with --all dashboard-dark.png and
dashboard-phone.png), and prints the distance of the drawn sun from the true camera's, in px, at which times, what the
console said, whom the page asked, and what axe-core finds hard to use. Beside other work, take a lower speed: a browser
without a graphics card needs some seconds for a picture.
"""

from __future__ import annotations

import argparse
import json
import shutil
from datetime import datetime
from pathlib import Path
from typing import Literal, NamedTuple

import numpy as np
from axe_playwright_python.sync_playwright import Axe
from playwright.sync_api import Browser, Page, ViewportSize, sync_playwright

from sunarc.formats.calibration_document import from_document
from sunarc.optics.forward import project
from sunarc.sky.sun import sun_directions


class Look(NamedTuple):
    """A window, px, and what it asks for."""

    width: int
    height: int
    scheme: Literal["light", "dark"]


LOOKS = {"": Look(1400, 1000, "light"), "-dark": Look(1400, 1000, "dark"), "-phone": Look(390, 844, "light")}
MARKER = """() => {
  const box = document.querySelector("#overlay path.expected").getBoundingClientRect();
  const image = document.querySelector("#image");
  const frame = image.getBoundingClientRect();
  const x = (box.left + box.width / 2 - frame.left) / frame.width;
  const y = (box.top + box.height / 2 - frame.top) / frame.height;
  const part = document.querySelector("#overlay").viewBox.baseVal; // px of the camera; the image may be a thumbnail
  return [part.x + x * part.width, part.y + y * part.height, document.querySelector("#sky-time").dataset.time];
}"""


def main() -> None:
    """Take the pictures and print what was seen."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("url")
    parser.add_argument("truth", type=Path)
    parser.add_argument("--into", type=Path, default=Path())
    parser.add_argument("--all", action="store_true", help="also in dark, and on a phone")
    options = parser.parse_args()
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(
            executable_path=shutil.which("chromium"), args=["--no-sandbox", "--disable-gpu"]
        )
        for name, look in LOOKS.items() if options.all else [("", LOOKS[""])]:
            photograph(browser, options.url, look, truth=options.truth, target=options.into / f"dashboard{name}.png")
        browser.close()


def photograph(browser: Browser, url: str, look: Look, *, truth: Path, target: Path) -> None:
    """Take one picture of the dashboard and print what was seen."""
    viewport = ViewportSize(width=look.width, height=look.height)
    page = browser.new_context(viewport=viewport, color_scheme=look.scheme).new_page()
    said: list[str] = []
    asked: set[str] = set()
    page.on("console", lambda message: said.append(message.text))
    page.on("request", lambda request: asked.add(request.url.split("/")[2]))
    page.goto(url)
    for selector in ("#overlay path.expected", "#by-time .x-mark", "#sigma path"):
        page.wait_for_selector(selector, timeout=900_000, state="attached")
    page.wait_for_timeout(6000)
    off, times = [], []
    for _ in range(5):
        page.wait_for_timeout(2600)
        distance_px, time = off_truth_px(page, truth)
        off.append(distance_px)
        times.append(time)
    page.screenshot(path=target, full_page=True)
    print(f"{target.stem}: drawn sun off the true one by {np.round(off, 2).tolist()} px")
    found = [one["id"] for one in Axe().run(page).response["violations"]]
    print(f"  at {times}; console: {said}; asked: {asked}; axe-core: {found}")


def off_truth_px(page: Page, truth: Path) -> tuple[float, str]:
    """Return how far the drawn sun is from where the true camera has it, px, and at which time."""
    x, y, time = page.evaluate(MARKER)
    unix_s = datetime.fromisoformat(time).timestamp()
    true = from_document(json.loads(truth.read_text()))
    return float(np.hypot(*(project(true.camera, sun_directions(unix_s, true.site)) - (x, y)))), time


if __name__ == "__main__":
    main()
