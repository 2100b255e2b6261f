"""How much one client may ask, and all of them together; the memory of it is bounded."""

from __future__ import annotations

import asyncio
import math
from collections import OrderedDict
from functools import partial
from http import HTTPStatus

from starlette.types import ASGIApp, Message, Receive, Scope, Send

from sunarc.api.middleware.authentication import bears_wrong_token
from sunarc.api.middleware.client_address import ClientAddressError, client_network
from sunarc.api.middleware.holdings import Holdings, answer_held
from sunarc.api.problems import Fault, RefusedError, problem_response

_MOST_CLIENTS = 4096
_PRICE_OF_A_WRONG_TOKEN = 20.0
_ALWAYS_ANSWERED = "/healthz"
_STREAM = "/events/stream"
"""The end of the path of a stream of events."""


def is_always_answered(scope: Scope) -> bool:
    """Return whether a request is a probe that no limit refuses: a watchdog must hear from a busy service."""
    return bool(scope["path"] == _ALWAYS_ANSWERED and scope["method"] in {"GET", "HEAD"})


class TokenBuckets:
    """What each client may still ask: a bucket that fills steadily and holds a burst.

    Parameters
    ----------
    per_s : requests per second in the long run.
    burst : requests at once after a pause.
    """

    def __init__(self, *, per_s: float, burst: int) -> None:
        self._per_s = per_s
        self._burst = float(burst)
        self._buckets: OrderedDict[str, tuple[float, float]] = OrderedDict()

    def take(self, client: str, price: float, *, now_s: float) -> float:
        """Take from a client's bucket; return the seconds to wait where it holds less than one request, else 0.

        A price above what is left makes a debt, which the client waits for: refused for its price, a wrong token
        would be distinguishable from a right one.
        """
        tokens = self._filled(client, now_s)
        enough = tokens >= 1.0
        self._buckets[client] = (tokens - price if enough else tokens, now_s)
        if len(self._buckets) > _MOST_CLIENTS:
            self._buckets.popitem(last=False)
        return 0.0 if enough else (1.0 - tokens) / self._per_s

    def give_back(self, client: str, price: float, *, now_s: float) -> None:
        """Put back what was taken for nothing."""
        self._buckets[client] = (min(self._burst, self._filled(client, now_s) + price), now_s)

    def _filled(self, client: str, now_s: float) -> float:
        tokens, at_s = self._buckets.pop(client, (self._burst, now_s))
        return min(self._burst, tokens + (now_s - at_s) * self._per_s)


class RateLimit:
    """Refuses what one client asks too often (429), and clients whose address a proxy garbles (400).

    A client on loopback is not counted: it is the host itself, or a proxy that does not tell for whom it asks.

    Parameters
    ----------
    app : what is behind it.
    per_s, burst : see `TokenBuckets`; no limit where `per_s` is 0.
    tokens : digests of those that are right; a request that bears another one and is refused costs 20.
    """

    def __init__(self, app: ASGIApp, *, per_s: float, burst: int, tokens: tuple[bytes, ...]) -> None:
        self._app = app
        self._allowances = TokenBuckets(per_s=per_s, burst=burst) if per_s > 0.0 else None
        self._tokens = tokens

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass a request on, or refuse it."""
        if scope["type"] != "http" or is_always_answered(scope):
            await self._app(scope, receive, send)
            return
        try:
            client = client_network(scope)
        except ClientAddressError as error:
            await _garbled(scope, error)(scope, receive, send)
            return
        if self._allowances is None or client is None:
            await self._app(scope, receive, send)
            return
        price = _PRICE_OF_A_WRONG_TOKEN if bears_wrong_token(scope, self._tokens) else 1.0
        wait_s = self._allowances.take(client, price, now_s=asyncio.get_running_loop().time())
        if wait_s > 0.0:
            await too_many("too many requests from this address", scope, wait_s=wait_s)(scope, receive, send)
        else:
            priced = send if price == 1.0 else self._refunding(self._allowances, client, price - 1.0, send)
            await self._app(scope, receive, priced)

    @staticmethod
    def _refunding(allowances: TokenBuckets, client: str, price: float, send: Send) -> Send:
        """Give the price back where the token was not needed: a proxy's own, or a page's where reading is open."""

        async def sending(message: Message) -> None:
            if message["type"] == "http.response.start" and message["status"] != HTTPStatus.UNAUTHORIZED:
                allowances.give_back(client, price, now_s=asyncio.get_running_loop().time())
            await send(message)

        return sending


class ConcurrencyLimit:
    """Refuses what is too much at once (503), or ends the oldest request of an address that has more under way.

    A request is counted from when its body is there to when its answer is written; streams of events, which have no
    end, are counted apart.

    Parameters
    ----------
    app : what is behind it.
    at_once : requests that are answered at the same time.
    streams : streams of events that are open at the same time.
    """

    def __init__(self, app: ASGIApp, *, at_once: int, streams: int = 64) -> None:
        self._app = app
        self._under_way = Holdings(at_once)
        self._streams = Holdings(streams)

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass a request on, or refuse it."""
        if scope["type"] != "http" or is_always_answered(scope):
            await self._app(scope, receive, send)
            return
        counted = self._streams if scope["path"].endswith(_STREAM) else self._under_way
        with counted.open(client_network(scope)) as request:
            try:
                request.grow(1)
            except RefusedError:
                refusal = too_many("too many requests at once", scope, HTTPStatus.SERVICE_UNAVAILABLE)
                await refusal(scope, receive, send)
            else:
                answer = partial(self._app, scope, receive)
                await answer_held(request, answer, scope=scope, receive=receive, send=send)


def too_many(
    problem: str, scope: Scope, status: HTTPStatus = HTTPStatus.TOO_MANY_REQUESTS, *, wait_s: float = 1.0
) -> ASGIApp:
    """Return the refusal of what is too much, with the seconds to wait."""
    seconds = math.ceil(wait_s)
    remedy = f"wait {seconds} s and ask again, with more pixels in one request where there are many"
    fault = Fault(field="request", problem=problem, remedy=remedy)
    return problem_response(
        status,
        path=scope["path"],
        detail=f"{fault.problem}; {fault.remedy}",
        errors=[fault],
        headers={"retry-after": str(seconds)},
    )


def _garbled(scope: Scope, error: ClientAddressError) -> ASGIApp:
    remedy = "let the proxy set X-Forwarded-For to the client's address alone"
    fault = Fault(field="x-forwarded-for", problem=str(error), remedy=remedy)
    detail = f"{fault.field}: {fault.problem}; {fault.remedy}"
    return problem_response(HTTPStatus.BAD_REQUEST, path=scope["path"], detail=detail, errors=[fault])
