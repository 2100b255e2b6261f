from __future__ import annotations

import doctest
import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
DOCS = ROOT / "docs"
LINK = re.compile(r"\]\(([^)\s#]+)[^)\s]*\)")
WITH_EXAMPLES = sorted(path.name for path in DOCS.glob("*.md") if ">>> " in path.read_text())


def test_the_conventions_have_their_example() -> None:
    assert "conventions.md" in WITH_EXAMPLES


@pytest.mark.parametrize("name", WITH_EXAMPLES)
def test_the_examples_do_what_they_say(name: str) -> None:
    result = doctest.testfile(str(DOCS / name), module_relative=False, encoding="utf-8")
    assert result.attempted > 0
    assert result.failed == 0


def test_decisions_are_numbered_and_say_the_four_things() -> None:
    decisions = sorted((DOCS / "decisions").glob("*.md"))
    assert [int(path.name[:4]) for path in decisions] == list(range(1, len(decisions) + 1))
    for path in decisions:
        text = path.read_text()
        assert text.startswith(f"# {path.name[:4]} ")
        assert [part for part in ("Status: ", "## Context", "## Decision", "## Consequences") if part not in text] == []


def links(folder: Path) -> list[tuple[str, str]]:
    """Return page and target of every link of the pages of a folder that leads to another file."""
    return [
        (str(page.relative_to(folder)), target)
        for page in sorted(folder.rglob("*.md"))
        for target in LINK.findall(page.read_text())
        if "://" not in target
    ]


def dead(folder: Path) -> list[tuple[str, str]]:
    return [(page, target) for page, target in links(folder) if not (folder / page).parent.joinpath(target).exists()]


def test_no_link_of_the_documents_is_dead() -> None:
    assert len(links(DOCS)) > 50
    assert dead(DOCS) == []


def test_no_link_of_the_packaged_documents_is_dead_or_leaves_their_folder(tmp_path: Path) -> None:
    folder = tmp_path / "usr" / "share" / "doc" / "sunarc"
    subprocess.run([sys.executable, ROOT / "deploy" / "debian" / "documents.py", ROOT, folder], check=True)
    assert dead(folder) == []
    left = [
        one for one in links(folder) if not (folder / one[0]).parent.joinpath(one[1]).resolve().is_relative_to(folder)
    ]
    assert left == []
    lost = len(links(DOCS)) - len(links(folder))
    assert 0 <= lost < 10  # to what is for developers: tests, the client's sources
    assert {"operating.md", "fleet.md", "hub/hub.toml", "hub/backup", "usb3.conf", "sunarc.toml"} <= {
        str(file.relative_to(folder)) for file in folder.rglob("*")
    }
    assert (folder / "hub" / "restore").stat().st_mode & 0o111
