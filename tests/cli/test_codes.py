"""The table of codes: complete, current, and of nothing that is not used."""

from __future__ import annotations

import ast
import json
from functools import cache
from pathlib import Path
from string import Formatter
from typing import TYPE_CHECKING, get_args

import pytest

from sunarc.archive.messages import code_of_event
from sunarc.archive.recovery import Recovered
from sunarc.archive.values import RefitState
from sunarc.calibration.change_detection import ChangeKind
from sunarc.cli.codes import all_codes, codes_as_markdown

if TYPE_CHECKING:
    from tests.fixtures.command_line import Sunarc

ROOT = Path(__file__).parents[2]
SERVICE = ROOT / "service" / "sunarc"
FILES = [path for path in sorted(SERVICE.rglob("*.py")) if path.name != "messages.py"]
MAKERS = ("Finding", "condition", "of_worker", "stepped", "_report", "_failure")
FORMATTED: dict[str, tuple[str, ...]] = {
    "changed_": get_args(ChangeKind),
    "database_": get_args(Recovered),
    "refit_": tuple(state for state in get_args(RefitState) if state not in {"requested", "running"}),
    "calibration_": ("pinned", "unpinned"),
}
"""The endings of the codes that a source puts together."""


def literals(path: Path) -> set[str]:
    """Return the strings of a source, the fixed parts of formatted ones among them."""
    tree = ast.parse(path.read_text())
    return {node.value for node in ast.walk(tree) if isinstance(node, ast.Constant) and isinstance(node.value, str)}


@cache
def words() -> set[str]:
    """Return the strings of all sources but the tables of messages."""
    return set().union(*map(literals, FILES))


def first_arguments(path: Path, function: str) -> list[ast.expr]:
    """Return the first argument of every call of a function in a source."""
    calls = [node for node in ast.walk(ast.parse(path.read_text())) if isinstance(node, ast.Call) and node.args]
    named = [node for node in calls if isinstance(node.func, ast.Name | ast.Attribute)]
    return [
        node.args[0] for node in named if function in {getattr(node.func, "id", ""), getattr(node.func, "attr", "")}
    ]


def codes_made_in(path: Path) -> set[str]:
    """Return the codes that a source gives to findings: strings, constants, and the formatted ones of `FORMATTED`."""
    tree, codes = ast.parse(path.read_text()), set[str]()
    for code in [code for maker in MAKERS for code in first_arguments(path, maker)]:
        if isinstance(code, ast.Constant):
            codes.add(str(code.value))
        elif isinstance(code, ast.JoinedStr):
            prefix = str(getattr(code.values[0], "value", ""))
            codes |= {f"{prefix}{ending}" for ending in FORMATTED.get(prefix, ("not in the test's FORMATTED",))}
        elif isinstance(code, ast.Name):
            codes |= assigned(tree, code.id)
    return codes


def assigned(tree: ast.AST, name: str) -> set[str]:
    """Return the strings that a source assigns to a name."""
    given = [node for node in ast.walk(tree) if isinstance(node, ast.Assign)]
    values = [node.value for node in given if any(isinstance(to, ast.Name) and to.id == name for to in node.targets)]
    inside = [one for value in values for one in ast.walk(value) if not isinstance(value, ast.Tuple)]
    return {one.value for one in inside if isinstance(one, ast.Constant) and isinstance(one.value, str)}


def test_the_page_is_the_commands_output() -> None:
    assert (ROOT / "docs" / "codes.md").read_text() == codes_as_markdown(all_codes())


def test_every_code_of_a_finding_is_declared() -> None:
    declared = {one.code for one in all_codes()}
    made = {code: path.name for path in FILES for code in codes_made_in(path)}
    assert len(made) > 80
    assert {code: name for code, name in made.items() if code not in declared} == {}


def test_every_event_is_made_of_a_finding() -> None:
    """Only `Event.of`, beside its class, calls the class; its code is one of a finding."""
    calls = {
        path: [node for node in ast.walk(ast.parse(path.read_text())) if isinstance(node, ast.Call)] for path in FILES
    }
    built = {path for path in FILES for call in calls[path] if getattr(call.func, "id", "") == "Event"}
    assert built == {SERVICE / "archive" / "values.py"}


@pytest.mark.parametrize("kind", get_args(ChangeKind))
def test_a_stored_change_has_the_code_of_its_kind(kind: str) -> None:
    assert code_of_event(kind, {}) == f"changed_{kind}" in {one.code for one in all_codes()}


def test_a_stored_move_that_a_search_found_has_the_code_of_the_search() -> None:
    assert code_of_event("bump", {"searched": True}) == "pose_changed"
    assert code_of_event("clock_step", {"searched": True}) == "clock_step"


@pytest.mark.parametrize("code", sorted({one.code for one in all_codes()}))
def test_every_declared_code_is_used(code: str) -> None:
    assert any(code == word or (word.endswith("_") and code.startswith(word)) for word in words())


def test_every_code_has_a_meaning_and_templates_that_can_be_filled() -> None:
    for one in all_codes():
        assert one.meaning, one.code
        for template in (one.text, one.action):
            assert all(name is None or name.isidentifier() for _, name, _, _ in Formatter().parse(template)), one.code


def test_the_command_prints_the_same_as_json(sunarc: Sunarc) -> None:
    printed = json.loads(sunarc("codes", "--json").out)
    assert [row["code"] for row in printed] == [one.code for one in all_codes()]
    assert set(printed[0]) == {"code", "room", "text", "meaning", "action"}
