"""Requests to a hub."""

from __future__ import annotations

import gzip
import http.client
import json
import urllib.error
import urllib.parse
import urllib.request
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from sunarc.archive import FeedRow, OutboxPosition, feed_lines, head_revision
from sunarc.errors import ConfigurationError, InputError, OutsideError

_TIMEOUT_S = 20.0  # less than the time without a heartbeat after which a worker is restarted
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


class _NoRedirect(urllib.request.HTTPRedirectHandler):
    """Leaves a redirect as the answer: urllib would send the token to whatever host it names."""

    def redirect_request(self, *_: object) -> None:
        """Return no further request."""


Send = Callable[[OutboxPosition, Sequence[FeedRow]], int]


class HubConnection:
    """Sends rows of one camera to a hub.

    Parameters
    ----------
    options : with an address.
    camera : its name.

    Raises
    ------
    ConfigurationError : the token cannot be read.
    """

    def __init__(self, options: HubOptions, *, camera: str) -> None:
        address = (options.url or "").rstrip("/")
        self._url = f"{address}/v1/cameras/{urllib.parse.quote(camera, safe='')}/feed"
        self._token = _token(options.token_file)
        self._opener = urllib.request.build_opener(_NoRedirect)

    def send(self, position: OutboxPosition, rows: Sequence[FeedRow]) -> int:
        """Send rows that follow a position, and return the number up to which the hub has them.

        Raises
        ------
        HubRefusal : the hub understood and refused.
        OutsideError : it did not answer, or was not able to.
        """
        request = urllib.request.Request(  # noqa: S310 - http and https alone
            f"{self._url}?after={position.committed}",
            data=gzip.compress(feed_lines(rows), _COMPRESSION_LEVEL, mtime=0),
            method="PUT",
            headers={
                "Authorization": f"Bearer {self._token}",
                "Content-Type": "application/x-ndjson",
                "Content-Encoding": "gzip",
                "Sunarc-Installation": position.installation,
                "Sunarc-Revision": head_revision(),
            },
        )
        try:
            with self._opener.open(request, timeout=_TIMEOUT_S) as answer:
                return int(json.loads(answer.read(_MOST_READ_BYTES))["committed"])
        except urllib.error.HTTPError as error:
            with error:
                raise _failure(error) from None
        except (OSError, http.client.HTTPException, ValueError, KeyError, TypeError) as error:
            raise OutsideError(f"the hub {self._url}: {error}") from error


def _failure(error: urllib.error.HTTPError) -> HubRefusal | OutsideError:
    try:
        text = str(json.loads(error.read(_MOST_READ_BYTES))["detail"])
    except (OSError, http.client.HTTPException, ValueError, KeyError, TypeError):
        text = error.reason
    if error.code >= 500 or error.code in {408, 429}:
        return OutsideError(f"the hub answers {error.code}: {text}")
    return HubRefusal(error.code, text)


def _token(path: Path | None) -> str:
    try:
        return "" if path is None else path.read_text("ascii").strip()
    except (OSError, UnicodeDecodeError) as error:
        raise ConfigurationError(f"hub.token_file {path}: {error}") from error
