"""Which lines must run for a change to matter: the statement's own, a function's first, or a constant's uses."""

from __future__ import annotations

import ast
from collections.abc import Mapping
from functools import cache


def lines_that_matter(line: int, file: str, texts: Mapping[str, str]) -> set[str]:
    """Return `file:line` of the lines of which a test must run one to notice a change.

    Parameters
    ----------
    line : of the change.
    file : where it is, named as in `texts`.
    texts : source texts by file name.
    """
    tree = _parsed(texts[file])
    function = _innermost(tree, line)
    if function is not None:
        first, last = _statement(function, line)
        return {f"{file}:{number}" for number in range(first, last + 1)}
    names = _names_set_at(tree, line)
    return {each for name in names for each in _uses(name, file, texts)}


@cache
def _parsed(text: str) -> ast.Module:
    return ast.parse(text)


def _innermost(tree: ast.Module, line: int) -> ast.FunctionDef | None:
    """Return the innermost function whose source holds a line."""
    found = None
    for node in ast.walk(tree):
        if isinstance(node, ast.FunctionDef) and node.lineno <= line <= (node.end_lineno or 0):
            found = node if found is None or node.lineno >= found.lineno else found
    return found


def _statement(function: ast.FunctionDef, line: int) -> tuple[int, int]:
    """Return the first and last line of the simple statement that holds a line; of a default, the first statement's."""
    body = [one for one in function.body if not (isinstance(one, ast.Expr) and isinstance(one.value, ast.Constant))]
    inside = [
        node
        for node in ast.walk(function)
        if isinstance(node, ast.stmt) and node.lineno <= line <= (node.end_lineno or 0) and node is not function
    ]
    if line < function.body[0].lineno or not body or not inside:  # a stub has no statement: nothing that runs
        first = body[0].lineno if body else function.lineno
        return first, first
    innermost = max(inside, key=lambda node: node.lineno)
    block = getattr(innermost, "body", None)
    return innermost.lineno, block[0].lineno - 1 if block else innermost.end_lineno or line


def _names_set_at(tree: ast.Module, line: int) -> set[str]:
    """Return the names that the module's or a class's statement at a line gives a value, and the class's own."""
    for node in tree.body:
        if node.lineno <= line <= (node.end_lineno or 0):
            if isinstance(node, ast.ClassDef):
                return {node.name}
            targets = node.targets if isinstance(node, ast.Assign) else [getattr(node, "target", None)]
            return {one.id for each in targets if each for one in ast.walk(each) if isinstance(one, ast.Name)}
    return set()


def _uses(name: str, file: str, texts: Mapping[str, str], seen: frozenset[str] = frozenset()) -> set[str]:
    """Return the lines in functions that use a module's name, through other constants that are made of it, too."""
    found: set[str] = set()
    files = [file] if name.startswith("_") else [each for each, text in texts.items() if name in text]
    for each in files:
        tree = _parsed(texts[each])
        for node in ast.walk(tree):
            if not isinstance(node, ast.Name) or node.id != name or not isinstance(node.ctx, ast.Load):
                continue
            if _innermost(tree, node.lineno) is not None:
                found |= lines_that_matter(node.lineno, each, texts)
                continue
            for other in _names_set_at(tree, node.lineno) - seen - {name}:
                found |= _uses(other, each, texts, seen | {name})
    return found
