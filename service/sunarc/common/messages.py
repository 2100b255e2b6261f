"""Messages of codes: the sentences, meanings and actions of each house, read from its `messages.toml` when needed."""

from __future__ import annotations

import math
import re
import string
import tomllib
from collections.abc import Iterator, Mapping
from functools import cache
from importlib.resources import files
from typing import NamedTuple

_FILE = "messages.toml"
_LIBRARY = "common"
"""The house that is read first; its rooms are those of the library."""


class Message(NamedTuple):
    """The message of a code.

    text: the sentence, a template of `str.format` over the data; `{n:day}` is a count, `{x:~2}` has two digits.
    meaning: consequence for the service. action: the remedy, a template too.
    before, after: what joins the sentence to the one before it and to the one after it; `before` goes first.
    """

    room: str
    text: str
    meaning: str
    action: str = "none"
    before: str = ""
    after: str = "; "


def find_message(code: str) -> Message | None:
    """Return the message of a code; None where no installed house has it."""
    return next((found[code] for found in map(_load_messages, _find_houses()) if code in found), None)


def all_messages() -> Iterator[tuple[str, Message]]:
    """Yield the codes of all installed houses with their messages, the library's first."""
    for house in _find_houses():
        yield from _load_messages(house).items()


def filled(template: str, data: Mapping[str, object]) -> str | None:
    """Return a template with its data; None where they are not those that it needs."""
    try:
        return _WORDS.vformat(template, (), data)
    except (KeyError, ValueError, TypeError):  # a stored finding of another version may lack a value
        return None


def counted(n: object, noun: str) -> str:
    """Return a number of things with their noun: 1 day, 2 days."""
    return f"{n} {noun}" + ("" if n == 1 else "s")


def significant(value: float | None, digits: int) -> str:
    """Return a number with so many significant digits, without an exponent: 1.2345 is 1.2, and 1234.5 is 1234.

    Digits before the point are all kept. None and what is not finite are `unknown`.
    """
    if value is None or not math.isfinite(value):
        return "unknown"
    leading = int(f"{value:.{digits - 1}e}".partition("e")[2])  # of the rounded number: 0.999 is 1.0
    return f"{value:.{max(digits - 1 - leading, 0)}f}"


class _MessageFormatter(string.Formatter):
    """`str.format`, with a count of things as `{n:day}` (1 day, 2 days) and two significant digits as `{x:~2}`."""

    def format_field(self, value: object, format_spec: str) -> str:
        if isinstance(value, float) and not math.isfinite(value):
            return "unknown"
        if format_spec.startswith("~") and isinstance(value, int | float):
            return significant(value, int(format_spec[1:]))
        if re.fullmatch("[a-z]{3,}", format_spec):
            return counted(value, format_spec)
        return str(super().format_field(value, format_spec))


_WORDS = _MessageFormatter()


@cache
def _find_houses() -> tuple[str, ...]:
    """Return the installed packages that have messages, the library first."""
    found = (house.name for house in files("sunarc").iterdir() if house.joinpath(_FILE).is_file())
    return tuple(sorted(found, key=lambda house: (house != _LIBRARY, house)))


@cache
def _load_messages(house: str) -> dict[str, Message]:
    rooms = tomllib.loads(files("sunarc").joinpath(house, _FILE).read_text(encoding="utf-8"))
    within = "" if house == _LIBRARY else f"{house}/"
    return {code: Message(within + room, **entry) for room, codes in rooms.items() for code, entry in codes.items()}
