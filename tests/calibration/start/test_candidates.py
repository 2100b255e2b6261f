"""First cameras: Wahba's problem against scipy, the image circle by hand, the search over focal lengths."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation
from tests.fixtures.calibration import ideal_camera, observed, small_camera, spread_directions, sun_arc

from sunarc.calibration.model.options import CalibrationOptions, ImageCircle
from sunarc.calibration.start.initial_guess import (
    as_far_as_it_rises,
    candidates,
    level_camera,
    tilt,
    wahba,
)
from sunarc.optics.forward import project
from sunarc.optics.inverse import unproject
from sunarc.optics.pose import rotation_matrix
from sunarc.optics.projections import Projection

FloatArray = NDArray[np.float64]

OPTIONS = CalibrationOptions()


@pytest.mark.parametrize(
    ("projection", "radius"),
    [("equidistant", math.pi / 2), ("equisolid", math.sqrt(2.0)), ("stereographic", 2.0), ("orthographic", 1.0)],
)
def test_the_circle_s_radius_over_the_projection_s_is_the_focal_length(projection: Projection, radius: float) -> None:
    circle = ImageCircle(x=310.0, y=250.0, radius=300.0)
    camera = level_camera(circle, image_size=(640, 480), options=replace(OPTIONS, projection=projection))
    np.testing.assert_allclose(camera.focal_length_px, 300.0 / radius)
    assert camera.principal_point_px == (310.0, 250.0)
    assert (camera.width, camera.height, camera.mirrored) == (640, 480, False)
    assert camera.rotation_cam_enu == (0.0, 0.0, 0.0)
    assert camera.max_angle == pytest.approx(math.radians(100.0))


def test_a_circle_beyond_the_horizon_counts_as_the_horizon_s() -> None:
    circle = ImageCircle(x=310.0, y=250.0, radius=300.0, angle_deg=95.0)
    equidistant = replace(OPTIONS, projection="equidistant")
    found = level_camera(circle, image_size=(640, 480), options=equidistant)
    assert found.focal_length_px[0] == pytest.approx(300.0 / (math.pi / 2))
    narrow = level_camera(replace(circle, angle_deg=45.0), image_size=(640, 480), options=equidistant)
    assert narrow.focal_length_px[0] == pytest.approx(300.0 / (math.pi / 4))
    perspective = level_camera(circle, image_size=(640, 480), options=replace(OPTIONS, projection="perspective"))
    assert perspective.focal_length_px[0] == pytest.approx(300.0 / math.tan(math.radians(80.0)))


def test_a_mirrored_circle_s_centre_is_on_the_other_side() -> None:
    circle = ImageCircle(x=310.0, y=250.0, radius=300.0)
    camera = level_camera(circle, image_size=(640, 480), options=replace(OPTIONS, mirrored="yes"))
    assert camera.mirrored
    assert camera.principal_point_px == (639.0 - 310.0, 250.0)


def test_without_a_circle_the_field_is_180_degrees_across_the_shorter_side() -> None:
    camera = level_camera(None, image_size=(640, 480), options=replace(OPTIONS, projection="equidistant"))
    assert camera.focal_length_px[0] == pytest.approx(240.0 / (math.pi / 2))
    assert camera.principal_point_px == (319.5, 239.5)
    flat = level_camera(None, image_size=(480, 640), options=replace(OPTIONS, projection="perspective"))
    assert flat.focal_length_px[0] == pytest.approx(240.0 / math.tan(math.radians(60.0)))


@pytest.mark.parametrize("mirrored", [False, True])
def test_three_exact_sightings_give_the_pose(*, mirrored: bool) -> None:
    camera = small_camera(mirrored=mirrored)
    seen = observed(camera, spread_directions(3, widest_deg=50.0))
    found, misfit = wahba(replace(camera, rotation_cam_enu=(0.1, 0.2, 0.3)), seen)
    np.testing.assert_allclose(
        rotation_matrix(found.rotation_cam_enu), rotation_matrix(camera.rotation_cam_enu), atol=1e-6
    )
    assert misfit < 1e-6


def test_one_round_is_scipy_s_alignment_of_vectors() -> None:
    camera = small_camera()
    seen = observed(camera, spread_directions(30, widest_deg=60.0), sigma_px=3.0)
    found, misfit = wahba(camera, seen, rounds=1)
    rays = unproject(as_far_as_it_rises(camera), seen.pixels)
    expected, _ = Rotation.align_vectors(rays, seen.directions)
    np.testing.assert_allclose(rotation_matrix(found.rotation_cam_enu), expected.as_matrix(), atol=1e-9)
    chords = np.linalg.norm(rays - expected.apply(seen.directions), axis=-1)
    assert misfit == pytest.approx(float(np.median(chords)))


def test_further_rounds_weigh_outliers_down() -> None:
    camera = small_camera()
    seen = observed(camera, spread_directions(40, widest_deg=60.0), sigma_px=0.1)
    pixels = seen.pixels.copy()
    pixels[::5] += [40.0, 25.0]
    wrong = replace(seen, pixels=pixels)
    apart = []
    for rounds in (1, 4):
        found, _ = wahba(camera, wrong, rounds=rounds)
        between = rotation_matrix(found.rotation_cam_enu) @ rotation_matrix(camera.rotation_cam_enu).T
        apart.append(Rotation.from_matrix(between).magnitude())
    assert apart[1] < 0.3 * apart[0]


def test_sightings_of_an_arc_are_never_explained_by_a_reflection() -> None:
    """The sun's way over a day lies nearly in a plane: the determinant decides the sign of its normal."""
    camera = small_camera()
    found, _ = wahba(camera, observed(camera, sun_arc(20, declination_deg=0.0)))
    assert np.linalg.det(rotation_matrix(found.rotation_cam_enu)) == pytest.approx(1.0)
    np.testing.assert_allclose(
        rotation_matrix(found.rotation_cam_enu), rotation_matrix(camera.rotation_cam_enu), atol=1e-5
    )


def test_too_few_rays_have_no_pose() -> None:
    camera = small_camera("orthographic")
    seen = observed(camera, spread_directions(10, widest_deg=60.0))
    pixels = seen.pixels.copy()
    pixels[:6] = 1e5
    found, misfit = wahba(camera, replace(seen, pixels=pixels))
    assert found is camera
    assert misfit == math.inf
    pixels[4:6] = seen.pixels[4:6]
    assert wahba(camera, replace(seen, pixels=pixels))[1] < 1e-6
    assert wahba(camera, seen.select(slice(0, 2)))[1] == math.inf


@pytest.mark.parametrize(
    ("rotation", "angle_deg"),
    [
        ((0.0, 0.0, 0.0), 0.0),
        ((0.0, 0.0, 2.0), 0.0),
        ((0.3, 0.0, 0.0), math.degrees(0.3)),
        ((0.0, math.pi, 0.0), 180.0),
    ],
)
def test_the_tilt_by_hand(rotation: tuple[float, float, float], angle_deg: float) -> None:
    assert math.degrees(tilt(replace(small_camera(), rotation_cam_enu=rotation))) == pytest.approx(angle_deg, abs=1e-6)


def test_the_tilt_is_the_angle_between_the_axis_and_the_vertical() -> None:
    rng = np.random.default_rng(1)
    for vector in rng.normal(0.0, 1.0, (20, 3)):
        camera = replace(small_camera(), rotation_cam_enu=tuple(vector))
        expected = math.acos(float(rotation_matrix(camera.rotation_cam_enu)[2, 2]))
        assert tilt(camera) == pytest.approx(expected, abs=1e-9)


def test_a_lens_answers_as_far_as_its_radius_rises() -> None:
    falling = replace(ideal_camera(), radial=(-1.0, *([0.0] * 7)), rotation_cam_enu=(0.5, 0.0, 0.0))
    found = as_far_as_it_rises(falling)
    assert found.rotation_cam_enu == (0.0, 0.0, 0.0)
    assert found.max_angle == pytest.approx((math.pi / 2) ** 2 / 2.0, abs=1e-3)
    assert as_far_as_it_rises(ideal_camera()).max_angle > 3.0


def test_a_known_guess_is_turned_and_nothing_else() -> None:
    camera = replace(ideal_camera(), rotation_cam_enu=(0.02, -0.05, 1.0))
    seen = observed(camera, sun_arc(60))
    found = candidates(seen, replace(camera, rotation_cam_enu=(0.0, 0.0, 0.0)), known=True, best=5)
    assert len(found) == 1
    assert found[0].focal_length_px == camera.focal_length_px
    np.testing.assert_allclose(project(found[0], seen.directions), seen.pixels, atol=1e-3)


def test_the_search_finds_a_focal_length_within_a_step_and_the_best_first() -> None:
    camera = replace(ideal_camera(), rotation_cam_enu=(0.02, -0.05, 1.0))
    seen = observed(camera, sun_arc(60))
    guess = replace(camera, rotation_cam_enu=(0.0, 0.0, 0.0), focal_length_px=(130.0, 130.0))
    found = candidates(seen, guess, known=False, best=4)
    assert len(found) == 4
    ratio = (4.0 / 0.35) ** (1.0 / 21.0)
    assert abs(math.log(found[0].focal_length_px[0] / 200.0)) < math.log(ratio)
    misfits = [wahba(each, seen)[1] for each in found]
    assert misfits == sorted(misfits)


def test_cameras_that_would_look_at_the_ground_are_no_candidates() -> None:
    camera = replace(ideal_camera(), rotation_cam_enu=(math.radians(80.0), 0.0, 0.0), max_angle=3.0)
    seen = observed(camera, spread_directions(30))
    assert candidates(seen, replace(camera, rotation_cam_enu=(0.0, 0.0, 0.0)), known=True, best=5) == []
