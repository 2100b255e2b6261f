"""Cycles vouch for one another: what is handed on is as bright all over as the sky was a moment before."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import dataclass

from sunarc.cameras import Frame
from sunarc.imaging import MOST_ALL_OVER, Exposed, Level, factor_all_over, level_of

_log = logging.getLogger(__name__)
COMPARABLE_S = 120.0
"""Cycles further apart may show another sky: the level is not held against them."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Taken:
    """The frames of one cycle; a normal exposure that failed is None."""

    normal: tuple[Frame | None, ...]
    sun: tuple[Frame, ...]

    @property
    def good(self) -> list[Frame]:
        """The normal frames that succeeded."""
        return [frame for frame in self.normal if frame is not None]

    @property
    def complete(self) -> bool:
        """Whether every normal exposure succeeded."""
        return None not in self.normal


class Vouching:
    """Remembers the last cycle that was believed, and holds the first one back until a second agrees.

    Parameters
    ----------
    cadence_s : seconds between cycles; beyond half of `COMPARABLE_S`, where one that is missed leaves the others too
        far apart, nothing is compared and nothing held back.
    """

    def __init__(self, *, cadence_s: float) -> None:
        self._comparing = cadence_s <= COMPARABLE_S / 2.0
        self._believed: _Seen | None = None
        self._held: tuple[Taken, _Seen] | None = None

    def contradiction(self, frames: Sequence[Frame]) -> str | None:
        """Return how a cycle's normal frames contradict the last that was believed, one sentence; None: they do not."""
        if not frames or self._believed is None:
            return None
        factor = self._believed.factor_to(_seen(frames))
        if factor is None or _is_possible(factor):
            return None
        return (
            f"all of the image has {factor:.2g} times the light of the cycle before; "
            f"a light that truly changed (a filter, a cover) is believed after {COMPARABLE_S:g} s"
        )

    def vouched(self, taken: Taken) -> list[Taken]:
        """Return what may be handed on now that this cycle is whole: nothing, this one, or one held back and this."""
        seen = _seen(taken.good)
        if self._believed is not None and self._believed.factor_to(seen) is not None:
            self._believed, self._held = seen, None
            return [taken]
        if not self._comparing or not seen.tells:
            self._believed = self._held = None
            return [taken]
        return self._first(taken, seen)

    def _first(self, taken: Taken, seen: _Seen) -> list[Taken]:
        """Hold a cycle back that nothing vouches for; or let it go, together with one that was held back before it.

        Two that are too far apart to be compared are let go: nothing speaks against them, and nothing ever could.
        """
        held, self._held = self._held, (taken, seen)
        self._believed = None
        if held is None:
            return []
        factor = held[1].factor_to(seen)
        if factor is not None and not _is_possible(factor):
            _log.warning("a cycle that nothing vouched for was thrown away")
            return []
        self._believed, self._held = seen, None
        return [held[0], taken]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Seen:
    """A cycle's level, and when it was, seconds since 1970."""

    level: Level
    at_s: float

    @property
    def tells(self) -> bool:
        """Whether there is contrast enough to compare others with it."""
        return factor_all_over(self.level, self.level) is not None

    def factor_to(self, later: _Seen) -> float | None:
        """Return `factor_all_over` from here to there; None where the two are too far apart too."""
        if abs(later.at_s - self.at_s) > COMPARABLE_S * 1.001:
            return None
        return factor_all_over(self.level, later.level)


def _seen(frames: Sequence[Frame]) -> _Seen:
    exposed = [Exposed(image=f.image, exposure_us=f.exposure_us, full_scale=f.full_scale) for f in frames]
    return _Seen(level=level_of(exposed), at_s=frames[0].time.timestamp())


def _is_possible(factor: float) -> bool:
    return 1.0 / MOST_ALL_OVER <= factor <= MOST_ALL_OVER
