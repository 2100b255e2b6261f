"""Exposures of the night: times for the stars and for the moon, and the gain that is raised for a star exposure."""

from __future__ import annotations

import logging
import math
import threading
from collections.abc import Callable
from datetime import datetime
from typing import NamedTuple

import numpy as np

from sunarc.common.errors import CameraError, CameraLostError
from sunarc.detection.values import MOST_PEAK, Stars
from sunarc.imager.cameras.frame import Frame, GainCamera, SkyCamera
from sunarc.imager.runtime.loop import DropOldestQueue
from sunarc.imager.runtime.status import StatusRegistry, condition
from sunarc.imaging.exposure import ExposureBounds
from sunarc.sky.night import MoonDisc
from sunarc.sky.site import relative_air_mass

_log = logging.getLogger(__name__)
GAIN_NOT_RESTORED = "gain_not_restored"
LADDER_US = (10e6, 5e6, 2.5e6, 1.25e6, 0.6e6, 0.3e6)
"""In 10 s the sky turns by 0.4 px at 600 px a radian; 0.3 s is short enough for a full moon."""
_FIRST = 1
_BRIGHTEST = 30
"""Stars: of V 3 and brighter, in a clear sky."""
_MOST_CLIPPED, _FEW_CLIPPED = 0.5, 0.1
_BRIGHT_SKY, _DARK_SKY = 0.35, 0.12
"""Share of full scale: a sky above leaves no room for stars; of one below twice the exposure leaves it."""
_TOO_DARK, _DIM = 0.02, 0.2
"""Of full scale at the longest exposure: sky and bright stars that the read noise and the steps of counts drown."""
_GAIN_STEP_DB, _MOST_RAISED_DB = 6.0, 18.0
"""A factor of 2 a step, 8 at most: the read noise of sensors falls no further."""


class NightExposure(NamedTuple):
    """Length in µs, and by how many decibels the gain is raised."""

    exposure_us: float
    raised_db: float


class NightExposures:
    """Chooses the next exposure of the night by the last one's sky and stars; safe between threads."""

    def __init__(self) -> None:
        self._rung = _FIRST
        self._raised_db = 0.0
        self._lock = threading.Lock()

    def next_us(self, bounds: ExposureBounds) -> NightExposure:
        """Return the next exposure within the camera's bounds, and by how much its gain is raised."""
        with self._lock:
            rung = min(max(LADDER_US[self._rung], bounds.minimum_us), bounds.maximum_us)
            return NightExposure(rung, self._raised_db)

    def report(self, stars: Stars, *, sky_fraction: float) -> None:
        """Record an image: its detections, and the level of its sky over full scale."""
        brightest = stars.peak_fraction[:_BRIGHTEST]
        clipped = float(np.mean(brightest > MOST_PEAK)) if brightest.size == _BRIGHTEST else 0.0
        step = 0
        if sky_fraction > _BRIGHT_SKY or clipped > _MOST_CLIPPED:
            step = 1
        elif sky_fraction < _DARK_SKY and clipped < _FEW_CLIPPED:
            step = -1
        dim = sky_fraction < _TOO_DARK and not np.any(brightest > _DIM)
        with self._lock:
            if step > 0 and self._raised_db > 0.0:
                self._raised_db -= _GAIN_STEP_DB
            elif dim and self._rung == 0:
                self._raised_db = min(self._raised_db + _GAIN_STEP_DB, _MOST_RAISED_DB)
            else:
                self._rung = min(max(self._rung + step, 0), len(LADDER_US) - 1)


class MoonCapture(NamedTuple):
    """Choice of the moon's exposures, and the receiver of the frames of each slot."""

    exposures: MoonExposures
    frames: DropOldestQueue[tuple[Frame, ...]]


class NightCapture(NamedTuple):
    """Choice of the night's exposures, and the receiver of their frames; `moon` likewise, in slots with a moon."""

    exposures: NightExposures
    frames: DropOldestQueue[Frame]
    moon: MoonCapture | None = None


LOWEST_DEG = 83.0
"""Zenith angle: below, 8 air masses redden and tremble, and trees stand."""
LEAST_LIT = 0.05
"""Share of the disc; a thinner crescent is up in the twilight only."""
_FIRST_US = (20.0, 160.0, 1_280.0, 10_240.0, 81_920.0)
"""While the light of the lens is not known: a factor of 8 lies within the range of a sensor."""
_TARGET, _BESIDE = 0.5, 3.0
"""Share of full scale of the second exposure; the first is a third of it, against a thin cloud that has gone."""
MOST_LEVEL = 0.9
"""Share of full scale of the brightest pixels of the disc; beyond it some of them may be clipped."""
_DIMMER = 0.5
"""By at most so much a slot the sensitivity falls: a moon behind cloud says little of the lens."""
_FORGOTTEN_AFTER = 3
_LONGEST_US = 0.3e6
"""The shortest of the stars'; the moon moves by a twentieth of its radius meanwhile."""
_FULL_MOON = -12.7
_EXTINCTION = 0.25
"""Magnitudes an air mass."""


class MoonExposures:
    """Chooses the exposures of the moon in each slot of the night; safe between threads.

    Parameters
    ----------
    disc_at : the moon's disc at a time.
    """

    def __init__(self, disc_at: Callable[[datetime], MoonDisc]) -> None:
        self._disc_at = disc_at
        self._level_per_us: float | None = None
        self._missed = 0
        self._lock = threading.Lock()

    def next_us(self, time: datetime, bounds: ExposureBounds) -> tuple[float, ...]:
        """Return the exposures of a slot, µs, the shortest first; empty where the moon is low, thin or down."""
        brightness = self.brightness(time)
        if brightness is None:
            return ()
        with self._lock:
            level_per_us = self._level_per_us
        wanted: tuple[float, ...] = _FIRST_US
        if level_per_us is not None:
            longest = _TARGET / (level_per_us * brightness)
            wanted = (longest / _BESIDE, longest)
        most = min(bounds.maximum_us, _LONGEST_US)
        return tuple(sorted({min(max(one, bounds.minimum_us), most) for one in wanted}))

    def brightness(self, time: datetime) -> float | None:
        """Return the surface's brightness over that of a full moon above the air; None without a moon to be seen."""
        disc = self._disc_at(time)
        zenith = math.degrees(math.acos(min(max(float(disc.direction[2]), -1.0), 1.0)))
        if zenith > LOWEST_DEG or disc.illuminated_fraction < LEAST_LIT:
            return None
        lost = _EXTINCTION * float(relative_air_mass(zenith))
        return float(10.0 ** (-0.4 * (disc.magnitude - _FULL_MOON + lost)) / disc.illuminated_fraction)

    def report(self, time: datetime, levels: tuple[tuple[float, float], ...]) -> None:
        """Record the frames of a slot.

        Parameters
        ----------
        time : of the slot.
        levels : exposure in µs and brightest level over full scale of each; a level of 0 is an image without a moon.
        """
        brightness = self.brightness(time)
        if brightness is None or not levels:
            return
        good = [(us, level) for us, level in levels if 0.0 < level < MOST_LEVEL]
        with self._lock:
            if good:
                us, level = max(good)
                measured = level / (us * brightness)
                before = self._level_per_us
                self._level_per_us = measured if before is None else max(measured, _DIMMER * before)
                self._missed = 0
            elif all(level >= MOST_LEVEL for _, level in levels) and self._level_per_us is not None:
                self._level_per_us *= _BESIDE**2
            else:
                self._missed += 1
                if self._missed >= _FORGOTTEN_AFTER:  # a filter or an aperture was changed
                    self._level_per_us, self._missed = None, 0


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
        """Set the gain back to the settings' where it was raised; CameraLostError where that fails."""
        if not self._raised or not isinstance(camera, GainCamera):
            return
        try:
            camera.restore_gain()
        except CameraError as error:
            reason = condition(GAIN_NOT_RESTORED, severity="not_ready", error=str(error))
            self._board.set_condition(GAIN_NOT_RESTORED, reason)
            raise CameraLostError(f"the gain of the night was not restored: {error}") from error
        self._raised = False
        self._board.set_condition(GAIN_NOT_RESTORED, None)
