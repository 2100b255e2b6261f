"""Functions are short, and none is written twice."""

from __future__ import annotations

import ast
from collections import defaultdict
from collections.abc import Iterator, Sequence
from pathlib import Path

import pytest

LONGEST = 60
LONGEST_OF_NINE_TENTHS = 20
SHORTEST_COMPARED = 12

Function = ast.FunctionDef | ast.AsyncFunctionDef


@pytest.fixture(scope="module")
def functions(root: Path) -> list[tuple[str, Function]]:
    package = root / "service" / "sunarc"
    return [
        (f"{path.relative_to(package)}: {node.name}", node)
        for path in sorted(package.rglob("*.py"))
        for node in ast.walk(ast.parse(path.read_text("utf-8")))
        if isinstance(node, Function)
    ]


def body_of(function: Function) -> list[ast.stmt]:
    """Return a function's statements without its docstring."""
    return function.body[1:] if ast.get_docstring(function) is not None else function.body


def n_lines(function: Function) -> int:
    """Return how many lines a function's body has."""
    body = body_of(function)
    return (body[-1].end_lineno or 0) - body[0].lineno + 1 if body else 0


def shape_of(function: Function) -> str:
    """Return a function's body without its names and positions: two that differ in names only have the same."""
    names: dict[str, str] = {}

    class Anonymous(ast.NodeTransformer):
        def visit_Name(self, node: ast.Name) -> ast.Name:
            return ast.Name(id=names.setdefault(node.id, f"n{len(names)}"), ctx=node.ctx)

        def visit_arg(self, node: ast.arg) -> ast.arg:
            return ast.arg(arg=names.setdefault(node.arg, f"n{len(names)}"))

    copies = [ast.parse(ast.unparse(statement)) for statement in body_of(function)]
    return "\n".join(ast.dump(Anonymous().visit(copy)) for copy in copies)


def written_twice(functions: Sequence[tuple[str, Function]]) -> Iterator[list[str]]:
    """Yield the names of functions of the same shape, 12 lines or longer."""
    alike = defaultdict(list)
    for name, function in functions:
        if n_lines(function) >= SHORTEST_COMPARED:
            alike[shape_of(function)].append(name)
    yield from (names for names in alike.values() if len(names) > 1)


def test_functions_are_short(functions: list[tuple[str, Function]]) -> None:
    lengths = sorted(n_lines(function) for _, function in functions)
    assert lengths[int(0.9 * len(lengths))] <= LONGEST_OF_NINE_TENTHS
    assert [name for name, function in functions if n_lines(function) > LONGEST] == []


def test_no_function_is_written_twice(functions: list[tuple[str, Function]]) -> None:
    assert list(written_twice(functions)) == []


def test_a_copy_with_other_names_is_found() -> None:
    body = "\n".join(f"    b{k} = a + {k}" for k in range(12))
    text = f"def one(a):\n{body}\n\ndef two(x):\n{body.replace('b', 'y').replace('a +', 'x +')}\n"
    pair = [(node.name, node) for node in ast.parse(text).body if isinstance(node, ast.FunctionDef)]
    assert list(written_twice(pair)) == [["one", "two"]]
    assert list(written_twice(pair[:1])) == []
