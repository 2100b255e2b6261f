from __future__ import annotations

import ast
import re
import subprocess
import sys
from itertools import pairwise
from pathlib import Path

import pytest

NO_DRAWER = ("service/sunarc/common", "tests/common")
"""Errors, findings, bounds, UTC, array types: what every room of the library uses, each in a file of its subject."""
DRAWERS = {"util", "utils", "helper", "helpers", "manager", "base", "common", "misc", "processor"}
# folders of a person or of this machine; those of an installed system (/usr, /etc, /var) are the product's own
A_PLACE = re.compile(r"/(?:root|home|Users|work)/")
A_REGISTRY = re.compile(
    r"python[h]osted|[p]ypi\.org|deb\.[d]ebian|registry\.[n]pmjs|--(?:extra-)?[i]ndex-url|--[f]ind-links"
)
A_HOST = re.compile(r"://(?:[^/@\s]*@)?([\w.-]+\.[a-z]+)")


@pytest.fixture(scope="module")
def sources(root: Path) -> list[Path]:
    return sorted((root / "service" / "sunarc").rglob("*.py"))


@pytest.fixture(scope="module")
def texts(root: Path, tracked_files: list[Path]) -> dict[str, str]:
    """Return every tracked text file."""
    contents = {str(name): (root / name).read_bytes() for name in tracked_files}
    return {name: content.decode() for name, content in contents.items() if b"\0" not in content}


def test_a_string_that_describes_a_constant_stands_right_under_it(sources: list[Path]) -> None:
    assert [f"{path.name}:{line}" for path in sources for line in stray_strings(ast.parse(path.read_text()))] == []


def test_a_stray_string_is_found() -> None:
    source = ast.parse('"""doc"""\nA = 1\n"""of A"""\nB = 2\n\n"""of what?"""\ndef f():\n    """doc"""\n    "x"\n')
    assert stray_strings(source) == [6, 9]


def stray_strings(tree: ast.AST) -> list[int]:
    """Return the lines of strings that stand alone, neither first in their block nor right under an assignment."""
    bodies = [getattr(node, "body", None) for node in ast.walk(tree)]
    blocks = [body for body in bodies if isinstance(body, list)]
    return sorted(
        here.lineno
        for block in blocks
        for before, here in pairwise(block)
        if isinstance(here, ast.Expr) and isinstance(here.value, ast.Constant) and isinstance(here.value.value, str)
        if not isinstance(before, ast.Assign | ast.AnnAssign) or here.lineno != (before.end_lineno or 0) + 1
    )


def test_there_are_no_drawers(tracked_files: list[Path]) -> None:
    named = [(name, {part.partition(".")[0] for part in name.parts}) for name in tracked_files]
    drawers = [name for name, parts in named if DRAWERS & parts and not any(map(name.is_relative_to, NO_DRAWER))]
    assert drawers == []


def test_gi_is_imported_in_one_file(root: Path, sources: list[Path]) -> None:
    importers = {path.relative_to(root).as_posix() for path in sources if "gi" in imported(path)}
    assert importers == {"service/sunarc/imager/cameras/aravis.py"}


def imported(path: Path) -> set[str]:
    """Return the top-level names that a file imports, and those it could import by name."""
    names: set[str] = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.level == 0:
            names.add(node.module or "")
        elif isinstance(node, ast.Call) and ast.unparse(node.func) in {
            "__import__",
            "import_module",
            "importlib.import_module",
        }:
            names |= {arg.value for arg in node.args if isinstance(arg, ast.Constant) and isinstance(arg.value, str)}
    return {name.partition(".")[0] for name in names}


def test_no_tracked_file_names_a_place_on_somebodys_machine(root: Path, texts: dict[str, str]) -> None:
    assert [name for name, text in texts.items() if A_PLACE.search(text) or f"{root}/" in text] == []


def test_no_tracked_file_names_a_registry(texts: dict[str, str]) -> None:
    assert [name for name, text in texts.items() if A_REGISTRY.search(text)] == []


def test_no_tracked_file_names_the_hosts_that_this_machine_installs_from(texts: dict[str, str]) -> None:
    pip = subprocess.run([sys.executable, "-m", "pip", "config", "list"], capture_output=True, text=True, check=True)
    apt = [path.read_text() for path in Path("/etc/apt").glob("sources.list*/*.sources")]
    hosts = set(A_HOST.findall("\n".join([pip.stdout, *apt])))
    assert [(name, host) for name, text in texts.items() for host in hosts if host in text] == []


def test_links_in_the_documents_lead_somewhere(root: Path, texts: dict[str, str]) -> None:
    links = [
        (name, link)
        for name, text in texts.items()
        if name.endswith(".md")
        for link in re.findall(r"\]\((?!\w+:)([^)#]+)", text)
    ]
    assert [(name, link) for name, link in links if not (root / name).parent.joinpath(link).exists()] == []
