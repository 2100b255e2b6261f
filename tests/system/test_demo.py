"""The whole chain, as a newcomer runs it: two processes, GigE Vision between them, a day, a served calibration."""

from __future__ import annotations

import json
import shutil
import sqlite3
import subprocess
import sys
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tests.fixtures.ports import free_port

from sunarc.formats.calibration_document import from_document
from sunarc.optics.forward import project
from sunarc.sky.directions import direction_from_angles
from sunarc.sky.sun import sun_angles, sun_directions

ROOT = Path(__file__).parents[2]

pytestmark = [pytest.mark.gige, pytest.mark.system, pytest.mark.slow, pytest.mark.timeout(1900)]


@dataclass(frozen=True)
class Result:
    state: Path
    printed: str

    def document(self, name: str) -> dict[str, Any]:
        loaded: dict[str, Any] = json.loads((self.state / name).read_text())
        return loaded


@pytest.fixture(scope="module")
def demo(tmp_path_factory: pytest.TempPathFactory) -> Result:
    state = tmp_path_factory.mktemp("demo")
    command = [
        *(sys.executable, str(ROOT / "deploy" / "demo.py"), "--headless", "--until-calibrated"),
        *("--days", "1", "--speed", "500", "--cadence", "240", "--state", str(state), "--port", str(free_port())),
    ]
    done = subprocess.run(command, capture_output=True, text=True, timeout=1800, check=False)  # slowed on a busy host
    assert done.returncode == 0, done.stdout + done.stderr
    return Result(state, done.stdout)


def off_truth_px(demo: Result, direction_enu: np.ndarray[Any, np.dtype[np.float64]]) -> float:
    served = from_document(demo.document("calibration.json")).camera
    true = from_document(demo.document("truth.json")).camera
    apart = project(served, direction_enu) - project(true, direction_enu)
    return float(np.sqrt(np.mean(np.sum(apart**2, axis=-1))))


def test_the_served_calibration_is_the_true_camera_on_the_suns_track(demo: Result) -> None:
    site = from_document(demo.document("calibration.json")).site
    times = 1_368_403_200.0 + np.arange(0.0, 86_400.0, 60.0) + 6 * 3600.0
    up = sun_angles(times, site).apparent_zenith < 89.6
    assert off_truth_px(demo, sun_directions(times[up], site)) <= 0.05


def test_the_served_calibration_is_the_true_camera_over_the_sky(demo: Result) -> None:
    rng = np.random.default_rng(0)
    zenith = np.degrees(np.arccos(rng.uniform(np.cos(np.radians(89.9)), 1.0, 3000)))
    sky = direction_from_angles(zenith_deg=zenith, azimuth_deg=rng.uniform(0.0, 360.0, 3000))
    assert off_truth_px(demo, sky) <= 0.6


def test_composites_stand_in_dated_folders_whole(demo: Result) -> None:
    images = sorted((demo.state / "images").rglob("*"))
    files = [path for path in images if path.is_file()]
    assert len([path for path in files if path.name.endswith("_hdr.png")]) > 100
    assert {path.parent.relative_to(demo.state / "images").as_posix() for path in files} <= {"2013/05/13", "2013/05/14"}
    assert not [path for path in files if path.suffix == ".part"]


def test_the_database_holds_every_look_and_is_sound(demo: Result) -> None:
    with closing(sqlite3.connect(demo.state / "sunarc.sqlite")) as database:
        assert database.execute("PRAGMA integrity_check").fetchone() == ("ok",)
        (accepted,) = database.execute("SELECT count(*) FROM sun_point WHERE accepted").fetchone()
    assert accepted > 100


def test_a_state_folder_that_is_not_empty_is_refused_in_one_line(demo: Result, tmp_path: Path) -> None:
    (tmp_path / "something").touch()
    command = [sys.executable, str(ROOT / "deploy" / "demo.py"), "--headless", "--state", str(tmp_path)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)
    assert done.returncode == 3
    assert "is not empty; give --state an empty folder" in done.stderr
    assert done.stderr.count("\n") == 1
    shutil.rmtree(demo.state / "images")  # the largest part is not needed any more
