"""By which rotation a camera's sightings of a day differ from where one calibration puts the sun.

Made for the comparison of days and cameras: it says nothing of the calibration's own error, which is the same on all
days, and costs a hundredth of `daily_pose_offset`, which does.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from sunarc.array_types import FloatArray
from sunarc.robust_statistics import biweights

FEWEST = 20
"""Sightings of a day that show a rotation: as many as a day's pose offset takes."""
_ROUNDS, _CUT = 8, 5.0
_MEDIAN_DISTANCE = 1.1774
"""Median of a two-dimensional distance over its 1-sigma per axis, (2 ln 2)^½."""
_LEAST_SIGMA = 1e-7
"""Radians; a smaller scatter, a ten-thousandth of a pixel, is that of made-up numbers."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class DailyRotations:
    """How a camera stood turned on the days that show the sun, against one calibration.

    Attributes
    ----------
    day : (n,) numbers of days, rising.
    rotation_deg : (n, 3) about east, north and up, right-handed, degrees: positive about "up" turns the camera
        counter-clockwise as seen from above.
    covariance_deg2 : (n, 3, 3) by the scatter of the day's sightings.
    """

    day: FloatArray
    rotation_deg: FloatArray
    covariance_deg2: FloatArray


def daily_rotations(day: FloatArray, *, observed: FloatArray, expected: FloatArray) -> DailyRotations:
    """Return the rotation of each day with at least 20 sightings that agree.

    Parameters
    ----------
    day : (n,) number of the day of each sighting.
    observed : (n, 3) directions by the calibration's camera, unit vectors east-north-up; NaN where it sees none.
    expected : (n, 3) directions of the sun.
    """
    days, found = [], []
    known = np.isfinite(observed).all(axis=-1) & np.isfinite(expected).all(axis=-1)
    for one in np.unique(day[known]).tolist():
        of_day = known & (day == one)
        rotation = _rotation(observed[of_day], expected[of_day])
        if rotation is not None:
            days.append(one)
            found.append(rotation)
    return DailyRotations(
        day=np.array(days),
        rotation_deg=np.array([rotation for rotation, _ in found]).reshape(-1, 3),
        covariance_deg2=np.array([covariance for _, covariance in found]).reshape(-1, 3, 3),
    )


def _rotation(observed: FloatArray, expected: FloatArray) -> tuple[FloatArray, FloatArray] | None:
    """Return the rotation (3,) that takes `observed` to `expected`, degrees, and its covariance; None of too few.

    Wahba's problem with Tukey's weights, again and again.
    """
    weight = np.ones(len(observed))
    for _ in range(_ROUNDS):
        if np.count_nonzero(weight) < FEWEST:
            return None
        rotation = Rotation.align_vectors(expected, observed, weights=weight)[0]
        distance = np.linalg.norm(expected - rotation.apply(observed), axis=-1)
        scale = max(float(np.median(distance)) / _MEDIAN_DISTANCE, _LEAST_SIGMA)
        weight = biweights(np.minimum(distance / (_CUT * scale), 1.0))
    variance = max(float(weight @ distance**2 / (2.0 * weight.sum())), _LEAST_SIGMA**2)
    # a small rotation w moves a direction d by w x d, which is (1 - d d^T) of w in size
    information = np.einsum("n,nij->ij", weight, np.eye(3) - expected[:, :, None] * expected[:, None, :]) / variance
    covariance = np.asarray(np.linalg.inv(information), dtype=np.float64)
    return np.asarray(rotation.as_rotvec(degrees=True)), np.degrees(np.degrees(covariance))
