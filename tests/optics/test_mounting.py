"""The pose in words names the azimuth at the top of the image and the direction of the tilt."""

from __future__ import annotations

from dataclasses import replace

import pytest
from tests.fixtures.served import LENS

from sunarc.optics.mounting import compass_point, pose_text, top_azimuth_deg
from sunarc.optics.pose import PoseAngles, rotation_from_pose_angles


def test_a_level_camera_whose_x_axis_points_west_has_north_at_its_top() -> None:
    west = rotation_from_pose_angles(PoseAngles(phi_xz_deg=180.0, theta_zz_deg=0.0, psi_z_deg=0.0))
    camera = replace(LENS, rotation_cam_enu=west, decentering=(0.0,) * 4)
    assert abs((top_azimuth_deg(camera) + 180.0) % 360.0 - 180.0) < 1e-6
    assert pose_text(camera) == "image top points to azimuth 0°, level"


@pytest.mark.parametrize(("lean", "words"), [(225.0, "south-west"), (91.0, "east"), (340.0, "north")])
def test_the_tilt_is_towards_where_the_axis_leans(lean: float, words: str) -> None:
    # the top of the image is clockwise of the x axis: azimuth 90 - phi - 90
    turned = rotation_from_pose_angles(PoseAngles(phi_xz_deg=-34.0, theta_zz_deg=1.2, psi_z_deg=lean))
    text = pose_text(replace(LENS, rotation_cam_enu=turned, decentering=(0.0,) * 4))
    assert text.startswith("image top points to azimuth 21")
    assert text.endswith(f"tilted 1.2° to the {words}")


@pytest.mark.parametrize(
    ("azimuth", "name"), [(0.0, "north"), (22.6, "north-east"), (359.0, "north"), (180.0, "south")]
)
def test_an_azimuth_has_the_nearest_point_of_the_compass(azimuth: float, name: str) -> None:
    assert compass_point(azimuth) == name
