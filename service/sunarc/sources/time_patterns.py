"""Patterns of times in paths, as `strptime` has them: with folders, seconds since 1970, and parts that vary."""

from __future__ import annotations

import calendar
import re
from datetime import datetime, timedelta
from functools import cache
from itertools import pairwise
from typing import NamedTuple

from sunarc.common.errors import InputError
from sunarc.common.utc import EPOCH
from sunarc.sources.name_times import parse_zone

DIRECTIVES = {
    "Y": (r"\d{4}", "year, four digits"),
    "y": (r"\d{2}", "year, two digits: 69 to 99 are 1969 to 1999"),
    "m": (r"\d{2}", "month"),
    "b": ("|".join(calendar.month_abbr[1:]), "month as Jun"),
    "B": ("|".join(calendar.month_name[1:]), "month as June"),
    "d": (r"\d{2}", "day of the month"),
    "j": (r"\d{3}", "day of the year"),
    "a": ("|".join(calendar.day_abbr), "day of the week as Tue"),
    "A": ("|".join(calendar.day_name), "day of the week as Tuesday"),
    "H": (r"\d{2}", "hour, 00 to 23"),
    "I": (r"\d{2}", "hour, 01 to 12, with `%p`"),
    "p": (r"[ap]m", "AM or PM"),
    "M": (r"\d{2}", "minute"),
    "S": (r"\d{2}", "second"),
    "f": (r"\d{1,6}", "fraction of the second"),
    "s": (r"\d{10}(?:\d{3})?", "seconds since 1970 (10 digits), or milliseconds (13)"),
    "z": (r"Z|[+-]\d{2}:?\d{2}", "zone as +0200, +02:00 or Z"),
    "Z": (r"[A-Z]{1,5}", "zone as UTC or CEST"),
}
"""Regular expression and meaning of each letter after `%`."""
_ONE_OR_TWO = frozenset("mdHIMS")
"""Of one digit, too, where nothing but letters of the pattern stands next to them."""
_WORDS = frozenset("bBaApZ")
_TOKEN = re.compile(r"%(.?)|(\*)|([^%*]+)", re.DOTALL)


class TimePattern(NamedTuple):
    """A pattern that was parsed: of the last folders of a path and its name without ending."""

    parts: int
    """Folders and name."""
    letters: str
    """Of the directives, in their order."""
    expression: re.Pattern[str]

    def read(self, stem: str) -> tuple[datetime, timedelta | None] | None:
        """Return the time in a path without its ending, and how far it is ahead of UTC (None: not stated).

        None where the path does not match whole, or where two of its parts contradict each other.
        """
        found = self.expression.fullmatch("/".join(stem.split("/")[-self.parts :]))
        if found is None:
            return None
        texts = list(zip(self.letters, found.groups(), strict=True))
        try:
            return _parse_epoch_seconds(dict(texts)) if "s" in self.letters else _parse_local_time(texts)
        except (ValueError, OverflowError):
            return None


def _parse_epoch_seconds(texts: dict[str, str]) -> tuple[datetime, timedelta]:
    digits = texts["s"]
    seconds = int(digits[:10]) + float(f"0.{digits[10:] or texts.get('f', '0')}")
    return (EPOCH + timedelta(seconds=seconds)).replace(tzinfo=None), timedelta(0)


def _parse_local_time(texts: list[tuple[str, str]]) -> tuple[datetime, timedelta | None] | None:
    first = {letter: text for letter, text in reversed(texts) if letter not in "zZ"}
    time = datetime.strptime("\n".join(first.values()), "\n".join(f"%{letter}" for letter in first))  # noqa: DTZ007 - its zone is beside it
    if not all(_agrees_with_time(time, letter, text) for letter, text in texts):
        return None
    zones = [parse_zone(text) for letter, text in texts if letter in "zZ"]
    if None in zones or len(set(zones)) > 1:
        return None
    return time, zones[0] if zones else None


def _agrees_with_time(time: datetime, letter: str, text: str) -> bool:
    """Return whether a part of a path agrees with a time; a folder may state another date."""
    if letter in "fzZ":
        return True
    written = time.strftime(f"%{letter}")
    return int(written) == int(text) if text.isdecimal() else written.casefold() == text.casefold()


@cache
def time_pattern(text: str) -> TimePattern:
    """Return a pattern, parsed.

    Parameters
    ----------
    text : `strptime` directives; `*` stands for any letters of one folder or name, but for digits next to digits and
        for letters next to words.

    Raises
    ------
    ValueError : it has other directives, or states no date and hour.
    """
    tokens = [match.groups(default="") for match in _TOKEN.finditer(text)]
    unknown = [token[0] for token in tokens if not any(token[1:]) and token[0] not in {*DIRECTIVES, "%"}]
    if unknown:
        raise ValueError(f"%{unknown[0]} is not one of {', '.join('%' + one for one in DIRECTIVES)}")
    letters = "".join(token[0] for token in tokens if token[0] != "%")
    _require_complete_time(set(letters))
    around = [("", "", "^"), *tokens, ("", "", "$")]
    pieces = [_make_regex_part(before, token, after) for (before, token), (_, after) in pairwise(pairwise(around))]
    return TimePattern(text.count("/") + 1, letters, re.compile("".join(pieces), re.ASCII | re.IGNORECASE))


_Token = tuple[str, ...]


def _make_regex_part(before: _Token, token: _Token, after: _Token) -> str:
    """Return the regular expression of a part of a pattern."""
    letter, any_letters, literal = token
    if literal or letter == "%":
        return re.escape(literal or "%")
    if any_letters:
        return "[^/]*"
    expression, _ = DIRECTIVES[letter]
    if letter in _ONE_OR_TWO and before[2] and after[2]:
        expression = r"\d{1,2}"
    like = r"[^\W\d_]" if letter in _WORDS else r"\d"
    return (f"(?<!{like})" if before[1] else "") + f"({expression})" + (f"(?!{like})" if after[1] else "")


def _require_complete_time(letters: set[str]) -> None:
    if "s" in letters:
        if letters - set("sf"):
            raise ValueError("%s is the whole time; leave out the other directives, or write * for them")
        return
    is_date = letters & set("Yy") and ("j" in letters or ("d" in letters and letters & set("mbB")))
    is_clock = "H" in letters or {"I", "p"} <= letters
    if not is_date or not is_clock:
        missing = "no hour (%H, or %I with %p)" if is_date else "no date (%Y or %y, %m, %d; or %j)"
        raise ValueError(f"it states {missing}")


def checked_pattern(text: str, *, field: str) -> str:
    """Return a pattern that is one.

    Raises
    ------
    InputError : see `time_pattern`.
    """
    try:
        time_pattern(text)
    except ValueError as error:
        raise InputError(
            field=field, problem=f"{text!r}: {error}", remedy="give one as %Y/%m/%d/%H%M%S, cam*_%y%j%H%M or img_%s"
        ) from None
    return text
