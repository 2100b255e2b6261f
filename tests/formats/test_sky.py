"""The sky to which models are fitted."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from tests.formats.conftest import LENS

from sunarc.formats.view import camera_sky
from sunarc.optics.forward import project
from sunarc.optics.pose import rotation_matrix

SKY = camera_sky(LENS, within=LENS.max_angle)


@pytest.mark.parametrize("within_deg", [20.0, 60.0, 89.5])
def test_directions_reach_to_the_angle_and_no_farther(within_deg: float) -> None:
    sky = camera_sky(LENS, within=math.radians(within_deg))
    off_axis = np.degrees(np.arccos(sky.rays[:, 2]))
    assert sky.within == pytest.approx(math.radians(within_deg))
    assert off_axis.max() <= within_deg + 1e-9
    assert off_axis.max() > within_deg - 1.0


def test_directions_are_spread_evenly_over_the_cap() -> None:
    sky = camera_sky(LENS, within=math.radians(40.0))
    share = float(np.mean(sky.rays[:, 2] > math.cos(math.radians(20.0))))
    assert share == pytest.approx((1.0 - math.cos(math.radians(20.0))) / (1.0 - math.cos(math.radians(40.0))), abs=0.01)
    assert np.abs(sky.rays[:, :2].mean(axis=0)).max() < 0.01


def test_rays_and_pixels_are_of_one_camera() -> None:
    assert np.linalg.norm(SKY.rays, axis=-1) == pytest.approx(1.0)
    assert SKY.pixels == pytest.approx(project(LENS, SKY.rays @ rotation_matrix(LENS.rotation_cam_enu)))


def test_pixels_outside_the_image_are_left_out() -> None:
    narrow = camera_sky(replace(LENS, width=900), within=LENS.max_angle)
    assert len(narrow.pixels) < len(SKY.pixels)
    assert narrow.pixels[:, 0].max() <= 899.5
