"""Write the page of a run that is too long for tests/run, with its date and commit, from the file that the run left.

    .venv/bin/python -m tests.last_run booted FILE.xml docs/booted.md       pytest's --junitxml
    .venv/bin/python -m tests.last_run campaign FILE.json docs/campaign.md  tests/campaign --json

`deploy/test-booted --page FILE` and `tests/release` do it.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
from datetime import UTC, datetime
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET

ROOT = Path(__file__).resolve().parents[1]
_MOST_CHARACTERS = 160
_OUTCOMES = {"failure": "**failed**", "error": "**failed**", "skipped": "skipped"}


def booted(text: str) -> list[str]:
    """Return the lines of a page on a run of pytest.

    Parameters
    ----------
    text : the XML file of `--junitxml`.

    Raises
    ------
    ValueError
        Where it has no test.
    """
    rows, counts, seconds = [], {"passed": 0, "skipped": 0, "**failed**": 0}, 0.0
    for case in ET.fromstring(text).iter("testcase"):
        kinds = [(_OUTCOMES[part.tag], part.get("message", "")) for part in case if part.tag in _OUTCOMES]
        outcome, why = kinds[0] if kinds else ("passed", "")
        counts[outcome] += 1
        took_s = float(case.get("time", "0"))
        seconds += took_s
        said = f"{outcome}: {_cell(why)}" if why else outcome
        file = case.get("classname", "").rpartition(".")[2]
        rows.append(f"| {file} | {_cell(case.get('name', ''))} | {took_s:.0f} | {said} |")
    if not rows:
        raise ValueError("no test was run")
    total = f"{counts['passed']} passed, {counts['**failed**']} failed, {counts['skipped']} skipped"
    return [
        f"{total}, in {seconds / 60.0:.0f} minutes.",
        "",
        "| file | test | s | outcome |",
        "|---|---|---|---|",
        *rows,
    ]


def campaign(text: str) -> list[str]:
    """Return the lines of a page on a campaign of faults, one source after the other.

    Parameters
    ----------
    text : the JSON file of `tests/campaign --json`.

    Raises
    ------
    ValueError
        Where it states no faults.
    """
    reports: list[dict[str, Any]] = json.loads(text)
    if not reports:
        raise ValueError("no fault was done")
    return [line for report in reports for line in _of_source(report)]


def _of_source(found: dict[str, Any]) -> list[str]:
    faults: dict[str, int] = found.pop("faults")
    good = "good" if found.pop("good") else "**not good**"
    lines = [f"{found.pop('source')}: {sum(faults.values())} faults of seed {found.pop('seed')}: {good}."]
    lines += ["", "| fault | times |", "|---|---|", *(f"| {name} | {n} |" for name, n in sorted(faults.items()))]
    lines += ["", "| found | |", "|---|---|"]
    return [*lines, *(f"| {name} | {_cell(json.dumps(value))} |" for name, value in found.items()), ""]


def page(kind: str, lines: list[str], *, commit: str, moment: datetime) -> str:
    """Return the page of a run."""
    title = {"booted": "The booted set's last run", "campaign": "The campaign's last run"}[kind]
    command = {"booted": "deploy/test-booted --page", "campaign": "tests/release campaign"}[kind]
    host = f"{os.cpu_count()} cores, load {os.getloadavg()[2]:.0f}"
    head = [
        f"# {title}",
        "",
        f"Written by `{command}`. {moment:%Y-%m-%d %H:%M} UTC, commit {commit}, {host}.",
    ]
    return "\n".join([*head, "", *lines]) + "\n"


def _cell(text: str) -> str:
    line = " ".join(text.split()).replace("|", "\\|")
    return line if len(line) <= _MOST_CHARACTERS else f"{line[:_MOST_CHARACTERS]}…"


def main() -> int:
    """Write a page; exit 1 where the run left nothing to tell."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("kind", choices=["booted", "campaign"])
    parser.add_argument("file", type=Path)
    parser.add_argument("out", type=Path)
    chosen = parser.parse_args()
    try:
        lines = {"booted": booted, "campaign": campaign}[chosen.kind](chosen.file.read_text("utf-8"))
    except (OSError, ValueError, ET.ParseError) as error:
        print(f"last_run: {chosen.file}: {error}", file=sys.stderr)
        return 1
    asked = ["git", "describe", "--always", "--dirty", "--abbrev=12"]
    commit = subprocess.run(asked, cwd=ROOT, capture_output=True, text=True, check=True).stdout.strip()
    chosen.out.write_text(page(chosen.kind, lines, commit=commit, moment=datetime.now(UTC)), "utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
