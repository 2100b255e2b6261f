"""HEAD for every path that answers GET."""

from __future__ import annotations

from starlette.types import ASGIApp, Message, Receive, Scope, Send

_BY_HEAD = "sunarc.head"


def asked_by_head(scope: Scope) -> bool:
    """Return whether a request was HEAD: an endless answer need not begin."""
    return bool(scope.get(_BY_HEAD))


class HeadRequests:
    """Answers HEAD with the status and the headers of GET, and no body (RFC 9110, section 9.3.2).

    Parameters
    ----------
    app : what is behind it.
    """

    def __init__(self, app: ASGIApp) -> None:
        self._app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass a request on, HEAD as GET."""
        if scope["type"] != "http" or scope["method"] != "HEAD":
            await self._app(scope, receive, send)
            return

        async def without_body(message: Message) -> None:
            await send({**message, "body": b""} if message["type"] == "http.response.body" else message)

        await self._app({**scope, "method": "GET", _BY_HEAD: True}, receive, without_body)
