"""Routes: the images that are kept: composites as 16 bit PNG, JPEG preview or thumbnail, pictures of other sources."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import datetime, timedelta
from http import HTTPStatus
from pathlib import Path
from typing import Annotated, Literal, get_args

import cv2
import numpy as np
from fastapi import APIRouter, Query, Request
from fastapi import Path as InPath
from fastapi.responses import FileResponse, Response
from numpy.typing import NDArray
from pydantic import BaseModel, Field

from sunarc.common.errors import NotFoundError, OutsideError
from sunarc.common.foreign_files import open_regular, read_regular
from sunarc.common.utc import rfc3339
from sunarc.imager.runtime.json_fields import Time
from sunarc.imager.web.context import ApiContext
from sunarc.imager.web.parameters import AnsweringId, Cursor, IfNoneMatch, Next, Since, Until, page_at, row_limit
from sunarc.imager.web.problems import Fault, RefusedError, answers, described_answer
from sunarc.imager.web.routes.calibrations import decimal, make_etag, matches
from sunarc.imager.web.routes.stored_answers import RANGED, byte_range
from sunarc.imaging.metadata import embedded_document
from sunarc.imaging.preview import decoded

Kind = Literal["png", "jpeg"]


class Composite(BaseModel):
    """One image: a cycle's composite, or a picture of another source."""

    time: Annotated[Time, Field(description="Of its first exposure; names it in /v1/images/{time}.")]
    calibration: AnsweringId
    format: Annotated[Kind, Field(description="`png` of a composite: 16 bit, linear in counts.")]
    bytes: int = Field(description="Size of the file of this format, bytes.", examples=[5_200_000])


class Images(BaseModel):
    """Images, the newest first."""

    images: list[Composite] = Field(description="The page.")
    next: Next


_FILES: dict[Kind, str] = {"png": "hdr.png", "jpeg": "hdr.jpg"}
_MEDIA_TYPES: dict[Kind, str] = {"png": "image/png", "jpeg": "image/jpeg"}
_BEGINNINGS = (b"\xff\xd8\xff", b"\x89PNG\r\n\x1a\n")
"""First bytes of JPEG and PNG."""
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
        """Return the images of the source with since <= time < until, the newest first."""
        selected, page = context.of(request), page_at(cursor, limit)
        found = _list_images(selected, since, page.until(until), page.rows)
        rows, next_ = page.cut(found, request, time=lambda row: row[0])
        return Images(images=[_make_entry(selected, *row) for row in rows], next=next_)

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
        """Return an image: whole, or the range that is asked for."""
        kinds = (format_,) if format_ else ("jpeg",) if width else _parse_accepted_kinds(request.headers.get("accept"))
        selected = context.of(request)
        path = image_file(selected, time, kinds if width is None else ("jpeg", "png"))
        kind = kinds[0] if width else _path_kind(path)
        tag = make_etag(f"{path}-{kind}-{width or 0}".encode(errors="surrogateescape"))
        headers = _make_headers(selected, time, path) | {"etag": tag, "cache-control": _IMMUTABLE}
        if matches(if_none_match, tag):
            return Response(status_code=HTTPStatus.NOT_MODIFIED, headers=headers)
        if width is None and not _is_ours(selected, path):
            return Response(picture_content(path), media_type=_MEDIA_TYPES[kind], headers=headers)
        if width is None:
            if byte_range(request.headers.get("range"), path.stat().st_size) is None:
                request.scope["headers"] = [one for one in request.scope["headers"] if one[0] != b"range"]
            return FileResponse(path, media_type=_MEDIA_TYPES[kind], headers=headers)
        return Response(thumbnail(path, width, kind), media_type=_MEDIA_TYPES[kind], headers=headers)

    return routes


def _list_images(
    context: ApiContext, since: datetime | None, until: datetime | None, limit: int
) -> list[tuple[datetime, Path]]:
    """Return times and files of the images with since <= time < until, the newest first; of a composite its PNG."""
    found = {} if context.pictures is None else dict(context.pictures(since, until, limit))
    if context.images is not None:
        for kind in ("jpeg", "png"):
            found |= dict(context.images.between(kind=_FILES[kind], since=since, until=until, limit=limit))
    return sorted(found.items(), reverse=True)[:limit]


def _path_kind(path: Path) -> Kind:
    return "png" if path.suffix.lower() == ".png" else "jpeg"


def _make_entry(context: ApiContext, time: datetime, path: Path) -> Composite:
    answering = context.record_or_none(time)
    try:
        size = path.stat().st_size
    except OSError:  # removed meanwhile, to make room
        size = 0
    calibration = None if answering is None else answering.id
    return Composite(time=time, calibration=calibration, format=_path_kind(path), bytes=size)


def _parse_accepted_kinds(accept: str | None) -> tuple[Kind, ...]:
    """Return the kinds that a client accepts, PNG first."""
    accepted = [part.partition(";")[0].strip().lower() for part in (accept or "*/*").split(",")]
    kinds = get_args(Kind)
    found = tuple(kind for kind in kinds if any(one in ("*/*", "image/*", _MEDIA_TYPES[kind]) for one in accepted))
    if found:
        return found
    fault = Fault(
        field="accept", problem=f"{accept!r} names no format of images", remedy="accept image/png or image/jpeg"
    )
    raise RefusedError(HTTPStatus.NOT_ACCEPTABLE, fault)


def image_file(context: ApiContext, time: datetime, kinds: Sequence[Kind] = ("jpeg", "png")) -> Path:
    """Return the file of an image of the first kind that there is; its time is known to the millisecond."""
    begin = time.replace(microsecond=time.microsecond // 1000 * 1000)
    end = begin + _RESOLUTION
    if context.images is not None:
        for kind in kinds:
            rows = context.images.between(kind=_FILES[kind], since=begin, until=end, limit=1)
            if rows:
                return rows[0][1]
    for _, path in () if context.pictures is None else context.pictures(begin, end, 1):
        if _path_kind(path) in kinds:
            return path
    wanted = " or ".join(kinds)
    raise NotFoundError(
        field="time", problem=f"no {wanted} of {rfc3339(time)}", remedy="see /v1/images for what is kept"
    )


def decoded_preview(path: Path) -> NDArray[np.uint8]:
    """Return the pixels (rows, columns, 3) of a preview, blue, green, red."""
    try:
        image = decoded(read_regular(path), cv2.IMREAD_COLOR)
    except OSError:
        image = None
    if image is None:
        raise OutsideError(f"the image {path.name} cannot be decoded")
    return np.asarray(image, dtype=np.uint8)


def _make_headers(context: ApiContext, time: datetime, path: Path) -> dict[str, str]:
    answering = context.record_or_none(time)
    headers = {"sunarc-time": rfc3339(time)}
    if answering is not None:
        headers["sunarc-calibration"] = answering.id
    try:
        with open_regular(path) as file:
            document = embedded_document(file.read(_HEAD_BYTES)) or {}
    except OSError as error:
        raise OutsideError(f"the image {path.name} cannot be read: {error.strerror}") from error
    exposures = [one["exposure_us"] for one in document.get("exposures", ())]
    return (
        headers | {"sunarc-exposures-us": ", ".join(decimal(one, digits=9) for one in exposures)}
        if exposures
        else headers
    )


def _is_ours(context: ApiContext, path: Path) -> bool:
    """Return whether a file is the service's own: a name in another's folder may be a link to anywhere."""
    return context.images is not None and path.is_relative_to(context.images.folder)


def picture_content(path: Path) -> bytes:
    """Return the content of a file that another program has written, where it is a picture and nothing else."""
    try:
        content = read_regular(path)
    except OSError as error:
        raise OutsideError(f"the image {path.name} cannot be read: {error.strerror}") from error
    if not content.startswith(_BEGINNINGS):
        raise OutsideError(f"the image {path.name} is no JPEG or PNG any more")
    return content


def shrunk(picture: NDArray[np.uint8], width: int) -> NDArray[np.uint8]:
    """Return a picture (rows, columns, 3) of at most a width in px."""
    height, whole = picture.shape[:2]
    if width >= whole:
        return picture
    size = (width, max(1, round(height * width / whole)))
    return cv2.resize(picture, size, interpolation=cv2.INTER_AREA).astype(np.uint8)


def thumbnail(path: Path, width: int, kind: Kind) -> bytes:
    """Return a preview of at most a width in px, 8 bits, as a file of a kind."""
    picture = shrunk(decoded_preview(path), width)
    quality = [cv2.IMWRITE_JPEG_QUALITY, _QUALITY] if kind == "jpeg" else []
    return bytes(cv2.imencode(f".{kind}", picture, quality)[1].tobytes())
