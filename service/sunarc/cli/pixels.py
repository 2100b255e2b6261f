"""The commands that read images and pixels: `sunarc detect`, `sunarc project` and `sunarc unproject`."""

from __future__ import annotations

import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any

import typer

from sunarc.cli.options import (
    AcceptRefused,
    AsJson,
    CalibrationFile,
    DetectionMethod,
    FollowExif,
    parse_choice,
    print_json,
    print_sentence,
    print_table,
)
from sunarc.cli.owner import act_as_folder_owner
from sunarc.common.errors import InputError
from sunarc.common.findings import Finding, choose_headline
from sunarc.common.messages import counted
from sunarc.detection.values import BAYERS
from sunarc.public.calibration_files import project_csv, unproject_csv
from sunarc.sources.detect_files import METHODS, detect_in_files, draw_overlay
from sunarc.sources.file_kinds import without_derived


def detect(
    images: Annotated[list[Path], typer.Argument(help="Image files.")],
    *,
    method: DetectionMethod = "auto",
    full_scale: Annotated[int | None, typer.Option(help="Largest count; judged from the file unless given.")] = None,
    bayer: Annotated[str | None, typer.Option(help="Colours of a raw mosaic: RGGB, BGGR, GRBG or GBRG.")] = None,
    follow_exif: FollowExif = False,
    overlay: Annotated[
        Path | None, typer.Option(callback=act_as_folder_owner, help="Write the (one) image with a cross on the sun.")
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Find the sun in images; exit 1 when none shows it, 2 when none is an image.

    Example: sunarc detect noon.png --json
    """
    images = without_derived(images)
    if overlay is not None and len(images) != 1:
        raise InputError(field="--overlay", problem=f"{len(images)} images", remedy="give one image with it")
    mosaic = None if bayer is None else parse_choice("--bayer", bayer, BAYERS)
    found = detect_in_files(
        images,
        method=parse_choice("--method", method, METHODS),
        full_scale=full_scale,
        bayer=mosaic,
        follow_exif=follow_exif,
    )
    unread = [row for row in found if row["verdict"] == "no_frame"]
    if as_json:
        print_json(found)
    else:
        _print_found(found)
    for row in unread:
        print_sentence(f"sunarc: {row['file']}: {_get_deciding_finding(row).sentence}", file=sys.stderr)
    if len(unread) == len(found):
        raise typer.Exit(2)
    if overlay is not None:
        draw_overlay(images[0], found[0], overlay, follow_exif=follow_exif)
    if not any(row["accepted"] for row in found):
        raise typer.Exit(1)


def _get_deciding_finding(row: Mapping[str, Any]) -> Finding:
    """Return the deciding finding of an image."""
    first = row["findings"][0]
    return Finding(first["code"], first["data"])


def _print_found(found: Sequence[Mapping[str, Any]]) -> None:
    """Print a table, the reason of each refusal, and how many images show the sun or the cause that took most."""
    columns = ("file", "x_px", "y_px", "sigma_px", "method", "verdict")
    print_table(columns, [[row[column] for column in columns] for row in found])
    refused = [row for row in found if not row["accepted"]]
    for row in refused:
        if row["verdict"] != "no_frame":
            print_sentence(f"{row['file']}: {row['reason']}")
    shown = len(found) - len(refused)
    headline = choose_headline([_get_deciding_finding(row) for row in refused], used=shown)
    count = f"{shown} of {counted(len(found), 'image')} used"
    print_sentence(count if headline is None else f"{count}, {headline['n']} refused: {headline['reason']}")


def project(calibration: CalibrationFile, *, accept_refused: AcceptRefused = False) -> None:
    """Read zenith_deg,azimuth_deg from standard input and write their pixels.

    Example: sunarc project --calibration calibration.json < directions.csv
    """
    project_csv(calibration, sys.stdin, sys.stdout, accept_refused=accept_refused)


def unproject(calibration: CalibrationFile, *, accept_refused: AcceptRefused = False) -> None:
    """Read x_px,y_px from standard input and write their directions.

    Example: sunarc unproject --calibration calibration.json < pixels.csv
    """
    unproject_csv(calibration, sys.stdin, sys.stdout, accept_refused=accept_refused)
