"""Codes of findings, for comparisons."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Protocol


class HasCode(Protocol):
    """A finding, or a reason on the status board."""

    @property
    def code(self) -> str: ...


def codes(findings: Iterable[HasCode]) -> list[str]:
    """Return the codes, in order."""
    return [finding.code for finding in findings]
