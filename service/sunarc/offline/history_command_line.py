"""The commands of `sunarc calibrations`: parse, call, print."""

from __future__ import annotations

from datetime import datetime
from typing import Annotated, Any

import typer
from rich.console import Console

from sunarc.archive import parse_time
from sunarc.clock import SystemClock
from sunarc.offline import history
from sunarc.offline.command_line import AsJson, Config
from sunarc.settings import load_settings
from sunarc.terminal import print_json, table

calibrations_cli = typer.Typer(no_args_is_help=True, help="The history of calibrations: see it, roll back, pin.")

Id = Annotated[str, typer.Argument(metavar="ID", help="A calibration's id, see `sunarc calibrations list`.")]
Reason = Annotated[str, typer.Option(help="Why; it is kept.")]
From = Annotated[str | None, typer.Option("--from", help="From when on it answers, ISO 8601; now unless given.")]


@calibrations_cli.command("list")
def list_calibrations(
    config: Config = None,
    *,
    limit: Annotated[int, typer.Option(help="How many, the newest first.")] = 20,
    as_json: AsJson = False,
) -> None:
    """Print the history: which calibration answered when, and which were refused.

    Example: sunarc calibrations list --config sunarc.toml
    """
    rows = history.list_calibrations(load_settings(config), limit=limit)
    if as_json:
        print_json(rows)
        return
    columns = ("id", "state", "from", "until", "1-sigma")
    Console(soft_wrap=True).print(table(columns, [_cells(row) for row in rows]))


@calibrations_cli.command()
def activate(
    calibration: Id, *, config: Config = None, start: From = None, reason: Reason = "by hand", as_json: AsJson = False
) -> None:
    """Serve a calibration of the history again (roll back), or a candidate, whatever is current or pinned.

    Example: sunarc calibrations activate 20130514T063000Z-ab12cd --reason "the last one was worse"
    """
    row = history.reinstate(load_settings(config), calibration, at=_moment(start), reason=reason)
    _say(row, f"{row['id']} is current from {row['valid_from']}", as_json=as_json)


@calibrations_cli.command()
def pin(calibration: Id, *, config: Config = None, reason: Reason = "by hand", as_json: AsJson = False) -> None:
    """Keep the current calibration: refits make candidates, and do not replace it.

    Example: sunarc calibrations pin 20130514T063000Z-ab12cd
    """
    row = history.hold(load_settings(config), calibration, at=_moment(None), reason=reason, pinned=True)
    _say(row, f"{row['id']} stays current until it is unpinned", as_json=as_json)


@calibrations_cli.command()
def unpin(calibration: Id, *, config: Config = None, reason: Reason = "by hand", as_json: AsJson = False) -> None:
    """Let refits replace the current calibration again.

    Example: sunarc calibrations unpin 20130514T063000Z-ab12cd
    """
    row = history.hold(load_settings(config), calibration, at=_moment(None), reason=reason, pinned=False)
    _say(row, f"{row['id']} may be replaced again", as_json=as_json)


def _say(row: dict[str, Any], text: str, *, as_json: bool) -> None:
    if as_json:
        print_json(row)
    else:
        print(text)


def _cells(row: dict[str, Any]) -> list[str]:
    sky, answered = row["sky_rms_deg"], row["state"] in ("current", "retired")
    times = [(row[name] or "")[:16].replace("T", " ") if answered else "" for name in ("valid_from", "valid_until")]
    state = "pinned" if row["pinned"] else row["state"]
    return [row["id"], state, *times, "" if sky is None else f"{sky:.4f}°"]


def _moment(text: str | None) -> datetime:
    return SystemClock().now() if text is None else parse_time(text, where="--from")
