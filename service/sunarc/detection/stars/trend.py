"""Whether the stars grew wider and fainter over a night: dew, haze, a lens that the cold takes out of focus."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from annotated_types import Gt

from sunarc.array_types import FloatArray
from sunarc.bounds import require_bounds

_FEWEST = 6
_PARTS = 3


@dataclass(frozen=True, slots=True, kw_only=True)
class NightLimits:
    """What the numbers of a night must reach to be suspected.

    Attributes
    ----------
    width_growth : of the stars' width, its last third over its first.
    halo_growth : growth of the halo's share of the light, absolute.
    fading_mag : loss of brightness over the night, magnitudes.
    width_ratio : of a night's width over that of the nights before.
    nights : nights in a row with such a ratio.
    """

    width_growth: Annotated[float, Gt(1.0)] = 1.1
    halo_growth: Annotated[float, Gt(0.0)] = 0.05
    fading_mag: Annotated[float, Gt(0.0)] = 0.25
    width_ratio: Annotated[float, Gt(1.0)] = 1.2
    nights: int = 2

    def __post_init__(self) -> None:
        """Refuse what is no limit."""
        require_bounds(self, section="night")


@dataclass(frozen=True, slots=True, kw_only=True)
class NightTrend:
    """How a night ended against how it began; NaN where less than 6 of its images have the number.

    Attributes
    ----------
    width_growth : ratio of the stars' widths.
    halo_growth : difference of the halo's share of the light.
    fading_mag : difference of the zero points, magnitudes; positive: fainter.
    """

    width_growth: float
    halo_growth: float
    fading_mag: float


def trend_of(width: FloatArray, halo: FloatArray, zero_point: FloatArray) -> NightTrend:
    """Return the medians of the last third of a night's images against those of its first, (n,) in their order."""
    first, last = zip(*(_ends(column) for column in (width, halo, zero_point)), strict=True)
    return NightTrend(
        width_growth=last[0] / first[0] if first[0] > 0.0 else math.nan,
        halo_growth=last[1] - first[1],
        fading_mag=first[2] - last[2],
    )


def dew_suspected(trend: NightTrend, limits: NightLimits) -> bool:
    """Return whether the stars grew wider, or their halo brighter, while they faded."""
    spread = trend.width_growth >= limits.width_growth or trend.halo_growth >= limits.halo_growth
    return spread and trend.fading_mag >= limits.fading_mag


def focus_ratio(widths: Sequence[float], limits: NightLimits) -> float | None:
    """Return how much wider the stars are than they were, where that holds for the last nights in a row; else None.

    Parameters
    ----------
    widths : of clear nights, the newest first; the nights before the last ones are the reference, 3 at least.
    limits : how much, and for how many nights.
    """
    known = [width for width in widths if math.isfinite(width) and width > 0.0]
    last, before = known[: limits.nights], known[limits.nights :]
    if len(last) < limits.nights or len(before) < _PARTS:
        return None
    ratio = min(last) / float(np.median(before))
    return ratio if ratio >= limits.width_ratio else None


def _ends(column: FloatArray) -> tuple[float, float]:
    """Return the medians of the first and of the last third of the numbers that are known."""
    known = column[np.isfinite(column)]
    if known.size < _FEWEST:
        return math.nan, math.nan
    part = known.size // _PARTS
    return float(np.median(known[:part])), float(np.median(known[-part:]))
