"""How long the exposures of the night are: as long as the sky and the bright stars allow."""

from __future__ import annotations

import threading
from typing import NamedTuple

import numpy as np

from sunarc.cameras import Frame
from sunarc.detection import MOST_PEAK, Stars
from sunarc.imaging import ExposureBounds
from sunarc.workers.bounded_queue import DropOldestQueue

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


class NightExposures:
    """Chooses the next exposure of the night by the last one's sky and stars; safe between threads."""

    def __init__(self) -> None:
        self._rung = _FIRST
        self._lock = threading.Lock()

    def next_us(self, bounds: ExposureBounds) -> float:
        """Return the next exposure, µs, within the camera's bounds."""
        with self._lock:
            wanted = LADDER_US[self._rung]
        return min(max(wanted, bounds.minimum_us), bounds.maximum_us)

    def report(self, stars: Stars, *, sky_fraction: float) -> None:
        """Take note of an image: its detections, and the level of its sky over full scale."""
        brightest = stars.peak_fraction[:_BRIGHTEST]
        clipped = float(np.mean(brightest > MOST_PEAK)) if brightest.size == _BRIGHTEST else 0.0
        step = 0
        if sky_fraction > _BRIGHT_SKY or clipped > _MOST_CLIPPED:
            step = 1
        elif sky_fraction < _DARK_SKY and clipped < _FEW_CLIPPED:
            step = -1
        with self._lock:
            self._rung = min(max(self._rung + step, 0), len(LADDER_US) - 1)


class NightCapture(NamedTuple):
    """How the night's exposures are chosen, and where their frames go."""

    exposures: NightExposures
    frames: DropOldestQueue[Frame]
