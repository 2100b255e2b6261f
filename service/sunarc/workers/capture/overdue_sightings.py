"""Whether sightings are stored while the sun is up, whatever it is that keeps them away."""

from __future__ import annotations

from collections.abc import Callable

from sunarc.runtime.clock import Clock
from sunarc.runtime.status import StatusRegistry
from sunarc.workers.capture.dark_frames import LIT_ZENITH_DEG
from sunarc.workers.messages import condition
from sunarc.workers.timing.frame_time import FrameTime

CODE = "no_sightings"
_SLOTS = 10
"""As many as of black frames: 5 min at the default cadence."""


class OverdueSightings:
    """Sets the condition `no_sightings` after ten slots with the sun up in which none was stored, rejected or not.

    Time is counted by the monotonic clock, which a wrong or stepped wall clock leaves alone.

    Parameters
    ----------
    stored : how many sightings this process has stored so far.
    apparent_zenith : the sun's now, degrees.
    clock, frame_time : real time, and the time that the frames tell, with its speed.
    cadence_s : seconds of frame time from slot to slot.
    board : where the condition is set.
    """

    def __init__(
        self,
        *,
        stored: Callable[[], int],
        apparent_zenith: Callable[[], float],
        clock: Clock,
        frame_time: FrameTime,
        cadence_s: float,
        board: StatusRegistry,
    ) -> None:
        self._stored = stored
        self._apparent_zenith = apparent_zenith
        self._clock = clock
        self._frame_time = frame_time
        self._cadence_s = cadence_s
        self._board = board
        self._n_stored = 0
        self._since_s = clock.monotonic()

    def check(self) -> None:
        """Compare with the last check, and set or clear the condition."""
        now_s, n_stored = self._clock.monotonic(), self._stored()
        sun_is_up = self._frame_time.is_known and self._apparent_zenith() < LIT_ZENITH_DEG
        if n_stored != self._n_stored or not sun_is_up:
            self._n_stored, self._since_s = n_stored, now_s
            self._board.set_condition(CODE, None)
            return
        slots = int((now_s - self._since_s) * self._frame_time.speed / self._cadence_s)
        if slots >= _SLOTS:
            self._board.set_condition(CODE, condition(CODE, slots=slots))
