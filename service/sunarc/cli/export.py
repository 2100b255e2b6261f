"""The command `sunarc export`: parse, call, print."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Annotated

import typer

from sunarc.cli.options import CalibrationFile
from sunarc.errors import InputError, OutsideError
from sunarc.exports import FORMATS, MAP_FORMATS, Exported, export, export_map
from sunarc.offline.files import read_file

_MAPS = tuple(f"map-{name}" for name in MAP_FORMATS)


def export_calibration(
    calibration: CalibrationFile,
    *,
    format_: Annotated[str, typer.Option("--format", help=f"{', '.join((*FORMATS, *_MAPS))}.")],
    target: Annotated[
        Path | None, typer.Option("--output", "-o", help="File to write; standard output unless given.")
    ] = None,
) -> None:
    """Write a calibration in another format, and say on standard error how far that is from it.

    Example: sunarc export --calibration calibration.json --format opencv -o fisheye.yml
    """
    made = _made(_document(calibration), format_)
    if target is None:
        sys.stdout.buffer.write(made.content)
    else:
        _write(target, made.content)
        for name, content in made.beside.items():
            _write(target.parent / name, content)
            print(f"{format_}: wrote {name} beside it", file=sys.stderr)
    print(f"{format_}: {made.error}", file=sys.stderr)


def _made(document: dict[str, object], format_: str) -> Exported:
    for name in MAP_FORMATS:
        if format_ == f"map-{name}":
            return Exported(content=export_map(document, name), error="in single precision")
    for known in FORMATS:
        if format_ == known:
            return export(document, known)
    choices = ", ".join((*FORMATS, *_MAPS))
    raise InputError(field="--format", problem=f"{format_!r} is unknown", remedy=f"use one of {choices}")


def _document(path: Path) -> dict[str, object]:
    try:
        found = json.loads(read_file(path))
    except ValueError:
        found = None
    if not isinstance(found, dict):
        raise InputError(field=str(path), problem="is no JSON object", remedy="give a calibration document")
    return found


def _write(path: Path, content: bytes) -> None:
    try:
        path.write_bytes(content)
    except OSError as error:
        raise OutsideError(f"cannot write {path}: {error.strerror}") from error
