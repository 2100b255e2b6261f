"""Numbers whose growth by half leaves every result within what it is known to, told by where they stand.

- A float of at most 1e-6: it keeps a divisor, a logarithm or a matrix from zero, or says when an iteration is at rest.
- A float of at most 1e-3 in the condition of an `if` that ends with `break`: when an iteration is at rest.
- The end of a `range` of 10 or more whose loop has a `break` or a `return`: how often it may go on.
- An argument called iterations or tolerance, a value called damping, seed or chunk: how a search goes, not where it
  ends.
- What `default_rng` is given: another draw. The points, 10 or more, of a `linspace` or `geomspace`: a finer grid.

A module's private constant is one of them where each use of it is. Fewer than 10 rounds or points are a decision.
"""

from __future__ import annotations

import ast
import re
from collections import Counter
from collections.abc import Iterable, Iterator

_SMALLEST, _AT_REST, _MANY = 1e-6, 1e-3, 10
_COURSE = re.compile(r"(^|_)(damping|seed|chunk)($|_)", re.IGNORECASE)
_LIMIT = re.compile(r"^(iterations|tolerance|num)$")


def idle_numbers(tree: ast.Module) -> set[ast.AST]:
    """Return the number literals of a module that are left alone."""
    places = list(_places(tree))
    uses = Counter(node.id for node in ast.walk(tree) if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Load))
    placed = Counter(place.id for place in places if isinstance(place, ast.Name))
    private = {name for name, count in placed.items() if name.startswith("_") and count == uses[name]}
    places += [value for name, value in _values(tree) if name in private or _COURSE.search(name)]
    small = {node for node in ast.walk(tree) if _is_float(node, _SMALLEST)}
    return small | {place for place in places if isinstance(place, ast.Constant) and _counts(place.value)}


def _counts(value: object) -> bool:
    """Return whether a number that stands in such a place is none of the few that are a decision."""
    return isinstance(value, float) or (isinstance(value, int) and value >= _MANY)


def _is_float(node: ast.AST, most: float) -> bool:
    return isinstance(node, ast.Constant) and isinstance(node.value, float) and 0.0 < node.value <= most


def _places(tree: ast.Module) -> Iterator[ast.AST]:
    """Yield the expressions that stand where a number is idle."""
    for node in ast.walk(tree):
        if isinstance(node, ast.For) and isinstance(node.iter, ast.Call) and _called(node.iter) == "range":
            yield from node.iter.args[:2][-1:] if _leaves_early(node.body) else []
        elif isinstance(node, ast.If) and isinstance(node.body[-1], ast.Break):
            yield from (each for each in ast.walk(node.test) if _is_float(each, _AT_REST))
        elif isinstance(node, ast.Call):
            yield from (one.value for one in node.keywords if one.arg and _LIMIT.search(one.arg))
            if _called(node) == "default_rng":
                yield from node.args[:1]
            elif _called(node) in {"linspace", "geomspace"}:
                yield from node.args[2:3]
        elif isinstance(node, ast.arguments):
            given = [*node.posonlyargs, *node.args]
            yield from (by for one, by in zip(given[::-1], node.defaults[::-1], strict=False) if _LIMIT.search(one.arg))


def _called(call: ast.Call) -> str:
    return call.func.id if isinstance(call.func, ast.Name) else getattr(call.func, "attr", "")


def _leaves_early(block: list[ast.stmt], *, own: bool = True) -> bool:
    """Return whether the block of a loop may leave it; a loop within it has its own breaks."""
    for node in block:
        if isinstance(node, ast.Return) or (own and isinstance(node, ast.Break)):
            return True
        inner = own and not isinstance(node, ast.For | ast.While)
        if any(_leaves_early(getattr(node, name, []), own=inner) for name in ("body", "orelse", "finalbody")):
            return True
    return False


def _values(tree: ast.Module) -> Iterator[tuple[str, ast.AST]]:
    """Yield the names that statements give a value, and the value of each."""
    for node in ast.walk(tree):
        if not isinstance(node, ast.Assign | ast.AugAssign | ast.AnnAssign) or node.value is None:
            continue
        for target in node.targets if isinstance(node, ast.Assign) else [node.target]:
            pairs: Iterable[tuple[ast.expr, ast.expr]] = [(target, node.value)]
            if isinstance(target, ast.Tuple) and isinstance(node.value, ast.Tuple):
                pairs = zip(target.elts, node.value.elts, strict=False)
            yield from ((one.id, value) for one, value in pairs if isinstance(one, ast.Name))
