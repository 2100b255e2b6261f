"""Routes: verdicts of the nights, and the picture of each with the names of its stars."""

from __future__ import annotations

import json
from dataclasses import dataclass, fields
from datetime import date, datetime
from http import HTTPStatus
from pathlib import Path
from typing import Annotated

from fastapi import APIRouter, Query, Request
from fastapi import Path as InPath
from fastapi.responses import FileResponse, Response
from pydantic import BaseModel, Field

from sunarc.common.errors import NotFoundError, OutsideError
from sunarc.common.utc import DAY_S, rfc3339, utc_time
from sunarc.imager.archive.values import Night
from sunarc.imager.runtime.json_fields import SolarDate, Time, described
from sunarc.imager.web.context import ApiContext
from sunarc.imager.web.parameters import Cursor, IfNoneMatch, Next, Pair, Since, Size, Unit, Until, page_at, row_limit
from sunarc.imager.web.problems import answers, described_answer
from sunarc.imager.web.routes.calibrations import matches
from sunarc.sky.days import day_bounds_unix_s


@dataclass(frozen=True, slots=True, kw_only=True)
class NightWithPicture(Night):
    """Verdict of a night; null is not known: no image of it was matched."""

    picture: Annotated[bool, described("Whether /v1/nights/{night}/image has a picture of it.", True)]


class NightBody(BaseModel):
    """A star, a planet or the moon in the picture of a night."""

    body: str = Field(description="As in the sightings.", examples=["star:HIP32349"])
    title: str = Field(description="What a person calls it.", examples=["Sirius"])
    pixel: Pair = Field(description="Where it is predicted, x, y in px of the camera.", examples=[[400.0, 912.5]])
    magnitude: float = Field(description="V, of stars and planets with the air's extinction.", examples=[-1.4])
    found: bool | None = Field(
        description="Whether it was detected; null where no star of the picture was named, and of the moon.",
        examples=[True],
    )
    lit: float | None = Field(default=None, description="Of the moon, the share that is lit.", examples=[0.4])


class NightBodies(BaseModel):
    """Bodies in the picture of a night: stars to V 3.5, planets, the moon."""

    time: Annotated[Time, Field(description="Middle of the exposure of the picture.")]
    calibration: str | None = Field(
        description="Id of the calibration that predicted them.", examples=["20130514T150508Z"]
    )
    image_size: Size | None = Field(description="Width, height of the camera's image, px.", examples=[[1748, 1748]])
    bodies: list[NightBody] = Field(description="The moon first, then the brightest; empty without a calibration.")


class NightPose(BaseModel):
    """Pose of the camera at night against the day, by the sightings of all nights of a calibration."""

    calibration: str = Field(description="Id of the calibration.", examples=["20130514T150508Z"])
    n: int = Field(description="Sightings of nights that it used, a count.", examples=[150])
    pose_difference_deg: Unit = Field(
        description="Turn against the day about east, north and up, degrees.", examples=[[0.004, -0.011, 0.002]]
    )
    pose_sigma_deg: Unit = Field(description="1-sigma of each, degrees.", examples=[[0.002, 0.002, 0.003]])


class Nights(BaseModel):
    """Nights, the newest first; a night that was judged again is listed once, as it was judged last."""

    nights: Annotated[list[NightWithPicture], described("On this page, the newest first.")]
    pose: Annotated[
        NightPose | None,
        described("By the calibration that is served; null without one, or where it used no sightings of a night."),
    ] = None
    next: Next


_PICTURE, _NAMES = "night.jpg", "night.json"
"""Kinds of files of the store of images, as the worker of the night writes them."""
_CACHED = "private, max-age=300"
"""A night whose work was interrupted may get another picture; it may hold people, so no shared cache keeps it."""
_IMAGE = described_answer(
    "The picture, 1024 px wide at most.",
    ["image/jpeg"],
    headers={"Sunarc-Time": "Middle of its exposure."},
    same="The picture is the one",
)
Evening = Annotated[SolarDate, InPath(description="Local mean solar date of the evening, as /v1/nights has it.")]


def night_routes(context: ApiContext) -> APIRouter:
    """Return the routes of the nights."""
    routes = APIRouter(tags=["record"])

    @routes.get("/nights", responses=answers(422))
    def nights(
        *,
        request: Request,
        since: Since = None,
        until: Until = None,
        images: Annotated[bool, Query(description="Add the numbers of each image.", examples=[True])] = False,
        limit: Annotated[int, row_limit()] = 366,
        cursor: Cursor = None,
    ) -> Nights:
        """Return the verdicts of the nights evaluated at since <= time < until, the newest first, each once."""
        selected, page = context.of(request), page_at(cursor, limit)
        found = selected.archive.nights.find(selected.camera, since=since, until=page.until(until), limit=page.rows)
        rows, next_ = page.cut(found, request, time=lambda night: night.decided_at)
        nights = [_describe_night(night, images=images, picture=_has_picture(selected, night)) for night in rows]
        return Nights(nights=nights, pose=_make_night_pose(selected), next=next_)

    @routes.get("/nights/{night}/image", response_class=Response, responses=_IMAGE | answers(404, 422))
    def night_image(request: Request, night: Evening, if_none_match: IfNoneMatch = None) -> Response:
        """Return the picture of a night: its image with the most stars, stretched to 8 bits."""
        time, path = _require_newest_picture(context.of(request), night, _PICTURE)
        tag = f'"{path.stem}"'
        headers = {"etag": tag, "cache-control": _CACHED, "sunarc-time": rfc3339(time)}
        if matches(if_none_match, tag):
            return Response(status_code=HTTPStatus.NOT_MODIFIED, headers=headers)
        return FileResponse(path, media_type="image/jpeg", headers=headers)

    @routes.get("/nights/{night}/bodies", responses=answers(404, 422))
    def night_bodies(request: Request, night: Evening) -> NightBodies:
        """Return the bright stars, the planets and the moon in the picture of a night, and which were detected."""
        _, path = _require_newest_picture(context.of(request), night, _NAMES)
        try:
            return NightBodies.model_validate(json.loads(path.read_text("utf-8")))
        except (OSError, ValueError) as error:
            raise OutsideError(f"{path.name} cannot be read: {error}") from error

    return routes


def _make_night_pose(context: ApiContext) -> NightPose | None:
    """Return the pose of the camera at night against the day, by the calibration that is served."""
    record = context.record_or_none(None)
    night = None if record is None else record.document.get("night")
    return None if record is None or night is None else NightPose.model_validate({**night, "calibration": record.id})


def _has_picture(context: ApiContext, night: Night) -> bool:
    """Return whether the picture of a night is there: where its row says, or else where its time would put it."""
    if context.images is None:
        return False
    if night.picture_time is not None:
        return context.images.path(night.picture_time, kind=_PICTURE).is_file()
    return bool(_list_pictures(context, night.date, _PICTURE))


def _list_pictures(context: ApiContext, night: date, kind: str) -> list[tuple[datetime, Path]]:
    """Return the newest file of a kind that belongs to a night, with its time: from noon to noon, local mean time."""
    begin = day_bounds_unix_s(night, longitude=context.site.longitude)[0] + 0.5 * DAY_S
    since, until = utc_time(begin), utc_time(begin + DAY_S)
    return [] if context.images is None else context.images.between(kind=kind, since=since, until=until, limit=1)


def _require_newest_picture(context: ApiContext, night: date, kind: str) -> tuple[datetime, Path]:
    """Return the time and the file of a kind that belongs to a night."""
    found = _list_pictures(context, night, kind)
    if not found:
        raise NotFoundError(field="night", problem=f"no picture of the night {night}", remedy="see /v1/nights")
    return found[0]


def _describe_night(night: Night, *, images: bool, picture: bool) -> NightWithPicture:
    values = {one.name: getattr(night, one.name) for one in fields(night)}
    return NightWithPicture(**values if images else values | {"images": None}, picture=picture)
