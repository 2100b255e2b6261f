"""How fast the engine is beside others on the same work: `pytest tests/benchmarks --benchmark-enable`."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.optimize import least_squares

from sunarc.calibration.answers.direction_table import back_projection_map, lookup
from sunarc.calibration.calibrate import calibrate
from sunarc.calibration.fit.marginal_likelihood import PriorScales, prior_precision
from sunarc.calibration.fit.normal_equations import linear_system, most_probable_with_field
from sunarc.calibration.model.options import CalibrationOptions
from sunarc.calibration.model.sightings import Sightings, filter_sightings
from sunarc.calibration.solve.problem import FitProblem, time_bins
from sunarc.calibration.start.initial_guess import single_problem
from sunarc.optics.camera import Camera
from sunarc.optics.displacement import wave_basis
from sunarc.optics.forward import project
from sunarc.optics.inverse_table import inverse_table
from sunarc.sky.site import Site
from sunarc.sky.sun import sun_angles, sun_directions

FloatArray = NDArray[np.float64]

SGP = Site(latitude=36.604043, longitude=-97.484856, altitude=318.0)
SIZE = (1748, 1748)
TRUTH = Camera(
    width=1748,
    height=1748,
    projection="equisolid",
    focal_length_px=(601.32, 601.32),
    principal_point_px=(871.96, 883.0),
    rotation_cam_enu=(0.01, -0.02, 0.8),
    radial=(-0.013, 0.0, 0.0222, 0.0, -0.0086, 0.0, 0.0, 0.0),
    decentering=(1.5e-4, -1.9e-4, 0.0, 0.0),
)
NO_FIELD = PriorScales(1e-6, 420.0, 2.0, 0.7)


@pytest.fixture(scope="module")
def points() -> Sightings:
    noon = 1_368_403_200.0 + 43_200.0 - SGP.longitude * 240.0
    days = (0, 1, 9, 19, 20, 21, 25, 27, 28, 29)
    times = np.concatenate([noon + 86_400.0 * d + np.arange(-43_200.0, 43_200.0, 30.0) for d in days])
    times = times[sun_angles(times, SGP).apparent_zenith < 89.6][:15_966]
    pixels = project(TRUTH, sun_directions(times, SGP))
    return Sightings.of(unix_s=times, pixels=pixels + np.random.default_rng(0).normal(0.0, 0.5, pixels.shape))


class _Task:
    """One cost, one start: 15 966 sightings, Gaussian noise of 0.5 px, the lens's priors."""

    def __init__(self, points: Sightings) -> None:
        self.usable: Sightings = filter_sightings(points, site=SGP)
        self.seen: Sightings = replace(self.usable, information=np.full(len(self.usable), 4.0))
        start = replace(TRUTH, focal_length_px=(605.0, 605.0), principal_point_px=(876.0, 880.0), radial=(0.0,) * 8)
        start = replace(start, decentering=(1e-5, 1e-5, 0.0, 0.0), rotation_cam_enu=(0.02, -0.01, 0.81))
        self.problem: FitProblem = single_problem(self.seen, start, CalibrationOptions(), None)
        self.start = self.problem.unknowns([start])
        self.root = np.sqrt(prior_precision(self.problem.size, 2.0, 0.7))

    def binned(self) -> FloatArray:
        """Solve with sightings taken together, gathered twice."""
        basis = wave_basis(width=1748, height=1748, shortest_px=1748.0, longest_px=1748.0)
        bins, at = time_bins(self.usable), self.start
        for _ in range(2):
            system = linear_system(self.problem, self.seen, bins, at, information=self.seen.information, basis=basis)
            at = most_probable_with_field(self.problem, system, NO_FIELD).unknowns
        return at

    def misfit(self, at: FloatArray) -> FloatArray:
        """Return the same cost as a vector, by numpy's forward model."""
        camera = self.problem.camera(at)
        off = project(camera, self.seen.directions) - self.seen.pixels
        return np.concatenate([2.0 * off.ravel(), self.root * at])

    def scipy(self) -> FloatArray:
        """Solve by scipy, numeric derivatives."""
        return np.asarray(least_squares(self.misfit, self.start, method="lm", x_scale="jac").x)


@pytest.fixture(scope="module")
def task(points: Sightings) -> _Task:
    return _Task(points)


@pytest.mark.benchmark(group="solve of 15966 sightings")
def test_our_solve(task: _Task, benchmark: Any) -> None:  # noqa: ANN401 - the plug-in's own type
    found = benchmark(task.binned)
    assert 0.5 * float(np.sum(task.misfit(found) ** 2)) == pytest.approx(15_966.0, rel=0.05)


@pytest.mark.slow
@pytest.mark.benchmark(group="solve of 15966 sightings")
def test_scipy_solve(task: _Task, benchmark: Any) -> None:  # noqa: ANN401 - the plug-in's own type
    found = benchmark.pedantic(task.scipy, rounds=1, iterations=1)
    ours, theirs = task.misfit(task.binned()), task.misfit(found)
    assert 0.5 * float(np.sum(ours**2)) < 0.5 * float(np.sum(theirs**2)) * 1.001


@pytest.mark.benchmark(group="whole calibrate, 15966 sightings")
def test_whole_calibrate(points: Sightings, benchmark: Any) -> None:  # noqa: ANN401 - the plug-in's own type
    found = benchmark.pedantic(calibrate, (points,), {"site": SGP, "image_size": SIZE}, rounds=1, iterations=1)
    assert found.verdict.accepted


@pytest.fixture(scope="module")
def many_pixels() -> FloatArray:
    rng = np.random.default_rng(1)
    theta, phi = rng.uniform(0.0, np.radians(83.0), 1_000_000), rng.uniform(-np.pi, np.pi, 1_000_000)
    radius = 601.32 * 2.0 * np.sin(theta / 2.0)
    return np.stack([871.96 + radius * np.cos(phi), 883.0 + radius * np.sin(phi)], axis=-1)


@pytest.mark.benchmark(group="back-projection of 1e6 pixels")
def test_our_back_projection(many_pixels: FloatArray, benchmark: Any) -> None:  # noqa: ANN401 - the plug-in's own type
    table = inverse_table(TRUTH)
    directions = benchmark(table.directions, many_pixels)
    np.testing.assert_allclose(project(TRUTH, directions[::500]), many_pixels[::500], atol=1e-6)


@pytest.mark.benchmark(group="back-projection of 1e6 pixels")
def test_opencv_back_projection(many_pixels: FloatArray, benchmark: Any) -> None:  # noqa: ANN401 - the plug-in's own type
    matrix = np.array([[601.32, 0.0, 871.96], [0.0, 601.32, 883.0], [0.0, 0.0, 1.0]])
    found = benchmark(cv2.fisheye.undistortPoints, many_pixels[:, None], matrix, np.array([-0.04, 0.001, 0.0, 0.0]))
    assert found.shape == (1_000_000, 1, 2)


@pytest.mark.benchmark(group="whole map of 1748 x 1748 pixels")
def test_whole_map(points: Sightings, benchmark: Any) -> None:  # noqa: ANN401 - the plug-in's own type
    calibration = calibrate(points.select(slice(0, 1600)), site=SGP, image_size=SIZE)
    found = benchmark(lambda: back_projection_map(lookup(calibration)))
    assert found.directions.shape == (1748, 1748, 3)
