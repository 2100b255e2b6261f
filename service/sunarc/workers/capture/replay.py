"""Replay of a folder of images, as fast as they are processed."""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable
from contextlib import closing

from sunarc.cameras.frame import Frame, SkyCamera
from sunarc.errors import CameraLostError, ConfigurationError, InputError
from sunarc.runtime.clock import Clock
from sunarc.runtime.status import CameraStatus, StatusRegistry
from sunarc.workers.bounded_queue import DropOldestQueue
from sunarc.workers.capture.status import CaptureReport
from sunarc.workers.timing.frame_time import FrameTime

_log = logging.getLogger(__name__)
_POLL_S = 0.2
_SUN_EXPOSURE_BELOW_US = 1000.0


class ReplayWorker:
    """Puts the microsecond images of a folder into the queue, in order, and then waits to be stopped.

    Parameters
    ----------
    open_camera : opens the folder; raises `CameraError` when there is nothing to play.
    clock, frame_time : real time, and the time that the images tell.
    name : the camera's name on the board.
    sun_frames : where the images of the sun go; nothing is dropped, the replay waits for room.
    board : where the replay's state is shown.
    """

    def __init__(
        self,
        *,
        open_camera: Callable[[], SkyCamera],
        clock: Clock,
        frame_time: FrameTime,
        name: str,
        sun_frames: DropOldestQueue[Frame],
        board: StatusRegistry,
    ) -> None:
        self._open_camera = open_camera
        self._clock = clock
        self._frame_time = frame_time
        self._name = name
        self._sun_frames = sun_frames
        self._board = board

    def run(self, stop: threading.Event, heartbeat: Callable[[], None]) -> None:
        """Play the folder once; one that does not match the stored camera is refused with a condition."""
        try:
            with closing(self._open_camera()) as camera:
                self._board.note(camera=CameraStatus(name=self._name, connected=True, address=camera.info.address))
                self._play(camera, stop, heartbeat)
        except (ConfigurationError, InputError) as error:
            CaptureReport(self._board, name=self._name).refused(error)
        while not stop.is_set():
            heartbeat()
            self._clock.wait(stop, _POLL_S)

    def _play(self, camera: SkyCamera, stop: threading.Event, heartbeat: Callable[[], None]) -> None:
        while not stop.is_set():
            heartbeat()
            try:
                frame = camera.expose(0.0)
            except CameraLostError as end:
                _log.info("%s", end)
                return
            self._frame_time.note(frame.time)
            self._board.note(last_frame_at=frame.time)
            if frame.exposure_us < _SUN_EXPOSURE_BELOW_US:
                self._hand_on(frame, stop, heartbeat)

    def _hand_on(self, frame: Frame, stop: threading.Event, heartbeat: Callable[[], None]) -> None:
        while self._sun_frames.full and not stop.is_set():
            heartbeat()
            self._clock.wait(stop, _POLL_S)
        self._sun_frames.put(frame)
