"""Residuals of sightings under a calibration, in px and in degrees."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from sunarc.calibration.model.result import Calibration
from sunarc.calibration.model.sightings import Sightings, apparent_directions
from sunarc.common.array_types import BoolArray, FloatArray
from sunarc.optics.forward import project
from sunarc.optics.inverse import unproject
from sunarc.sky.directions import angles_from_direction, angular_distance


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Residuals:
    """Residuals of sightings that are finite and in view of the camera.

    Attributes
    ----------
    sightings : n of them, with their apparent directions.
    offset_px : (n, 2) seen minus predicted, px.
    offset_deg : (n,) angle between where the pixel looks and where the sun was, degrees.
    used : (n,) whether the fit used the sighting.
    """

    sightings: Sightings
    offset_px: FloatArray
    offset_deg: FloatArray
    used: BoolArray


def compute_residuals(calibration: Calibration, points: Sightings) -> Residuals:
    """Return the residuals of sightings, each against the pose of its epoch."""
    directions = apparent_directions(points, site=calibration.site)
    predicted, detected = np.full((len(points), 2), np.nan), np.full((len(points), 3), np.nan)
    for epoch, pose in enumerate(calibration.poses):
        camera, in_epoch = replace(calibration.camera, rotation_cam_enu=pose), points.epoch == epoch
        predicted[in_epoch] = project(camera, directions[in_epoch])
        detected[in_epoch] = unproject(camera, points.pixels[in_epoch])
    offset = points.pixels - predicted
    valid = (
        np.all(np.isfinite(offset), axis=-1)
        & np.isfinite(points.unix_s)
        & (angles_from_direction(directions)[0] < 91.0)
    )
    return Residuals(
        sightings=replace(points, directions=directions).select(valid),
        offset_px=offset[valid],
        offset_deg=np.degrees(angular_distance(detected[valid], directions[valid])),
        used=used_sightings(calibration, points, offset)[valid],
    )


def used_sightings(calibration: Calibration, points: Sightings, offset: FloatArray) -> BoolArray:
    """Return which sightings the fit used; of one made from other sightings, the nearest that are as many."""
    if calibration.left_out is not None and calibration.evidence.n_supplied == len(points):
        return ~np.isin(np.arange(len(points)), calibration.left_out)
    has_sigma = np.isfinite(points.sigma_px) & (points.sigma_px > 0.0)
    typical = float(np.median(points.sigma_px[has_sigma])) if np.any(has_sigma) else 1.0
    distance = np.linalg.norm(offset, axis=-1) / np.where(has_sigma, points.sigma_px, typical)
    used = np.zeros(distance.size, dtype=bool)
    used[np.argsort(distance, kind="stable")[: calibration.evidence.n_used]] = True
    return np.asarray(used & np.isfinite(distance))
