"""Named arrays with units, as NetCDF (CF conventions) and npz: a calibration, and the map of directions."""

from __future__ import annotations

import io
import json
import zlib
from collections.abc import Mapping
from typing import Any, Literal, get_args
from zipfile import BadZipFile

import numpy as np
from numpy.typing import NDArray

from sunarc.calibration.answers.direction_table import BackProjectionMap, lookup
from sunarc.calibration.model.result import Calibration
from sunarc.common.array_types import IntArray
from sunarc.common.errors import InputError
from sunarc.common.extras import extra_module
from sunarc.formats.exported import PLACE, Table, Variable, discovery_attributes, discovery_variables
from sunarc.formats.view import Comparison, View, camera_view, compare, grid_view

_STEP = 8
_CHUNK = 128
"""Side of a compressed block, px: 64 kB, so that a pixel is read without unpacking the map."""
_WORTH_COMPRESSING = 4096
_COMPRESSION_LEVEL = 4
"""Of zlib. A map of 1748 x 1748 pixels: 73 MB become 28.9 MB in 0.7 s; level 1 29.7 MB, level 6 28.5 MB."""


MapFormat = Literal["netcdf", "npz"]
"""Formats of tables."""
MAP_FORMATS: tuple[MapFormat, ...] = get_args(MapFormat)


def table_bytes(table: Table, form: MapFormat) -> bytes:
    """Return the file of a table."""
    return {"netcdf": netcdf_bytes, "npz": npz_bytes}[form](table)


def netcdf_bytes(table: Table) -> bytes:
    """Return a NetCDF-4 file; InputError where the extra `netcdf` is not installed."""
    h5netcdf = extra_module("h5netcdf", extra="netcdf")  # imported here: the service starts sooner without it
    target = io.BytesIO()
    with h5netcdf.File(target, "w") as file:
        for variable in table.variables.values():
            for name, size in zip(variable.dimensions, variable.values.shape, strict=True):
                if name not in file.dimensions:
                    file.dimensions[name] = size
        for name, variable in table.variables.items():
            written = file.create_variable(name, variable.dimensions, **_make_array_options(variable.values))
            written.attrs.update(variable.attributes)
        file.attrs.update(table.attributes)
    return target.getvalue()


def _make_array_options(values: NDArray[Any]) -> dict[str, Any]:
    """Return the keywords of an array for h5netcdf: texts are of any length, maps are compressed without loss."""
    if values.dtype.kind == "U":
        return {"dtype": extra_module("h5py", extra="netcdf").string_dtype(), "data": values.astype(object)}
    if values.ndim < 2 or values.size < _WORTH_COMPRESSING:
        return {"data": values}
    chunks = (min(values.shape[0], _CHUNK), min(values.shape[1], _CHUNK), *(1 for _ in values.shape[2:]))
    packed = {"compression": "gzip", "compression_opts": _COMPRESSION_LEVEL, "shuffle": True}
    return {"data": values, "chunks": chunks, **packed}


def npz_bytes(table: Table) -> bytes:
    """Return an npz file: the arrays by name, and `attributes`, a JSON text of their attributes.

    It is compressed, but cannot sort the bytes of numbers by significance as NetCDF does, and is larger.
    """
    described = {"attributes": dict(table.attributes)} | {n: dict(v.attributes) for n, v in table.variables.items()}
    text = json.dumps(described, default=lambda value: value.tolist())
    target = io.BytesIO()
    arrays = {name: variable.values for name, variable in table.variables.items()}
    np.savez_compressed(target, allow_pickle=False, attributes=np.array(text), **arrays)
    return target.getvalue()


def read_table(content: bytes, *, name: str) -> View:
    """Return the view of a NetCDF or npz file of ours: its `direction` on its `x` and `y`, interpolated bilinearly.

    Raises
    ------
    InputError
        It has not these variables, or no direction at all.
    """
    try:
        if content.startswith(b"PK"):
            with np.load(io.BytesIO(content), allow_pickle=False) as file:
                x, y, directions = (np.asarray(file[key]) for key in ("x", "y", "direction"))
        else:
            h5netcdf = extra_module("h5netcdf", extra="netcdf")
            with h5netcdf.File(io.BytesIO(content), "r") as file:
                x, y, directions = (np.asarray(file.variables[key][...]) for key in ("x", "y", "direction"))
    # RuntimeError, OverflowError: of HDF5's library
    except (KeyError, ValueError, OSError, RuntimeError, OverflowError, BadZipFile, zlib.error) as error:
        raise InputError(
            field=name, problem=f"no map of directions ({error})", remedy="give a NetCDF or npz file of sunarc export"
        ) from None
    if any(axis.ndim != 1 or not np.all(np.diff(axis) > 0) for axis in (x, y)):
        raise InputError(field=name, problem="x or y does not ascend", remedy="write the file again")
    require_directions(directions, (len(y), len(x)), name=name)
    size = (int(x[-1]) + 1, int(y[-1]) + 1)
    return grid_view("netcdf", size=size, x=x, y=y, directions=directions.astype(np.float64))


def require_directions(directions: NDArray[Any], shape: tuple[int, int], *, name: str) -> None:
    """Raise InputError where a map has another shape than stated, or nothing but NaN."""
    if directions.shape != (*shape, 3):
        problem = f"directions of shape {directions.shape}, where {(*shape, 3)} are expected"
        raise InputError(field=name, problem=problem, remedy="write the file again")
    if not np.any(np.isfinite(directions)):
        raise InputError(field=name, problem="NaN everywhere", remedy="write the file again")


def map_table(found: BackProjectionMap, document: Mapping[str, Any], *, masks: Mapping[str, Variable]) -> Table:
    """Return the map of the directions of every pixel, with masks of its shape."""
    height, width = found.zenith_deg.shape
    variables = _make_axis_variables(np.arange(width), np.arange(height)) | discovery_variables(document)
    variables |= _make_direction_variables(found.zenith_deg, found.azimuth_deg, found.directions, found.sigma_deg)
    return Table(
        variables=variables | dict(masks),
        attributes=discovery_attributes(document, title="What every pixel of an all-sky imager sees"),
    )


def calibration_table(calibration: Calibration, document: Mapping[str, Any]) -> tuple[Table, Comparison]:
    """Return a calibration as arrays: parameters, covariance, and a grid of the directions of every eighth pixel.

    The error is that of a bilinear interpolation of the unit vectors between the pixels of the grid.
    """
    camera = calibration.camera
    size = (camera.width, camera.height)
    x, y = every_nth(_STEP, camera.width), every_nth(_STEP, camera.height)
    grid = np.stack(np.meshgrid(x, y), axis=-1).astype(np.float64)
    # The grid is that of the service's own table, so that a file and the API give the same directions.
    directions = lookup(calibration).back_project(grid.reshape(-1, 2)).reshape(len(y), len(x), -1)
    views = np.asarray(directions[..., 2:5], dtype=np.float64)
    error = compare(camera_view(camera), grid_view("netcdf", size=size, x=x, y=y, directions=views))
    names = np.array(calibration.parameter_names)
    variables = _make_axis_variables(x, y) | discovery_variables(document)
    variables |= _make_direction_variables(
        directions[..., 0], directions[..., 1], directions[..., 2:5], directions[..., 5]
    )
    variables |= {
        "parameter_name": Variable(
            dimensions=("parameter",), values=names, attributes={"long_name": "fitted parameter of a row"}
        ),
        "parameter_too_name": Variable(
            dimensions=("parameter_too",), values=names, attributes={"long_name": "fitted parameter of a column"}
        ),
        "covariance": Variable(
            dimensions=("parameter", "parameter_too"),
            values=calibration.covariance,
            attributes={
                "long_name": "covariance of the fitted parameters, in their own units",
                "units": "1",
                "coverage_content_type": "qualityInformation",
                "coordinates": "parameter_name parameter_too_name",
            },
        ),
    }
    attributes = discovery_attributes(document, title="Calibration of an all-sky imager") | {
        "calibration_document": json.dumps(document, separators=(",", ":")),
        "fit_error": f"the grid, interpolated bilinearly by its unit vectors, {error}",
    }
    return Table(variables=variables, attributes=attributes), error


def every_nth(step: int, size: int) -> IntArray:
    """Return every so manieth pixel, and the last one."""
    return np.unique(np.r_[np.arange(0, size, step), size - 1])


def _make_axis_variables(x: IntArray, y: IntArray) -> dict[str, Variable]:
    def axis(name: str, values: IntArray, meaning: str) -> Variable:
        return Variable(
            dimensions=(name,), values=values.astype(np.int32), attributes={"units": "1", "long_name": meaning}
        )

    component = Variable(
        dimensions=("component",),
        values=np.array(["east", "north", "up"]),
        attributes={"long_name": "component of a direction"},
    )
    return {
        "y": axis("y", y, "row in px from the centre of the top-most pixel, downward"),
        "x": axis("x", x, "column in px from the centre of the left-most pixel, rightward"),
        "component_name": component,
    }


def _make_direction_variables(
    zenith: NDArray[Any], azimuth: NDArray[Any], directions: NDArray[Any], sigma: NDArray[Any]
) -> dict[str, Variable]:
    def view(values: NDArray[Any], units: str, meaning: str, *more: str, **attributes: str) -> Variable:
        described = {
            "units": units,
            "long_name": meaning,
            "camera_model": "camera",
            "coverage_content_type": "referenceInformation",
            "coordinates": PLACE,
            **attributes,
        }
        return Variable(dimensions=("y", "x", *more), values=values, attributes=described)

    return {
        "zenith": view(
            zenith,
            "degree",
            "apparent zenith angle of the view direction",
            standard_name="zenith_angle",
            ancillary_variables="sigma",
        ),
        "azimuth": view(
            azimuth,
            "degree",
            "azimuth of the view direction, clockwise from north",
            standard_name="direction_of_radial_vector_away_from_instrument",
            ancillary_variables="sigma",
        ),
        "direction": view(
            directions,
            "1",
            "unit vector towards what the pixel sees, east-north-up",
            "component",
            coordinates=f"component_name {PLACE}",
            ancillary_variables="sigma",
        ),
        "sigma": view(
            sigma,
            "degree",
            "1-sigma of the view direction on the sphere, per axis",
            standard_name="zenith_angle standard_error",
            coverage_content_type="qualityInformation",
        ),
    }
