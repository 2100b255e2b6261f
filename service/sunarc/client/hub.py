"""Requests to a hub: its fleet, and each of its cameras as an imager."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import date, datetime
from typing import Any

from .imager import Imager
from .requests import Requests, _format_day, _format_time, _quote_name


class Hub(Requests):
    """A hub's service.

    Parameters
    ----------
    address : as "https://fleet.example".
    token : where reading needs one.
    timeout_s : of one request.
    retries : how often a request is asked again after 429, 503 or no connection, waiting longer each time.
    """

    def __init__(self, address: str, *, token: str | None = None, timeout_s: float = 30.0, retries: int = 4) -> None:
        super().__init__(address, token=token, timeout_s=timeout_s, retries=retries)
        self._connection = {"address": address, "token": token, "timeout_s": timeout_s, "retries": retries}

    def imager(self, camera: str) -> Imager:
        """Return one of its cameras; a hub refuses requests that change something."""
        return Imager(**self._connection, camera=camera)  # type: ignore[arg-type]

    def fleet(self) -> dict[str, Any]:
        """Return every camera, the worst first."""
        return self._ask_json("/fleet")

    def cross_checks(self, camera: str | None = None) -> dict[str, Any]:
        """Return the clock, longitude and north of each camera by its neighbours of last night, alarms first."""
        return self._ask_json("/cross-checks", camera=camera)

    def quarantine(self, camera: str | None = None, *, limit: int | None = None) -> dict[str, Any]:
        """Return the rows that were refused or set apart, the newest first."""
        return self._ask_json("/quarantine", camera=camera, limit=_format_count(limit))

    def nights(self, *, limit: int | None = None) -> dict[str, Any]:
        """Return how the work of the last nights went, the newest first."""
        return self._ask_json("/nightly", limit=_format_count(limit))

    def summaries(
        self,
        camera: str | None = None,
        *,
        since: date | None = None,
        until: date | None = None,
        limit: int | None = None,
    ) -> dict[str, Any]:
        """Return solar days with `since` <= date < `until`, the newest first."""
        return self._ask_json(
            "/summaries", camera=camera, since=_format_day(since), until=_format_day(until), limit=_format_count(limit)
        )

    def pair_height(
        self,
        first: str,
        second: str,
        *,
        at: datetime,
        first_pixel: Sequence[float],
        second_pixel: Sequence[float],
    ) -> dict[str, Any]:
        """Return the height of a point that two cameras see at a time, each in its pixel (x, y)."""
        path = f"/pairs/{_quote_name(first)}/{_quote_name(second)}/height"
        return self._ask_change(path, time=_format_time(at), pixel_a=list(first_pixel), pixel_b=list(second_pixel))


def _format_count(number: int | None) -> str | None:
    return None if number is None else str(number)
