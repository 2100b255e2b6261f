"""A newcomer's afternoon, as an example in Python and in the shell: short, and the same answers from both."""

from __future__ import annotations

import math
import re
import shutil
import subprocess
import sys
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import cv2
import numpy as np
import pytest
from tests.fixtures.served import LENS, NOON, archives, make
from tests.imager.web.test_event_stream import quick, serving

from sunarc.imager.archive.images import ImageStore
from sunarc.optics.inverse import unproject

if TYPE_CHECKING:
    from tests.fixtures.served import Made, Make

__all__ = ["archives", "make", "quick"]

EXAMPLES = Path(__file__).parents[2] / "docs" / "examples"
COMMANDS = {"afternoon.py": [sys.executable], "afternoon.sh": ["sh"]}
MOST_LINES = {"afternoon.py": 30, "afternoon.sh": 60}


@pytest.fixture
def served(make: Make, tmp_path: Path) -> Made:
    store = ImageStore(tmp_path / "images", free_bytes=lambda _: 10**12)
    sky = np.full((LENS.height, LENS.width, 3), 90, dtype=np.uint8)
    for kind in ("hdr.png", "hdr.jpg"):
        store.write(NOON, cv2.imencode(kind[3:], sky)[1].tobytes(), kind=kind)
    made: Made = make(history="filled", images=store)
    return made


@pytest.fixture
def another(served: Made) -> Iterator[None]:
    """Make another calibration current again and again, until the test ends: whoever waits for one hears of it."""
    ended = threading.Event()

    def change() -> None:
        number = 0
        while not ended.wait(0.5):
            served.archive.calibrations.reinstate(("first", "second")[number % 2], at=NOON, reason="a test")
            number += 1

    thread = threading.Thread(target=change)
    thread.start()
    yield
    ended.set()
    thread.join()


@pytest.mark.usefixtures("another")
@pytest.mark.parametrize("name", COMMANDS)
def test_an_afternoons_work(served: Made, tmp_path: Path, name: str) -> None:
    script = EXAMPLES / name
    assert len(script.read_text().splitlines()) <= MOST_LINES[name]
    if name.endswith(".sh") and not (shutil.which("curl") and shutil.which("jq")):
        pytest.skip("curl or jq is not installed")
    with serving(served) as address:
        done = subprocess.run(
            [*COMMANDS[name], script, address, tmp_path], capture_output=True, text=True, check=False, timeout=60.0
        )
    assert done.returncode == 0, done.stderr
    sizes = {path: cv2.imread(str(tmp_path / path)).shape[:2] for path in ("newest.png", "sun_mask.png", "sky.png")}  # type: ignore[union-attr]
    assert sizes == {"newest.png": (1748, 1748), "sun_mask.png": (1748, 1748), "sky.png": (1024, 1024)}
    said = dict(line.split(": ", 1) for line in done.stdout.splitlines())
    assert list(said) == ["direction", "cloud", "shadow", "calibration"]
    numbers = {key: [float(one) for one in re.findall(r"-?\d+\.\d+", text)] for key, text in said.items()}
    up = float(unproject(LENS, np.array([0.52 * LENS.width, 0.4 * LENS.height]))[2])
    assert numbers["direction"][0] == pytest.approx(math.degrees(math.acos(up)), abs=1e-3)
    assert 0.0 < numbers["direction"][2] < 0.02
    for place in ("cloud", "shadow"):
        assert numbers[place][:2] == pytest.approx([36.604, -97.485], abs=0.02)
        assert 0.0 < numbers[place][2] < 100.0
    assert re.fullmatch(r"(first|second)(-r\d+)?", said["calibration"])
