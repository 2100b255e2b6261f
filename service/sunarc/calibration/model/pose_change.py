"""Change of a camera's pose, clock, lens, image or site: the one result of every search for a change."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from sunarc.common.array_types import FloatArray
from sunarc.common.findings import Finding
from sunarc.common.utc import DAY_S
from sunarc.optics.pose import rotation_matrix, rotation_vector

Cause = Literal[
    "bump", "moved", "slow_turn", "clock", "longitude", "north", "clock_or_north", "lens", "refocus", "shift",
    "mirrored", "site",
]  # fmt: skip
"""`bump`, `moved`: a turn about any axis, as it is stored of one camera and of neighbours. `slow_turn`: one of days and
weeks, as that of a mast that settles. `clock`: about the celestial pole. `north`: about the vertical. `clock_or_north`:
both fit, as they do near the poles. `longitude`, `site`: the stated site is another one. `lens`, `refocus`, `shift`,
`mirrored`: the image is another one."""
UNKNOWN = np.full((3, 3), math.nan)
"""Covariance where none is known."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PoseChange:
    """Change of pose, clock, lens or image that explains observations better than no change.

    Times are seconds since 1970-01-01 UTC, or numbers of days where days are compared.
    """

    time: float
    """First observation after the change, or that at which a slow turn begins."""
    bracket: tuple[float, float]
    """Last observation surely before the change and first one surely after it; begin and end of a slow turn."""
    rotation_deg: FloatArray
    """(3,) turn of the camera about east, north and up, right-handed, degrees; 0 where the camera did not turn."""
    covariance_deg2: FloatArray = field(default_factory=UNKNOWN.copy)
    """(3, 3) covariance of the turn; NaN where it is not known."""
    cause: Cause
    """Most probable cause."""
    gain: float = math.nan
    """Powers of e by which the change explains the observations better than none does; NaN where it was not kept."""
    settling: float = 0.0
    """Time in which a slow turn does 0.63 of its way; infinite at a constant rate, 0 of a step."""
    perhaps: tuple[Cause, ...] = ()
    """Causes that explain the observations about as well."""
    slower: PoseChange | None = None
    """Slow turn that explains the observations best in place of a step."""
    finding: Finding | None = None
    """Change as a code and data, where the search states it by itself."""

    @property
    def turn_deg(self) -> float:
        """Return the angle of the turn."""
        return float(np.linalg.norm(self.rotation_deg))

    @property
    def likeliest(self) -> PoseChange:
        """Return the change of the larger gain: the step, or the slow turn in its place."""
        return self if self.slower is None or self.gain >= self.slower.gain else self.slower

    def progress(self, time: FloatArray) -> FloatArray:
        """Return the share (n,) of the change that was done at times: 0 before it, 1 at its end."""
        return progress(time, self.time, self.bracket[1], self.settling)


@dataclass(frozen=True, slots=True, kw_only=True)
class SteadyTurn:
    """Steady turn of a camera whose pose is that of a stated time."""

    at_unix_s: float
    """Time of the pose, seconds since 1970-01-01 UTC."""
    deg_per_day: tuple[float, float, float]
    """Turn of the camera about east, north and up, right-handed, degrees a day."""
    sigma_deg_per_day: tuple[float, float, float]
    """1-sigma of each."""

    def as_seen(self, directions: FloatArray, unix_s: FloatArray) -> FloatArray:
        """Return the directions that the camera of the stated time sees at the pixels of the turned one.

        Parameters
        ----------
        directions : (n, 3) unit vectors, east-north-up.
        unix_s : (n,) times of these; turns of some degrees are right to 1e-4 degrees.
        """
        days = (np.asarray(unix_s) - self.at_unix_s)[:, None] / DAY_S
        back = -np.radians(days * np.array(self.deg_per_day))
        once = np.cross(back, directions)
        turned = directions + once + 0.5 * np.cross(back, once)
        return np.asarray(turned / np.linalg.norm(turned, axis=-1, keepdims=True))


def progress(time: FloatArray, first: float, last: float, settling: float) -> FloatArray:
    """Return the share (n,) of a change from `first` to `last` that was done at times, see `PoseChange`."""
    since = np.maximum(time - first, 0.0)
    if settling == 0.0:
        return np.asarray(time >= first, dtype=np.float64)
    if np.isinf(settling):
        return np.asarray(since / (last - first))
    return np.asarray(np.expm1(-since / settling) / np.expm1(-(last - first) / settling))


def turn_between(before: ArrayLike, after: ArrayLike) -> FloatArray:
    """Return the turn (3,) of a camera from one pose to another, degrees about east, north and up.

    Parameters
    ----------
    before, after : rotation vectors (3,) from east-north-up to the camera, radians.
    """
    return np.degrees(rotation_vector(rotation_matrix(after).T @ rotation_matrix(before)))


def pose_before(after: ArrayLike, turn_deg: FloatArray) -> tuple[float, float, float]:
    """Return the pose from which a turn (3,) takes a camera to another one, as `turn_between` has them."""
    return rotation_vector(rotation_matrix(after) @ rotation_matrix(np.radians(turn_deg)))
