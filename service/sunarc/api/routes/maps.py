"""Routes: the map of what every pixel sees."""

from __future__ import annotations

import math
from dataclasses import dataclass
from datetime import datetime
from functools import partial
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
from sunarc.api.routes.calibrations import etag_of
from sunarc.api.routes.choice import BY_CALIBRATION
from sunarc.api.routes.stored_answers import RANGED, AnswerFiles, Content, Tagged
from sunarc.api.schemas.parameters import At, IfNoneMatch
from sunarc.archive.values import CalibrationRecord
from sunarc.array_types import BoolArray
from sunarc.calibration.model.maps import BackProjectionMap, back_projection_map
from sunarc.errors import OutsideError
from sunarc.exports.discovery import Variable
from sunarc.exports.formats import MAP_FORMATS, MEDIA_TYPES, MapFormat
from sunarc.exports.tables import map_table, netcdf_bytes, npz_bytes
from sunarc.sky.site import Site
from sunarc.sky.sun import sun_directions

_MAP: dict[int | str, dict[str, Any]] = {
    200: {
        "description": "zenith, azimuth, direction, sigma of every pixel, and masks (docs/rest.md).",
        "headers": {"ETag": {"description": "Changes with the calibration.", "schema": {"type": "string"}}},
        "content": {MEDIA_TYPES[name]: {} for name in MAP_FORMATS},
    },
    **RANGED,
    304: {"description": "The map is the one that If-None-Match names."},
}
Radius = Annotated[
    float | None,
    Query(gt=0.0, le=90.0, description="Adds a mask of a disc round the sun of so many degrees.", examples=[10.0]),
]


def map_routes(context: ApiContext, files: AnswerFiles) -> APIRouter:
    """Return the route that tells what every pixel sees, from a file."""
    routes = APIRouter(tags=["directions"])
    slots = ComputeSlots(1)

    @routes.get(
        "/back-projection-map",
        dependencies=BY_CALIBRATION,
        response_class=Response,
        responses=_MAP | answers(404, 416, 422),
    )
    async def back_projection_map(
        request: Request,
        at: At = None,
        format_: Annotated[MapFormat, Query(alias="format", description="Of the answer.")] = "netcdf",
        sun_radius_deg: Radius = None,
        if_none_match: IfNoneMatch = None,
    ) -> Response:
        """Return every pixel's direction and 1-sigma, now or at the moment `at`, and where the sun then dazzles."""
        selected, record = await run_in_threadpool(context.answering, request, at)
        sun = None if sun_radius_deg is None else (at or selected.frame_clock(), sun_radius_deg)
        site = None if sun is None else await run_in_threadpool(selected.site_at, sun[0])
        requested = _Map(context=selected, record=record, format=format_, sun=sun, site=site)
        tag = await run_in_threadpool(_tag, requested)
        headers = {"etag": tag, "cache-control": "no-cache", "sunarc-calibration": record.id}
        tagged = Tagged(request=request, headers=headers, if_none_match=if_none_match)
        return await files.answer(tagged, slots, partial(_content, requested))

    return routes


@dataclass(frozen=True, slots=True, kw_only=True)
class _Map:
    """A map that is asked for.

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


def _content(requested: _Map) -> Content:
    found = back_projection_map(requested.context.ready.get(requested.record))
    masks = _obstructions(requested.context, requested.record)
    if requested.sun is not None and requested.site is not None:
        masks |= _sun_mask(requested.site, *requested.sun, found)
    table = map_table(found, requested.record.document, masks=masks)
    content = netcdf_bytes(table) if requested.format == "netcdf" else npz_bytes(table)
    return Content(content=content, media_type=MEDIA_TYPES[requested.format])


def _tag(requested: _Map) -> str:
    """Return what changes with a map: its calibration, its masks, and what writes it."""
    context, record = requested.context, requested.record
    path = context.options.obstruction_mask if record.camera == context.camera else None
    changed = path.stat().st_mtime_ns if path is not None and path.exists() else None
    parts = (record.id, sunarc.__version__, requested.format, requested.sun, requested.site, path, changed)
    return etag_of(repr(parts).encode())


def _sun_mask(site: Site, time: datetime, radius_deg: float, found: BackProjectionMap) -> dict[str, Variable]:
    sun = sun_directions(time.timestamp(), site).astype(np.float32)
    near = found.directions @ sun > math.cos(math.radians(radius_deg))
    attributes = {
        "long_name": "1 within a disc round the sun",
        "units": "1",
        "flag_values": np.array([0, 1], dtype=np.uint8),
        "flag_meanings": "away_from_the_sun near_the_sun",
        "radius_deg": radius_deg,
        "time": time.isoformat(),
    }
    return {"sun_mask": Variable(dimensions=("y", "x"), values=near.astype(np.uint8), attributes=attributes)}


def hidden_by_obstructions(context: ApiContext, record: CalibrationRecord) -> BoolArray | None:
    """Return (rows, columns): which pixels `api.obstruction_mask` calls hidden; None where it is not set."""
    path = context.options.obstruction_mask
    if path is None or record.camera != context.camera:
        return None
    image = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
    camera = context.ready.get(record).camera
    if image is None or image.shape != (camera.height, camera.width):
        raise OutsideError(f"api.obstruction_mask {path}: is no image of {camera.width}x{camera.height} pixels")
    return np.asarray(image == 0)


def _obstructions(context: ApiContext, record: CalibrationRecord) -> dict[str, Variable]:
    hidden = hidden_by_obstructions(context, record)
    if hidden is None:
        return {}
    attributes = {
        "long_name": "1 where something hides the sky",
        "units": "1",
        "flag_values": np.array([0, 1], dtype=np.uint8),
        "flag_meanings": "sky obstruction",
    }
    values = hidden.astype(np.uint8)
    return {"obstruction_mask": Variable(dimensions=("y", "x"), values=values, attributes=attributes)}
