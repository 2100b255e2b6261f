"""Cycles of exposures, and the consistency of their brightness: it may not jump from one to the next."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import dataclass

from sunarc.imager.cameras.frame import Frame
from sunarc.imaging.brightness import MOST_ALL_OVER, Exposed, Level, factor_all_over, measure_level

_log = logging.getLogger(__name__)
COMPARABLE_S = 120.0
"""Cycles further apart may show another sky: their levels are not compared."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Cycle:
    """Frames of one cycle; a normal exposure that failed is None."""

    normal: tuple[Frame | None, ...]
    sun: tuple[Frame, ...]

    @property
    def good(self) -> list[Frame]:
        """The normal frames that succeeded."""
        return [frame for frame in self.normal if frame is not None]

    @property
    def complete(self) -> bool:
        """True where every normal exposure succeeded."""
        return None not in self.normal


class CycleConsistencyFilter:
    """Filter that compares each cycle's brightness with the last accepted one's; the first waits for a second.

    Parameters
    ----------
    cadence_s : seconds between cycles; beyond half of `COMPARABLE_S`, where one that is missed leaves the others too
        far apart, nothing is compared and nothing held back.
    """

    def __init__(self, *, cadence_s: float) -> None:
        self._comparing = cadence_s <= COMPARABLE_S / 2.0
        self._reference: _CycleLevel | None = None
        self._held_back: tuple[Cycle, _CycleLevel] | None = None

    def contradiction(self, frames: Sequence[Frame]) -> str | None:
        """Return how a cycle's frames contradict the last accepted cycle, one sentence; None where they agree."""
        if not frames or self._reference is None:
            return None
        factor = self._reference.factor_to(_cycle_level(frames))
        if factor is None or _is_possible(factor):
            return None
        return (
            f"image {factor:.2g}× as bright as the previous cycle; accepted only if it stays so for {COMPARABLE_S:g} s"
        )

    def accepted_cycles(self, taken: Cycle) -> list[Cycle]:
        """Return the cycles to hand on now that this one is whole: an empty list, this one, or one held back too."""
        level = _cycle_level(taken.good)
        if self._reference is not None and self._reference.factor_to(level) is not None:
            self._reference, self._held_back = level, None
            return [taken]
        if not self._comparing or not level.tells:
            self._reference = self._held_back = None
            return [taken]
        return self._hold_first_cycle(taken, level)

    def _hold_first_cycle(self, taken: Cycle, level: _CycleLevel) -> list[Cycle]:
        """Delay a cycle without a reference; or return it together with the delayed one before it.

        Two that are too far apart to be compared are let go: nothing speaks against them, and nothing ever could.
        """
        held_back, self._held_back = self._held_back, (taken, level)
        self._reference = None
        if held_back is None:
            return []
        factor = held_back[1].factor_to(level)
        if factor is not None and not _is_possible(factor):
            _log.warning("discarded a cycle: brightness inconsistent with the cycles before and after")
            return []
        self._reference, self._held_back = level, None
        return [held_back[0], taken]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _CycleLevel:
    """A cycle's level, and when it was, seconds since 1970."""

    level: Level
    at_s: float

    @property
    def tells(self) -> bool:
        """True where the contrast suffices to compare other cycles with it."""
        return factor_all_over(self.level, self.level) is not None

    def factor_to(self, later: _CycleLevel) -> float | None:
        """Return `factor_all_over` from here to there; None where the two are too far apart too."""
        if abs(later.at_s - self.at_s) > COMPARABLE_S * 1.001:
            return None
        return factor_all_over(self.level, later.level)


def _cycle_level(frames: Sequence[Frame]) -> _CycleLevel:
    exposed = [Exposed(image=f.image, exposure_us=f.exposure_us, full_scale=f.full_scale) for f in frames]
    return _CycleLevel(level=measure_level(exposed), at_s=frames[0].time.timestamp())


def _is_possible(factor: float) -> bool:
    return 1.0 / MOST_ALL_OVER <= factor <= MOST_ALL_OVER
