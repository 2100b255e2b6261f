"""Write the page of a run that is too long for tests/run, with its date and commit, from the file that the run left.

    .venv/bin/python -m tests.release.last_run booted FILE.xml docs/booted.md       pytest's --junitxml
    .venv/bin/python -m tests.release.last_run campaign FILE.json docs/campaign.md  tests/campaign --json
    .venv/bin/python -m tests.release.last_run campaign FOLDER docs/campaign.md     tests/campaign --keep, while it runs

`deploy/test-booted --page FILE` and `tests/release/run` do it.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
from collections.abc import Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET

ROOT = Path(__file__).resolve().parents[2]
REPAIRS = Path(__file__).with_name("campaign_repairs.md")
_MOST_CHARACTERS = 400
_MOST_LISTED = 4
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


def campaign(reports: Sequence[dict[str, Any]], *, repairs: str = "") -> list[str]:
    """Return the lines of a page on a campaign of faults.

    Parameters
    ----------
    reports : of each source, as `tests/campaign` leaves them.
    repairs : what campaigns found, and how it was repaired.

    Raises
    ------
    ValueError
        Where no fault was done.
    """
    kinds = sorted({kind for report in reports for kind in report["faults"]})
    if not kinds:
        raise ValueError("no fault was done")
    heads = [f"{report['source']} {report['seed']}" for report in reports]
    rows = [(kind, *(report["faults"].get(kind, 0) for report in reports)) for kind in kinds]
    total = sum(sum(row[1:]) for row in rows)
    windows = sum(report.get("windows", 0) for report in reports)
    bad = sum(not report["good"] for report in reports)
    outcome = f"**{bad} not good**" if bad else "all good"
    runs = f"{len(reports)} runs by source and seed"
    lines = [
        f"{total:,} faults of {len(kinds)} kinds in {windows} windows, {runs}: {outcome}.",
        "",
        *_table(("fault", *heads, "all"), [(*row, sum(row[1:])) for row in rows]),
        "",
        *_table(("found", *heads), [(name, *(_said(one.get(name)) for one in reports)) for name in _names(reports)]),
    ]
    for report, head in zip(reports, heads, strict=True):
        lines += [line for window in report.get("failed", ()) for line in _failed(head, window)]
    return [*lines, *(["", "## Found and repaired", "", repairs.strip()] if repairs else [])]


def _names(reports: Sequence[dict[str, Any]]) -> list[str]:
    apart = {"source", "seed", "faults", "failed"}
    return [name for name in dict.fromkeys(name for report in reports for name in report) if name not in apart]


def _said(value: object) -> str:
    """Return a cell of what was found: of a long list of numbers its middle and largest, of a list its length."""
    if isinstance(value, list) and value and all(isinstance(one, int | float) for one in value):
        return f"{sorted(value)[len(value) // 2]:.3g}, at most {max(value):.3g}"
    if isinstance(value, list) and len(value) > _MOST_LISTED:
        return str(len(value))
    if isinstance(value, dict | list):
        return _cell(", ".join(map(str, value)) if isinstance(value, list) else json.dumps(value).strip("{}")) or "0"
    return "" if value is None else _cell(f"{value:.3g}" if isinstance(value, float) else str(value))


def _failed(head: str, window: dict[str, Any]) -> list[str]:
    singly = [f"{fault}: {'; '.join(found) or 'good'}" for fault, found in window["singly"].items()]
    found = f"{', '.join(window['faults'])}: {'; '.join(window['found'])}"
    return [
        "",
        _cell(f"{head}, window {window['number']}: {found}"),
        *([_cell(f"Singly: {', '.join(singly)}")] * bool(singly)),
    ]


def _table(head: Sequence[object], rows: Sequence[Sequence[object]]) -> list[str]:
    return [f"| {' | '.join(map(str, row))} |" for row in (head, ["---"] * len(head), *rows)]


def _reports_of(path: Path) -> list[dict[str, Any]]:
    files = sorted(path.rglob("report.json")) if path.is_dir() else [path]
    read = [json.loads(file.read_text("utf-8")) for file in files]
    return [report for one in read for report in (one if isinstance(one, list) else [one])]


def page(kind: str, lines: list[str], *, commit: str, moment: datetime) -> str:
    """Return the page of a run."""
    title = {"booted": "The booted set's last run", "campaign": "The campaign's last run"}[kind]
    command = {"booted": "deploy/test-booted --page", "campaign": "tests/release/run campaign"}[kind]
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
        if chosen.kind == "booted":
            lines = booted(chosen.file.read_text("utf-8"))
        else:
            lines = campaign(_reports_of(chosen.file), repairs=REPAIRS.read_text("utf-8"))
    except (OSError, ValueError, KeyError, TypeError, AttributeError, ET.ParseError) as error:
        print(f"last_run: {chosen.file}: {error}", file=sys.stderr)
        return 1
    asked = ["git", "describe", "--always", "--dirty", "--abbrev=12"]
    commit = subprocess.run(asked, cwd=ROOT, capture_output=True, text=True, check=True).stdout.strip()
    chosen.out.write_text(page(chosen.kind, lines, commit=commit, moment=datetime.now(UTC)), "utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
