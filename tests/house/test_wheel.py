"""The wheel, installed where there is no checkout, is the whole product."""

from __future__ import annotations

import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

pytestmark = [pytest.mark.system, pytest.mark.slow]


@pytest.fixture(scope="module")
def wheel(checkout: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Build the wheel from what git knows of."""
    folder = tmp_path_factory.mktemp("dist")
    run(sys.executable, "-m", "build", "--wheel", "--no-isolation", "--outdir", folder, checkout, cwd=folder)
    (path,) = folder.glob("*.whl")
    return path


@pytest.fixture(scope="module")
def installed(root: Path, wheel: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the bin folder of a clean venv that holds the wheel, what it depends on, and gi."""
    venv = tmp_path_factory.mktemp("installed") / "venv"
    run("/usr/bin/python3", "-m", "venv", "--without-pip", venv, cwd=venv.parent)
    python = venv / "bin" / "python"
    uv = Path(sys.executable).with_name("uv")
    lock = root / "requirements.lock"
    run(uv, "pip", "install", "--quiet", "--python", python, "--constraint", lock, wheel, cwd=venv.parent)
    gi = run("/usr/bin/python3", "-I", "-c", "import gi, os; print(os.path.dirname(gi.__file__))", cwd=venv.parent)
    site = run(python, "-I", "-c", "import sysconfig; print(sysconfig.get_path('platlib'))", cwd=venv.parent)
    Path(site.strip(), "gi").symlink_to(gi.strip())
    return venv / "bin"


def run(*command: str | Path, cwd: Path) -> str:
    """Run a command away from the checkout and return what it prints."""
    answer = subprocess.run(command, cwd=cwd, capture_output=True, text=True, check=False)
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
