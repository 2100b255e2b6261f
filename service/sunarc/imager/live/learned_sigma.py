"""The sigma of sightings in image files, learned from how far they are from a calibration.

The rule: a sighting is stored with what its detector states times the factor in force, which is that of the method's
last event `sigma_learned` (1 without). After a run, and after an accepted calibration, all stored sightings and the
factor in force are multiplied by scatter over stated sigma where these differ by more than 15 %; the factor never falls
below 1 nor rises above 5. The table of sightings of `reanalyse`, where nothing is stored, has a factor for each kind of
sky (`series_sigma`).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from datetime import datetime
from typing import NamedTuple

import numpy as np

from sunarc.calibration.model.result import Calibration
from sunarc.common.array_types import FloatArray
from sunarc.common.findings import Finding
from sunarc.common.robust_statistics import robust_sigma
from sunarc.detection.values import Detection
from sunarc.imager.archive.archive import Archive
from sunarc.imager.archive.values import Event
from sunarc.imager.settings.model import Settings
from sunarc.optics.forward import project
from sunarc.sky.sun import sun_directions

_LEAST_SIGHTINGS = 20
_LARGEST_FACTOR = 5.0
"""A factor beyond is no detector's error: the calibration or the detector is wrong."""
_AS_STATED = 1.15
"""By so much scatter and stated sigma may differ before the stated sigma is changed: about 2 sigma of 50 sightings
tell of it."""
_EVENT = "sigma_learned"


class ValidCamera(NamedTuple):
    """Calibration, and the times (seconds since 1970-01-01 UTC) for which its pose holds."""

    calibration: Calibration
    since: float = -math.inf
    until: float = math.inf


def factor_in_force(archive: Archive, camera: str, method: str) -> float:
    """Return the factor of a method's stated sigma with which a sighting of an image file is stored."""
    events = archive.events.find(camera, kind=_EVENT)
    return next((float(one.details["factor"]) for one in events if one.details["method"] == method), 1.0)


def scale_detection_sigma(found: Detection, factor: float) -> Detection:
    """Return a detection with its sigma multiplied."""
    return found if found.sigma_px is None else replace(found, sigma_px=factor * found.sigma_px)


def learn_sigma(archive: Archive, settings: Settings, cameras: Sequence[ValidCamera], *, now: datetime) -> None:
    """Set the stated sigma of each method's image sightings to their scatter about the calibrations.

    It is never made smaller than the detector states: the scatter is that of the good ones; those at clouds, contrails
    and haze scatter more.
    """
    for method in archive.sightings.file_methods(settings.name):
        columns = archive.sightings.columns(settings.name, method=method, file_sightings=True)
        residual = np.full_like(columns.pixels, np.nan)
        directions = sun_directions(columns.unix_s, settings.place)
        for one in cameras:
            held = (columns.unix_s >= one.since) & (columns.unix_s < one.until)
            residual[held] = columns.pixels[held] - project(one.calibration.camera, directions[held])
        before = factor_in_force(archive, settings.name, method)
        change = sigma_factor(residual, columns.sigma_px, in_force=before)
        if change is not None:
            learned = Finding(_EVENT, {"method": method, "factor": before * change, "n": int(columns.unix_s.size)})
            event = Event.of(learned, time=now, severity="info", camera=settings.name)
            archive.sightings.scale_sigma(settings.name, method=method, factor=change, event=event)


def sigma_factor(residual: FloatArray, sigma_px: FloatArray, *, in_force: float = 1.0) -> float | None:
    """Return the factor that makes a stated sigma the scatter of the inliers; None where it is right.

    Parameters
    ----------
    residual : (n, 2) px; NaN where the camera does not see the direction.
    sigma_px : (n,) stated 1-sigma per axis, the factor in force included; NaN where not known.
    in_force : factor in force.
    """
    ratio = np.hypot(residual[:, 0], residual[:, 1]) / sigma_px
    ratio = ratio[np.isfinite(ratio)]
    if ratio.size < _LEAST_SIGHTINGS:
        return None
    change = max(robust_sigma(ratio), 1.0 / in_force)
    is_right = 1.0 / _AS_STATED <= change <= _AS_STATED
    return None if is_right or in_force * change > _LARGEST_FACTOR else change


_TAILS = 6.0
"""Robust sigmas that a residual counts as, at most: beyond are false sightings."""


def series_sigma(residual: FloatArray, sigma_px: FloatArray, sky: Sequence[str]) -> FloatArray:
    """Return (n,): 1-sigma per axis of the sightings of a series, from the scatter of those under the same kind of sky.

    It is what is stated times the root mean square of the residuals of all sightings with one verdict and about the
    same stated sigma (an octave), tails included; of kinds with few sightings, of all of them. It is never made
    smaller than the detector states: what all sightings of a series have in common does not scatter.

    Parameters
    ----------
    residual : (n, 2) px; NaN where no accepted camera says where the sun was.
    sigma_px : (n,) stated 1-sigma per axis; NaN where not known.
    sky : (n,) their verdicts.
    """
    ratio = np.hypot(residual[:, 0], residual[:, 1]) / sigma_px
    known = np.isfinite(ratio)
    factor = np.full(ratio.size, _robust_rms(ratio[known]))
    octave = np.floor(np.log2(np.where(np.isfinite(sigma_px), sigma_px, 1.0)))
    kinds = np.unique([f"{one} {size}" for one, size in zip(sky, octave, strict=True)], return_inverse=True)[1]
    for kind in np.unique(kinds):
        of_kind = kinds == kind
        if np.count_nonzero(of_kind & known) >= _LEAST_SIGHTINGS:
            factor[of_kind] = _robust_rms(ratio[of_kind & known])
    return np.asarray(sigma_px * factor)


def _robust_rms(ratio: FloatArray) -> float:
    """Return the root mean square of 2-D distances (n,) per axis, 1 at least and of few."""
    if ratio.size < _LEAST_SIGHTINGS:
        return 1.0
    bounded = np.minimum(ratio, _TAILS * robust_sigma(ratio))
    return max(math.sqrt(0.5 * float(np.mean(bounded**2))), 1.0)
