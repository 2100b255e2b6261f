"""The examples of docs/examples with a service that has a camera: a folder of pictures, and one of GigE Vision."""

from __future__ import annotations

import json
import os
import runpy
import shutil
import subprocess
import sys
from collections.abc import Iterator
from contextlib import ExitStack
from datetime import UTC, datetime
from pathlib import Path

import cv2
import numpy as np
import pytest
from tests.release.first_hour import Newcomer, decimal

from sunarc.client import Imager
from sunarc.common.utc import rfc3339, utc_time
from sunarc.formats.calibration_document import from_document
from sunarc.formats.csv_files import write_sightings
from sunarc.optics.forward import project
from sunarc.sky.sun import sun_angles, sun_directions

pytestmark = [pytest.mark.system, pytest.mark.timeout(900)]

EXAMPLES = Path(__file__).parents[2] / "docs" / "examples"
SUNARC = str(Path(sys.executable).with_name("sunarc"))
SPEED = 20.0
BEFORE, START = datetime(2013, 5, 13, 11, 44, tzinfo=UTC), datetime(2013, 5, 14, 17, tzinfo=UTC)
WAYS = {
    "folder": (("--folder", "pictures"), ("--folder", "pictures", "--utc-offset", "0"), {}),
    "gige": (
        ("--address", "127.0.0.1"),
        ("--camera", "127.0.0.1"),
        {"SUNARC_CAMERA__PACKET_SIZE": "60000", "SUNARC_CAMERA__TIMESTAMPS": "camera"},
    ),
}
"""Of each camera the options of the simulation, those of `sunarc init`, and settings."""


@pytest.fixture(scope="module", params=["folder", pytest.param("gige", marks=pytest.mark.gige)])
def camera(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Newcomer]:
    """Serve a camera that was calibrated by the sightings of the day before."""
    simulated, asked, settings = WAYS[request.param]
    newcomer = Newcomer(SUNARC, tmp_path_factory.mktemp(request.param), SPEED)
    newcomer.environment |= settings
    home = newcomer.home
    with ExitStack() as running:
        times = ("--start", rfc3339(START), "--speed", str(SPEED), "--truth", "truth.json")
        running.enter_context(newcomer.runs(SUNARC, "simulate", *simulated, *times))
        newcomer.wait_until((home / "truth.json").exists)
        size = write_sightings_of(home / "truth.json", home / "points.csv")
        newcomer.wait_until(lambda: request.param == "gige" or len(list(home.rglob("image-*.jpg"))) > 2)
        place = ("--state", str(home / "state"), "--port", str(newcomer.port))
        newcomer.do(SUNARC, "init", *decimal(), *asked, *place)
        newcomer.do(SUNARC, "points", "import", "points.csv", "--config", "sunarc.toml", "--image-size", size)
        for _ in range(2):  # the second gives the first one something to be rolled back to
            newcomer.do(SUNARC, "calibrate", "--config", "sunarc.toml", codes=(0, 1))
        running.enter_context(newcomer.runs(SUNARC, "serve", "--config", "sunarc.toml"))
        newcomer.wait_for("/healthz", what="the service")
        newcomer.wait_until(lambda: len(newcomer.get("/v1/images")["images"]) > 1)
        yield newcomer


def write_sightings_of(truth: Path, target: Path) -> str:
    """Write a day of sightings by the true camera, and return its image's size."""
    true = from_document(json.loads(truth.read_text()))
    unix_s = BEFORE.timestamp() + np.arange(0.0, 15 * 3600.0, 150.0)
    unix_s = unix_s[sun_angles(unix_s, true.site).apparent_zenith < 85.0]
    noise = np.random.default_rng(1).normal(0.0, 0.1, (unix_s.size, 2))
    pixels = (project(true.camera, sun_directions(unix_s, true.site)) + noise).tolist()
    with target.open("w") as file:
        write_sightings(file, [(utc_time(t), *pixel, 0.1, "sun") for t, pixel in zip(unix_s, pixels, strict=True)])
    return f"{true.camera.width},{true.camera.height}"


def address(camera: Newcomer) -> str:
    return f"http://127.0.0.1:{camera.port}"


def roll_back(camera: Newcomer) -> None:
    """Serve a former calibration again, as an operator does."""
    listed = json.loads(camera.do(SUNARC, "calibrations", "list", "--config", "sunarc.toml", "--json"))
    former = next(one["id"] for one in listed if one["state"] != "current")
    camera.do(SUNARC, "calibrations", "activate", former, "--config", "sunarc.toml")


@pytest.mark.parametrize("command", [(sys.executable, "afternoon.py"), ("sh", "afternoon.sh")])
def test_an_afternoons_work(camera: Newcomer, tmp_path: Path, command: tuple[str, str]) -> None:
    if command[0] == "sh" and not (shutil.which("curl") and shutil.which("jq")):
        pytest.skip("curl or jq is not installed")
    program, script = command
    asking = subprocess.Popen(
        [program, EXAMPLES / script, address(camera), tmp_path],
        env=os.environ | {"PYTHONUNBUFFERED": "1"}, stdout=subprocess.PIPE, text=True,
    )  # fmt: skip
    assert asking.stdout is not None
    said = [next(asking.stdout, "") for _ in range(3)]
    assert [line.partition(":")[0] for line in said] == ["direction", "cloud", "shadow"]
    assert all(f" {36.6:.1f}" in line for line in said[1:])
    for _ in range(20):  # until it listens, and hears of one
        if asking.poll() is None:
            roll_back(camera)
    rest, _ = asking.communicate(timeout=60.0)
    assert (asking.returncode, rest.partition(":")[0]) == (0, "calibration")
    width = Imager(address(camera)).status()["image_size"][0]
    shapes = {path.stem: cv2.imread(str(path)).shape[1] for path in tmp_path.iterdir()}  # type: ignore[union-attr]
    assert shapes == {"newest": width, "sun_mask": width, "sky": 1024}


def test_a_shadow_is_followed(camera: Newcomer, tmp_path: Path) -> None:
    at = ("--at", rfc3339(START))
    script = EXAMPLES / "follow_a_shadow.py"
    subprocess.run([sys.executable, script, address(camera), tmp_path / "shadow.png", *at], check=True)
    assert (tmp_path / "shadow.png").read_bytes().startswith(b"\x89PNG")


def test_the_notebook_of_the_sky(camera: Newcomer, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("xarray")
    monkeypatch.setenv("SUNARC_ADDRESS", address(camera))
    notebooks = runpy.run_path(str(EXAMPLES / "notebooks.py"))
    notebook = json.loads((EXAMPLES / "sky.ipynb").read_text())
    notebooks["run"](notebook)
    said = notebooks["texts"](notebook)
    assert said.count("a figure") == 2
    assert "latitude 36." in said[-1]
    assert "nan" not in said[-1]


def test_the_evaluator_answers_as_the_service_does(camera: Newcomer, tmp_path: Path) -> None:
    document = tmp_path / "calibration.json"
    document.write_text(json.dumps(camera.get("/v1/calibration")))
    direction = ["0.3", "-0.2", "0.9327379"]
    script = EXAMPLES / "evaluators" / "evaluate_calibration.py"
    asked = [sys.executable, str(script), str(document), "project", *direction]
    found = subprocess.run(asked, capture_output=True, text=True, check=True).stdout.split()
    expected = Imager(address(camera)).project([float(one) for one in direction])
    assert np.array(found, dtype=float) == pytest.approx(np.asarray(expected.pixels), abs=1e-4)
