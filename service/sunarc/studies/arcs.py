"""The sun's arcs over the paper's site, and where its camera would have seen them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from datetime import date

import numpy as np
from numpy.typing import NDArray

from sunarc.array_types import FloatArray
from sunarc.optics.camera import Camera
from sunarc.optics.forward import project
from sunarc.simulation.truth import SGP
from sunarc.sky.days import day_bounds_unix_s
from sunarc.sky.sun import sun_angles, sun_directions

LARGEST_ZENITH_DEG = 89.6
"""Up to this apparent zenith angle the paper's detector found the sun (section 3.3)."""
SYNTHETIC_DAY = date(2013, 5, 13)
"""The day of the paper's Fig. 3."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Arc:
    """Moments at which the sun is seen.

    Attributes
    ----------
    unix_s : (n,) s.
    directions : (n, 3) apparent directions of the sun, east-north-up.
    pixels : (n, 2) where the true camera sees it, px.
    """

    unix_s: FloatArray
    directions: FloatArray
    pixels: FloatArray

    def __len__(self) -> int:
        return int(self.unix_s.size)

    def select(self, which: NDArray[np.intp]) -> Arc:
        """Return the moments that an index picks."""
        return Arc(unix_s=self.unix_s[which], directions=self.directions[which], pixels=self.pixels[which])


def arcs(camera: Camera, days: Sequence[date], *, cadence_s: float = 30.0) -> Arc:
    """Return the arcs of solar days at the Southern Great Plains, one moment every `cadence_s` while the sun is up."""
    bounds = [day_bounds_unix_s(day, longitude=SGP.longitude) for day in days]
    times = np.concatenate([np.arange(begin, end, cadence_s) for begin, end in bounds])
    times = times[sun_angles(times, SGP).apparent_zenith < LARGEST_ZENITH_DEG]
    directions = sun_directions(times, SGP)
    return Arc(unix_s=times, directions=directions, pixels=project(camera, directions))
