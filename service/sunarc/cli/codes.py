"""The command `sunarc codes`: the codes of findings with their meaning and action, as the page docs/codes.md."""

from __future__ import annotations

import re
from collections.abc import Iterable
from typing import NamedTuple

from sunarc.calibration.messages import MESSAGES as OF_CALIBRATION
from sunarc.changes.messages import MESSAGES as OF_CHANGES
from sunarc.cli.options import AsJson, print_json
from sunarc.common.findings import Messages
from sunarc.detection.messages import MESSAGES as OF_DETECTION
from sunarc.formats.messages import MESSAGES as OF_FORMATS
from sunarc.imager.app.status_line import MESSAGES as OF_APP
from sunarc.imager.archive.messages import MESSAGES as OF_ARCHIVE
from sunarc.imager.commands.first_look import MESSAGES as OF_COMMANDS
from sunarc.imager.runtime.supervisor import MESSAGES as OF_RUNTIME
from sunarc.imager.workers.messages import MESSAGES as OF_WORKERS
from sunarc.lab.studies.messages import MESSAGES as OF_STUDIES
from sunarc.sources.messages import MESSAGES as OF_SOURCES
from sunarc.stars.messages import MESSAGES as OF_STARS

_TABLES: dict[str, Messages] = {
    "detection": OF_DETECTION,
    "calibration": OF_CALIBRATION,
    "changes": OF_CHANGES,
    "stars": OF_STARS,
    "imager/archive": OF_ARCHIVE,
    "imager/runtime": OF_RUNTIME,
    "imager/workers": OF_WORKERS,
    "imager/app": OF_APP,
    "formats": OF_FORMATS,
    "sources": OF_SOURCES,
    "lab/studies": OF_STUDIES,
    "imager/commands": OF_COMMANDS,
}
_HEAD = """# Codes of findings

Verdicts of calibrations and days, sightings, conditions in `/readyz` and `/v1/status`, and events carry
`findings: [{"code", "data"}]`. Codes and data are stable; the sentences are not. The code of a worker's condition ends
with the worker's name (`worker_stuck_capture`). This page is the output of `sunarc codes`.
"""


class Code(NamedTuple):
    """A code, the package (`room`) that makes it, its sentence, what it means, and what to do."""

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
    """Return the codes of all packages, each one's in alphabetical order."""
    return [Code(code, package, *table[code]) for package, table in _TABLES.items() for code in sorted(table)]


def codes_as_markdown(codes: Iterable[Code]) -> str:
    """Return the page docs/codes.md."""
    rows, package = [_HEAD], ""
    for one in codes:
        if one.room != package:
            package = one.room
            rows.append(f"\n## `{package}/`\n\n| code | message | meaning | action |\n|---|---|---|---|\n")
        rows.append(f"| `{one.code}` | {_plain(one.text)} | {_plain(one.meaning)} | {_plain(one.action)} |\n")
    return "".join(rows)


def _plain(template: str) -> str:
    """Return a template with the names of its data only, and bars that do not end a cell of the table."""
    counted = re.sub(r"\{(\w+):([a-z]{3,})\}", r"{\1} \2s", template)
    return re.sub(r"\{(\w+)[^}]*\}", r"{\1}", counted).replace("|", "\\|").replace("\n", " ")
