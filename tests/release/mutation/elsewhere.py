"""Which test files of other rooms are near a module: by imports, their own and those of what is made of the module."""

from __future__ import annotations

import ast
import re
from collections.abc import Mapping, Sequence
from functools import cache
from pathlib import Path

_FARTHEST, _MOST = 3, 12
_APART = {"benchmarks", "booted", "client", "house", "release", "system"}
_MARKED = re.compile(r"^pytestmark\b.*\bmark\.(slow|gige|system|browser|waits|release)\b", re.MULTILINE)


def files_elsewhere(file: str, texts: Mapping[str, str], root: Path, rooms: Sequence[str]) -> list[str]:
    """Return test files outside of some rooms, the nearest first: one that imports the module, then what imports it.

    Parameters
    ----------
    file : of the module, named as in `texts`.
    texts : source texts of the package by file name.
    root : of the repository.
    rooms : whose test files are known already.
    """
    distance, front = {file: 0}, [file]
    for step in range(1, _FARTHEST):
        front = [one for one in texts if one not in distance and not _imported(texts[one]).isdisjoint(front)]
        distance |= dict.fromkeys(front, step)
    found = []
    for path, imported in _test_files(root).items():
        near = min((distance[one] for one in imported if one in distance), default=_FARTHEST)
        if near < _FARTHEST and not path.startswith(tuple(f"tests/{room}/" for room in rooms)):
            found.append((near, len(imported), path))
    return [path for _, _, path in sorted(found)][:_MOST]


@cache
def _test_files(root: Path) -> dict[str, frozenset[str]]:
    """Return what each fast test file imports of the package."""
    found = {}
    for path in (root / "tests").rglob("test_*.py"):
        name, text = path.relative_to(root).as_posix(), path.read_text("utf-8")
        if name.split("/")[1] not in _APART and _MARKED.search(text) is None:
            found[name] = _imported(text)
    return found


@cache
def _imported(text: str) -> frozenset[str]:
    """Return the files of the package's modules that a text imports, wherever in it."""
    names = set()
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module and node.level == 0:
            names |= {node.module, *(f"{node.module}.{alias.name}" for alias in node.names)}
    inside = [name.split(".", 1)[1] for name in names if name.startswith("sunarc.")]
    return frozenset(f"{name.replace('.', '/')}.py" for name in inside)
