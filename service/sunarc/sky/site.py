"""Position of the camera, and the air above it."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Annotated

from annotated_types import Ge, Le

from sunarc.bounds import require_bounds

TEMPERATURE_BOUNDS_C = (-60.0, 60.0)
"""Air temperatures that are accepted, °C: the annual mean of the coldest inhabited sites is -55, the record is 57."""
PRESSURE_BOUNDS_PA = (30_000.0, 110_000.0)
"""Air pressures that are accepted, Pa: those of 9000 m and of the strongest high at sea level."""
PA_PER_HPA = 100.0
PRESSURE_BOUNDS_HPA = (PRESSURE_BOUNDS_PA[0] / PA_PER_HPA, PRESSURE_BOUNDS_PA[1] / PA_PER_HPA)

PressurePa = Annotated[float, Ge(PRESSURE_BOUNDS_PA[0]), Le(PRESSURE_BOUNDS_PA[1])]
TemperatureC = Annotated[float, Ge(TEMPERATURE_BOUNDS_C[0]), Le(TEMPERATURE_BOUNDS_C[1])]


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

    latitude: Annotated[float, Ge(-90.0), Le(90.0)]
    longitude: Annotated[float, Ge(-180.0), Le(180.0)]
    altitude: Annotated[float, Ge(-500.0), Le(9000.0)] = 0.0
    pressure: PressurePa | None = None
    temperature: TemperatureC = 12.0

    def __post_init__(self) -> None:
        """Refuse what is no place on Earth."""
        require_bounds(self, section="site")

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


def _standard_pressure_pa(altitude: float) -> float:
    """Return the standard atmosphere's pressure at an altitude in metres, by the constants of pvlib's `alt2pres`."""
    return float(100.0 * ((44_331.514 - altitude) / 11_880.516) ** (1.0 / 0.1902632))
