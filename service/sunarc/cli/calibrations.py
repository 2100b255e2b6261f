"""The commands of `sunarc calibrations` and `sunarc epochs`: parse, call, print."""

from __future__ import annotations

from datetime import datetime
from typing import Annotated, Any

import typer

from sunarc.cli.options import AsJson, Config, print_rows, print_text, service_settings
from sunarc.common.utc import parse_time
from sunarc.imager.archive.archive import open_archive
from sunarc.imager.archive.values import CalibrationRecord, PoseEpoch
from sunarc.imager.runtime.clock import SystemClock

_SHOWN = ("id", "state", "pinned", "valid_from", "valid_until", "pose_epoch", "parent", "accepted")

calibrations_cli = typer.Typer(no_args_is_help=True, help="The history of calibrations: list, roll back, pin.")
epochs_cli = typer.Typer(
    no_args_is_help=True, help="The pose epochs (intervals in which the camera does not move): list, close a wrong one."
)

Id = Annotated[str, typer.Argument(metavar="ID", help="A calibration's id, see `sunarc calibrations list`.")]
EpochId = Annotated[str, typer.Argument(metavar="ID", help="A pose epoch's id, see `sunarc epochs list`.")]
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
    settings = service_settings(config)
    with open_archive(settings.archive) as archive:
        rows = [_make_row(record) for record in archive.calibrations.find(settings.name, limit=limit)]
    print_rows(rows, ("id", "state", "from", "until", "1-sigma"), map(_format_cells, rows), as_json=as_json)


@calibrations_cli.command()
def activate(
    calibration: Id, *, config: Config = None, start: From = None, reason: Reason = "by hand", as_json: AsJson = False
) -> None:
    """Serve a calibration of the history again (roll back), or a candidate, whatever is current or pinned.

    Example: sunarc calibrations activate 20130514T063000Z-ab12cd --reason "the last one was worse"
    """
    with open_archive(service_settings(config).archive) as archive:
        at, now = _time_or_now(start), _time_or_now(None)
        row = _make_row(archive.calibrations.reinstate(calibration, at=at, decided_at=now, reason=reason))
    print_text(row, f"{row['id']} is current from {row['valid_from']}", as_json=as_json)


@calibrations_cli.command()
def pin(calibration: Id, *, config: Config = None, reason: Reason = "by hand", as_json: AsJson = False) -> None:
    """Keep the current calibration: refits make candidates, and do not replace it.

    Example: sunarc calibrations pin 20130514T063000Z-ab12cd
    """
    with open_archive(service_settings(config).archive) as archive:
        row = _make_row(archive.calibrations.pin(calibration, at=_time_or_now(None), reason=reason))
    print_text(row, f"{row['id']} stays current until it is unpinned", as_json=as_json)


@calibrations_cli.command()
def unpin(calibration: Id, *, config: Config = None, reason: Reason = "by hand", as_json: AsJson = False) -> None:
    """Let refits replace the current calibration again.

    Example: sunarc calibrations unpin 20130514T063000Z-ab12cd
    """
    with open_archive(service_settings(config).archive) as archive:
        row = _make_row(archive.calibrations.unpin(calibration, at=_time_or_now(None), reason=reason))
    print_text(row, f"{row['id']} may be replaced again", as_json=as_json)


@epochs_cli.command("list")
def list_epochs(config: Config = None, *, as_json: AsJson = False) -> None:
    """Print the pose epochs, the first one first.

    Example: sunarc epochs list --config sunarc.toml
    """
    settings = service_settings(config)
    with open_archive(settings.archive) as archive:
        rows = [_make_epoch_row(epoch) for epoch in archive.epochs.find(settings.name, include_closed=True)]
    cells = [
        [row["id"], row["started_at"], "closed as wrong" if row["closed"] else row["ended_at"] or "", row["reason"]]
        for row in rows
    ]
    print_rows(rows, ("id", "from", "until", "reason"), cells, as_json=as_json)


@epochs_cli.command("close")
def close_epoch(
    epoch: EpochId,
    *,
    config: Config = None,
    reason: Reason = "the camera had not moved",
    as_json: AsJson = False,
) -> None:
    """Undo a pose epoch that was begun by mistake: the one before continues, its calibration is current again.

    Example: sunarc epochs close imager-2 --reason "the clock was ahead"
    """
    with open_archive(service_settings(config).archive) as archive:
        current = archive.calibrations.close_epoch(epoch, at=_time_or_now(None), reason=reason)
    row = {"id": epoch, "closed": True, "calibration": current}
    said = "no calibration was served before it" if current is None else f"calibration {current} is current"
    print_text(row, f"pose epoch {epoch} is closed; {said}", as_json=as_json)


def _make_row(record: CalibrationRecord) -> dict[str, Any]:
    row = {name: getattr(record, name) for name in _SHOWN}
    row |= {name: value and value.isoformat() for name, value in row.items() if name.startswith("valid")}
    sky = record.document.get("uncertainty", {}).get("sky_rms_deg")
    return {
        **row,
        "sky_rms_deg": sky,
        "reasons": list(record.reasons),
        "findings": [finding.as_json() for finding in record.findings],
    }


def _make_epoch_row(epoch: PoseEpoch) -> dict[str, Any]:
    return {
        "id": epoch.id,
        "started_at": epoch.started_at.isoformat(),
        "ended_at": epoch.ended_at and epoch.ended_at.isoformat(),
        "reason": epoch.reason,
        "closed": epoch.ended_at is not None and epoch.ended_at <= epoch.started_at,
    }


def _format_cells(row: dict[str, Any]) -> list[str]:
    sky, answered = row["sky_rms_deg"], row["state"] in ("current", "retired")
    times = [(row[name] or "")[:16].replace("T", " ") if answered else "" for name in ("valid_from", "valid_until")]
    state = "pinned" if row["pinned"] else row["state"]
    return [row["id"], state, *times, "" if sky is None else f"{sky:.4f}°"]


def _time_or_now(text: str | None) -> datetime:
    return SystemClock().now() if text is None else parse_time(text, where="--from")
