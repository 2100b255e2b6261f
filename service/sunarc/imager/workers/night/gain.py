"""Gain of the night: raised for one exposure and restored after it; no slot is served where that fails."""

from __future__ import annotations

import logging
from collections.abc import Callable

from sunarc.common.errors import CameraError, CameraLostError
from sunarc.imager.cameras.frame import Frame, GainCamera, SkyCamera
from sunarc.imager.runtime.status import StatusRegistry, condition

_log = logging.getLogger(__name__)
CODE = "gain_not_restored"


class NightGain:
    """Takes an exposure with a raised gain.

    A frame of the day with the gain of the night would spoil its sightings. So the gain is restored and read back
    before anything else is done with the camera; where it stays raised, the camera is let go, and after it was opened
    again no slot is served before the gain is what the settings say.

    Parameters
    ----------
    board : where the condition `gain_not_restored` is set.
    """

    def __init__(self, board: StatusRegistry) -> None:
        self._board = board
        self._raised = False

    def take(self, camera: SkyCamera, raised_db: float, expose: Callable[[], Frame | None]) -> Frame | None:
        """Return a frame with a gain raised by `raised_db`, or as it is where the camera has no gain to set.

        Raises
        ------
        CameraLostError
            The gain could not be restored.
        """
        if raised_db <= 0.0 or camera.info.gain_raise_db <= 0.0 or not isinstance(camera, GainCamera):
            return expose()
        self._raised = True
        try:
            camera.raise_gain(min(raised_db, camera.info.gain_raise_db))
            return expose()
        except CameraLostError:
            raise
        except CameraError as error:
            _log.warning("the gain of the night was not set: %s", error)
            return None
        finally:
            self.restore(camera)

    def restore(self, camera: SkyCamera) -> None:
        """Restore the gain where it was raised, and read it back; CameraLostError where it is another one."""
        if not self._raised or not isinstance(camera, GainCamera):
            return
        try:
            camera.restore_gain()
        except CameraError as error:
            reason = condition(CODE, severity="not_ready", error=str(error))
            self._board.set_condition(CODE, reason)
            raise CameraLostError(f"the gain of the night was not restored: {error}") from error
        self._raised = False
        self._board.set_condition(CODE, None)
