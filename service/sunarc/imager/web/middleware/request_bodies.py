"""Room that requests take: bodies (size, rate, memory), and how many requests are answered at the same time."""

from __future__ import annotations

import asyncio
import re
from dataclasses import dataclass
from functools import partial
from http import HTTPStatus

from starlette.types import Message, Receive, Scope, Send

from sunarc.imager.web.middleware.admission import is_always_answered, too_many
from sunarc.imager.web.middleware.http_only import HttpMiddleware
from sunarc.imager.web.middleware.shared_quota import QuotaUse, SharedQuota, answer_held, client_network
from sunarc.imager.web.options import MIN_RATE_BYTES_PER_S
from sunarc.imager.web.problems import Fault, RefusedError, UnreadError, refusal_response

_WITHOUT_BODY = frozenset({"GET", "HEAD", "OPTIONS"})
_WITH_ROWS = re.compile(r"/v1(?:/cameras/[^/]+)?/(?:back-project|feed|geolocate|project)")
_STREAM = "/events/stream"
"""The end of the path of a stream of events."""
_MOST_WITHOUT_ROWS = 16_384
"""Bytes of any other body, which the web framework reads on the event loop: a few numbers, a reason."""


@dataclass(kw_only=True, eq=False)
class Occupancy(HttpMiddleware):
    """Limits of requests in progress: the memory of their bodies, and the number that is answered at the same time.

    A body is read before its request is counted and handed on: nothing else is occupied by one that does not come.
    Where there is no room a request is refused (429 for memory, 503), or an address that holds more than others loses
    its oldest request. Streams of events, which have no end, are counted apart.

    Parameters
    ----------
    max_body_bytes, max_array_bytes : a larger body of rows, or one of .npy, is refused (413).
    within_s : a body that is not there after so many seconds, and of which in so many seconds hardly any more came, is
        refused (408).
    quota : bounds the memory of all bodies.
    at_once : requests that are answered at the same time.
    streams : streams of events that are open at the same time.
    """

    max_body_bytes: int
    max_array_bytes: int
    within_s: float
    quota: SharedQuota
    at_once: int
    streams: int = 64

    def __post_init__(self) -> None:
        """Begin without a request."""
        self._under_way = SharedQuota(self.at_once)
        self._streams = SharedQuota(self.streams)

    async def answer(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass a request on when its body is complete, or refuse it; end it when others claim its room."""
        if is_always_answered(scope):
            await self.app(scope, receive, send)
            return
        counted = self._streams if scope["path"].endswith(_STREAM) else self._under_way
        client = client_network(scope)
        with self.quota.open(client) as use, counted.open(client) as place:
            answer = partial(self._pass, scope, receive, use, place)
            await answer_held((use, place), answer, scope=scope, receive=receive, send=send)

    async def _pass(self, scope: Scope, receive: Receive, use: QuotaUse, place: QuotaUse, send: Send) -> None:
        if scope["method"] not in _WITHOUT_BODY:
            try:
                body = await self._read(receive, use, most_bytes(scope, self.max_body_bytes, self.max_array_bytes))
            except UnreadError as error:
                await error.response(scope["path"])(scope, receive, send)
                return
            except RefusedError as error:
                await refusal_response(scope["path"], error)(scope, receive, send)
                return
            if body is None:
                return
            scope["state"] = {**scope.get("state", {}), "use": use, "body": body}
            receive = _replay_body(body, receive)
        try:
            place.grow(1)
        except RefusedError:
            refusal = too_many("too many requests at once", scope, HTTPStatus.SERVICE_UNAVAILABLE)
            await refusal(scope, receive, send)
        else:
            await self.app(scope, receive, send)

    async def _read(self, receive: Receive, use: QuotaUse, most: int) -> bytes | None:
        """Return the body; None where the client went away."""
        parts: list[bytes] = []
        read, progress = 0, _Progress(self.within_s)
        while True:
            try:
                async with asyncio.timeout_at(progress.end_s):
                    message = await receive()
            except TimeoutError:
                # Two deadlines end in the same error: this one is another client's claim to the memory.
                if use.ended:
                    raise
                problem = f"too little of it came within {self.within_s:g} s"
                raise _refuse(HTTPStatus.REQUEST_TIMEOUT, problem) from None
            if message["type"] != "http.request":
                return None
            part = message.get("body", b"")
            read += len(part)
            if read > most:
                raise too_large(most)
            use.grow(len(part))
            parts.append(part)
            if not message.get("more_body", False):
                return b"".join(parts)
            progress.received(len(part))


class _Progress:
    """Progress of a body: in each stretch of `within_s`, so many bytes as the lowest rate makes.

    Attributes
    ----------
    end_s : when the present stretch ends, by the event loop's time.
    """

    def __init__(self, within_s: float) -> None:
        self._within_s = within_s
        self._n_received = 0
        self.end_s = asyncio.get_running_loop().time() + within_s

    def received(self, count: int) -> None:
        """Count bytes; a stretch with enough of them begins anew."""
        self._n_received += count
        if self._n_received >= self._within_s * MIN_RATE_BYTES_PER_S:
            self._n_received, self.end_s = 0, asyncio.get_running_loop().time() + self._within_s


def _replay_body(body: bytes, receive: Receive) -> Receive:
    given = False

    async def replaying() -> Message:
        nonlocal given
        if given:
            return await receive()
        given = True
        return {"type": "http.request", "body": body, "more_body": False}

    return replaying


def most_bytes(scope: Scope, max_body_bytes: int, max_array_bytes: int) -> int:
    """Return how large the body of a request may be."""
    if not _WITH_ROWS.fullmatch(scope["path"]):
        return min(_MOST_WITHOUT_ROWS, max_body_bytes)
    return max_array_bytes if is_array(scope) else max_body_bytes


def is_array(scope: Scope) -> bool:
    """Return whether a request says that its body is .npy."""
    kind: bytes = next((value for name, value in scope["headers"] if name == b"content-type"), b"")
    return kind.partition(b";")[0].strip().lower() == b"application/x-npy"


def too_large(most: int) -> UnreadError:
    """Return the refusal of a body that is too large."""
    return _refuse(HTTPStatus.REQUEST_ENTITY_TOO_LARGE, f"larger than {most} bytes")


def _refuse(status: HTTPStatus, problem: str) -> UnreadError:
    return UnreadError(status, Fault(field="body", problem=problem, remedy="send it in parts"))
