"""Findings: what was found, as a code and data; a package's table of messages makes the sentence of it."""

from __future__ import annotations

import math
import re
import string
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, NamedTuple

Data = Mapping[str, float | int | str]

UNCODED = "uncoded"
"""Code of a sentence that a program wrote which had no codes yet (version 0.2 and before)."""


@dataclass(frozen=True, slots=True)
class Finding:
    """What was found.

    Attributes
    ----------
    code : stable name, in the table of docs/codes.md.
    data : its numbers and names, by the names in the message of the code.
    """

    code: str
    data: Data = field(default_factory=dict)

    def as_json(self) -> dict[str, Any]:
        """Return the JSON object of the finding; a number that is not finite is null."""
        data = {key: None if _is_undefined(value) else value for key, value in self.data.items()}
        return {"code": self.code, "data": data}


class _Words(string.Formatter):
    """`str.format`, with a count of things as `{n:day}` (1 day, 2 days) and two significant digits as `{x:~2}`."""

    def format_field(self, value: object, format_spec: str) -> str:
        if isinstance(value, float) and not math.isfinite(value):
            return "unknown"
        if format_spec.startswith("~") and isinstance(value, int | float):
            return significant(value, int(format_spec[1:]))
        if re.fullmatch("[a-z]{3,}", format_spec):
            return counted(value, format_spec)
        return str(super().format_field(value, format_spec))


_WORDS = _Words()


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


class Message(NamedTuple):
    """The message of a code.

    text: the sentence, a template of `str.format` over the data; `{n:day}` is a count, `{x:~2}` has two digits.
    meaning: what it says of the service. action: what to do about it, a template too.
    """

    text: str
    meaning: str
    action: str = "none"


class Messages(dict[str, Message]):
    """The messages of a package, by code."""

    def text_of(self, finding: Finding) -> str:
        """Return the sentence of a finding; of an unknown code (another version's) the code and its data."""
        return self._filled(finding, 0) or f"{finding.code} {dict(finding.data)}"

    def remedy_of(self, finding: Finding) -> str:
        """Return what to do about a finding; of an unknown code "none"."""
        return self._filled(finding, 2) or "none"

    def _filled(self, finding: Finding, column: int) -> str | None:
        try:
            return _WORDS.vformat(self[finding.code][column], (), finding.data)
        except (KeyError, ValueError, TypeError):  # a stored finding of another version may lack a value
            return None


def uncoded(text: str) -> Finding:
    """Return the finding of a sentence without a code."""
    return Finding(UNCODED, {"text": text})


def from_json(stored: object) -> Finding:
    """Return the finding of a JSON object, or of a sentence where there is no code; null is NaN."""
    if not isinstance(stored, Mapping):
        return uncoded(str(stored))
    data = stored.get("data")
    values = data.items() if isinstance(data, Mapping) else ()
    return Finding(str(stored.get("code", UNCODED)), {str(k): math.nan if v is None else v for k, v in values})


def findings_of(stored: Mapping[str, Any]) -> tuple[Finding, ...]:
    """Return the findings of a JSON object that has `findings`, or only `reasons` (version 0.2 and before)."""
    return tuple(from_json(one) for one in stored.get("findings") or stored["reasons"])


def _is_undefined(value: object) -> bool:
    return isinstance(value, float) and not math.isfinite(value)
