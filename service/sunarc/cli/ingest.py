"""The command `sunarc ingest`: parse, call, print."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from sunarc.archives.ingest import IngestOptions, ingest_folder
from sunarc.archives.ingest_summary import IngestSummary
from sunarc.archives.pool import usable_processors
from sunarc.cli.calibrate import calibrate_stored, stated_level
from sunarc.cli.database import note_running_service
from sunarc.cli.options import (
    AsJson,
    ClockError,
    Config,
    DetectionMethod,
    FollowExif,
    LevelWithin,
    TimePatternOption,
    parse_choice,
    print_json,
    print_sentence,
    print_table,
    progress_bars,
    service_settings,
)
from sunarc.cli.owner import act_as_folder_owner
from sunarc.common.errors import InputError
from sunarc.common.findings import choose_headline
from sunarc.common.messages import counted
from sunarc.sources.detect_files import METHODS
from sunarc.sources.image_times import TimeRules, parse_utc_offset

_LISTED = 20
"""Images that are named with the reason why they were left out; --json lists all."""


def ingest(
    folder: Annotated[Path, typer.Argument(help="Folder of images.")],
    *,
    config: Config = None,
    method: DetectionMethod = "auto",
    time_pattern: TimePatternOption = None,
    utc_offset: Annotated[
        str | None,
        typer.Option(help="Times without a zone, ahead of UTC: 0 unless given; hours, or as Europe/Berlin."),
    ] = None,
    follow_exif: FollowExif = False,
    reprocess: Annotated[
        bool, typer.Option("--reprocess", help="Look at known images again, and replace their sightings.")
    ] = False,
    workers: Annotated[
        int | None, typer.Option(help="Processes; one for each processor unless given.", show_default=False)
    ] = None,
    contact_sheet: Annotated[
        Path | None,
        typer.Option(
            callback=act_as_folder_owner, help="PNG with examples of each verdict; in the state folder unless given."
        ),
    ] = None,
    calibrate: Annotated[
        bool, typer.Option("--calibrate", help="Then fit the camera, as sunarc calibrate --config FILE does.")
    ] = False,
    provisional: Annotated[
        bool, typer.Option("--provisional", help="With --calibrate: as sunarc calibrate --provisional.")
    ] = False,
    level_within: LevelWithin = None,
    clock_error: ClockError = None,
    as_json: AsJson = False,
) -> None:
    """Find the sun in a folder of archived images and fill the archive; images that are in it are skipped.

    Images of the night (the sun 12 degrees below the horizon) have their stars named by the served calibration.

    It can be stopped at any time (Ctrl-C) and goes on where it was when it is called again.

    Example: sunarc ingest images/ --config sunarc.toml --calibrate
    """
    settings = stated_level(service_settings(config), level_within)
    if workers is not None and workers < 1:
        raise InputError(field="--workers", problem=f"{workers} is below 1", remedy="give 1 or more")
    if as_json and calibrate:
        raise InputError(field="--json", problem="given with --calibrate", remedy="run sunarc calibrate --json then")
    options = IngestOptions(
        method=parse_choice("--method", method, METHODS),
        rules=TimeRules(
            time_pattern,
            parse_utc_offset(utc_offset or "0", field="--utc-offset"),
            documents=True,
            is_offset_assumed=utc_offset is None,
        ),
        follow_exif=follow_exif or (settings.folder is not None and settings.folder.follow_exif),
        reprocess=reprocess,
        processes=workers or usable_processors(),
        contact_sheet=contact_sheet,
    )
    with progress_bars() as progress:
        summary = ingest_folder(settings, folder, options=options, progress=progress)
    note_running_service(settings.state)
    if as_json:
        print_json(summary.as_json())
        return
    _print_summary(summary)
    if calibrate:
        calibrate_stored(settings, provisional=provisional, as_json=False, clock_error_s=clock_error)
    else:
        print(_suggest_next_command(summary, config))


def _suggest_next_command(summary: IngestSummary, config: Path | None) -> str:
    """Return the command to type next."""
    if not any(summary.by_verdict.values()):
        return "next: check the reasons above (the times of the files: --time-pattern, --utc-offset)"
    named = "" if config is None else f" --config {config}"
    return f"next: sunarc calibrate{named}"


def _print_summary(summary: IngestSummary) -> None:
    record = summary.as_json()
    for row in record["files_skipped"][:_LISTED]:
        print_sentence(f"skipped {row['file']}: {row['reason']}")
    if len(record["files_skipped"]) > _LISTED:
        print(f"… and {len(record['files_skipped']) - _LISTED} more (--json lists them)")
    rows = [[verdict, str(n)] for verdict, n in summary.by_verdict.items()]
    rows += [[f"skipped: {code}", str(n)] for code, n in summary.by_reason.items()]
    print_table(("verdict", "images"), rows)
    stacked = f"{summary.stacked} in stacks, " if summary.stacked else ""
    print(
        f"{summary.accepted} accepted, {summary.rejected} rejected, {stacked}{summary.known} known already, "
        f"{len(summary.skipped)} skipped"
    )
    for night in summary.nights:
        print(
            f"night of {night.date}: {night.verdict}, stars named in {night.accepted} of "
            f"{counted(night.images, 'image')}, {counted(night.stored, 'new sighting')}"
        )
    if summary.nights_known:
        print(f"{counted(summary.nights_known, 'image')} of nights known already")
    for finding in summary.camera_findings:
        print(f"camera: {finding.sentence}")
    if summary.contact_sheet is not None:
        print(f"examples of each verdict: {summary.contact_sheet}")
    headline = choose_headline([one.finding for one in summary.skipped], used=sum(summary.by_verdict.values()))
    if headline is not None:
        print_sentence(f"{counted(headline['n'], 'file')} skipped: {headline['reason']}")
