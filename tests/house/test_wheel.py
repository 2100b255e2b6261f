"""The wheel, installed where there is no checkout, is the whole product."""

from __future__ import annotations

import json
import subprocess
import sys
import zipfile
from pathlib import Path

import numpy as np
import pytest
from tests.fixtures.clear_day import SGP, TRUTH
from tests.public.test_lens_priors import write_csv

from sunarc.lab.simulation.made_archive import encoded, photograph

pytestmark = [pytest.mark.system, pytest.mark.slow]


@pytest.fixture(scope="module")
def wheel(checkout: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Build the wheel from what git knows of."""
    folder = tmp_path_factory.mktemp("dist")
    run(sys.executable, "-m", "build", "--wheel", "--no-isolation", "--outdir", folder, checkout, cwd=folder)
    (path,) = folder.glob("*.whl")
    return path


@pytest.fixture(scope="module")
def library(root: Path, wheel: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the bin folder of a clean venv that holds what `pip install sunarc` brings."""
    return environment(root, str(wheel), tmp_path_factory.mktemp("library"))


@pytest.fixture(scope="module")
def installed(root: Path, wheel: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the bin folder of a clean venv that holds the wheel with the extra `imager`, and gi."""
    bin_ = environment(root, f"{wheel}[imager]", tmp_path_factory.mktemp("installed"))
    gi = run("/usr/bin/python3", "-I", "-c", "import gi, os; print(os.path.dirname(gi.__file__))", cwd=bin_)
    site = run(bin_ / "python", "-I", "-c", "import sysconfig; print(sysconfig.get_path('platlib'))", cwd=bin_)
    Path(site.strip(), "gi").symlink_to(gi.strip())
    return bin_


def environment(root: Path, wheel: str, folder: Path) -> Path:
    """Make a venv with a wheel and what it depends on, and return its bin folder."""
    python = folder / "venv" / "bin" / "python"
    run("/usr/bin/python3", "-m", "venv", "--without-pip", folder / "venv", cwd=folder)
    uv, lock = Path(sys.executable).with_name("uv"), root / "requirements.lock"
    run(uv, "pip", "install", "--quiet", "--python", python, "--constraint", lock, wheel, cwd=folder)
    return python.parent


def run(*command: str | Path, cwd: Path, given: str = "") -> str:
    """Run a command away from the checkout and return what it prints."""
    answer = subprocess.run(command, cwd=cwd, input=given, capture_output=True, text=True, check=False)
    assert answer.returncode == 0, answer.stdout + answer.stderr
    return answer.stdout


def test_the_wheel_holds_the_package_its_types_and_its_migrations(
    root: Path, wheel: Path, tracked_files: list[Path]
) -> None:
    names = set(zipfile.ZipFile(wheel).namelist())
    package = {str(name.relative_to("service")) for name in tracked_files if name.parts[:2] == ("service", "sunarc")}
    migrations = {f"sunarc/{name}" for name in tracked_files if name.parts[0] == "migrations"}
    assert root.joinpath("migrations").is_dir()
    assert "sunarc/py.typed" in names
    assert (package | migrations) - names == set()


def test_the_installed_package_is_not_the_checkouts(installed: Path, tmp_path: Path) -> None:
    where = run(installed / "python", "-c", "import sunarc; print(sunarc.__file__)", cwd=tmp_path)
    assert Path(where.strip()).is_relative_to(installed.parent)


def test_the_command_answers(installed: Path, tmp_path: Path) -> None:
    answer = run(installed / "sunarc", "--help", cwd=tmp_path)
    for command in ("serve", "simulate", "detect", "points", "calibrate", "project", "unproject", "db", "check"):
        assert command in answer


def test_it_makes_a_database_and_finds_it_well(installed: Path, tmp_path: Path) -> None:
    state = tmp_path / "state"
    run(installed / "sunarc", "db", "upgrade", "--state", state, cwd=tmp_path)
    run(installed / "sunarc", "db", "check", "--state", state, cwd=tmp_path)
    assert list(state.glob("*.sqlite*")) != []


def test_it_can_speak_to_cameras(installed: Path, tmp_path: Path) -> None:
    run(installed / "python", "-c", "import sunarc.imager.cameras.aravis", cwd=tmp_path)


def test_the_library_is_small_and_has_no_framework(library: Path) -> None:
    code = "from importlib.metadata import distributions; print(*(one.name.lower() for one in distributions()))"
    there = set(run(library / "python", "-c", code, cwd=library).split())
    assert {"sunarc", "numpy", "scipy"} <= there
    assert not there & {
        "fastapi",
        "starlette",
        "uvicorn",
        "sqlalchemy",
        "alembic",
        "apscheduler",
        "dask",
        "distributed",
    }
    files = [path.lstat() for path in library.parent.rglob("*") if path.is_file() and not path.is_symlink()]
    assert sum(one.st_blocks for one in files) * 512 <= 400e6


def test_every_module_of_the_library_loads_without_the_houses_packages(library: Path, tmp_path: Path) -> None:
    code = """
import importlib, pkgutil, sunarc
rooms = "common sky optics detection geolocation imaging calibration stars changes formats sources".split()
names = []
for room in rooms:
    path = importlib.import_module(f"sunarc.{room}").__path__
    names += [one.name for one in pkgutil.walk_packages(path, f"sunarc.{room}.")]
for name in names:
    importlib.import_module(name)
print(len(names))
"""
    assert int(run(library / "python", "-c", code, cwd=tmp_path)) > 80


def test_the_library_fits_a_camera_answers_with_it_and_finds_the_sun(library: Path, tmp_path: Path) -> None:
    sunarc, points = library / "sunarc", write_csv(tmp_path / "points.csv", TRUTH)
    site = ("--latitude", SGP.latitude, "--longitude", SGP.longitude, "--altitude", SGP.altitude)
    size = f"{TRUTH.width},{TRUTH.height}"
    document = run(sunarc, "calibrate", points, *map(str, site), "--image-size", size, "--json", cwd=tmp_path)
    calibration = tmp_path / "calibration.json"
    calibration.write_text(document)
    assert json.loads(document)["verdict"]["accepted"]
    run(sunarc, "export", "--calibration", calibration, "--format", "opencv", "-o", "camera.yml", cwd=tmp_path)
    compared = run(sunarc, "compare", calibration, "camera.yml", "--json", cwd=tmp_path)
    assert json.loads(compared)["rms_px"] < 1.0
    picture = photograph(TRUTH.width, np.array([900.0, 700.0]), np.random.default_rng(1), hidden=False)
    (tmp_path / "noon.jpg").write_bytes(encoded(picture))
    (found,) = json.loads(run(sunarc, "detect", "noon.jpg", "--json", cwd=tmp_path))
    assert (found["x_px"], found["y_px"]) == pytest.approx((900.0, 700.0), abs=5.0)
    run(sunarc, "rectify", "noon.jpg", "--calibration", calibration, "-o", "maps", cwd=tmp_path)
    for command, row in (("project", "zenith_deg,azimuth_deg\n30,180\n"), ("unproject", "x_px,y_px\n900,700\n")):
        answer = run(sunarc, command, "--calibration", calibration, cwd=tmp_path, given=row)
        assert len(answer.splitlines()) == 2


@pytest.mark.parametrize("command", ["serve", "reanalyse", "hub", "calibrate"])
def test_a_command_of_a_house_that_is_not_installed_names_the_line(library: Path, tmp_path: Path, command: str) -> None:
    done = subprocess.run([library / "sunarc", command], cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 2
    assert "pip install 'sunarc[" in done.stderr
