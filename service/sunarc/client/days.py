"""What can be asked of days and nights."""

from __future__ import annotations

from collections.abc import Iterator
from datetime import date, datetime
from typing import Any

from .requests import Requests, _day, _time


class Days(Requests):
    """The requests that concern days and nights; see `Imager`."""

    def sightings_by_day(self, *, since: date | None = None, until: date | None = None) -> list[dict[str, Any]]:
        """Return how many looks at the sun had which verdict on each solar day, the newest first; 366 days at most."""
        return self._listed("/sun-points/days", "days", since=_day(since), until=_day(until))

    def days(self, *, since: date | None = None, until: date | None = None) -> Iterator[dict[str, Any]]:
        """Yield the verdicts of the solar days with since <= date < until, the newest first."""
        return self._pages("/days", "days", since=_day(since), until=_day(until))

    def housekeeping(
        self, *, step: str = "hour", since: datetime | None = None, until: datetime | None = None
    ) -> list[dict[str, Any]]:
        """Return free disk space and the camera's temperature by "hour" or "day", the newest first."""
        return self._listed("/housekeeping", "rows", step=step, since=_time(since), until=_time(until))

    def nights(self, *, images: bool = False) -> Iterator[dict[str, Any]]:
        """Yield the verdicts of the nights, the newest first, with the numbers of their images where asked for."""
        return self._pages("/nights", "nights", images="true" if images else None)

    def night_image(self, night: date) -> bytes:
        """Return the picture of a night, by the date of its evening, as JPEG."""
        return self._content(f"/nights/{night.isoformat()}/image")

    def night_bodies(self, night: date) -> dict[str, Any]:
        """Return the stars, planets and the moon in the picture of a night, and which were detected."""
        return self._json(f"/nights/{night.isoformat()}/bodies")

    def day_air(self, day: date) -> dict[str, Any]:
        """Return the air that was measured on a solar day."""
        return self._json(f"/days/{day.isoformat()}/air")

    def set_day_air(
        self, day: date, *, temperature_c: float | None = None, pressure_hpa: float | None = None
    ) -> dict[str, Any]:
        """Set the air that was measured on a solar day; None: not measured. Needs the token of changes."""
        air = {"temperature_c": temperature_c, "pressure_hpa": pressure_hpa}
        return self._change(f"/days/{day.isoformat()}/air", method="PUT", **air)
