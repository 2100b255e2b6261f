"""The import contracts hold, and each of them bites: a copy of the package that breaks one is refused."""

from __future__ import annotations

import shutil
import subprocess
import sys
import tomllib
from pathlib import Path
from typing import Any

import pytest

DOWNWARD = "houses and rooms of the library import downward only"
CORE = "the library computes: no framework, database, thread, clock or log"
FILES = "the library's readers and writers of files know no service"
IMAGER = "imager: its rooms import downward only"
ARCHIVES = "archives: of the imager no worker, web service, camera driver or command"
HUB = "hub: of the imager no camera, live source or command"
LAB = "lab: of the imager its cameras, clock and options alone"
PUBLIC = "public: names and commands of the library need no service"
CLIENT = "client: it stands apart"
GI = "imager: cameras.aravis alone imports gi"
HOUSES = ("archives", "cli", "client", "hub", "imager", "lab")


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


def rooms_of_the_library(package: Path) -> set[str]:
    return {path.name for path in package.iterdir() if (path / "__init__.py").exists()} - set(HOUSES)


def test_the_package_keeps_every_contract(package: Path, contracts: dict[str, dict[str, Any]]) -> None:
    answer = lint(package.parent)
    assert answer.returncode == 0, answer.stdout
    assert f"Contracts: {len(contracts)} kept, 0 broken." in answer.stdout


BREACHES = [
    ("sky/days.py", "import sunarc.optics.camera", DOWNWARD),
    ("imager/archive/upward.py", "import sunarc.imager.settings", IMAGER),
    ("detection/disc/sideways.py", "import sunarc.optics", DOWNWARD),
    ("sources/upward.py", "import sunarc.imager.runtime", DOWNWARD),
    ("imager/live/upward.py", "import sunarc.archives", DOWNWARD),
    ("imager/workers/night/upward.py", "def later():\n    from sunarc import hub", DOWNWARD),
    ("hub/sideways.py", "import sunarc.archives", DOWNWARD),
    ("imager/runtime/upward.py", "import sunarc.imager.cameras", IMAGER),
    ("imager/workers/night/sideways.py", "def later():\n    from sunarc.imager import web", IMAGER),
    ("imager/drawer.py", "", IMAGER),
    ("calibration/model/upward.py", "import sunarc.calibration.fit", "calibration: its rooms import downward only"),
    ("calibration/drawer.py", "", "calibration: its rooms import downward only"),
    (
        "imager/workers/night/above.py",
        "import sunarc.imager.workers.capture",
        "imager: its workers import downward only",
    ),
    (
        "imager/web/middleware/upward.py",
        "import sunarc.imager.web.routes",
        "imager: its web service imports downward only",
    ),
    ("detection/disc/across.py", "import sunarc.detection.photo", "detection: its rooms import downward only"),
    ("helpers/__init__.py", "", DOWNWARD),
    ("drawer.py", "", DOWNWARD),
    ("imager/workers/night/simulated.py", "import sunarc.lab", DOWNWARD),
    ("archives/worker.py", "import sunarc.imager.workers.capture", ARCHIVES),
    ("hub/camera.py", "import sunarc.imager.cameras.frame", HUB),
    ("lab/stored.py", "import sunarc.imager.archive.values", LAB),
    ("public/star_files.py", "import sunarc.hub", DOWNWARD),
    ("public/framework.py", "import typer", PUBLIC),
    ("client/optics.py", "import sunarc.optics.camera", CLIENT),
    ("sources/framework.py", "import fastapi", FILES),
    ("imager/cameras/other.py", "import gi", GI),
    ("lab/simulation/other.py", "def later():\n    from gi.repository import Aravis", GI),
]


def test_all_breaches_but_those_of_the_tree_are_named_in_one_run(
    package: Path, contracts: dict[str, dict[str, Any]]
) -> None:
    for module, line, _ in BREACHES:
        if line:
            add(package, module, line)
    answer = lint(package.parent)
    assert answer.returncode == 1, answer.stdout + answer.stderr
    assert set(broken(answer)) >= {contract for _, line, contract in BREACHES if line}
    assert {contract for *_, contract in BREACHES} <= set(contracts)


@pytest.mark.parametrize(("module", "line", "contract"), BREACHES[::4] + [one for one in BREACHES if not one[1]])
def test_a_breach_is_named_alone(package: Path, module: str, line: str, contract: str) -> None:
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


def test_every_room_of_the_library_is_held_to_computing_or_to_reading(
    package: Path, contracts: dict[str, dict[str, Any]]
) -> None:
    computing = {name.split(".")[1] for name in contracts[CORE]["source_modules"]}
    reading = {name.split(".")[1] for name in contracts[FILES]["source_modules"]}
    assert contracts[PUBLIC]["source_modules"] == ["sunarc.public"]
    assert computing | reading | {"public"} == rooms_of_the_library(package)
    places = {"calibration": "calibration/model", "detection": "detection/disc"}
    for room in computing | reading | {"public"}:
        add(package, f"{places.get(room, room)}/impure.py", "import logging")
    answer = lint(package.parent)
    assert broken(answer) == [CORE, FILES, PUBLIC]
    rooms = computing | reading | {"public"}
    expected = {f"sunarc.{places.get(room, room).replace('/', '.')}.impure -> logging " for room in rooms}
    assert [one for one in sorted(expected) if one not in answer.stdout] == []
