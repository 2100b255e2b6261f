"""The names that docstrings describe are those of the code."""

from __future__ import annotations

import ast
import re
from os.path import commonpath
from pathlib import Path

SERVICE = Path(__file__).parents[2] / "service" / "sunarc"
SECTION = re.compile(r"(?:Parameters|Attributes)\n-+\n(.*?)(?:\n\n[A-Z]|\Z)", re.DOTALL)
ENTRY = re.compile(r"^([a-zA-Z_][\w, ]*) ?:(?: |$)", re.MULTILINE)
Described = ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef


def described(node: Described) -> set[str]:
    """Return the names in the sections of parameters and attributes of a docstring."""
    sections = "\n".join(SECTION.findall(ast.get_docstring(node) or ""))
    return {name.strip() for entry in ENTRY.findall(sections) for name in entry.split(",")}


def present(node: Described) -> set[str]:
    """Return the parameters of a function; of a class those of its methods, its fields and what methods assign."""
    functions = [one for one in ast.walk(node) if isinstance(one, ast.FunctionDef | ast.AsyncFunctionDef)]
    names = {one.arg for function in functions for one in ast.walk(function.args) if isinstance(one, ast.arg)}
    if isinstance(node, ast.ClassDef):
        names |= {one.name for one in functions}
        names |= {one.id for one in ast.walk(node) if isinstance(one, ast.Name) and isinstance(one.ctx, ast.Store)}
        names |= {one.attr for one in ast.walk(node) if isinstance(one, ast.Attribute)}
    return names


def unknown(trees: dict[str, ast.AST]) -> dict[tuple[str, str], set[str]]:
    """Return the names that docstrings describe and the code does not have, by file and function or class."""
    nodes = [(file, node) for file, tree in trees.items() for node in ast.walk(tree) if isinstance(node, Described)]
    classes = [(file, node) for file, node in nodes if isinstance(node, ast.ClassDef)]

    def base(file: str, name: str) -> tuple[str, ast.ClassDef] | None:
        """Return the class of a name, of several the one whose file is nearest."""
        near = [(len(commonpath([file, other])), other, one) for other, one in classes if one.name == name]
        return max(near, key=lambda one: one[0])[1:] if near else None

    def names_of(file: str, node: Described) -> set[str]:
        bases = [one.id for one in node.bases if isinstance(one, ast.Name)] if isinstance(node, ast.ClassDef) else []
        known = [one for name in bases if (one := base(file, name)) is not None]
        return present(node).union(*(names_of(*one) for one in known))

    return {(file, node.name): names for file, node in nodes if (names := described(node) - names_of(file, node))}


def test_described_parameters_and_attributes_exist() -> None:
    assert unknown({str(path): ast.parse(path.read_text()) for path in sorted(SERVICE.rglob("*.py"))}) == {}


def test_a_name_that_is_gone_is_found() -> None:
    source = '''
class A:
    """Text.

    Attributes
    ----------
    kept, gone : two.
    """

    kept: int

def f(x: int) -> None:
    """Text.

    Parameters
    ----------
    x : here.
    y : not here.
    """
'''
    found = unknown({"one.py": ast.parse(source), "two.py": ast.parse(source.replace("gone", "kept"))})
    assert found == {("one.py", "A"): {"gone"}, ("one.py", "f"): {"y"}, ("two.py", "f"): {"y"}}
