"""How far two cameras are from each other over the sky."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from sunarc.array_types import FloatArray
from sunarc.calibration.model.covariance import hemisphere
from sunarc.errors import InputError
from sunarc.exports.view import View, rotated

ZENITH_RANGES_DEG = ((0.0, 30.0), (30.0, 60.0), (60.0, 80.0), (80.0, 90.0))
_COUNT = 5003
"""Directions that are compared. Not the number of those that a model is fitted to (see `sky`): other directions."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Differences:
    """Size of differences.

    Attributes
    ----------
    n : how many directions.
    rms_px, max_px : from a direction to its pixel.
    rms_deg, max_deg : from a pixel to its direction.
    """

    n: int
    rms_px: float
    max_px: float
    rms_deg: float
    max_deg: float


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Comparison:
    """How far a second camera is from a first one, over the sky in the first one's image.

    Attributes
    ----------
    total : over all of it that the second one describes.
    by_zenith : in `ZENITH_RANGES_DEG`; n = 0 and NaN where the image has none.
    undescribed : share of the sky for which the second one has no pixel or no direction.
    described_to_deg : smallest zenith angle of such a direction; 90 where there is none.
    rotation_deg : angle of the rotation that brings the second one's directions closest to the first one's.
    rotation_vector_deg : the same as a vector: about east, north and up.
    rms_rotated_deg : of the differences that are left by that rotation.
    directions : (n, 3) those compared, east-north-up.
    off_px : (n, 2) second pixel minus first one; NaN where undescribed.
    off_deg : (n,) angle between the directions; NaN where undescribed.
    """

    total: Differences
    by_zenith: tuple[Differences, ...]
    undescribed: float
    described_to_deg: float
    rotation_deg: float
    rotation_vector_deg: tuple[float, float, float]
    rms_rotated_deg: float
    directions: FloatArray
    off_px: FloatArray
    off_deg: FloatArray

    def __str__(self) -> str:
        """Say it in one sentence."""
        ranges = ", ".join(
            f"{low:.0f}-{high:.0f}: {one.rms_px:.2g} px ({one.rms_deg:.2g})"
            for (low, high), one in zip(ZENITH_RANGES_DEG, self.by_zenith, strict=True)
            if one.n
        )
        total = self.total
        beyond = (
            ""
            if self.undescribed == 0.0
            else f"; the format cannot describe {100.0 * self.undescribed:.2g} % of the sky in the image, from "
            f"{self.described_to_deg:.1f} degrees of zenith angle on"
        )
        return (
            f"differs from the calibration by {total.rms_px:.2g} px RMS and {total.max_px:.2g} px at most from a "
            f"direction to a pixel, by {total.rms_deg:.2g} degrees RMS and {total.max_deg:.2g} degrees at most from a "
            f"pixel to a direction, over the sky in the image; RMS by degrees of zenith angle {ranges}{beyond}"
        )


def compare(first: View, second: View) -> Comparison:
    """Return how far the second camera is from the first one.

    Where one of the two has no pose, the second one is rotated to fit best before.

    Raises
    ------
    InputError
        The images are of different sizes, or nothing of the sky is described by both.
    """
    if (first.width, first.height) != (second.width, second.height):
        raise InputError(
            field="image size",
            problem=f"{first.width}x{first.height} and {second.width}x{second.height}",
            remedy="compare calibrations of images of one size",
        )
    directions = hemisphere(_COUNT)
    pixels = first.project(directions)
    inside = np.all((pixels >= -0.5) & (pixels <= np.array([first.width, first.height]) - 0.5), axis=-1)
    directions, pixels = directions[inside], pixels[inside]
    here = first.unproject(pixels)
    rotation = _best_rotation(here, second.unproject(pixels))
    if not (first.has_pose and second.has_pose):
        second = rotated(second, rotation.as_matrix())
    there = second.unproject(pixels)
    off_px = second.project(directions) - pixels
    off_deg = _angle_deg(here, there)
    described = np.isfinite(off_px[:, 0]) & np.isfinite(off_deg)
    off_px[~described], off_deg[~described] = np.nan, np.nan
    left = _angle_deg(here, there @ _best_rotation(here, there).as_matrix().T)[described]
    zenith_deg = np.degrees(np.arccos(np.clip(directions[:, 2], -1.0, 1.0)))
    vector = np.degrees(rotation.as_rotvec())
    return Comparison(
        total=_differences(off_px, off_deg, described),
        by_zenith=tuple(
            _differences(off_px, off_deg, described & (zenith_deg >= low) & (zenith_deg < high))
            for low, high in ZENITH_RANGES_DEG
        ),
        undescribed=float(np.mean(~described)),
        described_to_deg=float(np.min(zenith_deg[~described], initial=90.0)),
        rotation_deg=float(np.linalg.norm(vector)),
        rotation_vector_deg=(float(vector[0]), float(vector[1]), float(vector[2])),
        rms_rotated_deg=float(np.sqrt(np.mean(left**2))),
        directions=directions,
        off_px=off_px,
        off_deg=off_deg,
    )


def _differences(off_px: FloatArray, off_deg: FloatArray, which: np.typing.NDArray[np.bool_]) -> Differences:
    n = int(np.sum(which))
    if n == 0:
        return Differences(n=0, rms_px=math.nan, max_px=math.nan, rms_deg=math.nan, max_deg=math.nan)
    px, deg = np.linalg.norm(off_px[which], axis=-1), off_deg[which]
    return Differences(
        n=n,
        rms_px=float(np.sqrt(np.mean(px**2))),
        max_px=float(np.max(px)),
        rms_deg=float(np.sqrt(np.mean(deg**2))),
        max_deg=float(np.max(deg)),
    )


def _best_rotation(first: FloatArray, second: FloatArray) -> Rotation:
    """Return the rotation that takes the second directions (n, 3) closest to the first ones (Kabsch's)."""
    both = np.isfinite(first[:, 0]) & np.isfinite(second[:, 0])
    if np.sum(both) < 3:
        raise InputError(
            field="comparison", problem="no direction of the sky is in both", remedy="compare two whole calibrations"
        )
    return Rotation.align_vectors(first[both], second[both])[0]


def _angle_deg(first: FloatArray, second: FloatArray) -> FloatArray:
    """Return the angles between unit vectors (n, 3); the half chord is exact where they are close."""
    half = 0.5 * np.linalg.norm(first - second, axis=-1)
    return np.asarray(np.degrees(2.0 * np.arcsin(np.minimum(half, 1.0))))
