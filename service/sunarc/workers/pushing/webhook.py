"""Webhooks: a notice as a signed POST, in the form of Standard Webhooks 1.0."""

from __future__ import annotations

import base64
import hashlib
import hmac
import json
import ssl
import urllib.parse
from collections.abc import Callable
from http import HTTPStatus
from pathlib import Path

import h11

from sunarc.archive.notices import Notice
from sunarc.errors import OutsideError
from sunarc.runtime.clock import Clock
from sunarc.utc import rfc3339
from sunarc.workers.http_exchange import HttpRequest, Limit, UnfinishedError, connected, exchange
from sunarc.workers.pushing.options import read_secret
from sunarc.workers.pushing.push import NoticeRefusedError

_WITHIN_S = 15.0
"""From the beginning of the connection to the status line of the answer."""
_RETRIED = {HTTPStatus.REQUEST_TIMEOUT, HTTPStatus.TOO_EARLY, HTTPStatus.TOO_MANY_REQUESTS}


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

    def refresh(self, heartbeat: Callable[[], None]) -> None:
        """Read the key, if it is not there yet: a webhook keeps no state of the cameras."""
        del heartbeat
        self._read_key()

    def probe(self) -> None:
        """Read the key, connect, and end the connection."""
        self._read_key()
        request = HttpRequest(method="POST", url=self._url, headers={}, body=b"")
        try:
            connected(request, self._context, self._limit(lambda: None)).close()
        except (OSError, ValueError) as error:
            raise OutsideError(f"{self._url.hostname}: {error}") from error

    def close(self, *, orderly: bool) -> None:
        """Do nothing: every notice has a connection of its own."""

    def deliver(self, notice: Notice, heartbeat: Callable[[], None]) -> None:
        """Post a notice, and wait for the status of the answer."""
        self._read_key()
        body = json.dumps(message_of(notice), separators=(",", ":")).encode()
        timestamp = str(int(self._clock.now().timestamp()))
        headers = {
            "content-type": "application/json",
            "user-agent": "sunarc",
            "webhook-id": notice.id,
            "webhook-timestamp": timestamp,
            "webhook-signature": signature(self._key, notice.id, timestamp, body),
        }
        request = HttpRequest(method="POST", url=self._url, headers=headers, body=body)
        try:
            status, _ = exchange(request, context=self._context, limit=self._limit(heartbeat))
        except (OSError, ValueError, UnfinishedError, h11.RemoteProtocolError) as error:
            raise OutsideError(f"{self._url.hostname}: {error}") from error
        if HTTPStatus.OK <= status < HTTPStatus.MULTIPLE_CHOICES:
            return
        if status >= HTTPStatus.INTERNAL_SERVER_ERROR or status in _RETRIED:
            raise OutsideError(f"{self._url.hostname} answers {status}")
        raise NoticeRefusedError(f"{self._url.hostname} answers {status}")

    def _read_key(self) -> None:
        self._key = self._key or read_secret(self._secret_file)

    def _limit(self, heartbeat: Callable[[], None]) -> Limit:
        return Limit(_WITHIN_S, monotonic=self._clock.monotonic, heartbeat=heartbeat)


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
