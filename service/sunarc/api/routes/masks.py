"""Routes: masks of the image as PNG, 255 where they hold: a disc round the sun, and the sky above the horizon."""

from __future__ import annotations

import math
from datetime import datetime
from typing import Annotated, Any

import cv2
import numpy as np
from fastapi import APIRouter, Query, Request
from fastapi.responses import Response
from numpy.typing import NDArray
from starlette.concurrency import run_in_threadpool

import sunarc
from sunarc.api.compute_slots import ComputeSlots
from sunarc.api.context import ApiContext
from sunarc.api.problems import answers
from sunarc.api.routes.calibrations import etag_of
from sunarc.api.routes.choice import BY_CALIBRATION
from sunarc.api.routes.maps import hidden_by_obstructions
from sunarc.api.routes.stored_answers import RANGED, AnswerFiles, Content, Tagged
from sunarc.api.schemas.parameters import At, IfNoneMatch
from sunarc.archive.values import CalibrationRecord
from sunarc.array_types import BoolArray, FloatArray
from sunarc.sky.sun import sun_directions

_MASK: dict[int | str, dict[str, Any]] = {
    200: {
        "description": "PNG of 8 bits of the image's size: 255 where the mask holds, else 0.",
        "headers": {
            "Sunarc-Calibration": {"description": "Id of the calibration.", "schema": {"type": "string"}},
            "ETag": {"description": "Changes with the mask.", "schema": {"type": "string"}},
        },
        "content": {"image/png": {}},
    },
    **RANGED,
    304: {"description": "The mask is the one that If-None-Match names."},
}
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
            site = await run_in_threadpool(selected.site_at, time)
            axis = np.asarray(sun_directions(time.timestamp(), site))
        hidden = await run_in_threadpool(hidden_by_obstructions, selected, record) if name == "horizon" else None
        key = repr(
            (name, record.id, sunarc.__version__, limit, axis.tolist(), None if hidden is None else hidden.tobytes())
        )
        tag, headers = etag_of(key.encode()), {"sunarc-calibration": record.id, "cache-control": "no-cache"}
        asked = Tagged(request=request, headers=headers | {"etag": tag}, if_none_match=if_none_match)

        def made() -> Content:
            return Content(content=_mask(selected, record, axis, limit, hidden), media_type="image/png")

        return await files.answer(asked, slots, made)

    @routes.get(
        "/masks/sun", dependencies=BY_CALIBRATION, response_class=Response, responses=_MASK | answers(404, 416, 422)
    )
    async def sun_mask(
        request: Request, at: At = None, radius_deg: _RADIUS = 10.0, if_none_match: IfNoneMatch = None
    ) -> Response:
        """Return where the image looks within a radius of the sun, now or at the moment `at`."""
        return await sent(request, at, if_none_match, name="sun", limit=math.cos(math.radians(radius_deg)))

    @routes.get(
        "/masks/horizon", dependencies=BY_CALIBRATION, response_class=Response, responses=_MASK | answers(404, 416, 422)
    )
    async def horizon_mask(
        request: Request, at: At = None, elevation_deg: _ELEVATION = 0.0, if_none_match: IfNoneMatch = None
    ) -> Response:
        """Return where the image shows the sky above an elevation, and no obstruction of `api.obstruction_mask`."""
        return await sent(request, at, if_none_match, name="horizon", limit=math.sin(math.radians(elevation_deg)))

    return routes


def _mask(
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
