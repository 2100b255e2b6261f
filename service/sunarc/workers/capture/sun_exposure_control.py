"""State of the sun exposure control, shared by capture and detection."""

from __future__ import annotations

import threading
from collections.abc import Callable

import numpy as np

from sunarc.cameras.frame import CameraInfo, Frame
from sunarc.detection.values import Detection
from sunarc.imaging.exposure import (
    ExposureBounds,
    Peak,
    SunExposureOptions,
    SunExposureState,
    SunLook,
    first_sun_exposures,
    next_sun_exposures,
)
from sunarc.runtime.status import StatusRegistry
from sunarc.workers.messages import condition

_SATURATED = 0.98
_BURNT_PX = 30
_BURNT_LEVEL = 4.0  # of a sun that left a streak and no disc: "much shorter"
_CODE = "sun_too_bright"

SPOILED_AFTER = 20
"""Cycles in which even the shortest exposure was burnt beyond use, after which it is reported: 10 minutes."""


class SunExposures:
    """Passes detections to the exposure control and its exposures to capture.

    Parameters
    ----------
    options : what the controller aims at.
    apparent_zenith : the sun's now, degrees.
    clear_level_per_us : the clear sun's level in 1 µs over full scale; 0 while unknown.
    board : where a sun too bright for the camera is shown.
    """

    def __init__(
        self,
        options: SunExposureOptions,
        *,
        apparent_zenith: Callable[[], float] = lambda: 0.0,
        clear_level_per_us: Callable[[], float] = lambda: 0.0,
        board: StatusRegistry | None = None,
    ) -> None:
        self._options = options
        self._apparent_zenith = apparent_zenith
        self._clear_level_per_us = clear_level_per_us
        self._board = board
        self._lock = threading.Lock()
        self._state: SunExposureState | None = None
        self._shortest_us = 0.0
        self._peaks: list[Peak] = []
        self._spoiled = False
        self._reported = 0

    def choose(self, info: CameraInfo) -> tuple[float, ...]:
        """Return this cycle's sun exposures in microseconds, within the camera's bounds.

        A cycle whose frames have not been looked at yet changes nothing.
        """
        bounds = info.exposure_bounds
        zenith, clear_level = self._apparent_zenith(), self._clear_level_per_us()
        with self._lock:
            observation = SunLook(
                peaks=tuple(self._peaks), apparent_zenith=zenith, clear_level_per_us=clear_level, spoiled=self._spoiled
            )
            if self._state is None:
                self._state = first_sun_exposures(self._options, bounds)
            elif self._reported:
                self._state = next_sun_exposures(self._state, observation, options=self._options, bounds=bounds)
                self._publish(self._state, bounds)
            self._shortest_us = bounds.minimum_us + bounds.step_us
            self._peaks, self._spoiled, self._reported = [], False, 0
            return self._state.exposures_us

    def report(self, frame: Frame, detection: Detection) -> None:
        """Take the result of a sun exposure; one that is too bright to be accepted still shortens the next."""
        with self._lock:
            self._reported += 1
            burnt = not detection.accepted and _is_burnt(frame)
            is_informative = detection.accepted or detection.saturated_px > 0
            if burnt:  # whatever was fitted to the streak
                level = max(detection.peak_fraction or 0.0, _BURNT_LEVEL)
                self._peaks.append(Peak(exposure_us=frame.exposure_us, fraction=level))
            elif is_informative and detection.peak_fraction is not None:
                self._peaks.append(Peak(exposure_us=frame.exposure_us, fraction=detection.peak_fraction))
            self._spoiled |= burnt and frame.exposure_us <= self._shortest_us

    def _publish(self, state: SunExposureState, bounds: ExposureBounds) -> None:
        if self._board is None:
            return
        if state.cycles_spoiled >= SPOILED_AFTER:
            self._board.set_condition(_CODE, condition(_CODE, exposure_us=bounds.minimum_us))
        elif state.cycles_spoiled == 0:
            self._board.set_condition(_CODE, None)


def _is_burnt(frame: Frame) -> bool:
    """Return whether so much is saturated that only the sun can have done it."""
    saturated = int(np.count_nonzero(frame.image >= _SATURATED * frame.full_scale))
    return saturated * frame.binning**2 > _BURNT_PX
