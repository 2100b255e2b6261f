"""Connections that cannot be held open for nothing: uvicorn's, with bounds on their number and their patience."""

from __future__ import annotations

import asyncio
from http import HTTPStatus
from typing import Any, cast

import h11
from uvicorn.protocols.http.h11_impl import H11Protocol

from sunarc.api.options import ApiOptions
from sunarc.api.problems import problem_response


class BoundedConnection(H11Protocol):
    """One connection.

    uvicorn waits for a request's head, and for a client that does not read, as long as it takes, and its own limit on
    connections lets idle ones keep others out. Here the one that was idle longest makes room.

    Parameters
    ----------
    options : `max_connections`, and `request_within_s` for a head to come and for an answer to be taken.
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
        self._stop(self._head_timer, self._write_timer)
        super().connection_lost(exc)

    def handle_events(self) -> None:
        """Wait no longer for a head that is there."""
        before = self.cycle
        super().handle_events()
        if self.cycle is not before:
            self._stop(self._head_timer)

    def on_response_complete(self) -> None:
        """Go idle; a body that nobody reads any more ends with its connection."""
        self.idle_since_s = self.loop.time()
        super().on_response_complete()
        if self.conn.their_state is h11.SEND_BODY:
            self.transport.close()

    def pause_writing(self) -> None:
        """Begin to wait for a client that does not read."""
        super().pause_writing()
        self._write_timer = self.loop.call_later(self._patience_s, self.transport.abort)

    def resume_writing(self) -> None:
        """Stop waiting: it reads."""
        self._stop(self._write_timer)
        super().resume_writing()

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

    @staticmethod
    def _stop(*timers: asyncio.TimerHandle | None) -> None:
        for timer in timers:
            if timer is not None:
                timer.cancel()
