"""What can be set about the web server."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from sunarc.errors import ConfigurationError, InputError

_SHORTEST_TOKEN = 16


@dataclass(frozen=True, slots=True, kw_only=True)
class ApiOptions:
    """Where the service answers, to whom, and how much at once.

    Attributes
    ----------
    host, port : the address it listens on.
    token_file : a file whose one line is the token that changing anything needs; None: nothing can be changed here.
    max_body_bytes : a larger request is refused (413).
    max_points : more pixels or directions in one request are refused (413).
    """

    host: str = "127.0.0.1"
    port: int = 8080
    token_file: Path | None = None
    max_body_bytes: int = 8_000_000
    max_points: int = 100_000

    def __post_init__(self) -> None:
        """Refuse what cannot be served."""
        if not 0 <= self.port <= 65_535:
            raise InputError(field="api.port", problem=f"{self.port} is no port", remedy="give 0 to 65535")
        for name in ("max_body_bytes", "max_points"):
            if getattr(self, name) < 1:
                raise InputError(field=f"api.{name}", problem="not positive", remedy="give a number of at least 1")


def read_token(path: Path | None) -> bytes | None:
    """Return the token that a file holds; None without a file.

    Raises
    ------
    ConfigurationError : the file cannot be read, or its token is too short to be one.
    """
    if path is None:
        return None
    try:
        token = path.read_bytes().strip()
    except OSError as error:
        raise ConfigurationError(f"api.token_file {path}: {error.strerror}") from error
    if len(token) < _SHORTEST_TOKEN:
        raise ConfigurationError(f"api.token_file {path}: a token has at least {_SHORTEST_TOKEN} characters")
    return token
