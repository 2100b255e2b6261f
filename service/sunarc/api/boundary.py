"""What every request passes on its way in and every answer on its way out: the limit on size, the security headers."""

from __future__ import annotations

from http import HTTPStatus

from starlette.datastructures import Headers, MutableHeaders
from starlette.exceptions import HTTPException
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from sunarc.api.problems import Fault, problem_response

_HEADERS = {
    "content-security-policy": (
        "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self'; connect-src 'self'; "
        "base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
    ),
    "referrer-policy": "no-referrer",
    "x-content-type-options": "nosniff",
}


class Boundary:
    """Refuses bodies that are too large before they are read, and adds the headers that keep browsers strict.

    Parameters
    ----------
    app : what is behind it.
    max_body_bytes : a larger body is refused.
    """

    def __init__(self, app: ASGIApp, *, max_body_bytes: int) -> None:
        self._app = app
        self._max_body_bytes = max_body_bytes

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Let one request pass, or refuse it."""
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        guarded = _with_headers(send)
        if _announced_bytes(scope) > self._max_body_bytes:
            fault = Fault(field="body", problem=self._too_large(), remedy="send it in parts")
            refusal = problem_response(
                HTTPStatus.REQUEST_ENTITY_TOO_LARGE,
                path=scope["path"],
                detail=f"body: {fault.problem}; {fault.remedy}",
                errors=[fault],
                headers={"connection": "close"},
            )
            await refusal(scope, receive, guarded)
            return
        await self._app(scope, self._counted(receive), guarded)

    def _too_large(self) -> str:
        return f"larger than {self._max_body_bytes} bytes"

    def _counted(self, receive: Receive) -> Receive:
        """Stop reading a body that did not announce its size."""
        read = 0

        async def counting() -> Message:
            nonlocal read
            message = await receive()
            read += len(message.get("body", b""))
            if read > self._max_body_bytes:
                raise HTTPException(HTTPStatus.REQUEST_ENTITY_TOO_LARGE, f"body: {self._too_large()}; send it in parts")
            return message

        return counting


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
