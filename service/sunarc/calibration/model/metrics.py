"""How well a fit meets the sightings (Eq. 27), and both readings of SD."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from sunarc.array_types import BoolArray, FloatArray
from sunarc.optics.camera import Camera
from sunarc.optics.inverse import unproject
from sunarc.sky.directions import angular_distance


@dataclass(frozen=True, slots=True, kw_only=True)
class Metrics:
    """Eq. 27 over a set of sightings; NaN where there are none.

    Attributes
    ----------
    n : sightings used.
    rmse_px, mae_px : root of the mean square, and mean, of the 2-D distance of the sightings used.
    rmse_all_px : the same over all sightings supplied that have a time and a pixel.
    sd_px : Eq. 27c as written: about the mean distance vector.
    sd_of_distance_px : standard deviation of the scalar distance, which the paper's tables contain
        (RMSE² = MAE² + SD²).
    rmse_deg : root of the mean square angle between sighted and true direction.
    held_out_rmse_px : the same as rmse_px on days that were left out in turn; None with fewer than two days.
    held_out_expected_px : what the fits without those days expected it to be.
    """

    n: int
    rmse_px: float
    rmse_all_px: float
    mae_px: float
    sd_px: float
    sd_of_distance_px: float
    rmse_deg: float
    held_out_rmse_px: float | None = None
    held_out_expected_px: float | None = None


NO_METRICS = Metrics(
    n=0,
    rmse_px=math.nan,
    rmse_all_px=math.nan,
    mae_px=math.nan,
    sd_px=math.nan,
    sd_of_distance_px=math.nan,
    rmse_deg=math.nan,
)


def measures(residual: FloatArray) -> tuple[float, float, float, float]:
    """Return RMSE, MAE, SD as written in Eq. 27c, and SD of the distance, of residuals (n, 2) in px."""
    if residual.shape[0] == 0:
        return math.nan, math.nan, math.nan, math.nan
    distance = np.hypot(residual[:, 0], residual[:, 1])
    # Eq. 27c takes the scatter about the mean vector, so a common shift does not count
    about_mean = np.linalg.norm(residual - residual.mean(axis=0), axis=-1)
    return (
        float(np.sqrt(np.mean(distance**2))),
        float(np.mean(distance)),
        float(np.sqrt(np.mean(about_mean**2))),
        float(np.std(distance)),
    )


def fit_metrics(residual: FloatArray, used: BoolArray, angle: FloatArray) -> Metrics:
    """Return the metrics of a fit.

    Parameters
    ----------
    residual : (n, 2) observed minus modelled, px.
    used : (n,) whether a sighting counted.
    angle : (n,) radians between sighted and true direction, NaN where the camera sees nothing.
    """
    rmse, mae, sd, sd_of_distance = measures(residual[used])
    valid_angle = angle[used & np.isfinite(angle)]
    return Metrics(
        n=int(used.sum()),
        rmse_px=rmse,
        rmse_all_px=measures(residual)[0],
        mae_px=mae,
        sd_px=sd,
        sd_of_distance_px=sd_of_distance,
        rmse_deg=math.degrees(float(np.sqrt(np.mean(valid_angle**2)))) if valid_angle.size else math.nan,
    )


def residual_angles(camera: Camera, pixels: FloatArray, directions: FloatArray) -> FloatArray:
    """Return (n,): radians between where pixels look and where the sun was."""
    return angular_distance(unproject(camera, pixels), directions)
