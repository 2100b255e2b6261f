"""Uncertainty of a calibration at other times than those of its sightings.

A focal length follows the seasons. A fit is of the day of its last sighting; how far the focal length may be from that
at another time is the prior of the fit's own block of the season (`season_columns`).
"""

from __future__ import annotations

import math
from bisect import bisect_left
from dataclasses import replace
from datetime import date

import numpy as np

from sunarc.calibration.answers.covariance import replace_covariance, sky_sigma_deg
from sunarc.calibration.model.result import Calibration, Provenance, suspects
from sunarc.common.array_types import FloatArray
from sunarc.common.utc import DAY_S
from sunarc.optics.camera import FOCAL_LENGTH, PARAMETER_NAMES
from sunarc.sky.days import SECONDS_PER_DEGREE, date_to_day

SEASONS = {"season": 3e-4, "season_of_plastic": 2.4e-3}
"""1-sigma of how the focal length follows the year: of glass in aluminium by 1e-5 a kelvin, of plastic by 8e-5. By the
smaller one alone the season of plastic is taken for a tilt: a summer's sun is higher than a winter's."""
_YEAR_S = 365.2422 * DAY_S
_WEEK = 0.02
"""Of a year."""
_HARMONICS = (1.0, 0.4)
"""1-sigma of the waves once and twice a year, in that of the season."""
_TRENDS = 3
"""Half waves over the record, at most, by which years differ."""
_STEPS_DAYS = (7, 14, 21, 35, 56, 84, 119, 183)
"""Ages at which the uncertainty grows: up to the first it is the fit's, after half a year a season is farthest."""


def season_columns(unix_s: FloatArray) -> FloatArray:
    """Return (n, k): changes of the focal length since the last sighting, whose camera is sought; relative to a season.

    0 in a record of a week or less, and of sightings without a time.
    """
    ago = np.nan_to_num((unix_s - np.nanmax(unix_s, initial=-math.inf)) / _YEAR_S)[:, None]
    years = float(np.ptp(ago)) if len(ago) else 0.0
    phase, size = 2.0 * math.pi * ago * np.arange(1, len(_HARMONICS) + 1), np.array(_HARMONICS)
    half_waves = np.arange(1, _TRENDS + 1)
    trend = min(years, 1.0) * (np.cos(math.pi * half_waves * ago / max(years, _WEEK)) - 1.0) / half_waves
    return (years > _WEEK) * np.concatenate([size * np.sin(phase), size * (np.cos(phase) - 1.0), trend], axis=1)


def age_step_days(calibration: Calibration, unix_s: float) -> int:
    """Return how long after the last day of its sightings a time is, in days: the next step, negative before that day.

    0 within a week, and without days.
    """
    days = calibration.evidence.days
    if not days:
        return 0
    noon = date_to_day(date.fromisoformat(max(days))) + 0.5 - calibration.site.longitude * SECONDS_PER_DEGREE / DAY_S
    age = unix_s / DAY_S - noon
    if abs(age) <= _STEPS_DAYS[0]:
        return 0
    step = _STEPS_DAYS[min(bisect_left(_STEPS_DAYS, abs(age)), len(_STEPS_DAYS) - 1)]
    return int(math.copysign(step, age))


def focal_share(evidence: Provenance, days: float) -> float:
    """Return the 1-sigma of a focal length's change within so many days, as a share of itself; 0 within a week.

    The season is that of glass; that of plastic where the sightings suspect it, and as the more probable of both.
    """
    odds = {name: evidence.log_odds.get(name, -math.inf) for name in SEASONS}
    usual, best = next(iter(SEASONS)), max(odds, key=lambda name: odds[name])
    share = SEASONS[best if suspects(best, odds[best]) else usual]
    return share * float(np.linalg.norm(season_columns(np.array([0.0, abs(days) * DAY_S]))[0]))


def add_focal_change(calibration: Calibration, share: float) -> Calibration:
    """Return a calibration whose focal length may be another by a share of itself (1-sigma).

    Its 1-sigma over the sky stays that of its own time.
    """
    names = calibration.parameter_names
    change = np.zeros(len(names))
    for name, focal in zip(PARAMETER_NAMES[FOCAL_LENGTH], calibration.camera.focal_length_px, strict=True):
        if name in names:
            change[names.index(name)] = share * focal
    return replace_covariance(calibration, calibration.covariance + np.outer(change, change)) if share else calibration


def aged(calibration: Calibration, days: int) -> Calibration:
    """Return a calibration with the uncertainty that it has so many days from its last sighting.

    One that is of another time already is returned as it is.
    """
    share = 0.0 if calibration.aged_days else focal_share(calibration.evidence, days)
    if share == 0.0:
        return calibration
    widened = add_focal_change(calibration, share)
    before, without = calibration.sky_rms_deg, calibration.sky_rms_without_clock_deg
    rms, most = sky_sigma_deg(widened)
    if without is not None:
        without = math.sqrt(max(without**2 + rms**2 - before**2, 0.0))
    return replace(widened, sky_rms_deg=rms, sky_max_deg=most, sky_rms_without_clock_deg=without, aged_days=days)
