"""Clocks that differ from day to day by more than a fit allows for."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from sunarc.calibration.evidence import linear_evidence, products_by_part
from sunarc.calibration.model.result import Calibration, proves, residuals_by_pose
from sunarc.calibration.model.sightings import Kind, Sightings
from sunarc.calibration.quality.fit_checks import JudgedFit
from sunarc.common.array_types import FloatArray
from sunarc.common.findings import Data
from sunarc.optics.forward import by_direction, project_with_rows_fast
from sunarc.sky.site import EARTH_RATE

_FEWEST_DAYS, _FEWEST_OF_DAY = 3, 3
_LEAST_S = 10.0
"""Scatter of the days' clocks up to which the camera is used: 10 s turn it by 0.04 degrees."""
_SPREADS_S = 3.0 * 2.0 ** np.arange(10.0)
"""1-sigma of the days' clocks that are tried, and, as turns of the earth in that time, of the days' other errors."""
_LEAST_SIGMA_PX, _LARGEST_CORRELATION = 0.01, 0.995


class _Errors(NamedTuple):
    """Errors of the days of one kind.

    log_odds: of them against none. of_days (d, k): the most probable ones.
    """

    log_odds: float
    of_days: FloatArray


def _errors(products: FloatArray, spread: float) -> _Errors:
    """Return the errors of days, normal with one spread, by the products (d, k, k) with the residuals at last."""
    information = np.eye(products.shape[-1] - 1) + products[:, :-1, :-1] * spread**2
    evidence, of_days = linear_evidence(information, products[:, :-1, -1] * spread)
    return _Errors(float(np.sum(evidence)), of_days * spread)


def _most_probable(products: FloatArray) -> _Errors:
    """Return the errors of days with the spread of the highest evidence."""
    return max((_errors(products, spread) for spread in _SPREADS_S.tolist()), key=lambda one: one.log_odds)


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
    columns = _displacement_columns(calibration, seen)
    residual = residuals_by_pose(calibration.camera, calibration.poses, seen)
    fine = np.all(np.isfinite(residual), axis=-1)
    residual = np.where(fine[:, None], residual, 0.0)
    weight = np.where(fine, seen.information, 0.0)
    root = np.sqrt(weight)[:, None, None]
    of_days = {
        name: products_by_part(np.concatenate([found, residual[..., None]], axis=-1) * root, day)
        for name, found in columns.items()
    }
    turns = _errors(of_days["turn"], float(_SPREADS_S[-1])).of_days
    left = residual - np.einsum("nap,np->na", columns["turn"], turns[day])
    free = max(2.0 * len(seen) - 3.0 * days.size, 1.0)
    one_day, power = day[1:] == day[:-1], float(np.sum(left**2))
    rho = float(np.sum((left[1:] * left[:-1])[one_day])) / power if power > 0.0 else 0.0
    rho = min(max(rho, 0.0), _LARGEST_CORRELATION)
    alike = (1.0 + rho) / (1.0 - rho)  # by how much more a mean varies as neighbours err alike
    variance = max(float(np.sum(weight[:, None] * left**2)) / free * alike, _LEAST_SIGMA_PX**2)
    found = {name: _most_probable(one / variance) for name, one in of_days.items()}
    log_odds, offsets = found["clock"]
    if not proves("daily_clock", log_odds) or log_odds < max(one.log_odds for one in found.values()):
        return None
    return {
        "scatter_s": float(np.std(offsets)),
        "range_s": float(np.ptp(offsets)),
        "days": len(offsets),
        "log_odds": log_odds,
    }


def allowed_clock_s(judged: JudgedFit) -> float:
    """Return 10 s; the stated bound of the clock, if larger."""
    evidence = judged.calibration.evidence
    return max(_LEAST_S, evidence.clock_error_s if evidence.clock_stated else 0.0)


def _displacement_columns(calibration: Calibration, seen: Sightings) -> dict[str, FloatArray]:
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
