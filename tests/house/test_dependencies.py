"""What the package imports is declared; what comes with something else today may be gone tomorrow."""

from __future__ import annotations

import ast
import re
import sys
import tomllib
from importlib.metadata import packages_distributions
from pathlib import Path

FROM_DEBIAN = {"gi"}


def imports_of(path: Path) -> set[str]:
    names: set[str] = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            names |= {alias.name.partition(".")[0] for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.level == 0:
            names.add((node.module or "").partition(".")[0])
    return names


def normalised(name: str) -> str:
    return re.sub(r"[-_.]+", "-", name).lower()


def test_every_import_of_the_package_is_a_declared_dependency(root: Path) -> None:
    imported = set().union(*(imports_of(path) for path in (root / "service" / "sunarc").rglob("*.py")))
    others = imported - set(sys.stdlib_module_names) - FROM_DEBIAN - {"sunarc"}
    project = tomllib.loads((root / "pyproject.toml").read_text())["project"]
    lists = [project["dependencies"], *project.get("optional-dependencies", {}).values()]
    declared = {normalised(re.split(r"[<>=!\[; ]", line)[0]) for lines in lists for line in lines}
    distributions = packages_distributions()
    missing = {
        name: distributions.get(name)
        for name in others
        if not {normalised(distribution) for distribution in distributions.get(name, [])} & declared
    }
    assert len(others) > 15
    assert missing == {}
