"""What a message asks to be typed is there: the command, its options, the settings."""

from __future__ import annotations

import ast
import re
from functools import cache
from pathlib import Path
from typing import Any

import pytest

from sunarc.cli import main
from sunarc.cli.codes import all_codes

SERVICE = Path(main.__file__).parents[1]
OPTION = re.compile(r"(?<![\w-])--[a-z][a-z-]*\b")
CALL = re.compile(r"`?\bsunarc ((?:[a-z]+ ?){1,2})((?:[^`;,)]|\(ID\))*)")
OTHERS = {"--kill-who": "systemctl", "--verify": "dpkg", "--user": "systemctl", "--editable": "pip"}
"""Options of other programs in messages."""


@cache
def options() -> dict[str, set[str]]:
    """Return the options of each command by its words, as `db restore`."""
    found: dict[str, set[str]] = {}

    def add(words: str, command: Any) -> None:  # noqa: ANN401 - click's
        found[words] = {name for one in command.params for name in one.opts if name.startswith("-")}
        for name, below in getattr(command, "commands", {}).items():
            add(f"{words} {name}", below)

    for commands in main.houses().values():
        for name in commands:
            add(name, main.load_command(name))
    return found


def texts_of_sources() -> dict[str, str]:
    """Return the strings of the arguments `problem`, `remedy` and `field` of all sources, by where they stand."""
    found = {}
    for path in sorted(SERVICE.rglob("*.py")):
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.keyword) and node.arg in {"problem", "remedy", "field"}:
                parts = [one.value for one in ast.walk(node.value) if isinstance(one, ast.Constant)]
                found[f"{path.relative_to(SERVICE)}:{node.value.lineno}"] = " ".join(map(str, parts))
    return found


@cache
def texts() -> dict[str, str]:
    return {one.code: f"{one.text} {one.action}" for one in all_codes()} | texts_of_sources()


def unknown_options(text: str) -> set[str]:
    known = set().union(*options().values()) | {"--help", *OTHERS}
    return set(OPTION.findall(text)) - known


def wrong_calls(text: str) -> list[str]:
    """Return the commands that a text names and that are not there, or lack an option that it names with them."""
    wrong = []
    for words, rest in CALL.findall(text):
        named = [words.strip(), words.strip().partition(" ")[0]]
        command = next((one for one in named if one in options()), None)
        if command is None:
            wrong.append(words.strip())
        else:
            wrong += [f"{command} {one}" for one in OPTION.findall(rest) if one not in options()[command] | {"--help"}]
    return wrong


def test_every_option_that_a_message_names_is_one_of_a_command() -> None:
    assert sum("--" in text for text in texts().values()) > 80
    assert {where: found for where, text in texts().items() if (found := unknown_options(text))} == {}


def test_every_command_that_a_message_names_is_there_with_its_options() -> None:
    assert {where: found for where, text in texts().items() if (found := wrong_calls(text))} == {}


@pytest.mark.parametrize(
    ("text", "wrong"),
    [("`sunarc calibrate --joint FILE`", []), ("run `sunarc db restore --latest`", []), ("sunarc cal", ["cal"]),
     ("`sunarc detect --joint FILE`", ["detect --joint"])],
)  # fmt: skip
def test_a_wrong_call_is_found(text: str, wrong: list[str]) -> None:
    assert wrong_calls(text) == wrong
    assert unknown_options("give --lattitude") == {"--lattitude"}
