"""The names of the service that the booted tests use exist; they run on a machine of their own, not with the others."""

from __future__ import annotations

import ast
import importlib
import re
import sqlite3
from contextlib import closing
from pathlib import Path

import pytest

from sunarc.cli.codes import all_codes
from sunarc.imager.archive.database.schema import upgrade

BOOTED = Path(__file__).parents[1] / "booted"
SOURCES = {path.name: ast.parse(path.read_text()) for path in sorted(BOOTED.glob("*.py"))}
CODED = ("wait_for_reason", "wait_until_gone")


def texts(tree: ast.AST) -> list[str]:
    """Return the strings of a source; what is put into formatted ones is "1"."""
    parts = {id(part) for node in ast.walk(tree) if isinstance(node, ast.JoinedStr) for part in node.values}
    whole = [node.value for node in ast.walk(tree) if isinstance(node, ast.Constant) and id(node) not in parts]
    formatted = [
        "".join(str(part.value) if isinstance(part, ast.Constant) else "1" for part in node.values)
        for node in ast.walk(tree)
        if isinstance(node, ast.JoinedStr)
    ]
    return [text for text in [*whole, *formatted] if isinstance(text, str)]


def statements() -> list[str]:
    """Return the SQL statements of the booted tests, those in their scripts too."""
    found: list[str] = []
    for tree in SOURCES.values():
        for text in texts(tree):
            found += (
                [text] if text.startswith(("SELECT ", "UPDATE ")) else re.findall(r'"((?:SELECT|UPDATE) .*?)"', text)
            )
    return found


@pytest.fixture(scope="module")
def database(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("state") / "sunarc.sqlite"
    upgrade(path)
    return path


def test_statements_fit_the_tables(database: Path) -> None:
    assert len(statements()) > 15
    with closing(sqlite3.connect(database)) as connection:
        for statement in statements():
            connection.execute(f"EXPLAIN {statement}", (None,) * statement.count("?"))


def scripts() -> dict[str, str]:
    """Return the programs that the booted tests write into the machine, by their names."""
    named = {
        f"{name}: {node.targets[0].id}": node.value.value
        for name, tree in SOURCES.items()
        for node in tree.body
        if isinstance(node, ast.Assign) and isinstance(node.targets[0], ast.Name)
        if isinstance(node.value, ast.Constant) and isinstance(node.value.value, str)
    }
    return {name: text for name, text in named.items() if "import " in text and "sunarc" in text}


@pytest.mark.parametrize("name", sorted(scripts()))
@pytest.mark.parametrize("worker", ["CaptureWorker", "DetectWorker", "ComposeWorker", "RefitWorker"])
def test_scripts_use_names_that_exist(name: str, worker: str) -> None:
    tree = ast.parse(scripts()[name].replace("{worker}", worker))
    known: dict[str, object] = {}
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom) and str(node.module).startswith("sunarc"):
            module = importlib.import_module(str(node.module))
            for alias in node.names:
                member = getattr(module, alias.name, None) or importlib.import_module(f"{node.module}.{alias.name}")
                known[alias.asname or alias.name] = member
        elif isinstance(node, ast.Import):
            ours = [alias for alias in node.names if alias.name.startswith("sunarc")]
            known |= {str(alias.asname): importlib.import_module(alias.name) for alias in ours}
    for node in ast.walk(tree):
        if isinstance(node, ast.Attribute):
            path = ast.unparse(node).split(".")
            value = known.get(path[0])
            for part in path[1:] if value is not None else []:
                value = getattr(value, part)  # AttributeError names what is gone


def test_conditions_are_named_by_codes_of_the_table() -> None:
    named = {
        argument.value
        for tree in SOURCES.values()
        for node in ast.walk(tree)
        if isinstance(node, ast.Call) and getattr(node.func, "id", "") in CODED
        for argument in node.args
        if isinstance(argument, ast.Constant)
    }
    assert len(named) > 5
    assert named <= {one.code for one in all_codes()}
