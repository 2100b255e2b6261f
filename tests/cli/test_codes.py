"""The table of codes: complete, current, and of nothing that is not used."""

from __future__ import annotations

import ast
import json
from functools import cache
from pathlib import Path
from string import Formatter
from typing import TYPE_CHECKING

import pytest

from sunarc.cli.codes import all_codes, codes_as_markdown

if TYPE_CHECKING:
    from tests.fixtures.command_line import Sunarc

ROOT = Path(__file__).parents[2]
SERVICE = ROOT / "service" / "sunarc"
FILES = [path for path in sorted(SERVICE.rglob("*.py")) if path.name != "messages.py"]


def literals(path: Path) -> set[str]:
    """Return the strings of a source, the fixed parts of formatted ones among them."""
    tree = ast.parse(path.read_text())
    return {node.value for node in ast.walk(tree) if isinstance(node, ast.Constant) and isinstance(node.value, str)}


@cache
def words() -> set[str]:
    """Return the strings of all sources but the tables of messages."""
    return set().union(*map(literals, FILES))


def made_in(path: Path) -> set[str]:
    """Return the codes that a source gives to findings as a plain string."""
    calls = [node for node in ast.walk(ast.parse(path.read_text())) if isinstance(node, ast.Call) and node.args]
    first = [node.args[0] for node in calls if isinstance(node.func, ast.Name) and node.func.id == "Finding"]
    return {str(one.value) for one in first if isinstance(one, ast.Constant)}


def test_the_page_is_the_commands_output() -> None:
    assert (ROOT / "docs" / "codes.md").read_text() == codes_as_markdown(all_codes())


def test_every_code_of_a_finding_is_declared() -> None:
    declared = {one.code for one in all_codes()}
    assert set().union(*map(made_in, FILES)) <= declared


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
