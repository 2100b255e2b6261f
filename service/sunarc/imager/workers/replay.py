"""Replay of a folder of images in place of a camera."""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable
from contextlib import closing
from dataclasses import dataclass

from sunarc.common.errors import CameraLostError, ConfigurationError, InputError
from sunarc.imager.cameras.frame import Frame, SkyCamera
from sunarc.imager.runtime.clock import Clock
from sunarc.imager.runtime.loop import DropOldestQueue, Loop
from sunarc.imager.runtime.status import CameraStatus, StatusRegistry
from sunarc.imager.workers.capture_status import CaptureReport
from sunarc.imager.workers.clock_watch import FrameTime

_log = logging.getLogger(__name__)
_POLL_S = 0.2
_SUN_EXPOSURE_BELOW_US = 1000.0


@dataclass(kw_only=True, eq=False)
class ReplayWorker:
    """Worker that queues the sun exposures of a folder in order, and then waits to be stopped.

    Parameters
    ----------
    open_camera : opens the folder; raises `CameraError` when there is nothing to play.
    clock, frame_time : real time, and the time of the images.
    name : the camera's name on the board.
    sun_frames : where the images of the sun go; nothing is dropped, the replay waits for room.
    board : where the replay's state is shown.
    """

    open_camera: Callable[[], SkyCamera]
    clock: Clock
    frame_time: FrameTime
    name: str
    sun_frames: DropOldestQueue[Frame]
    board: StatusRegistry

    def run(self, stop: threading.Event, heartbeat: Callable[[], None]) -> None:
        """Play the folder once; one that does not match the stored camera is refused with a condition."""
        loop = Loop(self.clock, stop, heartbeat)
        try:
            with closing(self.open_camera()) as camera:
                self.board.note(camera=CameraStatus(name=self.name, connected=True, address=camera.info.address))
                self._play_folder(camera, loop)
        except (ConfigurationError, InputError) as error:
            CaptureReport(self.board, name=self.name).refused(error)
        loop.every(_POLL_S, lambda: None)

    def _play_folder(self, camera: SkyCamera, loop: Loop) -> None:
        for _ in loop.turns():
            try:
                frame = camera.expose(0.0)
            except CameraLostError as end:
                _log.info("%s", end)
                return
            self.frame_time.note(frame.time)
            self.board.note(last_frame_at=frame.time)
            if frame.exposure_us < _SUN_EXPOSURE_BELOW_US:
                self._queue_frame(frame, loop)

    def _queue_frame(self, frame: Frame, loop: Loop) -> None:
        while self.sun_frames.full and not loop.wait(_POLL_S):
            pass
        self.sun_frames.put(frame)
