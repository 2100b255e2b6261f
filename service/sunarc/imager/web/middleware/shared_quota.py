"""Memory held for requests and answers: bounded in total, and shared fairly among addresses."""

from __future__ import annotations

import asyncio
from collections import Counter
from collections.abc import Awaitable, Callable
from dataclasses import dataclass
from functools import lru_cache
from http import HTTPStatus
from ipaddress import IPv6Address, ip_address
from types import TracebackType
from typing import Self

from starlette.types import Message, Receive, Scope, Send

from sunarc.imager.web.problems import Fault, RefusedError, UnreadError


class SharedQuota:
    """Keeps the sum of the held memory within a limit.

    Where room is short, an address that holds less than another takes it from that one, whose oldest request is ended;
    an address that holds the most is refused instead. So nobody keeps others out by holding on.

    Parameters
    ----------
    limit : of the sum, in bytes or pieces.
    """

    def __init__(self, limit: int) -> None:
        self._limit = limit
        self._open: dict[QuotaUse, None] = {}  # in the order in which they were opened
        self._of_client: Counter[str | None] = Counter()

    def open(self, client: str | None) -> QuotaUse:
        """Return the use of a client's request, of nothing yet; a context manager. On the event loop alone."""
        return QuotaUse(self, client)

    def enter(self, use: QuotaUse) -> None:
        """Begin to count a request's use."""
        self._open[use] = None

    def leave(self, use: QuotaUse) -> None:
        """Count a request's use no longer."""
        self._open.pop(use, None)
        self._of_client[use.client] -= use.amount
        if not self._of_client[use.client]:
            del self._of_client[use.client]
        use.amount = 0

    def grow(self, use: QuotaUse, amount: int) -> None:
        """Count more for a request; RefusedError (429) where there is no room, nor an address that holds more."""
        while self._of_client.total() + amount > self._limit:
            heaviest, most = self._of_client.most_common(1)[0] if self._of_client else (use.client, 0)
            if self._of_client[use.client] + amount >= most:
                fault = Fault(field="request", problem="too much at once", remedy="ask again in a second, or in parts")
                raise RefusedError(HTTPStatus.TOO_MANY_REQUESTS, fault, headers={"retry-after": "1"})
            # A dictionary keeps the order of insertion: the first is the oldest.
            oldest = next(one for one in self._open if one.client == heaviest and one.amount)
            self.leave(oldest)
            oldest.end()
        use.amount += amount
        self._of_client[use.client] += amount


@dataclass(eq=False)
class QuotaUse:
    """Memory that one request holds.

    Parameters
    ----------
    quota : where it is counted.
    client : whose it is.
    """

    quota: SharedQuota
    client: str | None

    def __post_init__(self) -> None:
        """Begin with nothing."""
        self._until: asyncio.Timeout | None = None
        self.amount = 0
        self.ended = False

    def __enter__(self) -> Self:
        self.quota.enter(self)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, stack: TracebackType | None
    ) -> None:
        self.quota.leave(self)

    def grow(self, amount: int) -> None:
        """Hold more; see `SharedQuota.grow`."""
        if not self.ended:
            self.quota.grow(self, amount)

    def ends(self, until: asyncio.Timeout) -> None:
        """Set the timeout that ends the request when its memory is claimed."""
        self._until = until

    def end(self) -> None:
        """End the request: another took its room."""
        self.ended = True
        if self._until is not None:
            self._until.reschedule(asyncio.get_running_loop().time())


async def answer_held(
    uses: tuple[QuotaUse, ...], answer: Callable[[Send], Awaitable[None]], *, scope: Scope, receive: Receive, send: Send
) -> None:
    """Answer a request until one of its uses is ended: then with 503, or by cutting off the answer that has begun.

    Parameters
    ----------
    uses : what the request holds.
    answer : answers it, by what it is given.
    scope, receive, send : of the request.
    """
    started = False

    async def sending(message: Message) -> None:
        nonlocal started
        started = True
        await send(message)

    try:
        async with asyncio.timeout(None) as until:
            for use in uses:
                use.ends(until)
            await answer(sending)
    except TimeoutError:
        if not any(use.ended for use in uses):
            raise
        # A status line that is sent cannot be taken back: then the answer is cut off.
        if not started:
            problem, remedy = "ended, since others need the room that it held", "ask again, in parts"
            refused = UnreadError(
                HTTPStatus.SERVICE_UNAVAILABLE, Fault(field="request", problem=problem, remedy=remedy)
            )
            await refused.response(scope["path"])(scope, receive, send)


LONGEST_ADDRESS = 64
"""Characters of an IPv6 address with its zone, and more."""
_MOST_ADDRESSES = 1024
_IPV6_PREFIX_BITS = 64  # whoever has one IPv6 address has 2^64


class ClientAddressError(ValueError):
    """Error of a forwarded client that is no address."""


def client_network(scope: Scope) -> str | None:
    """Return the client of a request: its IPv4 address or IPv6 /64; None for the host itself.

    uvicorn has put there what a proxy on loopback says in X-Forwarded-For, whatever it is.

    Raises
    ------
    ClientAddressError : it is no address.
    """
    host = scope["client"][0] if scope.get("client") else None
    if host is None:
        return None
    if len(host) > LONGEST_ADDRESS:
        raise ClientAddressError(f"{host[:LONGEST_ADDRESS]!r} is not an address")
    return _network(host)


@lru_cache(_MOST_ADDRESSES)
def _network(host: str) -> str | None:
    try:
        address = ip_address(host)
    except ValueError:
        raise ClientAddressError(f"{host!r} is not an address") from None
    if isinstance(address, IPv6Address):
        address = address.ipv4_mapped or address
    if address.is_loopback:
        return None
    if isinstance(address, IPv6Address):
        return str(IPv6Address(int(address) >> _IPV6_PREFIX_BITS << _IPV6_PREFIX_BITS))
    return str(address)
