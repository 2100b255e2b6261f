"""Findings: results as a code and data; the message of the code makes the sentence of it."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from sunarc.common.errors import InputError
from sunarc.common.messages import filled, find_message

Data = Mapping[str, float | int | str]

UNCODED = "uncoded"
"""Code of a sentence that a program wrote which had no codes yet (version 0.2 and before)."""


@dataclass(frozen=True, slots=True)
class Finding:
    """A finding: a code and its data.

    Attributes
    ----------
    code : stable name, in the table of docs/codes.md.
    data : its numbers and names, by the names in the message of the code.
    """

    code: str
    data: Data = field(default_factory=dict)

    @property
    def text(self) -> str:
        """The sentence; of an unknown code (another version's) the code and its data."""
        message = find_message(self.code)
        return (message and filled(message.text, self.data)) or f"{self.code} {dict(self.data)}"

    @property
    def remedy(self) -> str:
        """Remedy of the finding; "none" for an unknown code."""
        message = find_message(self.code)
        return (message and filled(message.action, self.data)) or "none"

    @property
    def sentence(self) -> str:
        """Sentence of the finding with its remedy, where it has one."""
        return self.text if self.remedy == "none" else f"{self.text}; {self.remedy}"

    def as_json(self) -> dict[str, Any]:
        """Return the JSON object of the finding; a number that is not finite is null."""
        data = {key: None if _is_undefined(value) else value for key, value in self.data.items()}
        return {"code": self.code, "data": data}


def choose_headline(findings: Sequence[Finding], *, used: int) -> dict[str, Any] | None:
    """Return the cause that took most files, where it took more than were used: its code, its number and its sentence.

    Parameters
    ----------
    findings : why files were left out, one of each.
    used : images that a sun was found in.
    """
    for code, n in Counter(one.code for one in findings).most_common(1):
        example = next(one for one in findings if one.code == code)
        return {"code": code, "n": n, "reason": example.sentence} if n > used else None
    return None


class FindingError(InputError):
    """Input that a finding refuses; its sentence ends with the code.

    Parameters
    ----------
    field : the file, its part, or the option that is wrong.
    finding : why.
    """

    def __init__(self, field: str, finding: Finding) -> None:
        super().__init__(field=field, problem=finding.text, remedy=finding.remedy)
        self.args = (f"{self} [{finding.code}]",)
        self.finding = finding


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


def joined(findings: Iterable[Finding]) -> str:
    """Return the findings of one detection in a sentence, joined as their messages state it."""
    text, after = "", ""
    for finding in findings:
        message = find_message(finding.code)
        text += (text and ((message and message.before) or after)) + finding.text
        after = message.after if message else "; "
    return text


def parse_findings(stored: Mapping[str, Any]) -> tuple[Finding, ...]:
    """Return the findings of a JSON object that has `findings`, or only `reasons` (version 0.2 and before)."""
    return tuple(from_json(one) for one in stored.get("findings") or stored["reasons"])


def _is_undefined(value: object) -> bool:
    return isinstance(value, float) and not math.isfinite(value)
