"""Routes: what was decided and what happened, and the latest image."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from datetime import timedelta
from typing import Annotated, Any

from fastapi import APIRouter, Query, Request
from fastapi.responses import Response

from sunarc.api.context import ApiContext
from sunarc.api.problems import answers
from sunarc.api.routes.calibrations import matches
from sunarc.api.routes.day_air import air_out
from sunarc.api.routes.images import ThumbnailWidth, thumbnail
from sunarc.api.schemas.paging import Cursor, page_at
from sunarc.api.schemas.parameters import IfNoneMatch, Since, Until, row_limit
from sunarc.api.schemas.record import Days, DayWithAir, Events
from sunarc.archive.values import Day, EventSeverity
from sunarc.errors import NotFoundError, OutsideError
from sunarc.json_fields import SolarDate

_MEDIA_TYPES = {".jpg": "image/jpeg", ".jpeg": "image/jpeg", ".png": "image/png"}
_IMAGE: dict[int | str, dict[str, Any]] = {
    200: {
        "description": "The image.",
        "content": {media_type: {} for media_type in sorted(set(_MEDIA_TYPES.values()))},
    },
    304: {"description": "The image is the one that If-None-Match names."},
}


def record_routes(context: ApiContext) -> APIRouter:
    """Return the routes that tell what was."""
    routes = APIRouter(tags=["record"])

    @routes.get("/days", responses=answers(422))
    def days(
        *,
        request: Request,
        since: Annotated[SolarDate | None, Query(description="From this date on.")] = None,
        until: Annotated[SolarDate | None, Query(description="Before this date.")] = None,
        limit: Annotated[int, row_limit()] = 366,
        cursor: Cursor = None,
    ) -> Days:
        """Tell the verdicts of the solar days with since <= date < until, the newest first."""
        selected, page = context.of(request), page_at(cursor, limit)
        found = selected.archive.days(selected.camera, since=since, until=page.until_date(until), limit=page.rows)
        rows, next_ = page.cut(found, request, time=lambda day: day.date)
        return Days(days=days_out(selected, rows), next=next_)

    @routes.get("/events", responses=answers(422))
    def events(
        *,
        request: Request,
        since: Since = None,
        until: Until = None,
        severity: Annotated[EventSeverity | None, Query(description="Of the events to return.")] = None,
        kind: Annotated[str | None, Query(max_length=60, description="Of the events to return.")] = None,
        limit: Annotated[int, row_limit()] = 100,
        cursor: Cursor = None,
    ) -> Events:
        """Tell the events with since <= time < until, the newest first."""
        selected, page = context.of(request), page_at(cursor, limit)
        found = selected.archive.events(
            selected.camera, since=since, until=page.until(until), severity=severity, kind=kind, limit=page.rows
        )
        rows, next_ = page.cut(found, request, time=lambda event: event.time)
        return Events(events=list(rows), next=next_)

    @routes.get("/image/latest", response_class=Response, responses=_IMAGE | answers(404))
    def latest_image(request: Request, width: ThumbnailWidth = None, if_none_match: IfNoneMatch = None) -> Response:
        """Return the newest composite's preview, or a thumbnail of it."""
        return _image(context.of(request), if_none_match, width)

    return routes


def days_out(context: ApiContext, days: Sequence[Day]) -> list[DayWithAir]:
    """Return days, with their measured air where there is one, as an answer."""
    if not days:
        return []
    dates = [day.date for day in days]
    measured = context.archive.day_air(context.camera, since=min(dates), until=max(dates) + timedelta(days=1))
    air = {one.date: air_out(one) for one in measured}
    return [DayWithAir(**asdict(day) | {"findings": day.findings}, air=air.get(day.date)) for day in days]


def _image(context: ApiContext, if_none_match: str | None, width: int | None) -> Response:
    path = context.latest_image()
    if path is None:
        raise NotFoundError(field="image", problem="no image was kept yet", remedy="wait for the first cycle")
    tag = path.stem if width is None else f"{path.stem}-{width}"
    headers = {"etag": f'"{tag}"', "cache-control": "no-cache"}
    if matches(if_none_match, headers["etag"]):
        return Response(status_code=304, headers=headers)
    try:
        content = path.read_bytes()
    except OSError as error:
        raise OutsideError(f"the image {path.name} cannot be read: {error.strerror}") from error
    if width is not None:
        return Response(thumbnail(path, width, "jpeg"), media_type="image/jpeg", headers=headers)
    return Response(content, media_type=_MEDIA_TYPES[path.suffix], headers=headers)
