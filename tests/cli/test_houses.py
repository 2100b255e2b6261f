"""The commands of a house load with the base and the house's extra, and are refused without."""

from __future__ import annotations

import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

from sunarc.cli.main import houses

ROOT = Path(__file__).parents[2]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
LOAD = """
import importlib.metadata, re, sys
from sunarc.cli.main import houses, load_command
house = sys.argv[1]
stated = [one.partition(";") for one in importlib.metadata.requires("sunarc")]
named = [(re.match(r"[\\w.-]+", package)[0].lower(), extra.strip()) for package, _, extra in stated]
allowed = {name for name, extra in named if extra in ("", f"extra == '{house}'")}
others = {name for name, _ in named} - allowed - {"pydantic"}  # typer has it
provided = importlib.metadata.packages_distributions()
blocked = {top for top, owners in provided.items() if {owner.lower() for owner in owners} & others}
for top in blocked - {*sys.modules}:
    sys.modules[top] = None
for name in houses()[house]:
    load_command(name)
print(len(blocked))
"""


def test_every_house_that_is_registered_is_an_extra() -> None:
    registered = set(PROJECT["entry-points"]["sunarc.commands"])
    assert registered == set(houses())
    assert registered - {"library"} <= set(PROJECT["optional-dependencies"])


def test_the_base_has_ten_packages_at_most_and_no_framework() -> None:
    base = {one.split(">")[0] for one in PROJECT["dependencies"]}
    assert len(base) <= 10
    of_houses = {
        one.split(">")[0] for extra in ("imager", "archives") for one in PROJECT["optional-dependencies"][extra]
    }
    assert base & of_houses == set()


def test_no_command_is_of_two_houses() -> None:
    names = [name for commands in houses().values() for name in commands]
    assert len(names) == len(set(names)) >= 20


@pytest.mark.parametrize("house", ["library", "imager", "archives", "hub", "lab"])
def test_a_houses_commands_load_with_the_packages_of_its_extra_alone(house: str) -> None:
    done = subprocess.run([sys.executable, "-c", LOAD, house], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert int(done.stdout) >= 10


REFUSED = """
import sys
from importlib.metadata import PackageNotFoundError, distribution
from sunarc.common import extras
def without(name):
    if name == "fastapi":
        raise PackageNotFoundError(name)
    return distribution(name)
extras.distribution = without
from sunarc.cli.main import main
main()
"""


@pytest.mark.parametrize(
    ("arguments", "line"),
    [
        (["serve", "--help"], "sunarc[imager]"),
        (["calibrate"], "sunarc[imager]"),
        (["calibrate", "--again", "x"], "sunarc[imager]"),
        (["hub", "list"], "sunarc[hub]"),
    ],
)
def test_a_command_whose_house_is_not_installed_ends_with_the_line_that_installs_it(
    arguments: list[str], line: str
) -> None:
    done = subprocess.run([sys.executable, "-c", REFUSED, *arguments], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout, done.stderr.count("\n")) == (2, "", 1)
    assert f"pip install '{line}'" in done.stderr


def test_the_list_of_commands_says_which_house_is_not_installed() -> None:
    done = subprocess.run([sys.executable, "-c", REFUSED, "--help"], capture_output=True, text=True, check=True)
    headings = [line for line in done.stdout.splitlines() if line.endswith(":")]
    assert "Commands of sunarc[imager], which is not installed:" in headings
    assert "Commands of sunarc[archives]:" in headings


def test_an_installation_that_registers_nothing_says_so() -> None:
    code = "import sunarc.cli.main as m; m.entry_points = lambda group: []; m.main()"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr.count("\n")) == (2, 1)
    assert "deploy/setup" in done.stderr


@pytest.mark.parametrize("group", ["db", "calibrations", "points", "hub", "study"])
def test_the_summaries_of_a_group_are_not_cut(group: str) -> None:
    done = subprocess.run([sys.executable, "-m", "sunarc", group, "--help"], capture_output=True, text=True, check=True)
    assert "..." not in done.stdout.partition("Commands:")[2]
