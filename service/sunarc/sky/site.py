"""Where the camera stands, and the air above it."""

from __future__ import annotations

import math
from dataclasses import dataclass

from sunarc.errors import InputError


@dataclass(frozen=True, slots=True, kw_only=True)
class Site:
    """A place on the ground.

    Attributes
    ----------
    latitude : degrees, north positive.
    longitude : degrees, east positive.
    altitude : metres above sea level.
    pressure : annual mean air pressure in Pa; None takes it from the altitude (as pvlib's `alt2pres`).
    temperature : annual mean air temperature in °C.
    """

    latitude: float
    longitude: float
    altitude: float = 0.0
    pressure: float | None = None
    temperature: float = 12.0

    def __post_init__(self) -> None:
        """Refuse what is no place on Earth."""
        _within("latitude", self.latitude, -90.0, 90.0, "give degrees, north positive")
        _within("longitude", self.longitude, -180.0, 180.0, "give degrees, east positive")
        _within("altitude", self.altitude, -500.0, 9000.0, "give metres above sea level")
        _within("temperature", self.temperature, -90.0, 60.0, "give degrees Celsius")
        if self.pressure is not None:
            _within("pressure", self.pressure, 30_000.0, 110_000.0, "give pascals")

    @property
    def pressure_pa(self) -> float:
        """The air pressure, from the altitude unless it was set."""
        return _standard_pressure_pa(self.altitude) if self.pressure is None else self.pressure


def _within(field: str, value: float, low: float, high: float, remedy: str) -> None:
    if not (math.isfinite(value) and low <= value <= high):
        raise InputError(field=field, problem=f"{value} is not within {low:g} to {high:g}", remedy=remedy)


def _standard_pressure_pa(altitude: float) -> float:
    """Return the standard atmosphere's pressure at an altitude in metres, by the constants of pvlib's `alt2pres`."""
    return float(100.0 * ((44_331.514 - altitude) / 11_880.516) ** (1.0 / 0.1902632))
