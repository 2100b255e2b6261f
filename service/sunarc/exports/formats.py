"""The same calibration in others' formats, by name."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, Literal, get_args

from sunarc.calibration import Calibration, back_projection_map, from_document, lookup
from sunarc.exports.asi_core import asi_core_yaml, mask_mat, mask_name
from sunarc.exports.comparison import compare
from sunarc.exports.fisheye import fisheye_model, fisheye_view
from sunarc.exports.mrcal import cameramodel, splined_model, splined_view
from sunarc.exports.ocam import ocam_model, ocam_view
from sunarc.exports.ocamcalib import calib_results
from sunarc.exports.opencv import opencv_yaml
from sunarc.exports.tables import Table, calibration_table, map_table, netcdf_bytes, npz_bytes
from sunarc.exports.view import camera_view

Format = Literal["json", "opencv", "ocamcalib", "asi-core", "mrcal", "netcdf", "npz"]
FORMATS: tuple[Format, ...] = get_args(Format)
MapFormat = Literal["netcdf", "npz"]
MAP_FORMATS: tuple[MapFormat, ...] = get_args(MapFormat)

MEDIA_TYPES: Mapping[Format, str] = {
    "json": "application/json",
    "opencv": "application/yaml",
    "ocamcalib": "text/plain; charset=utf-8",
    "asi-core": "application/yaml",
    "mrcal": "text/plain; charset=utf-8",
    "netcdf": "application/x-netcdf",
    "npz": "application/x-npz",
}
FILE_NAMES: Mapping[Format, str] = {
    "json": "calibration.json",
    "opencv": "opencv_fisheye.yml",
    "ocamcalib": "calib_results.txt",
    "asi-core": "asi_core_camera.yaml",
    "mrcal": "sunarc.cameramodel",
    "netcdf": "calibration.nc",
    "npz": "calibration.npz",
}

_PIXELS = "pixel (0, 0) is the centre of the top-left one, x right, y down; azimuth clockwise from north"
_FAR_PAST, _FAR_FUTURE = "1970-01-01T00:00:00Z", "2199-12-31T00:00:00Z"


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Exported:
    """A calibration in another format.

    Attributes
    ----------
    content : the file.
    error : how far it is from the calibration, in one sentence; the file says it too.
    beside : files that belong beside it, by the names that it calls them.
    """

    content: bytes
    error: str
    beside: Mapping[str, bytes] = field(default_factory=dict)


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
            return _asi_core(calibration, document)
        case "mrcal":
            return _mrcal(calibration, document)
        case "netcdf" | "npz":
            table, error = calibration_table(calibration, document)
            return Exported(content=_file(form)(table), error=f"between the pixels of the grid, {error}")


def export_map(document: Mapping[str, Any], form: MapFormat) -> bytes:
    """Return the map of what every pixel of a calibration sees."""
    found = back_projection_map(lookup(from_document(document)))
    return _file(form)(map_table(found, document, masks={}))


def _file(form: MapFormat) -> Callable[[Table], bytes]:
    return netcdf_bytes if form == "netcdf" else npz_bytes


def _opencv(calibration: Calibration, document: Mapping[str, Any]) -> Exported:
    camera = calibration.camera
    model = fisheye_model(camera)
    error = str(compare(camera_view(camera), fisheye_view("opencv", model, size=(camera.width, camera.height))))
    notes = {
        "calibration": document["id"],
        "model": "cv2.fisheye: projectPoints(directions, Rodrigues(rotation_cam_enu), zeros, K, D)",
        "conventions": f"{_PIXELS}; rotation_cam_enu takes east-north-up to the camera (x right, y down, z out)",
        "limit": "the model divides by z: nothing at 90 degrees off the axis and beyond has a pixel",
        "fit_error": f"this model {error}",
    }
    return Exported(content=opencv_yaml(model, width=camera.width, height=camera.height, notes=notes), error=error)


def _mrcal(calibration: Calibration, document: Mapping[str, Any]) -> Exported:
    camera = calibration.camera
    model = splined_model(camera)
    error = str(compare(camera_view(camera), splined_view(model, size=(camera.width, camera.height))))
    notes = [*_notes(document), f"this model {error}"]
    return Exported(content=cameramodel(model, camera, notes=notes), error=error)


def _ocam(calibration: Calibration, document: Mapping[str, Any]) -> Exported:
    camera = calibration.camera
    model = ocam_model(camera)
    error = str(compare(camera_view(camera), ocam_view("ocamcalib", model, size=(camera.width, camera.height))))
    content = calib_results(
        model, width=camera.width, height=camera.height, notes=[*_notes(document), f"this model {error}"]
    )
    return Exported(content=content, error=error)


def _asi_core(calibration: Calibration, document: Mapping[str, Any]) -> Exported:
    camera, model = calibration.camera, ocam_model(calibration.camera, cubic=True)
    error = str(compare(camera_view(camera), ocam_view("asi-core", model, size=(camera.width, camera.height))))
    name = mask_name(str(document["camera"]))
    notes = [
        *_notes(document),
        f"this model {error}",
        "asi_core's own azimuth matrix is counted in radians counter-clockwise from east: it is pi/2 - azimuth",
        "its object coordinates are (north, east, up); its x_center is the row, its y_center the column",
    ]
    site = {
        "camera_name": str(document["camera"]),
        "camera_mask_file": name,
        "mounted": document["valid_from"] or _FAR_PAST,
        "demounted": document["valid_until"] or _FAR_FUTURE,
        **{name: float(document["site"][name]) for name in ("latitude", "longitude", "altitude")},
    }
    content = asi_core_yaml(model, width=camera.width, height=camera.height, camera=site, notes=notes)
    return Exported(content=content, error=error, beside={name: mask_mat(back_projection_map(lookup(calibration)))})


def _notes(document: Mapping[str, Any]) -> list[str]:
    software = document["software"]
    return [
        f"{software['name']} {software['version']}: camera {document['camera']}, calibration {document['id']}",
        f"conventions of the service: {_PIXELS}",
    ]
