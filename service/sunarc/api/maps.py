"""Routes: the map of what every pixel sees, made once for each calibration."""

from __future__ import annotations

import hashlib
import math
import os
import tempfile
import weakref
from collections.abc import Callable, Mapping
from contextlib import ExitStack
from datetime import datetime
from functools import partial
from typing import Annotated, Any

import cv2
import numpy as np
from fastapi import APIRouter, Header, Query, Request
from fastapi.responses import Response
from starlette.concurrency import run_in_threadpool

import sunarc
from sunarc.api.arrays import Gate, PartsResponse
from sunarc.api.calibrations import matches
from sunarc.api.fields import Time
from sunarc.api.problems import answers
from sunarc.api.served import Kept, Served
from sunarc.archive import CalibrationRecord
from sunarc.calibration import BackProjectionMap, back_projection_map
from sunarc.errors import OutsideError
from sunarc.exports import MAP_FORMATS, MEDIA_TYPES, MapFormat, Variable, map_table, netcdf_bytes, npz_bytes
from sunarc.sky import sun_directions

_MOST_FILES = 2
_PART_BYTES = 4_000_000
_MAP: dict[int | str, dict[str, Any]] = {
    200: {
        "description": "zenith, azimuth, direction, sigma of every pixel, and masks (docs/rest.md).",
        "headers": {"ETag": {"description": "Changes with the calibration.", "schema": {"type": "string"}}},
        "content": {MEDIA_TYPES[name]: {} for name in MAP_FORMATS},
    },
    304: {"description": "The map is the one that If-None-Match names."},
}
Radius = Annotated[
    float | None,
    Query(gt=0.0, le=90.0, description="Adds a mask of a disc round the sun of so many degrees.", examples=[10.0]),
]


def map_routes(served: Served, gate: Gate) -> APIRouter:
    """Return the route that tells what every pixel sees."""
    routes = APIRouter(tags=["directions"])
    kept = {name: Kept(partial(_file, served, name), most=_MOST_FILES) for name in MAP_FORMATS}

    @routes.get("/back-projection-map", response_class=Response, responses=_MAP | answers(404, 422))
    async def back_projection_map(
        request: Request,
        at: Time | None = None,
        wanted: Annotated[MapFormat, Query(alias="format", description="Of the answer.")] = "netcdf",
        sun_radius_deg: Radius = None,
        if_none_match: Annotated[str | None, Header()] = None,
    ) -> Response:
        """Return every pixel's direction and 1-sigma, now or at the moment `at`, and where the sun then dazzles."""
        chosen, record = await run_in_threadpool(_chosen, served, request, at)
        moment = at or chosen.frame_clock()
        tag = _tag(chosen, record, wanted, None if sun_radius_deg is None else (moment, sun_radius_deg))
        headers = {"etag": tag, "cache-control": "no-cache", "sunarc-calibration": record.id}
        if matches(if_none_match, tag):
            return Response(status_code=304, headers=headers)
        with ExitStack() as stack:
            stack.enter_context(gate.entered())
            if sun_radius_deg is None:
                file = await run_in_threadpool(kept[wanted].get, record)
            else:
                mask = partial(_sun_mask, chosen, moment, sun_radius_deg)
                file = await run_in_threadpool(_file, chosen, wanted, record, mask)
            return file.sent(MEDIA_TYPES[wanted], headers, stack.pop_all())

    return routes


def _chosen(served: Served, request: Request, at: datetime | None) -> tuple[Served, CalibrationRecord]:
    chosen = served.of(request)
    return chosen, chosen.record(at)


class _MapFile:
    """A map in a file that has no name and goes when nobody reads it any more.

    Parameters
    ----------
    content : its bytes.
    """

    def __init__(self, content: bytes) -> None:
        with tempfile.TemporaryFile() as file:
            file.write(content)
            file.flush()
            self._descriptor = os.dup(file.fileno())
        weakref.finalize(self, os.close, self._descriptor)
        self._size = len(content)

    def sent(self, media_type: str, headers: dict[str, str], held: ExitStack) -> PartsResponse:
        """Return the answer that sends it."""
        parts = [partial(self._part, begin) for begin in range(0, self._size, _PART_BYTES)]
        return PartsResponse(parts, length=self._size, media_type=media_type, headers=headers, held=held)

    def _part(self, begin: int) -> bytes:
        return os.pread(self._descriptor, min(_PART_BYTES, self._size - begin), begin)


def _file(
    served: Served,
    wanted: MapFormat,
    record: CalibrationRecord,
    mask: Callable[[BackProjectionMap], Mapping[str, Variable]] | None = None,
) -> _MapFile:
    found = back_projection_map(served.ready.get(record))
    masks = dict(_obstructions(served, record, found)) | (dict(mask(found)) if mask else {})
    table = map_table(found, record.document, masks=masks)
    return _MapFile(netcdf_bytes(table) if wanted == "netcdf" else npz_bytes(table))


def _tag(served: Served, record: CalibrationRecord, wanted: MapFormat, sun: tuple[datetime, float] | None) -> str:
    path = served.options.obstruction_mask if record.camera == served.camera else None
    changed = path.stat().st_mtime_ns if path is not None and path.exists() else None
    parts = (record.id, sunarc.__version__, wanted, sun, path, changed)
    return f'"{hashlib.sha256(repr(parts).encode()).hexdigest()[:32]}"'


def _sun_mask(served: Served, moment: datetime, radius_deg: float, found: BackProjectionMap) -> dict[str, Variable]:
    sun = sun_directions(moment.timestamp(), served.site).astype(np.float32)
    near = found.directions @ sun > math.cos(math.radians(radius_deg))
    attributes = {
        "long_name": "1 within a disc round the sun",
        "units": "1",
        "flag_values": np.array([0, 1], dtype=np.uint8),
        "flag_meanings": "away_from_the_sun near_the_sun",
        "radius_deg": radius_deg,
        "time": moment.isoformat(),
    }
    return {"sun_mask": Variable(dimensions=("y", "x"), values=near.astype(np.uint8), attributes=attributes)}


def _obstructions(served: Served, record: CalibrationRecord, found: BackProjectionMap) -> dict[str, Variable]:
    path = served.options.obstruction_mask
    if path is None or record.camera != served.camera:
        return {}
    image = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
    height, width = found.inside.shape
    if image is None or image.shape != (height, width):
        raise OutsideError(f"api.obstruction_mask {path}: is no image of {width}x{height} pixels")
    attributes = {
        "long_name": "1 where something hides the sky",
        "units": "1",
        "flag_values": np.array([0, 1], dtype=np.uint8),
        "flag_meanings": "sky obstruction",
    }
    hidden = (image == 0).astype(np.uint8)
    return {"obstruction_mask": Variable(dimensions=("y", "x"), values=hidden, attributes=attributes)}
