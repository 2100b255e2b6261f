"""Several frames of the disc: those of one bracket as one sighting, and the brightness of the clear sun over days."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from sunarc.common.array_types import FloatArray, IntArray
from sunarc.common.errors import InputError
from sunarc.common.findings import Finding
from sunarc.detection.values import Detection
from sunarc.sky.site import CLEAR_OPTICAL_DEPTH, relative_air_mass

_AGREE_PX = 0.1  # smaller differences are accepted: a lens's glare moves a saturated disc a little
_SIGNIFICANCE = 1e-4  # probability of a larger chi² by chance below which frames are inconsistent


def combine(detections: Sequence[Detection], *, shifts: Sequence[tuple[float, float]] | None = None) -> Detection:
    """Return the mean of a bracket's accepted detections, weighted by inverse variance.

    Parameters
    ----------
    detections : of frames taken within seconds.
    shifts : how far the sun had moved in each frame since the reference time, px; it is subtracted. None: no motion.

    Returns
    -------
    The most certain detection with the mean position and its sigma, widened where the frames scatter more than their
    sigmas. Where they scatter beyond chance (chi², probability 1e-4) it is rejected. Where none was accepted: the one
    of the largest signal-to-noise ratio.

    Raises
    ------
    InputError : no detections, or not one shift for each.
    """
    if not detections or (shifts is not None and len(shifts) != len(detections)):
        raise InputError(
            field="detections",
            problem=f"{len(detections)} detections, {0 if shifts is None else len(shifts)} shifts",
            remedy="give at least one, and a shift for each",
        )
    moved = [
        _shift_detection(one, shift)
        for one, shift in zip(detections, shifts or [(0.0, 0.0)] * len(detections), strict=True)
    ]
    accepted = [one for one in moved if one.accepted and one.x_px is not None and one.sigma_px]
    if not accepted:
        return max(moved, key=lambda one: -math.inf if one.snr is None else one.snr)
    return _combine_detections(accepted)


def check_against_bracket(
    earlier: Sequence[Detection], latest: Detection, *, shifts: Sequence[tuple[float, float]] | None
) -> Detection:
    """Return a frame's detection, checked against the earlier frames of its bracket.

    Parameters
    ----------
    earlier : detections of the same bracket's frames.
    latest : the detection to check.
    shifts : how far the sun moved from each earlier frame to this one, px; None where that is not known, and then
        positions are not compared.

    Returns
    -------
    The detection; rejected where a frame of larger signal-to-noise ratio shows the disc partly covered, or where its
    position and an accepted earlier one differ by more than 0.1 px and more than chance allows.
    """
    if not latest.accepted:
        return latest
    covered = [
        one for one in earlier if one.verdict == "partly_covered" and (one.snr or 0.0) > (latest.snr or math.inf)
    ]
    if covered:
        return replace(
            latest,
            accepted=False,
            verdict="partly_covered",
            findings=(Finding("bracket_covered"), *covered[0].findings),
        )
    if shifts is None:
        return latest
    for one, (dx, dy) in zip(earlier, shifts, strict=True):
        shifted = _shift_detection(one, (-dx, -dy))
        if shifted.accepted and _distance_px(shifted, latest) > _AGREE_PX:
            joined = combine([shifted, latest])
            if not joined.accepted:
                return replace(latest, accepted=False, verdict=joined.verdict, findings=joined.findings)
    return latest


def _distance_px(one: Detection, other: Detection) -> float:
    if one.x_px is None or one.y_px is None or other.x_px is None or other.y_px is None:
        return 0.0
    return math.hypot(one.x_px - other.x_px, one.y_px - other.y_px)


def _shift_detection(detection: Detection, shift: tuple[float, float]) -> Detection:
    if detection.x_px is None or detection.y_px is None:
        return detection
    return replace(detection, x_px=detection.x_px - shift[0], y_px=detection.y_px - shift[1])


def _combine_detections(accepted: list[Detection]) -> Detection:
    best = min(accepted, key=lambda one: one.sigma_px or math.inf)
    if len(accepted) == 1:
        return best
    position: FloatArray = np.array([(one.x_px, one.y_px) for one in accepted])
    weight = np.array([one.sigma_px or math.inf for one in accepted]) ** -2.0
    mean = weight @ position / weight.sum()
    chi2, freedom = float(weight @ np.sum((position - mean) ** 2, axis=1)), 2 * (len(accepted) - 1)
    joined = replace(
        best,
        x_px=float(mean[0]),
        y_px=float(mean[1]),
        # Birge's ratio, upward only: frames that agree by luck are not more certain than their sigmas.
        sigma_px=math.sqrt(max(1.0, chi2 / freedom) / float(weight.sum())),
    )
    scatter = {"frames": len(accepted), "chi2": chi2, "freedom": freedom}
    from scipy.special import chdtri  # noqa: PLC0415 - the service starts sooner without it

    if chi2 > float(chdtri(freedom, _SIGNIFICANCE)):
        inconsistent = Finding("bracket_inconsistent", scatter)
        return replace(joined, accepted=False, verdict="partly_covered", findings=(inconsistent,))
    return replace(joined, findings=(*best.findings, Finding("bracket_mean", scatter)))


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
    tops = [
        top
        for k in np.unique(bins)
        if (top := _clear_level_of_bin(air[bins == k], logs[bins == k], day[bins == k])) is not None
    ]
    if not tops:
        return None
    masses, levels = np.array(tops).T
    design = np.column_stack([np.ones_like(masses), -masses])
    matrix = design.T @ design / _LEVEL_SIGMA**2 + np.diag([0.0, _DEPTH_SIGMA**-2])
    right = design.T @ levels / _LEVEL_SIGMA**2 + np.array([0.0, CLEAR_OPTICAL_DEPTH / _DEPTH_SIGMA**2])
    log_level, depth = np.linalg.solve(matrix, right)
    return ClearSun(float(log_level), float(depth))


def _clear_level_of_bin(air: FloatArray, logs: FloatArray, day: IntArray) -> tuple[float, float] | None:
    """Return the mean air mass of a bin and the level that a clear sun has there."""
    above_air = logs + CLEAR_OPTICAL_DEPTH * air  # so that the top is not the highest sun's of the bin
    days = [np.quantile(above_air[day == k], _QUANTILE) for k in np.unique(day) if np.sum(day == k) >= _MIN_PER_BIN]
    if not days:
        return None
    mass, top = float(air.mean()), float(np.sort(days)[-2 if len(days) >= _SPARE_DAYS else -1])
    return mass, top - CLEAR_OPTICAL_DEPTH * mass
