"""Routes: what the nights were like, and the picture of each with what is named in it."""

from __future__ import annotations

import json
from datetime import date, datetime
from http import HTTPStatus
from pathlib import Path
from typing import Annotated, Any, Literal

from fastapi import APIRouter, Query, Request
from fastapi import Path as InPath
from fastapi.responses import FileResponse, Response
from pydantic import BaseModel, Field

from sunarc.api.context import ApiContext
from sunarc.api.parameters import Cursor, IfNoneMatch, Next, Pair, Since, Size, Unit, Until, page_at, row_limit
from sunarc.api.problems import answers
from sunarc.api.routes.calibrations import matches
from sunarc.archive.values import Event
from sunarc.errors import NotFoundError, OutsideError
from sunarc.json_fields import EXAMPLE_TIME, SolarDate, Time, described
from sunarc.sky.days import day_bounds_unix_s
from sunarc.utc import DAY_S, rfc3339, utc_time


class ZenithBandOut(BaseModel):
    """The stars of a band of zenith angles."""

    from_deg: float = Field(description="Zenith angle, degrees.", examples=[50.0])
    to_deg: float = Field(description="Zenith angle, degrees.", examples=[65.0])
    predicted: int = Field(
        description="Stars to V 4 that the calibration predicts in the images, a count.", examples=[812]
    )
    found: int = Field(description="Of them those that are detected, a count.", examples=[741])
    transparency: float | None = Field(
        description="Share of their light that arrives, of what it is outside the air; with the lens's own shading.",
        examples=[0.74],
    )


class NightImages(BaseModel):
    """Numbers of a night's images, 72 at most, in columns; null where one is not known."""

    time: list[Time] = Field(default=[], description="Middles of the exposures.", examples=[[EXAMPLE_TIME]])
    n_matched: list[int] = Field(default=[], description="Named stars, counts.", examples=[[620]])
    cloud_fraction: list[float | None] = Field(
        default=[], description="Share of the stars to V 4 that are not seen.", examples=[[0.1]]
    )
    limiting_magnitude: list[float | None] = Field(
        default=[], description="V at which half as many are detected as of the bright ones.", examples=[[5.1]]
    )
    star_fwhm_px: list[float | None] = Field(
        default=[], description="Full width at half maximum of bright stars, px.", examples=[[2.4]]
    )
    star_ellipticity: list[float | None] = Field(
        default=[], description="1 - minor / major axis, of bright stars.", examples=[[0.12]]
    )
    halo: list[float | None] = Field(
        default=[], description="Light between 4 and 7 widths around stars, over their own.", examples=[[0.01]]
    )
    zero_point: list[float | None] = Field(
        default=[], description="V of a star outside the air that gives one count a second.", examples=[[10.9]]
    )


class Night(BaseModel):
    """Verdict of a night; what is null is not known: no image of it was matched."""

    night: Annotated[SolarDate, Field(alias="date", description="Local mean solar date of the evening.")]
    verdict: Annotated[
        Literal["clear", "partly", "cloudy", "moonlit", "unusable"],
        described("`moonlit`: no stars were named, and a moon more than half lit was up.", "clear"),
    ]
    n_images: Annotated[int, described("Exposures of the night, a count.", 48)]
    n_accepted: Annotated[int, described("Of them those whose stars were named, a count.", 46)] = 0
    n_stored: Annotated[int, described("Sightings of stars and planets that were stored, a count.", 1380)] = 0
    n_moon_images: Annotated[int, described("Slots with exposures of the moon, a count.", 12)] = 0
    n_moon_stored: Annotated[int, described("Sightings of the moon that were stored, a count.", 12)] = 0
    n_warm_pixels: Annotated[int, described("Warm pixels that were repaired in its images, a count.", 310)] = 0
    star_offset_px: Annotated[
        float | None, described("By how much the stars' centres lie outside of their prediction, at most, px.", 0.1)
    ] = None
    n_stars: Annotated[int, described("Detections in an accepted image, median.", 1730)] = 0
    n_matched: Annotated[int, described("Named stars in an accepted image, median.", 620)] = 0
    limiting_magnitude: Annotated[float | None, described("V to which half of the stars are detected.", 5.5)] = None
    star_fwhm_px: Annotated[float | None, described("Full width of the stars at half maximum, px.", 2.4)] = None
    cloud_fraction: Annotated[
        float | None, described("Share of the stars to V 4 that are not seen; 1 in images without named stars.", 0.1)
    ] = None
    transparency: Annotated[
        float | None,
        described("Share of the light that comes through one air mass, by the stars' brightness over the sky.", 0.83),
    ] = None
    extinction: Annotated[
        float | None, described("Loss of light, magnitudes an air mass, with the shading of the lens.", 0.21)
    ] = None
    extinction_sigma: Annotated[float | None, described("1-sigma of the extinction, magnitudes.", 0.01)] = None
    zero_point: Annotated[
        float | None, described("V of a star outside the air that gives one count a second, median.", 10.9)
    ] = None
    star_ellipticity: Annotated[
        float | None, described("1 - minor / major axis of bright stars, median of the images.", 0.12)
    ] = None
    halo: Annotated[
        float | None, described("Light between 4 and 7 widths around stars over their own, median.", 0.01)
    ] = None
    width_growth: Annotated[
        float | None, described("Width of the stars in the last third of the images over the first.", 1.02)
    ] = None
    halo_growth: Annotated[
        float | None, described("Growth of the halo from the first to the last third of the images.", 0.002)
    ] = None
    fading_mag: Annotated[
        float | None, described("Loss of brightness from the first to the last third, magnitudes.", 0.05)
    ] = None
    picture: Annotated[bool, described("Whether /v1/nights/{night}/image has a picture of it.", True)] = False
    zenith_bands: Annotated[list[ZenithBandOut], described("Stars by zenith angle; empty where none were named.")] = []
    images: Annotated[
        NightImages | None, described("Numbers of its images; null where not asked for, or not known.")
    ] = None
    findings: Annotated[list[dict[str, Any]], described("Why, as codes and data.", [{"code": "night_images"}])]
    decided_at: Annotated[Time, described("When the night was judged, by the frames' time.", EXAMPLE_TIME)]


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
    """What is in the picture of a night: stars to V 3.5, planets, the moon."""

    time: Annotated[Time, Field(description="Middle of the exposure of the picture.")]
    calibration: str | None = Field(
        description="Id of the calibration that predicted them.", examples=["20130514T150508Z"]
    )
    image_size: Size | None = Field(description="Width, height of the camera's image, px.", examples=[[1748, 1748]])
    bodies: list[NightBody] = Field(description="The moon first, then the brightest; empty without a calibration.")


class NightPose(BaseModel):
    """How the camera stands at night against the day, by the sightings of all nights of a calibration."""

    calibration: str = Field(description="Id of the calibration.", examples=["20130514T150508Z"])
    n: int = Field(description="Sightings of nights that it used, a count.", examples=[150])
    pose_difference_deg: Unit = Field(
        description="Turn against the day about east, north and up, degrees.", examples=[[0.004, -0.011, 0.002]]
    )
    pose_sigma_deg: Unit = Field(description="1-sigma of each, degrees.", examples=[[0.002, 0.002, 0.003]])


class Nights(BaseModel):
    """Nights, the newest first; a night that was judged again is listed once, as it was judged last."""

    nights: Annotated[list[Night], described("On this page, the newest first.")]
    pose: Annotated[
        NightPose | None,
        described("By the calibration that is served; null without one, or where it used no sightings of a night."),
    ] = None
    next: Next


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
