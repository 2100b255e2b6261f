"""Which requests are answered: by the name asked for, by token, and by how many a client makes."""

from __future__ import annotations

import asyncio
import hashlib
import hmac
import math
import re
import socket
from collections import OrderedDict
from collections.abc import Awaitable, Callable
from dataclasses import dataclass
from functools import lru_cache
from http import HTTPStatus
from ipaddress import ip_address
from pathlib import Path
from typing import Annotated

from fastapi import Security
from fastapi.security import HTTPAuthorizationCredentials, HTTPBearer
from starlette.datastructures import Headers
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from sunarc.common.errors import ConfigurationError
from sunarc.common.foreign_files import MOST_SECRET_BYTES, read_regular
from sunarc.imager.web.middleware.http_only import HttpMiddleware
from sunarc.imager.web.middleware.shared_quota import LONGEST_ADDRESS, ClientAddressError, client_network
from sunarc.imager.web.options import ApiOptions
from sunarc.imager.web.problems import Fault, RefusedError, problem_response, refusal_response

_SHORTEST_TOKEN = 16
_OPEN_PATHS = frozenset({"/", "/docs", "/healthz", "/readyz"})
_OPEN_FOLDER = "/static/"
FEED_PATH = re.compile(r"/v1/cameras/([^/]+)/feed")
"""A hub's route that imagers send to, each with a token of its own."""
_CHALLENGE = {"www-authenticate": "Bearer"}
_NO_TOKEN = Fault(field="authorization", problem="no token, or a wrong one", remedy="send Authorization: Bearer …")
_bearer = HTTPBearer(auto_error=False, scheme_name="token", description="The token of `api.token_file`.")


def read_token(path: Path | None, *, setting: str) -> bytes | None:
    """Return the digest of the token that a file holds; None without a file. The token itself is kept nowhere.

    Raises
    ------
    ConfigurationError : the file cannot be read, or its token is too short to be one.
    """
    if path is None:
        return None
    try:
        token = read_regular(path, most_bytes=MOST_SECRET_BYTES).strip()
    except OSError as error:
        raise ConfigurationError(f"{setting} {path}: {error.strerror}") from error
    if len(token) < _SHORTEST_TOKEN:
        raise ConfigurationError(f"{setting} {path}: a token has at least {_SHORTEST_TOKEN} characters")
    return _digest_token(token)


def require_write_token(token: bytes | None) -> Callable[..., Awaitable[None]]:
    """Return a dependency that refuses requests without the token of a digest, and all without a digest."""

    async def check_token(given: Annotated[HTTPAuthorizationCredentials | None, Security(_bearer)]) -> None:
        if token is None:
            fault = Fault(
                field="authorization", problem="no change is allowed: no token is set", remedy="set api.token_file"
            )
            raise RefusedError(HTTPStatus.FORBIDDEN, fault)
        if given is None or not _is_same_token(given.credentials, token):
            raise RefusedError(HTTPStatus.UNAUTHORIZED, _NO_TOKEN, headers=_CHALLENGE)

    return check_token


@dataclass(kw_only=True, eq=False)
class ReadTokenMiddleware(HttpMiddleware):
    """Refuses reads without one of the tokens; the empty page and the probes stay open.

    Parameters
    ----------
    tokens : the digests of those that open it.
    """

    tokens: tuple[bytes, ...]

    async def answer(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass a request on, or refuse it."""
        if _is_open(scope["path"]) or self._bears_token(scope):
            await self.app(scope, receive, send)
            return
        error = RefusedError(HTTPStatus.UNAUTHORIZED, _NO_TOKEN, headers=_CHALLENGE)
        await refusal_response(scope["path"], error)(scope, receive, send)

    def _bears_token(self, scope: Scope) -> bool:
        given = _bearer_token(scope)
        return given is not None and _matches_any(given, self.tokens)


def bears_wrong_token(scope: Scope, tokens: tuple[bytes, ...]) -> bool:
    """Return whether a request bears a token that belongs to no digest; False without digests."""
    given = _bearer_token(scope)
    return bool(tokens) and given is not None and not _matches_any(given, tokens)


def _bearer_token(scope: Scope) -> str | None:
    scheme, _, given = Headers(scope=scope).get("authorization", "").partition(" ")
    return given.strip() if scheme.lower() == "bearer" else None


def _matches_any(given: str, tokens: tuple[bytes, ...]) -> bool:
    """Compare with every token, so that the time does not reveal which one is meant."""
    return sum(_is_same_token(given, token) for token in tokens) > 0


def _is_open(path: str) -> bool:
    return path in _OPEN_PATHS or path.startswith(_OPEN_FOLDER) or FEED_PATH.fullmatch(path) is not None


def _is_same_token(given: str, digest: bytes) -> bool:
    """Return whether a token has a SHA-256 digest, compared in a time that reveals nothing of either."""
    return hmac.compare_digest(_digest_token(given.encode("utf-8", "replace")), digest)


def _digest_token(token: bytes) -> bytes:
    return hashlib.sha256(token).digest()


_MOST_CLIENTS = 4096
_PRICE_OF_A_WRONG_TOKEN = 20.0
_ALWAYS_ANSWERED = "/healthz"


def is_always_answered(scope: Scope) -> bool:
    """Return whether a request is a probe that no limit refuses: a watchdog must hear from a busy service."""
    return bool(scope["path"] == _ALWAYS_ANSWERED and scope["method"] in {"GET", "HEAD"})


class TokenBuckets:
    """Budget of each client: a bucket that fills steadily and holds a burst.

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
        tokens = self._fill_bucket(client, now_s)
        enough = tokens >= 1.0
        self._buckets[client] = (tokens - price if enough else tokens, now_s)
        if len(self._buckets) > _MOST_CLIENTS:
            self._buckets.popitem(last=False)
        return 0.0 if enough else (1.0 - tokens) / self._per_s

    def give_back(self, client: str, price: float, *, now_s: float) -> None:
        """Return a token to a client's bucket."""
        self._buckets[client] = (min(self._burst, self._fill_bucket(client, now_s) + price), now_s)

    def _fill_bucket(self, client: str, now_s: float) -> float:
        tokens, at_s = self._buckets.pop(client, (self._burst, now_s))
        return min(self._burst, tokens + (now_s - at_s) * self._per_s)


@dataclass(kw_only=True, eq=False)
class RateLimit(HttpMiddleware):
    """Refuses requests of one client that come too often (429), and clients whose address a proxy garbles (400).

    A client on loopback is not counted: it is the host itself, or a proxy that does not state for whom it asks.

    Parameters
    ----------
    per_s, burst : see `TokenBuckets`; no limit where `per_s` is 0.
    tokens : digests of those that are right; a request that bears another one and is refused costs 20.
    """

    per_s: float
    burst: int
    tokens: tuple[bytes, ...]

    def __post_init__(self) -> None:
        """Begin without a client."""
        self._allowances = TokenBuckets(per_s=self.per_s, burst=self.burst) if self.per_s > 0.0 else None

    async def answer(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass a request on, or refuse it."""
        if is_always_answered(scope):
            await self.app(scope, receive, send)
            return
        try:
            client = client_network(scope)
        except ClientAddressError as error:
            await _refuse_garbled(scope, error)(scope, receive, send)
            return
        if self._allowances is None or client is None:
            await self.app(scope, receive, send)
            return
        price = _PRICE_OF_A_WRONG_TOKEN if bears_wrong_token(scope, self.tokens) else 1.0
        wait_s = self._allowances.take(client, price, now_s=asyncio.get_running_loop().time())
        if wait_s > 0.0:
            await too_many("too many requests from this address", scope, wait_s=wait_s)(scope, receive, send)
        else:
            priced = send if price == 1.0 else self._refund_price(self._allowances, client, price - 1.0, send)
            await self.app(scope, receive, priced)

    @staticmethod
    def _refund_price(allowances: TokenBuckets, client: str, price: float, send: Send) -> Send:
        """Return the price to the client where no token was needed: a proxy's own request, or open reading."""

        async def sending(message: Message) -> None:
            if message["type"] == "http.response.start" and message["status"] != HTTPStatus.UNAUTHORIZED:
                allowances.give_back(client, price, now_s=asyncio.get_running_loop().time())
            await send(message)

        return sending


def too_many(
    problem: str, scope: Scope, status: HTTPStatus = HTTPStatus.TOO_MANY_REQUESTS, *, wait_s: float = 1.0
) -> ASGIApp:
    """Return the refusal of a request beyond a limit, with the seconds to wait."""
    seconds = math.ceil(wait_s)
    remedy = f"wait {seconds} s and try again, with more pixels per request where there are many"
    fault = Fault(field="request", problem=problem, remedy=remedy)
    return problem_response(
        status,
        path=scope["path"],
        detail=f"{fault.problem}; {fault.remedy}",
        errors=[fault],
        headers={"retry-after": str(seconds)},
    )


def _refuse_garbled(scope: Scope, error: ClientAddressError) -> ASGIApp:
    remedy = "let the proxy set X-Forwarded-For to the client's address alone"
    fault = Fault(field="x-forwarded-for", problem=str(error), remedy=remedy)
    return refusal_response(scope["path"], RefusedError(HTTPStatus.BAD_REQUEST, fault))


_HOST = re.compile(r"(\[[0-9A-Fa-f:.]+\]|[^:\[\]]+)(?::[0-9]{1,5})?")


def host_names(options: ApiOptions) -> frozenset[str]:
    """Return the names that are answered: localhost, the name bound to, the host's own, and those that are set."""
    host_name = socket.gethostname()
    names = ("localhost", options.host, host_name, host_name.partition(".")[0], *options.allowed_hosts)
    return frozenset(name.lower().rstrip(".") for name in names if name)


@dataclass(kw_only=True, eq=False)
class AllowedHosts(HttpMiddleware):
    """Refuses requests (421) whose Host header has a name that is not this service's.

    In a DNS rebinding attack the browser sends the attacker's name. Addresses are always answered: an address cannot
    be rebound, and clients behind a port forwarding use one that the host does not know. A request without the
    header is not a browser's.

    Parameters
    ----------
    names : those that are answered, in lower case.
    """

    names: frozenset[str]

    async def answer(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass a request on, or refuse it."""
        if scope["type"] == "http" and not is_always_answered(scope):
            host = Headers(scope=scope).get("host", "")
            if host and not self._is_allowed(host):
                await _make_refusal(scope["path"], host)(scope, receive, send)
                return
        await self.app(scope, receive, send)

    def _is_allowed(self, host: str) -> bool:
        found = _HOST.fullmatch(host)
        if found is None:
            return False
        name = found[1].lower().rstrip(".")
        if name in self.names or name.endswith(".localhost"):
            return True
        return len(name) <= LONGEST_ADDRESS and _is_address(name.strip("[]"))


@lru_cache
def _is_address(name: str) -> bool:
    try:
        ip_address(name)
    except ValueError:
        return False
    return True


def _make_refusal(path: str, host: str) -> ASGIApp:
    fault = Fault(
        field="host",
        problem=f"{host[:64]!r} is not a name of this service",
        remedy="ask by its address, or add the name to api.allowed_hosts",
    )
    return refusal_response(path, RefusedError(HTTPStatus.MISDIRECTED_REQUEST, fault))
