"""The command `sunarc rectify`: parse, call, print."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from sunarc.cli.options import AsJson, CalibrationFile
from sunarc.cli.output import print_json
from sunarc.errors import InputError
from sunarc.exports.remap import Grid
from sunarc.offline.rectify_files import rectify_files

_GRIDS: dict[str, Grid] = {"sky": "sky", "ground": "ground"}


def rectify(
    images: Annotated[list[Path], typer.Argument(metavar="IMAGE…", help="Images of the camera.")],
    calibration: CalibrationFile,
    *,
    folder: Annotated[Path, typer.Option("--output", "-o", help="Folder to write into.")],
    grid: Annotated[str, typer.Option(help="sky (PNG, equidistant) or ground (GeoTIFF, under a cloud layer).")] = "sky",
    size: Annotated[int, typer.Option(help="Pixels along a side.")] = 1024,
    cloud_height: Annotated[float | None, typer.Option(help="Of the layer above the camera, m; for ground.")] = None,
    half_width: Annotated[
        float | None, typer.Option(help="Of the ground grid, m; what lies within 78° of zenith angle unless given.")
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Map images to a grid of the sky, or of the ground under clouds at a height; north at the top, east at the right.

    Example: sunarc rectify noon.png --calibration calibration.json --grid ground --cloud-height 1500 -o maps/
    """
    if grid not in _GRIDS:
        raise InputError(field="--grid", problem=f"{grid!r} is unknown", remedy="use sky or ground")
    found = rectify_files(
        images,
        calibration,
        grid=_GRIDS[grid],
        size=size,
        cloud_height_m=cloud_height,
        half_width_m=half_width,
        folder=folder,
    )
    if as_json:
        print_json(found)
        return
    for row in found:
        print(f"{row['written']}: {100.0 * row['seen']:.0f} % of the grid is in the image")
