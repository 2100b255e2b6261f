"""Lens prior files: what calibrations of several cameras say of their type of lens."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import sunarc
from sunarc.calibration.lens_library.combination import Unit, lens_type_of
from sunarc.calibration.lens_library.lens_type import LensType, UnitSpread
from sunarc.calibration.model.document import from_document
from sunarc.calibration.model.options import CalibrationOptions
from sunarc.errors import InputError
from sunarc.offline.files import read_file


def write_lens_prior(path: Path, lens: LensType) -> None:
    """Write a lens prior file."""
    content = lens.to_json(software_version=sunarc.__version__)
    path.write_text(json.dumps(content, indent=1, allow_nan=False) + "\n", encoding="utf-8")


def combined_lens(documents: Sequence[dict[str, Any]], files: Sequence[Path], *, spread: UnitSpread | None) -> LensType:
    """Return what calibration documents, and files of such, say of one type of lens.

    Raises
    ------
    InputError
        Where a file is no calibration document, a calibration is refused or was given a lens prior itself, a camera is
        named twice, or two are of different types of lens.
    """
    units: dict[str, Unit] = {}
    for document in (*documents, *map(_json, files)):
        unit = _unit(document)
        if unit.camera in units:
            raise InputError(
                field=unit.camera, problem="two calibrations of one camera", remedy="name its best one, or fit --joint"
            )
        units[unit.camera] = unit
    return lens_type_of(list(units.values()), spread=spread)


def require_lens(lens: LensType, *, image_size: tuple[int, int], options: CalibrationOptions, known: bool) -> None:
    """Raise InputError where a camera cannot be of a type of lens.

    Parameters
    ----------
    lens : the type.
    image_size : of the camera, px.
    options : of its fit.
    known : whether the options' projection is stated.
    """
    camera = lens.camera
    hand = "yes" if camera.mirrored else "no"
    for what, given, stated in (
        ("image size", image_size, (camera.width, camera.height)),
        ("projection", options.projection if known else camera.projection, camera.projection),
        ("mirrored", hand if options.mirrored == "auto" else options.mirrored, hand),
    ):
        if given != stated:
            raise InputError(
                field="--lens-prior",
                problem=f"{what} {stated}, where the camera's is {given}",
                remedy="name the lens prior of this type of lens and sensor",
            )


def _unit(document: dict[str, Any]) -> Unit:
    calibration = from_document(document)
    name = str(document.get("camera", ""))
    if not calibration.verdict.accepted:
        raise InputError(field=name, problem="the calibration is refused", remedy="name accepted calibrations")
    if calibration.evidence.options.get("free", "all") != "all" or "lens_prior" in calibration.evidence.options:
        raise InputError(
            field=name,
            problem="the calibration was given its lens, and tells nothing new of it",
            remedy="name a calibration that was fitted without --pose-only, --lens-within and --lens-prior",
        )
    return Unit(name, calibration)


def _json(path: Path) -> Any:  # noqa: ANN401 - JSON holds anything
    try:
        return json.loads(read_file(path))
    except ValueError:
        raise InputError(field=str(path), problem="is not JSON", remedy="name a JSON file of sunarc") from None
