"""The connection of an imager to its hub: sent rows, and the hub's answers about its stored rows."""

from __future__ import annotations

import gzip
import http.client
import json
import math
import urllib.parse
import urllib.request
from collections.abc import Callable, Mapping, Sequence
from datetime import date
from http import HTTPStatus
from pathlib import Path
from types import MappingProxyType
from typing import Any

from pydantic import TypeAdapter, ValidationError

from sunarc.common.errors import ConfigurationError, OutsideError
from sunarc.common.foreign_files import MOST_SECRET_BYTES, read_regular
from sunarc.imager.archive.database.connections import parsed_json
from sunarc.imager.archive.database.schema import head_revision
from sunarc.imager.archive.day_digests import StoredDays
from sunarc.imager.archive.feed_rows import FeedRow, feed_lines
from sunarc.imager.archive.outbox import OutboxPosition
from sunarc.imager.runtime.clock import Clock
from sunarc.imager.runtime.http_exchange import HttpAnswer, HttpRequest, Limit, Trust, UnfinishedError, fetch
from sunarc.imager.workers.options import HubOptions

_WITHIN_S = 30.0
"""From the beginning of the connection to the end of the answer; more rows than go in that time are sent in parts."""
_LEAST_BYTES_PER_S = 500.0
"""One row can be sent in no parts: it has the time that it takes at this rate besides."""
_MOST_READ_BYTES = 65_536
_MOST_QUOTED = 100
_LONGEST_ASKED_S = 600.0
"""No answer makes a sender wait for longer: a proxy's own may name hours."""
_COMPRESSION_LEVEL = 4  # rows become a tenth; higher levels cost more time than they save


class HubRefusal(Exception):  # noqa: N818 - an answer, and no fault
    """Refusal of a batch by the hub.

    Parameters
    ----------
    status : the HTTP status.
    text : why.
    """

    def __init__(self, status: int, text: str) -> None:
        super().__init__(text)
        self.status = status


class HubUnfinishedError(OutsideError):
    """Error of an exchange with the hub that did not end in time; fewer rows may fit."""


class HubAnswerError(OutsideError):
    """Error of an answer that cannot be a hub's: from a proxy, or a faulty hub."""


_STORED_DAYS = TypeAdapter(StoredDays)

AskStoredDays = Callable[[str, date, date, Callable[[], None]], StoredDays]
"""Asks as an installation for a hub's rows of the days from one to before another, with the caller's heartbeat."""
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
        self._trust = Trust() if self._url.startswith("https:") else None
        self._clock = clock
        self._asked_until_s = -math.inf

    def wait_s(self) -> float:
        """Return for how many seconds more the hub's last answer asks to wait (Retry-After)."""
        return max(self._asked_until_s - self._clock.monotonic(), 0.0)

    def send(self, position: OutboxPosition, rows: Sequence[FeedRow], heartbeat: Callable[[], None]) -> int:
        """Send rows that follow a position, and return the number up to which the hub has them.

        All of it takes at most 30 s, for one row more by its size; redirects are not followed, since the token would
        go to whatever host they name.

        Raises
        ------
        HubRefusal : the hub understood and refused.
        HubUnfinishedError : it was reached, and the exchange was cut off or took too long.
        HubAnswerError : the answer has no number that a hub could give.
        OutsideError : it was not reached, or was not able to.
        """
        body = gzip.compress(feed_lines(rows), _COMPRESSION_LEVEL, mtime=0)
        headers = {"content-type": "application/x-ndjson", "content-encoding": "gzip"}
        within_s = _WITHIN_S + (len(body) / _LEAST_BYTES_PER_S if len(rows) == 1 else 0.0)
        limit = Limit(within_s, monotonic=self._clock.monotonic, heartbeat=heartbeat)
        query = f"after={position.committed}"
        answer = self._exchange_with_hub("PUT", query, position.installation, limit, body=body, headers=headers)
        asked = answer.headers.get("retry-after", "")
        asked_s = float(asked) if asked.isdecimal() else 0.0  # a date is no hub's
        self._asked_until_s = self._clock.monotonic() + min(asked_s, _LONGEST_ASKED_S)
        number = _parse_answer(answer).get("committed")
        if type(number) is not int or not -1 <= number < 2**63:
            raise HubAnswerError(f"{_quote_body(answer.body)}, which has no number `committed` from -1 on")
        return number

    def stored_days(self, installation: str, since: date, until: date, heartbeat: Callable[[], None]) -> StoredDays:
        """Return the hub's rows of the days `since` <= day < `until`, as many as it answers at once.

        Raises
        ------
        HubRefusal, HubUnfinishedError, HubAnswerError, OutsideError : as of `send`.
        """
        limit = Limit(_WITHIN_S, monotonic=self._clock.monotonic, heartbeat=heartbeat)
        answer = self._exchange_with_hub("GET", f"since={since}&until={until}", installation, limit)
        try:
            return _STORED_DAYS.validate_python(_parse_answer(answer))
        except ValidationError:
            raise HubAnswerError(f"{_quote_body(answer.body)}, which says nothing of days") from None

    def _exchange_with_hub(  # noqa: PLR0917 - of a request
        self,
        method: str,
        query: str,
        installation: str,
        limit: Limit,
        body: bytes = b"",
        headers: Mapping[str, str] = MappingProxyType({}),
    ) -> HttpAnswer:
        request = HttpRequest(
            method=method,
            url=urllib.parse.urlsplit(f"{self._url}?{query}"),
            body=body,
            headers={
                "authorization": f"Bearer {self._token}",
                "sunarc-installation": installation,
                "sunarc-revision": head_revision(),
                **headers,
            },
            proxy=_find_proxy(self._url),
        )
        try:
            context = None if self._trust is None else self._trust.context()
            return fetch(request, context=context, limit=limit, most_bytes=_MOST_READ_BYTES)
        except UnfinishedError as error:
            raise HubUnfinishedError(f"the hub {self._url}: {error}") from error
        except OSError as error:
            raise OutsideError(f"the hub {self._url}: {error}") from error


def _parse_answer(answer: HttpAnswer) -> dict[str, Any]:
    """Return the JSON object of an answer."""
    if not HTTPStatus.OK <= answer.status < HTTPStatus.MULTIPLE_CHOICES:
        raise _make_failure(answer.status, answer.body)
    found = parsed_json(answer.body)
    if not isinstance(found, dict):
        raise HubAnswerError(f"{_quote_body(answer.body)}, which is no JSON object")
    return found


def _quote_body(body: bytes) -> str:
    return repr(body[:_MOST_QUOTED].decode("utf-8", "replace"))


def _make_failure(status: int, body: bytes) -> HubRefusal | OutsideError:
    try:
        text = str(json.loads(body)["detail"])
    except (ValueError, KeyError, TypeError):
        text = http.client.responses.get(status, "")
    if status in {HTTPStatus.REQUEST_TIMEOUT, HTTPStatus.GATEWAY_TIMEOUT}:
        return HubUnfinishedError(f"the hub answers {status}: {text}")
    if status >= HTTPStatus.INTERNAL_SERVER_ERROR or status == HTTPStatus.TOO_MANY_REQUESTS:
        return OutsideError(f"the hub answers {status}: {text}")
    return HubRefusal(status, text)


def _find_proxy(url: str) -> urllib.parse.SplitResult | None:
    """Return the proxy that the environment names for an address (`https_proxy`, `no_proxy`); None without one."""
    parts = urllib.parse.urlsplit(url)
    found = urllib.request.getproxies_environment().get(parts.scheme)
    if not found or urllib.request.proxy_bypass(parts.netloc):
        return None
    return urllib.parse.urlsplit(found if "//" in found else f"//{found}")


def _token(path: Path | None) -> str:
    try:
        return "" if path is None else read_regular(path, most_bytes=MOST_SECRET_BYTES).decode("ascii").strip()
    except (OSError, UnicodeDecodeError) as error:
        raise ConfigurationError(f"hub.token_file {path}: {error}") from error
