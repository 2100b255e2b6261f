"""Who may read and who may change: a token that a file or a systemd credential holds."""

from __future__ import annotations

import hashlib
import hmac
import re
from collections.abc import Awaitable, Callable
from http import HTTPStatus
from pathlib import Path
from typing import Annotated

from fastapi import Security
from fastapi.security import HTTPAuthorizationCredentials, HTTPBearer
from starlette.datastructures import Headers
from starlette.types import ASGIApp, Receive, Scope, Send

from sunarc.api.problems import Fault, RefusedError, problem_response
from sunarc.errors import ConfigurationError

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
        token = path.read_bytes().strip()
    except OSError as error:
        raise ConfigurationError(f"{setting} {path}: {error.strerror}") from error
    if len(token) < _SHORTEST_TOKEN:
        raise ConfigurationError(f"{setting} {path}: a token has at least {_SHORTEST_TOKEN} characters")
    return _digest(token)


def require_write_token(token: bytes | None) -> Callable[..., Awaitable[None]]:
    """Return a dependency that refuses requests without the token of a digest, and all where there is none."""

    async def with_token(given: Annotated[HTTPAuthorizationCredentials | None, Security(_bearer)]) -> None:
        if token is None:
            fault = Fault(field="authorization", problem="nothing can be changed here", remedy="set api.token_file")
            raise RefusedError(HTTPStatus.FORBIDDEN, fault)
        if given is None or not _same(given.credentials, token):
            raise RefusedError(HTTPStatus.UNAUTHORIZED, _NO_TOKEN, headers=_CHALLENGE)

    return with_token


class ReadTokenMiddleware:
    """Refuses reads without one of the tokens; the empty page and the probes stay open.

    Parameters
    ----------
    app : what is behind it.
    tokens : the digests of those that open it.
    """

    def __init__(self, app: ASGIApp, *, tokens: tuple[bytes, ...]) -> None:
        self._app = app
        self._tokens = tokens

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass a request on, or refuse it."""
        if scope["type"] != "http" or _is_open(scope["path"]) or self._borne(scope):
            await self._app(scope, receive, send)
            return
        refusal = problem_response(
            HTTPStatus.UNAUTHORIZED,
            path=scope["path"],
            detail=f"{_NO_TOKEN.field}: {_NO_TOKEN.problem}; {_NO_TOKEN.remedy}",
            errors=[_NO_TOKEN],
            headers=_CHALLENGE,
        )
        await refusal(scope, receive, send)

    def _borne(self, scope: Scope) -> bool:
        given = _given(scope)
        return given is not None and _is_one_of(given, self._tokens)


def bears_wrong_token(scope: Scope, tokens: tuple[bytes, ...]) -> bool:
    """Return whether a request bears a token that is none of those of the digests; not so where there are none."""
    given = _given(scope)
    return bool(tokens) and given is not None and not _is_one_of(given, tokens)


def _given(scope: Scope) -> str | None:
    scheme, _, given = Headers(scope=scope).get("authorization", "").partition(" ")
    return given.strip() if scheme.lower() == "bearer" else None


def _is_one_of(given: str, tokens: tuple[bytes, ...]) -> bool:
    """Compare with every token, so that the time does not tell which one is meant."""
    return sum(_same(given, token) for token in tokens) > 0


def _is_open(path: str) -> bool:
    return path in _OPEN_PATHS or path.startswith(_OPEN_FOLDER) or FEED_PATH.fullmatch(path) is not None


def _same(given: str, token: bytes) -> bool:
    """Compare what is given with a token's digest, in a time that tells nothing of either."""
    return hmac.compare_digest(_digest(given.encode("utf-8", "replace")), token)


def _digest(token: bytes) -> bytes:
    return hashlib.sha256(token).digest()
