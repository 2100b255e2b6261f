"""Differences between two cameras against differences that were put there."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from tests.formats.conftest import LENS, FloatArray

from sunarc.calibration.answers.covariance import hemisphere
from sunarc.common.errors import InputError
from sunarc.formats.view import ZENITH_RANGES_DEG, View, camera_view, compare, rotated
from sunarc.optics.camera import camera_sees
from sunarc.optics.forward import project
from sunarc.optics.pose import rotation_matrix, rotation_vector

OURS = camera_view(LENS)


def shifted(view: View, by: FloatArray) -> View:
    """Return a view whose every pixel is moved."""
    return replace(
        view, project=lambda d: view.project(d) + by, unproject=lambda p: view.unproject(p - by), camera=None
    )


def test_a_camera_is_not_off_itself() -> None:
    found = compare(OURS, OURS)
    assert (found.total.rms_px, found.total.max_px, found.total.rms_deg) == (0.0, 0.0, 0.0)
    assert (found.undescribed, found.described_to_deg) == (0.0, 90.0)
    assert found.rotation_deg < 1e-10
    assert found.total.n == sum(one.n for one in found.by_zenith)


def test_a_moved_image_is_off_by_its_length_in_pixels() -> None:
    found = compare(OURS, shifted(OURS, np.array([0.3, -0.4])))
    assert (found.total.rms_px, found.total.max_px) == pytest.approx((0.5, 0.5))
    assert all((one.rms_px, one.max_px) == pytest.approx((0.5, 0.5)) for one in found.by_zenith)
    assert found.by_zenith[0].rms_deg == pytest.approx(math.degrees(0.5 / 600.0), rel=0.05)  # 1 px is 1/601 rad there
    assert found.total.rms_deg < found.total.max_deg < 2.0 * found.total.rms_deg


def test_a_rotation_is_found_with_its_axis_and_leaves_nothing() -> None:
    vector = np.radians([0.02, -0.01, 0.3])
    turn = Rotation.from_rotvec(vector).as_matrix()
    turned = replace(LENS, rotation_cam_enu=rotation_vector(rotation_matrix(LENS.rotation_cam_enu) @ turn.T))
    found = compare(camera_view(turned), OURS)
    assert np.radians(found.rotation_vector_deg) == pytest.approx(vector, abs=1e-9)
    assert found.rotation_deg == pytest.approx(math.degrees(np.linalg.norm(vector)))
    assert found.rms_rotated_deg < 1e-9
    assert found.total.max_deg == pytest.approx(found.rotation_deg, rel=0.01)


def test_the_ranges_are_those_of_the_zenith_angle_by_brute_force() -> None:
    other = replace(LENS, radial=(0.006, *LENS.radial[1:]))
    found = compare(OURS, camera_view(other))
    directions = hemisphere(20_000)
    pixels = project(LENS, directions)
    seen = camera_sees(LENS, pixels)
    off = np.linalg.norm(project(other, directions) - pixels, axis=-1)
    zenith = np.degrees(np.arccos(directions[:, 2]))
    for (low, high), one in zip(ZENITH_RANGES_DEG, found.by_zenith, strict=True):
        brute = off[seen & (zenith >= low) & (zenith < high)]
        assert (one.rms_px, one.max_px) == pytest.approx((np.sqrt(np.mean(brute**2)), brute.max()), rel=0.02)


def test_what_the_second_camera_cannot_describe_is_counted_and_not_averaged() -> None:
    near = replace(LENS, max_angle=math.radians(75.0), rotation_cam_enu=(0.0, 0.0, 2.1))
    level = replace(LENS, rotation_cam_enu=(0.0, 0.0, 2.1))
    found = compare(camera_view(level), camera_view(near))
    assert found.described_to_deg == pytest.approx(75.0, abs=0.1)
    assert found.undescribed == pytest.approx(math.cos(math.radians(75.0)) / 1.0, abs=0.02)  # of the hemisphere
    assert (found.total.max_px, found.by_zenith[3].n) == (0.0, 0)
    assert np.isnan(found.off_deg).mean() == pytest.approx(found.undescribed)
    assert "cannot describe" in str(found)
    assert "80-90" not in str(found)


def test_a_camera_without_a_pose_is_rotated_before() -> None:
    turn = Rotation.from_rotvec([0.4, -0.2, 1.3]).as_matrix()
    lens = replace(rotated(OURS, turn), has_pose=False)
    found = compare(OURS, lens)
    assert found.total.max_px < 1e-6
    assert found.rotation_deg == pytest.approx(math.degrees(np.linalg.norm([0.4, -0.2, 1.3])))


def test_images_of_two_sizes_and_skies_apart_are_refused() -> None:
    with pytest.raises(InputError) as refused:
        compare(OURS, camera_view(replace(LENS, width=1750)))
    assert refused.value.field == "image size"
    down = replace(OURS, unproject=lambda pixels: np.full((len(pixels), 3), np.nan))
    with pytest.raises(InputError) as refused:
        compare(OURS, down)
    assert refused.value.field == "comparison"
