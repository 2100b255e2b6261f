"""The text of a settings file: values set in place, every other line and every comment kept."""

from __future__ import annotations

import json
import re
import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

from sunarc.common.errors import ConfigurationError, InputError
from sunarc.common.foreign_files import MOST_SETTINGS_BYTES, read_regular

Value = str | int | float | bool

_HEADER = re.compile(r"\s*\[\s*([A-Za-z0-9_.\-]+)\s*\]\s*(?:#.*)?$")
_ANY_HEADER = re.compile(r"\s*\[")
_LONGEST_VALUE = 200
"""Lines of a value: a list may be written over many."""

NEW_FILE = """\
# Settings of sunarc, written by `sunarc init`, which asks again where it is called again: what is not asked is kept.
# `sunarc settings` prints every setting with its default and its meaning. Every setting can also be given in the
# environment, as SUNARC_SECTION__NAME=value. What is not written is at its default.

name = "imager"               # the camera's name in the archive and in documents
state = "/var/lib/sunarc"     # folder of the database and the images

[site]
"""
"""The head of a new file; its sections follow."""

_COMMENTS = {
    "source": "where the images come from: aravis (a GenICam camera), folder, http, rtsp",
    "site.latitude": "degrees, north positive",
    "site.longitude": "degrees, east positive",
    "site.altitude": "metres above sea level",
    "site.timezone": "zone of the local times that are shown",
    "api.port": "of the dashboard and the REST service",
}
"""Comment behind a value on a line that is new; `sunarc settings` has the rest."""
_COMMENT_COLUMN = 30


def toml_value(value: Value) -> str:
    """Return a value as TOML writes it."""
    return json.dumps(value, ensure_ascii=False)


def read_text(path: Path) -> str | None:
    """Return the text of a settings file; None without one.

    Raises
    ------
    ConfigurationError : it cannot be read, or is not TOML in UTF-8.
    """
    try:
        text = read_regular(path, most_bytes=MOST_SETTINGS_BYTES).decode("utf-8-sig")
        tomllib.loads(text)
    except FileNotFoundError:
        return None
    except OSError as error:
        raise ConfigurationError(f"{path}: {error.strerror}; name a settings file that can be read") from None
    except UnicodeDecodeError as error:
        raise ConfigurationError(f"{path}: is not UTF-8 ({error.reason}); save it as UTF-8") from None
    except (ValueError, RecursionError) as error:
        raise ConfigurationError(f"{path}: is not TOML: {error}") from None
    return text


def value_in(text: str, name: str) -> Any:  # noqa: ANN401 - whatever TOML holds
    """Return the value of a setting by its dotted name; None where the text does not set it."""
    found: Any = tomllib.loads(text)
    for part in name.split("."):
        found = found.get(part) if isinstance(found, dict) else None
    return found


def replace_values(text: str, values: Mapping[str, Value]) -> str:
    """Return the text with settings at other values; lines of other settings, comments and line ends are kept.

    A setting that has a line keeps that line's comment; one whose line is commented out gets that line; of others a
    line is added to the section, and a section at the end of the file.

    Parameters
    ----------
    text : of a settings file, valid TOML.
    values : by dotted name; a name without a point is of the top level.

    Raises
    ------
    InputError : a value is written in a form that cannot be changed line by line (within an inline table).
    """
    for name, value in values.items():
        if value_in(text, name) == value and type(value_in(text, name)) is type(value):
            continue
        text = _require_only(text, _replace_value(text, name, value), name, value)
    return text


def _require_only(before: str, after: str, name: str, value: Value) -> str:
    """Return the text after a change; InputError where that has not changed this setting, and this alone."""
    try:
        wanted, found = tomllib.loads(before), tomllib.loads(after)
    except tomllib.TOMLDecodeError:
        wanted, found = {}, {"": None}
    *sections, key = name.split(".")
    table: Any = wanted
    for section in sections:
        table = table.setdefault(section, {}) if isinstance(table, dict) else {}
    if isinstance(table, dict):
        table[key] = value
    if wanted != found:
        raise InputError(
            field=name,
            problem="is written in a form that cannot be changed in place",
            remedy=f"write it on a line of its own in its section: {key} = {toml_value(value)}",
        )
    return after


class _Line(NamedTuple):
    """Range of the lines of a setting, and the comment after its value."""

    first: int
    end: int
    comment: str


def _replace_value(text: str, name: str, value: Value) -> str:
    section, _, key = name.rpartition(".")
    newline = "\r\n" if "\r\n" in text else "\n"
    lines = text.replace("\r\n", "\n").split("\n")
    begin, end = _find_section(lines, section)
    if begin is None:
        while lines and not lines[-1].strip():
            lines.pop()
        lines += ["", f"[{section}]", _new_line(name, key, value), ""]
        return newline.join(lines)
    found = _find_line(lines, begin, end, re.compile(rf"\s*{re.escape(key)}\s*=\s*"))
    found = found or _find_line(lines, begin, end, re.compile(rf"\s*#\s*{re.escape(key)}\s*=\s*"))
    if found is None:
        at = end
        while at > begin and not lines[at - 1].strip():
            at -= 1
        lines[at:at] = [_new_line(name, key, value)]
    else:
        lines[found.first : found.end] = [_comment_text(f"{key} = {toml_value(value)}", found.comment)]
    return newline.join(lines)


def _new_line(name: str, key: str, value: Value) -> str:
    comment = _COMMENTS.get(name, "")
    return _comment_text(f"{key} = {toml_value(value)}", f"# {comment}" if comment else "")


def _comment_text(text: str, comment: str) -> str:
    return f"{text:<{_COMMENT_COLUMN - 1}} {comment}" if comment else text


def _find_section(lines: list[str], section: str) -> tuple[int | None, int]:
    """Return where the lines of a section begin and end; that of "" is the top level, before all others."""
    begin = None if section else 0
    for number, line in enumerate(lines):
        if not _ANY_HEADER.match(line) or _within_value(lines, number):
            continue
        if begin is not None:
            return begin, number
        match = _HEADER.match(line)
        if match is not None and match.group(1) == section:
            begin = number + 1
    return begin, len(lines)


def _within_value(lines: list[str], number: int) -> bool:
    """Return whether a line is not the beginning of one: the lines before it are no TOML by themselves."""
    try:
        tomllib.loads("\n".join(lines[:number]))
    except tomllib.TOMLDecodeError:
        return True
    return False


def _find_line(lines: list[str], begin: int, end: int, pattern: re.Pattern[str]) -> _Line | None:
    for number in range(begin, end):
        match = pattern.match(lines[number])
        if match is None:
            continue
        rest = lines[number][match.end() :]
        for last in range(number, min(end, number + _LONGEST_VALUE)):
            whole = "\n".join([rest, *lines[number + 1 : last + 1]])
            comment = _comment_behind(whole)
            if comment is not None:
                return _Line(number, last + 1, comment)
        return _Line(number, number + 1, "")
    return None


def _comment_behind(value: str) -> str | None:
    """Return the comment behind a value, with its sign; None where the text before every such sign is no value."""
    for at in [*(match.start() for match in re.finditer("#", value)), len(value)]:
        try:
            tomllib.loads(f"value = {value[:at]}")
        except tomllib.TOMLDecodeError:
            continue
        return value[at:].strip()
    return None
