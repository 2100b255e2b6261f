"""The command `sunarc export`: parse, call, print."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Annotated

import typer

from sunarc.errors import InputError, OutsideError
from sunarc.exports.asi_core_set import asi_core_set
from sunarc.exports.exported import Exported
from sunarc.exports.formats import FILE_FORMATS, FORMATS, MAP_FORMATS, export, export_draws, export_file, export_map
from sunarc.offline.files import read_file

_YAML = (".yaml", ".yml")
_MAPS = tuple(f"map-{name}" for name in MAP_FORMATS)
_ALL = (*FORMATS, *FILE_FORMATS, *_MAPS)


def export_calibration(
    calibration: Annotated[
        Path, typer.Option("--calibration", help="A calibration document (JSON); for asi-core also a folder of them.")
    ],
    *,
    format_: Annotated[str, typer.Option("--format", help=f"{', '.join(_ALL)}.")],
    target: Annotated[
        Path | None,
        typer.Option("--output", "-o", help="File (asi-core, azimuth-zenith: folder) to write; else standard output."),
    ] = None,
    draws: Annotated[
        int, typer.Option(help="Draws of the calibration's errors to add (netcdf and npz): `direction_draw`.", min=0)
    ] = 0,
    seed: Annotated[int, typer.Option(help="With the calibration's id it decides the draws.", min=0)] = 0,
) -> None:
    """Write a calibration in another format, and say on standard error how far that is from it.

    Example: sunarc export --calibration calibration.json --format opencv -o fisheye.yml
    """
    if format_ == "asi-core" and target is not None and target.suffix not in _YAML:
        _write_set(asi_core_set(_documents(calibration)), target)
        return
    made = _made(_document(calibration), format_, draws=draws, seed=seed)
    if format_.startswith("azimuth-zenith") and target is not None:
        _write_set([made], target)
    elif target is None:
        sys.stdout.buffer.write(made.content)
    else:
        _write(target, made.content)
        for name, content in made.beside.items():
            _write(target.parent / name, content)
            print(f"{format_}: wrote {name} beside it", file=sys.stderr)
    print(f"{format_}: {made.error}", file=sys.stderr)


def _write_set(made: list[Exported], folder: Path) -> None:
    """Write a set of files into a folder; what is there of the same name is replaced."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise OutsideError(f"cannot make the folder {folder}: {error.strerror}") from error
    for one in made:
        for name, content in one.files.items():
            _write(folder / name, content)
        print(f"{one.name}: {one.error}", file=sys.stderr)


def _documents(path: Path) -> list[dict[str, object]]:
    """Return the document of a file, or those of all JSON files of a folder."""
    return [_document(one) for one in sorted(path.glob("*.json"))] if path.is_dir() else [_document(path)]


def _made(document: dict[str, object], format_: str, *, draws: int, seed: int) -> Exported:
    if draws:
        return _drawn(document, format_, draws=draws, seed=seed)
    for name in MAP_FORMATS:
        if format_ == f"map-{name}":
            return Exported(content=export_map(document, name), error="in single precision")
    for known in FORMATS:
        if format_ == known:
            return export(document, known)
    for other in FILE_FORMATS:
        if format_ == other:
            return export_file(document, other)
    choices = ", ".join(_ALL)
    raise InputError(field="--format", problem=f"{format_!r} is unknown", remedy=f"use one of {choices}")


def _drawn(document: dict[str, object], format_: str, *, draws: int, seed: int) -> Exported:
    for name in MAP_FORMATS:
        if format_ == name:
            content = export_draws(document, name, draws=draws, seed=seed)
            return Exported(content=content, error=f"{draws} draws of its errors, in single precision")
    choices = " or ".join(MAP_FORMATS)
    raise InputError(field="--draws", problem=f"{format_!r} has no draws", remedy=f"use --format {choices}")


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
