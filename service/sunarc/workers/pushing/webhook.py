"""Webhooks: a notice as a signed POST, in the form of Standard Webhooks 1.0."""

from __future__ import annotations

import base64
import hashlib
import hmac
import json
import socket
import ssl
import urllib.parse
from collections.abc import Callable, Mapping
from http import HTTPStatus
from pathlib import Path

import h11

from sunarc.archive import Notice
from sunarc.errors import OutsideError
from sunarc.runtime.clock import Clock
from sunarc.utc import rfc3339
from sunarc.workers.pushing.options import read_secret
from sunarc.workers.pushing.push import NoticeRefusedError

_WITHIN_S = 15.0
"""From the beginning of the connection to the status line of the answer; a worker may be silent for 120 s."""
_LEAST_S = 0.01
_MOST_ADDRESSES = 4
"""Of a host that has many."""
_RETRIED = {HTTPStatus.REQUEST_TIMEOUT, HTTPStatus.TOO_EARLY, HTTPStatus.TOO_MANY_REQUESTS}
_LONGEST_LINE = 65_536


class Webhook:
    """A receiver of signed POSTs.

    Redirects are not followed and nothing of a row is in the address: only what is set is connected to.

    Parameters
    ----------
    url : checked address.
    secret_file : with the key of the signature; read when it is first needed.
    clock : real time.
    """

    def __init__(self, url: str, *, secret_file: Path | None, clock: Clock) -> None:
        self.name = webhook_name(url)
        self._url = urllib.parse.urlsplit(url)
        self._secret_file = secret_file
        self._key = b""
        self._context = ssl.create_default_context() if self._url.scheme == "https" else None
        self._clock = clock

    def refresh(self) -> None:
        """Read the key, if it is not there yet: a webhook keeps no state of the cameras."""
        self._key = self._key or read_secret(self._secret_file)

    def probe(self) -> None:
        """Read the key, connect, and end the connection."""
        self.refresh()
        until_s = self._clock.monotonic() + _WITHIN_S
        try:
            _connected(self._url, self._context, lambda: max(until_s - self._clock.monotonic(), _LEAST_S)).close()
        except (OSError, ValueError) as error:
            raise OutsideError(f"{self._url.hostname}: {error}") from error

    def close(self, *, orderly: bool) -> None:
        """Do nothing: every notice has a connection of its own."""

    def deliver(self, notice: Notice) -> None:
        """Post a notice, and wait for the status of the answer."""
        self.refresh()
        body = json.dumps(message_of(notice), separators=(",", ":")).encode()
        timestamp = str(int(self._clock.now().timestamp()))
        headers = {
            "content-type": "application/json",
            "user-agent": "sunarc",
            "webhook-id": notice.id,
            "webhook-timestamp": timestamp,
            "webhook-signature": signature(self._key, notice.id, timestamp, body),
        }
        try:
            status = post(self._url, headers=headers, body=body, context=self._context, monotonic=self._clock.monotonic)
        except (OSError, ValueError, h11.RemoteProtocolError) as error:
            raise OutsideError(f"{self._url.hostname}: {error}") from error
        if HTTPStatus.OK <= status < HTTPStatus.MULTIPLE_CHOICES:
            return
        if status >= HTTPStatus.INTERNAL_SERVER_ERROR or status in _RETRIED:
            raise OutsideError(f"{self._url.hostname} answers {status}")
        raise NoticeRefusedError(f"{self._url.hostname} answers {status}")


def webhook_name(url: str) -> str:
    """Return the name of a receiver: its host, and a digest, since an address may hold a secret."""
    digest = hashlib.sha256(url.encode()).hexdigest()[:8]
    return f"webhook_{urllib.parse.urlsplit(url).hostname}_{digest}"


def message_of(notice: Notice) -> dict[str, object]:
    """Return a notice as the JSON object that receivers get."""
    return {
        "id": notice.id,
        "type": notice.kind,
        "timestamp": rfc3339(notice.time),
        "camera": notice.camera,
        "data": notice.data,
    }


def signature(key: bytes, identity: str, timestamp: str, body: bytes) -> str:
    """Return the value of `webhook-signature`: HMAC-SHA256 of id, time and body."""
    mac = hmac.new(key, f"{identity}.{timestamp}.".encode() + body, hashlib.sha256)
    return f"v1,{base64.b64encode(mac.digest()).decode()}"


def post(
    url: urllib.parse.SplitResult,
    *,
    headers: Mapping[str, str],
    body: bytes,
    context: ssl.SSLContext | None,
    monotonic: Callable[[], float],
    within_s: float = _WITHIN_S,
) -> int:
    """Post a body, and return the status of the answer.

    All of it takes at most `within_s` (a name that is not resolved, as long as the host's resolver), however slowly
    bytes come; `urllib` and `http.client` limit the time between two bytes alone.

    Raises
    ------
    OSError : no connection, no TLS, or no answer in time.
    h11.RemoteProtocolError : the answer is no HTTP.
    """
    until_s = monotonic() + within_s

    def left_s() -> float:
        left = until_s - monotonic()
        if left <= 0.0:
            raise TimeoutError(f"no answer within {within_s:g} s")
        return left

    connection = h11.Connection(h11.CLIENT, max_incomplete_event_size=_LONGEST_LINE)
    path = (url.path or "/") + (f"?{url.query}" if url.query else "")
    lines = {"host": url.netloc, "content-length": str(len(body)), "connection": "close", **headers}
    events = (h11.Request(method="POST", target=path, headers=list(lines.items())), h11.Data(data=body))
    sent = b"".join(connection.send(event) or b"" for event in (*events, h11.EndOfMessage()))
    with _connected(url, context, left_s) as channel:
        channel.settimeout(left_s())
        channel.sendall(sent)
        while True:
            event = connection.next_event()
            if isinstance(event, h11.Response):
                return event.status_code
            if event is h11.NEED_DATA:
                channel.settimeout(left_s())
                connection.receive_data(channel.recv(_LONGEST_LINE))


def _connected(
    url: urllib.parse.SplitResult, context: ssl.SSLContext | None, left_s: Callable[[], float]
) -> socket.socket:
    """Return a connection to the first address of a host that answers, with TLS where there is a context."""
    host, port = url.hostname or "", url.port or (443 if url.scheme == "https" else 80)
    error: OSError = OSError("the name has no address")
    for _, _, _, _, address in socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[:_MOST_ADDRESSES]:
        try:
            channel = socket.create_connection((str(address[0]), port), timeout=left_s())
            break
        except TimeoutError:
            raise
        except OSError as refused:
            error = refused
    else:
        raise error
    if context is None:
        return channel
    try:
        channel.settimeout(left_s())
        return context.wrap_socket(channel, server_hostname=host)
    except BaseException:
        channel.close()
        raise
