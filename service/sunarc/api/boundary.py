"""What every request passes on its way in and every answer on its way out: how large, how slow, which headers."""

from __future__ import annotations

import asyncio
from http import HTTPStatus

from starlette.datastructures import Headers, MutableHeaders
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from sunarc.api.arrays import NPY
from sunarc.api.problems import Fault, UnreadError

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


class Boundary:
    """Refuses bodies that are too large or too slow, and adds the headers that keep browsers strict.

    Parameters
    ----------
    app : what is behind it.
    max_body_bytes : a larger body is refused, before it is read where it announces its size.
    max_array_bytes : likewise, of .npy.
    within_s : a body that is not there after so many seconds is refused.
    """

    def __init__(self, app: ASGIApp, *, max_body_bytes: int, max_array_bytes: int, within_s: float) -> None:
        self._app = app
        self._max_body_bytes = max_body_bytes
        self._max_array_bytes = max_array_bytes
        self._within_s = within_s

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Let one request pass, or refuse it."""
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        guarded = _with_headers(send)
        most = self._max_array_bytes if _is_array(scope) else self._max_body_bytes
        if _announced_bytes(scope) > most:
            await _too_large(most).response(scope["path"])(scope, receive, guarded)
            return
        await self._app(scope, self._counted(receive, most), guarded)

    def _too_slow(self) -> UnreadError:
        return _refused(HTTPStatus.REQUEST_TIMEOUT, f"not there within {self._within_s:g} s")

    def _counted(self, receive: Receive, most: int) -> Receive:
        """Stop reading a body that does not announce its size, or does not come."""
        read, more, end_s = 0, True, asyncio.get_running_loop().time() + self._within_s

        async def counting() -> Message:
            nonlocal read, more
            if not more:  # what comes now is the end of the connection, and has no hurry
                return await receive()
            try:
                async with asyncio.timeout_at(end_s):
                    message = await receive()
            except TimeoutError:
                raise self._too_slow() from None
            read, more = read + len(message.get("body", b"")), message.get("more_body", False)
            if read > most:
                raise _too_large(most)
            return message

        return counting


def _refused(status: HTTPStatus, problem: str) -> UnreadError:
    return UnreadError(status, Fault(field="body", problem=problem, remedy="send it in parts"))


def _too_large(most: int) -> UnreadError:
    return _refused(HTTPStatus.REQUEST_ENTITY_TOO_LARGE, f"larger than {most} bytes")


def _is_array(scope: Scope) -> bool:
    return Headers(scope=scope).get("content-type", "").partition(";")[0].strip().lower() == NPY


def _announced_bytes(scope: Scope) -> int:
    length = Headers(scope=scope).get("content-length", "")
    return int(length) if length.isdecimal() else 0


def _with_headers(send: Send) -> Send:
    async def sending(message: Message) -> None:
        if message["type"] == "http.response.start":
            headers = MutableHeaders(scope=message)
            for name, value in _HEADERS.items():
                headers.setdefault(name, value)
        await send(message)

    return sending
