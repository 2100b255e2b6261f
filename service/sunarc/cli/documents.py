"""The commands `sunarc export`, `sunarc compare` and `sunarc rectify`: parse, call, print."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.console import Console

from sunarc.cli.options import AcceptRefused, AsJson, CalibrationFile, print_json, table
from sunarc.cli.owner import act_as_folder_owner
from sunarc.common.errors import InputError
from sunarc.common.utc import parse_time
from sunarc.formats.calibration_document import document_at, from_document
from sunarc.formats.formats import FORMATS
from sunarc.formats.remap import Grid
from sunarc.public.calibration_files import (
    compare_files,
    exported,
    is_set,
    rectify_files,
    require_answers,
    write_exports,
)
from sunarc.sources.files import read_file

_READ = tuple(one.name for one in FORMATS.values() if one.read is not None)


def export_calibration(
    calibration: Annotated[
        Path, typer.Option("--calibration", help="A calibration document (JSON); for asi-core also a folder of them.")
    ],
    *,
    format_: Annotated[str, typer.Option("--format", help=f"{', '.join(FORMATS)}.")],
    target: Annotated[
        Path | None,
        typer.Option(
            "--output",
            "-o",
            callback=act_as_folder_owner,
            help="File (asi-core, azimuth-zenith: folder) to write; else standard output.",
        ),
    ] = None,
    draws: Annotated[
        int, typer.Option(help="Draws of the calibration's errors to add (netcdf and npz): `direction_draw`.", min=0)
    ] = 0,
    seed: Annotated[int, typer.Option(help="Determines the draws, together with the calibration's id.", min=0)] = 0,
    at: Annotated[
        str | None,
        typer.Option(metavar="TIME", help="State the uncertainty of this time, ISO 8601; else that of the fit."),
    ] = None,
    accept_refused: AcceptRefused = False,
) -> None:
    """Write a calibration in another format; its approximation error goes to standard error.

    Example: sunarc export --calibration calibration.json --format opencv -o fisheye.yml
    """
    if target is None:
        document = _read_document(calibration, at=at, accept_refused=accept_refused)
        one = exported(document, format_, draws=draws, seed=seed)
        sys.stdout.buffer.write(one.content)
        print(f"{format_}: {one.error}", file=sys.stderr)
        return
    into_folder = is_set(format_, target)
    documents = _read_documents(calibration, at=at, into_folder=into_folder, accept_refused=accept_refused)
    for one in write_exports(documents, format_, target, draws=draws, seed=seed):
        for name in () if into_folder else one.beside:
            print(f"{format_}: wrote {name} beside it", file=sys.stderr)
        print(f"{one.name if into_folder else format_}: {one.error}", file=sys.stderr)


def _read_documents(path: Path, *, at: str | None, into_folder: bool, accept_refused: bool) -> list[dict[str, object]]:
    """Return the document of a file; where a set is written, those of all JSON files of a folder."""
    paths = sorted(path.glob("*.json")) if into_folder and path.is_dir() else [path]
    return [_read_document(one, at=at, accept_refused=accept_refused) for one in paths]


def _read_document(path: Path, *, at: str | None, accept_refused: bool) -> dict[str, object]:
    try:
        found = json.loads(read_file(path))
    except (ValueError, RecursionError):
        found = None
    if not isinstance(found, dict):
        raise InputError(field=str(path), problem="is not a JSON object", remedy="give a calibration document")
    require_answers(from_document(found), path.name, accept_refused=accept_refused)
    return found if at is None else document_at(found, parse_time(at, where="--at"))


def compare(
    first: Annotated[Path, typer.Argument(metavar="A", help=f"A camera: {', '.join(_READ)}.")],
    second: Annotated[Path, typer.Argument(metavar="B", help="Another one, of images of the same size.")],
    *,
    differences: Annotated[
        Path | None,
        typer.Option(
            "--differences", callback=act_as_folder_owner, help="Write every compared direction here: .nc or .npz."
        ),
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Compare two cameras: differences of B from A over the sky, in px and degrees.

    Example: sunarc compare calibration.json camera.yaml --json
    """
    found = compare_files(first, second, differences=differences)
    if as_json:
        print_json(found)
        return
    rows: list[list[Any]] = [_make_row("whole sky", found)]
    rows += [_make_row("zenith angle {:.0f}-{:.0f}°".format(*one["zenith_deg"]), one) for one in found["by_zenith"]]
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
    for file, limit in zip((first, second), found["sigma_limits_deg"], strict=True):
        if limit is not None:
            print(f"{file.name} is provisional: compared where its 1-sigma is at most {limit:g}°")
    if found["undescribed"]:
        print(
            f"{second.name} cannot describe {100.0 * found['undescribed']:.2f} % of the sky in the image, "
            f"from zenith angle {found['described_to_deg']:.1f}° on"
        )


def _make_row(name: str, one: dict[str, Any]) -> list[Any]:
    sizes = (one[key] for key in ("rms_px", "max_px", "rms_deg", "max_deg"))
    return [name, one["n"], *("" if value is None else f"{value:.4g}" for value in sizes)]


_GRIDS: dict[str, Grid] = {"sky": "sky", "ground": "ground"}


def rectify(
    images: Annotated[list[Path], typer.Argument(metavar="IMAGE…", help="Images of the camera.")],
    calibration: CalibrationFile,
    *,
    folder: Annotated[Path, typer.Option("--output", "-o", callback=act_as_folder_owner, help="Folder to write into.")],
    grid: Annotated[str, typer.Option(help="sky (PNG, equidistant) or ground (GeoTIFF, under a cloud layer).")] = "sky",
    size: Annotated[int, typer.Option(help="Pixels along a side.")] = 1024,
    cloud_height: Annotated[float | None, typer.Option(help="Of the layer above the camera, m; for ground.")] = None,
    half_width: Annotated[
        float | None, typer.Option(help="Of the ground grid, m; what lies within 78° of zenith angle unless given.")
    ] = None,
    accept_refused: AcceptRefused = False,
    as_json: AsJson = False,
) -> None:
    """Map images to a grid of the sky, seen from below, or of the ground for clouds at a height; north at the top.

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
        accept_refused=accept_refused,
    )
    if as_json:
        print_json(found)
        return
    for row in found:
        print(f"{row['written']}: {100.0 * row['seen']:.0f} % of the grid is in the image")
