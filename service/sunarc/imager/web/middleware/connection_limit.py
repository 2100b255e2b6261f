"""Limits of connections: how many there are, how long a request's head may take, how slowly an answer may be read.

uvicorn waits for a request's head, and for a client that does not read, as long as it takes, and its own limit on
connections lets idle ones keep others out. `BoundedConnection` stands between its protocol and the event loop, with
asyncio's interface alone; `RequestFollower`, as ASGI middleware, notifies it when a request begins and ends.
"""

from __future__ import annotations

import asyncio
import fcntl
import struct
import sys
import termios
from contextvars import ContextVar
from http import HTTPStatus
from typing import Any, cast

import uvicorn
from starlette.datastructures import Headers
from starlette.types import Message, Receive, Scope, Send

from sunarc.imager.web.middleware.http_only import HttpMiddleware
from sunarc.imager.web.options import MIN_RATE_BYTES_PER_S, ApiOptions
from sunarc.imager.web.problems import problem_response

_NO_HTTP = "Invalid HTTP request received."


def bound_connections(config: uvicorn.Config, options: ApiOptions) -> uvicorn.Config:
    """Load a web server's configuration and put the limits around its protocol and its application.

    Parameters
    ----------
    config : of the server, not loaded yet.
    options : `max_connections`, and `request_within_s` for a head to come and for an answer to be read.
    """
    config.http = "h11"
    config.load()
    new_protocol = config.http_protocol_class
    connections: set[BoundedConnection] = set()

    def connect(**how: Any) -> asyncio.Protocol:  # noqa: ANN401 - what uvicorn hands to its protocols
        return BoundedConnection(new_protocol(**how), options, connections)

    config.http_protocol_class = cast("type[asyncio.Protocol]", connect)
    config.loaded_app = RequestFollower(config.loaded_app)
    return config


class BoundedConnection(asyncio.Protocol):
    """Connection with limits; where there are too many, the one that was idle longest is closed.

    Parameters
    ----------
    http : the protocol that reads requests and writes answers.
    options : `max_connections` and `request_within_s`.
    connections : all that are open.

    Attributes
    ----------
    idle : whether no request is being answered.
    idle_since_s : since when, by the event loop's time.
    """

    def __init__(self, http: asyncio.Protocol, options: ApiOptions, connections: set[BoundedConnection]) -> None:
        self._http = http
        self._most = options.max_connections
        self._patience_s = options.request_within_s
        self._connections = connections
        self._loop = asyncio.get_running_loop()
        self._head_timer: asyncio.TimerHandle | None = None
        self._write_timer: asyncio.TimerHandle | None = None
        self.idle = True
        self.idle_since_s = self._loop.time()

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Register the connection, and start the timer for a request's head."""
        self._transport = cast("asyncio.Transport", transport)
        self._http.connection_made(cast("asyncio.Transport", _ProblemTransport(self._transport)))
        self._connections.add(self)
        if len(self._connections) > self._most:
            longest = min((one for one in self._connections if one.idle), key=lambda one: one.idle_since_s)
            self._connections.discard(longest)  # it hears of its end later; this one is idle: there is one
            longest.abort()
        self._start_head_timer()

    def connection_lost(self, exc: Exception | None) -> None:
        """Stop the timers of the connection."""
        self._connections.discard(self)
        self._stop_head_timer()
        self._stop_write_timer()
        self._http.connection_lost(exc)

    def data_received(self, data: bytes) -> None:
        """Pass received bytes on; on an idle connection they begin a head, whose rest has to arrive in time."""
        before = _connection.set(self)  # the task that answers a request inherits it
        self._http.data_received(data)
        _connection.reset(before)
        if self.idle and self._head_timer is None:
            self._start_head_timer()

    def eof_received(self) -> bool | None:
        """Pass on that the client sends no more."""
        return self._http.eof_received()

    def pause_writing(self) -> None:
        """Start the timer of a client that does not read its answer."""
        self._http.pause_writing()
        self._watch_reading(self._unread_bytes())

    def resume_writing(self) -> None:
        """Stop the timer: the client reads."""
        self._stop_write_timer()
        self._http.resume_writing()

    def begin(self) -> None:
        """Stop the timer of a request's head: the head has arrived, and its request is being answered."""
        self.idle = False
        self._stop_head_timer()

    def end(self, *, unread: bool) -> None:
        """Mark the connection idle after an answer; one with an unread body is closed."""
        self.idle, self.idle_since_s = True, self._loop.time()
        if unread:  # answered before its body had come (a refusal): to read the rest only to drop it serves the sender
            self._transport.close()

    def abort(self) -> None:
        """Close the connection at once."""
        self._transport.abort()

    def _watch_reading(self, unread_bytes: int) -> None:
        """End the connection unless, until the timer ends, the client has read at the lowest rate or faster."""

        def check() -> None:
            now_unread_bytes = self._unread_bytes()
            if unread_bytes - now_unread_bytes < self._patience_s * MIN_RATE_BYTES_PER_S:
                self.abort()
            else:
                self._watch_reading(now_unread_bytes)

        self._stop_write_timer()
        self._write_timer = self._loop.call_later(self._patience_s, check)

    def _unread_bytes(self) -> int:
        """Return the written bytes that the client has not acknowledged: here, and in the kernel's buffer.

        The kernel's buffer holds megabytes and asks for more only when a good part of it is free, so that a client
        that reads steadily seems to read nothing for minutes if only this side's buffer is counted.
        """
        return self._transport.get_write_buffer_size() + _in_kernel_bytes(self._transport)

    def _start_head_timer(self) -> None:
        self._head_timer = self._loop.call_later(self._patience_s, self.abort)

    def _stop_head_timer(self) -> None:
        if self._head_timer is not None:
            self._head_timer.cancel()
            self._head_timer = None

    def _stop_write_timer(self) -> None:
        if self._write_timer is not None:
            self._write_timer.cancel()
            self._write_timer = None


_connection: ContextVar[BoundedConnection] = ContextVar("connection")


class RequestFollower(HttpMiddleware):
    """Notifies a connection when a request begins and when its answer is written."""

    async def answer(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass a request on."""
        connection, headers = _connection.get(), Headers(scope=scope)
        unread = "transfer-encoding" in headers or headers.get("content-length", "0") != "0"
        connection.begin()

        async def receiving() -> Message:
            nonlocal unread
            message = await receive()
            unread = unread and message.get("more_body", False)
            return message

        async def sending(message: Message) -> None:
            ends = message["type"] == "http.response.body" and not message.get("more_body", False)
            if ends and unread and "expect" not in headers:  # to receive would ask for the body
                await _receive_arrived(receiving)
            await send(message)
            if ends:
                connection.end(unread=unread)

        await self.app(scope, receiving, sending)


async def _receive_arrived(receive: Receive) -> None:
    """Receive the part of a body that has come, and wait for no more."""
    try:
        async with asyncio.timeout(0):
            while (await receive()).get("more_body", False):
                pass
    except TimeoutError:
        return


class _ProblemTransport:
    """A transport on which a request that is no HTTP is refused in the shape of all refusals.

    uvicorn refuses it itself, before any application, with a plain text; every other answer is an application's.

    Parameters
    ----------
    transport : of the connection.
    """

    def __init__(self, transport: asyncio.Transport) -> None:
        self._transport = transport
        self._refused = False

    def __getattr__(self, name: str) -> Any:  # noqa: ANN401 - of the transport
        return getattr(self._transport, name)

    def write(self, data: bytes) -> None:
        """Write an answer, except for uvicorn's refusal in plain text, which `close` replaces."""
        self._refused = self._refused or (data.startswith(b"HTTP/1.1 400 ") and b"text/plain" in data)
        if not self._refused:
            self._transport.write(data)

    def close(self) -> None:
        """Close the connection, after the refusal where there is one."""
        if self._refused:
            self._transport.write(_malformed())
            self._refused = False
        self._transport.close()


def _malformed() -> bytes:
    """Return the whole answer to bytes that are no HTTP."""
    refusal = problem_response(HTTPStatus.BAD_REQUEST, path="", detail=_NO_HTTP)
    lines = [b"%s: %s\r\n" % header for header in (*refusal.raw_headers, (b"connection", b"close"))]
    return b"HTTP/1.1 400 Bad Request\r\n" + b"".join(lines) + b"\r\n" + bytes(refusal.body)


def _in_kernel_bytes(transport: asyncio.Transport) -> int:
    """Return how many bytes of a socket are sent and not acknowledged, or not sent yet (tcp(7), SIOCOUTQ)."""
    answer = bytearray(struct.calcsize("i"))
    try:
        fcntl.ioctl(transport.get_extra_info("socket").fileno(), termios.TIOCOUTQ, answer)
    except OSError:
        return 0  # closed in this moment
    return int.from_bytes(answer, sys.byteorder)
