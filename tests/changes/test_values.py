"""The window of the last sightings as a value, and the bounds of the options."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from tests.fixtures.calibration import small_camera

from sunarc.calibration.evidence import ONLINE
from sunarc.calibration.model.pose_change import pose_before, turn_between
from sunarc.changes.values import OF_LENS, Sighting, SightingWindow, WatchOptions, lens_freedom
from sunarc.common.errors import InputError
from sunarc.optics.camera import Param
from sunarc.optics.pose import rotation_between


def _grown(count: int) -> SightingWindow:
    window = SightingWindow()
    for k in range(count):
        one = Sighting(unix_s=60.0 * k, pixel=(float(k), 2.0 * k), direction=(0.0, 0.6, 0.8), sigma_px=0.1 * k)
        window = window.append_sighting(one, trusted=k % 2 == 0, surprise=np.array([k, -k], dtype=np.float64))
    return window


def test_an_empty_window_has_columns_of_nothing() -> None:
    window = SightingWindow()
    assert len(window) == 0
    assert window.pixels.shape == window.surprise.shape == (0, 2)
    assert window.directions.shape == (0, 3)
    assert window.trusted.dtype == np.bool_


def test_sightings_are_appended_in_order() -> None:
    window = _grown(3)
    assert len(window) == 3
    np.testing.assert_allclose(window.unix_s, [0.0, 60.0, 120.0])
    np.testing.assert_allclose(window.pixels, [[0.0, 0.0], [1.0, 2.0], [2.0, 4.0]])
    np.testing.assert_allclose(window.directions, np.tile([0.0, 0.6, 0.8], (3, 1)))
    np.testing.assert_allclose(window.sigma_px, [0.0, 0.1, 0.2])
    assert window.trusted.tolist() == [True, False, True]
    np.testing.assert_allclose(window.surprise, [[0.0, 0.0], [1.0, -1.0], [2.0, -2.0]])


def test_a_sighting_more_leaves_the_window_before_as_it_was() -> None:
    window = _grown(2)
    window.append_sighting(
        Sighting(unix_s=1e9, pixel=(0.0, 0.0), direction=(0.0, 0.0, 1.0)), trusted=True, surprise=np.zeros(2)
    )
    assert len(window) == 2


@pytest.mark.parametrize(("count", "kept"), [(0, []), (2, [120.0, 180.0]), (9, [0.0, 60.0, 120.0, 180.0])])
def test_the_last_ones(count: int, kept: list[float]) -> None:
    assert _grown(4).last(count).unix_s.tolist() == kept


def test_what_is_remembered_from_a_time_on_holds_that_time() -> None:
    assert _grown(4).since(120.0).unix_s.tolist() == [120.0, 180.0]
    assert len(_grown(4).since(180.5)) == 0


def test_a_sighting_states_no_sigma_unless_it_is_given() -> None:
    assert math.isnan(Sighting(unix_s=0.0, pixel=(0.0, 0.0), direction=(0.0, 0.0, 1.0)).sigma_px)


@pytest.mark.parametrize(
    "wrong",
    [{"wander_deg": -0.1}, {"wander_deg": 5.1}, {"wander_deg": math.nan}],
)
def test_options_out_of_bounds_are_refused(wrong: dict[str, float]) -> None:
    with pytest.raises(InputError):
        replace(WatchOptions(), **wrong)


def test_options_at_their_bounds_are_taken() -> None:
    assert WatchOptions(wander_deg=0.0).wander_deg == 0.0


def test_a_turn_takes_one_pose_to_the_next_and_back() -> None:
    before, after = (0.1, -3.0, 0.2), (-0.2, -2.9, 0.4)
    turn = turn_between(before, after)
    assert np.linalg.norm(turn) == pytest.approx(math.degrees(rotation_between(before, after)))
    np.testing.assert_allclose(pose_before(after, turn), before, atol=1e-12)
    # turned by 10 degrees about the vertical a camera that looked at the sky sees it turn the other way
    up = Rotation.from_rotvec([0.0, 0.0, 10.0], degrees=True)
    turned = (Rotation.from_rotvec(before) * up.inv()).as_rotvec()
    np.testing.assert_allclose(turn_between(before, turned), [0.0, 0.0, 10.0], atol=1e-9)


def test_a_lens_changes_by_the_parameters_of_its_kind_and_both_focal_lengths_alike() -> None:
    camera = small_camera()
    names = [Param.K2, Param.FOCAL_LENGTH_Y_PX, Param.FOCAL_LENGTH_X_PX, Param.PRINCIPAL_POINT_Y_PX]
    focal, center, radial = ONLINE.lens
    focal_px = focal * camera.focal_length_px[0]
    refocused = lens_freedom(camera, names, OF_LENS["refocus"], ONLINE)
    assert refocused.tolist() == [[0.0], [focal_px], [focal_px], [0.0]]
    shifted = lens_freedom(camera, names, OF_LENS["shift"], ONLINE)
    assert shifted.tolist() == [[0.0, 0.0]] * 3 + [[0.0, center * camera.height]]
    lens = lens_freedom(camera, names, OF_LENS["lens"], ONLINE)
    assert lens.shape == (4, 5)
    assert lens[0].tolist() == [0.0, 0.0, 0.0, radial, 0.0]
