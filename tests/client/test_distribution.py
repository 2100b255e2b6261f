"""The distribution sunarc-client: its wheel holds the client alone, and runs on numpy without sunarc."""

from __future__ import annotations

import json
import subprocess
import sys
import tomllib
import zipfile
from pathlib import Path

import numpy as np
import pytest

ROOT = Path(__file__).parents[2]
SOURCES = ROOT / "service" / "sunarc" / "client"
PROGRAM = """
import json, sys
sys.modules["sunarc"] = None  # to import it fails
import sunarc_client
from sunarc_client import AsyncImager, Imager, LocalImager
try:
    LocalImager()
except ValueError as error:
    refused = str(error)
others = sorted({name.partition(".")[0] for name in sys.modules} - set(sys.stdlib_module_names))
print(json.dumps([sunarc_client.__file__, refused, [name for name in others if not name.startswith("_")]]))
"""

pytestmark = pytest.mark.system


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("client")
    command = [
        sys.executable,
        "-m",
        "build",
        "--wheel",
        "--no-isolation",
        "--outdir",
        str(folder),
        str(ROOT / "client"),
    ]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    (path,) = folder.glob("sunarc_client-*.whl")
    return path


def test_the_wheel_holds_every_module_and_nothing_else(wheel: Path) -> None:
    names = {name for name in zipfile.ZipFile(wheel).namelist() if ".dist-info/" not in name}
    assert names == {f"sunarc_client/{path.name}" for path in SOURCES.iterdir() if path.is_file()}
    assert "sunarc_client/py.typed" in names


def test_it_runs_on_numpy_alone(wheel: Path, tmp_path: Path) -> None:
    zipfile.ZipFile(wheel).extractall(tmp_path)
    numpy = tmp_path / "site"
    numpy.mkdir()
    for folder in Path(np.__file__).parents[1].glob("numpy*"):
        (numpy / folder.name).symlink_to(folder)
    environment = {"PYTHONPATH": f"{tmp_path}:{numpy}", "PYTHONDONTWRITEBYTECODE": "1"}
    done = subprocess.run(
        [sys.executable, "-S", "-c", PROGRAM],
        capture_output=True,
        text=True,
        check=False,
        cwd=tmp_path,
        env=environment,
    )
    assert done.returncode == 0, done.stderr
    where, refused, others = json.loads(done.stdout)
    assert Path(where).is_relative_to(tmp_path)
    assert "give an imager" in refused
    assert others == ["numpy", "sunarc", "sunarc_client"]


def test_it_has_the_version_of_the_service_and_needs_numpy_alone(wheel: Path) -> None:
    projects = [tomllib.loads((ROOT / name / "pyproject.toml").read_text())["project"] for name in ("", "client")]
    service, client = projects
    assert wheel.name.split("-")[1] == service["version"]
    assert [one.partition(">")[0] for one in client["dependencies"]] == ["numpy"]
    assert client["optional-dependencies"] == {"xarray": service["optional-dependencies"]["xarray"]}
