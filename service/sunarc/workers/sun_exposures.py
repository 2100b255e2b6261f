"""Which sun exposures come next: the controller's state, shared by capture (asks) and detect (tells)."""

from __future__ import annotations

import threading

from sunarc.cameras import CameraInfo, Frame
from sunarc.detection import Detection
from sunarc.imaging import (
    ExposureBounds,
    Peak,
    SunExposureOptions,
    SunExposureState,
    first_sun_exposures,
    next_sun_exposures,
)


class SunExposures:
    """Joins the pure exposure controller to the two workers.

    Parameters
    ----------
    options : what the controller aims at.
    """

    def __init__(self, options: SunExposureOptions) -> None:
        self._options = options
        self._lock = threading.Lock()
        self._state: SunExposureState | None = None
        self._seen: list[Peak] = []
        self._reported = 0

    def choose(self, info: CameraInfo) -> tuple[float, ...]:
        """Return this cycle's sun exposures in microseconds, within the camera's bounds.

        A cycle whose frames have not been looked at yet changes nothing.
        """
        bounds = ExposureBounds(
            minimum_us=info.exposure_min_us, maximum_us=info.exposure_max_us, step_us=info.exposure_step_us
        )
        with self._lock:
            if self._state is None:
                self._state = first_sun_exposures(self._options, bounds)
            elif self._reported:
                self._state = next_sun_exposures(self._state, self._seen, options=self._options, bounds=bounds)
            self._seen, self._reported = [], 0
            return self._state.exposures_us

    def report(self, frame: Frame, detection: Detection) -> None:
        """Take note of what a sun exposure showed; what is too bright to be believed still says "shorter"."""
        with self._lock:
            self._reported += 1
            telling = detection.accepted or detection.saturated_px > 0
            if telling and detection.peak_fraction is not None:
                self._seen.append(Peak(exposure_us=frame.exposure_us, fraction=detection.peak_fraction))
