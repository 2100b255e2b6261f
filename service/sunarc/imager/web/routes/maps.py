"""Routes: the map of the directions of pixels, the masks of sun and horizon, and maps for rectifying images."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from datetime import datetime
from functools import partial
from pathlib import Path
from typing import Annotated, Any

import cv2
import numpy as np
from fastapi import APIRouter, Query, Request
from fastapi.responses import Response
from numpy.typing import NDArray
from starlette.concurrency import run_in_threadpool

import sunarc
from sunarc.calibration.answers.direction_table import BackProjectionMap, back_projection_map
from sunarc.common.array_types import BoolArray, FloatArray
from sunarc.common.errors import InputError
from sunarc.formats.exported import Variable
from sunarc.formats.formats import FORMATS
from sunarc.formats.remap import Grid, grid_directions, reach_m, remap_table, remap_tables, remapped
from sunarc.formats.tables import MAP_FORMATS, MapFormat, map_table, table_bytes
from sunarc.geolocation.locate import clouds
from sunarc.imager.archive.values import CalibrationRecord
from sunarc.imager.web.bulk import ComputeSlots
from sunarc.imager.web.context import ApiContext, model_key
from sunarc.imager.web.hidden_sky import hidden_by_obstructions, obstructions_key
from sunarc.imager.web.parameters import BY_CALIBRATION, At, IfNoneMatch
from sunarc.imager.web.problems import answers, described_answer
from sunarc.imager.web.routes.calibrations import decimal, make_etag
from sunarc.imager.web.routes.images import Captured, decoded_preview, image_file
from sunarc.imager.web.routes.stored_answers import RANGED, AnswerFiles, ResponseBody, Tagged
from sunarc.optics.camera import Camera
from sunarc.sky.site import Site
from sunarc.sky.sun import sun_directions

_TABLE_TYPES = tuple(str(FORMATS[name].media_type) for name in MAP_FORMATS)
_MAP = RANGED | described_answer(
    "zenith, azimuth, direction, sigma of every pixel, and masks (docs/rest.md).",
    _TABLE_TYPES,
    headers={"ETag": "Changes with the calibration."},
    same="The map is the one",
)
Radius = Annotated[
    float | None,
    Query(gt=0.0, le=90.0, description="Adds a mask of a disc round the sun of so many degrees.", examples=[10.0]),
]


def map_routes(context: ApiContext, files: AnswerFiles) -> APIRouter:
    """Return the route of the map of directions, answered from a file."""
    routes = APIRouter(tags=["directions"])
    slots = ComputeSlots(1)

    @routes.get(
        "/back-projection-map",
        dependencies=BY_CALIBRATION,
        response_class=Response,
        responses=_MAP | answers(404, 416, 422, 503),
    )
    async def back_projection_map(
        request: Request,
        at: At = None,
        format_: Annotated[MapFormat, Query(alias="format", description="Of the answer.")] = "netcdf",
        sun_radius_deg: Radius = None,
        if_none_match: IfNoneMatch = None,
    ) -> Response:
        """Return every pixel's direction and 1-sigma, now or at the time `at`, and a mask round the sun."""
        selected, record = await run_in_threadpool(context.answering, request, at)
        sun = None if sun_radius_deg is None else (at or selected.frame_clock(), sun_radius_deg)
        site = None if sun is None else await run_in_threadpool(selected.site_with_air_at, sun[0])
        requested = _Map(context=selected, record=record, format=format_, sun=sun, site=site)
        tag = await run_in_threadpool(_make_tag, requested)
        headers = {"etag": tag, "cache-control": "no-cache", "sunarc-calibration": record.id}
        tagged = Tagged(request=request, headers=headers, if_none_match=if_none_match)
        return await files.answer(tagged, slots, partial(_make_map, requested))

    return routes


@dataclass(frozen=True, slots=True, kw_only=True)
class _Map:
    """Requested map.

    Attributes
    ----------
    context : of the camera.
    record : its calibration.
    format : of the file.
    sun : the moment and the radius in degrees of a mask round the sun; None: without.
    site : in the air of that moment, which refracts the sun; None: without a mask.
    """

    context: ApiContext
    record: CalibrationRecord
    format: MapFormat
    sun: tuple[datetime, float] | None
    site: Site | None


def _make_map(requested: _Map) -> ResponseBody:
    found = back_projection_map(requested.context.ready.get(requested.record))
    masks = _make_obstruction_mask(requested.context, requested.record)
    if requested.sun is not None and requested.site is not None:
        masks |= _make_sun_mask(requested.site, *requested.sun, found)
    table = map_table(found, requested.record.document, masks=masks)
    content = table_bytes(table, requested.format)
    return ResponseBody(content=content, media_type=str(FORMATS[requested.format].media_type))


def _make_tag(requested: _Map) -> str:
    """Return a tag that changes with a map: its calibration, its masks, and its writer."""
    masks = obstructions_key(requested.context, requested.record)
    parts = (masks, model_key(requested.record), sunarc.__version__, requested.format, requested.sun, requested.site)
    return make_etag(repr(parts).encode())


def _make_sun_mask(site: Site, time: datetime, radius_deg: float, found: BackProjectionMap) -> dict[str, Variable]:
    sun = sun_directions(time.timestamp(), site).astype(np.float32)
    near = found.directions @ sun > math.cos(math.radians(radius_deg))
    of_sun = {"radius_deg": radius_deg, "time": time.isoformat()}
    return {
        "sun_mask": _make_flag_variable(near, "1 within a disc round the sun", "away_from_the_sun near_the_sun", of_sun)
    }


def _make_flag_variable(holds: BoolArray, text: str, meanings: str, more: Mapping[str, Any]) -> Variable:
    """Return a mask as a variable of CF flags."""
    flags = {"units": "1", "flag_values": np.array([0, 1], dtype=np.uint8), "flag_meanings": meanings}
    return Variable(
        dimensions=("y", "x"), values=holds.astype(np.uint8), attributes={"long_name": text, **flags, **more}
    )


def _make_obstruction_mask(context: ApiContext, record: CalibrationRecord) -> dict[str, Variable]:
    hidden = hidden_by_obstructions(context, record)
    if hidden is None:
        return {}
    return {"obstruction_mask": _make_flag_variable(hidden, "1 where something hides the sky", "sky obstruction", {})}


_MASK = RANGED | described_answer(
    "PNG of 8 bits of the image's size: 255 where the mask holds, else 0.",
    ["image/png"],
    headers={"Sunarc-Calibration": "Id of the calibration.", "ETag": "Changes with the mask."},
    same="The mask is the one",
)
_RADIUS = Annotated[float, Query(gt=0.0, le=90.0, description="Of the disc, degrees on the sky.", examples=[10.0])]
_ELEVATION = Annotated[
    float, Query(ge=-20.0, lt=90.0, description="Apparent elevation of the mask's edge, degrees.", examples=[0.0])
]


def mask_routes(context: ApiContext, files: AnswerFiles) -> APIRouter:
    """Return the routes of the masks, which are kept in files."""
    routes = APIRouter(tags=["images"])
    slots = ComputeSlots(1)

    async def sent(
        request: Request, at: datetime | None, if_none_match: str | None, *, name: str, limit: float
    ) -> Response:
        """Return a mask, or 304: a threshold on the cosine of the angle to the sun, or of the zenith angle."""
        selected, record = await run_in_threadpool(context.answering, request, at)
        time = at or selected.frame_clock()
        axis = np.array([0.0, 0.0, 1.0])
        if name == "sun":
            site = await run_in_threadpool(selected.site_with_air_at, time)
            axis = np.asarray(sun_directions(time.timestamp(), site))
        hidden = await run_in_threadpool(hidden_by_obstructions, selected, record) if name == "horizon" else None
        key = repr(
            (name, record.id, sunarc.__version__, limit, axis.tolist(), None if hidden is None else hidden.tobytes())
        )
        tag, headers = make_etag(key.encode()), {"sunarc-calibration": record.id, "cache-control": "no-cache"}
        asked = Tagged(request=request, headers=headers | {"etag": tag}, if_none_match=if_none_match)

        def made() -> ResponseBody:
            return ResponseBody(content=_make_mask_png(selected, record, axis, limit, hidden), media_type="image/png")

        return await files.answer(asked, slots, made)

    @routes.get(
        "/masks/sun", dependencies=BY_CALIBRATION, response_class=Response, responses=_MASK | answers(404, 416, 422)
    )
    async def sun_mask(
        request: Request, at: At = None, radius_deg: _RADIUS = 10.0, if_none_match: IfNoneMatch = None
    ) -> Response:
        """Return which pixels look within a radius of the sun, now or at the time `at`."""
        return await sent(request, at, if_none_match, name="sun", limit=math.cos(math.radians(radius_deg)))

    @routes.get(
        "/masks/horizon", dependencies=BY_CALIBRATION, response_class=Response, responses=_MASK | answers(404, 416, 422)
    )
    async def horizon_mask(
        request: Request, at: At = None, elevation_deg: _ELEVATION = 0.0, if_none_match: IfNoneMatch = None
    ) -> Response:
        """Return which pixels show the sky above an elevation, outside the obstructions of `api.obstruction_mask`."""
        return await sent(request, at, if_none_match, name="horizon", limit=math.sin(math.radians(elevation_deg)))

    return routes


def _make_mask_png(
    context: ApiContext, record: CalibrationRecord, axis: FloatArray, least_cosine: float, hidden: BoolArray | None
) -> bytes:
    """Return a PNG of the pixels whose direction has at least a cosine to an axis, and that are not hidden."""
    table = context.ready.get(record).table
    camera = table.camera
    holds = np.zeros((camera.height, camera.width), dtype=bool)
    columns = np.arange(camera.width, dtype=np.float64)
    for row in range(camera.height):
        pixels = np.stack([columns, np.full(camera.width, float(row))], axis=-1)
        with np.errstate(invalid="ignore"):
            holds[row] = table.directions(pixels) @ axis >= least_cosine  # NaN is no direction
    if hidden is not None:
        holds &= ~hidden
    encoded: NDArray[np.uint8] = holds.astype(np.uint8) * np.uint8(255)
    return bytes(cv2.imencode(".png", encoded)[1].tobytes())


_HEIGHT_M = 1000.0
"""Of a cloud base where none is given, m: that of fair-weather cumulus; the header `Sunarc-Height-M` states it."""
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
_of_grid = partial(
    described_answer,
    headers={"Sunarc-Calibration": "Id of the calibration.", "ETag": "Changes with the calibration and the grid."},
    numbers={
        "Sunarc-Sigma-Deg": "1-sigma of the directions, RMS over the grid, degrees.",
        "Sunarc-Height-M": "Of the layer of a ground grid, metres.",
        "Sunarc-Sigma-M": "The same on the ground grid, m, by the calibration.",
    },
)
_NOT_MADE = RANGED | answers(404, 416, 422, 503)
_TABLES = _NOT_MADE | _of_grid(
    "map_x, map_y (size, size), single precision; -1 where the image has nothing (docs/rest.md).",
    _TABLE_TYPES,
    same="The tables are the ones",
)
_PICTURE = _NOT_MADE | _of_grid(
    "PNG of 8 bits; 0 where the image has nothing.", ["image/png"], same="The picture is the one"
)


@dataclass(frozen=True, slots=True, kw_only=True)
class _AskedTables:
    """Requested grid: its kind, size, height and the camera's altitude."""

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
        """Return a tag that changes with the grid and with the other named values."""
        text = json.dumps([sunarc.__version__, self.grid, self.size, self.height_m, self.half_width_m, *more])
        return make_etag(text.encode())


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
        asked = _AskedTables(grid=grid, size=size, height_m=height, half_width_m=half_width)
        selected, record = await run_in_threadpool(context.answering, request, at)
        tagged = _make_tagged(request, if_none_match, asked.tag(model_key(record), format_))
        content = partial(_make_tables, selected, record, asked, format_)
        stated = partial(_make_error_headers, selected, record, asked)
        return await files.answer(tagged, slots, partial(_make_body, content, stated, str(FORMATS[format_].media_type)))

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
        """Return an image's preview on a grid by its time's calibration: the sky from below, or a map of the ground."""
        asked = _AskedTables(grid=grid, size=size, height_m=height, half_width_m=half_width)
        selected, record = await run_in_threadpool(context.answering, request, time)
        path = await run_in_threadpool(image_file, selected, time)
        tagged = _make_tagged(request, if_none_match, asked.tag(model_key(record), path.stem))
        content = partial(_rectify_picture, selected, record, asked, path)
        stated = partial(_make_error_headers, selected, record, asked)
        return await files.answer(tagged, slots, partial(_make_body, content, stated, "image/png"))

    return routes


def _make_tagged(request: Request, if_none_match: str | None, tag: str) -> Tagged:
    headers = {"etag": tag, "cache-control": "private, no-cache"}
    return Tagged(request=request, headers=headers, if_none_match=if_none_match)


def _make_body(content: Callable[[], bytes], stated: Callable[[], dict[str, str]], media_type: str) -> ResponseBody:
    return ResponseBody(content=content(), media_type=media_type, headers=stated())


def _get_camera(context: ApiContext, record: CalibrationRecord) -> Camera:
    return context.ready.get(record).camera


def _make_tables(context: ApiContext, record: CalibrationRecord, asked: _AskedTables, format_: MapFormat) -> bytes:
    of_ground = {} if asked.grid == "sky" else {"height_m": asked.height_m, "half_width_m": asked.width()}
    attributes = {"calibration": record.id, **of_ground}
    directions = asked.directions(asked.size)
    site = context.archive.calibrations.model(record.id).site
    table = remap_table(
        _get_camera(context, record),
        directions,
        grid=asked.grid,
        attributes=attributes,
        half_width_m=asked.width(),
        place=(site.latitude, site.longitude) if asked.grid == "ground" else None,
    )
    return table_bytes(table, format_)


def _rectify_picture(context: ApiContext, record: CalibrationRecord, asked: _AskedTables, path: Path) -> bytes:
    image, camera = decoded_preview(path), _get_camera(context, record)
    if image.shape[:2] != (camera.height, camera.width):
        problem = (
            f"an image of {image.shape[1]}x{image.shape[0]} px, the calibration is of {camera.width}x{camera.height}"
        )
        raise InputError(field="time", problem=problem, remedy="choose a calibration of that camera, see calibration=")
    found = remapped(image, *remap_tables(camera, asked.directions(asked.size)))
    return bytes(cv2.imencode(".png", found)[1].tobytes())


def _make_error_headers(context: ApiContext, record: CalibrationRecord, asked: _AskedTables) -> dict[str, str]:
    """Return the headers: which calibration, and its error over the grid, on the sky and on the ground."""
    ready = context.ready.get(record)
    directions = asked.directions(_CELLS).reshape(-1, 3)
    directions = np.ascontiguousarray(directions[np.isfinite(directions[:, 0])])
    covariance = ready.direction_covariance(directions)
    headers = {"sunarc-calibration": record.id}
    headers |= _make_rms_header("sunarc-sigma-deg", np.degrees(1.0) ** 2 * 0.5 * np.trace(covariance, axis1=1, axis2=2))
    if asked.grid == "ground":
        site = context.archive.calibrations.model(record.id).site
        place = clouds(directions, height_m=asked.height_m, covariance=covariance, site=site).covariance_m2
        headers["sunarc-height-m"] = decimal(asked.height_m, digits=9)
        headers |= _make_rms_header("sunarc-sigma-m", 0.5 * (place[:, 0, 0] + place[:, 1, 1]))
    return headers


def _make_rms_header(name: str, squares: FloatArray) -> dict[str, str]:
    """Return the header of a root mean square; empty where the camera sees nothing of the grid."""
    finite = squares[np.isfinite(squares)]
    return {name: decimal(math.sqrt(float(np.mean(finite))))} if finite.size else {}
