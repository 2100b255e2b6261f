"""Input, state and result of the change detection."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Annotated, Literal

import numpy as np
from annotated_types import Ge, Le

from sunarc.calibration.evidence import ONLINE, Limits
from sunarc.calibration.model.sightings import Sightings
from sunarc.common.array_types import BoolArray, FloatArray, stacked
from sunarc.common.bounds import require_bounds
from sunarc.optics.camera import Camera, Param

ChangeKind = Literal["bump", "clock", "lens", "refocus", "shift", "mirrored", "site"]
FleetCause = Literal["clock", "longitude", "site", "north", "clock_or_north", "moved", "slow_turn"]
"""`clock`: about the celestial pole, and the stated site is as before. `longitude`, `site`: what is stated of the site
changed, by the rotation that was seen. `north`: about the vertical. `clock_or_north`: both fit, as they do near the
poles. `moved`: none of them. `slow_turn`: no step, but a turn of days and weeks about another axis than the celestial
pole, as that of a mast that settles; no alarm, since the imager's own calibration follows it."""


CENTER = (Param.PRINCIPAL_POINT_X_PX, Param.PRINCIPAL_POINT_Y_PX)
OF_LENS: dict[ChangeKind, tuple[Param, ...]] = {
    "refocus": (Param.FOCAL_LENGTH_X_PX,),
    "shift": CENTER,
    "lens": (Param.FOCAL_LENGTH_X_PX, *CENTER, Param.K2, Param.K3),
}
"""Parameters that may differ after a change of the lens; both focal lengths change alike."""
LENS_KINDS = frozenset(OF_LENS)
"""Kinds after which earlier sightings carry no information on the lens."""


def lens_freedom(camera: Camera, names: Sequence[int], changed: Sequence[Param], limits: Limits) -> FloatArray:
    """Return (p, f): free directions of p parameters by f that change with the lens, one column per standard normal.

    Parameters
    ----------
    camera : before the change.
    names : the p parameters.
    changed : see `OF_LENS`.
    limits : of the search.
    """
    focal, center, radial = limits.lens
    spread = {
        Param.FOCAL_LENGTH_X_PX: focal * camera.focal_length_px[0],
        Param.PRINCIPAL_POINT_X_PX: center * camera.width,
        Param.PRINCIPAL_POINT_Y_PX: center * camera.height,
    }
    also = {Param.FOCAL_LENGTH_Y_PX: Param.FOCAL_LENGTH_X_PX}
    moved = [[float(one in (name, also.get(Param(name)))) for one in changed] for name in names]
    return np.array(moved).reshape(len(names), len(changed)) * [spread.get(one, radial) for one in changed]


@dataclass(frozen=True, slots=True, kw_only=True)
class WatchOptions:
    """Limits of the changes that the change detection reports.

    Attributes
    ----------
    wander_deg : 1-sigma per axis by which a mast and its mount wander with heat and wind, which is no change.
    """

    wander_deg: Annotated[float, Ge(0.0), Le(5.0)] = ONLINE.least_deg

    def __post_init__(self) -> None:
        """Refuse values out of bounds."""
        require_bounds(self, section_path="watch")


@dataclass(frozen=True, slots=True, kw_only=True)
class Sighting:
    """Sighting as the change detection uses it.

    Attributes
    ----------
    unix_s : mid-exposure.
    pixel : x, y, px.
    direction : where the sun was, east-north-up.
    sigma_px : stated 1-sigma per axis; NaN where none is stated.
    """

    unix_s: float
    pixel: tuple[float, float]
    direction: tuple[float, float, float]
    sigma_px: float = math.nan


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SightingWindow(Sightings):
    """Last sightings, the oldest first; immutable.

    Attributes
    ----------
    pixels : see `Sightings`, as for the other columns.
    trusted : (n,) whether each agreed with those before it.
    surprise : (n, 2) by how many sigmas it did not, in whitened axes; 0 where it is not trusted.
    """

    pixels: FloatArray = field(default_factory=lambda: np.zeros((0, 2)))
    trusted: BoolArray = field(default_factory=lambda: np.array([False]))
    surprise: FloatArray = field(default_factory=lambda: np.zeros((1, 2)))

    def since(self, unix_s: float) -> SightingWindow:
        """Return the sightings from a time on."""
        return self.select(self.unix_s >= unix_s)

    def last(self, count: int) -> SightingWindow:
        """Return the last `count` sightings."""
        return self.select(np.arange(len(self)) >= len(self) - count)

    def append_sighting(self, sighting: Sighting, *, trusted: bool, surprise: FloatArray) -> SightingWindow:
        """Return this with one more sighting."""
        one = SightingWindow(
            unix_s=np.array([sighting.unix_s]),
            pixels=np.array([sighting.pixel]),
            directions=np.array([sighting.direction]),
            sigma_px=np.array([sighting.sigma_px]),
            trusted=np.array([trusted]),
            surprise=np.asarray(surprise)[None],
        )
        return stacked([self, one])


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Hypothesis:
    """Hypothesis that the sightings from one on follow a change.

    Attributes
    ----------
    kind : what.
    first : the first sighting after the change.
    camera : that sees them then.
    sightings : from that one on; the directions where the sun was, the pixels those of that camera.
    free : (p, f) free directions in the error model's parameters, one column per standard normal number.
    mean : (p,) where those are expected before the sightings.
    """

    kind: ChangeKind
    first: int
    camera: Camera
    sightings: Sightings
    free: FloatArray
    mean: FloatArray
