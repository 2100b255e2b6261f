"""Whether the frames of the day are black, so that neither sightings nor composites can come of them."""

from __future__ import annotations

from collections.abc import Sequence

from sunarc.cameras import Frame
from sunarc.imaging import is_dark
from sunarc.runtime.status import Reason, StatusRegistry

CODE = "black_frames"
LIT_ZENITH_DEG = 80.0
"""The sun's apparent zenith angle below which the longest normal exposure shows the sky in any weather."""
_SLOTS = 10


class DarkFrames:
    """Counts the slots in a row whose longest exposure is black, and sets the condition `black_frames`.

    Parameters
    ----------
    board : where the condition is set.
    """

    def __init__(self, board: StatusRegistry) -> None:
        self._board = board
        self._dark = 0

    def add(self, frames: Sequence[Frame], *, apparent_zenith: float) -> None:
        """Add a slot's normal frames. By night and in twilight a black frame says nothing; a bright one always does."""
        longest = max(frames, key=lambda frame: frame.exposure_us)
        if not is_dark(longest.image, full_scale=longest.full_scale):
            self._dark = 0
            self._board.clear_reason(CODE)
        elif apparent_zenith < LIT_ZENITH_DEG:
            self._dark += 1
            if self._dark >= _SLOTS:
                self._board.set_reason(_reason(self._dark, longest.exposure_us))


def _reason(slots: int, exposure_us: float) -> Reason:
    return Reason(
        code=CODE,
        severity="not_ready",
        text=f"the last {slots} slots by day are black at {exposure_us:g} us: no sun can be found in them",
        remedy="take the lens cap off, open the dome or shutter, and check iris and filter; "
        "with a dense filter set longer capture.hdr_exposures_us",
    )
