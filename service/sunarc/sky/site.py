"""Where the camera stands, and the air above it."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

from sunarc.errors import InputError

TEMPERATURE_BOUNDS_C = (-60.0, 60.0)
"""Air temperatures that are accepted, °C: the annual mean of the coldest inhabited sites is -55, the record is 57."""
PRESSURE_BOUNDS_PA = (30_000.0, 110_000.0)
"""Air pressures that are accepted, Pa: those of 9000 m and of the strongest high at sea level."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Site:
    """A place on the ground.

    Attributes
    ----------
    latitude : degrees, north positive, -90 to 90.
    longitude : degrees, east positive, -180 to 180.
    altitude : metres above sea level, -500 to 9000.
    pressure : annual mean air pressure in Pa, 30000 to 110000; None takes it from the altitude (as pvlib's `alt2pres`).
    temperature : annual mean air temperature in °C, -60 to 60.
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
        _within("temperature", self.temperature, *TEMPERATURE_BOUNDS_C, "give degrees Celsius")
        if self.pressure is not None:
            _within("pressure", self.pressure, *PRESSURE_BOUNDS_PA, "give pascals")

    @property
    def pressure_pa(self) -> float:
        """The air pressure, from the altitude unless it was set."""
        return _standard_pressure_pa(self.altitude) if self.pressure is None else self.pressure

    def with_air(self, *, temperature: float | None, pressure: float | None) -> Site:
        """Return the same place in air of a temperature (°C) and a pressure (Pa); None keeps the present value."""
        return replace(
            self,
            temperature=self.temperature if temperature is None else temperature,
            pressure=self.pressure if pressure is None else pressure,
        )


def _within(field: str, value: float, low: float, high: float, remedy: str) -> None:
    if not (math.isfinite(value) and low <= value <= high):
        raise InputError(field=f"site.{field}", problem=f"{value} is not within {low:g} to {high:g}", remedy=remedy)


def _standard_pressure_pa(altitude: float) -> float:
    """Return the standard atmosphere's pressure at an altitude in metres, by the constants of pvlib's `alt2pres`."""
    return float(100.0 * ((44_331.514 - altitude) / 11_880.516) ** (1.0 / 0.1902632))
