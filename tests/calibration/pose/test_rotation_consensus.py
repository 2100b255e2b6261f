"""Rotations from few sightings, three of them by hand, against scipy's."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation
from tests.fixtures.calibration import ideal_camera, small_camera, spread_directions

from sunarc.calibration.answers.error_model import rotated
from sunarc.calibration.start import initial_guess as module
from sunarc.calibration.start.initial_guess import ransac_rotation
from sunarc.optics.forward import project

FloatArray = NDArray[np.float64]


def _found(turn: FloatArray, directions: FloatArray, *, noise_px: float = 0.0) -> FloatArray:
    start = small_camera()
    pixels = project(rotated(start, turn).at_every_angle(), directions)
    pixels += np.random.default_rng(1).normal(0.0, 1.0, pixels.shape) * noise_px
    return ransac_rotation(start, directions, pixels, np.full(len(directions), max(noise_px, 0.05)))


def _apart_deg(first: FloatArray, second: FloatArray) -> float:
    between = Rotation.from_rotvec(first) * Rotation.from_rotvec(second).inv()
    return float(np.degrees(between.magnitude()))


@pytest.mark.parametrize("size_deg", [0.2, 5.0, 60.0, 179.0])
def test_three_exact_sightings_give_the_rotation(size_deg: float) -> None:
    axis = np.array([0.6, -0.48, 0.64])
    turn = np.radians(size_deg) * axis
    directions = spread_directions(3, seed=8)
    assert _apart_deg(_found(turn, directions), turn) < 1e-3


def test_a_camera_that_stands_still_is_not_turned() -> None:
    np.testing.assert_array_equal(_found(np.zeros(3), spread_directions(10)), 0.0)


@pytest.mark.parametrize(("moved_deg", "turned_deg"), [(0.5, 0.5), (0.65, 0.0)])
def test_one_sighting_gives_the_smallest_rotation_if_it_is_small_by_hand(moved_deg: float, turned_deg: float) -> None:
    """A sighting outweighs a rotation by up to 0.01 rad: half a sighting for each power of ten above 1e-4 rad."""
    camera = ideal_camera()  # its x axis is to the east: a sun in the zenith is at the centre
    zenith = np.array([[0.0, 0.0, 1.0]])
    pixels = np.array([[319.5 + 200.0 * np.radians(moved_deg), 239.5]])
    found = ransac_rotation(camera, zenith, pixels, np.array([0.01]))
    # the ray moved from z towards x: about y
    np.testing.assert_allclose(np.degrees(found), [0.0, turned_deg, 0.0], atol=1e-6)


def test_two_sightings_of_one_pixel_name_no_rotation_of_a_pair() -> None:
    camera = ideal_camera()
    directions = spread_directions(2, seed=4)
    found = ransac_rotation(camera, directions, np.tile([330.0, 250.0], (2, 1)), np.full(2, 0.1))
    assert np.all(np.isfinite(found))
    assert np.linalg.norm(found) < np.pi


def test_pixels_beyond_the_lens_ask_for_nothing() -> None:
    camera = small_camera("orthographic")
    pixels = np.full((3, 2), 1e5)
    np.testing.assert_array_equal(ransac_rotation(camera, spread_directions(3), pixels, np.ones(3)), 0.0)
    np.testing.assert_array_equal(ransac_rotation(camera, np.zeros((0, 3)), np.zeros((0, 2)), np.zeros(0)), 0.0)


@pytest.mark.parametrize("false", [0.3, 0.5])
def test_false_sightings_do_not_turn_the_camera_elsewhere(false: float) -> None:
    camera, turn = small_camera(), np.radians([3.0, -2.0, 7.0])
    directions = spread_directions(40)
    rng = np.random.default_rng(2)
    pixels = project(rotated(camera, turn).at_every_angle(), directions)
    wrong = rng.random(40) < false
    pixels[wrong] = rng.uniform([0.0, 0.0], [640.0, 480.0], (int(wrong.sum()), 2))
    found = ransac_rotation(camera, directions, pixels, np.full(40, 0.2))
    assert _apart_deg(found, turn) < 0.3


def test_noise_moves_the_rotation_by_no_more_than_a_pair_of_sightings_tells() -> None:
    turn = np.radians([0.0, 4.0, 0.0])
    assert _apart_deg(_found(turn, spread_directions(60), noise_px=0.3), turn) < 0.4


def test_a_small_rotation_is_taken_before_a_large_one_that_fits_alike() -> None:
    """One sighting fits any rotation about its own direction, too."""
    turn = np.radians([0.5, 0.0, 0.0])
    found = _found(turn, np.array([[0.1, 0.2, np.sqrt(0.95)]]))
    assert np.degrees(np.linalg.norm(found)) < 0.51


def test_the_answer_does_not_change_from_call_to_call() -> None:
    turn = np.radians([10.0, -20.0, 5.0])
    directions = spread_directions(64)
    np.testing.assert_array_equal(_found(turn, directions, noise_px=0.5), _found(turn, directions, noise_px=0.5))


def test_axes_of_a_pair_are_orthonormal_and_right_handed_with_its_middle_first() -> None:
    vectors = spread_directions(6)
    pairs = np.array([[0, 1], [2, 3], [5, 4]])
    triads = module.triads(vectors, pairs)
    np.testing.assert_allclose(np.swapaxes(triads, -1, -2) @ triads, np.tile(np.eye(3), (3, 1, 1)), atol=1e-12)
    np.testing.assert_allclose(np.linalg.det(triads), 1.0)
    first, second = vectors[pairs[:, 0]], vectors[pairs[:, 1]]
    middle = np.cos(0.5 * np.arccos(np.sum(first * second, axis=-1)))
    np.testing.assert_allclose(np.sum(triads[..., 0] * first, axis=-1), middle)
    np.testing.assert_allclose(np.sum(triads[..., 0] * second, axis=-1), middle)
    np.testing.assert_allclose(np.sum(triads[..., 1] * first, axis=-1), 0.0, atol=1e-12)
