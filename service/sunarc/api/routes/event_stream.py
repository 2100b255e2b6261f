"""Route: what happens, as server-sent events."""

from __future__ import annotations

import asyncio
import json
import re
from collections.abc import AsyncIterator, Callable, Iterator, Mapping
from typing import Annotated, Any, Literal, NamedTuple

from fastapi import APIRouter, Header, Request
from fastapi.responses import Response, StreamingResponse
from starlette.concurrency import run_in_threadpool

from sunarc.api.context import ApiContext
from sunarc.api.middleware.head_requests import asked_by_head
from sunarc.api.problems import answers
from sunarc.archive.notices import NoticeKind, condition_changes, stored_changes
from sunarc.errors import InputError
from sunarc.runtime.status import StatusSnapshot
from sunarc.utc import rfc3339

Kind = NoticeKind | Literal["state", "worker", "frame"]  # what `event:` says

MEDIA_TYPE = "text/event-stream"
_POLL_S = 0.5
"""Between two looks at archive and status: they cost microseconds where nothing was written."""
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
_STREAM: dict[int | str, dict[str, Any]] = {
    200: {
        "description": "Server-sent events (docs/rest.md), until the client or the service ends the stream.",
        "content": {MEDIA_TYPE: {"schema": {"type": "string"}, "example": _EXAMPLE}},
    }
}


class Message(NamedTuple):
    """One message of the stream."""

    kind: Kind
    data: Mapping[str, Any]
    id: str

    @property
    def text(self) -> str:
        """Return it as the stream has it."""
        data = json.dumps(self.data, separators=(",", ":"))
        return f"event: {self.kind}\nid: {self.id}\ndata: {data}\n\n"


class Position(NamedTuple):
    """Up to where a client has heard: the newest event's number and the current calibration; an empty one is none."""

    event: int
    calibration: str

    @classmethod
    def of(cls, text: str) -> Position:
        """Return the position that an id names; InputError for what is none."""
        found = _ID.fullmatch(text)
        if found is None:
            remedy = "send the id of a message of this stream, or leave it out"
            raise InputError(field="last-event-id", problem=f"{text[:40]!r} is no id", remedy=remedy)
        return cls(int(found[1]), found[2])

    @property
    def text(self) -> str:
        """Return the id that names it."""
        return f"{self.event}.{self.calibration}"


class Follower:
    """What one client has heard, and what is new to it.

    Parameters
    ----------
    context : of the camera that is followed.
    position : up to where it had heard when it was cut off; None for one that begins now.
    """

    def __init__(self, context: ApiContext, position: Position | None) -> None:
        self._context = context
        self._revision = context.archive.revision()
        self._status = context.status()
        known = Position(context.archive.last_event_id(), self._calibration())
        self.position = position or known
        self._behind = position is not None

    def state(self) -> Message:
        """Return how things are now."""
        conditions = list(self._status.conditions.values())
        data = {"health": self._status.health, "calibration": self._calibration() or None, "conditions": conditions}
        return Message("state", data, self.position.text)

    def news(self) -> list[Message]:
        """Return what happened since the last question, the oldest first."""
        revision = self._context.archive.revision()
        stored = list(self._stored()) if revision != self._revision or self._behind else []
        self._revision, self._behind = revision, False
        before, self._status = self._status, self._context.status()
        changed = _changes(before, self._status)
        return [*stored, *(Message(kind, data, self.position.text) for kind, data in changed)]

    def _stored(self) -> Iterator[Message]:
        archive, known = self._context.archive, self.position
        events = archive.events_after(known.event, camera=self._context.camera, limit=_MOST_MISSED)
        changes = stored_changes(events, self._calibration(), after_event=known.event, known=known.calibration)
        for kind, data, event, calibration in changes:
            self.position = Position(event, calibration)
            yield Message(kind, data, self.position.text)

    def _calibration(self) -> str:
        record = self._context.record_or_none(None)
        return "" if record is None else record.id


def _changes(before: StatusSnapshot, now: StatusSnapshot) -> Iterator[tuple[Kind, Mapping[str, Any]]]:
    """Yield what two snapshots of the status differ in."""
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
        """Tell what happens: a state at first, then changes of calibration, conditions, days, workers and frames."""
        headers = {"cache-control": "no-cache", "x-accel-buffering": "no"}
        selected = await run_in_threadpool(context.of, request)
        position = Position.of(last_event_id) if last_event_id else None
        follower = await run_in_threadpool(Follower, selected, position)
        content = _nothing() if asked_by_head(request.scope) else _messages(follower, context.stopping)
        return StreamingResponse(content, media_type=MEDIA_TYPE, headers=headers)

    return routes


async def _nothing() -> AsyncIterator[str]:
    return
    yield


async def _messages(follower: Follower, stopping: Callable[[], bool]) -> AsyncIterator[str]:
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
