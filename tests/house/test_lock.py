from __future__ import annotations

import re
import tomllib
from pathlib import Path

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name
from packaging.version import Version

# name==version, perhaps a marker, then hashes: no address and no path has room in it
PIN = re.compile(r"(?P<name>[a-z0-9][a-z0-9-]*)==(?P<version>[\w.+!]+)( ; [\w\s.'()<>=!]+)? \\")
HASH = re.compile(r"    --hash=sha256:[0-9a-f]{64}( \\)?")


@pytest.fixture(scope="module")
def lock(root: Path) -> list[str]:
    return (root / "requirements.lock").read_text().splitlines()


def test_the_lock_holds_pins_and_hashes_and_nothing_else(lock: list[str]) -> None:
    assert [line for line in lock if not PIN.fullmatch(line) and not HASH.fullmatch(line)] == []


def test_the_lock_names_no_address_and_no_path(lock: list[str]) -> None:
    assert [line for line in lock if "://" in line or "@" in line or "/" in line] == []


def test_every_pin_has_a_hash(lock: list[str]) -> None:
    bare = [
        line
        for line, following in zip(lock, [*lock[1:], ""], strict=True)
        if PIN.fullmatch(line) and not HASH.fullmatch(following)
    ]
    assert bare == []


def test_what_the_project_asks_for_is_locked_at_a_version_that_it_allows(root: Path, lock: list[str]) -> None:
    project = tomllib.loads((root / "pyproject.toml").read_text())
    extras = project["project"]["optional-dependencies"].values()
    lists = [project["project"]["dependencies"], *extras, project["dependency-groups"]["dev"]]
    wanted = [text for texts in lists for text in texts if not text.startswith("sunarc[")]  # an extra of others
    pins: dict[str, list[Version]] = {}
    for match in filter(None, map(PIN.fullmatch, lock)):
        pins.setdefault(match["name"], []).append(Version(match["version"]))
    unmet = [
        text
        for text in wanted
        if not any(
            Requirement(text).specifier.contains(v) for v in pins.get(canonicalize_name(Requirement(text).name), [])
        )
    ]
    assert unmet == []


def test_the_set_up_finds_uv_in_the_lock(lock: list[str]) -> None:
    assert [line for line in lock if line.startswith("uv==")] != []
