"""Whether most slots get a cycle, or the host or the camera is too slow for the cadence."""

from __future__ import annotations

from collections import deque

from sunarc.runtime.status import StatusRegistry
from sunarc.workers.messages import condition

CODE = "slots_missed"
_SLOTS = 40
"""Over how many slots the share is taken: 20 min at the default cadence."""
_FEWEST_SLOTS = 10
_SET_SHARE, _CLEAR_SHARE = 0.25, 0.1
"""Shares of missed slots at which the condition is set and cleared; between them it stays as it is."""


class MissedSlots:
    """Keeps the last slots with the sun up, and sets the condition `slots_missed`.

    Parameters
    ----------
    board : where the condition is set.
    """

    def __init__(self, board: StatusRegistry) -> None:
        self._board = board
        self._taken: deque[bool] = deque(maxlen=_SLOTS)
        self._after_outage = False

    def add(self, *, missed_before: int) -> None:
        """Add a slot that got its cycle, and those that passed without one before it; set or clear the condition.

        Parameters
        ----------
        missed_before : slots without a cycle since the last one; not counted after the camera was lost, which has a
            condition of its own.
        """
        if not self._after_outage:
            self._taken.extend([False] * min(missed_before, _SLOTS))
        self._after_outage = False
        self._taken.append(True)
        missed = self._taken.count(False)
        if len(self._taken) >= _FEWEST_SLOTS and missed >= _SET_SHARE * len(self._taken):
            self._board.set_condition(CODE, condition(CODE, missed=missed, slots=len(self._taken)))
        elif missed <= _CLEAR_SHARE * len(self._taken):
            self._board.set_condition(CODE, None)

    def outage(self) -> None:
        """Take note that the camera is lost: the slots until it is back are not the host's."""
        self._after_outage = True
