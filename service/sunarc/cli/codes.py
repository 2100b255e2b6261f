"""The command `sunarc codes`: the codes of findings with their meaning and action, as the page docs/codes.md."""

from __future__ import annotations

import re
from collections.abc import Iterable
from typing import NamedTuple

from sunarc.cli.options import AsJson, print_json
from sunarc.common.messages import all_messages

_HEAD = """# Codes of findings

Verdicts of calibrations and days, sightings, conditions in `/readyz` and `/v1/status`, and events carry
`findings: [{"code", "data"}]`. Codes and data are stable; the sentences are not. The code of a worker's condition ends
with the worker's name (`worker_stuck_capture`). This page is the output of `sunarc codes`.
"""


class Code(NamedTuple):
    """A code, the package (`room`) that makes it, its sentence, its meaning, and the remedy."""

    code: str
    room: str
    text: str
    meaning: str
    action: str


def codes(*, as_json: AsJson = False) -> None:
    """Print every code of findings with its meaning and action, as the page docs/codes.md.

    Example: sunarc codes --json
    """
    if as_json:
        print_json([one._asdict() for one in all_codes()])
    else:
        print(codes_as_markdown(all_codes()), end="")


def all_codes() -> list[Code]:
    """Return the codes of all installed houses, the library's first, by room and code."""
    codes = [Code(code, one.room, one.text, one.meaning, one.action) for code, one in all_messages()]
    return sorted(codes, key=lambda one: ("/" in one.room, one.room, one.code))


def codes_as_markdown(codes: Iterable[Code]) -> str:
    """Return the page docs/codes.md."""
    rows, package = [_HEAD], ""
    for one in codes:
        if one.room != package:
            package = one.room
            rows.append(f"\n## `{package}/`\n\n| code | message | meaning | action |\n|---|---|---|---|\n")
        rows.append(
            f"| `{one.code}` | {' | '.join(_plain_template(text) for text in (one.text, one.meaning, one.action))} |\n"
        )
    return "".join(rows)


def _plain_template(template: str) -> str:
    """Return a template with the names of its data only, and bars that do not end a cell of the table."""
    counted = re.sub(r"\{(\w+):([a-z]{3,})\}", r"{\1} \2s", template)
    return re.sub(r"\{(\w+)[^}]*\}", r"{\1}", counted).replace("|", "\\|").replace("\n", " ")
