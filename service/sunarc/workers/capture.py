"""The cycle: the normal exposures at their slot as though nothing else were there, then the sun exposures."""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable, Sequence
from contextlib import closing
from dataclasses import dataclass

from sunarc.board import CameraStatus, Reason, StatusBoard
from sunarc.cameras import Frame, SkyCamera
from sunarc.clock import Clock
from sunarc.errors import CameraError, CameraLostError, InputError
from sunarc.workers.frame_time import FrameTime
from sunarc.workers.handover import Handover
from sunarc.workers.sun_exposures import SunExposures

_log = logging.getLogger(__name__)
_HEARTBEAT_S = 1.0


@dataclass(frozen=True, slots=True, kw_only=True)
class CaptureOptions:
    """The cadence.

    Attributes
    ----------
    cadence_s : seconds from slot to slot; slots are whole multiples of it since 1970-01-01 UTC.
    hdr_exposures_us : the normal exposures, in the order taken.
    daylight_zenith_deg : composites are made while the sun's apparent zenith angle is below this.
    sun_zenith_deg : sun exposures are taken while it is below this.
    night_cadence_s : seconds between the sign-of-life exposures of the night, which are not kept.
    attempts : how often one exposure is tried before the cycle goes on without it.
    reopen_after_s : seconds before a lost camera is tried again; doubles up to `reopen_at_most_s`.
    camera_clock_error_s : bound of the camera's clock's error, where frames are dated by it (PTP).
    speed : seconds of the camera's clock in a real second; other than 1 only for a simulated camera.
    """

    cadence_s: float = 30.0
    hdr_exposures_us: tuple[float, ...] = (3_000.0, 12_000.0, 48_000.0)
    daylight_zenith_deg: float = 96.0
    sun_zenith_deg: float = 89.6
    night_cadence_s: float = 600.0
    attempts: int = 2
    reopen_after_s: float = 1.0
    reopen_at_most_s: float = 30.0
    camera_clock_error_s: float = 0.001
    speed: float = 1.0

    def __post_init__(self) -> None:
        """Refuse a cycle that cannot be kept."""
        if self.cadence_s <= 0.0 or self.night_cadence_s <= 0.0 or self.speed <= 0.0:
            raise InputError(field="capture", problem="a duration is not positive", remedy="give seconds above 0")
        if not self.hdr_exposures_us or min(self.hdr_exposures_us) <= 0.0:
            raise InputError(
                field="capture.hdr_exposures_us", problem="not positive", remedy="give exposures in microseconds"
            )
        if self.attempts < 1:
            raise InputError(field="capture.attempts", problem="below 1", remedy="give 1 or more")


class CaptureWorker:
    """Drives the camera, and opens it anew for as long as it takes when it is lost.

    Parameters
    ----------
    open_camera : opens the camera; raises `CameraError` when it does not answer.
    clock, frame_time : real time, and the time that the frames tell.
    options : the cadence.
    name : the camera's name on the board.
    apparent_zenith : the sun's, in degrees, at a frame time.
    sun_exposures : which sun exposures to take next.
    cycles, sun_frames : where the normal frames of a cycle and the sun frames go.
    board : where the camera's state is shown.
    """

    def __init__(
        self,
        *,
        open_camera: Callable[[], SkyCamera],
        clock: Clock,
        frame_time: FrameTime,
        options: CaptureOptions,
        name: str,
        apparent_zenith: Callable[[], float],
        sun_exposures: SunExposures,
        cycles: Handover[Sequence[Frame]],
        sun_frames: Handover[Frame],
        board: StatusBoard,
    ) -> None:
        self._open_camera = open_camera
        self._clock = clock
        self._frame_time = frame_time
        self._options = options
        self._name = name
        self._apparent_zenith = apparent_zenith
        self._sun_exposures = sun_exposures
        self._cycles = cycles
        self._sun_frames = sun_frames
        self._board = board

    def run(self, stop: threading.Event, heartbeat: Callable[[], None]) -> None:
        """Capture until stopped; a lost camera is opened again, ever less often."""
        pause_s = self._options.reopen_after_s
        while not stop.is_set():
            heartbeat()
            try:
                with closing(self._open_camera()) as camera:
                    self._show_camera(camera)
                    pause_s = self._options.reopen_after_s
                    self._capture(camera, stop, heartbeat)
            except CameraError as error:
                self._show_lost(error)
                self._wait(stop, heartbeat, pause_s)
                pause_s = min(2.0 * pause_s, self._options.reopen_at_most_s)

    def _capture(self, camera: SkyCamera, stop: threading.Event, heartbeat: Callable[[], None]) -> None:
        if not self._frame_time.known:
            self._expose(camera, camera.info.exposure_min_us)
        while not stop.is_set():
            daylight = self._apparent_zenith() < self._options.daylight_zenith_deg
            every_s = self._options.cadence_s if daylight else self._options.night_cadence_s
            slot = self._frame_time.next_slot(every_s=every_s)
            if self._wait(stop, heartbeat, self._frame_time.real_seconds_until(slot)):
                return
            if daylight:
                self.cycle(camera)
            else:
                self._expose(camera, self._options.hdr_exposures_us[0])

    def cycle(self, camera: SkyCamera) -> None:
        """Take the exposures of one slot and hand them over."""
        normal = [self._expose(camera, exposure_us) for exposure_us in self._options.hdr_exposures_us]
        if self._apparent_zenith() < self._options.sun_zenith_deg:
            for exposure_us in self._sun_exposures.choose(camera.info):
                frame = self._expose(camera, exposure_us)
                if frame is not None:
                    self._sun_frames.put(frame)
        frames = [frame for frame in normal if frame is not None]
        if not frames:
            raise CameraLostError("no exposure of a whole cycle succeeded")
        if len(frames) == len(normal):
            self._cycles.put(frames)

    def _expose(self, camera: SkyCamera, exposure_us: float) -> Frame | None:
        """Return a frame, or None when every attempt failed; a lost camera is for `run`."""
        for _ in range(self._options.attempts):
            try:
                frame = camera.expose(exposure_us)
            except CameraLostError:
                raise
            except CameraError as error:
                _log.warning("exposure of %g us failed: %s", exposure_us, error)
            else:
                self._frame_time.note(frame.time)
                self._board.note(last_frame_at=frame.time)
                self._board.clear_reason("exposures_failing")
                return frame
        self._board.set_reason(
            Reason(
                code="exposures_failing",
                severity="degraded",
                text=f"the last exposure failed {self._options.attempts} times",
                remedy="check the network between host and camera, and the journal for what was seen",
            )
        )
        return None

    def _wait(self, stop: threading.Event, heartbeat: Callable[[], None], seconds: float) -> bool:
        """Wait with signs of life; return whether to stop."""
        end = self._clock.monotonic() + seconds
        while not stop.is_set():
            heartbeat()
            left = end - self._clock.monotonic()
            if left <= 0.0:
                return False
            self._clock.wait(stop, min(left, _HEARTBEAT_S))
        return True

    def _show_camera(self, camera: SkyCamera) -> None:
        info = camera.info
        _log.info("camera %s %s (%s) answers at %s", info.vendor, info.model, info.serial, info.address)
        self._board.clear_reason("camera_lost")
        self._board.note(
            camera=CameraStatus(
                name=self._name,
                connected=True,
                address=info.address,
                model=f"{info.vendor} {info.model}".strip(),
                serial=info.serial,
            )
        )

    def _show_lost(self, error: CameraError) -> None:
        _log.warning("camera lost: %s", error)
        self._board.note(camera=CameraStatus(name=self._name, connected=False))
        self._board.set_reason(
            Reason(
                code="camera_lost",
                severity="degraded",
                text=str(error),
                remedy="check the camera's power, cable and address; it is tried again by itself",
            )
        )
