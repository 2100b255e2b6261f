"""Bodies of requests (size, rate, memory), answers to HEAD, and headers of every answer: security, time of decision."""

from __future__ import annotations

import asyncio
import re
from dataclasses import dataclass
from datetime import datetime
from functools import partial
from http import HTTPStatus

from starlette.datastructures import Headers, MutableHeaders
from starlette.types import Message, Receive, Scope, Send

from sunarc.common.utc import rfc3339
from sunarc.imager.web.context import DECIDED_AT
from sunarc.imager.web.middleware.http_only import HttpMiddleware
from sunarc.imager.web.middleware.shared_quota import QuotaUse, SharedQuota, answer_held, client_network
from sunarc.imager.web.options import MIN_RATE_BYTES_PER_S
from sunarc.imager.web.problems import Fault, RefusedError, UnreadError, refusal_response

_WITHOUT_BODY = frozenset({"GET", "HEAD", "OPTIONS"})
_WITH_ROWS = re.compile(r"/v1(?:/cameras/[^/]+)?/(?:back-project|feed|geolocate|project)")
_MOST_WITHOUT_ROWS = 16_384
"""Bytes of any other body, which the web framework reads on the event loop: a few numbers, a reason."""


@dataclass(kw_only=True, eq=False)
class BodyReader(HttpMiddleware):
    """Reads the body of a request, and hands the request on when it is there; nothing is occupied by one that is not.

    Parameters
    ----------
    max_body_bytes, max_array_bytes : a larger body of rows, or one of .npy, is refused (413).
    within_s : a body that is not there after so many seconds, and of which in so many seconds hardly any more came, is
        refused (408).
    quota : bounds the memory of all bodies.
    """

    max_body_bytes: int
    max_array_bytes: int
    within_s: float
    quota: SharedQuota

    async def answer(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass a request on when its body is complete, or refuse it; end it when its memory is claimed by others."""
        if scope["method"] in _WITHOUT_BODY:
            await self.app(scope, receive, send)
            return
        with self.quota.open(client_network(scope)) as use:
            answer = partial(self._pass, scope, receive, use)
            await answer_held(use, answer, scope=scope, receive=receive, send=send)

    async def _pass(self, scope: Scope, receive: Receive, use: QuotaUse, send: Send) -> None:
        most = _most_bytes(scope, self.max_body_bytes, self.max_array_bytes)
        try:
            body = await self._read(receive, use, most)
        except UnreadError as error:
            await error.response(scope["path"])(scope, receive, send)
        except RefusedError as error:
            await refusal_response(scope["path"], error)(scope, receive, send)
        else:
            if body is not None:
                scope["state"] = {**scope.get("state", {}), "use": use}
                await self.app(scope, _replay_body(body, receive), send)

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


def _most_bytes(scope: Scope, max_body_bytes: int, max_array_bytes: int) -> int:
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


_HEADERS = {
    "content-security-policy": (
        "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' blob:; connect-src 'self'; "
        "base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
    ),
    "cross-origin-opener-policy": "same-origin",
    "cross-origin-resource-policy": "same-origin",
    "permissions-policy": "camera=(), geolocation=(), microphone=()",
    "referrer-policy": "no-referrer",
    "x-content-type-options": "nosniff",
    "x-frame-options": "DENY",
}


@dataclass(kw_only=True, eq=False)
class Boundary(HttpMiddleware):
    """Refuses bodies that announce too many bytes, or two lengths, and adds the headers that keep browsers strict.

    Parameters
    ----------
    max_body_bytes : a larger body of rows is refused (413), before it is read.
    max_array_bytes : likewise, of .npy.
    """

    max_body_bytes: int
    max_array_bytes: int

    async def answer(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass a request on, or refuse it."""
        guarded = _add_headers(send)
        most, headers = _most_bytes(scope, self.max_body_bytes, self.max_array_bytes), Headers(scope=scope)
        if "content-length" in headers and "transfer-encoding" in headers:
            await _TWO_LENGTHS.response(scope["path"])(scope, receive, guarded)
        elif _announced_bytes(headers) > most:
            await too_large(most).response(scope["path"])(scope, receive, guarded)
        else:
            await self.app(scope, receive, guarded)


_TWO_LENGTHS = UnreadError(
    HTTPStatus.BAD_REQUEST,
    Fault(field="content-length", problem="was sent with transfer-encoding", remedy="send one of them"),
)
"""A proxy may go by the other one and take the rest of the body for a request of its own (RFC 9112, section 11.2)."""


def _announced_bytes(headers: Headers) -> int:
    length = headers.get("content-length", "")
    return int(length) if length.isdecimal() else 0


def _add_headers(send: Send) -> Send:
    async def sending(message: Message) -> None:
        if message["type"] == "http.response.start":
            headers = MutableHeaders(scope=message)
            for name, value in _HEADERS.items():
                headers.setdefault(name, value)
        await send(message)

    return sending


_BY_HEAD = "sunarc.head"


def asked_by_head(scope: Scope) -> bool:
    """Return whether a request was HEAD: an endless answer need not begin."""
    return bool(scope.get(_BY_HEAD))


class HeadRequests(HttpMiddleware):
    """Answers HEAD with the status and the headers of GET, and no body (RFC 9110, section 9.3.2)."""

    async def answer(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass a request on, HEAD as GET."""
        if scope["method"] != "HEAD":
            await self.app(scope, receive, send)
            return

        async def without_body(message: Message) -> None:
            await send({**message, "body": b""} if message["type"] == "http.response.body" else message)

        await self.app({**scope, "method": "GET", _BY_HEAD: True}, receive, without_body)


@dataclass(eq=False)
class DecidedHeader(HttpMiddleware):
    """Adds `Sunarc-Decided-At` to an answer: when it was decided which calibration answers a request's `at`."""

    async def answer(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass a request on."""

        async def decided(message: Message) -> None:
            time = scope.get(DECIDED_AT)
            if message["type"] == "http.response.start" and isinstance(time, datetime):
                MutableHeaders(scope=message)["sunarc-decided-at"] = rfc3339(time)
            await send(message)

        await self.app(scope, receive, decided)
