"""Every reader of files bears some damaged ones; `tests/release fuzz` draws a million."""

from __future__ import annotations

from pathlib import Path

import pytest
from tests.files import fuzz
from tests.files.fuzz import Reader, edited, fuzzed, readers, trouble

from sunarc.errors import InputError
from sunarc.exports.formats import FORMATS

CASES = 25
NAMES = (
    "sightings", "pairs", "settings", "hub", "npy", "document", "feed", "entry", "case", "joint", "lens", "image.png",
    "image.jpg", "image.tiff", "image.bmp",
    *(f"view-{form.name}" for form in FORMATS.values() if form.read is not None),
)  # fmt: skip


@pytest.fixture(scope="module")
def made() -> dict[str, Reader]:
    """Return the readers by their names; their files take seconds to make."""
    return {one.name: one for one in readers()}


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("name", NAMES)
def test_a_reader_answers_or_refuses_whatever_it_is_given(name: str, made: dict[str, Reader]) -> None:
    if name not in made:
        pytest.skip(f"{name} writes no file of such a lens, or its extra is missing")
    assert fuzzed(made[name], count=CASES, number=1) is None


def test_every_reader_is_asked(made: dict[str, Reader]) -> None:
    assert set(made) <= set(NAMES)


def test_what_a_reader_must_not_do_is_found(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(fuzz, "SLOWEST_S", 0.05)

    def slow(content: bytes, _: Path) -> object:
        return sum(range(10**7)) if content else None

    def broken(content: bytes, _: Path) -> object:
        return content[100]

    def refusing(content: bytes, _: Path) -> object:
        raise InputError(field="a", problem=str(len(content)), remedy="b")

    found = [trouble(Reader("one", (b"a",), read), b"a", tmp_path) for read in (slow, broken, refusing)]
    assert [one is None for one in found] == [False, False, True]


def test_an_edit_changes_a_file_where_it_says() -> None:
    assert edited(b"abcdef", [("set", 1, 2, b"X")]) == b"aXdef"
    assert edited(b"abcdef", [("cut", 1, 2, b"")]) == b"adef"
    assert edited(b"abcdef", [("end", 2, 0, b"")]) == b"ab"
    assert edited(b"ab", [("double", 0, 1, b"")]) == b"aaaab"
    assert edited(b"a", [("flip", 0, 1, b"")]) == b"c"
