"""Routes: the composites that are kept, as 16 bit PNG, JPEG preview or thumbnail."""

from __future__ import annotations

from datetime import datetime, timedelta
from http import HTTPStatus
from pathlib import Path
from typing import Annotated, Literal

import cv2
import numpy as np
from fastapi import APIRouter, Query, Request
from fastapi import Path as InPath
from fastapi.responses import FileResponse, Response
from numpy.typing import NDArray
from pydantic import BaseModel, Field

from sunarc.common.errors import NotFoundError, OutsideError
from sunarc.common.foreign_files import read_regular
from sunarc.common.utc import rfc3339
from sunarc.imager.runtime.json_fields import Time
from sunarc.imager.web.context import ApiContext
from sunarc.imager.web.parameters import AnsweringId, Cursor, IfNoneMatch, Next, Since, Until, page_at, row_limit
from sunarc.imager.web.problems import Fault, RefusedError, answers, described_answer
from sunarc.imager.web.routes.calibrations import decimal, matches
from sunarc.imager.web.routes.stored_answers import RANGED, byte_range
from sunarc.imaging.metadata import document_of
from sunarc.imaging.preview import decoded


class Composite(BaseModel):
    """One cycle's composite."""

    time: Annotated[Time, Field(description="Of its first exposure; names it in /v1/images/{time}.")]
    calibration: AnsweringId
    bytes: int = Field(description="Size of the 16 bit PNG, bytes.", examples=[5_200_000])


class Images(BaseModel):
    """Composites, the newest first."""

    images: list[Composite] = Field(description="The page.")
    next: Next


Kind = Literal["png", "jpeg"]

_FILES: dict[Kind, str] = {"png": "hdr.png", "jpeg": "hdr.jpg"}
_MEDIA_TYPES: dict[Kind, str] = {"png": "image/png", "jpeg": "image/jpeg"}
_IMMUTABLE = "private, max-age=31536000, immutable"
"""An image never changes under its time; it may hold people, so no shared cache keeps it."""
_WIDTHS = (16, 4096)
_QUALITY = 85
_RESOLUTION = timedelta(milliseconds=1)
_HEAD_BYTES = 65_536
"""Where the metadata stand: before the image data."""
_IMAGE = RANGED | described_answer(
    "The image.",
    sorted(_MEDIA_TYPES.values()),
    headers={
        "Sunarc-Time": "Of its first exposure, RFC 3339, UTC.",
        "Sunarc-Calibration": "Id of what answers at that time.",
        "Sunarc-Exposures-Us": "Exposures it was made of, µs.",
    },
    same="The image is the one",
)
ThumbnailWidth = Annotated[
    int | None, Query(ge=_WIDTHS[0], le=_WIDTHS[1], description="Of a thumbnail, px; never enlarged.")
]
Captured = Annotated[Time, InPath(description="Of its first exposure, as /v1/images lists it.")]


def image_routes(context: ApiContext) -> APIRouter:
    """Return the routes of the composites."""
    routes = APIRouter(tags=["images"])

    @routes.get("/images", responses=answers(422))
    def images(
        *,
        request: Request,
        since: Since = None,
        until: Until = None,
        limit: Annotated[int, row_limit(1000)] = 100,
        cursor: Cursor = None,
    ) -> Images:
        """Return the composites with since <= time < until, the newest first."""
        selected, page = context.of(request), page_at(cursor, limit)
        found: list[tuple[datetime, Path]] = []
        if selected.images is not None:
            found = selected.images.between(kind=_FILES["png"], since=since, until=page.until(until), limit=page.rows)
        rows, next_ = page.cut(found, request, time=lambda row: row[0])
        return Images(images=[_composite(selected, *row) for row in rows], next=next_)

    @routes.get("/images/{time}", response_class=Response, responses=_IMAGE | answers(404, 406, 416, 422))
    def image(
        *,
        request: Request,
        time: Captured,
        format_: Annotated[
            Kind | None, Query(alias="format", description="16 bit PNG of linear counts, or JPEG preview.")
        ] = None,
        width: ThumbnailWidth = None,
        if_none_match: IfNoneMatch = None,
    ) -> Response:
        """Return a composite: whole, or the range that is asked for."""
        kind = format_ or ("jpeg" if width else _accepted(request.headers.get("accept")))
        selected = context.of(request)
        path = composite_file(selected, time, kind if width is None else "jpeg")
        tag = f'"{path.stem}-{kind}-{width or 0}"'
        headers = _headers(selected, time, path) | {"etag": tag, "cache-control": _IMMUTABLE}
        if matches(if_none_match, tag):
            return Response(status_code=HTTPStatus.NOT_MODIFIED, headers=headers)
        if width is None:
            if byte_range(request.headers.get("range"), path.stat().st_size) is None:
                request.scope["headers"] = [one for one in request.scope["headers"] if one[0] != b"range"]
            return FileResponse(path, media_type=_MEDIA_TYPES[kind], headers=headers)
        return Response(thumbnail(path, width, kind), media_type=_MEDIA_TYPES[kind], headers=headers)

    return routes


def _composite(context: ApiContext, time: datetime, path: Path) -> Composite:
    answering = context.record_or_none(time)
    try:
        size = path.stat().st_size
    except OSError:  # removed meanwhile, to make room
        size = 0
    return Composite(time=time, calibration=None if answering is None else answering.id, bytes=size)


def _accepted(accept: str | None) -> Kind:
    """Return the kind that a client accepts, PNG first."""
    accepted = [part.partition(";")[0].strip().lower() for part in (accept or "*/*").split(",")]
    for kind in ("png", "jpeg"):
        if any(one in ("*/*", "image/*", _MEDIA_TYPES[kind]) for one in accepted):
            return kind
    fault = Fault(
        field="accept", problem=f"{accept!r} names no format of images", remedy="accept image/png or image/jpeg"
    )
    raise RefusedError(HTTPStatus.NOT_ACCEPTABLE, fault)


def composite_file(context: ApiContext, time: datetime, kind: Kind) -> Path:
    """Return the file of a composite, whose name has the time to the millisecond."""
    if context.images is not None:
        begin = time.replace(microsecond=time.microsecond // 1000 * 1000)
        rows = context.images.between(kind=_FILES[kind], since=begin, until=begin + _RESOLUTION, limit=1)
        if rows:
            return rows[0][1]
    raise NotFoundError(field="time", problem=f"no {kind} of {rfc3339(time)}", remedy="see /v1/images for what is kept")


def decoded_preview(path: Path) -> NDArray[np.uint8]:
    """Return the pixels (rows, columns, 3) of a preview, blue, green, red."""
    try:
        image = decoded(read_regular(path), cv2.IMREAD_COLOR)
    except OSError:
        image = None
    if image is None:
        raise OutsideError(f"the image {path.name} cannot be decoded")
    return np.asarray(image, dtype=np.uint8)


def _headers(context: ApiContext, time: datetime, path: Path) -> dict[str, str]:
    answering = context.record_or_none(time)
    headers = {"sunarc-time": rfc3339(time)}
    if answering is not None:
        headers["sunarc-calibration"] = answering.id
    try:
        with path.open("rb") as file:
            document = document_of(file.read(_HEAD_BYTES)) or {}
    except OSError as error:
        raise OutsideError(f"the image {path.name} cannot be read: {error.strerror}") from error
    exposures = [one["exposure_us"] for one in document.get("exposures", ())]
    return (
        headers | {"sunarc-exposures-us": ", ".join(decimal(one, digits=9) for one in exposures)}
        if exposures
        else headers
    )


def thumbnail(path: Path, width: int, kind: Kind) -> bytes:
    """Return a preview of at most a width in px, 8 bits, as a file of a kind."""
    picture = decoded_preview(path)
    height, whole = picture.shape[:2]
    if width < whole:
        size = (width, max(1, round(height * width / whole)))
        picture = cv2.resize(picture, size, interpolation=cv2.INTER_AREA).astype(np.uint8)
    quality = [cv2.IMWRITE_JPEG_QUALITY, _QUALITY] if kind == "jpeg" else []
    return bytes(cv2.imencode(f".{kind}", picture, quality)[1].tobytes())
