"""Effect of an error of the view direction on a cloud's height, its shadow and a forecast of the irradiance.

Two cameras of one kind, `baseline` apart, see a point of a cloud base. Its height follows from the closest approach of
both view directions, its shadow from the first camera's direction, the height and the sun. The shadow's edge passes a
place when the wind brings it there: an error of its position along the wind is an error of that time, and a ramp of the
irradiance is forecast too early or too late. Flat ground, straight rays; the errors of the two cameras are independent,
and within a camera common to all directions.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from sunarc.calibration.answers.error_model import draw_ensemble
from sunarc.calibration.model.result import Calibration
from sunarc.common.array_types import FloatArray
from sunarc.optics.forward import project
from sunarc.sky.directions import direction_from_angles

SIGMAS_DEG = (0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1.0)
"""1-sigma per axis of the pose, degrees."""
HEIGHTS_M = (500.0, 1000.0, 2000.0, 4000.0)
BASELINES_M = (250.0, 500.0, 1000.0, 2000.0, 4000.0)
SUN_ZENITH_DEG, SUN_AZIMUTH_DEG = 40.0, 180.0
WIND_M_S = 10.0
"""Towards the east, along the baseline."""
RAMP_W_M2 = 600.0
"""Irradiance that a cloud's shadow takes away."""
WINDOW_S = 600.0
"""Time over which a forecast is compared with the truth, the ramp at its middle."""
_ZENITHS_DEG = (0.0, 15.0, 30.0, 45.0, 60.0)
_AZIMUTHS_DEG = tuple(range(0, 360, 30))
_PARALLEL = 1e-12
"""Square of the sine below which two rays have no closest approach that means anything."""
_PER_SIGMA = 0.6827
"""Share of a Gaussian within 1 sigma: the quantile is not moved by the few pairs whose rays are nearly parallel."""
_PER_SIGMA_2D = 1.0 - math.exp(-0.5)
"""Share of a round Gaussian in the plane within 1 sigma per axis."""

DirectionErrors = Callable[[FloatArray, int], FloatArray]
"""Returns (draws, n, 3): directions (n, 3) as a camera with errors sees them; the number names the camera."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ShadowRow:
    """Errors for one size of the direction's error, one height and one baseline; 1-sigma over the sky to 60 degrees.

    Attributes
    ----------
    sigma_deg : 1-sigma per axis of the direction, degrees.
    height_m, baseline_m : of the cloud base and between the cameras, m.
    height_sigma_m : of the height by the pair, m.
    height_overhead_m : the same by the closed form, for a cloud above the middle of the baseline, m.
    shadow_sigma_m : per axis of the shadow where the height is known, m.
    shadow_pair_sigma_m : per axis of the shadow with the pair's height, m.
    ramp_error_w_m2 : mean absolute error of the irradiance over `WINDOW_S`, W/m², with the pair's height.
    """

    sigma_deg: float
    height_m: float
    baseline_m: float
    height_sigma_m: float
    height_overhead_m: float
    shadow_sigma_m: float
    shadow_pair_sigma_m: float
    ramp_error_w_m2: float


def study_shadow(
    *,
    draws: int,
    seed: int,
    sigmas_deg: Sequence[float] = SIGMAS_DEG,
    after_each: Callable[[], None] = lambda: None,
) -> list[ShadowRow]:
    """Return the errors for every size of the pose's error, height and baseline.

    Parameters
    ----------
    draws : pairs of cameras that are drawn for each size.
    seed : of everything that is drawn.
    sigmas_deg : 1-sigma per axis of the pose, degrees.
    after_each : is called after each size.
    """
    rows = []
    for sigma in sigmas_deg:
        rows += _compute_shadow_rows(turned_errors(sigma, draws=draws, seed=seed), sigma)
        after_each()
    return rows


def study_calibrated_shadow(calibration: Calibration, *, draws: int, seed: int) -> list[ShadowRow]:
    """Return the errors of two cameras with the errors that a calibration states, drawn jointly over the sky."""
    ensembles = [draw_ensemble(calibration, draws=draws, seed=seed + k, calibration_id="shadow") for k in (0, 1)]

    def seen(directions: FloatArray, camera: int) -> FloatArray:
        pixels = project(calibration.camera, directions)
        return np.stack([ensembles[camera].back_project(draw, pixels) for draw in ensembles[camera]])

    return _compute_shadow_rows(seen, calibration.sky_rms_deg)


def pair_height(first: FloatArray, second: FloatArray, *, baseline_m: float) -> FloatArray:
    """Return (...): heights of the closest approach of two rays, m, the mean of both; NaN where they are parallel.

    Parameters
    ----------
    first, second : (..., 3) unit vectors, east-north-up, of cameras at (0, 0, 0) and (`baseline_m`, 0, 0).
    """
    cosine = np.sum(first * second, axis=-1)
    along_first, along_second = baseline_m * first[..., 0], baseline_m * second[..., 0]
    square = 1.0 - cosine**2
    square = np.where(square > _PARALLEL, square, np.nan)
    to_first = (along_first - cosine * along_second) / square
    to_second = (cosine * along_first - along_second) / square
    return np.asarray(0.5 * (to_first * first[..., 2] + to_second * second[..., 2]))


def shadow_place(direction: FloatArray, height_m: FloatArray, sun: FloatArray) -> FloatArray:
    """Return (..., 2): metres east and north of the camera of the shadow of a cloud at a height.

    Parameters
    ----------
    direction : (..., 3) unit vectors, east-north-up.
    height_m : (...) above the ground, m.
    sun : (3,) unit vector to the sun.
    """
    slope = direction[..., :2] / direction[..., 2:] - sun[:2] / sun[2]
    return np.asarray(height_m[..., None] * slope)


def ramp_error(displacement_m: FloatArray) -> FloatArray:
    """Return (...): mean absolute error of the irradiance in W/m² over `WINDOW_S`, of shadows displaced by (..., 2) m.

    A step of `RAMP_W_M2` that comes by δt too early or too late is wrong for |δt|, at most for half the window.
    """
    delay_s = np.abs(displacement_m[..., 0]) / WIND_M_S
    return np.asarray(RAMP_W_M2 * np.minimum(delay_s, 0.5 * WINDOW_S) / WINDOW_S)


def overhead_height_sigma_m(*, sigma_deg: float, height_m: float, baseline_m: float) -> float:
    """Return the 1-sigma of the pair's height for a cloud above the middle of the baseline, to first order, m.

    With h = b / (tan α - tan β) and tan α = -tan β = b / 2h it is h² / b · √2 · (1 + b² / 4h²) · σ.
    """
    square = 1.0 + (baseline_m / (2.0 * height_m)) ** 2
    return math.sqrt(2.0) * height_m**2 / baseline_m * square * math.radians(sigma_deg)


def turned_errors(sigma_deg: float, *, draws: int, seed: int) -> DirectionErrors:
    """Return the errors of cameras whose pose is off by small turns about any axis."""
    rng = np.random.default_rng(seed)
    turns = [Rotation.from_rotvec(math.radians(sigma_deg) * rng.standard_normal((draws, 3))) for _ in range(2)]

    def seen(directions: FloatArray, camera: int) -> FloatArray:
        return np.asarray(np.einsum("kij,nj->kni", turns[camera].as_matrix(), directions))

    return seen


def _compute_shadow_rows(seen: DirectionErrors, sigma_deg: float) -> list[ShadowRow]:
    sun = direction_from_angles(zenith_deg=SUN_ZENITH_DEG, azimuth_deg=SUN_AZIMUTH_DEG)
    zenith, azimuth = np.meshgrid(_ZENITHS_DEG, _AZIMUTHS_DEG)
    first = direction_from_angles(zenith_deg=zenith.ravel(), azimuth_deg=azimuth.ravel())
    first_seen = seen(first, 0)

    def row(height_m: float, baseline_m: float) -> ShadowRow:
        place = first * (height_m / first[:, 2:])
        second = place - np.array([baseline_m, 0.0, 0.0])
        second_seen = seen(second / np.linalg.norm(second, axis=-1, keepdims=True), 1)
        height = pair_height(first_seen, second_seen, baseline_m=baseline_m)
        true = shadow_place(first, np.full(len(first), height_m), sun)
        known = shadow_place(first_seen, np.full(height.shape, height_m), sun) - true
        by_pair = shadow_place(first_seen, height, sun) - true
        return ShadowRow(
            sigma_deg=sigma_deg,
            height_m=height_m,
            baseline_m=baseline_m,
            height_sigma_m=float(np.nanquantile(np.abs(height - height_m), _PER_SIGMA)),
            height_overhead_m=overhead_height_sigma_m(sigma_deg=sigma_deg, height_m=height_m, baseline_m=baseline_m),
            shadow_sigma_m=float(np.nanquantile(np.linalg.norm(known, axis=-1), _PER_SIGMA_2D)),
            shadow_pair_sigma_m=float(np.nanquantile(np.linalg.norm(by_pair, axis=-1), _PER_SIGMA_2D)),
            ramp_error_w_m2=float(np.nanmean(ramp_error(by_pair))),
        )

    return [row(height, baseline) for height in HEIGHTS_M for baseline in BASELINES_M]
