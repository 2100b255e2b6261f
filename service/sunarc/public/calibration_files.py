"""Answers of a calibration in a file: pixels and directions, differences to another, rectified images."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any, TextIO, get_args

import cv2
import numpy as np
from numpy.typing import NDArray

from sunarc.calibration.answers.direction_table import BACK_PROJECTED, PROJECTED, Rows, lookup
from sunarc.calibration.model.result import Calibration
from sunarc.common.array_types import FloatArray, Image
from sunarc.common.errors import InputError, OutsideError, disk_errors
from sunarc.common.extras import extra_module
from sunarc.common.foreign_files import is_regular, name_text
from sunarc.detection.values import Bayer
from sunarc.formats.asi_core import asi_core_set
from sunarc.formats.calibration_document import from_document
from sunarc.formats.csv_files import read_pairs, write_columns
from sunarc.formats.exported import Exported, Table, Variable
from sunarc.formats.formats import export_draws, find_format, read_view
from sunarc.formats.remap import Grid, grid_directions, reach_m, remap_tables, remapped
from sunarc.formats.tables import MAP_FORMATS, netcdf_bytes, npz_bytes
from sunarc.formats.view import ZENITH_RANGES_DEG, Comparison, View, compare
from sunarc.imaging.metadata import embedded_document
from sunarc.imaging.preview import demosaiced
from sunarc.sky.directions import angles_from_direction, direction_from_angles, unit_vectors
from sunarc.sources.files import read_file, read_image

_PLACES = 10
_YAML = (".yaml", ".yml")


def project_csv(calibration: Path, source: TextIO, target: TextIO, *, accept_refused: bool = False) -> None:
    """Read zenith_deg,azimuth_deg and write x_px,y_px,sigma_px,cov_xx,cov_xy,cov_yy,inside."""
    ready = lookup(answering(calibration, accept_refused=accept_refused))
    angles = read_pairs(source, columns=("zenith_deg", "azimuth_deg"), name="standard input")
    directions = direction_from_angles(zenith_deg=angles[:, 0], azimuth_deg=angles[:, 1])
    found = ready.project(unit_vectors(directions))
    _write_answers(target, found, [name.removesuffix("_px2") for name in PROJECTED])


def unproject_csv(calibration: Path, source: TextIO, target: TextIO, *, accept_refused: bool = False) -> None:
    """Read x_px,y_px and write zenith_deg,azimuth_deg,sigma_deg,inside."""
    ready = lookup(answering(calibration, accept_refused=accept_refused))
    found = ready.back_project(read_pairs(source, columns=("x_px", "y_px"), name="standard input"))
    columns = ["zenith_deg", "azimuth_deg", "sigma_deg", "inside"]
    _write_answers(target, found[:, [BACK_PROJECTED.index(name) for name in columns]], columns)


def _write_answers(target: TextIO, rows: Rows, names: Sequence[str]) -> None:
    """Write rows (n, k) of answers as columns; the last one is whether the camera sees it."""
    columns = dict(zip(names, np.asarray(rows, dtype=np.float64).T, strict=True))
    write_columns(target, columns, places=dict.fromkeys(columns, _PLACES) | {"inside": 0})


def read_calibration(path: Path) -> Calibration:
    """Return the calibration of a document's file; InputError where the file is invalid."""
    try:
        document = json.loads(read_file(path))
    except (ValueError, RecursionError):
        raise InputError(field=str(path), problem="is not JSON", remedy="give a calibration document") from None
    return from_document(document)


def answering(path: Path, *, accept_refused: bool) -> Calibration:
    """Return the calibration of a document's file; InputError where it is refused, unless that is accepted."""
    found = read_calibration(path)
    require_answers(found, path.name, accept_refused=accept_refused)
    return found


def require_answers(calibration: Calibration, name: str, *, accept_refused: bool) -> None:
    """Raise InputError where a calibration is refused and was not asked for: its numbers are no answer."""
    verdict = calibration.verdict
    if not (accept_refused or verdict.accepted or calibration.sigma_limit_deg is not None):
        problem = f"the calibration is refused: {verdict.findings[0].text}" if verdict.findings else "is refused"
        raise InputError(field=name, problem=problem, remedy="fit it anew; or ask with --accept-refused")


_WRITERS = {".nc": netcdf_bytes, ".npz": npz_bytes}


def read_view_file(path: Path) -> View:
    """Return the view of a camera that a file of any format holds; files that it names are looked for in its folder."""

    def beside(name: str) -> bytes | None:
        other = path.parent / name
        return read_file(other) if is_regular(other) else None

    return read_view(read_file(path), name=path.name, beside=beside)


def exported(document: dict[str, Any], form: str, *, draws: int = 0, seed: int = 0) -> Exported:
    """Return a calibration document in another format, with draws of its errors where they are asked for."""
    if not draws:
        return find_format(form, field="--format").write(from_document(document), document)
    for name in MAP_FORMATS:
        if form == name:
            content = export_draws(document, name, draws=draws, seed=seed)
            return Exported(content=content, error=f"{draws} draws of its errors, in single precision")
    choices = " or ".join(MAP_FORMATS)
    raise InputError(field="--draws", problem=f"{form!r} has no draws", remedy=f"use --format {choices}")


def is_set(form: str, target: Path) -> bool:
    """Return whether a format is a set of files, for which the target is a folder."""
    return form.startswith("azimuth-zenith") or (form == "asi-core" and target.suffix not in _YAML)


def write_exports(
    documents: Sequence[dict[str, Any]], form: str, target: Path, *, draws: int = 0, seed: int = 0
) -> list[Exported]:
    """Write a calibration document in another format, of asi-core's set all documents; return the written files.

    Parameters
    ----------
    documents : the first one is written, or all as a set.
    form : name of the format.
    target : the file; the folder of a set. Files of the same name are replaced.
    draws, seed : of the errors, for formats that have them.
    """
    into_folder = is_set(form, target)
    if form == "asi-core" and into_folder:
        made = asi_core_set(documents)
    else:
        made = [exported(documents[0], form, draws=draws, seed=seed)]
    folder = target if into_folder else target.parent
    if into_folder:
        with disk_errors(folder):
            folder.mkdir(parents=True, exist_ok=True)
    for one in made:
        for name, content in (one.files if into_folder else {target.name: one.content, **one.beside}).items():
            with disk_errors(folder / name):
                (folder / name).write_bytes(content)
    return made


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
        _write_differences(differences, found, title=f"{second.name} minus {first.name}")
    ranges = zip(ZENITH_RANGES_DEG, found.by_zenith, strict=True)
    return {
        "formats": [view.form for view in views],
        **{name: _finite_or_none(value) for name, value in asdict(found.total).items()},
        "by_zenith": [
            {"zenith_deg": list(bounds), **{name: _finite_or_none(value) for name, value in asdict(one).items()}}
            for bounds, one in ranges
        ],
        "rotation_deg": found.rotation_deg,
        "rotation_vector_deg": list(found.rotation_vector_deg),
        "rms_rotated_deg": found.rms_rotated_deg,
        "rotated_before": not all(view.has_pose for view in views),
        "undescribed": found.undescribed,
        "described_to_deg": found.described_to_deg,
        "sigma_limits_deg": [view.sigma_limit_deg for view in views],
    }


def _finite_or_none(value: float) -> float | None:
    return value if np.isfinite(value) else None


def _write_differences(path: Path, found: Comparison, *, title: str) -> None:
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
    with disk_errors(path):
        path.write_bytes(_WRITERS[path.suffix](Table(variables=variables, attributes={"title": title})))


def rectify_files(
    images: Sequence[Path],
    calibration: Path,
    *,
    grid: Grid,
    size: int,
    cloud_height_m: float | None,
    half_width_m: float | None,
    folder: Path,
    accept_refused: bool = False,
) -> list[dict[str, Any]]:
    """Map images to a grid, write them into a folder, and return the written files.

    Parameters
    ----------
    images : of the camera, all of its size.
    calibration : a calibration document.
    grid : `sky` writes PNG, an equidistant map with east at the left, as in the picture; `ground` writes GeoTIFF,
        azimuthal equidistant about the camera, east at the right. North is at the top; 0 where the image has nothing.
    size : pixels along a side.
    cloud_height_m, half_width_m : of the ground grid: the layer's height above the camera, and the distance from the
        camera to the middle of the outermost pixels (unless given: what lies within 78 degrees of zenith angle).
    folder : it is made where it is not there.

    Raises
    ------
    InputError : the grid needs a height, an image is of another size, or the extra `geotiff` is not installed.
    """
    if size < 2 or not all(value is None or 0.0 < value < math.inf for value in (cloud_height_m, half_width_m)):
        raise InputError(field="grid", problem="a size or length that is not positive", remedy="give px and m")
    if grid == "ground" and cloud_height_m is None:
        raise InputError(field="--cloud-height", problem="missing", remedy="give the cloud base above the camera in m")
    solved = answering(calibration, accept_refused=accept_refused)
    height = cloud_height_m or 0.0
    half_width = half_width_m or reach_m(height)
    directions = grid_directions(grid, size, half_width_m=half_width, height_m=height)
    tables = remap_tables(solved.camera, directions)
    with disk_errors(folder):
        folder.mkdir(parents=True, exist_ok=True)
    written = []
    for path in images:
        found = _remap_image(path, solved, tables)
        target = folder / f"{path.stem}_{grid}.{'png' if grid == 'sky' else 'tif'}"
        if grid == "sky":
            with disk_errors(target):
                target.write_bytes(cv2.imencode(".png", found)[1].tobytes())
        else:
            _write_geotiff(target, found, solved, pixel_m=2.0 * half_width / (size - 1))
        written.append(
            {"file": name_text(path), "written": name_text(target), "seen": float(np.mean(tables[0] >= -0.5))}
        )
    return written


def _remap_image(path: Path, solved: Calibration, tables: tuple[NDArray[Any], NDArray[Any]]) -> NDArray[Any]:
    image = _restore_colours(path, read_image(path))
    size = (solved.camera.width, solved.camera.height)
    if (image.shape[1], image.shape[0]) != size:
        problem = f"{image.shape[1]}x{image.shape[0]} px, the calibration is of {size[0]}x{size[1]}"
        raise InputError(field=str(path), problem=problem, remedy="give images of this camera")
    return remapped(image, *tables)


def _restore_colours(path: Path, image: Image) -> Image:
    """Return the image in its colours where it is a composite of ours that says which mosaic it is."""
    said = (embedded_document(read_file(path)) or {}).get("bayer")
    bayer: Bayer | None = next((known for known in get_args(Bayer) if known == said), None)
    return image if bayer is None or image.ndim != 2 else demosaiced(image, bayer)


def _write_geotiff(path: Path, image: NDArray[Any], solved: Calibration, *, pixel_m: float) -> None:
    rasterio = extra_module("rasterio", extra="geotiff")
    site, (rows, columns) = solved.site, image.shape[:2]
    bands = np.atleast_3d(image)[..., ::-1]  # OpenCV's blue, green, red
    left, top = -columns / 2.0 * pixel_m, rows / 2.0 * pixel_m
    profile = {
        "driver": "GTiff",
        "width": columns,
        "height": rows,
        "count": bands.shape[2],
        "dtype": bands.dtype.name,
        "nodata": 0,
        "crs": f"+proj=aeqd +lat_0={site.latitude!r} +lon_0={site.longitude!r} +datum=WGS84 +units=m",
        "transform": rasterio.Affine(pixel_m, 0.0, left, 0.0, -pixel_m, top),
        "compress": "deflate",
    }
    try:
        with rasterio.open(path, "w", **profile) as file:
            file.write(np.moveaxis(bands, -1, 0))
    except rasterio.errors.RasterioIOError as error:
        raise OutsideError(f"cannot write {path}: {error}") from error
