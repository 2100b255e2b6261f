"""Options of the web server."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from annotated_types import Ge, Le

from sunarc.common.bounds import Count, require_bounds
from sunarc.common.errors import InputError

MIN_RATE_BYTES_PER_S = 4000.0
"""A client that sends or reads more slowly is cut off; half the rate of a telephone modem."""

_MAX_ALLOWED_HOSTS = 64
_HOST_NAME = re.compile(r"[A-Za-z0-9_](?:[A-Za-z0-9._-]{0,252})")


@dataclass(frozen=True, slots=True, kw_only=True)
class ApiOptions:
    """Where the service answers, to whom, and how much at once.

    Attributes
    ----------
    host, port : the address it listens on.
    token_file : a file whose one line is the token that changing anything needs; unset: nothing can be changed here.
    read_token_file : likewise, for reading; unset: whoever reaches the port may read.
    allowed_hosts : names, besides localhost, `host` and the host's own, that the service answers to; a request for
        another name is refused (421). At most 64. Addresses are always answered.
    cors_origins : other sites whose pages may ask this service from a browser ("https://forecast.example").
    max_body_bytes : a larger request is refused (413).
    max_array_bytes : a larger request of .npy is refused (413).
    max_points : more pixels or directions in one request of JSON are refused (413).
    max_rows : more of them in one request of .npy are refused (413).
    obstruction_mask : an image of the camera's size, black where something hides the sky; it goes into the maps.
    max_large_at_once : large requests (of .npy, of long JSON) that are computed at the same time, and how many more of
        one address may wait (then 429); so many times `max_array_bytes` and 32 MB is the memory that requests may hold.
    max_connections : open connections; of more, the one that was idle longest is closed.
    max_at_once : requests being answered; more are refused (503).
    requests_per_s, burst : of one address, in the long run and after a pause; more are refused (429). Loopback is not
        counted. 0 requests_per_s: no limit.
    request_within_s : a head that is not there after so many seconds ends its connection, and so does a body or an
        answer of which less than 4 kB/s was sent or read for so long.
    """

    host: str = "127.0.0.1"
    port: Annotated[int, Ge(0), Le(65_535)] = 8080
    token_file: Path | None = None
    read_token_file: Path | None = None
    allowed_hosts: tuple[str, ...] = ()
    cors_origins: tuple[str, ...] = ()
    max_body_bytes: Count = 8_000_000
    max_array_bytes: Count = 100_000_000
    max_points: Count = 100_000
    max_rows: Count = 4_000_000
    max_large_at_once: Count = 4
    obstruction_mask: Path | None = None
    max_connections: Count = 512
    max_at_once: Count = 128
    requests_per_s: Annotated[float, Ge(0.0), Le(1e6)] = 100.0
    burst: Count = 400
    request_within_s: Annotated[float, Ge(0.1), Le(3600.0)] = 30.0

    def __post_init__(self) -> None:
        """Refuse options that cannot be served."""
        require_bounds(self, section_path="api")
        _check_hosts(self.allowed_hosts)
        for origin in self.cors_origins:
            if not origin.startswith(("http://", "https://")) or origin.count("/") != 2:
                raise InputError(
                    field="api.cors_origins",
                    problem=f"{origin!r} is not an origin",
                    remedy="give scheme and host, as https://forecast.example",
                )


def _check_hosts(names: tuple[str, ...]) -> None:
    if len(names) > _MAX_ALLOWED_HOSTS:
        problem = f"{len(names)} names, more than {_MAX_ALLOWED_HOSTS}"
        raise InputError(field="api.allowed_hosts", problem=problem, remedy="name those that clients use")
    for name in names:
        if not _HOST_NAME.fullmatch(name):
            remedy = "give it without scheme and port, as imager.example"
            raise InputError(field="api.allowed_hosts", problem=f"{name!r} is not a host name", remedy=remedy)
