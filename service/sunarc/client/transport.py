"""Requests over HTTP, repeated where the service is busy or not reachable for a moment."""

from __future__ import annotations

import http.client
import io
import json
import socket
import time
import urllib.error
import urllib.parse
import urllib.request
from collections.abc import Iterator, Mapping
from http import HTTPStatus
from typing import Any

_AGAIN = (429, 503)
_NOT_SOON = "urn:sunarc:problem:no_calibration"
"""Type of a 503 that a clear day ends, not a moment."""
_FIRST_WAIT_S = 0.25
_LONGEST_WAIT_S = 10.0
_LEAST_BYTES_PER_S = 4000.0
"""The rate below which the service itself cuts a client off."""
_MOST_BYTES = 2_000_000_000
"""Of an answer: three times the longest one, positions of 4 million points in double precision."""
_MOST_REFUSAL_BYTES = 1_000_000
_LONGEST_LINE_BYTES = 1_000_000
"""Of a stream of events."""
_PART_BYTES = 1_048_576


class ImagerError(Exception):
    """Error of the service in place of an answer.

    Attributes
    ----------
    status : the HTTP status; None where nothing answered at all.
    problem : the problem document (RFC 9457): its `detail` says what is wrong, its `errors` where and what to do.
    """

    def __init__(self, message: str, *, status: int | None, problem: Mapping[str, Any] | None = None) -> None:
        super().__init__(message)
        self.status = status
        self.problem = dict(problem or {})


class _TimedSocket(io.RawIOBase):
    """Bytes of an answer, head and body, whose whole time is limited: a server that drips is cut off.

    Parameters
    ----------
    channel : the connection; its timeout is that of the whole, to which the bytes that come add.
    raw : reads from it.
    """

    def __init__(self, channel: socket.socket, raw: io.RawIOBase) -> None:
        self._channel, self._raw = channel, raw
        self._timeout_s = channel.gettimeout()
        self._until_s = _read_monotonic_s() + (self._timeout_s or 0.0)

    def readable(self) -> bool:
        """Return True."""
        return True

    def readinto(self, buffer: Any) -> int | None:  # noqa: ANN401 - a writable buffer
        """Read the next bytes; TimeoutError where too few came in the time."""
        if self._timeout_s is not None:
            left_s = self._until_s - _read_monotonic_s()
            if left_s <= 0.0:
                raise TimeoutError(f"less than {_LEAST_BYTES_PER_S:g} bytes per second came")
            self._channel.settimeout(min(left_s, self._timeout_s))
        count = self._raw.readinto(buffer)
        self._until_s += (count or 0) / _LEAST_BYTES_PER_S
        return count

    def close(self) -> None:
        """Close the connection with it."""
        self._raw.close()
        super().close()


class _TimedResponse(http.client.HTTPResponse):
    def __init__(self, sock: socket.socket, *args: Any, **how: Any) -> None:  # noqa: ANN401 - of http.client
        super().__init__(sock, *args, **how)
        self.fp = io.BufferedReader(_TimedSocket(sock, self.fp.detach()))


class _TimedConnection(http.client.HTTPConnection):
    response_class = _TimedResponse


class _TimedTlsConnection(http.client.HTTPSConnection):
    response_class = _TimedResponse


class _TimedHttp(urllib.request.HTTPHandler):
    def http_open(self, req: urllib.request.Request) -> http.client.HTTPResponse:
        return self.do_open(_TimedConnection, req)


class _TimedHttps(urllib.request.HTTPSHandler):
    def https_open(self, req: urllib.request.Request) -> http.client.HTTPResponse:
        return self.do_open(_TimedTlsConnection, req)


def _read_monotonic_s() -> float:
    return time.monotonic()  # noqa: TID251 - it stands outside the service and its clock


def _read_content(answer: http.client.HTTPResponse) -> bytes:
    """Return the whole content of an answer; HTTPException where it is cut off, or too long."""
    parts, left = [], _MOST_BYTES
    while part := answer.read(_PART_BYTES):
        parts.append(part)
        left -= len(part)
        if left < 0:
            raise http.client.HTTPException(f"the answer has more than {_MOST_BYTES} bytes")
    if answer.length:
        raise http.client.IncompleteRead(b"", answer.length)
    return b"".join(parts)


class _NoRedirect(urllib.request.HTTPRedirectHandler):
    """Leaves a redirect as the answer: urllib would send the token to whatever host it names."""

    def redirect_request(self, *_: object) -> None:
        """Return no further request."""


class Transport:
    """HTTP requests to one service at its own address; a redirect is an `ImagerError` that names the new address.

    Parameters
    ----------
    address : as "http://imager:8080".
    token : sent with every request.
    timeout_s : of one request: of connecting, of sending it, and of an answer, which has a second more for every 4 kB
        that came, and 2 GB at most.
    retries : how often a request is asked again after 429, 503 or no connection.
    """

    def __init__(self, address: str, *, token: str | None, timeout_s: float, retries: int) -> None:
        if urllib.parse.urlsplit(address).scheme not in {"http", "https"}:
            raise ValueError(f"{address!r} is not an address; give one as http://imager:8080")
        self._address = address.rstrip("/")
        self._headers = {} if token is None else {"Authorization": f"Bearer {token}"}
        self._timeout_s = timeout_s
        self._retries = retries
        self._opener = urllib.request.build_opener(_NoRedirect, _TimedHttp, _TimedHttps)
        self._of_streams = urllib.request.build_opener(_NoRedirect)

    def ask(
        self,
        path: str,
        query: Mapping[str, str | None],
        *,
        body: bytes | None = None,
        media_type: str | None = None,
        again: bool = True,
    ) -> tuple[bytes, Mapping[str, str]]:
        """Return the content and the headers of an answer; ImagerError where it is a refusal, or is missing.

        `again` says whether a request that failed for the moment is repeated.
        """
        headers = {} if media_type is None else {"Content-Type": media_type}
        return self._repeat_request(self._make_request(path, query, headers, body=body), again=again)

    def ask_if_changed(
        self, path: str, query: Mapping[str, str | None], *, tag: str | None
    ) -> tuple[bytes, Mapping[str, str]] | None:
        """Return the content as `ask` does; None where the answer still has an ETag."""
        headers = {} if tag is None else {"If-None-Match": tag}
        try:
            return self._repeat_request(self._make_request(path, query, headers), again=False)
        except ImagerError as error:
            if error.status == HTTPStatus.NOT_MODIFIED:
                return None
            raise

    def change(self, path: str, body: bytes, *, method: str) -> bytes:
        """Return the content of the answer to a change, which is asked for once: it may have been made."""
        request = self._make_request(path, {}, {"Content-Type": "application/json"}, body=body, method=method)
        return self._repeat_request(request, again=False)[0]

    def _make_request(
        self,
        path: str,
        query: Mapping[str, str | None],
        headers: Mapping[str, str],
        *,
        body: bytes | None = None,
        method: str | None = None,
    ) -> urllib.request.Request:
        given = urllib.parse.urlencode({name: value for name, value in query.items() if value is not None})
        return urllib.request.Request(  # noqa: S310 - http and https alone
            f"{self._address}{path}?{given}", data=body, headers={**self._headers, **headers}, method=method
        )

    def _repeat_request(self, request: urllib.request.Request, *, again: bool) -> tuple[bytes, Mapping[str, str]]:
        for attempt in range(self._retries + 1):
            try:
                return self._send_request(request)
            except ImagerError as error:
                if not again:
                    raise
                self.wait(error, attempt)
        raise AssertionError("unreachable")

    def lines(self, path: str, *, headers: Mapping[str, str], silent_s: float) -> Iterator[str]:
        """Yield the lines of an endless answer, until it ends or nothing comes for `silent_s`; ImagerError if refused.

        Nothing is asked again.
        """
        request = urllib.request.Request(f"{self._address}{path}", headers={**self._headers, **headers})  # noqa: S310
        try:
            with self._of_streams.open(request, timeout=silent_s) as answer:
                while line := answer.readline(_LONGEST_LINE_BYTES):
                    yield line.decode("utf-8", "replace").rstrip("\r\n")
        except urllib.error.HTTPError as error:
            with error:
                raise _make_refusal(error) from None
        except (OSError, http.client.HTTPException) as error:
            raise ImagerError(f"{self._address} does not answer: {error}", status=None) from error

    def wait(self, error: ImagerError, attempt: int) -> None:
        """Wait before a request that failed is asked again; raise the error where it would fail again, or often did."""
        if attempt >= self._retries or error.status not in (None, *_AGAIN) or _NOT_SOON in error.problem.values():
            raise error
        time.sleep(retry_wait_s(error, attempt))  # noqa: TID251 - it stands outside the service and its clock

    def _send_request(self, request: urllib.request.Request) -> tuple[bytes, Mapping[str, str]]:
        try:
            with self._opener.open(request, timeout=self._timeout_s) as answer:
                return _read_content(answer), answer.headers
        except urllib.error.HTTPError as error:
            with error:
                raise _make_refusal(error) from None
        except (OSError, http.client.HTTPException) as error:
            raise ImagerError(f"{self._address} does not answer: {error}", status=None) from error


def _make_refusal(error: urllib.error.HTTPError) -> ImagerError:
    try:
        problem = json.loads(error.read(_MOST_REFUSAL_BYTES))
    except (ValueError, OSError, http.client.HTTPException):  # no JSON, or the connection ended within it
        problem = {}
    problem = problem if isinstance(problem, dict) else {}
    moved_to = error.headers.get("Location")
    reason = error.reason if moved_to is None else f"moved to {moved_to}; give that address if it is the imager's"
    refusal = ImagerError(str(problem.get("detail", reason)), status=error.code, problem=problem)
    refusal.problem.setdefault("retry_after_s", error.headers.get("Retry-After"))
    return refusal


def retry_wait_s(error: ImagerError, attempt: int) -> float:
    """Return how long to wait before a request is asked again, s."""
    retry_after = str(error.problem.get("retry_after_s") or "")
    wait_s = float(retry_after) if retry_after.isdecimal() else _FIRST_WAIT_S * 2.0**attempt
    return min(wait_s, _LONGEST_WAIT_S)
