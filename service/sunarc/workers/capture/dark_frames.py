"""Whether the frames of the day are black, so that neither sightings nor composites can come of them."""

from __future__ import annotations

from collections.abc import Sequence

from sunarc.cameras.frame import Frame
from sunarc.imaging.darkness import is_dark
from sunarc.runtime.status import StatusRegistry
from sunarc.workers.messages import condition

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
            self._board.set_condition(CODE, None)
        elif apparent_zenith < LIT_ZENITH_DEG:
            self._dark += 1
            if self._dark >= _SLOTS:
                data = {"slots": self._dark, "exposure_us": longest.exposure_us}
                self._board.set_condition(CODE, condition(CODE, severity="not_ready", **data))
