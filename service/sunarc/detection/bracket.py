"""The frames of one bracket as a single sighting."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.special import chdtri

from sunarc.detection.values import Detection, FloatArray
from sunarc.errors import InputError

_DOUBT = 1e-4  # probability below which honest frames disagree so much


def combine(detections: Sequence[Detection], *, shifts: Sequence[tuple[float, float]] | None = None) -> Detection:
    """Return the mean of a bracket's accepted detections, weighted by their inverse variances.

    Parameters
    ----------
    detections : of frames taken within seconds.
    shifts : how far the sun had moved in each frame since the moment aimed at, px; it is subtracted. None: nowhere.

    Returns
    -------
    The most certain detection with the mean position and its sigma, widened where the frames scatter more than their
    sigmas tell. Where they scatter beyond chance (chi², probability 1e-4) it is not accepted. Where none was accepted:
    the one of the largest signal-to-noise.

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
        _moved(one, shift) for one, shift in zip(detections, shifts or [(0.0, 0.0)] * len(detections), strict=True)
    ]
    believed = [one for one in moved if one.accepted and one.x_px is not None and one.sigma_px]
    if not believed:
        return max(moved, key=lambda one: -math.inf if one.snr is None else one.snr)
    return _joined(believed)


def _moved(detection: Detection, shift: tuple[float, float]) -> Detection:
    if detection.x_px is None or detection.y_px is None:
        return detection
    return replace(detection, x_px=detection.x_px - shift[0], y_px=detection.y_px - shift[1])


def _joined(believed: list[Detection]) -> Detection:
    best = min(believed, key=lambda one: one.sigma_px or math.inf)
    if len(believed) == 1:
        return best
    position: FloatArray = np.array([(one.x_px, one.y_px) for one in believed])
    weight = np.array([one.sigma_px or math.inf for one in believed]) ** -2.0
    mean = weight @ position / weight.sum()
    chi2, freedom = float(weight @ np.sum((position - mean) ** 2, axis=1)), 2 * (len(believed) - 1)
    joined = replace(
        best,
        x_px=float(mean[0]),
        y_px=float(mean[1]),
        sigma_px=math.sqrt(max(1.0, chi2 / freedom) / float(weight.sum())),
    )
    scatter = f"of {len(believed)} frames, chi² {chi2:.1f} for {freedom}"
    if chi2 > float(chdtri(freedom, _DOUBT)):
        return replace(
            joined, accepted=False, verdict="partly_covered", reason=f"the bracket disagrees: mean {scatter}"
        )
    return replace(joined, reason=f"{best.reason}; mean {scatter}")
