"""What `tests/mutants` changes: each rule on a line of its own, and nothing that no test of behaviour could detect."""

from __future__ import annotations

import ast
import importlib.util
import sys
from pathlib import Path
from types import ModuleType

import pytest


@pytest.fixture(scope="module")
def mutation(root: Path) -> ModuleType:
    return _module(root, "sites")


@pytest.fixture(scope="module")
def reach(root: Path) -> ModuleType:
    return _module(root, "reach")


def _module(root: Path, name: str) -> ModuleType:
    specification = importlib.util.spec_from_file_location(
        f"mutation_{name}", root / "tests" / "mutation" / f"{name}.py"
    )
    assert specification is not None
    assert specification.loader is not None
    module = importlib.util.module_from_spec(specification)
    sys.modules[f"mutation_{name}"] = module  # dataclasses look their module up
    specification.loader.exec_module(module)
    return module


@pytest.mark.parametrize(
    ("text", "changed"),
    [
        ("a = b + c", {"a = b - c"}),
        ("a = b**2", {"a = b*2", "a = b**3"}),
        ("a = b < 1.5", {"a = b >= 1.5", "a = b < 2.25"}),
        ("a = b < c <= d", {"a = b >= c <= d", "a = b < c > d"}),
        ("a = (b) / (c)  # x / y", {"a = (b) * (c)  # x / y"}),
        ("a = b and c", {"a = b or c"}),
        ("a = 0.0", {"a = 1.0"}),
        ("a = 'µ', b * c", {"a = 'µ', b / c"}),
    ],
)
def test_a_rule_changes_one_constant_or_operator(mutation: ModuleType, text: str, changed: set[str]) -> None:
    assert {mutation.mutated(text, site) for site in mutation.sites(text)} == changed


@pytest.mark.parametrize(
    "text",
    [
        '"""A docstring: 1 + 1."""',
        "def f(a: Literal[1]) -> Literal[2]: ...",
        "@cache(3)\ndef f(): ...",
        "raise ValueError(1 + 2)",
        "a = f'{b:.3f}'",
        "a = b.shape[0]",
        "a = True",
    ],
)
def test_what_no_test_of_behaviour_could_detect_is_left_alone(mutation: ModuleType, text: str) -> None:
    assert mutation.sites(text) == []


def test_every_change_of_the_core_is_a_valid_source_that_differs(mutation: ModuleType, root: Path) -> None:
    text = (root / "service" / "sunarc" / "optics" / "projections.py").read_text()
    trees = {ast.dump(ast.parse(mutation.mutated(text, site))) for site in mutation.sites(text)}
    assert len(trees) == len(mutation.sites(text)) > 20
    assert ast.dump(ast.parse(text)) not in trees


SOURCE = """\
_LIMIT = 3.0
_TWICE = 2.0 * _LIMIT


def near(x, cut=4.0):
    \"\"\"Say whether x is near.\"\"\"
    if x < (
        _TWICE
    ):
        return x + 1
    return cut


def stub(x=2.0):
    \"\"\"Do nothing.\"\"\"
"""


@pytest.mark.parametrize(
    ("line", "reached"),
    [
        (1, {7, 8, 9}),  # a constant: where it is used, through another constant too
        (5, {7}),  # a default: the function's first statement
        (8, {7, 8, 9}),  # a condition over several lines: without what it guards
        (10, {10}),
        (14, {14}),  # a default of a function without a statement
    ],
)
def test_a_change_matters_where_its_statement_or_its_name_is_used(
    reach: ModuleType, line: int, reached: set[int]
) -> None:
    assert reach.lines_that_matter(line, "near.py", {"near.py": SOURCE}) == {f"near.py:{one}" for one in reached}
