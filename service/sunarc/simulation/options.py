"""What can be set about the simulated sky, the lens's faults and the sensor."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import date, datetime
from typing import Literal, get_args

from sunarc.errors import InputError

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
    """How light becomes counts.

    Attributes
    ----------
    full_well_e : electrons at full scale and 0 dB.
    read_noise_e : electrons.
    black_level : of an empty pixel, as a fraction of full scale.
    hot_pixels : number of pixels with strong dark current or a stuck level, anywhere.
    blooming : share of the charge that a full well cannot hold which runs into its column's neighbours, half each way.
    smear_us_per_row : exposure that every row gets of every other row of its column while the charge is moved.
    """

    full_well_e: float = 20_000.0
    read_noise_e: float = 12.0
    black_level: float = 32.0 / 4095.0
    hot_pixels: int = 40
    blooming: float = 0.0
    smear_us_per_row: float = 2e-3

    def __post_init__(self) -> None:
        """Refuse what is no sensor."""
        _require(field="full_well_e", good=self.full_well_e > 0.0, remedy="give electrons")
        _require(field="read_noise_e", good=self.read_noise_e >= 0.0, remedy="give electrons")
        _require(field="black_level", good=0.0 <= self.black_level < 0.5, remedy="give a fraction of full scale")
        _require(field="hot_pixels", good=self.hot_pixels >= 0, remedy="give a number of pixels")
        _require(field="blooming", good=0.0 <= self.blooming <= 1.0, remedy="give 0 to 1")
        _require(field="smear_us_per_row", good=self.smear_us_per_row >= 0.0, remedy="give microseconds")


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
    """

    seed: int = 0
    weather: tuple[Weather, ...] = ("clear",)
    first_day: date = date(2013, 5, 13)
    sun_rate: float = 3.0
    nd_transmission: float = 1.0
    limb_darkening: float = 0.6
    psf_sigma_px: float = 0.7
    glare_strength: float = 2.5e-4
    sky_strength: float = 4e-6
    ghost_strength: float = 0.0
    sun_cover: float = 0.0
    moon_at: tuple[float, float] | None = None
    field_deg: float = 93.0
    obstructions: tuple[Obstruction, ...] = ()
    bump: Bump | None = None

    def __post_init__(self) -> None:
        """Refuse what is no scene."""
        known = bool(self.weather) and all(weather in WEATHERS for weather in self.weather)
        _require(field="weather", good=known, remedy=f"use {', '.join(WEATHERS)}")
        _require(field="sun_rate", good=0.0 < self.sun_rate < 1e6, remedy="give full scales per microsecond")
        _require(field="nd_transmission", good=0.0 < self.nd_transmission <= 1.0, remedy="give 0 to 1")
        _require(field="limb_darkening", good=0.0 <= self.limb_darkening <= 1.0, remedy="give 0 to 1")
        _require(field="psf_sigma_px", good=0.05 <= self.psf_sigma_px <= 20.0, remedy="give 0.05 to 20 px")
        _require(field="ghost_strength", good=self.ghost_strength >= 0.0, remedy="give 0 or more")
        _require(field="sun_cover", good=0.0 <= self.sun_cover <= 1.0, remedy="give 0 to 1")
        zenith = 0.0 if self.moon_at is None else self.moon_at[0]
        _require(field="moon_at", good=0.0 <= zenith <= 180.0, remedy="give a zenith angle of 0 to 180, and an azimuth")
        _require(field="field_deg", good=10.0 <= self.field_deg <= 120.0, remedy="give 10 to 120 degrees")


def _require(*, field: str, good: bool, remedy: str) -> None:
    if not good:
        raise InputError(field=field, problem="out of its bounds", remedy=remedy)
