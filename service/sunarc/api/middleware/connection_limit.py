"""Connections that cannot be held open for nothing: uvicorn's, with bounds on their number and their patience."""

from __future__ import annotations

import asyncio
import fcntl
import struct
import sys
import termios
from http import HTTPStatus
from typing import Any, cast

import h11
from uvicorn.protocols.http.h11_impl import H11Protocol

from sunarc.api.options import MIN_RATE_BYTES_PER_S, ApiOptions
from sunarc.api.problems import problem_response


class BoundedConnection(H11Protocol):
    """One connection.

    uvicorn waits for a request's head, and for a client that does not read, as long as it takes, and its own limit on
    connections lets idle ones keep others out. Here the one that was idle longest makes room.

    Parameters
    ----------
    options : `max_connections`, and `request_within_s` for a head to come and for an answer to be read.
    how : what uvicorn hands to its protocols.
    """

    def __init__(self, options: ApiOptions, **how: Any) -> None:  # noqa: ANN401 - uvicorn's
        super().__init__(**how)
        self._most = options.max_connections
        self._patience_s = options.request_within_s
        self.idle_since_s = self.loop.time()
        self._head_timer: asyncio.TimerHandle | None = None
        self._write_timer: asyncio.TimerHandle | None = None

    @property
    def idle(self) -> bool:
        """Whether no request is being answered."""
        return self.cycle is None or self.cycle.response_complete

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]  # as uvicorn has it
        """Make room, and begin to wait for a head."""
        super().connection_made(transport)
        if len(self.connections) > self._most:
            idle = [one for one in self.connections if isinstance(one, BoundedConnection) and one.idle]
            longest = min(idle, key=lambda one: one.idle_since_s)  # this one is idle: there is one
            self.connections.discard(longest)  # it hears of its end later
            longest.transport.abort()
        self._head_timer = self.loop.call_later(self._patience_s, transport.abort)

    def connection_lost(self, exc: Exception | None) -> None:
        """Stop waiting."""
        self._stop_head_timer()
        self._stop_write_timer()
        super().connection_lost(exc)

    def handle_events(self) -> None:
        """Wait no longer for a head that is there; begin to wait for the rest of one that has begun.

        uvicorn waits for the next request only until its first byte.
        """
        before = self.cycle
        super().handle_events()
        if self.cycle is not before:
            self._stop_head_timer()
        # h11 keeps what it cannot parse yet: bytes of a head that has begun and does not go on.
        if self._head_timer is None and self.idle and self.conn.trailing_data[0]:
            self._head_timer = self.loop.call_later(self._patience_s, self.transport.abort)

    def on_response_complete(self) -> None:
        """Go idle; a body that nobody reads any more ends with its connection."""
        self.idle_since_s = self.loop.time()
        super().on_response_complete()
        # Answered before its body had come (a refusal): to read the rest only to drop it would serve the sender.
        if self.conn.their_state is h11.SEND_BODY:
            self.transport.close()

    def pause_writing(self) -> None:
        """Start the timer of a client that does not read its answer."""
        super().pause_writing()
        self._watch_reading(self._unread_bytes())

    def resume_writing(self) -> None:
        """Stop watching: it reads."""
        self._stop_write_timer()
        super().resume_writing()

    def _watch_reading(self, unread_bytes: int) -> None:
        """End the connection unless, until the timer ends, the client has read at the lowest rate or faster."""

        def check() -> None:
            now_unread_bytes = self._unread_bytes()
            if unread_bytes - now_unread_bytes < self._patience_s * MIN_RATE_BYTES_PER_S:
                self.transport.abort()
            else:
                self._watch_reading(now_unread_bytes)

        self._stop_write_timer()
        self._write_timer = self.loop.call_later(self._patience_s, check)

    def _unread_bytes(self) -> int:
        """Return what was written and is not acknowledged by the client: here, and in the kernel's buffer.

        The kernel's buffer holds megabytes and asks for more only when a good part of it is free, so that a client
        that reads steadily seems to read nothing for minutes if only this side's buffer is looked at.
        """
        return self.transport.get_write_buffer_size() + _in_kernel_bytes(self.transport)

    def _stop_head_timer(self) -> None:
        if self._head_timer is not None:
            self._head_timer.cancel()
            self._head_timer = None

    def _stop_write_timer(self) -> None:
        if self._write_timer is not None:
            self._write_timer.cancel()
            self._write_timer = None

    def send_400_response(self, msg: str) -> None:
        """Refuse what is no HTTP, in the shape of all refusals."""
        refusal = problem_response(HTTPStatus.BAD_REQUEST, path="", detail=msg)
        headers = [*refusal.raw_headers, (b"connection", b"close")]
        reason = HTTPStatus.BAD_REQUEST.phrase.encode()
        for event in (
            h11.Response(status_code=400, headers=headers, reason=reason),
            h11.Data(data=cast("bytes", refusal.body)),
            h11.EndOfMessage(),
        ):
            self.transport.write(self.conn.send(event) or b"")
        self.transport.close()


def _in_kernel_bytes(transport: asyncio.Transport) -> int:
    """Return how many bytes of a socket are sent and not acknowledged, or not sent yet (tcp(7), SIOCOUTQ)."""
    answer = bytearray(struct.calcsize("i"))
    try:
        fcntl.ioctl(transport.get_extra_info("socket").fileno(), termios.TIOCOUTQ, answer)
    except OSError:
        return 0  # closed in this moment
    return int.from_bytes(answer, sys.byteorder)
