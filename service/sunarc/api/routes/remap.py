"""Routes: tables for `cv2.remap`, and composites mapped by them to the sky or to the ground under a cloud layer."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Annotated, Any

import cv2
import numpy as np
from fastapi import APIRouter, Query, Request
from fastapi.responses import Response
from starlette.concurrency import run_in_threadpool

import sunarc
from sunarc.api.compute_slots import ComputeSlots
from sunarc.api.context import ApiContext
from sunarc.api.problems import answers
from sunarc.api.routes.calibrations import decimal, etag_of
from sunarc.api.routes.choice import BY_CALIBRATION
from sunarc.api.routes.images import Captured, composite_file, decoded_preview
from sunarc.api.routes.stored_answers import RANGED, AnswerFiles, Content, Tagged
from sunarc.api.schemas.parameters import At, IfNoneMatch
from sunarc.archive.values import CalibrationRecord
from sunarc.array_types import FloatArray
from sunarc.errors import InputError
from sunarc.exports.formats import MEDIA_TYPES, MapFormat
from sunarc.exports.remap import Grid, grid_directions, reach_m, remap_table, remap_tables, remapped
from sunarc.exports.tables import netcdf_bytes, npz_bytes
from sunarc.geolocation.locate import clouds
from sunarc.optics.camera import Camera

_HEIGHT_M = 1000.0
"""Of a cloud base where none is given, m: that of fair-weather cumulus; the header `Sunarc-Height-M` tells it."""
_CELLS = 24
"""Along a side, of the grid that the stated error is taken over."""
_GRID = Annotated[Grid, Query(description="Equidistant map of the sky, or the ground under a cloud layer.")]
_SIZE = Annotated[int, Query(ge=16, le=4096, description="Cells along a side.")]
_HEIGHT = Annotated[
    float, Query(gt=0.0, le=30_000.0, description="Of the layer above the camera, m; of the ground grid.")
]
_HALF_WIDTH = Annotated[
    float | None,
    Query(
        gt=0.0,
        le=500_000.0,
        description="From the camera to the outermost cells, m; to 78 degrees of zenith angle where not given.",
    ),
]
_HEADERS: dict[str, Any] = {
    "Sunarc-Calibration": {"description": "Id of the calibration.", "schema": {"type": "string"}},
    "Sunarc-Sigma-Deg": {
        "description": "1-sigma of the directions, RMS over the grid, degrees.",
        "schema": {"type": "number"},
    },
    "Sunarc-Height-M": {"description": "Of the layer of a ground grid, metres.", "schema": {"type": "number"}},
    "Sunarc-Sigma-M": {
        "description": "The same on the ground grid, m, by the calibration.",
        "schema": {"type": "number"},
    },
    "ETag": {"description": "Changes with the calibration and the grid.", "schema": {"type": "string"}},
}
_TABLES: dict[int | str, dict[str, Any]] = {
    200: {
        "description": "map_x, map_y (size, size), single precision; -1 where the image has nothing (docs/rest.md).",
        "headers": _HEADERS,
        "content": {MEDIA_TYPES[name]: {} for name in ("netcdf", "npz")},
    },
    **RANGED,
    **answers(404, 416, 422),
    304: {"description": "The tables are the ones that If-None-Match names."},
}
_PICTURE: dict[int | str, dict[str, Any]] = {
    200: {
        "description": "PNG of 8 bits; 0 where the image has nothing.",
        "headers": _HEADERS,
        "content": {"image/png": {}},
    },
    **RANGED,
    **answers(404, 416, 422),
    304: {"description": "The picture is the one that If-None-Match names."},
}


@dataclass(frozen=True, slots=True, kw_only=True)
class _Asked:
    """A grid: what of, how large, how high and how wide."""

    grid: Grid
    size: int
    height_m: float
    half_width_m: float | None

    def directions(self, size: int) -> FloatArray:
        """Return the directions (size, size, 3) of the grid, with another number of cells."""
        return grid_directions(self.grid, size, half_width_m=self.width(), height_m=self.height_m)

    def width(self) -> float:
        """Return the half width of the ground grid, m."""
        return self.half_width_m or reach_m(self.height_m)

    def tag(self, *more: str) -> str:
        """Return what changes with the grid and with what else is named."""
        text = json.dumps([sunarc.__version__, self.grid, self.size, self.height_m, self.half_width_m, *more])
        return etag_of(text.encode())


def remap_routes(context: ApiContext, files: AnswerFiles) -> APIRouter:
    """Return the routes of the grids, whose answers are kept in files."""
    routes = APIRouter(tags=["images"])
    slots = ComputeSlots(1)

    @routes.get("/remap", dependencies=BY_CALIBRATION, response_class=Response, responses=_TABLES)
    async def remap(
        *,
        request: Request,
        at: At = None,
        grid: _GRID = "sky",
        size: _SIZE = 1024,
        height: _HEIGHT = _HEIGHT_M,
        half_width: _HALF_WIDTH = None,
        format_: Annotated[MapFormat, Query(alias="format", description="Of the answer.")] = "npz",
        if_none_match: IfNoneMatch = None,
    ) -> Response:
        """Return float32 tables that take an image to the grid: cv2.remap(image, map_x, map_y, cv2.INTER_LINEAR)."""
        asked = _Asked(grid=grid, size=size, height_m=height, half_width_m=half_width)
        selected, record = await run_in_threadpool(context.answering, request, at)
        tagged = _tagged(request, if_none_match, asked.tag(record.id, format_))
        content = partial(_tables, selected, record, asked, format_)
        stated = partial(_stated, selected, record, asked)
        return await files.answer(tagged, slots, partial(_made, content, stated, MEDIA_TYPES[format_]))

    @routes.get(
        "/images/{time}/rectified",
        dependencies=BY_CALIBRATION,
        response_class=Response,
        responses=_PICTURE,
    )
    async def rectified(
        *,
        request: Request,
        time: Captured,
        grid: _GRID = "sky",
        size: _SIZE = 1024,
        height: _HEIGHT = _HEIGHT_M,
        half_width: _HALF_WIDTH = None,
        if_none_match: IfNoneMatch = None,
    ) -> Response:
        """Return a composite's preview on the grid, north at the top and east at the right, by what answered then."""
        asked = _Asked(grid=grid, size=size, height_m=height, half_width_m=half_width)
        selected, record = await run_in_threadpool(context.answering, request, time)
        path = await run_in_threadpool(composite_file, selected, time, "jpeg")
        tagged = _tagged(request, if_none_match, asked.tag(record.id, path.stem))
        content = partial(_picture, selected, record, asked, path)
        stated = partial(_stated, selected, record, asked)
        return await files.answer(tagged, slots, partial(_made, content, stated, "image/png"))

    return routes


def _tagged(request: Request, if_none_match: str | None, tag: str) -> Tagged:
    headers = {"etag": tag, "cache-control": "private, no-cache"}
    return Tagged(request=request, headers=headers, if_none_match=if_none_match)


def _made(content: Callable[[], bytes], stated: Callable[[], dict[str, str]], media_type: str) -> Content:
    return Content(content=content(), media_type=media_type, headers=stated())


def _camera(context: ApiContext, record: CalibrationRecord) -> Camera:
    return context.ready.get(record).camera


def _tables(context: ApiContext, record: CalibrationRecord, asked: _Asked, format_: MapFormat) -> bytes:
    of_ground = {} if asked.grid == "sky" else {"height_m": asked.height_m, "half_width_m": asked.width()}
    attributes = {"calibration": record.id, **of_ground}
    directions = asked.directions(asked.size)
    table = remap_table(_camera(context, record), directions, grid=asked.grid, attributes=attributes)
    return netcdf_bytes(table) if format_ == "netcdf" else npz_bytes(table)


def _picture(context: ApiContext, record: CalibrationRecord, asked: _Asked, path: Path) -> bytes:
    image, camera = decoded_preview(path), _camera(context, record)
    if image.shape[:2] != (camera.height, camera.width):
        problem = (
            f"an image of {image.shape[1]}x{image.shape[0]} px, the calibration is of {camera.width}x{camera.height}"
        )
        raise InputError(field="time", problem=problem, remedy="choose a calibration of that camera, see calibration=")
    found = remapped(image, *remap_tables(camera, asked.directions(asked.size)))
    return bytes(cv2.imencode(".png", found)[1].tobytes())


def _stated(context: ApiContext, record: CalibrationRecord, asked: _Asked) -> dict[str, str]:
    """Return the headers: which calibration, and its error over the grid, on the sky and on the ground."""
    ready = context.ready.get(record)
    directions = asked.directions(_CELLS).reshape(-1, 3)
    directions = np.ascontiguousarray(directions[np.isfinite(directions[:, 0])])
    covariance = ready.direction_covariance(directions)
    headers = {"sunarc-calibration": record.id}
    headers |= _root_mean("sunarc-sigma-deg", np.degrees(1.0) ** 2 * 0.5 * np.trace(covariance, axis1=1, axis2=2))
    if asked.grid == "ground":
        site = context.archive.model(record.id).site
        place = clouds(directions, height_m=asked.height_m, covariance=covariance, site=site).covariance_m2
        headers["sunarc-height-m"] = decimal(asked.height_m, digits=9)
        headers |= _root_mean("sunarc-sigma-m", 0.5 * (place[:, 0, 0] + place[:, 1, 1]))
    return headers


def _root_mean(name: str, squares: FloatArray) -> dict[str, str]:
    """Return the header of a root mean square; none where the camera sees nothing of the grid."""
    finite = squares[np.isfinite(squares)]
    return {name: decimal(math.sqrt(float(np.mean(finite))))} if finite.size else {}
