"""Lays the sources of the site: pages.py CHECKOUT FOLDER makes FOLDER/pages for Sphinx."""

from __future__ import annotations

import importlib.util
import json
import os
import re
import shutil
import sys
from pathlib import Path
from typing import Any

import sunarc
from sunarc.cli.main import houses, load_command

HOUSES = ("library", "imager", "archives", "hub", "lab", "client", "cli")
PARTS = {
    "Tutorials": ("first-hour", *(f"tutorials/{name}" for name in ("csv", "summer", "mast", "night"))),
    "First steps": ("explanation", "faq", "troubleshooting", "python", "glossary"),
    "Operate": (
        "operating", "operating/install", "operating/run", "operating/sources", "operating/images",
        "operating/names", "operating/archives", "operating/alerts", "operating/rehearse", "operating/another-machine",
        "operating/tasks",
        "fleet", "push", "container", "security", "scale",
    ),
    "Understand": (
        "architecture", *(f"architecture/{house}" for house in HOUSES), "architecture/workers",
        "conventions", "maths", "model",
        "results", "studies", "benchmark/README", "benchmark/results",
    ),
    "Reference": (
        "api", "commands", "routes", "rest", "settings", "codes", "checks", "formats", "feed", "metrics", "versions",
    ),
    "Develop": (
        "contributing", "developing", "extending", "decisions/index", "campaign", "booted", "reporting", "changes",
    ),
}  # fmt: skip
OF_THE_ROOT = {"CONTRIBUTING.md": "contributing.md", "SECURITY.md": "reporting.md", "CHANGELOG.md": "changes.md"}


def documents(checkout: Path) -> Any:  # noqa: ANN401 - a module
    """Return the module that lays the documents, told to leave nothing out."""
    stated = importlib.util.spec_from_file_location("documents", checkout / "deploy" / "debian" / "documents.py")
    if stated is None or stated.loader is None:
        raise FileNotFoundError("deploy/debian/documents.py")
    module = importlib.util.module_from_spec(stated)
    stated.loader.exec_module(module)
    vars(module)["LEFT_OUT"] = set()
    return module


def lay(checkout: Path, folder: Path) -> None:
    """Lay all pages; those of the root stand beside those of docs/."""
    module = documents(checkout)
    module.lay_documents(checkout, folder)
    for name, place in OF_THE_ROOT.items():
        text = (checkout / name).read_text("utf-8")
        (folder / place).write_text(re.sub(r"\]\(docs/", "](", text), "utf-8")
    (folder / "index.md").write_text(index(checkout), "utf-8")
    shutil.copy(checkout / "docs" / "dashboard.png", folder)
    titles = {
        page: page.read_text("utf-8").partition("\n")[0].removeprefix("# ") for page in folder.glob("decisions/0*.md")
    }
    listed = "\n".join(page.name for page in sorted(titles))
    (folder / "decisions" / "index.md").write_text(f"# Decisions\n\n```{{toctree}}\n{listed}\n```\n", "utf-8")
    (folder / "api.md").write_text(api(), "utf-8")
    (folder / "commands.md").write_text(commands(), "utf-8")
    (folder / "routes.md").write_text(routes(checkout), "utf-8")
    for page in folder.rglob("*.md"):
        page.write_text(with_pages(page, module.LINK), "utf-8")


def with_pages(page: Path, link: re.Pattern[str]) -> str:
    """Return a page's text; a link to a folder leads to its index, one to nothing becomes its text."""

    def linked(match: re.Match[str]) -> str:
        text, target, part = match.groups(default="")
        place = Path(os.path.normpath(page.parent / target))
        if "://" in target or place.is_file():
            return match[0]
        inner = place / "index.md"
        return f"[{text}]({os.path.relpath(inner, page.parent)}{part})" if inner.is_file() else text

    return link.sub(linked, page.read_text("utf-8"))


def index(checkout: Path) -> str:
    """Return the first page: the README's beginning, and the tables of contents."""
    begin = (checkout / "README.md").read_text("utf-8").partition("## By hand")[0]
    begin = re.sub(r"\]\(docs/", "](", begin)
    trees = [
        f"```{{toctree}}\n:hidden:\n:maxdepth: 1\n:caption: {caption}\n\n" + "\n".join(names) + "\n```"
        for caption, names in PARTS.items()
    ]
    return begin + "\n\n".join(trees) + "\n"


def api() -> str:
    """Return the page of the public names."""
    parts = ["# Python API\n\nThe names of `import sunarc`; [From Python](python.md) shows how they go together.\n"]
    for name in sorted(sunarc.__all__):
        thing = getattr(sunarc, name)
        kind = "autoclass" if isinstance(thing, type) else "autofunction"
        members = "\n   :members:" if kind == "autoclass" and not issubclass(thing, Exception) else ""
        parts.append(f"## {name}\n\n```{{eval-rst}}\n.. {kind}:: sunarc.{name}{members}\n```\n")
    return "\n".join(parts)


def commands() -> str:
    """Return the page of the commands, each as its --help prints it."""
    parts = ["# Commands\n\nEach command as `--help` prints it.\n"]
    names = [name for house in houses().values() for name in house]
    for words, command in [one for name in sorted(names) for one in within(f"sunarc {name}", load_command(name))]:
        printed = command.get_help(command.context_class(command, info_name=words, terminal_width=90))
        parts.append(f"## {words}\n\n```text\n{printed.strip()}\n```\n")
    return "\n".join(parts)


def within(words: str, command: Any) -> list[tuple[str, Any]]:  # noqa: ANN401 - click's
    """Return a command and those within it, each with its words."""
    inner = getattr(command, "commands", None) or {}
    return [(words, command), *(one for name in inner for one in within(f"{words} {name}", inner[name]))]


def routes(checkout: Path) -> str:
    """Return the page of the routes."""
    described = json.loads((checkout / "docs" / "openapi.json").read_text("utf-8"))
    parts = [
        "# Routes\n\nOf an imager, as `/openapi.json` describes them; [the REST guide](rest.md) explains them.\n",
        "| method | route | returns |",
        "|---|---|---|",
    ]
    for path, methods in described["paths"].items():
        for method, one in methods.items():
            parts.append(f"| {method.upper()} | `{path}` | {one.get('summary', '').replace('|', chr(92) + '|')} |")
    return "\n".join(parts) + "\n"


if __name__ == "__main__":
    lay(Path(sys.argv[1]).resolve(), Path(sys.argv[2]).resolve() / "pages")
