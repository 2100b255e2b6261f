"""What every request passes on its way in and every answer on its way out: how large, which headers."""

from __future__ import annotations

from starlette.datastructures import Headers, MutableHeaders
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from sunarc.api.middleware.request_bodies import is_array, too_large

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
    """Refuses bodies that announce themselves as too large, and adds the headers that keep browsers strict.

    Parameters
    ----------
    app : what is behind it.
    max_body_bytes : a larger body is refused (413), before it is read.
    max_array_bytes : likewise, of .npy.
    """

    def __init__(self, app: ASGIApp, *, max_body_bytes: int, max_array_bytes: int) -> None:
        self._app = app
        self._max_body_bytes = max_body_bytes
        self._max_array_bytes = max_array_bytes

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass a request on, or refuse it."""
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        guarded = _with_headers(send)
        most = self._max_array_bytes if is_array(scope) else self._max_body_bytes
        if _announced_bytes(scope) > most:
            await too_large(most).response(scope["path"])(scope, receive, guarded)
            return
        await self._app(scope, receive, guarded)


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
