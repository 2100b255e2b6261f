"""Names, texts and docstrings of the package use the words of the field; the words listed here are not among them."""

from __future__ import annotations

import ast
import io
import re
import tokenize
from collections.abc import Iterator
from pathlib import Path

import pytest
from tests.house import figures

MOST_RELATIVE_WHAT = 1.0
"""Percent of the first lines of docstrings."""
WORDS = re.compile(r"told|vouch\w*|footing|believed|hindered|soundness|mend(?:s|ed|ing)?|foretold", re.IGNORECASE)
PHRASES = re.compile(r"\bgiven up\b", re.IGNORECASE)
KEPT = {
    "worker_hindered": "the code of a condition, which dashboards and alert rules outside know",
}
BARE = re.compile(r"_?of_\w+|\w+_of|_?with_\w+")
"""Names that say neither the noun nor what is done: `x_of`, `_of_x`, `with_x`."""
KEPT_NAMES = {
    "client/xarray_accessor.py: with_directions",  # programs outside call them
    "client/xarray_accessor.py: with_positions",
}
DOCUMENTS = (
    "README.md",
    "docs/architecture.md",
    "docs/maths.md",
    "docs/glossary.md",
    "docs/extending.md",
    "docs/settings.md",
)


def words_of(identifier: str) -> list[str]:
    """Return the words of an identifier: `_wait_for_mending`, `MixtureFit`."""
    return re.sub(r"(?<=[a-z0-9])(?=[A-Z])", "_", identifier).strip("_").split("_")


def found_in(text: str) -> Iterator[str]:
    """Yield what a source's identifiers and texts have of the words."""
    for token in tokenize.generate_tokens(io.StringIO(text).readline):
        if token.type == tokenize.NAME:
            if token.string not in KEPT and any(WORDS.fullmatch(word) for word in words_of(token.string)):
                yield f"{token.start[0]}: {token.string}"
        elif token.type == tokenize.STRING:
            content = token.string
            for kept in KEPT:
                content = content.replace(kept, "")
            words = re.findall(r"[A-Za-z]+", content)
            if any(WORDS.fullmatch(word) for word in words) or PHRASES.search(content):
                yield f"{token.start[0]}: {token.string[:80]}"


@pytest.fixture(scope="module")
def sources(root: Path) -> dict[str, str]:
    package = root / "service" / "sunarc"
    return {path.relative_to(package).as_posix(): path.read_text("utf-8") for path in sorted(package.rglob("*.py"))}


def test_no_name_and_no_text_of_the_package_has_them(sources: dict[str, str]) -> None:
    assert [f"{name}:{found}" for name, text in sources.items() for found in found_in(text)] == []


def test_no_document_and_no_message_has_them(root: Path) -> None:
    names = [*DOCUMENTS, *(str(path.relative_to(root)) for path in root.glob("service/sunarc/*/messages.toml"))]
    assert len(names) > len(DOCUMENTS)
    texts = {name: (root / name).read_text("utf-8") for name in names}
    assert [
        name for name, text in texts.items() if any(WORDS.fullmatch(word) for word in re.findall(r"\w+", text))
    ] == []


def test_every_module_and_every_public_name_has_a_docstring(sources: dict[str, str]) -> None:
    assert [name for name, text in sources.items() if ast.get_docstring(ast.parse(text)) is None] == []


def test_first_lines_begin_with_the_noun_and_no_text_has_a_phrase_of_no_textbook() -> None:
    found = figures.prose(figures.modules())
    assert found["first lines with a relative what, %"] <= MOST_RELATIVE_WHAT
    assert (found["phrases in docstrings"], found["phrases in pages by hand"]) == (0, 0)


def test_no_function_is_named_by_of_or_with_alone(sources: dict[str, str]) -> None:
    found = {
        f"{name}: {node.name}"
        for name, text in sources.items()
        for node in ast.walk(ast.parse(text))
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef) and BARE.fullmatch(node.name)
    }
    assert found == KEPT_NAMES


@pytest.mark.parametrize(
    ("text", "number"),
    [
        ("told = 1\n", 1),
        ("class VouchingFilter: ...\n", 1),
        ("x = 'mend it'\n", 1),
        ("x = 'recommended'\n", 0),
        ("retold_ = 'untold'\n", 0),
        ("x = 'worker_hindered_' + name\n", 0),
        ("x = dict(worker_hindered=1)\n", 0),
        ("worker_was_hindered = 1\n", 1),
        ("def f():\n    '''It is given up.'''\n", 1),
    ],
)
def test_a_word_is_found_in_names_and_texts_and_not_within_others(text: str, number: int) -> None:
    assert len(list(found_in(text))) == number
