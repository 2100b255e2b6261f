"""Requests to a hub."""

from __future__ import annotations

import gzip
import http.client
import json
import ssl
import urllib.parse
import urllib.request
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from http import HTTPStatus
from pathlib import Path

import h11

from sunarc.archive.feed_values import FeedRow, feed_lines
from sunarc.archive.outbox import OutboxPosition
from sunarc.archive.schema import head_revision
from sunarc.errors import ConfigurationError, InputError, OutsideError
from sunarc.runtime.clock import Clock
from sunarc.workers.http_exchange import HttpRequest, Limit, UnfinishedError, exchange

_WITHIN_S = 30.0
"""From the beginning of the connection to the end of the answer; more rows than go in that time are sent in parts."""
_LEAST_BYTES_PER_S = 500.0
"""One row can be sent in no parts: it has the time that it takes at this rate besides."""
_MOST_READ_BYTES = 65_536
_COMPRESSION_LEVEL = 4  # rows become a tenth; higher levels cost more time than they save


@dataclass(frozen=True, slots=True, kw_only=True)
class HubOptions:
    """The hub that an imager sends its archive's rows to.

    Attributes
    ----------
    url : its address, as "https://fleet.example"; None: nothing is sent.
    token_file : a file whose one line is the camera's token, made on the hub by `sunarc hub token`.
    """

    url: str | None = None
    token_file: Path | None = None

    def __post_init__(self) -> None:
        """Refuse an address that is none."""
        parts = urllib.parse.urlsplit("https://none" if self.url is None else self.url)
        if parts.scheme not in {"http", "https"} or not parts.hostname or parts.query or parts.username:
            remedy = "give one as https://fleet.example"
            raise InputError(field="hub.url", problem=f"{self.url!r} is no address", remedy=remedy)
        if self.url is not None and self.token_file is None:
            raise InputError(field="hub.token_file", problem="is missing", remedy="sunarc hub token makes a token")


class HubRefusal(Exception):  # noqa: N818 - an answer, and no fault
    """The hub refuses what was sent.

    Parameters
    ----------
    status : the HTTP status.
    text : why.
    """

    def __init__(self, status: int, text: str) -> None:
        super().__init__(text)
        self.status = status


class HubUnfinishedError(OutsideError):
    """The hub was reached, and not all was sent, stored and answered in time: fewer rows may be."""


Send = Callable[[OutboxPosition, Sequence[FeedRow], Callable[[], None]], int]
"""Sends rows that follow a position, with the caller's heartbeat, and returns the number that the hub answers."""


class HubConnection:
    """Sends rows of one camera to a hub.

    Parameters
    ----------
    options : with an address.
    camera : its name.
    clock : real time.

    Raises
    ------
    ConfigurationError : the token cannot be read.
    """

    def __init__(self, options: HubOptions, *, camera: str, clock: Clock) -> None:
        address = (options.url or "").rstrip("/")
        self._url = f"{address}/v1/cameras/{urllib.parse.quote(camera, safe='')}/feed"
        self._token = _token(options.token_file)
        self._context = ssl.create_default_context() if self._url.startswith("https:") else None
        self._clock = clock

    def send(self, position: OutboxPosition, rows: Sequence[FeedRow], heartbeat: Callable[[], None]) -> int:
        """Send rows that follow a position, and return the number up to which the hub has them.

        All of it takes at most 30 s, for one row more by its size; redirects are not followed, since the token would
        go to whatever host they name.

        Raises
        ------
        HubRefusal : the hub understood and refused.
        HubUnfinishedError : it was reached, and the exchange was cut off or took too long.
        OutsideError : it was not reached, or was not able to.
        """
        request = HttpRequest(
            method="PUT",
            url=urllib.parse.urlsplit(f"{self._url}?after={position.committed}"),
            body=gzip.compress(feed_lines(rows), _COMPRESSION_LEVEL, mtime=0),
            headers={
                "authorization": f"Bearer {self._token}",
                "content-type": "application/x-ndjson",
                "content-encoding": "gzip",
                "sunarc-installation": position.installation,
                "sunarc-revision": head_revision(),
            },
            proxy=_proxy_of(self._url),
        )
        within_s = _WITHIN_S + (len(request.body) / _LEAST_BYTES_PER_S if len(rows) == 1 else 0.0)
        limit = Limit(within_s, monotonic=self._clock.monotonic, heartbeat=heartbeat)
        try:
            status, body = exchange(request, context=self._context, limit=limit, most_bytes=_MOST_READ_BYTES)
            if HTTPStatus.OK <= status < HTTPStatus.MULTIPLE_CHOICES:
                return int(json.loads(body)["committed"])
        except (UnfinishedError, h11.RemoteProtocolError) as error:
            raise HubUnfinishedError(f"the hub {self._url}: {error}") from error
        except (OSError, ValueError, KeyError, TypeError, h11.LocalProtocolError) as error:
            raise OutsideError(f"the hub {self._url}: {error}") from error
        raise _failure(status, body)


def _failure(status: int, body: bytes) -> HubRefusal | OutsideError:
    try:
        text = str(json.loads(body)["detail"])
    except (ValueError, KeyError, TypeError):
        text = http.client.responses.get(status, "")
    if status in {HTTPStatus.REQUEST_TIMEOUT, HTTPStatus.GATEWAY_TIMEOUT}:
        return HubUnfinishedError(f"the hub answers {status}: {text}")
    if status >= HTTPStatus.INTERNAL_SERVER_ERROR or status == HTTPStatus.TOO_MANY_REQUESTS:
        return OutsideError(f"the hub answers {status}: {text}")
    return HubRefusal(status, text)


def _proxy_of(url: str) -> urllib.parse.SplitResult | None:
    """Return the proxy that the environment names for an address (`https_proxy`, `no_proxy`); None without one."""
    parts = urllib.parse.urlsplit(url)
    found = urllib.request.getproxies_environment().get(parts.scheme)
    if not found or urllib.request.proxy_bypass(parts.netloc):
        return None
    return urllib.parse.urlsplit(found if "//" in found else f"//{found}")


def _token(path: Path | None) -> str:
    try:
        return "" if path is None else path.read_text("ascii").strip()
    except (OSError, UnicodeDecodeError) as error:
        raise ConfigurationError(f"hub.token_file {path}: {error}") from error
