"""Brightness of the clear sun, as the upper envelope of the sightings of some days."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from sunarc.array_types import FloatArray, IntArray
from sunarc.sky.air import CLEAR_OPTICAL_DEPTH, relative_air_mass

_MIN_PER_BIN = 5
_BINS_PER_AIR_MASS = 3.0  # per natural logarithm
_QUANTILE = 0.8  # of a bin's sightings: a few frames with a wrong exposure do not count
_SPARE_DAYS = 3  # from this number of days on the brightest one is ignored
_DEPTH_SIGMA = 0.1  # of a clear sky's optical depth
_LEVEL_SIGMA = 0.1  # of a bin's logarithm


class ClearSun(NamedTuple):
    """The clear sun's brightness.

    log_level : natural logarithm of the disc's level over full scale in 1 µs, above the air. optical_depth : of the
    clear air, vertically.
    """

    log_level: float
    optical_depth: float

    def level_per_us(self, apparent_zenith: float) -> float:
        """Return the disc's level over full scale in 1 µs, the sun at this apparent zenith angle (degrees)."""
        return math.exp(self.log_level - self.optical_depth * float(relative_air_mass(apparent_zenith)))


def clear_sun(*, apparent_zenith: FloatArray, level_per_us: FloatArray, day: IntArray) -> ClearSun | None:
    """Return the clear sun's brightness from sightings of some days; None where they are too few.

    Parameters
    ----------
    apparent_zenith : (n,) degrees.
    level_per_us : (n,) the disc's level over full scale divided by the exposure, positive.
    day : (n,) any number of the day.

    Notes
    -----
    In every range of air mass each day has the 0.8 quantile of its sightings; of the days the brightest counts, of
    three or more the second. Through these goes Bouguer's law, its optical depth held to 0.2 ± 0.1. So a lasting lower
    level is taken over when the days before it are no longer given, a higher one on its second day.
    """
    air = relative_air_mass(apparent_zenith)
    bins = np.floor(np.log(air) * _BINS_PER_AIR_MASS).astype(np.int64)
    logs = np.log(level_per_us)
    tops = [top for k in np.unique(bins) if (top := _top(air[bins == k], logs[bins == k], day[bins == k])) is not None]
    if not tops:
        return None
    masses, levels = np.array(tops).T
    design = np.column_stack([np.ones_like(masses), -masses])
    matrix = design.T @ design / _LEVEL_SIGMA**2 + np.diag([0.0, _DEPTH_SIGMA**-2])
    right = design.T @ levels / _LEVEL_SIGMA**2 + np.array([0.0, CLEAR_OPTICAL_DEPTH / _DEPTH_SIGMA**2])
    log_level, depth = np.linalg.solve(matrix, right)
    return ClearSun(float(log_level), float(depth))


def _top(air: FloatArray, logs: FloatArray, day: IntArray) -> tuple[float, float] | None:
    """Return the mean air mass of a bin and the level that a clear sun has there."""
    above_air = logs + CLEAR_OPTICAL_DEPTH * air  # so that the top is not the highest sun's of the bin
    days = [np.quantile(above_air[day == k], _QUANTILE) for k in np.unique(day) if np.sum(day == k) >= _MIN_PER_BIN]
    if not days:
        return None
    mass, top = float(air.mean()), float(np.sort(days)[-2 if len(days) >= _SPARE_DAYS else -1])
    return mass, top - CLEAR_OPTICAL_DEPTH * mass
