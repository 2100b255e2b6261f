"""Where the sun should be in the image, from the calibration that is current."""

from __future__ import annotations

import math
import threading
from datetime import datetime, timedelta

import numpy as np

from sunarc.calibration.answers.covariance import project_with_covariance, without_clock
from sunarc.calibration.model.sightings import MAX_CLOCK_ERROR_S
from sunarc.detection.disc.series import ClearSun, clear_sun
from sunarc.detection.values import Expectation
from sunarc.imager.archive.archive import CameraArchive
from sunarc.optics.forward import local_stretch
from sunarc.sky.days import solar_days
from sunarc.sky.sun import sun_angles, sun_directions

_LEAST_UNCERTAINTY_PX = 2.0
_BRIGHTNESS_OF = timedelta(days=5)
_BRIGHTNESS_EVERY = timedelta(hours=1)


class SunPredictor:
    """Predicts the sun's position in the sky and on the sensor.

    Parameters
    ----------
    camera : whose archive has the calibrations, the brightness of earlier sightings and the site.
    """

    def __init__(self, camera: CameraArchive) -> None:
        self._camera = camera
        self._lock = threading.Lock()
        self._clear: tuple[datetime, ClearSun | None] | None = None

    def apparent_zenith(self, time: datetime) -> float:
        """Return the sun's apparent zenith angle in degrees."""
        return float(sun_angles(time.timestamp(), self._camera.site).apparent_zenith)

    def clear_level_per_us(self, time: datetime) -> float:
        """Return the clear sun's level over full scale in 1 µs, learned from the last 5 days; 0 while unknown.

        What is older is forgotten, so that a filter, dirt or another gain change the answer within 5 days, even where
        they had every sighting refused. The archive is asked once an hour of the frames' time.
        """
        with self._lock:
            if self._clear is None or not timedelta(0) <= time - self._clear[0] < _BRIGHTNESS_EVERY:
                self._clear = (time, self._learned_clear_sun(time))
            clear = self._clear[1]
        return 0.0 if clear is None else clear.level_per_us(self.apparent_zenith(time))

    def _learned_clear_sun(self, time: datetime) -> ClearSun | None:
        unix_s, levels = self._camera.archive.sightings.sun_levels(
            self._camera.name,
            since=time - _BRIGHTNESS_OF,
            until=time,
            largest_clock_error_s=MAX_CLOCK_ERROR_S,
        )
        zenith = sun_angles(unix_s, self._camera.site).apparent_zenith
        day = solar_days(unix_s, longitude=self._camera.site.longitude)
        return clear_sun(apparent_zenith=zenith, level_per_us=levels, day=day)

    def calibration_id(self) -> str | None:
        """Return the id of the calibration that is current."""
        record = self._camera.archive.calibrations.current(self._camera.name)
        return None if record is None else record.id

    def expectation(self, time: datetime) -> Expectation | None:
        """Return where the sun should be, in the day's air where it was measured.

        None before there is a calibration, or outside its field.
        """
        calibration = self._camera.archive.calibrations.current_model(self._camera.name)
        if calibration is None:
            return None
        site = self._camera.site_with_air_at(time)
        direction = sun_directions(time.timestamp(), site)
        pixel, covariance = project_with_covariance(without_clock(calibration), direction)
        if not np.all(np.isfinite(pixel)):
            return None
        (a, b), (c, d) = local_stretch(calibration.camera, direction).tolist()
        uncertainty = math.sqrt(float(np.trace(covariance)) / 2.0)
        return Expectation(
            x_px=float(pixel[0]),
            y_px=float(pixel[1]),
            uncertainty_px=max(uncertainty, _LEAST_UNCERTAINTY_PX),
            stretch_px_per_rad=((a, b), (c, d)),
            apparent_zenith=math.radians(float(sun_angles(time.timestamp(), site).apparent_zenith)),
        )
