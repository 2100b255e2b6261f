"""Paths, modules, commands, options, routes and settings that a page names exist."""

from __future__ import annotations

import json
import re
import shlex
from collections.abc import Callable, Iterator
from functools import cache
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import pytest
from typer.exceptions import TyperException

from sunarc.cli.main import houses, load_command
from sunarc.imager.settings.reference import all_settings

CODE = re.compile(r"^```.*?^```|^ {4,}\S.*(?:\n+ {4,}\S.*)*|`[^`]+`", re.MULTILINE | re.DOTALL)
"""What is set as code: blocks, and spans between backticks."""
PATH = re.compile(r"(?<![\w/.{<:-])(?:docs|deploy|tests|service|migrations|client)/[\w./-]*\w")
FILE = re.compile(r"(?<![\w/.{-])(?:[a-z_]+/)+[a-z_0-9]+\.py\b")
MODULE = re.compile(r"(?<![\w./@-])(?:sunarc|sunarc_client|tests)(?:\.[a-z_][a-z_0-9]*)+\b(?![/@-])")
ROUTE = re.compile(r"(?<![\w.])/v1/[\w{}/.:-]*")
COMMAND = re.compile(
    r"(?:^|`|\$ |\| |; )\s*(?:sudo )?(?:\.venv/bin/)?sunarc ([a-z][a-z-]*(?: [a-z][a-z-]*)?)((?:[^`\n#|;]|\\\n)*)",
    re.MULTILINE,
)
LINE = re.compile(r"(?:^|\$ |\| |; |&& |sudo )\s*(?:\.venv/bin/)?sunarc ([a-z][^\n|;]*)", re.MULTILINE)
SETTING = re.compile(r"(?<![\w./-])([a-z]+\.[a-z_.]+[a-z])(?![\w(/.-])")
FILES = {"toml", "service", "path", "sqlite", "timer", "conf", "deb", "json", "jpg", "png"}
FILES |= {"yaml", "yml", "py", "html", "csv", "md", "npz"}
"""Ends of files that begin as a module or a setting does: sunarc.toml, camera.yaml."""
NOT_IN_THE_TREE = {"deploy/releases.txt": "deploy/release writes it", "sunarc.commands": "a group of entry points"}


def pages(root: Path) -> dict[str, str]:
    """Return the pages by name; the changelog names what was."""
    files = [*root.glob("*.md"), root / "tests" / "README.md", *(root / "docs").rglob("*.md")]
    return {str(file.relative_to(root)): file.read_text("utf-8") for file in files if file.name != "CHANGELOG.md"}


def code_of(text: str) -> Iterator[str]:
    """Yield a page's code."""
    yield from CODE.findall(text)


def paths(root: Path) -> Callable[[str], Iterator[str]]:
    """Return what yields the paths that do not exist: from the root, or the end of a module's path."""
    modules = [f"/{path.relative_to(root)}" for path in root.glob("service/sunarc/**/*.py")]
    modules += [
        f"/{path.relative_to(root)}"
        for top in ("docs", "tests", "deploy", "client")
        for path in root.glob(f"{top}/**/*.py")
    ]

    def missing(code: str) -> Iterator[str]:
        for name in {*PATH.findall(code), *FILE.findall(code)} - set(NOT_IN_THE_TREE):
            if not (root / name).exists() and not any(one.endswith(f"/{name}") for one in modules):
                yield name

    return missing


def modules(code: str) -> Iterator[str]:
    """Yield the names below `sunarc` and `tests` that are no module, and nothing in one."""
    for name in MODULE.findall(code):
        if name.rpartition(".")[2] not in FILES and name not in NOT_IN_THE_TREE and not _is_importable(name):
            yield name


@cache
def _is_importable(name: str) -> bool:
    parts = name.split(".")
    for n in range(len(parts), 0, -1):
        try:
            found = find_spec(".".join(parts[:n]))
        except (ImportError, AttributeError, ValueError):
            continue
        if found is None:
            continue
        if n == len(parts):
            return True
        thing: Any = import_module(".".join(parts[:n]))
        return all((thing := getattr(thing, part, None)) is not None for part in parts[n:])
    return False


def routes(root: Path) -> Callable[[str], Iterator[str]]:
    """Return what yields the routes that neither an imager nor a hub has."""
    known = list(json.loads((root / "docs" / "openapi.json").read_text("utf-8"))["paths"])
    known += [
        path for file in root.glob("service/sunarc/hub/*.py") for path in re.findall(r'"(/v1/[^"]*)"', file.read_text())
    ]
    patterns = [
        re.compile("/".join("[^/]+" if "{" in part else re.escape(part) for part in one.split("/"))) for one in known
    ]

    def missing(code: str) -> Iterator[str]:
        for name in ROUTE.findall(code):
            bare = name.rstrip("/.:").removeprefix("/v1/cameras/{camera}") or "/v1/cameras"
            bare = bare if bare.startswith("/v1") else f"/v1{bare}"
            if name.rstrip("/") != "/v1" and not any(
                one.fullmatch(bare) or one.fullmatch(name.rstrip("/.:")) for one in patterns
            ):
                yield name

    return missing


@cache
def _known_settings() -> frozenset[str]:
    return frozenset(one.name for one in all_settings())


def settings(code: str) -> Iterator[str]:
    """Yield the settings that do not exist, of sections that do."""
    known = _known_settings()
    sections = {name.partition(".")[0] for name in known if "." in name}
    for name in SETTING.findall(code):
        first, last = name.partition(".")[0], name.rpartition(".")[2]
        if first in sections and last not in FILES and not any(f"{one}.".startswith(f"{name}.") for one in known):
            yield name


def commands(code: str) -> Iterator[str]:
    """Yield the commands and options that do not exist."""
    known = {name for house in houses().values() for name in house}
    for words, rest in COMMAND.findall(code):
        name, *further = f"{words} {rest}".split()
        if name not in known:
            yield f"sunarc {name}"
            continue
        command = load_command(name)
        while inner := getattr(command, "commands", None):
            named = further.pop(0) if further else ""
            if not re.fullmatch(r"[a-z-]+", named):  # the group itself, or several of its commands
                break
            if named not in inner:
                yield f"sunarc {name} {named}"
                break
            name, command = f"{name} {named}", inner[named]
        else:
            options = {option for one in command.params for option in (*one.opts, *one.secondary_opts)} | {"--help"}
            stated = re.findall(r"(?<!\S)\[?(--[a-z][a-z-]*)", " ".join(further))
            yield from (f"sunarc {name} {one}" for one in stated if one not in options)


def unparsed(code: str) -> Iterator[str]:
    """Yield the command lines of a block that the command does not take: a missing argument, a value out of bounds."""
    known = {name for house in houses().values() for name in house}
    lines = LINE.findall(code.replace("\\\n", " ")) if not code.startswith("`") or code.startswith("```") else []
    for line in lines:
        words = shlex.split(re.split(r"\s#\s|\s{4}|\s[<>&]", line)[0])
        if not words or words[0] not in known or {"…", "--help"} & {*words} or "`" in line:
            continue
        name, *further = words
        command = load_command(name)
        try:
            while inner := getattr(command, "commands", None):
                name = further.pop(0)
                command = inner[name]
            command.make_context(name, further)
        except TyperException as error:
            yield f"sunarc {line.strip()}: {error.format_message()}"


def kinds(root: Path) -> dict[str, Callable[[str], Iterator[str]]]:
    return {
        "paths": paths(root),
        "modules": modules,
        "routes": routes(root),
        "settings": settings,
        "commands": commands,
        "command lines": unparsed,
    }


@pytest.mark.parametrize("kind", ["paths", "modules", "routes", "settings", "commands", "command lines"])
def test_what_a_page_names_exists(root: Path, kind: str) -> None:
    missing = kinds(root)[kind]
    found = [f"{page}: {one}" for page, text in pages(root).items() for code in code_of(text) for one in missing(code)]
    assert found == []


@pytest.mark.parametrize(
    ("kind", "wrong", "right"),
    [
        ("paths", "`docs/none.md`", "`docs/maths.md`"),
        ("paths", "`imager/none.py`", "`imager/checks.py`"),
        ("modules", "`python -m sunarc.none`", "`sunarc.common.utc`"),
        ("modules", "`sunarc.common.utc.none`", "`sunarc.common.utc.utc_time`"),
        ("routes", "`GET /v1/none`", "`GET /v1/cameras/{camera}/status`"),
        ("routes", "`/v1/calibrations/ID/none`", "`/v1/fleet`"),
        ("settings", "`camera.none`", "`capture.cadence_s`"),
        ("commands", "`sunarc none`", "`sunarc init`"),
        ("commands", "`sunarc db none FILE`", "`sunarc db backup FILE --state DIR`"),
        ("commands", "    .venv/bin/sunarc calibrate POINTS --none 1", "    .venv/bin/sunarc calibrate POINTS --json"),
        ("commands", "`sunarc study benchmark none`", "`sunarc study benchmark make`"),
        ("command lines", "    sunarc db backup", "    sudo sunarc db backup FILE --state DIR    # a copy"),
        ("command lines", "    $ sunarc stars a.png --blind --image-size x", "    sunarc codes > docs/codes.md"),
    ],
)
def test_a_name_of_nothing_is_found(root: Path, kind: str, wrong: str, right: str) -> None:
    missing = kinds(root)[kind]
    assert [len([*missing(code)]) for text in (wrong, right) for code in code_of(text)] == [1, 0]
