"""The command `sunarc compare`: parse, call, print."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer
from rich.console import Console

from sunarc.cli.options import AsJson
from sunarc.cli.output import print_json, table
from sunarc.exports.reading import READ_FORMATS
from sunarc.offline.compare_files import compare_files


def compare(
    first: Annotated[Path, typer.Argument(metavar="A", help=f"A camera: {', '.join(READ_FORMATS)}.")],
    second: Annotated[Path, typer.Argument(metavar="B", help="Another one, of images of the same size.")],
    *,
    differences: Annotated[
        Path | None, typer.Option("--differences", help="Write every compared direction here: .nc or .npz.")
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Say how far camera B is from camera A over the sky, in px and degrees.

    Example: sunarc compare calibration.json camera.yaml --json
    """
    found = compare_files(first, second, differences=differences)
    if as_json:
        print_json(found)
        return
    rows: list[list[Any]] = [_row("whole sky", found)]
    rows += [_row("zenith angle {:.0f}-{:.0f}°".format(*one["zenith_deg"]), one) for one in found["by_zenith"]]
    columns = ("", "n", "RMS px", "max px", "RMS °", "max °")
    console = Console(soft_wrap=True)
    console.print(table(columns, rows))
    vector = "({:.4f}, {:.4f}, {:.4f})".format(*found["rotation_vector_deg"])
    print(
        f"best rotation {found['rotation_deg']:.4f}° about east, north, up {vector}; "
        f"{found['rms_rotated_deg']:.4f}° RMS are left"
    )
    if found["rotated_before"]:
        print("one of the two has no pose: the differences are those after this rotation")
    if found["undescribed"]:
        print(
            f"{second.name} cannot describe {100.0 * found['undescribed']:.2f} % of the sky in the image, "
            f"from zenith angle {found['described_to_deg']:.1f}° on"
        )


def _row(name: str, one: dict[str, Any]) -> list[Any]:
    sizes = (one[key] for key in ("rms_px", "max_px", "rms_deg", "max_deg"))
    return [name, one["n"], *("" if value is None else f"{value:.4g}" for value in sizes)]
