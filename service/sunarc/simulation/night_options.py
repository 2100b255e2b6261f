"""What can be set about the simulated sky of the night."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from annotated_types import Ge, Le

from sunarc.bounds import NonNegative, Positive, Share, require_bounds

Magnitude = Annotated[float, Ge(10.0), Le(30.0)]
"""Of the sky, magnitudes a square arcsecond."""


@dataclass(frozen=True, slots=True, kw_only=True)
class NightOptions:
    """The sky of the night, and what else shines in it.

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
        """Refuse what is no night."""
        require_bounds(self, section="")
