"""Options of the simulated sky, the lens's faults and the sensor."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import date, datetime
from typing import Annotated, Literal, get_args

from annotated_types import Ge, Gt, Le, Lt

from sunarc.common.bounds import NonNegative, Positive, Share, require_bounds
from sunarc.common.errors import InputError

Magnitude = Annotated[float, Ge(10.0), Le(30.0)]
"""Of the sky, magnitudes a square arcsecond."""


@dataclass(frozen=True, slots=True, kw_only=True)
class SimulatedNight:
    """The sky of the night, and its other lights.

    Attributes
    ----------
    star_e_per_s : electrons a second of a star of V 0 above the air; 25,000 is a bare lens of f/2 and 2.7 mm.
    faintest : V of the faintest stars. Those beyond the catalogue's 5.5 are drawn at random, fixed on the sky.
    extinction : magnitudes an air mass.
    twinkle : 1-sigma of a star's brightness in the zenith; it grows with the air mass.
    airglow, city : brightness of the dark zenith and of the dome of light over a town on the horizon.
    city_azimuth_deg : where the town lies.
    moon : whether there is a moon, with its phase and its glow (by ephem, as Venus to Saturn are).
    coma_px : how far the outer part of a star's image is drawn outwards at the edge of the field.
    warm_spots : clumps of a few pixels with a dark current of their own, which look like stars and stand still.
    satellites, aircraft : trails in an exposure, on average.
    """

    star_e_per_s: Positive = 25_000.0
    faintest: Annotated[float, Ge(0.0), Le(7.5)] = 7.0
    extinction: Annotated[float, Ge(0.0), Le(3.0)] = 0.2
    twinkle: Share = 0.1
    airglow: Magnitude = 21.0
    city: Magnitude = 18.5
    city_azimuth_deg: float = 200.0
    moon: bool = True
    coma_px: Annotated[float, Ge(0.0), Le(5.0)] = 0.6
    warm_spots: Annotated[int, Ge(0), Le(100_000)] = 60
    satellites: Annotated[NonNegative, Le(50.0)] = 0.5
    aircraft: Annotated[NonNegative, Le(50.0)] = 0.1

    def __post_init__(self) -> None:
        """Refuse an invalid night."""
        require_bounds(self, section_path="")


Weather = Literal["clear", "veil", "broken", "overcast"]
WEATHERS: tuple[Weather, ...] = get_args(Weather)


@dataclass(frozen=True, slots=True, kw_only=True)
class Obstruction:
    """A mast or a building: a dark rectangle on the horizon.

    Attributes
    ----------
    azimuth_deg : of its middle, clockwise from north.
    width_deg : in azimuth.
    height_deg : above the horizon.
    """

    azimuth_deg: float
    width_deg: float
    height_deg: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Bump:
    """The camera is turned at a moment, and stays so.

    Attributes
    ----------
    at : when, aware.
    turn_deg : about the axes to the east, to the north and up, right-handed.
    """

    at: datetime
    turn_deg: tuple[float, float, float]


@dataclass(frozen=True, slots=True, kw_only=True)
class SensorModel:
    """Response of the sensor: counts by light.

    Attributes
    ----------
    full_well_e : electrons at full scale and 0 dB.
    read_noise_e : electrons.
    black_level : of an empty pixel, as a fraction of full scale.
    hot_pixels : number of pixels with strong dark current or a stuck level, anywhere.
    blooming : share of the charge that a full well cannot hold which runs into its column's neighbours, half each way.
    smear_us_per_row : exposure that every row gets of every other row of its column while the charge is moved.
    """

    full_well_e: Positive = 20_000.0
    read_noise_e: NonNegative = 12.0
    black_level: Annotated[float, Ge(0.0), Lt(0.5)] = 32.0 / 4095.0
    hot_pixels: Annotated[int, Ge(0)] = 40
    blooming: Share = 0.0
    smear_us_per_row: NonNegative = 2e-3

    def __post_init__(self) -> None:
        """Refuse an invalid sensor."""
        require_bounds(self, section_path="")


@dataclass(frozen=True, slots=True, kw_only=True)
class SceneOptions:
    """The sky, the light and the lens's imperfections.

    Attributes
    ----------
    seed : draws clouds, noise and hot pixels.
    weather : one per solar day, in turn, from `first_day` on.
    first_day : the solar day of the first weather.
    sun_rate : full scales per microsecond in the middle of the sun's disc above the air; 3 is a bare camera (30 µs
        are 75 times full scale with the sun high).
    nd_transmission : of a neutral filter before the lens; 0.01 leaves the disc unsaturated at tens of µs.
    limb_darkening : u of 1 - u (1 - mu).
    psf_sigma_px : the lens's Gaussian blur; each pixel then integrates over its square.
    glare_strength : light scattered in the lens 1° from the sun, in units of the disc's.
    sky_strength : brightness of the clear zenith under a high sun, in units of the disc's.
    ghost_strength : of the reflection opposite the sun through the principal point, in units of the disc's.
    sun_cover : share of the sun's diameter behind an opaque edge that stays with it, from its left limb, seen upright.
    moon_at : zenith angle and azimuth of a full moon that stays there, degrees; None is no moon.
    field_deg : half the lens's field of view: the image circle.
    obstructions : what stands before the sky.
    bump : when the camera is turned, if it is.
    night : what shines at night; None leaves the nights black.
    """

    seed: int = 0
    weather: tuple[Weather, ...] = ("clear",)
    first_day: date = date(2013, 5, 13)
    sun_rate: Annotated[float, Gt(0.0), Lt(1e6)] = 3.0
    nd_transmission: Annotated[float, Gt(0.0), Le(1.0)] = 1.0
    limb_darkening: Share = 0.6
    psf_sigma_px: Annotated[float, Ge(0.05), Le(20.0)] = 0.7
    glare_strength: NonNegative = 2.5e-4
    sky_strength: NonNegative = 4e-6
    ghost_strength: NonNegative = 0.0
    sun_cover: Share = 0.0
    moon_at: tuple[float, float] | None = None
    field_deg: Annotated[float, Ge(10.0), Le(120.0)] = 93.0
    obstructions: tuple[Obstruction, ...] = ()
    bump: Bump | None = None
    night: SimulatedNight | None = None

    def __post_init__(self) -> None:
        """Refuse an invalid scene."""
        require_bounds(self, section_path="")
        if not self.weather:
            raise InputError(field="weather", problem="is empty", remedy=f"use {', '.join(WEATHERS)}")
        if self.moon_at is not None and not 0.0 <= self.moon_at[0] <= 180.0:
            raise InputError(field="moon_at", problem="no zenith angle", remedy="give 0 to 180, and an azimuth")
