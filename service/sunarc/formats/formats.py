"""Formats of a calibration, one record each: names of its files, how they are written, read and recognised."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, Literal, Protocol, get_args

import numpy as np

from sunarc.calibration.answers.covariance import project_with_covariance, unproject_with_sigma
from sunarc.calibration.answers.direction_table import BackProjectionMap, back_projection_map, lookup
from sunarc.calibration.answers.error_model import draw_ensemble
from sunarc.calibration.model.result import Calibration
from sunarc.common.errors import InputError
from sunarc.common.findings import Finding, FindingError
from sunarc.formats import fisheye, pixel_maps
from sunarc.formats.asi_core import asi_core_file, read_asi_core
from sunarc.formats.calibration_document import from_document
from sunarc.formats.exported import PIXELS, Exported, Table, Variable, file_notes
from sunarc.formats.mrcal import cameramodel, read_mrcal, splined_model, splined_view
from sunarc.formats.ocam import calib_results, ocam_model, ocam_view, read_ocamcalib
from sunarc.formats.remap import is_remap, read_remap, remap_table, sky_grid
from sunarc.formats.tables import MapFormat, calibration_table, map_table, read_table, table_bytes
from sunarc.formats.view import View, camera_view, compare
from sunarc.formats.virtualsky import MOST_DEG, virtualsky_json, virtualsky_model, virtualsky_view

ServedFormat = Literal["json", "opencv", "ocamcalib", "asi-core", "mrcal", "netcdf", "npz"]
"""Names of the formats that are served over HTTP."""
SERVED: tuple[ServedFormat, ...] = get_args(ServedFormat)
Document = Mapping[str, Any]
Beside = Callable[[str], bytes | None]
"""Returns a file that another one names, None where it is not there."""
Written = dict[str, bytes]
Write = Callable[[Calibration, Document], Exported]
WriteFiles = Callable[[Calibration, Document, list[str]], Written]

_PROBED = 9
"""Pixels along a side that are asked for a direction: a fisheye shows some of them, whatever its field."""


class Read(Protocol):
    """Returns the view of a camera that a file holds; raises InputError where the file does not follow its format."""

    def __call__(self, content: bytes, /, *, name: str, beside: Beside) -> View:
        """Return the view."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Format:
    """A format.

    Attributes
    ----------
    name : what it is asked for by.
    file : what its file, or the first of its files, is called; a set names its own.
    write : makes its files of a calibration and the document of that.
    read : None where nothing reads it.
    start : bytes that its files begin with, one of them.
    inside : bytes that its files contain, one of them. A file without any mark is a calibration document.
    media_type : over HTTP; None where it is not served.
    """

    name: str
    file: str
    write: Write
    read: Read | None = None
    start: tuple[bytes, ...] = ()
    inside: tuple[bytes, ...] = ()
    media_type: str | None = None


def export(document: Document, form: str) -> Exported:
    """Return a calibration document in another format.

    Raises
    ------
    InputError
        The document is not a calibration document, the format is unknown, or cannot describe its camera.
    """
    return find_format(form).write(from_document(document), document)


def find_format(name: str, *, field: str = "format") -> Format:
    """Return a format by its name; FindingError where it is unknown."""
    if name not in FORMATS:
        raise FindingError(field, Finding("format_unknown", {"format": name, "known": ", ".join(FORMATS)}))
    return FORMATS[name]


def read_view(content: bytes, *, name: str, beside: Beside = lambda _: None) -> View:
    """Return the view of a camera that a file of any format holds.

    Raises
    ------
    InputError
        The format is unknown or without a reader, the file is not what its format says, or no pixel of its image has a
        direction.
    """
    view = _get_reader(_recognize_format(content), name)(content, name=name, beside=beside)
    across = [np.linspace(0.0, size - 1.0, _PROBED) for size in (view.width, view.height)]
    if not np.any(np.isfinite(view.unproject(np.stack(np.meshgrid(*across), axis=-1).reshape(-1, 2)))):
        raise InputError(
            field=name, problem="no pixel of its image has a direction", remedy="look for NaN among its numbers"
        )
    return view


def _recognize_format(content: bytes) -> Format:
    """Return the format of a file: by its start, else by the longest mark in it."""
    for form in FORMATS.values():
        if content.startswith(form.start):
            return form
    marked = [(len(mark), form) for form in FORMATS.values() for mark in form.inside if mark in content]
    return max(marked, key=lambda one: one[0])[1] if marked else FORMATS["json"]


def _get_reader(form: Format, field: str) -> Read:
    if form.read is None:
        raise FindingError(field, Finding("format_without_reader", {"format": form.name}))
    return form.read


def _read_json(content: bytes, /, *, name: str, beside: Beside) -> View:
    del beside
    try:
        document = json.loads(content)
    except (ValueError, RecursionError):
        known = ", ".join(one.name for one in FORMATS.values() if one.read is not None)
        raise FindingError(name, Finding("file_format_unknown", {"known": known})) from None
    if isinstance(document, dict) and set(document) >= _PLATEPAR:
        raise FindingError(name, Finding("platepar_not_read"))
    calibration = from_document(document)
    return replace(calibration_view(calibration), document=document, calibration=calibration)


_PLATEPAR = {"RA_d", "dec_d", "F_scale", "x_poly_fwd"}
"""Keys of an RMS platepar, the plate solution of a meteor station."""


def calibration_view(calibration: Calibration) -> View:
    """Return the view of a calibration: that of its camera, as far as it answers."""
    view = camera_view(calibration.camera)
    if calibration.sigma_limit_deg is None:
        return view
    return replace(
        view,
        project=lambda directions: project_with_covariance(calibration, directions)[0],
        unproject=lambda pixels: unproject_with_sigma(calibration, pixels)[0],
        sigma_limit_deg=calibration.sigma_limit_deg,
    )


def _read_npz(content: bytes, *, name: str) -> View:
    return (read_remap if is_remap(content) else read_table)(content, name=name)


def _lone_file(read: Callable[..., View]) -> Read:
    """Return a reader of files that refer to no other file."""

    def reader(content: bytes, /, *, name: str, beside: Beside) -> View:
        del beside
        return read(content, name=name)

    return reader


# Models that are fitted to the camera: the error is that of the model.


def _export_model(
    calibration: Calibration, document: Document, view: View, content: Callable[[list[str]], bytes]
) -> Exported:
    """Return the file of a model, with its difference to the camera among its notes."""
    error = compare(camera_view(calibration.camera), view)
    notes = [*file_notes(document), f"this model {error}"]
    return Exported(content=content(notes), error=str(error), difference=error.total)


def _image_size(calibration: Calibration) -> tuple[int, int]:
    return calibration.camera.width, calibration.camera.height


def _export_opencv(calibration: Calibration, document: Document) -> Exported:
    model, (width, height) = fisheye.fisheye_model(calibration.camera), _image_size(calibration)

    def content(notes: list[str]) -> bytes:
        stated = {
            "calibration": document["id"],
            "model": "cv2.fisheye: projectPoints(directions, Rodrigues(rotation_cam_enu), zeros, K, D)",
            "conventions": f"{PIXELS}; rotation_cam_enu takes east-north-up to the camera (x right, y down, z out)",
            "limit": "the model divides by z: nothing at 90 degrees off the axis and beyond has a pixel",
            "fit_error": notes[-1],
        }
        return fisheye.opencv_yaml(model, width=width, height=height, notes=stated)

    return _export_model(calibration, document, fisheye.fisheye_view("opencv", model, size=(width, height)), content)


def _export_mrcal(calibration: Calibration, document: Document) -> Exported:
    model = splined_model(calibration.camera)
    view = splined_view(model, size=_image_size(calibration))
    return _export_model(calibration, document, view, lambda notes: cameramodel(model, calibration.camera, notes=notes))


def _export_ocamcalib(calibration: Calibration, document: Document) -> Exported:
    model, (width, height) = ocam_model(calibration.camera), _image_size(calibration)
    view = ocam_view("ocamcalib", model, size=(width, height))
    return _export_model(
        calibration, document, view, lambda notes: calib_results(model, width=width, height=height, notes=notes)
    )


def _export_virtualsky(calibration: Calibration, document: Document) -> Exported:
    fisheye.require_no_mirror(calibration.camera, "virtualsky")
    square, size = virtualsky_model(calibration.camera), _image_size(calibration)

    def content(notes: list[str]) -> bytes:
        return virtualsky_json(square, size=size, site=calibration.site, notes=notes)

    made = _export_model(calibration, document, virtualsky_view(square, size=size), content)
    if made.difference is None or not made.difference.max_deg <= MOST_DEG:
        worst = math.nan if made.difference is None else made.difference.max_deg
        raise FindingError("calibration", Finding("format_does_not_hold", {"max_deg": worst, "limit_deg": MOST_DEG}))
    return made


# Files whose error is that of the file, read back.


def _export_and_read_back(
    name: str, write: WriteFiles, calibration: Calibration, document: Document, *, says: bool
) -> Exported:
    """Return the files of a format, with the error found by reading them back."""
    notes = file_notes(document)
    written = write(calibration, document, notes)
    file = next(iter(written))
    view = _get_reader(FORMATS[name], name)(written[file], name=file, beside=written.get)
    error = compare(camera_view(calibration.camera), view)
    if says:
        written = write(calibration, document, [*notes, f"this file {error}"])
    beside = {other: content for other, content in written.items() if other != file}
    return Exported(content=written[file], error=str(error), difference=error.total, name=file, beside=beside)


def _write_colmap(calibration: Calibration, document: Document, notes: list[str]) -> Written:
    del document
    fisheye.require_no_mirror(calibration.camera, "colmap")
    model = fisheye.fisheye_model(calibration.camera, prism=True)
    return {"cameras.txt": fisheye.colmap_text(model, size=_image_size(calibration), notes=notes)}


def _write_ros(calibration: Calibration, document: Document, notes: list[str]) -> Written:
    fisheye.require_no_mirror(calibration.camera, "ros")
    model, camera = fisheye.fisheye_model(calibration.camera), str(document["camera"])
    return {"camera_info.yaml": fisheye.ros_yaml(model, size=_image_size(calibration), camera=camera, notes=notes)}


def _write_remap(calibration: Calibration, document: Document, notes: list[str]) -> Written:
    del document
    table = remap_table(
        calibration.camera, sky_grid(min(_image_size(calibration))), grid="sky", attributes={"notes": notes}
    )
    return {"remap.npz": table_bytes(table, "npz")}


def _write_pixel_maps(write: Callable[[BackProjectionMap, list[str]], Written]) -> WriteFiles:
    """Return the writer of the map of directions of every pixel."""
    return lambda calibration, _, notes: write(back_projection_map(lookup(calibration)), notes)


# Tables: parameters, covariance and the directions of a grid, or those of every pixel.


def _export_table(calibration: Calibration, document: Document, *, form: MapFormat) -> Exported:
    table, error = calibration_table(calibration, document)
    stated = f"between the pixels of the grid, {error}"
    return Exported(content=table_bytes(table, form), error=stated, difference=error.total)


def _export_map(calibration: Calibration, document: Document, *, form: MapFormat) -> Exported:
    table = map_table(back_projection_map(lookup(calibration)), document, masks={})
    return Exported(content=table_bytes(table, form), error="in single precision")


def _export_json(calibration: Calibration, document: Document) -> Exported:
    del calibration
    return Exported(content=json.dumps(document).encode(), error="is the calibration itself")


def _file_format(
    name: str,
    file: str,
    write: WriteFiles,
    read: Read,
    *,
    start: tuple[bytes, ...] = (),
    inside: tuple[bytes, ...] = (),
    says: bool = True,
) -> Format:
    """Return a format whose error is found by reading its file back."""
    return Format(
        name=name,
        file=file,
        write=partial(_export_and_read_back, name, write, says=says),
        read=read,
        start=start,
        inside=inside,
    )


_JSON = "application/json"
_TEXT = "text/plain; charset=utf-8"
FORMATS: Mapping[str, Format] = {
    form.name: form
    for form in (
        Format(name="json", file="calibration.json", write=_export_json, read=_read_json, media_type=_JSON),
        Format(
            name="opencv", file="opencv_fisheye.yml", write=_export_opencv, read=_lone_file(fisheye.read_opencv),
            inside=(b"%YAML", b"opencv_storage", b"opencv-matrix", b"<?xml"), media_type="application/yaml",
        ),
        Format(
            name="ocamcalib", file="calib_results.txt", write=_export_ocamcalib, read=_lone_file(read_ocamcalib),
            inside=(b"polynomial coefficients for the DIRECT mapping",), media_type=_TEXT,
        ),
        Format(
            name="asi-core", file="asi_core_camera.zip", write=asi_core_file, read=read_asi_core,
            inside=(b"internal_calibration",), media_type="application/zip",
        ),
        Format(
            name="mrcal", file="sunarc.cameramodel", write=_export_mrcal, read=_lone_file(read_mrcal),
            inside=(b"LENSMODEL_",), media_type=_TEXT,
        ),
        Format(
            name="netcdf", file="calibration.nc", write=partial(_export_table, form="netcdf"),
            read=_lone_file(read_table), start=(b"\x89HDF",), media_type="application/x-netcdf",
        ),
        Format(
            name="npz", file="calibration.npz", write=partial(_export_table, form="npz"), read=_lone_file(_read_npz),
            start=(b"PK",), media_type="application/x-npz",
        ),
        Format(name="virtualsky", file="virtualsky.json", write=_export_virtualsky, inside=(b'"virtualsky": {',)),
        _file_format("opencv-remap", "remap.npz", _write_remap, _lone_file(read_remap), start=(b"PK",)),
        _file_format("colmap", "cameras.txt", _write_colmap, _lone_file(fisheye.read_colmap), inside=(b"_FISHEYE ",)),
        _file_format(
            "ros", "camera_info.yaml", _write_ros, _lone_file(fisheye.read_ros), inside=(b"distortion_model:",)
        ),
        _file_format(
            "fits", "directions.fits",
            _write_pixel_maps(lambda found, notes: {"directions.fits": pixel_maps.fits_file(found, notes)}),
            _lone_file(pixel_maps.read_fits), start=(b"SIMPLE  =",),
        ),
        _file_format(
            "matlab", "directions.mat",
            _write_pixel_maps(lambda found, notes: {"directions.mat": pixel_maps.matlab_file(found, notes)}),
            _lone_file(pixel_maps.read_matlab), start=(b"MATLAB 5.0",),
        ),
        _file_format(
            "azimuth-zenith-png", "azimuth_visible.png",
            _write_pixel_maps(lambda found, _: pixel_maps.sixteen_bit_files(found, suffix=".png")),
            pixel_maps.read_sixteen_bit, start=(b"\x89PNG",), says=False,
        ),
        _file_format(
            "azimuth-zenith-jp2", "azimuth_visible.jp2",
            _write_pixel_maps(lambda found, _: pixel_maps.sixteen_bit_files(found, suffix=".jp2")),
            pixel_maps.read_sixteen_bit, start=(b"\x00\x00\x00\x0cjP  ",), says=False,
        ),
        Format(
            name="map-netcdf", file="map.nc", write=partial(_export_map, form="netcdf"), read=_lone_file(read_table),
            start=(b"\x89HDF",),
        ),
        Format(
            name="map-npz", file="map.npz", write=partial(_export_map, form="npz"), read=_lone_file(read_table),
            start=(b"PK",),
        ),
    )
}  # fmt: skip
"""All formats by name; of two that begin alike the first reads both."""


# Draws of an ensemble as arrays: what every eighth pixel sees by each of them.

MOST_DRAWS_OF_A_FILE = 1000
"""A file of so many draws of a 2000 x 2000 image has 0.75 GB."""


def export_draws(document: Document, form: MapFormat, *, draws: int, seed: int) -> bytes:
    """Return a calibration's arrays with draws of its errors, see `draws_table`."""
    return table_bytes(draws_table(document, draws=draws, seed=seed), form)


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
