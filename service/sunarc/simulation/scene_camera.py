"""A camera in this very process that shows a scene: for tests of everything that needs no wire."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable
from datetime import datetime, timedelta
from typing import Literal

from sunarc.cameras.frame import CameraCondition, CameraInfo, Frame, full_scale_of
from sunarc.detection.values import bayer_of
from sunarc.errors import CameraError, CameraLostError, CameraTimeoutError
from sunarc.runtime.clock import Clock
from sunarc.simulation.scene import Region, Scene
from sunarc.utc import to_microseconds

Fault = Literal["timeout", "lost", "error", "wrong_exposure"]
_MOST_GAIN_DB = 36.0

_WRONG_FACTOR = 4.0


class SceneCamera:
    """A `SkyCamera` over a scene.

    Parameters
    ----------
    scene : what it sees.
    clock : waited on for the length of each exposure; a `VirtualClock` moves on by it.
    now : the time at the start of an exposure, aware; the clock's unless given.
    pixel_format : "Mono8" … "Mono16", or Bayer likewise.
    region : x, y, width, height in px; None is the whole sensor.
    gain_db : amplification.
    exposure_bounds_us : shortest and longest exposure.
    has_gain : whether it has a gain to be set.
    """

    def __init__(
        self,
        scene: Scene,
        clock: Clock,
        *,
        now: Callable[[], datetime] | None = None,
        pixel_format: str = "Mono12",
        region: Region | None = None,
        gain_db: float = 0.0,
        exposure_bounds_us: tuple[float, float] = (1.0, 10_000_000.0),
        has_gain: bool = True,
    ) -> None:
        self._scene = scene
        self._clock = clock
        self._now = now or clock.now
        self._region = region or (0, 0, scene.camera.width, scene.camera.height)
        self._gain_db = gain_db
        self._raised_db = 0.0
        self.gain_stuck = False
        self._faults: deque[Fault | None] = deque()
        self._frame_id = 0
        self._open = True
        self._info = CameraInfo(
            address="in-process",
            vendor="sunarc",
            model="simulated sky",
            serial="",
            width=self._region[2],
            height=self._region[3],
            pixel_format=pixel_format,
            full_scale=full_scale_of(pixel_format),
            exposure_min_us=exposure_bounds_us[0],
            exposure_max_us=exposure_bounds_us[1],
            exposure_step_us=1.0,
            gain_raise_db=_MOST_GAIN_DB - gain_db if has_gain else 0.0,
        )

    @property
    def info(self) -> CameraInfo:
        """What is known of the camera."""
        return self._info

    def fail_next(self, *faults: Fault | None) -> None:
        """Let the next exposures fail in these ways, one each; None is a good one in between.

        "wrong_exposure" gives a frame that was exposed four times as long as it says; after "lost" nothing works.
        """
        self._faults.extend(faults)

    def expose(self, exposure_us: float) -> Frame:
        """Expose once, whole microseconds within the bounds, and return the frame (see `SkyCamera`)."""
        fault = self._faults.popleft() if self._faults else None
        self._raise(fault)
        actual_us = float(round(min(max(exposure_us, self._info.exposure_min_us), self._info.exposure_max_us)))
        start = self._now()
        image = self._scene.render(
            to_microseconds(start),
            exposure_us=actual_us * (_WRONG_FACTOR if fault == "wrong_exposure" else 1.0),
            gain_db=self._gain_db + self._raised_db,
            full_scale=self._info.full_scale,
            region=self._region,
            bayer=bayer_of(self._info.pixel_format),
        )
        self._clock.wait(threading.Event(), actual_us * 1e-6)
        image.flags.writeable = False
        self._frame_id += 1
        return Frame(
            image=image,
            time=start + timedelta(microseconds=actual_us / 2.0),
            exposure_us=actual_us,
            gain_db=self._gain_db + self._raised_db,
            pixel_format=self._info.pixel_format,
            full_scale=self._info.full_scale,
            frame_id=self._frame_id,
            raised_db=self._raised_db,
        )

    def raise_gain(self, by_db: float) -> None:
        """Raise the gain (see `SkyCamera`)."""
        self._raise(None)
        self._raised_db = by_db

    def restore_gain(self) -> None:
        """Restore the gain, unless `gain_stuck` was set: then CameraError (see `SkyCamera`)."""
        self._raise(None)
        if self.gain_stuck and self._raised_db:
            raise CameraError(f"Gain is {self._gain_db + self._raised_db:g} dB, not {self._gain_db:g}")
        self._raised_db = 0.0

    def distrust(self) -> None:
        """Change nothing: the next frame is another one."""

    def check(self) -> CameraCondition:
        """Return whether it still answers (see `SkyCamera`)."""
        self._raise(None)
        return CameraCondition(temperature_c=21.5)

    def close(self) -> None:
        """Let go of the camera."""
        self._open = False

    def _raise(self, fault: Fault | None) -> None:
        if fault == "lost":
            self._open = False
        if not self._open:
            raise CameraLostError("the simulated camera no longer answers")
        if fault == "timeout":
            raise CameraTimeoutError("no frame came from the simulated camera")
        if fault == "error":
            raise CameraError("the simulated camera's frame is not usable")
