"""Outermost layer of an application: refusals by a request's head, faults, answers to HEAD, headers of every answer."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from datetime import datetime
from http import HTTPStatus

from starlette.types import Message, Receive, Scope, Send

from sunarc.common.utc import rfc3339
from sunarc.imager.web.context import DECIDED_AT
from sunarc.imager.web.middleware.http_only import HttpMiddleware
from sunarc.imager.web.middleware.request_bodies import most_bytes, too_large
from sunarc.imager.web.problems import Fault, FaultLog, UnreadError, internal_problem, record_fault

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
_RAW_HEADERS = [(name.encode(), value.encode()) for name, value in _HEADERS.items()]
"""Headers that keep browsers strict, as they are sent."""
_TWO_LENGTHS = UnreadError(
    HTTPStatus.BAD_REQUEST,
    Fault(field="content-length", problem="was sent with transfer-encoding", remedy="send one of them"),
)
"""A proxy may go by the other one and take the rest of the body for a request of its own (RFC 9112, section 11.2)."""
_BY_HEAD = "sunarc.head"


def asked_by_head(scope: Scope) -> bool:
    """Return whether a request was HEAD: an endless answer need not begin."""
    return bool(scope.get(_BY_HEAD))


@dataclass(kw_only=True, eq=False)
class Boundary(HttpMiddleware):
    """Completes every answer, and answers with a problem where nothing behind it has answered.

    Bodies that announce too many bytes, or two lengths, are refused. HEAD is answered with the status and the headers
    of GET, and no body (RFC 9110, section 9.3.2). The stack of a fault goes to the log once: the web framework's own
    guard hands the exception on to the server, which would write it each time.

    Parameters
    ----------
    max_body_bytes : a larger body of rows is refused (413), before it is read.
    max_array_bytes : likewise, of .npy.
    faults : the log.
    count : is given the status of each answer, and how long it took until it was known, s.
    """

    max_body_bytes: int
    max_array_bytes: int
    faults: FaultLog
    count: Callable[[int, float], None] = lambda _status, _duration_s: None

    async def answer(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass a request on, or refuse it; an answer that has begun when a fault comes is cut off."""
        clock = asyncio.get_running_loop()
        begun_s, started = clock.time(), False
        by_head = scope["method"] == "HEAD"
        asked = {**scope, "method": "GET", _BY_HEAD: True} if by_head else scope

        async def sending(message: Message) -> None:
            nonlocal started
            started = True
            if message["type"] == "http.response.start":
                self.count(message["status"], clock.time() - begun_s)
                present = message.get("headers", [])
                message = {**message, "headers": [*present, *_missing_headers(asked, present)]}
            elif by_head:
                message = {**message, "body": b""}
            await send(message)

        refusal = self._refusal(scope)
        if refusal is not None:
            await refusal.response(scope["path"])(asked, receive, sending)
            return
        try:
            await self.app(asked, receive, sending)
        except Exception as error:  # noqa: BLE001 - that is its purpose
            name = record_fault(self.faults, error, scope)
            if not started:
                await internal_problem(scope["path"], name)(asked, receive, sending)

    def _refusal(self, scope: Scope) -> UnreadError | None:
        """Return the refusal of a request whose body will not be read."""
        headers = dict(scope["headers"])
        length = headers.get(b"content-length")
        if length is None:
            return None
        if b"transfer-encoding" in headers:
            return _TWO_LENGTHS
        most = most_bytes(scope, self.max_body_bytes, self.max_array_bytes)
        return too_large(most) if length.isdigit() and int(length) > most else None


def _missing_headers(scope: Scope, present: list[tuple[bytes, bytes]]) -> Iterator[tuple[bytes, bytes]]:
    """Yield the headers that an answer lacks: of security, and when it was decided which calibration answers `at`."""
    names = {name.lower() for name, _ in present}
    yield from (header for header in _RAW_HEADERS if header[0] not in names)
    time = scope.get(DECIDED_AT)
    if isinstance(time, datetime):
        yield b"sunarc-decided-at", rfc3339(time).encode()
