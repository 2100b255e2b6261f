"""How a pose that wanders from day to day widens what is stated."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import pytest

from sunarc.calibration.acceptance import pose_spread_deg
from sunarc.calibration.answers.covariance import hemisphere, project_with_covariance
from sunarc.calibration.quality.widening import add_pose_spread
from sunarc.calibration.verdict import accept
from sunarc.optics.forward import project
from sunarc.optics.pose import rotation_matrix, rotation_vector

if TYPE_CHECKING:
    from sunarc.calibration.model.result import Calibration


def test_the_spread_is_what_the_days_errors_do_not_explain() -> None:
    rng = np.random.default_rng(1)
    sigmas = np.full((400, 3), 0.003)
    turns = rng.normal(0.0, [0.01, 0.0, 0.02], (400, 3)) + rng.normal(0.0, 0.003, (400, 3))
    east, north, up = pose_spread_deg(turns, sigmas)
    assert [east, up] == pytest.approx([0.01, 0.02], rel=0.2)
    assert north < 0.0015


def test_one_odd_day_is_no_spread() -> None:
    turns = np.zeros((20, 3))
    turns[7] = 1.0
    assert pose_spread_deg(turns, np.full((20, 3), 1e-6)) == (0.0, 0.0, 0.0)


def test_four_days_tell_no_spread() -> None:
    assert pose_spread_deg(np.eye(4, 3), np.zeros((4, 3))) == (0.0, 0.0, 0.0)
    assert pose_spread_deg((), ()) == (0.0, 0.0, 0.0)


def test_what_is_stated_grows_by_what_such_turns_move_the_sky(calibrated: Calibration) -> None:
    spread = (0.02, 0.005, 0.05)
    widened = add_pose_spread(calibrated, spread)
    sky, rng = hemisphere(60), np.random.default_rng(2)
    turn = rotation_matrix(calibrated.camera.rotation_cam_enu)
    moved = []
    for _ in range(1500):
        small = rotation_matrix(tuple(np.radians(rng.normal(0.0, spread))))
        camera = replace(calibrated.camera, rotation_cam_enu=rotation_vector(turn @ small))
        moved.append(project(camera, sky) - project(calibrated.camera, sky))
    expected = np.einsum("kni,knj->nij", moved, moved) / 1500
    grown = project_with_covariance(widened, sky)[1] - project_with_covariance(calibrated, sky)[1]
    known = np.all(np.isfinite(grown), axis=(1, 2))
    assert np.trace(grown[known], axis1=1, axis2=2) == pytest.approx(
        np.trace(expected[known], axis1=1, axis2=2), rel=0.15
    )
    assert widened.sky_rms_deg > calibrated.sky_rms_deg
    assert widened.evidence.pose_spread_deg == spread


def test_a_camera_that_wanders_more_is_no_reason_to_refuse_the_next_fit(calibrated: Calibration) -> None:
    assert accept(add_pose_spread(calibrated, (0.5, 0.5, 0.5)), calibrated).accepted
