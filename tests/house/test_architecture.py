"""The pictures, paths and tables of docs/architecture are those of the sources."""

from __future__ import annotations

import ast
import importlib.util
import re
from pathlib import Path
from types import ModuleType

import pytest


@pytest.fixture(scope="module")
def drawing(root: Path) -> ModuleType:
    return script(root, "draw_rooms")


def script(root: Path, name: str) -> ModuleType:
    """Return a script of docs/architecture as a module."""
    path = root / "docs" / "architecture" / f"{name}.py"
    specification = importlib.util.spec_from_file_location(name, path)
    assert specification is not None
    assert specification.loader is not None
    module = importlib.util.module_from_spec(specification)
    specification.loader.exec_module(module)
    return module


def test_the_stored_pictures_are_those_of_the_sources(drawing: ModuleType, root: Path) -> None:
    folder = root / "docs" / "architecture"
    drawn = drawing.pictures(root)
    stored = {path.name: path.read_text(encoding="utf-8") for path in folder.glob("*.svg")}
    assert stored == drawn, "run: python docs/architecture/draw_rooms.py"


def test_the_page_of_checks_is_that_of_the_table(root: Path) -> None:
    page = (root / "docs" / "checks.md").read_text(encoding="utf-8")
    assert page == script(root, "checks").page(), "run: python docs/architecture/checks.py"


def test_every_room_of_the_library_is_in_its_picture(drawing: ModuleType, root: Path) -> None:
    package = root / "service" / "sunarc"
    rooms = {path.name for path in package.iterdir() if (path / "__init__.py").exists()} - set(drawing.HOUSES)
    stored = (root / "docs" / "architecture" / "library.svg").read_text(encoding="utf-8")
    assert len(rooms) > 10
    assert [room for room in sorted(rooms) if f">{room}<" not in stored] == []


def test_imports_between_rooms_are_read_from_every_form_of_import(drawing: ModuleType, tmp_path: Path) -> None:
    (tmp_path / "low").mkdir()
    (tmp_path / "low" / "one.py").write_text("import math\n")
    (tmp_path / "high.py").write_text("from sunarc import low\nimport sunarc.other.x\n")
    (tmp_path / "other").mkdir()
    (tmp_path / "other" / "x.py").write_text("from sunarc.low.one import math\n")
    found = drawing.imports_between_rooms(tmp_path)
    assert found == {"low": set(), "high": {"low", "other"}, "other": {"low"}}
    assert drawing.without_implied(found) == {"low": set(), "high": {"other"}, "other": {"low"}}
    assert drawing.rows_of(found) == [["high"], ["other"], ["low"]]


def test_each_path_has_at_most_twelve_stations_and_they_exist(root: Path) -> None:
    page = (root / "docs" / "architecture.md").read_text(encoding="utf-8")
    paths = re.findall(r"^### The path of a (\w+)\n(.*?)(?=^###|\Z)", page, re.MULTILINE | re.DOTALL)
    assert [name for name, _ in paths] == ["frame", "sighting", "night", "pixel", "setting"]
    for name, text in paths:
        stations = re.findall(r"^\d+\. (.*)$", text, re.MULTILINE)
        assert 4 <= len(stations) <= 12, name
        modules = re.findall(r"`([\w/]+\.py)`", "\n".join(stations))
        assert len(modules) >= len(stations), name
        assert [module for module in modules if not (root / "service" / "sunarc" / module).is_file()] == []


@pytest.mark.parametrize("house", ["library", "imager", "archives", "hub", "lab", "client", "cli"])
def test_the_types_that_a_page_names_are_defined_where_it_says(root: Path, house: str) -> None:
    page = (root / "docs" / "architecture" / f"{house}.md").read_text(encoding="utf-8")
    rows = re.findall(r"^\| `(\w+)` \| `([\w/]+\.py)` \|", page, re.MULTILINE)
    assert len(rows) == 5
    for name, module in rows:
        tree = ast.parse((root / "service" / "sunarc" / module).read_text(encoding="utf-8"))
        assert name in {node.name for node in tree.body if isinstance(node, ast.ClassDef | ast.FunctionDef)}, name
    assert f"]({house}.svg)" in page
