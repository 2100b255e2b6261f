"""The command `sunarc mask`: parse, call, print."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from sunarc.cli.options import AcceptRefused, AsJson, CalibrationFile, print_json
from sunarc.cli.owner import act_as_folder_owner
from sunarc.public.calibration_files import answering
from sunarc.public.mask_files import learn_mask_from_files, write_mask
from sunarc.public.star_files import StarOptions
from sunarc.sources.image_times import TimeRules, parse_utc_offset


def mask(
    images: Annotated[list[Path], typer.Argument(help="Images of a clear day or more: PNG, JPEG, TIFF, FITS.")],
    *,
    calibration: CalibrationFile,
    output: Annotated[
        Path | None,
        typer.Option(
            "--output", "-o", callback=act_as_folder_owner, help="PNG: 255 free, 128 unknown, 64 dirt, 0 hidden."
        ),
    ] = None,
    horizon: Annotated[
        Path | None, typer.Option(callback=act_as_folder_owner, help="CSV of the horizon's elevation by azimuth.")
    ] = None,
    userhorizon: Annotated[
        Path | None, typer.Option(callback=act_as_folder_owner, help="The same as PVGIS takes it for `userhorizon`.")
    ] = None,
    time_pattern: Annotated[str | None, typer.Option(help="strptime pattern of the names, without suffix.")] = None,
    utc_offset: Annotated[
        str | None,
        typer.Option(help="Times without a zone, ahead of UTC: 0 unless given; hours, or as Europe/Berlin."),
    ] = None,
    accept_refused: AcceptRefused = False,
    as_json: AsJson = False,
) -> None:
    """Find the obstructions of the sky, and the horizon, in images of a clear day or more.

    Example: sunarc mask day/*.jpg --calibration calibration.json -o mask.png --horizon horizon.csv
    """
    known = answering(calibration, accept_refused=accept_refused)
    offset = parse_utc_offset(utc_offset or "0", field="--utc-offset")
    rules = TimeRules(time_pattern, offset, documents=True, is_offset_assumed=utc_offset is None)
    found = learn_mask_from_files(images, known, StarOptions(rules=rules))
    write_mask(found, mask=output, horizon=horizon, pvgis=userhorizon)
    said = found.as_json()
    if as_json:
        print_json(said)
        return
    print("images: " + ", ".join(f"{n} {use}" for use, n in sorted(said["images"].items())))
    print("sky: " + ", ".join(f"{100.0 * share:.1f} % {state}" for state, share in said["shares_of_the_sky"].items()))
