"""Where a source file can be mutated: one constant or one operator at a time, as positions in its text.

A number only grows: a float and an integer from 10 on by half, a smaller integer by one. Numbers whose growth leaves
every result within what it is known to, by their place, are no sites (`idle.py`).
"""

from __future__ import annotations

import ast
import math
from collections.abc import Iterator
from dataclasses import dataclass

from tests.release.mutation.idle import idle_numbers

_BINARY: dict[type[ast.operator], tuple[str, str]] = {
    ast.Add: ("+", "-"),
    ast.Sub: ("-", "+"),
    ast.Mult: ("*", "/"),
    ast.Div: ("/", "*"),
    ast.Pow: ("**", "*"),
}
_COMPARISON: dict[type[ast.cmpop], tuple[str, str]] = {
    ast.Lt: ("<", ">="),
    ast.LtE: ("<=", ">"),
    ast.Gt: (">", "<="),
    ast.GtE: (">=", "<"),
    ast.Eq: ("==", "!="),
    ast.NotEq: ("!=", "=="),
}
_BY_HALF_FROM = 10
_BOOLEAN: dict[type[ast.boolop], tuple[str, str]] = {ast.And: ("and", "or"), ast.Or: ("or", "and")}


@dataclass(frozen=True, slots=True, order=True)
class Site:
    """A change of a source text: at a line (from 1) and a column in bytes (from 0), `old` becomes `new`."""

    line: int
    column: int
    old: str
    new: str


def sites(text: str) -> list[Site]:
    """Return every change of a source text that the rules know, in the order of the text.

    Mutated are numbers, arithmetic, comparisons and `and`/`or`. Left alone are texts, annotations, decorators, plain
    integers as subscripts (`shape[0]`), what only makes a message: `raise` statements, and the idle numbers.
    """
    lines = text.encode().split(b"\n")
    tree = ast.parse(text)
    idle = idle_numbers(tree)
    found = {site for node in _mutable(tree) if node not in idle for site in _sites_of(node, lines)}
    return sorted(found)


def mutated(text: str, site: Site) -> str:
    """Return a source text with one change made."""
    lines = text.encode().split(b"\n")
    row, old = lines[site.line - 1], site.old.encode()
    if row[site.column : site.column + len(old)] != old:
        raise ValueError(f"{site} is not in the text")
    lines[site.line - 1] = row[: site.column] + site.new.encode() + row[site.column + len(old) :]
    return b"\n".join(lines).decode()


def _mutable(node: ast.AST) -> Iterator[ast.AST]:
    """Yield a tree's nodes but for those that no test of behaviour could notice."""
    yield node
    for name, value in ast.iter_fields(node):
        if isinstance(node, ast.Raise) or name in {"annotation", "returns", "decorator_list"}:
            continue
        for child in value if isinstance(value, list) else [value]:
            if isinstance(child, ast.JoinedStr) or not isinstance(child, ast.AST):
                continue
            if isinstance(node, ast.Subscript) and isinstance(child, ast.Constant):
                continue
            yield from _mutable(child)


def _sites_of(node: ast.AST, lines: list[bytes]) -> Iterator[Site]:
    if isinstance(node, ast.Constant):
        yield from _number(node, lines)
    elif isinstance(node, ast.BinOp) and type(node.op) in _BINARY:
        yield from _between(node.left, node.right, *_BINARY[type(node.op)], lines)
    elif isinstance(node, ast.Compare):
        operands = [node.left, *node.comparators]
        for left, operator, right in zip(operands, node.ops, node.comparators, strict=False):
            if type(operator) in _COMPARISON:
                yield from _between(left, right, *_COMPARISON[type(operator)], lines)
    elif isinstance(node, ast.BoolOp):
        for left, right in zip(node.values, node.values[1:], strict=False):
            yield from _between(left, right, *_BOOLEAN[type(node.op)], lines)


def _number(node: ast.Constant, lines: list[bytes]) -> Iterator[Site]:
    value = node.value
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        return
    if node.lineno != node.end_lineno:
        return
    if isinstance(value, int):
        changed: float = value + (value // 2 if value >= _BY_HALF_FROM else 1)
    else:
        changed = 1.0 if value == 0.0 else value * 1.5
    old = lines[node.lineno - 1][node.col_offset : node.end_col_offset].decode()
    yield Site(node.lineno, node.col_offset, old, repr(changed))


def _between(left: ast.expr, right: ast.expr, old: str, new: str, lines: list[bytes]) -> Iterator[Site]:
    """Yield the operator between two operands, where it stands on one line with the end of the left one."""
    if left.end_lineno is None or left.end_col_offset is None:
        return
    end = right.col_offset if right.lineno == left.end_lineno else len(lines[left.end_lineno - 1])
    gap = lines[left.end_lineno - 1][left.end_col_offset : end].split(b"#")[0]
    at = gap.find(old.encode())
    if at >= 0:
        yield Site(left.end_lineno, left.end_col_offset + at, old, new)
