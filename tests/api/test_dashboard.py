from __future__ import annotations

import re
import shutil
import socket
import subprocess
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
import uvicorn

if TYPE_CHECKING:
    from tests.api.conftest import Made

FILES = {"/": "text/html", "/static/dashboard.js": "text/javascript", "/static/dashboard.css": "text/css"}
CHROMIUM = shutil.which("chromium")


@pytest.mark.parametrize(("path", "kind"), FILES.items())
def test_the_page_asks_nobody_else(made: Made, path: str, kind: str) -> None:
    answer = made.client.get(path)
    assert answer.status_code == 200
    assert answer.headers["content-type"].startswith(kind)
    assert set(re.findall(r"https?://[^\"' ]+", answer.text)) <= {"http://www.w3.org/2000/svg"}


def test_the_page_keeps_to_its_own_policy(made: Made) -> None:
    page = made.client.get("/").text
    assert not re.search(r"<script(?![^>]*src=)|<style|\sstyle=|\son\w+=", page)
    code = made.client.get("/static/dashboard.js").text
    assert not re.search(r"innerHTML|outerHTML|insertAdjacentHTML|document\.write|\beval\(", code)


def test_every_place_that_the_script_fills_is_on_the_page(made: Made) -> None:
    page, code = made.client.get("/").text, made.client.get("/static/dashboard.js").text
    wanted = set(re.findall(r'\$\("([\w-]+)"\)', code)) | set(re.findall(r'fill(?:Rows|Facts)\("([\w-]+)"', code))
    assert len(wanted) > 15
    assert wanted <= set(re.findall(r'id="([\w-]+)"', page))


def test_every_route_that_the_script_asks_is_served(made: Made) -> None:
    code = made.client.get("/static/dashboard.js").text
    asked = set(re.findall(r'ask\("(/[^"?]+)', code))
    assert asked <= set(made.client.get("/openapi.json").json()["paths"])
    assert "/v1/sun/track" in asked


@contextmanager
def serving(made: Made) -> Iterator[str]:
    with socket.create_server(("127.0.0.1", 0)) as listening:
        server = uvicorn.Server(uvicorn.Config(made.app, log_level="warning"))
        thread = threading.Thread(target=server.run, kwargs={"sockets": [listening]})
        thread.start()
        try:
            yield f"http://127.0.0.1:{listening.getsockname()[1]}/"
        finally:
            server.should_exit = True
            thread.join()


def page_in_browser(address: str, profile: Path) -> tuple[str, list[str]]:
    """Return the page as a browser has made it, and what its console says."""
    assert CHROMIUM is not None
    command = [CHROMIUM, "--headless", "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run"]
    command += ["--disable-background-networking", "--disable-component-update", "--disable-sync"]
    command += [f"--user-data-dir={profile}", "--enable-logging=stderr", "--virtual-time-budget=5000", "--dump-dom"]
    done = subprocess.run([*command, address], capture_output=True, text=True, timeout=60, check=True)
    return done.stdout, [line for line in done.stderr.splitlines() if "CONSOLE" in line]


@pytest.mark.system
@pytest.mark.skipif(CHROMIUM is None, reason="chromium is not installed")
def test_a_browser_shows_the_sun_where_it_is_expected(made: Made, tmp_path: Path) -> None:
    with serving(made) as address:
        page, complaints = page_in_browser(address, tmp_path / "profile")
    assert complaints == []
    assert 'data-health="ready"' in page
    x, y = made.client.get("/v1/sun").json()["pixel"]
    drawn = re.search(r'class="expected"[^>]*transform="translate\(([\d.]+) ([\d.]+)\)', page)
    assert drawn is not None
    assert [float(value) for value in drawn.groups()] == pytest.approx([x, y], abs=1e-6)
    assert page.count('class="x-mark"') > 50
    assert "held-out days disagree by 0.4 px" in page
