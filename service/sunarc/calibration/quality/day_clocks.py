"""Clocks that differ from day to day by more than a fit allows for: the sun is early on some days, late on others."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from sunarc.calibration.model.result import Calibration, proves, residuals_by_pose
from sunarc.calibration.model.sightings import Kind, Sightings
from sunarc.calibration.quality.fit_checks import JudgedFit
from sunarc.common.array_types import FloatArray, IntArray
from sunarc.common.findings import Data
from sunarc.optics.forward import by_direction, project_with_rows_fast
from sunarc.sky.site import EARTH_RATE

_FEWEST_DAYS, _FEWEST_OF_DAY = 3, 3
_LEAST_S = 10.0
"""Scatter of the days' clocks up to which the camera is used: 10 s turn it by 0.04 degrees."""
_SPREADS_S = 3.0 * 2.0 ** np.arange(10.0)
"""1-sigma of the days' clocks that are tried, and, as turns of the earth in that time, of the days' other errors."""
_LEAST_SIGMA_PX, _LARGEST_CORRELATION = 0.01, 0.995


class _Days(NamedTuple):
    """Sums over each day's sightings, by the columns of an error that it may have.

    products (d, k, k), pulls (d, k): of the columns with each other, and with the residuals.
    """

    products: FloatArray
    pulls: FloatArray

    def solved(self, spread: float) -> FloatArray:
        """Return (d, k): the most probable errors of the days, each column's prior being normal of one spread."""
        size = self.pulls.shape[1]
        return np.asarray(np.linalg.solve(self.products + np.eye(size) / spread**2, self.pulls[..., None])[..., 0])

    def divide_by(self, variance: float) -> _Days:
        """Return the sums divided by the variance of the residuals."""
        return _Days(self.products / variance, self.pulls / variance)

    def best(self) -> tuple[float, float]:
        """Return the highest log evidence of such errors against none, and its spread."""
        size, tried = self.pulls.shape[1], []
        for spread in _SPREADS_S.tolist():
            gain = 0.5 * float(np.sum(self.pulls * self.solved(spread)))
            volume = float(np.sum(np.linalg.slogdet(np.eye(size) + self.products * spread**2)[1]))
            tried.append((gain - 0.5 * volume, spread))
        return max(tried)


def unsteady_clock(judged: JudgedFit) -> Data | None:
    """Return how the clock of the sun's sightings differs from day to day; None where they do not prove that it does.

    It is proven where one offset for each day explains the residuals far better than none, better than any turn of the
    camera on each day and than a bias along the radius on each.
    """
    calibration, usable = judged.calibration, judged.usable
    counted = (usable.kind == Kind.SUN) & ~usable.alone
    if calibration.left_out is not None:
        counted &= ~np.isin(usable.index, calibration.left_out)
    days, counts = np.unique(usable.day[counted], return_counts=True)
    seen = usable.select(counted & np.isin(usable.day, days[counts >= _FEWEST_OF_DAY]))
    days, day = np.unique(seen.day, return_inverse=True)
    if days.size < _FEWEST_DAYS:
        return None
    columns = _columns(calibration, seen)
    residual = residuals_by_pose(calibration.camera, calibration.poses, seen)
    fine = np.all(np.isfinite(residual), axis=-1)
    residual = np.where(fine[:, None], residual, 0.0)
    weight = np.where(fine, seen.information, 0.0)
    of_days = {name: _summed(found, residual, weight, day) for name, found in columns.items()}
    left = residual - np.einsum("nap,np->na", columns["turn"], of_days["turn"].solved(_SPREADS_S[-1])[day])
    free = max(2.0 * len(seen) - 3.0 * days.size, 1.0)
    one_day, power = day[1:] == day[:-1], float(np.sum(left**2))
    rho = float(np.sum((left[1:] * left[:-1])[one_day])) / power if power > 0.0 else 0.0
    rho = min(max(rho, 0.0), _LARGEST_CORRELATION)
    alike = (1.0 + rho) / (1.0 - rho)  # by how much more a mean varies as neighbours err alike
    variance = max(float(np.sum(weight[:, None] * left**2)) / free * alike, _LEAST_SIGMA_PX**2)
    scaled = {name: one.divide_by(variance) for name, one in of_days.items()}
    evidence = {name: one.best() for name, one in scaled.items()}
    log_odds, spread = evidence["clock"]
    rival = max(value for name, (value, _) in evidence.items() if name != "clock")
    offsets = scaled["clock"].solved(spread)[:, 0]
    scatter_s = float(np.std(offsets))
    if not proves("daily_clock", log_odds) or log_odds < rival:
        return None
    range_s = float(np.ptp(offsets))
    return {"scatter_s": scatter_s, "range_s": range_s, "days": offsets.size, "log_odds": log_odds}


def allowed_clock_s(judged: JudgedFit) -> float:
    """Return 10 s; the stated bound of the clock, if larger."""
    evidence = judged.calibration.evidence
    return max(_LEAST_S, evidence.clock_error_s if evidence.clock_stated else 0.0)


def _columns(calibration: Calibration, seen: Sightings) -> dict[str, FloatArray]:
    """Return displacements (n, 2, k) by name: per second of the clock, per turn and shift of the sky's turn in 1 s."""
    by_sky, outwards = np.zeros((len(seen), 2, 3)), np.zeros((len(seen), 2, 1))
    epoch = np.minimum(seen.epoch, len(calibration.poses) - 1)
    for number, pose in enumerate(calibration.poses):
        of_pose = epoch == number
        camera = replace(calibration.camera, rotation_cam_enu=pose)
        pixels, rows = project_with_rows_fast(camera, seen.directions[of_pose])
        by_sky[of_pose] = by_direction(camera, rows)
        away = np.nan_to_num(pixels - np.array(camera.principal_point_px))
        far = np.linalg.norm(away, axis=-1, keepdims=True)
        outwards[of_pose] = (away / np.maximum(far, 1e-9))[..., None]
    scale = EARTH_RATE * float(np.median(np.linalg.norm(by_sky, axis=(1, 2)))) / math.sqrt(2.0)
    return {
        "clock": np.einsum("nai,ni->na", by_sky, seen.motion)[..., None],
        "turn": np.cross(by_sky, seen.directions[:, None, :]) * EARTH_RATE,
        "outwards": outwards * scale,
    }


def _summed(columns: FloatArray, residual: FloatArray, weight: FloatArray, day: IntArray) -> _Days:
    """Return the sums over each day of columns (n, 2, k) and residuals (n, 2) with weights (n,)."""
    weighed = columns * weight[:, None, None]
    count = int(day.max()) + 1
    products, pulls = np.zeros((count, *columns.shape[2:] * 2)), np.zeros((count, *columns.shape[2:]))
    np.add.at(products, day, np.einsum("nap,naq->npq", weighed, columns))
    np.add.at(pulls, day, np.einsum("nap,na->np", weighed, residual))
    return _Days(products, pulls)
