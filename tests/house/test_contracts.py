"""The import contracts hold, and each of them bites: a copy of the package that breaks one is refused."""

from __future__ import annotations

import shutil
import subprocess
import sys
import tomllib
from pathlib import Path
from typing import Any

import pytest

DOWNWARD = "rooms import downward only"
CORE = "the core computes: no framework, database, thread, clock or log"
SIMULATOR = "only app and studies choose the simulator"
GI = "only cameras.aravis imports gi"


@pytest.fixture(scope="module")
def contracts(root: Path) -> dict[str, dict[str, Any]]:
    linter = tomllib.loads((root / "pyproject.toml").read_text())["tool"]["importlinter"]
    return {contract["name"]: contract for contract in linter["contracts"]}


@pytest.fixture
def package(root: Path, tmp_path: Path) -> Path:
    """Return a copy of the package, to be spoilt."""
    shutil.copy(root / "pyproject.toml", tmp_path)
    ignore = shutil.ignore_patterns("__pycache__")
    return Path(shutil.copytree(root / "service" / "sunarc", tmp_path / "sunarc", ignore=ignore))


def lint(folder: Path) -> subprocess.CompletedProcess[str]:
    """Run the linter on the package in `folder`, which stands before the installed one."""
    program = Path(sys.executable).with_name("lint-imports")
    return subprocess.run([program, "--no-cache"], cwd=folder, capture_output=True, text=True, check=False)


def add(package: Path, module: str, line: str) -> None:
    path = package / module
    path.parent.mkdir(exist_ok=True)
    text = path.read_text() if path.exists() else ""
    path.write_text(f"{text}\n{line}\n")


def broken(answer: subprocess.CompletedProcess[str]) -> list[str]:
    return [line.removesuffix(" BROKEN") for line in answer.stdout.splitlines() if line.endswith(" BROKEN")]


def test_the_package_keeps_every_contract(package: Path, contracts: dict[str, dict[str, Any]]) -> None:
    answer = lint(package.parent)
    assert answer.returncode == 0, answer.stdout
    assert f"Contracts: {len(contracts)} kept, 0 broken." in answer.stdout


@pytest.mark.parametrize(
    ("module", "line", "contract"),
    [
        ("sky/days.py", "import sunarc.optics.camera", DOWNWARD),
        ("archive/upward.py", "import sunarc.settings", DOWNWARD),
        ("detection/disc/sideways.py", "import sunarc.optics", DOWNWARD),
        ("runtime/upward.py", "import sunarc.sky", DOWNWARD),
        ("workers/night/sideways.py", "def later():\n    from sunarc import api", DOWNWARD),
        ("calibration/model/upward.py", "import sunarc.calibration.fit", "calibration: its rooms import downward only"),
        ("calibration/drawer.py", "", "calibration: its rooms import downward only"),
        ("workers/night/upward.py", "import sunarc.workers.capture", "workers: its rooms import downward only"),
        ("api/middleware/upward.py", "import sunarc.api.routes", "api: its rooms import downward only"),
        ("detection/disc/across.py", "import sunarc.detection.photo", "detection: its rooms import downward only"),
        ("helpers/__init__.py", "", DOWNWARD),
        ("common.py", "", DOWNWARD),
        ("workers/night/simulated.py", "import sunarc.simulation", SIMULATOR),
        ("__main__.py", "from sunarc.simulation import anything", SIMULATOR),
        ("cameras/other.py", "import gi", GI),
        ("simulation/other.py", "def later():\n    from gi.repository import Aravis", GI),
    ],
)
def test_a_breach_is_named(package: Path, module: str, line: str, contract: str) -> None:
    add(package, module, line)
    answer = lint(package.parent)
    assert answer.returncode == 1, answer.stdout + answer.stderr
    assert broken(answer) == [contract]


def test_the_core_may_import_none_of_what_is_forbidden(package: Path, contracts: dict[str, dict[str, Any]]) -> None:
    outside = [name for name in contracts[CORE]["forbidden_modules"] if name != "gi"]  # gi has a contract of its own
    add(package, "imaging/impure.py", "\n".join(f"import {name}" for name in outside))
    answer = lint(package.parent)
    assert broken(answer) == [CORE]
    assert [name for name in outside if f"sunarc.imaging.impure -> {name} " not in answer.stdout] == []


def test_every_room_of_the_core_is_held_to_it(package: Path, contracts: dict[str, dict[str, Any]]) -> None:
    rooms = [name.removeprefix("sunarc.") for name in contracts[CORE]["source_modules"]]
    places = {
        room: {"calibration": "calibration.model", "detection": "detection.disc"}.get(room, room) for room in rooms
    }
    for place in places.values():
        add(package, f"{place.replace('.', '/')}/impure.py", "import logging")
    answer = lint(package.parent)
    assert broken(answer) == [CORE]
    assert [place for place in places.values() if f"sunarc.{place}.impure -> logging " not in answer.stdout] == []


def test_the_core_is_whole(package: Path, contracts: dict[str, dict[str, Any]]) -> None:
    core = {"sky", "optics", "detection", "calibration", "imaging", "monitoring", "stars"}
    core |= {"documents", "geolocation", "cross_checks"}
    there = {f"sunarc.{room}" for room in core if (package / room).is_dir()}
    assert set(contracts[CORE]["source_modules"]) == there


def test_every_room_but_two_is_kept_from_the_simulator(package: Path, contracts: dict[str, dict[str, Any]]) -> None:
    names = {path.stem for path in package.iterdir() if path.suffix == ".py" or (path / "__init__.py").exists()}
    others = {f"sunarc.{name}" for name in names - {"__init__", "app", "studies", "simulation"}}
    assert set(contracts[SIMULATOR]["source_modules"]) == others
