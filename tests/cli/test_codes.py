"""The table of codes: complete, current, and of nothing that is not used."""

from __future__ import annotations

import ast
import json
import math
import re
from functools import cache
from pathlib import Path
from string import Formatter
from typing import TYPE_CHECKING, get_args

import pytest

from sunarc.changes.values import ChangeKind
from sunarc.cli.codes import Code, all_codes, codes_as_markdown
from sunarc.common.findings import Finding
from sunarc.imager.archive.database.recovery import Recovered
from sunarc.imager.archive.values import RefitState, event_code

if TYPE_CHECKING:
    from tests.fixtures.command_line import Sunarc

ROOT = Path(__file__).parents[2]
SERVICE = ROOT / "service" / "sunarc"
FILES = sorted(SERVICE.rglob("*.py"))
MAKERS = ("Finding", "FitCheck", "condition", "make_condition", "stepped", "_report_damage")
FORMATTED: dict[str, tuple[str, ...]] = {
    "changed_": get_args(ChangeKind),
    "database_": get_args(Recovered),
    "refit_": tuple(state for state in get_args(RefitState) if state not in {"requested", "running"}),
    "calibration_": ("pinned", "unpinned"),
    "benchmark_rows_": ("missing", "repeated", "unknown"),
}
"""The endings of the codes that a source puts together."""


@cache
def tree_of(path: Path) -> ast.Module:
    """Return a source, read once for all tests."""
    return ast.parse(path.read_text())


def literals(path: Path) -> set[str]:
    """Return the strings of a source, the fixed parts of formatted ones among them."""
    return {
        node.value for node in ast.walk(tree_of(path)) if isinstance(node, ast.Constant) and isinstance(node.value, str)
    }


FORMER = {"sigma_of_thinned_set"}
"""Codes that stored documents of former versions have."""


@cache
def words() -> set[str]:
    """Return the strings of all sources."""
    return set().union(*map(literals, FILES))


def codes_made_in(path: Path) -> set[str]:
    """Return the codes that a source gives to findings: strings, constants, and the formatted ones of `FORMATTED`."""
    tree = tree_of(path)
    return {code for _, call in calls_of(tree) for code in codes_of(call.args[0], tree)}


def codes_of(code: ast.expr, tree: ast.AST) -> set[str]:
    """Return the codes that an argument stands for."""
    if isinstance(code, ast.Constant):
        return {str(code.value)}
    if isinstance(code, ast.IfExp):
        return codes_of(code.body, tree) | codes_of(code.orelse, tree)
    if isinstance(code, ast.JoinedStr):
        prefix = str(getattr(code.values[0], "value", ""))
        return {f"{prefix}{ending}" for ending in FORMATTED.get(prefix, ("not in the test's FORMATTED",))}
    return assigned(tree, code.id) if isinstance(code, ast.Name) else set()


def assigned(tree: ast.AST, name: str) -> set[str]:
    """Return the strings that a source assigns to a name."""
    given = [(to, node.value) for node in ast.walk(tree) if isinstance(node, ast.Assign) for to in node.targets]
    for to, value in [*given]:
        if isinstance(to, ast.Tuple) and isinstance(value, ast.Tuple):
            given += zip(to.elts, value.elts, strict=False)
    values = [value for to, value in given if isinstance(to, ast.Name) and to.id == name]
    inside = [one for value in values for one in ast.walk(value) if not isinstance(value, ast.Tuple)]
    return {one.value for one in inside if isinstance(one, ast.Constant) and isinstance(one.value, str)}


def test_the_page_is_the_commands_output() -> None:
    assert (ROOT / "docs" / "codes.md").read_text() == codes_as_markdown(all_codes())


def test_every_code_of_a_finding_is_declared() -> None:
    declared = {one.code for one in all_codes()}
    made = {code: path.name for path in FILES for code in codes_made_in(path)}
    assert len(made) > 80
    assert {code: name for code, name in made.items() if code not in declared} == {}


def data_made_in(path: Path) -> list[tuple[str, set[str]]]:
    """Return the codes that a source makes findings of, each with the names of its data, where both are written out."""
    tree = tree_of(path)
    functions = [node for node in ast.walk(tree) if isinstance(node, ast.FunctionDef)]
    made = list[tuple[str, set[str]]]()
    for function in [*functions, *(node for node in tree.body if isinstance(node, ast.Assign))]:
        dicts = {
            getattr(node.targets[0] if isinstance(node, ast.Assign) else node.target, "id", ""): node.value
            for node in ast.walk(function)
            if isinstance(node, ast.Assign | ast.AnnAssign) and isinstance(node.value, ast.Dict)
        }
        for maker, call in calls_of(function):
            names = names_of_data(call, maker, dicts)
            made += [] if names is None else [(code, names) for code in codes_of(call.args[0], tree)]
    return made


def calls_of(tree: ast.AST) -> list[tuple[str, ast.Call]]:
    """Return the calls of `MAKERS` that have a positional argument, each with the maker's name."""
    calls = [node for node in ast.walk(tree) if isinstance(node, ast.Call) and node.args]
    named = [(getattr(call.func, "id", getattr(call.func, "attr", "")), call) for call in calls]
    return [(name, call) for name, call in named if name in MAKERS]


def names_of_data(call: ast.Call, maker: str, dicts: dict[str, ast.Dict]) -> set[str] | None:
    """Return the names of the data that a call gives; None where they are not written out."""
    if maker == "FitCheck":
        return names_of_check(call)
    if maker != "Finding":
        given = {keyword.arg for keyword in call.keywords} | ({"name"} if maker == "make_condition" else set())
        return None if maker == "stepped" or None in given else {str(name) for name in given}
    data = call.args[1] if len(call.args) > 1 else ast.Dict([], [])
    data = dicts.get(data.id, data) if isinstance(data, ast.Name) else data
    if not isinstance(data, ast.Dict):
        return None
    spread = [dicts.get(getattr(value, "id", "")) for key, value in zip(data.keys, data.values, strict=True) if not key]
    if None in spread:
        return None
    keys = [key for part in [data, *spread] if part is not None for key in part.keys if key]
    return {str(getattr(key, "value", "")) for key in keys}


MEASURED = ("acceptance.py", "quality/day_clocks.py", "quality/fit_checks.py", "quality/widening.py")
"""Files of the functions whose answers are the data of checks."""


@cache
def measures() -> dict[str, ast.FunctionDef]:
    """Return the functions of these files by name."""
    trees = [tree_of(SERVICE / "calibration" / path) for path in MEASURED]
    return {node.name: node for tree in trees for node in tree.body if isinstance(node, ast.FunctionDef)}


def answers_of(name: str) -> list[ast.Dict]:
    """Return the mappings that a measure returns, or the function that it calls for its answer."""
    if name not in measures():
        return []
    returned = [node.value for node in ast.walk(measures()[name]) if isinstance(node, ast.Return) and node.value]
    parts = [part for value in returned for part in ast.walk(value)]
    called = [getattr(part.func, "id", "") for part in parts if isinstance(part, ast.Call)]
    return [part for part in parts if isinstance(part, ast.Dict)] + [one for of in called for one in answers_of(of)]


def names_of_check(call: ast.Call) -> set[str] | None:
    """Return the names of the data of a check: those of its measure, which all its answers have, and of its limit."""
    name = getattr(call.args[1], "attr", getattr(call.args[1], "id", ""))
    written = answers_of(name) or [one for one in ast.walk(call.args[1]) if isinstance(one, ast.Dict)]
    if not written or any(None in one.keys for one in written):
        return None
    names = [{str(getattr(key, "value", "")) for key in one.keys} for one in written]
    limit = [one.value for part in call.args[2:] for one in ast.walk(part) if isinstance(one, ast.Constant)]
    return set.intersection(*names) | {str(one) for one in limit}


def test_a_finding_has_the_data_that_its_sentence_and_its_action_need() -> None:
    needed = {one.code: fields(one.text) | fields(one.action) for one in all_codes()}
    made = [(path.name, code, names) for path in FILES for code, names in data_made_in(path)]
    # of the others the data are not written out where the finding is made, as a mapping of several findings
    assert len({code for _, code, _ in made}) > 0.87 * len(needed)
    lacking = [(name, code, needed[code] - names) for name, code, names in made]
    assert [entry for entry in lacking if entry[2]] == []


def fields(template: str) -> set[str]:
    """Return the names that a template is filled with."""
    return {name for _, name, _, _ in Formatter().parse(template) if name}


def test_every_event_is_made_of_a_finding() -> None:
    """Only `Event.of`, beside its class, calls the class; its code is one of a finding."""
    calls = {path: [node for node in ast.walk(tree_of(path)) if isinstance(node, ast.Call)] for path in FILES}
    built = {path for path in FILES for call in calls[path] if getattr(call.func, "id", "") == "Event"}
    assert built == {SERVICE / "imager" / "archive" / "values.py"}


@pytest.mark.parametrize("kind", get_args(ChangeKind))
def test_a_stored_change_has_the_code_of_its_kind(kind: str) -> None:
    assert event_code(kind, {}) == f"changed_{kind}" in {one.code for one in all_codes()}


def test_a_stored_move_that_a_search_found_has_the_code_of_the_search() -> None:
    assert event_code("bump", {"searched": True}) == "pose_changed"
    assert event_code("clock_step", {"searched": True}) == "clock_step"


@pytest.mark.parametrize("code", sorted({one.code for one in all_codes()}))
def test_every_declared_code_is_used(code: str) -> None:
    if code in FORMER:
        return
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


def numbers_in(*texts: str) -> set[str]:
    """Return the names of the data in sentences that may be numbers: what is converted (`{x!r}`) is a word."""
    fields = [(name, conversion) for text in texts for _, name, _, conversion in Formatter().parse(text) if name]
    return {name for name, _ in fields} - {name for name, conversion in fields if conversion is not None}


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
def test_no_message_shows_what_is_not_a_number(value: float) -> None:
    for one in all_codes():
        words = dict.fromkeys(fields(one.text) | fields(one.action), "word")
        numbers = dict.fromkeys(numbers_in(one.text, one.action), value)
        finding = Finding(one.code, {**words, **numbers})
        assert not re.search(r"\b(nan|inf)\b", finding.sentence), one.code
        assert "unknown" in finding.text or not numbers_in(one.text) & set(numbers), one.code


@pytest.mark.parametrize("code", sorted(all_codes()), ids=lambda one: one.code)
def test_a_code_with_its_data_is_a_whole_sentence(code: Code) -> None:
    """Words stand where no format does, numbers elsewhere; what cannot be filled shows the code and its data."""
    parts = [part for text in (code.text, code.action) for part in Formatter().parse(text) if part[1]]
    data = {str(name): "word" for _, name, _, _ in parts} | {str(name): 2 for _, name, form, _ in parts if form}
    finding = Finding(code.code, data)
    assert not finding.text.startswith(f"{code.code} {{")
    assert (finding.remedy == "none") == (code.action == "none")
