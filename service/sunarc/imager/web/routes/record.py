"""Routes: days and their measured air, events with their pictures and their stream, disk space and temperature."""

from __future__ import annotations

import asyncio
import json
import re
from collections.abc import AsyncIterator, Callable, Iterator, Mapping, Sequence
from datetime import timedelta
from typing import Annotated, Any, Literal, NamedTuple

import cv2
import numpy as np
from fastapi import APIRouter, Depends, Header, Path, Query, Request
from fastapi.responses import Response, StreamingResponse
from numpy.typing import NDArray
from pydantic import BaseModel
from starlette.concurrency import run_in_threadpool

from sunarc.common.errors import InputError, NotFoundError
from sunarc.common.utc import MICROSECOND, rfc3339
from sunarc.imager.archive.images import time_in_name
from sunarc.imager.archive.move_pictures import Side
from sunarc.imager.archive.notices import NoticeKind, condition_changes, stored_changes
from sunarc.imager.archive.values import Day, DayAir, Event, EventSeverity, Housekeeping, HousekeepingStep, field_values
from sunarc.imager.runtime.json_fields import SolarDate, described
from sunarc.imager.runtime.status import StatusSnapshot
from sunarc.imager.web.context import ApiContext
from sunarc.imager.web.middleware.admission import require_write_token
from sunarc.imager.web.middleware.boundary import asked_by_head
from sunarc.imager.web.parameters import Cursor, IfNoneMatch, Since, Until, page_at, row_limit
from sunarc.imager.web.problems import answers, described_answer
from sunarc.imager.web.routes.calibrations import matches
from sunarc.imager.web.routes.images import ThumbnailWidth, decoded_preview, picture_content, shrunk, thumbnail
from sunarc.imager.web.schemas import Acknowledgement, DayAirIn, DayAirOut, Days, DayWithAir, Events
from sunarc.optics.camera import Camera
from sunarc.optics.forward import project
from sunarc.sky.directions import direction_from_angles

DayPath = Annotated[SolarDate, Path(description="Local mean solar date.", examples=["2013-05-13"])]


def day_air_routes(context: ApiContext) -> APIRouter:
    """Return the routes that take and answer the measured air of days."""
    routes = APIRouter(prefix="/days/{date}/air", tags=["record"])

    @routes.get("", responses=answers(422))
    def day_air(request: Request, date: DayPath) -> DayAirOut:
        """Return the measured air of a solar day; nulls where nothing was measured."""
        selected = context.of(request)
        stored = selected.archive.days.air(selected.camera, since=date, until=date + timedelta(days=1))
        return air_out(stored[0]) if stored else DayAirOut(temperature_c=None, pressure_hpa=None, set_at=None)

    @routes.put(
        "",
        dependencies=[Depends(require_write_token(context.token))],
        responses=answers(400, 403, 404, 408, 413, 415, 422),
    )
    def set_day_air(request: Request, date: DayPath, air: DayAirIn) -> DayAirOut:
        """Set the measured air of a solar day, replacing the stored one; both null remove it.

        The sun's position on that day is computed with it from now on, and the next refit uses it for the day's
        sightings, except for those that were imported with an air of their own.
        """
        selected = context.of(request)
        given = DayAir(
            camera=selected.camera,
            date=date,
            temperature_c=air.temperature_c,
            pressure_hpa=air.pressure_hpa,
            set_at=selected.frame_clock(),
        )
        return air_out(selected.archive.days.set_air(given))

    return routes


def air_out(air: DayAir) -> DayAirOut:
    """Return a day's measured air in the form of an answer."""
    return DayAirOut(temperature_c=air.temperature_c, pressure_hpa=air.pressure_hpa, set_at=air.set_at)


_MEDIA_TYPES = {".jpg": "image/jpeg", ".jpeg": "image/jpeg", ".png": "image/png"}
_IMAGE = described_answer(
    "The image.",
    sorted(set(_MEDIA_TYPES.values())),
    headers={"Sunarc-Time": "When it was taken, RFC 3339, UTC; absent where not known."},
    same="The image is the one",
)


def record_routes(context: ApiContext) -> APIRouter:
    """Return the routes of days and events."""
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
        """Return the verdicts of the solar days with since <= date < until, the newest first."""
        selected, page = context.of(request), page_at(cursor, limit)
        found = selected.archive.days.find(selected.camera, since=since, until=page.until_date(until), limit=page.rows)
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
        to_acknowledge: Annotated[bool, Query(description="Only those that wait for an operator.")] = False,
        limit: Annotated[int, row_limit()] = 100,
        cursor: Cursor = None,
    ) -> Events:
        """Return the events with since <= time < until, the newest first."""
        selected, page = context.of(request), page_at(cursor, limit)
        found = selected.archive.events.find(
            selected.camera,
            since=since,
            until=page.until(until),
            severity=severity,
            kind=kind,
            to_acknowledge=to_acknowledge,
            limit=page.rows,
        )
        rows, next_ = page.cut(found, request, time=lambda event: event.time)
        return Events(events=list(rows), next=next_)

    @routes.get("/image/latest", response_class=Response, responses=_IMAGE | answers(404))
    def latest_image(request: Request, width: ThumbnailWidth = None, if_none_match: IfNoneMatch = None) -> Response:
        """Return the newest composite's preview, or a thumbnail of it."""
        return _answer_newest_image(context.of(request), if_none_match, width)

    return routes


_QUALITY = 85
_LINE = (30, 90, 255)
"""Colour of the horizon: orange, as blue, green, red."""
_AROUND_DEG = np.arange(0.0, 361.0)
_PICTURE = described_answer(
    "The picture.",
    ["image/jpeg"],
    headers={
        "Sunarc-Time": "Of the picture, RFC 3339, UTC.",
        "Sunarc-Calibration": "Id of the calibration by which the horizon is drawn.",
    },
    same="The picture is the one",
)

EventId = Annotated[
    int, Path(ge=1, le=2**63 - 1, description="Number of an event, as /v1/events has it.", examples=[17])
]


def move_routes(context: ApiContext) -> APIRouter:
    """Return the routes of moves: their acknowledgement and their pictures."""
    routes = APIRouter(tags=["record"])

    @routes.post(
        "/events/{event_id}/acknowledge",
        dependencies=[Depends(require_write_token(context.token))],
        responses=answers(400, 403, 404, 408, 409, 413, 415, 422),
    )
    def acknowledge(request: Request, event_id: EventId, decision: Acknowledgement | None = None) -> Event:
        """Acknowledge a move, or a change of lens or camera, so that it is no longer shown as open."""
        selected = context.of(request)
        reason = (decision or Acknowledgement()).reason
        return selected.archive.events.acknowledge(selected.camera, event_id, at=selected.frame_clock(), reason=reason)

    @routes.get("/events/{event_id}/pictures/{side}", response_class=Response, responses=_PICTURE | answers(404, 422))
    def picture(
        *,
        request: Request,
        event_id: EventId,
        side: Annotated[Side, Path(description="Of the move.")],
        horizon: Annotated[bool, Query(description="Draw the horizon by the calibration of then.")] = False,
        width: ThumbnailWidth = None,
        if_none_match: IfNoneMatch = None,
    ) -> Response:
        """Return the picture before or after a move of the camera."""
        selected = context.of(request)
        event = selected.archive.events.get(selected.camera, event_id)
        path = None if selected.moves is None else selected.moves.path(event, side)
        if selected.moves is None or path is None:
            problem = f"no picture {side} event {event_id} was kept"
            raise NotFoundError(field="side", problem=problem, remedy="see /v1/images for the images that are kept")
        record = None
        if horizon:
            record = selected.record_or_none(event.time - MICROSECOND if side == "before" else event.time)
        calibration = "" if record is None else record.id
        headers = {
            "sunarc-time": rfc3339(selected.moves.time(path)),
            "etag": f'"{path.stem}-{width or 0}-{calibration}"',
            "cache-control": "no-cache",
        }
        if calibration:
            headers["sunarc-calibration"] = calibration
        if matches(if_none_match, headers["etag"]):
            return Response(status_code=304, headers=headers)
        pixels = decoded_preview(path)
        if width is not None:
            pixels = shrunk(pixels, width)
        if record is not None:
            draw_horizon(pixels, selected.archive.calibrations.model(record.id).camera)
        encoded = cv2.imencode(".jpg", pixels, [cv2.IMWRITE_JPEG_QUALITY, _QUALITY])[1]
        return Response(encoded.tobytes(), media_type="image/jpeg", headers=headers)

    return routes


def draw_horizon(pixels: NDArray[np.uint8], camera: Camera) -> None:
    """Draw the line of 90 degrees of apparent zenith angle into a picture (rows, columns, 3) of the camera's image."""
    directions = direction_from_angles(zenith_deg=np.full_like(_AROUND_DEG, 90.0), azimuth_deg=_AROUND_DEG)
    scale = pixels.shape[1] / camera.width
    points = (project(camera, directions) + 0.5) * scale - 0.5
    ends = np.stack([points[:-1], points[1:]], axis=1)  # a part that lies outside the field is left out
    lines = np.round(ends[np.isfinite(ends).all(axis=(1, 2))]).astype(np.int32)
    cv2.polylines(pixels, list(lines), isClosed=False, color=_LINE, thickness=max(1, round(pixels.shape[1] / 500)))


def days_out(context: ApiContext, days: Sequence[Day]) -> list[DayWithAir]:
    """Return days, with their measured air, in the form of an answer."""
    if not days:
        return []
    dates = [day.date for day in days]
    measured = context.archive.days.air(context.camera, since=min(dates), until=max(dates) + timedelta(days=1))
    air = {one.date: air_out(one) for one in measured}
    return [DayWithAir(**field_values(day), air=air.get(day.date)) for day in days]


def _answer_newest_image(context: ApiContext, if_none_match: str | None, width: int | None) -> Response:
    path = context.latest_image()
    if path is None:
        raise NotFoundError(field="image", problem="no image was kept yet", remedy="wait for the first cycle")
    tag = path.stem if width is None else f"{path.stem}-{width}"
    headers = {"etag": f'"{tag}"', "cache-control": "no-cache"}
    taken_at = time_in_name(path) or context.status().last_frame_at
    if taken_at is not None:
        headers["sunarc-time"] = rfc3339(taken_at)
    if matches(if_none_match, headers["etag"]):
        return Response(status_code=304, headers=headers)
    if width is not None:
        return Response(thumbnail(path, width, "jpeg"), media_type="image/jpeg", headers=headers)
    return Response(picture_content(path), media_type=_MEDIA_TYPES[path.suffix], headers=headers)


class HousekeepingRows(BaseModel):
    """Disk space and temperature, the newest first; hours and days without a measurement are left out."""

    step: Annotated[HousekeepingStep, described("Length of each row: an hour, or a UTC day.", "hour")]
    rows: Annotated[list[Housekeeping], described("The newest first.")]


def housekeeping_routes(context: ApiContext) -> APIRouter:
    """Return the route of disk space and temperature."""
    routes = APIRouter(tags=["record"])

    @routes.get("/housekeeping", responses=answers(422))
    def housekeeping(
        *,
        request: Request,
        step: Annotated[
            HousekeepingStep, Query(description="Hours are kept for 92 days, UTC days for five years.")
        ] = "hour",
        since: Since = None,
        until: Until = None,
    ) -> HousekeepingRows:
        """Return free disk space and camera temperature of hours or days that begin at since <= time < until."""
        selected = context.of(request)
        found = selected.archive.housekeeping.find(selected.camera, step=step, since=since, until=until)
        return HousekeepingRows(step=step, rows=list(found))

    return routes


Kind = NoticeKind | Literal["state", "worker", "frame"]  # what `event:` says

MEDIA_TYPE = "text/event-stream"
_POLL_S = 0.5
"""Between two queries of archive and status: they cost microseconds where nothing was written."""
_HEARTBEAT_S = 15.0
"""Between two signs of life where nothing happens: below the idle timeout of proxies (nginx: 60 s)."""
_RETRY_MS = 3000
"""After which a client that was cut off comes back."""
_MOST_MISSED = 500
"""Events that a client hears of that comes back; of more, the newest ones."""
_ID = re.compile(r"(\d{1,15})\.(.*)", re.ASCII)
_EXAMPLE = (
    'event: calibration\\nid: 17.20130514T150508Z-52ee44\\ndata: {"calibration": "20130514T150508Z-52ee44"}\\n\\n'
)
_STREAM = described_answer(
    "Server-sent events (docs/rest.md), until the client or the service ends the stream.",
    {MEDIA_TYPE: {"schema": {"type": "string"}, "example": _EXAMPLE}},
)


class StreamMessage(NamedTuple):
    """One message of the stream."""

    kind: Kind
    data: Mapping[str, Any]
    id: str

    @property
    def text(self) -> str:
        """Return the message as text of the stream."""
        data = json.dumps(self.data, separators=(",", ":"))
        return f"event: {self.kind}\nid: {self.id}\ndata: {data}\n\n"


class Position(NamedTuple):
    """Position of a client in the stream: the newest event's number and the current calibration; empty without them."""

    event: int
    calibration: str

    @classmethod
    def of(cls, text: str) -> Position:
        """Return the position that an id names; InputError for another text."""
        found = _ID.fullmatch(text)
        if found is None:
            remedy = "send the id of a message of this stream, or leave it out"
            raise InputError(field="last-event-id", problem=f"{text[:40]!r} is not an id", remedy=remedy)
        return cls(int(found[1]), found[2])

    @property
    def text(self) -> str:
        """Return the id that names it."""
        return f"{self.event}.{self.calibration}"


class Follower:
    """Position of one client, and the events that are new to it.

    Parameters
    ----------
    context : of the camera that is followed.
    position : up to where it had heard when it was cut off; None for one that begins now.
    """

    def __init__(self, context: ApiContext, position: Position | None) -> None:
        self._context = context
        self._revision = context.archive.revision()
        self._status = context.status()
        known = Position(context.archive.events.last_id(), self._get_calibration_id())
        self.position = position or known
        self._behind = position is not None

    def state(self) -> StreamMessage:
        """Return how things are now."""
        now = self._status
        data = {
            "health": now.health,
            "state": now.state,
            "state_text": now.state_text,
            "calibration": self._get_calibration_id() or None,
            "conditions": list(now.conditions.values()),
        }
        return StreamMessage("state", data, self.position.text)

    def news(self) -> list[StreamMessage]:
        """Return the events since the last question, the oldest first."""
        revision = self._context.archive.revision()
        stored = list(self._read_stored()) if revision != self._revision or self._behind else []
        self._revision, self._behind = revision, False
        before, self._status = self._status, self._context.status()
        changed = _list_status_changes(before, self._status)
        news = [*stored, *(StreamMessage(kind, data, self.position.text) for kind, data in changed)]
        return news if self._status.notes == before.notes else [*news, self.state()]

    def _read_stored(self) -> Iterator[StreamMessage]:
        archive, known = self._context.archive, self.position
        events = archive.events.after(known.event, camera=self._context.camera, limit=_MOST_MISSED)
        changes = stored_changes(events, self._get_calibration_id(), after_event=known.event, known=known.calibration)
        for kind, data, event, calibration in changes:
            self.position = Position(event, calibration)
            yield StreamMessage(kind, data, self.position.text)

    def _get_calibration_id(self) -> str:
        record = self._context.record_or_none(None)
        return "" if record is None else record.id


def _list_status_changes(before: StatusSnapshot, now: StatusSnapshot) -> Iterator[tuple[Kind, Mapping[str, Any]]]:
    """Yield the differences of two snapshots of the status."""
    yield from condition_changes(before.conditions, now.conditions)
    states = {worker.name: worker.state for worker in before.workers}
    for worker in now.workers:
        if states.get(worker.name) != worker.state:
            yield ("worker", {"name": worker.name, "state": worker.state})
    if now.last_frame_at is not None and now.last_frame_at != before.last_frame_at:
        yield ("frame", {"time": rfc3339(now.last_frame_at)})


def event_stream_routes(context: ApiContext) -> APIRouter:
    """Return the route of the stream."""
    routes = APIRouter(tags=["record"])

    @routes.get("/events/stream", response_class=Response, responses=_STREAM | answers(404, 422))
    async def event_stream(
        request: Request,
        last_event_id: Annotated[
            str | None,
            Header(max_length=200, description="Id of the last message received: what came after it is sent."),
        ] = None,
    ) -> Response:
        """Stream the state, then changes of calibration, conditions, days, workers and frames as they happen."""
        headers = {"cache-control": "no-cache", "x-accel-buffering": "no"}
        selected = await run_in_threadpool(context.of, request)
        position = Position.of(last_event_id) if last_event_id else None
        follower = await run_in_threadpool(Follower, selected, position)
        content = _yield_nothing() if asked_by_head(request.scope) else stream_messages(follower, context.stopping)
        return StreamingResponse(content, media_type=MEDIA_TYPE, headers=headers)

    return routes


async def _yield_nothing() -> AsyncIterator[str]:
    return
    yield


async def stream_messages(follower: Follower, stopping: Callable[[], bool]) -> AsyncIterator[str]:
    """Yield the stream's text until the service stops: messages as they come, comments where none comes."""
    yield f"retry: {_RETRY_MS}\n{follower.state().text}"
    silent_s = 0.0
    while not stopping():
        news = await run_in_threadpool(follower.news)
        if news:
            yield "".join(message.text for message in news)
        elif silent_s >= _HEARTBEAT_S:
            yield ":\n\n"
        silent_s = 0.0 if news or silent_s >= _HEARTBEAT_S else silent_s + _POLL_S
        await asyncio.sleep(_POLL_S)
