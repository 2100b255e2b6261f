"""Position of the camera, and the air above it: pressure, temperature, air mass, transmission of a clear sky."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass, replace
from typing import Annotated, Literal

import numpy as np
from annotated_types import Ge, Le
from numpy.typing import ArrayLike

from sunarc.common.array_types import FloatArray
from sunarc.common.bounds import require_bounds
from sunarc.common.findings import Finding, FindingError

TEMPERATURE_BOUNDS_C = (-60.0, 60.0)
"""Air temperatures that are accepted, °C: the annual mean of the coldest inhabited sites is -55, the record is 57."""
PRESSURE_BOUNDS_PA = (30_000.0, 110_000.0)
"""Air pressures that are accepted, Pa: those of 9000 m and of the strongest high at sea level."""
PA_PER_HPA = 100.0
PRESSURE_BOUNDS_HPA = (PRESSURE_BOUNDS_PA[0] / PA_PER_HPA, PRESSURE_BOUNDS_PA[1] / PA_PER_HPA)

EARTH_RATE = 7.292e-5
"""Of the earth's rotation against the stars, radians a second."""

Latitude = Annotated[float, Ge(-90.0), Le(90.0)]
Longitude = Annotated[float, Ge(-180.0), Le(180.0)]
Altitude = Annotated[float, Ge(-500.0), Le(9000.0)]
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
    pressure : annual mean air pressure in Pa; unset: from the altitude (as pvlib's `alt2pres`).
    temperature : annual mean air temperature in °C.
    """

    latitude: Latitude
    longitude: Longitude
    altitude: Altitude = 0.0
    pressure: PressurePa | None = None
    temperature: TemperatureC = 12.0

    def __post_init__(self) -> None:
        """Refuse an invalid place."""
        require_bounds(self, section_path="site")

    @property
    def pressure_pa(self) -> float:
        """The air pressure, from the altitude unless it was set."""
        return _standard_pressure_pa(self.altitude) if self.pressure is None else self.pressure

    def replace_air(self, *, temperature: float | None, pressure: float | None) -> Site:
        """Return the same place in air of a temperature (°C) and a pressure (Pa); None keeps the present value."""
        return replace(
            self,
            temperature=self.temperature if temperature is None else temperature,
            pressure=self.pressure if pressure is None else pressure,
        )


def pole_enu(site: Site) -> FloatArray:
    """Return the direction of the north celestial pole, east-north-up; below the horizon in the south."""
    latitude = math.radians(site.latitude)
    return np.array([0.0, math.cos(latitude), math.sin(latitude)])


def _standard_pressure_pa(altitude: float) -> float:
    """Return the standard atmosphere's pressure at an altitude in metres, by the constants of pvlib's `alt2pres`."""
    return float(100.0 * ((44_331.514 - altitude) / 11_880.516) ** (1.0 / 0.1902632))


CLEAR_OPTICAL_DEPTH = 0.2
"""Vertical optical depth of a clear sky in the visible: Rayleigh scattering 0.1 at 550 nm and as much of aerosol."""


def clear_transmission(apparent_zenith: float) -> float:
    """Return the share of the sun's light that a clear sky lets through, the sun at an apparent zenith (degrees)."""
    return math.exp(-CLEAR_OPTICAL_DEPTH * float(relative_air_mass(apparent_zenith)))


def relative_air_mass(apparent_zenith: ArrayLike) -> FloatArray:
    """Return the air mass relative to the zenith's, (...); 38 at the horizon and below it.

    Parameters
    ----------
    apparent_zenith : (...) degrees.

    References
    ----------
    F. Kasten and A. T. Young, "Revised optical air mass tables and approximation formula", Applied Optics 28 (1989).
    """
    elevation = np.clip(90.0 - np.asarray(apparent_zenith, dtype=np.float64), 0.0, 90.0)
    return np.asarray(1.0 / (np.sin(np.radians(elevation)) + 0.50572 * (elevation + 6.07995) ** -1.6364))


_NUMBER = r"\d+(?:[.,]\d+)?"
_ANGLE = re.compile(
    rf"\s*(?P<before>[NSEW])?\s*(?P<sign>[+\-−])?\s*(?P<degrees>{_NUMBER})\s*(?:°|d|deg|\s|$|(?=[NSEW]))\s*"
    rf"(?:(?P<minutes>{_NUMBER})\s*(?:'|′|’|m|\s|$|(?=[NSEW]))\s*)?"
    rf"(?:(?P<seconds>{_NUMBER})\s*(?:\"|″|”|''|s|\s|$|(?=[NSEW]))\s*)?(?P<after>[NSEW])?\s*",
    re.IGNORECASE,
)


def parse_angle(text: str, *, question: str, axis: Literal["NS", "EW"]) -> float:
    """Return an angle in degrees, north and east positive, from decimal degrees or degrees, minutes and seconds.

    Parameters
    ----------
    text : as "-97.4849", "97.4849 W", "97°29'05.5W", "97 29 5.5 W"; a decimal comma is taken for a point.
    question : the option that gives it.
    axis : the letters of its two directions, the positive one first.

    Raises
    ------
    FindingError : it is no angle of this axis.
    """
    match = _ANGLE.fullmatch(text)
    if match is None or (match["before"] and match["after"]):
        raise FindingError(question, Finding("angle_unreadable", {"given": text}))
    letter = (match["before"] or match["after"] or "").upper()
    if letter and letter not in axis:
        raise FindingError(question, Finding("angle_of_other_axis", {"given": text}))
    if letter and match["sign"]:
        raise FindingError(question, Finding("angle_signed_twice", {"given": text}))
    degrees, minutes, seconds = (_parse_decimal(match[part]) for part in ("degrees", "minutes", "seconds"))
    whole = [part for part in ("degrees", "minutes") if match["minutes" if part == "degrees" else "seconds"]]
    if max(minutes, seconds) >= 60.0 or any(_parse_decimal(match[part]) % 1.0 for part in whole):
        raise FindingError(question, Finding("angle_unreadable", {"given": text}))
    angle = degrees + minutes / 60.0 + seconds / 3600.0
    most = 90 if axis == "NS" else 180
    if angle > most:
        raise FindingError(question, Finding("angle_beyond", {"given": text, "most": most}))
    negative = letter == axis[1] or match["sign"] in {"-", "−"}
    return round(-angle if negative else angle, 7) + 0.0


def _parse_decimal(digits: str | None) -> float:
    return float((digits or "0").replace(",", "."))
