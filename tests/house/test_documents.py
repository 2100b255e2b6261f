from __future__ import annotations

import doctest
import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
DOCS = ROOT / "docs"
LINK = re.compile(r"\]\(([^)\s#]+)[^)\s]*\)")
PAGES = [*ROOT.glob("*.md"), *DOCS.glob("*.md")]
WITH_EXAMPLES = sorted(str(path.relative_to(ROOT)) for path in PAGES if ">>> " in path.read_text())


def test_the_pages_that_show_values_have_their_examples() -> None:
    assert {"README.md", "docs/conventions.md", "docs/maths.md"} <= set(WITH_EXAMPLES)


@pytest.mark.parametrize("name", WITH_EXAMPLES)
def test_the_examples_do_what_they_say(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(ROOT)
    result = doctest.testfile(str(ROOT / name), module_relative=False, encoding="utf-8")
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
    beside = [(page.name, target) for page in ROOT.glob("*.md") for target in LINK.findall(page.read_text())]
    assert [one for one in beside if "://" not in one[1] and not (ROOT / one[1]).exists()] == []


def test_no_link_of_the_packaged_documents_is_dead_or_leaves_their_folder(tmp_path: Path) -> None:
    folder = tmp_path / "usr" / "share" / "doc" / "sunarc"
    subprocess.run([sys.executable, ROOT / "deploy" / "debian" / "documents.py", ROOT, folder], check=True)
    assert dead(folder) == []
    left = [
        one for one in links(folder) if not (folder / one[0]).parent.joinpath(one[1]).resolve().is_relative_to(folder)
    ]
    assert left == []
    left_out = {".ipynb", ".png", ".svg"}
    whole, packaged = ([one for one in links(of) if Path(one[1]).suffix not in left_out] for of in (DOCS, folder))
    assert 0 <= len(whole) - len(packaged) < 10  # to what is for developers: tests, the client's sources
    assert not [file for file in folder.rglob("*") if file.suffix in left_out]
    assert {"operating.md", "fleet.md", "hub/hub.toml", "hub/backup", "usb3.conf", "sunarc.toml"} <= {
        str(file.relative_to(folder)) for file in folder.rglob("*")
    }
    assert (folder / "hub" / "restore").stat().st_mode & 0o111


MADE = re.compile(r"\d{4}-\d{2}-\d{2}, [0-9a-f]{8}")
NUMBER = re.compile(r"(?<![\w.-])\d+(?:\.\d+)?(?![\w-])")
NO_FIGURES = {"12"}
"""Debian's version."""


def faults_of_results(readme: str, results: str) -> list[str]:
    """Return claims that `readme` does not make, rows without command or date, parts and numbers without a row."""
    said = " ".join(readme.split())
    rows = [
        [cell.strip() for cell in line.strip("|").split(" | ")] for line in results.splitlines() if line[:3] == '| "'
    ]
    claims = [row[0].strip('"| ') for row in rows]
    wrong = [f"not said: {claim}" for claim in claims if claim not in said]
    wrong += [f"not made: {row[0]}" for row in rows if len(row) != 4 or not MADE.search(row[3])]
    wrong += [f"no command: {row[0]}" for row in rows if "`" not in row[2]]
    for part in readme.split("\n## ")[:-1]:
        if not any(claim in " ".join(part.split()) for claim in claims):
            wrong.append(f"no row: {part[:20]}")
    prose = [part for part in readme.split("\n\n") if not part.startswith("    ") and "doi.org" not in part]
    figures = set(NUMBER.findall("\n".join(prose))) - NO_FIGURES
    return wrong + [f"no figure: {one}" for one in sorted(figures) if one not in NUMBER.findall(results)]


def faults_of_commands(results: str) -> list[str]:
    """Return the scripts that are not there, and the options that they do not have."""
    wrong = []
    for command in re.findall(r"`([^`]+)`", results):
        module = re.search(r"python -m (tests[.\w]+)", command)
        named = (
            [module[1].replace(".", "/") + ".py"]
            if module
            else re.findall(r"\b(?:docs|deploy|tests)/[\w/.-]+", command)
        )
        missing = [name for name in named if not (ROOT / name).exists()]
        wrong += [f"no file: {name}" for name in missing]
        text = "".join(
            (ROOT / name).read_text("utf-8") for name in named if name.endswith(".py") and name not in missing
        )
        wrong += [
            f"no option: {one} in {command}" for one in re.findall(r" (--[\w-]+)", command) if text and one not in text
        ]
    return wrong


def test_results_have_a_command_and_a_date_for_what_the_readme_says() -> None:
    readme, results = (ROOT / "README.md").read_text("utf-8"), (DOCS / "results.md").read_text("utf-8")
    assert faults_of_results(readme, results) == []
    assert faults_of_commands(results) == []
    # and each fault is found
    assert faults_of_results(readme.replace("microseconds", "hours"), results.replace("2026-", "")) != []
    assert faults_of_results(readme + "\nIt is right to 0.0123 px.\n", results) == ["no figure: 0.0123"]
    assert faults_of_commands("`python docs/studies/none.py` `python docs/studies/moon.py --none 3`") != []
