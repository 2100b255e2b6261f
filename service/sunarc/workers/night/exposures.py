"""How long the exposures of the night are: as long as the sky and the bright stars allow."""

from __future__ import annotations

import threading
from typing import NamedTuple

import numpy as np

from sunarc.cameras.frame import Frame
from sunarc.detection.stars.values import MOST_PEAK, Stars
from sunarc.imaging.exposure import ExposureBounds
from sunarc.workers.bounded_queue import DropOldestQueue
from sunarc.workers.night.moon import MoonCapture

DARK_ZENITH_DEG = 102.0
"""The sun's zenith angle from which on it is night: -12 degrees."""

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
        """Take note of an image: its detections, and the level of its sky over full scale."""
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


class NightCapture(NamedTuple):
    """How the night's exposures are chosen, and where their frames go; `moon` likewise, in slots with a moon."""

    exposures: NightExposures
    frames: DropOldestQueue[Frame]
    moon: MoonCapture | None = None
