"""The same calibration in others' formats, by name."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from functools import partial
from typing import Any, Literal, get_args

import numpy as np

from sunarc.calibration.answers.direction_table import back_projection_map, lookup
from sunarc.calibration.answers.error_model import draw_ensemble
from sunarc.calibration.model.document import from_document
from sunarc.calibration.model.result import Calibration
from sunarc.errors import InputError
from sunarc.exports.asi_core import asi_core_file
from sunarc.exports.exported import PIXELS, Exported, Table, Variable, notes_of
from sunarc.exports.fisheye import colmap_text, fisheye_model, fisheye_view, opencv_yaml, require_no_mirror, ros_yaml
from sunarc.exports.mrcal import cameramodel, splined_model, splined_view
from sunarc.exports.ocam import calib_results, ocam_model, ocam_view
from sunarc.exports.pixel_maps import fits_file, matlab_file, sixteen_bit_files
from sunarc.exports.reading import read_view
from sunarc.exports.remap import remap_table, sky_grid
from sunarc.exports.tables import calibration_table, map_table, netcdf_bytes, npz_bytes
from sunarc.exports.view import camera_view, compare

Format = Literal["json", "opencv", "ocamcalib", "asi-core", "mrcal", "netcdf", "npz"]
FORMATS: tuple[Format, ...] = get_args(Format)
"""Formats that are served over HTTP."""
FileFormat = Literal["opencv-remap", "colmap", "ros", "fits", "matlab", "azimuth-zenith-png", "azimuth-zenith-jp2"]
FILE_FORMATS: tuple[FileFormat, ...] = get_args(FileFormat)
"""Formats that `sunarc export` writes besides."""
MapFormat = Literal["netcdf", "npz"]
MAP_FORMATS: tuple[MapFormat, ...] = get_args(MapFormat)

MEDIA_TYPES: Mapping[Format, str] = {
    "json": "application/json",
    "opencv": "application/yaml",
    "ocamcalib": "text/plain; charset=utf-8",
    "asi-core": "application/zip",
    "mrcal": "text/plain; charset=utf-8",
    "netcdf": "application/x-netcdf",
    "npz": "application/x-npz",
}
FILE_NAMES: Mapping[Format, str] = {
    "json": "calibration.json",
    "opencv": "opencv_fisheye.yml",
    "ocamcalib": "calib_results.txt",
    "asi-core": "asi_core_camera.zip",
    "mrcal": "sunarc.cameramodel",
    "netcdf": "calibration.nc",
    "npz": "calibration.npz",
}


def export(document: Mapping[str, Any], form: Format) -> Exported:
    """Return a calibration document in another format.

    Raises
    ------
    InputError
        The document is none.
    """
    calibration = from_document(document)
    match form:
        case "json":
            return Exported(content=json.dumps(document).encode(), error="is the calibration itself")
        case "opencv":
            return _opencv(calibration, document)
        case "ocamcalib":
            return _ocam(calibration, document)
        case "asi-core":
            return asi_core_file(calibration, document)
        case "mrcal":
            return _mrcal(calibration, document)
        case "netcdf" | "npz":
            table, error = calibration_table(calibration, document)
            return Exported(
                content=_file(form)(table), error=f"between the pixels of the grid, {error}", difference=error.total
            )


def export_file(document: Mapping[str, Any], form: FileFormat) -> Exported:
    """Return a calibration document in one of the formats that `sunarc export` writes besides `FORMATS`.

    Its error is that of the file itself, read back.

    Raises
    ------
    InputError
        The document is none, or the format cannot describe its camera.
    """
    calibration = from_document(document)
    camera, written = calibration.camera, _FILE_WRITERS[form](calibration, document, notes_of(document))
    name, content = next(iter(written.items()))
    error = compare(camera_view(camera), read_view(content, name=name, beside=written.get))
    if form in _WITH_NOTES:
        written = _FILE_WRITERS[form](calibration, document, [*notes_of(document), f"this file {error}"])
    beside = {other: made for other, made in written.items() if other != name}
    return Exported(content=written[name], error=str(error), difference=error.total, name=name, beside=beside)


Written = dict[str, bytes]


def _fisheye_file(calibration: Calibration, document: Mapping[str, Any], notes: list[str], *, form: str) -> Written:
    camera = calibration.camera
    require_no_mirror(camera, form)
    size, model = (camera.width, camera.height), fisheye_model(camera, prism=form == "colmap")
    if form == "colmap":
        return {"cameras.txt": colmap_text(model, size=size, notes=notes)}
    return {"camera_info.yaml": ros_yaml(model, size=size, camera=str(document["camera"]), notes=notes)}


def _remap_file(calibration: Calibration, document: Mapping[str, Any], notes: list[str]) -> Written:
    del document
    camera = calibration.camera
    directions = sky_grid(min(camera.width, camera.height))
    return {"remap.npz": npz_bytes(remap_table(camera, directions, grid="sky", attributes={"notes": notes}))}


def _map_file(
    calibration: Calibration, document: Mapping[str, Any], notes: list[str], *, write: Callable[..., Written]
) -> Written:
    del document
    return write(back_projection_map(lookup(calibration)), notes)


_FILE_WRITERS: Mapping[FileFormat, Callable[[Calibration, Mapping[str, Any], list[str]], Written]] = {
    "opencv-remap": _remap_file,
    "colmap": partial(_fisheye_file, form="colmap"),
    "ros": partial(_fisheye_file, form="ros"),
    "fits": partial(_map_file, write=lambda found, notes: {"directions.fits": fits_file(found, notes)}),
    "matlab": partial(_map_file, write=lambda found, notes: {"directions.mat": matlab_file(found, notes)}),
    "azimuth-zenith-png": partial(_map_file, write=lambda found, _: sixteen_bit_files(found, suffix=".png")),
    "azimuth-zenith-jp2": partial(_map_file, write=lambda found, _: sixteen_bit_files(found, suffix=".jp2")),
}
_WITH_NOTES = ("opencv-remap", "colmap", "ros", "fits", "matlab")
"""Formats whose file says its error; two images cannot."""


def export_map(document: Mapping[str, Any], form: MapFormat) -> bytes:
    """Return the map of what every pixel of a calibration sees."""
    found = back_projection_map(lookup(from_document(document)))
    return _file(form)(map_table(found, document, masks={}))


def export_draws(document: Mapping[str, Any], form: MapFormat, *, draws: int, seed: int) -> bytes:
    """Return a calibration's arrays with draws of its errors, see `draws_table`."""
    return _file(form)(draws_table(document, draws=draws, seed=seed))


def _file(form: MapFormat) -> Callable[[Table], bytes]:
    return netcdf_bytes if form == "netcdf" else npz_bytes


def _opencv(calibration: Calibration, document: Mapping[str, Any]) -> Exported:
    camera = calibration.camera
    model = fisheye_model(camera)
    error = compare(camera_view(camera), fisheye_view("opencv", model, size=(camera.width, camera.height)))
    notes = {
        "calibration": document["id"],
        "model": "cv2.fisheye: projectPoints(directions, Rodrigues(rotation_cam_enu), zeros, K, D)",
        "conventions": f"{PIXELS}; rotation_cam_enu takes east-north-up to the camera (x right, y down, z out)",
        "limit": "the model divides by z: nothing at 90 degrees off the axis and beyond has a pixel",
        "fit_error": f"this model {error}",
    }
    content = opencv_yaml(model, width=camera.width, height=camera.height, notes=notes)
    return Exported(content=content, error=str(error), difference=error.total)


def _mrcal(calibration: Calibration, document: Mapping[str, Any]) -> Exported:
    camera = calibration.camera
    model = splined_model(camera)
    error = compare(camera_view(camera), splined_view(model, size=(camera.width, camera.height)))
    notes = [*notes_of(document), f"this model {error}"]
    content = cameramodel(model, camera, notes=notes)
    return Exported(content=content, error=str(error), difference=error.total)


def _ocam(calibration: Calibration, document: Mapping[str, Any]) -> Exported:
    camera = calibration.camera
    model = ocam_model(camera)
    error = compare(camera_view(camera), ocam_view("ocamcalib", model, size=(camera.width, camera.height)))
    content = calib_results(
        model, width=camera.width, height=camera.height, notes=[*notes_of(document), f"this model {error}"]
    )
    return Exported(content=content, error=str(error), difference=error.total)


# Draws of an ensemble as arrays: what every eighth pixel sees by each of them.

MOST_DRAWS_OF_A_FILE = 1000
"""A file of so many draws of a 2000 x 2000 image has 0.75 GB."""


def draws_table(document: Mapping[str, Any], *, draws: int, seed: int) -> Table:
    """Return a calibration's arrays with `direction_draw` (draw, y, x, component): unit vectors by each draw.

    Parameters
    ----------
    document : the calibration document; its id and the seed decide the draws, as over HTTP.
    draws : how many.
    seed : from 0.

    Raises
    ------
    InputError
        The number of draws or the seed is out of bounds, or not a calibration document.
    """
    if not 1 <= draws <= MOST_DRAWS_OF_A_FILE:
        remedy = f"give 1 to {MOST_DRAWS_OF_A_FILE}"
        raise InputError(field="--draws", problem=f"{draws} draws in one file", remedy=remedy)
    if seed < 0:
        raise InputError(field="--seed", problem=f"{seed} is negative", remedy="give 0 or more")
    calibration = from_document(document)
    table, _ = calibration_table(calibration, document)
    x, y = (table.variables[name].values.astype(np.float64) for name in ("x", "y"))
    grid = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
    ensemble = draw_ensemble(calibration, draws=draws, seed=seed, calibration_id=str(document["id"]))
    values = np.empty((draws, len(y), len(x), 3), dtype=np.float32)
    for draw in ensemble:
        values[draw] = ensemble.back_project(draw, grid).reshape(len(y), len(x), 3)
    attributes = {
        "units": "1",
        "long_name": "unit vector towards what the pixel sees by each draw, east-north-up",
        "camera_model": "camera",
        "coordinates": "component_name",
    }
    drawn = Variable(dimensions=("draw", "y", "x", "component"), values=values, attributes=attributes)
    return Table(
        variables={**table.variables, "direction_draw": drawn}, attributes={**table.attributes, "seed": np.int32(seed)}
    )
