"""Slots for large computations: few at a time, by turns among addresses."""

from __future__ import annotations

import asyncio
from collections import OrderedDict, deque
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from http import HTTPStatus

from sunarc.api.problems import Fault, RefusedError


class ComputeSlots:
    """Semaphore of large computations that serves waiting addresses in turn.

    A slot is taken when all that is computed on is there, and left when the numbers are: not while a request is being
    sent, nor while its answer is being read. Addresses that wait take turns.

    Parameters
    ----------
    most : how many run; an address of which more requests wait than that is refused (429).
    """

    def __init__(self, most: int) -> None:
        self._most = most
        self._free = most
        self._waiting: OrderedDict[str | None, deque[asyncio.Future[None]]] = OrderedDict()

    def require_room(self, client: str | None) -> None:
        """Raise RefusedError (429) where too much of an address waits already. On the event loop alone."""
        if len(self._waiting.get(client, ())) >= self._most:
            fault = Fault(field="request", problem="too many large requests at once", remedy="ask again in a second")
            raise RefusedError(HTTPStatus.TOO_MANY_REQUESTS, fault, headers={"retry-after": "1"})

    @asynccontextmanager
    async def slot(self, client: str | None) -> AsyncIterator[None]:
        """Wait for a slot, and hold it. On the event loop alone."""
        await self._take(client)
        try:
            yield
        finally:
            self._leave()

    async def _take(self, client: str | None) -> None:
        if self._free:
            self._free -= 1
            return
        waiter: asyncio.Future[None] = asyncio.get_running_loop().create_future()
        self._waiting.setdefault(client, deque()).append(waiter)
        try:
            await waiter
        except asyncio.CancelledError:
            if waiter.done() and not waiter.cancelled():
                self._leave()  # it was handed a slot in the same moment
            raise

    def _leave(self) -> None:
        """Pass the slot on to the next waiting address."""
        while self._waiting:
            client, waiters = self._waiting.popitem(last=False)
            waiter = waiters.popleft()
            if waiters:
                self._waiting[client] = waiters
            if not waiter.done():
                waiter.set_result(None)
                return
        self._free += 1
