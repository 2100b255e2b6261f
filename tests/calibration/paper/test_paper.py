"""The paper's own procedure."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import pytest
from tests.calibration.paper.equations_reference import penalties

from sunarc.calibration.calibrate import calibrate
from sunarc.calibration.model.options import CalibrationOptions, ImageCircle, PaperOptions
from sunarc.calibration.model.result import Calibration, measures
from sunarc.calibration.model.sightings import Sightings
from sunarc.calibration.paper import direct_linear_pose
from sunarc.calibration.start.initial_guess import wahba
from sunarc.optics.forward import project
from sunarc.optics.pose import pose_angles

if TYPE_CHECKING:
    from tests.fixtures.clear_day import Simulated, Simulator

SIZE = (1748, 1748)
CIRCLE = ImageCircle(x=873.0, y=882.0, radius=850.0)


def test_table_2_case_3_comes_back_from_its_own_noise_free_arcs(simulator: Simulator) -> None:
    truth = replace(simulator().camera, radial=(0.0,) * 8, decentering=(0.0,) * 4)
    seen = simulator(truth, days=(0.0, 1.0, 20.0, 29.0), sigma_px=0.0)
    found = calibrate(
        seen.points, site=seen.site, image_size=SIZE, options=CalibrationOptions(method="paper"), circle=CIRCLE
    )
    assert found.camera.focal_length_px == pytest.approx((601.32, 601.32), abs=0.05)
    assert found.camera.principal_point_px == pytest.approx((871.96, 883.00), abs=0.05)
    assert found.pose == pytest.approx((47.91, 2.46, 140.16), abs=0.05)


def test_on_one_arc_the_paper_is_right_on_the_track_and_ours_over_the_sky(simulator: Simulator) -> None:
    seen = simulator(sigma_px=0.43, cadence_s=30.0)
    describe_change = CalibrationOptions(method="paper")
    paper = calibrate(seen.points, site=seen.site, image_size=SIZE, options=describe_change, circle=CIRCLE)
    ours = calibrate(seen.points, site=seen.site, image_size=SIZE, circle=CIRCLE)
    assert paper.method == "paper"
    assert seen.track_error_px(paper.camera) < 0.12
    assert seen.sky_error_px(ours.camera) < seen.sky_error_px(paper.camera)


def test_penalties_are_nothing_for_a_round_rising_lens(clear_day: Simulated) -> None:
    plain = replace(clear_day.camera, radial=(0.0,) * 8, decentering=(0.0,) * 4, skew_px=0.0)
    np.testing.assert_allclose(penalties(plain, PaperOptions(), largest_angle=math.pi / 2), 0.0, atol=1e-9)


def test_c1_c2_and_c3_feel_what_they_should(clear_day: Simulated) -> None:
    plain = replace(clear_day.camera, radial=(0.0,) * 8, decentering=(0.0,) * 4, skew_px=0.0)
    describe_change = PaperOptions()
    edge = math.pi / 2
    first = penalties(replace(plain, radial=(0.01, *([0.0] * 7))), describe_change, largest_angle=edge)
    expected = np.trapezoid(2.0 * np.sin(np.linspace(0, edge, 999) / 2) * np.linspace(0, 1, 999) ** 2, dx=edge / 998)
    assert first[0] == pytest.approx(describe_change.orthogonality_weight * 0.01 * expected, rel=1e-3)
    skewed = penalties(replace(plain, skew_px=1.0), describe_change, largest_angle=edge)
    # a skew of s stretches the circle by about s sin(2φ) r̂ / 2, whose standard deviation is s r̂ / √8
    spread = math.sqrt(2.0) / math.sqrt(8.0)
    assert np.linalg.norm(skewed[1:25]) == pytest.approx(describe_change.circularity_weight * spread, rel=0.01)
    falling = penalties(replace(plain, radial=(-2.0, *([0.0] * 7))), describe_change, largest_angle=edge)
    assert np.min(falling[25:]) < 0.0
    bent = replace(plain, decentering=(1e-3, 0.0, 0.0, 0.0))
    assert np.max(np.abs(penalties(bent, describe_change, largest_angle=edge))) < 1e-6
    included = replace(describe_change, ellipse_scope="with_decentering")
    assert np.max(np.abs(penalties(bent, included, largest_angle=edge))) > 100.0


def _all_over_the_sky(clear_day: Simulated) -> Sightings:
    rng = np.random.default_rng(0)
    directions = rng.standard_normal((200, 3))
    directions[:, 2] = np.abs(directions[:, 2]) + 0.2
    directions /= np.linalg.norm(directions, axis=-1, keepdims=True)
    return Sightings(
        directions=directions,
        pixels=project(clear_day.camera, directions),
        information=np.ones(200),
        epoch=np.zeros(200, dtype=np.int64),
    )


def test_linear_and_wahba_poses_agree_on_the_truth_where_the_sky_is_covered(clear_day: Simulated) -> None:
    seen = _all_over_the_sky(clear_day)
    unknown = replace(clear_day.camera, rotation_cam_enu=(0.0, 0.0, 0.0))
    for found in (direct_linear_pose(unknown, seen), wahba(unknown, seen)[0]):
        np.testing.assert_allclose(
            pose_angles(found.rotation_cam_enu), pose_angles(clear_day.camera.rotation_cam_enu), atol=1e-5
        )
    np.testing.assert_allclose(direct_linear_pose(unknown, seen).translation, 0.0, atol=1e-7)


def test_both_readings_of_sd() -> None:
    residual = np.random.default_rng(0).normal([0.3, -0.2], 0.5, (500, 2))
    rmse, mae, sd, sd_of_distance = measures(residual)
    assert rmse**2 == pytest.approx(mae**2 + sd_of_distance**2)
    assert sd**2 == pytest.approx(rmse**2 - float(np.sum(residual.mean(axis=0) ** 2)))


def test_a_calibration_by_the_paper_says_so(simulator: Simulator) -> None:
    seen = simulator(sigma_px=0.43)
    options = CalibrationOptions(method="paper", paper=PaperOptions(fit_translation=True))
    found: Calibration = calibrate(seen.points, site=seen.site, image_size=SIZE, options=options, circle=CIRCLE)
    assert len(found.parameter_names) == 23
    assert found.covariance.shape == (23, 23)
