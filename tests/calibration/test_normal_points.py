"""Dense records: a fit of their normal points answers as one of all sightings does, in little memory."""

from __future__ import annotations

import math
import tracemalloc
from dataclasses import replace
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from tests.fixtures.finding_codes import codes

from sunarc.calibration import normal_points
from sunarc.calibration.answers.covariance import hemisphere, project_with_covariance
from sunarc.calibration.model.options import CalibrationOptions
from sunarc.calibration.model.result import Calibration
from sunarc.calibration.model.sightings import Sightings
from sunarc.common.array_types import stacked
from sunarc.optics.forward import project
from sunarc.optics.pose import rotation_matrix, rotation_vector
from sunarc.public.stated_fit import fit_as_stated
from sunarc.sky.sun import sun_directions

if TYPE_CHECKING:
    from tests.fixtures.clear_day import Simulated, Simulator

    from sunarc.changes.record import Moved

SIZE = (1748, 1748)
EQUISOLID = CalibrationOptions(projection="equisolid", mirrored="no", outwards_px=0.01)
DAYS = (0.0, 1.0, 2.0, 7.0, 8.0, 30.0)


@pytest.fixture(scope="module")
def seen(simulator: Simulator) -> Simulated:
    """Six days at a cadence of 40 s, 7,000 sightings, one in fifty of them false."""
    drawn = simulator(days=DAYS, sigma_px=0.2, cadence_s=40.0)
    rng = np.random.default_rng(8)
    false = rng.random(len(drawn.points)) < 0.02
    pixels = drawn.points.pixels + rng.normal(0.0, 8.0, (false.size, 2)) * false[:, None]
    return replace(drawn, points=replace(drawn.points, pixels=pixels))


def fitted(points: Sightings, seen: Simulated, most: int, monkeypatch: pytest.MonkeyPatch) -> Moved:
    """Fit sightings, more than `most` by their normal points."""
    monkeypatch.setattr(normal_points, "MOST", most)
    return fit_as_stated(points, site=seen.site, image_size=SIZE, options=EQUISOLID)


def sky_px(fit: Calibration) -> tuple[Any, float]:
    """Return the pixels of the sky, and the stated root mean square error, px."""
    pixels, covariance = project_with_covariance(fit, hemisphere(400))
    return pixels, math.sqrt(float(np.nanmean(np.trace(covariance, axis1=1, axis2=2))))


def test_normal_points_lead_to_the_camera_and_the_errors_of_all_sightings(
    seen: Simulated, monkeypatch: pytest.MonkeyPatch
) -> None:
    dense, points = fitted(seen.points, seen, 3000, monkeypatch)
    every, _ = fitted(seen.points, seen, 100_000, monkeypatch)
    assert "sightings_in_slots" in codes(dense.verdict.findings)
    assert "sightings_in_slots" not in codes(every.verdict.findings)
    (near, stated), (far, expected) = sky_px(dense), sky_px(every)
    assert math.sqrt(float(np.nanmean(np.sum((near - far) ** 2, axis=-1)))) < 0.2 * expected
    assert stated == pytest.approx(expected, rel=0.1)
    assert seen.sky_error_px(dense.camera) < 1.7 * stated  # 95 %
    assert dense.metrics.rmse_px == pytest.approx(every.metrics.rmse_px, rel=0.03)
    assert dense.metrics.mae_px == pytest.approx(every.metrics.mae_px, rel=0.03)
    assert dense.evidence.sigma_px == pytest.approx(every.evidence.sigma_px, rel=0.05)
    assert dense.evidence.n_used == pytest.approx(every.evidence.n_used, rel=0.01)
    assert dense.evidence.n_supplied == len(points) == len(seen.points)
    assert dense.left_out is not None
    assert dense.left_out.size == dense.evidence.n_rejected
    far_off = seen.points.pixels - project(seen.camera, sun_directions(seen.points.unix_s, seen.site))
    assert np.median(np.linalg.norm(far_off, axis=-1)[dense.left_out]) > 1.0


def test_few_sightings_are_fitted_as_they_are(seen: Simulated, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(normal_points, "MOST", len(seen.points))
    assert normal_points.dense_record(seen.points, site=seen.site, image_size=SIZE, options=EQUISOLID) is None


def test_a_move_of_a_dense_record_is_found_and_parts_all_sightings(
    seen: Simulated, simulator: Simulator, monkeypatch: pytest.MonkeyPatch
) -> None:
    turn = rotation_vector(
        rotation_matrix((0.0, 0.0, math.radians(0.3))) @ rotation_matrix(seen.camera.rotation_cam_enu)
    )
    after = simulator(replace(seen.camera, rotation_cam_enu=turn), days=(31.0, 32.0), sigma_px=0.2, cadence_s=40.0)
    both = stacked([seen.points, after.points])
    solved, points = fitted(both, seen, 3000, monkeypatch)
    assert [move.cause for move in solved.evidence.moves] == ["moved"]
    assert solved.evidence.moves[0].turn_deg == pytest.approx(0.3, rel=0.05)
    assert points.epoch.tolist() == [0] * len(seen.points) + [1] * len(after.points)


def test_what_is_left_out_before_is_counted_in_sightings(seen: Simulated, monkeypatch: pytest.MonkeyPatch) -> None:
    text = np.tile([100.2, 1700.3], (300, 1))  # an overlay that stands still
    still = Sightings.of(unix_s=seen.points.unix_s[::20][:300] + 7.0, pixels=text, clock_error_s=0.01)
    night = Sightings.of(unix_s=seen.points.unix_s[:40] - 10_800.0, pixels=seen.points.pixels[:40], clock_error_s=0.01)
    points = stacked([seen.points, still, night])
    dense, _ = fitted(points, seen, 3000, monkeypatch)
    every, _ = fitted(points, seen, 100_000, monkeypatch)
    said = [{one.code: one.data for one in fit.verdict.findings} for fit in (dense, every)]
    for code in ("dropped_static", "dropped_below_horizon", "static_positions"):
        assert said[0][code] == said[1][code], code


def test_pixels_on_a_grid_stay_on_it(seen: Simulated, monkeypatch: pytest.MonkeyPatch) -> None:
    cut = replace(seen.points, pixels=np.floor(seen.points.pixels))
    dense, _ = fitted(cut, seen, 3000, monkeypatch)
    assert {one.code: one.data for one in dense.verdict.findings}["pixels_on_grid"]["step_px"] == pytest.approx(1.0)
    assert seen.sky_error_px(dense.camera) < 1.7 * sky_px(dense)[1]


def test_stated_directions_are_taken_together_by_part_of_the_sky(
    seen: Simulated, monkeypatch: pytest.MonkeyPatch
) -> None:
    stated = replace(seen.points, directions=sun_directions(seen.points.unix_s, seen.site))
    dense, _ = fitted(stated, seen, 3000, monkeypatch)
    assert dense.verdict.accepted
    said = {one.code: one.data for one in dense.verdict.findings}["sightings_in_slots"]
    assert float(said["n_points"]) <= 3000.0
    assert seen.sky_error_px(dense.camera) < 1.7 * sky_px(dense)[1]  # 95 %


def test_sightings_that_no_camera_meets_are_thinned_not_averaged(
    seen: Simulated, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(normal_points, "MOST", 3000)
    pixels = np.random.default_rng(3).uniform(100.0, 1600.0, seen.points.pixels.shape)
    points = replace(seen.points, pixels=pixels)
    record = normal_points.dense_record(points, site=seen.site, image_size=SIZE, options=EQUISOLID)
    assert record is not None
    assert {tuple(one) for one in record.normal.pixels.tolist()} <= {tuple(one) for one in pixels.tolist()}


def test_memory_is_linear_in_the_sightings_and_the_points_are_bounded(
    simulator: Simulator, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(normal_points, "MOST", 2000)
    peaks = []
    for days in (DAYS[:3], DAYS):
        drawn = simulator(days=days, sigma_px=0.2, cadence_s=10.0)
        tracemalloc.start()
        record = normal_points.dense_record(drawn.points, site=drawn.site, image_size=SIZE, options=EQUISOLID)
        peaks.append(tracemalloc.get_traced_memory()[1] / len(drawn.points))
        tracemalloc.stop()
        assert record is not None
        assert len(record.normal) <= 2000
    assert all(later < 1.1 * before for before, later in pairwise(peaks))
    assert peaks[-1] < 1000.0
