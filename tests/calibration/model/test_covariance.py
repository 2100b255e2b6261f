"""What a calibration says of its own error, and that its document carries it whole."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from datetime import UTC, datetime
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from sunarc.calibration.answers.covariance import (
    hemisphere,
    project_with_covariance,
    sigma_deg,
    sigma_px,
    unproject_with_sigma,
)
from sunarc.calibration.answers.direction_table import back_projection_map, lookup
from sunarc.calibration.calibrate import calibrate
from sunarc.calibration.model.result import Calibration
from sunarc.calibration.model.sightings import Sightings
from sunarc.calibration.solve import problem as bins_module
from sunarc.calibration.verdict import accept
from sunarc.common.errors import InputError
from sunarc.formats.calibration_document import from_document, to_document
from sunarc.optics.backward import back_project
from sunarc.optics.forward import project
from sunarc.optics.inverse import unproject
from sunarc.sky.directions import angular_distance

if TYPE_CHECKING:
    from tests.fixtures.clear_day import Simulated, Simulator

SIZE = (1748, 1748)
NOW = datetime(2013, 5, 14, 3, 0, tzinfo=UTC)


def _document(calibration: Calibration) -> dict[str, Any]:
    made = to_document(
        calibration,
        id="c1",
        camera="usi",
        state="candidate",
        created_at=NOW,
        valid_from=NOW,
        valid_until=None,
        pose_epoch="e1",
        software_version="0",
    )
    return dict(json.loads(json.dumps(made, allow_nan=False)))


def test_the_document_alone_suffices(calibrated: Calibration) -> None:
    again = from_document(_document(calibrated))
    directions = hemisphere(120)
    pixels, covariance = project_with_covariance(calibrated, directions)
    same_pixels, same_covariance = project_with_covariance(again, directions)
    np.testing.assert_array_equal(pixels, same_pixels)
    np.testing.assert_allclose(sigma_px(same_covariance), sigma_px(covariance), rtol=1e-3)
    assert _document(again)["metrics"] == _document(calibrated)["metrics"]


@pytest.mark.parametrize("key", ["schema", "model.radial", "uncertainty.covariance", "image.width", "site.latitude"])
def test_a_malformed_document_names_the_key(calibrated: Calibration, key: str) -> None:
    document = _document(calibrated)
    inner = document
    *path, last = key.split(".")
    for part in path:
        inner = inner[part]
    inner[last] = "nonsense"
    with pytest.raises(InputError) as refused:
        from_document(document)
    assert refused.value.field == key


@pytest.mark.parametrize("document", [None, [], {}, {"schema": "sunarc.calibration/2"}])
def test_what_is_no_document_is_refused(document: object) -> None:
    with pytest.raises(InputError):
        from_document(document)


def test_pixels_and_directions_are_each_other_s_inverse_with_one_sigma(calibrated: Calibration) -> None:
    directions = hemisphere(80)
    pixels, _ = project_with_covariance(calibrated, directions)
    back, sigma, inside = unproject_with_sigma(calibrated, pixels)
    np.testing.assert_allclose(np.degrees(angular_distance(back, directions)), 0.0, atol=1e-9)
    np.testing.assert_allclose(sigma, sigma_deg(calibrated, directions), rtol=1e-5)
    assert np.all(inside)


def test_outside_the_field_there_is_no_answer(calibrated: Calibration) -> None:
    direction, sigma, inside = unproject_with_sigma(calibrated, [-4000.0, 20.0])
    assert np.all(np.isnan(direction))
    assert np.isnan(sigma)
    assert not inside


def test_the_map_says_what_single_pixels_say(calibrated: Calibration) -> None:
    found = back_projection_map(lookup(calibrated))
    rng = np.random.default_rng(0)
    pixels = rng.integers(250, 1500, (300, 2))
    directions, sigma, _ = unproject_with_sigma(calibrated, pixels)
    np.testing.assert_allclose(found.directions[pixels[:, 1], pixels[:, 0]], directions, atol=1e-7)
    np.testing.assert_allclose(found.sigma_deg[pixels[:, 1], pixels[:, 0]], sigma, rtol=0.01)


def test_a_clock_error_turns_the_sky_by_what_the_earth_turns(clear_day: Simulated, calibrated: Calibration) -> None:
    points = Sightings.of(unix_s=clear_day.points.unix_s, pixels=clear_day.points.pixels, clock_error_s=np.array(60.0))
    doubted = calibrate(points, site=clear_day.site, image_size=SIZE)
    toward_equator = np.array([0.0, -math.sin(math.radians(36.6)), math.cos(math.radians(36.6))])
    added = sigma_deg(doubted, toward_equator[None]) ** 2 - sigma_deg(calibrated, toward_equator[None]) ** 2
    # along one of the two axes, hence the root of one half
    assert math.sqrt(float(added[0])) == pytest.approx(60.0 * 360.0 / 86164.0 / math.sqrt(2.0), rel=0.02)


def test_backward_model_comes_back_to_its_stated_error(calibrated: Calibration) -> None:
    overhead = hemisphere(300)[:, 2] > 0.06  # within 90 degrees of the axis, where it was fitted
    pixels = project(calibrated.camera, hemisphere(300)[overhead])
    directions = back_project(calibrated.camera, calibrated.backward, pixels)
    apart = np.linalg.norm(project(calibrated.camera, directions) - pixels, axis=-1)
    assert calibrated.backward.max_error_px < 0.1
    assert np.max(apart) < 1.5 * calibrated.backward.max_error_px + 1e-4


def test_taking_sightings_together_changes_nothing(simulator: Simulator, monkeypatch: pytest.MonkeyPatch) -> None:
    seen = simulator(sigma_px=0.3, cadence_s=60.0)
    together = calibrate(seen.points, site=seen.site, image_size=SIZE)
    monkeypatch.setattr(bins_module, "_MOST", 1)
    alone = calibrate(seen.points, site=seen.site, image_size=SIZE)
    sky = hemisphere(200)
    apart = np.linalg.norm(project(together.camera, sky) - project(alone.camera, sky), axis=-1)
    stated = sigma_px(project_with_covariance(alone, sky)[1])
    assert np.max(apart / stated) < 0.1


def test_more_days_are_surer_and_accepted(simulator: Simulator) -> None:
    one, four = simulator(sigma_px=0.3), simulator(sigma_px=0.3, days=(0.0, 10.0, 20.0, 30.0))
    first = calibrate(one.points, site=one.site, image_size=SIZE)
    second = calibrate(four.points, site=four.site, image_size=SIZE)
    assert second.sky_rms_deg < first.sky_rms_deg
    assert accept(second, first).accepted
    assert not accept(first, second).accepted
    assert second.metrics.held_out_rmse_px == pytest.approx(0.3 * math.sqrt(2.0), rel=0.1)
    assert first.metrics.held_out_rmse_px is None


def test_a_moved_camera_is_noticed(simulator: Simulator) -> None:
    before = simulator(sigma_px=0.1)
    turned = replace(before.camera, principal_point_px=(876.0, 883.0))
    after = simulator(turned, sigma_px=0.1, days=(0.0, 5.0))
    first = calibrate(before.points, site=before.site, image_size=SIZE)
    second = calibrate(after.points, site=after.site, image_size=SIZE)
    decided = accept(second, first)
    assert not decided.accepted
    assert decided.findings[0].code == "contradicts_active"
    assert accept(second, first, same_pose=False).accepted


def test_exact_directions_of_pixels(calibrated: Calibration) -> None:
    pixels = np.random.default_rng(3).uniform(300, 1400, (50, 2))
    np.testing.assert_allclose(project(calibrated.camera, unproject(calibrated.camera, pixels)), pixels, atol=1e-7)
