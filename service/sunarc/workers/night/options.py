"""Whether the camera works at night."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True, kw_only=True)
class NightOptions:
    """Work at night.

    Attributes
    ----------
    enabled : look at the stars: every `capture.night_cadence_s` while the sun is below -12 degrees an exposure of
        seconds is taken, and its stars are used beside the sun's sightings (extra `night`).
    """

    enabled: bool = False
