"""Routes: what the nights were like, and the picture of each with what is named in it."""

from __future__ import annotations

import json
from datetime import date, datetime
from http import HTTPStatus
from pathlib import Path
from typing import Annotated, Any

from fastapi import APIRouter, Query, Request
from fastapi import Path as InPath
from fastapi.responses import FileResponse, Response

from sunarc.api.context import ApiContext
from sunarc.api.problems import answers
from sunarc.api.routes.calibrations import matches
from sunarc.api.schemas.nights import Night, NightBodies, NightPose, Nights
from sunarc.api.schemas.paging import Cursor, page_at
from sunarc.api.schemas.parameters import IfNoneMatch, Since, Until, row_limit
from sunarc.archive.values import Event
from sunarc.errors import NotFoundError, OutsideError
from sunarc.json_fields import SolarDate
from sunarc.sky.days import day_bounds_unix_s
from sunarc.utc import DAY_S, rfc3339, utc_time

_PICTURE, _NAMES = "night.jpg", "night.json"
"""Kinds of files of the store of images, as the worker of the night writes them."""
_CACHED = "private, max-age=300"
"""A night whose work was interrupted may get another picture; it may hold people, so no shared cache keeps it."""
_IMAGE: dict[int | str, dict[str, Any]] = {
    200: {
        "description": "The picture, 1024 px wide at most.",
        "headers": {"Sunarc-Time": {"description": "Middle of its exposure.", "schema": {"type": "string"}}},
        "content": {"image/jpeg": {}},
    },
    304: {"description": "The picture is the one that If-None-Match names."},
}
Evening = Annotated[SolarDate, InPath(description="Local mean solar date of the evening, as /v1/nights has it.")]


def night_routes(context: ApiContext) -> APIRouter:
    """Return the route that tells the verdicts of the nights."""
    routes = APIRouter(tags=["record"])

    @routes.get("/nights", responses=answers(422), response_model_by_alias=False)
    def nights(
        *,
        request: Request,
        since: Since = None,
        until: Until = None,
        images: Annotated[bool, Query(description="Add the numbers of each image.", examples=[True])] = False,
        limit: Annotated[int, row_limit()] = 366,
        cursor: Cursor = None,
    ) -> Nights:
        """Tell the verdicts of the nights that were judged at since <= time < until, the newest first, each once."""
        selected, page = context.of(request), page_at(cursor, limit)
        found = selected.archive.nights(selected.camera, since=since, until=page.until(until), limit=page.rows)
        rows, next_ = page.cut(found, request, time=lambda event: event.time)
        nights = [_night(event, images=images, picture=_has_picture(selected, event)) for event in rows]
        return Nights(nights=nights, pose=_pose(selected), next=next_)

    @routes.get("/nights/{night}/image", response_class=Response, responses=_IMAGE | answers(404, 422))
    def night_image(request: Request, night: Evening, if_none_match: IfNoneMatch = None) -> Response:
        """Return the picture of a night: its image with the most stars, stretched to 8 bits."""
        time, path = _newest(context.of(request), night, _PICTURE)
        tag = f'"{path.stem}"'
        headers = {"etag": tag, "cache-control": _CACHED, "sunarc-time": rfc3339(time)}
        if matches(if_none_match, tag):
            return Response(status_code=HTTPStatus.NOT_MODIFIED, headers=headers)
        return FileResponse(path, media_type="image/jpeg", headers=headers)

    @routes.get("/nights/{night}/bodies", responses=answers(404, 422))
    def night_bodies(request: Request, night: Evening) -> NightBodies:
        """Tell the bright stars, the planets and the moon in the picture of a night, and which were detected."""
        _, path = _newest(context.of(request), night, _NAMES)
        try:
            return NightBodies.model_validate(json.loads(path.read_text("utf-8")))
        except (OSError, ValueError) as error:
            raise OutsideError(f"{path.name} cannot be read: {error}") from error

    return routes


def _pose(context: ApiContext) -> NightPose | None:
    """Return how the camera stands at night against the day, as the calibration that is served has it."""
    record = context.record_or_none(None)
    night = None if record is None else record.document.get("night")
    return None if record is None or night is None else NightPose.model_validate({**night, "calibration": record.id})


def _has_picture(context: ApiContext, event: Event) -> bool:
    """Return whether the picture of a night is there: where its event says, or else where its time would put it."""
    if context.images is None:
        return False
    time = event.details.get("picture_time")
    try:
        if time is not None:
            return context.images.path(datetime.fromisoformat(str(time)), kind=_PICTURE).is_file()
        night = date.fromisoformat(str(event.details["date"]))
    except ValueError:
        return False
    return bool(_pictures(context, night, _PICTURE))


def _pictures(context: ApiContext, night: date, kind: str) -> list[tuple[datetime, Path]]:
    """Return the newest file of a kind that belongs to a night, with its time: from noon to noon, local mean time."""
    begin = day_bounds_unix_s(night, longitude=context.site.longitude)[0] + 0.5 * DAY_S
    since, until = utc_time(begin), utc_time(begin + DAY_S)
    return [] if context.images is None else context.images.between(kind=kind, since=since, until=until, limit=1)


def _newest(context: ApiContext, night: date, kind: str) -> tuple[datetime, Path]:
    """Return the time and the file of a kind that belongs to a night."""
    found = _pictures(context, night, kind)
    if not found:
        raise NotFoundError(field="night", problem=f"no picture of the night {night}", remedy="see /v1/nights")
    return found[0]


def _night(event: Event, *, images: bool, picture: bool) -> Night:
    """Return the verdict that the event of a night carries."""
    left_out = {} if images else {"images": None}
    return Night.model_validate({**event.details, **left_out, "picture": picture, "decided_at": event.time})
