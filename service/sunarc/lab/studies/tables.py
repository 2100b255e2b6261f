"""The paper's Tables 1 to 3 made again in simulation: its five cases, with a truth to compare with."""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Callable, Sequence
from itertools import accumulate

import numpy as np

from sunarc.calibration.answers.covariance import hemisphere
from sunarc.calibration.calibrate import calibrate
from sunarc.calibration.model.options import CalibrationOptions, Method
from sunarc.calibration.model.result import Calibration, measures
from sunarc.calibration.model.sightings import Sightings
from sunarc.calibration.quality.day_quality import measure_day
from sunarc.common.array_types import BoolArray, FloatArray
from sunarc.lab.simulation.truth import SGP, true_camera
from sunarc.lab.studies.published import CASES, Case
from sunarc.lab.studies.trials import arcs, found_circle, true_error
from sunarc.optics.camera import Camera
from sunarc.optics.forward import project
from sunarc.optics.pose import pose_angles
from sunarc.sky.days import solar_date

TableRow = dict[str, str | int | float]

COLUMNS = (
    "case", "source", "n", "rmse_px", "mae_px", "sd_px", "sd_of_distance_px", "rmsd_m_px", "sd_m_px",
    "focal_length_x_px", "focal_length_y_px", "skew_px", "principal_point_x_px", "principal_point_y_px",
    "phi_xz_deg", "theta_zz_deg", "psi_z_deg", "true_arc_rmse_px", "true_sky_rmse_px",
)  # fmt: skip
"""Of a row. `sd_px` is Eq. 27c as written, `sd_of_distance_px` the number in the paper's tables; what a source does not
tell is left out."""

_INLIER_PX = 0.43


def study_tables(
    *, methods: Sequence[Method], seed: int = 1, after_each: Callable[[], None] = lambda: None
) -> list[TableRow]:
    """Return for each case the printed values of the paper, the truth of the simulation, and the fits of each method.

    Parameters
    ----------
    methods : of the fits.
    seed : of everything that is drawn.
    after_each : called after every fit.
    """
    rows = []
    for case in CASES:
        rows += [published_row(case), truth_row(case)]
        for method in methods:
            rows.append(fitted_row(case, method=method, seed=seed))
            after_each()
    return rows


def simulated_case(case: Case, rng: np.random.Generator) -> tuple[Sightings, Sightings]:
    """Return the arcs of a case and the sightings of them: as many as the paper had, with as much noise (SD_m)."""
    complete = arcs(true_camera(0), case.days)
    arc = complete.select(np.sort(rng.choice(len(complete), case.n_points, replace=False)))
    if case.cloud_share > 0.0:
        noise = cloud_noise(rng, len(arc), inlier_px=_INLIER_PX, share=case.cloud_share, sd_px=case.sd_m_px)
    else:
        noise = clear_noise(rng, len(arc), sd_px=case.sd_m_px)
    return arc, Sightings.of(unix_s=arc.unix_s, pixels=arc.pixels + noise)


def fitted_row(case: Case, *, method: Method, seed: int) -> TableRow:
    """Return the fit of a case by a method."""
    rng, truth = np.random.default_rng([seed, case.number]), true_camera(0)
    arc, points = simulated_case(case, rng)
    fit = calibrate(
        points,
        site=SGP,
        image_size=(truth.width, truth.height),
        options=CalibrationOptions(method=method),
        circle=found_circle(rng, truth),
    )
    return {
        "case": case.number,
        "source": method,
        "n": len(points),
        **_misfit_columns(fit, arc, points),
        **_arc_scatter_columns(points),
        **_parameter_columns(fit.camera),
        "true_arc_rmse_px": true_error(fit.camera, truth, arc.directions),
        "true_sky_rmse_px": true_error(fit.camera, truth, hemisphere()),
    }


def truth_row(case: Case) -> TableRow:
    """Return the simulation's truth."""
    return {"case": case.number, "source": "truth", "n": case.n_points, **_parameter_columns(true_camera(0))}


def published_row(case: Case) -> TableRow:
    """Return the printed values of the paper."""
    return {
        "case": case.number,
        "source": "published",
        "n": case.n_points,
        "rmse_px": case.rmse_px,
        "mae_px": case.mae_px,
        "sd_of_distance_px": case.sd_px,
        "rmsd_m_px": case.rmsd_m_px,
        "sd_m_px": case.sd_m_px,
        **_make_row(case.focal_length_px, case.skew_px, case.principal_point_px, case.pose_deg),
    }


def _misfit_columns(fit: Calibration, arc: Sightings, points: Sightings) -> TableRow:
    """Return the columns of Eq. 27 over all sightings, as the paper has it."""
    rmse, mae, sd, sd_of_distance = measures(project(fit.camera, arc.directions) - points.pixels)
    return {"rmse_px": rmse, "mae_px": mae, "sd_px": sd, "sd_of_distance_px": sd_of_distance}


def _arc_scatter_columns(points: Sightings) -> TableRow:
    """Return RMSD_m and SD_m about the days' smooth arcs (Eq. 20), over all days."""
    days: defaultdict[object, list[int]] = defaultdict(list)
    for row, time in enumerate(points.unix_s):
        days[solar_date(float(time), longitude=SGP.longitude)].append(row)
    measured = [measure_day(points.select(np.array(rows)), site=SGP) for rows in days.values()]
    count = np.array([day.n for day in measured], dtype=np.float64)
    square = np.array([day.rmsd_px**2 for day in measured])
    mean = np.sqrt(square - np.array([day.sd_px**2 for day in measured]))
    rmsd = float(np.sqrt(np.average(square, weights=count)))
    return {"rmsd_m_px": rmsd, "sd_m_px": float(np.sqrt(rmsd**2 - np.average(mean, weights=count) ** 2))}


def _parameter_columns(camera: Camera) -> TableRow:
    pose = pose_angles(camera.rotation_cam_enu)
    return _make_row(camera.focal_length_px, camera.skew_px, camera.principal_point_px, pose)


def _make_row(
    focal_length: tuple[float, float],
    skew: float,
    principal_point: tuple[float, float],
    pose: tuple[float, float, float],
) -> TableRow:
    return dict(zip(COLUMNS[9:17], (*focal_length, skew, *principal_point, *pose), strict=True))


# Errors of sightings as the paper's Table 1 measures them: clear days, and days with clouds.

SD_OF_DISTANCE = math.sqrt(2.0 - math.pi / 2.0)
"""Standard deviation of the 2-D distance of round Gaussian errors of 1 px per axis (Rayleigh's): the paper's SD."""

_CLOUD_FRAMES = 12
_CORRELATION = 0.7
_HEAVY_TAIL = 3
_LONGEST_PX = 50.0


def clear_noise(rng: np.random.Generator, n: int, *, sd_px: float) -> FloatArray:
    """Draw independent Gaussian errors, (n, 2), whose distances have the standard deviation `sd_px`."""
    return rng.normal(0.0, sd_px / SD_OF_DISTANCE, (n, 2))


def cloud_noise(rng: np.random.Generator, n: int, *, inlier_px: float, share: float, sd_px: float) -> FloatArray:
    """Draw errors with episodes of cloud, (n, 2).

    Parameters
    ----------
    inlier_px : 1-sigma per axis between the clouds.
    share : share of the sightings in episodes, whose errors are correlated, heavy-tailed (Student's t3) and at most
        50 px long in each axis.
    sd_px : standard deviation of all distances that the episodes' size is chosen for.
    """
    inlier = rng.normal(0.0, inlier_px, (n, 2))
    covered = episodes(rng, n, share)
    shock = rng.standard_t(_HEAVY_TAIL, (n, 2)) * math.sqrt(1.0 - _CORRELATION**2)
    episode = np.array(list(accumulate(shock, lambda before, step: _CORRELATION * before + step)))

    def draw_errors(size: float) -> FloatArray:
        return np.where(covered[:, None], np.clip(size * episode, -_LONGEST_PX, _LONGEST_PX), inlier)

    def excess_deviation(size: float) -> float:
        return float(np.std(np.linalg.norm(draw_errors(size), axis=-1))) - sd_px

    from scipy.optimize import brentq  # noqa: PLC0415 - the service starts sooner without it

    return draw_errors(float(brentq(excess_deviation, 1e-3, 1e3)))


def episodes(rng: np.random.Generator, n: int, share: float) -> BoolArray:
    """Return which sightings (n,) lie in episodes of wrong detections, a share of all."""
    covered = np.zeros(n, dtype=bool)
    while covered.mean() < share:
        begin, length = rng.integers(n), rng.geometric(1.0 / _CLOUD_FRAMES)
        covered[begin : begin + length] = True
    return covered
