"""What `tests/mutants` changes: each rule on a line of its own, and nothing that no test of behaviour could detect."""

from __future__ import annotations

import ast
from pathlib import Path

import pytest
from tests.release.mutation.elsewhere import files_elsewhere
from tests.release.mutation.reach import lines_that_matter
from tests.release.mutation.sites import mutated, sites


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
        ("a = b > 9", {"a = b <= 9", "a = b > 10"}),
        ("a = b > 11", {"a = b <= 11", "a = b > 16"}),
        ("a = 'µ', b * c", {"a = 'µ', b / c"}),
    ],
)
def test_a_rule_changes_one_constant_or_operator(text: str, changed: set[str]) -> None:
    assert {mutated(text, site) for site in sites(text)} == changed


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
def test_what_no_test_of_behaviour_could_detect_is_left_alone(text: str) -> None:
    assert sites(text) == []


@pytest.mark.parametrize(
    "text",
    [
        "a = max(b, 1e-9)",
        "for _ in range(20):\n    if b:\n        break",
        "def f():\n    for _ in range(b, 20):\n        return b",
        "_MOST = 20\ndef f():\n  for _ in range(_MOST):\n    while b:\n      if c:\n        return d",
        "while b:\n    if near(c, 1e-4):\n        break",
        "fit(b, tolerance=1e-4, iterations=30)",
        "def fit(b, tolerance=1e-4): ...",
        "_SEED, damping = 20, 0.001",
        "rng = np.random.default_rng(20)",
        "a = np.linspace(b, c, 50)",
    ],
)
def test_a_number_that_is_idle_by_its_place_is_left_alone(text: str) -> None:
    assert sites(text) == []


@pytest.mark.parametrize(
    "text",
    [
        "a = max(b, 1e-4)",
        "for _ in range(2):\n    if b:\n        break",  # few rounds are a decision
        "for _ in range(20):\n    b()",
        "for _ in range(20):\n    for c in b:\n        break",  # it leaves the inner loop alone
        "MOST = 20\nfor _ in range(MOST):\n    break",  # others may use it
        "_MOST = 20\nfor _ in range(_MOST):\n    break\na = b[:_MOST]",
        "while b:\n    if c is 0.5:\n        break",
        "a = np.linspace(b, c, 5)",
        "TOLERANCE_PX = 1.5",
    ],
)
def test_a_number_that_decides_is_changed(text: str) -> None:
    assert len(sites(text)) == 1


def test_test_files_of_other_rooms_are_found_by_imports_the_nearest_first(tmp_path: Path) -> None:
    texts = {
        "core/a.py": "",
        "made/b.py": "from sunarc.core.a import f",
        "made/c.py": "from sunarc.made import b",
        "made/d.py": "from sunarc.made.c import f",
    }
    files = {
        "core/test_a.py": "from sunarc.core.a import f",  # of the room itself
        "made/test_c.py": "from sunarc.made.c import f",
        "made/test_b.py": "import sunarc.made.b",
        "made/test_d.py": "import sunarc.made.d",  # too far
        "system/test_e.py": "import sunarc.core.a",  # in processes of its own
        "made/test_f.py": "import pytest\nfrom sunarc.core.a import f\npytestmark = pytest.mark.slow",
    }
    for name, text in files.items():
        path = tmp_path / "tests" / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
    assert files_elsewhere("core/a.py", texts, tmp_path, ["core"]) == ["tests/made/test_b.py", "tests/made/test_c.py"]


def test_every_change_of_the_core_is_a_valid_source_that_differs(root: Path) -> None:
    text = (root / "service" / "sunarc" / "optics" / "projections.py").read_text()
    trees = {ast.dump(ast.parse(mutated(text, site))) for site in sites(text)}
    assert len(trees) == len(sites(text)) > 20
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
def test_a_change_matters_where_its_statement_or_its_name_is_used(line: int, reached: set[int]) -> None:
    assert lines_that_matter(line, "near.py", {"near.py": SOURCE}) == {f"near.py:{one}" for one in reached}
