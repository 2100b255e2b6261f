"""What can be set about the web server."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from sunarc.errors import InputError

_COUNTS = (
    "max_body_bytes",
    "max_array_bytes",
    "max_points",
    "max_rows",
    "max_large_at_once",
    "max_connections",
    "max_at_once",
    "burst",
)


@dataclass(frozen=True, slots=True, kw_only=True)
class ApiOptions:
    """Where the service answers, to whom, and how much at once.

    Attributes
    ----------
    host, port : the address it listens on.
    token_file : a file whose one line is the token that changing anything needs; None: nothing can be changed here.
    read_token_file : likewise, for reading; None: whoever reaches the port may read.
    cors_origins : other sites whose pages may ask this service from a browser ("https://forecast.example").
    max_body_bytes : a larger request is refused (413).
    max_array_bytes : a larger request of .npy is refused (413).
    max_points : more pixels or directions in one request of JSON are refused (413).
    max_rows : more of them in one request of .npy are refused (413).
    obstruction_mask : an image of the camera's size, black where something hides the sky; it goes into the maps.
    max_large_at_once : large requests (of .npy, of long JSON, of exports that are to be made) that are answered at the
        same time; more are refused (429).
    max_connections : open connections; of more, the one that was idle longest is closed.
    max_at_once : requests being answered; more are refused (503).
    requests_per_s, burst : of one address, in the long run and after a pause; more are refused (429). Loopback is not
        counted. 0 requests_per_s: no limit.
    request_within_s : a request that is not there, or an answer that is not taken, after so long ends its connection.
    """

    host: str = "127.0.0.1"
    port: int = 8080
    token_file: Path | None = None
    read_token_file: Path | None = None
    cors_origins: tuple[str, ...] = ()
    max_body_bytes: int = 8_000_000
    max_array_bytes: int = 100_000_000
    max_points: int = 100_000
    max_rows: int = 4_000_000
    max_large_at_once: int = 4
    obstruction_mask: Path | None = None
    max_connections: int = 512
    max_at_once: int = 128
    requests_per_s: float = 100.0
    burst: int = 400
    request_within_s: float = 30.0

    def __post_init__(self) -> None:
        """Refuse what cannot be served."""
        if not 0 <= self.port <= 65_535:
            raise InputError(field="api.port", problem=f"{self.port} is no port", remedy="give 0 to 65535")
        for name in _COUNTS:
            if getattr(self, name) < 1:
                raise InputError(field=f"api.{name}", problem="not positive", remedy="give a number of at least 1")
        if self.requests_per_s < 0.0:
            raise InputError(field="api.requests_per_s", problem="negative", remedy="give 0 for no limit")
        if not 0.1 <= self.request_within_s <= 3600.0:
            raise InputError(field="api.request_within_s", problem="out of bounds", remedy="give 0.1 to 3600 seconds")
        for origin in self.cors_origins:
            if not origin.startswith(("http://", "https://")) or origin.count("/") != 2:
                raise InputError(
                    field="api.cors_origins",
                    problem=f"{origin!r} is no origin",
                    remedy="give scheme and host, as https://forecast.example",
                )
