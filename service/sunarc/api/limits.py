"""How much one client may ask, and all of them together; the memory of it is bounded."""

from __future__ import annotations

import asyncio
import math
from collections import OrderedDict
from http import HTTPStatus
from ipaddress import IPv6Address, ip_address

from starlette.types import ASGIApp, Message, Receive, Scope, Send

from sunarc.api.problems import Fault, problem_response

_MOST_CLIENTS = 4096
_NETWORK_OF_ONE_CLIENT = 64  # bits; whoever has one IPv6 address has 2^64
_PRICE_OF_A_WRONG_TOKEN = 20.0
_ALWAYS_ANSWERED = "/healthz"


class Allowances:
    """What each client may still ask: a bucket that fills steadily and holds a burst.

    Parameters
    ----------
    per_s : requests per second in the long run.
    burst : requests at once after a pause.
    """

    def __init__(self, *, per_s: float, burst: int) -> None:
        self._per_s = per_s
        self._burst = float(burst)
        self._left: OrderedDict[str, tuple[float, float]] = OrderedDict()

    def take(self, client: str, price: float, *, now_s: float) -> float:
        """Take from a client's bucket; return the seconds to wait where it holds too little, else 0."""
        left, at_s = self._left.pop(client, (self._burst, now_s))
        left = min(self._burst, left + (now_s - at_s) * self._per_s)
        enough = left >= price
        self._left[client] = (left - price if enough else left, now_s)
        if len(self._left) > _MOST_CLIENTS:
            self._left.popitem(last=False)
        return 0.0 if enough else (price - left) / self._per_s

    def empty(self, client: str, price: float, *, now_s: float) -> None:
        """Take from a client's bucket what is there, up to a price."""
        left, at_s = self._left.pop(client, (self._burst, now_s))
        left = min(self._burst, left + (now_s - at_s) * self._per_s)
        self._left[client] = (max(0.0, left - price), now_s)


class Limits:
    """Refuses what is too much: per client (429), and at once (503).

    A client on loopback is not counted: it is the host itself, or a proxy that does not tell for whom it asks.

    Parameters
    ----------
    app : what is behind it.
    per_s, burst : see `Allowances`; no limit per client where `per_s` is 0.
    at_once : requests that are answered at the same time.
    """

    def __init__(self, app: ASGIApp, *, per_s: float, burst: int, at_once: int) -> None:
        self._app = app
        self._allowances = Allowances(per_s=per_s, burst=burst) if per_s > 0.0 else None
        self._at_once = at_once
        self._under_way = 0

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Let one request pass, or refuse it."""
        if scope["type"] != "http" or scope["path"] == _ALWAYS_ANSWERED:
            await self._app(scope, receive, send)
            return
        client = _client(scope)
        wait_s = self._wait_s(client)
        if wait_s > 0.0:
            await _refused(HTTPStatus.TOO_MANY_REQUESTS, scope, wait_s=wait_s)(scope, receive, send)
        elif self._under_way >= self._at_once:
            await _refused(HTTPStatus.SERVICE_UNAVAILABLE, scope, wait_s=1.0)(scope, receive, send)
        else:
            self._under_way += 1
            try:
                await self._app(scope, receive, send if client is None else self._watched(client, send))
            finally:
                self._under_way -= 1

    def _wait_s(self, client: str | None) -> float:
        if self._allowances is None or client is None:
            return 0.0
        return self._allowances.take(client, 1.0, now_s=asyncio.get_running_loop().time())

    def _watched(self, client: str, send: Send) -> Send:
        """Make guessing tokens slow."""

        async def sending(message: Message) -> None:
            if self._allowances is not None and message.get("status") == HTTPStatus.UNAUTHORIZED:
                now_s = asyncio.get_running_loop().time()
                self._allowances.empty(client, _PRICE_OF_A_WRONG_TOKEN, now_s=now_s)
            await send(message)

        return sending


def _client(scope: Scope) -> str | None:
    """Return whom a request counts against; None for the host itself."""
    host = scope["client"][0] if scope.get("client") else None
    if host is None or host.startswith("127.") or host == "::1":
        return None
    if ":" not in host:
        return str(host)
    address = ip_address(host.partition("%")[0])
    if isinstance(address, IPv6Address) and address.ipv4_mapped is None:
        return str(int(address) >> _NETWORK_OF_ONE_CLIENT)
    return str(host)


def _refused(status: HTTPStatus, scope: Scope, *, wait_s: float) -> ASGIApp:
    seconds = math.ceil(wait_s)
    mine = status == HTTPStatus.TOO_MANY_REQUESTS
    fault = Fault(
        field="request",
        problem="too many requests from this address" if mine else "too many requests at once",
        remedy=f"wait {seconds} s and ask again, with more pixels in one request where there are many",
    )
    return problem_response(
        status,
        path=scope["path"],
        detail=f"{fault.problem}; {fault.remedy}",
        errors=[fault],
        headers={"retry-after": str(seconds)},
    )
