"""Cameras in files of any format: read, and compared over the sky."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from sunarc.array_types import FloatArray
from sunarc.errors import InputError, OutsideError
from sunarc.exports.comparison import ZENITH_RANGES_DEG, Comparison, compare
from sunarc.exports.discovery import Table, Variable
from sunarc.exports.reading import read_view
from sunarc.exports.tables import netcdf_bytes, npz_bytes
from sunarc.exports.view import View
from sunarc.offline.files import read_file
from sunarc.sky.directions import angles_from_direction

_WRITERS = {".nc": netcdf_bytes, ".npz": npz_bytes}


def read_view_file(path: Path) -> View:
    """Return the view of a camera that a file of any format holds; files that it names are looked for beside it."""

    def beside(name: str) -> bytes | None:
        other = path.parent / name
        return read_file(other) if other.is_file() else None

    return read_view(read_file(path), name=path.name, beside=beside)


def compare_files(first: Path, second: Path, *, differences: Path | None = None) -> dict[str, Any]:
    """Return how far the second file's camera is from the first one's; the keys are those of `sunarc compare --json`.

    Parameters
    ----------
    first, second : files of any format that is read.
    differences : where the single directions are written, NetCDF or npz by its ending.
    """
    if differences is not None and differences.suffix not in _WRITERS:
        raise InputError(
            field="--differences", problem=f"{differences.name} ends otherwise", remedy="end it .nc or .npz"
        )
    views = read_view_file(first), read_view_file(second)
    found = compare(*views)
    if differences is not None:
        _write(differences, found, title=f"{second.name} minus {first.name}")
    ranges = zip(ZENITH_RANGES_DEG, found.by_zenith, strict=True)
    return {
        "formats": [view.form for view in views],
        **{name: _number(value) for name, value in asdict(found.total).items()},
        "by_zenith": [
            {"zenith_deg": list(bounds), **{name: _number(value) for name, value in asdict(one).items()}}
            for bounds, one in ranges
        ],
        "rotation_deg": found.rotation_deg,
        "rotation_vector_deg": list(found.rotation_vector_deg),
        "rms_rotated_deg": found.rms_rotated_deg,
        "rotated_before": not all(view.has_pose for view in views),
        "undescribed": found.undescribed,
        "described_to_deg": found.described_to_deg,
    }


def _number(value: float) -> float | None:
    return value if np.isfinite(value) else None


def _write(path: Path, found: Comparison, *, title: str) -> None:
    zenith, azimuth = angles_from_direction(found.directions)

    def column(values: FloatArray, units: str, meaning: str) -> Variable:
        return Variable(
            dimensions=("direction",),
            values=values,
            attributes={"units": units, "long_name": meaning, "coordinates": "zenith azimuth"},
        )

    variables = {
        "zenith": column(zenith, "degree", "apparent zenith angle"),
        "azimuth": column(azimuth, "degree", "azimuth, clockwise from north"),
        "off_x": column(found.off_px[:, 0], "1", "difference of the pixels' x in px"),
        "off_y": column(found.off_px[:, 1], "1", "difference of the pixels' y in px"),
        "off_angle": column(found.off_deg, "degree", "angle between the directions of a pixel"),
    }
    try:
        path.write_bytes(_WRITERS[path.suffix](Table(variables=variables, attributes={"title": title})))
    except OSError as error:
        raise OutsideError(f"cannot write {path}: {error.strerror}") from error
