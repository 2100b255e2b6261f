"""The sky on which models are compared, and the error between two of them."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from tests.exports.conftest import LENS

from sunarc.exports.sky import fit_error, sky_of
from sunarc.optics import project, rotation_matrix

SKY = sky_of(LENS, within=LENS.max_angle)


@pytest.mark.parametrize("within_deg", [20.0, 60.0, 89.5])
def test_directions_reach_to_the_angle_and_no_farther(within_deg: float) -> None:
    sky = sky_of(LENS, within=math.radians(within_deg))
    off_axis = np.degrees(np.arccos(sky.rays[:, 2]))
    assert sky.within == pytest.approx(math.radians(within_deg))
    assert off_axis.max() <= within_deg + 1e-9
    assert off_axis.max() > within_deg - 1.0


def test_directions_are_spread_evenly_over_the_cap() -> None:
    sky = sky_of(LENS, within=math.radians(40.0))
    share = float(np.mean(sky.rays[:, 2] > math.cos(math.radians(20.0))))
    assert share == pytest.approx((1.0 - math.cos(math.radians(20.0))) / (1.0 - math.cos(math.radians(40.0))), abs=0.01)
    assert np.abs(sky.rays[:, :2].mean(axis=0)).max() < 0.01


def test_rays_directions_and_pixels_are_of_one_camera() -> None:
    assert np.linalg.norm(SKY.rays, axis=-1) == pytest.approx(1.0)
    assert SKY.directions @ rotation_matrix(LENS.rotation_cam_enu).T == pytest.approx(SKY.rays)
    assert SKY.pixels == pytest.approx(project(LENS, SKY.directions))


def test_pixels_outside_the_image_are_left_out() -> None:
    narrow = sky_of(replace(LENS, width=900), within=LENS.max_angle)
    assert len(narrow.pixels) < len(SKY.pixels)
    assert narrow.pixels[:, 0].max() <= 899.5


def test_a_model_is_not_off_itself() -> None:
    error = fit_error(LENS, SKY, SKY.pixels)
    assert (error.rms_px, error.max_px, error.rms_deg, error.max_deg) == (0.0, 0.0, 0.0, 0.0)
    assert error.within_deg == pytest.approx(math.degrees(SKY.within))


def test_a_constant_offset_is_its_length_in_pixels() -> None:
    error = fit_error(LENS, SKY, SKY.pixels + np.array([0.3, -0.4]))
    assert (error.rms_px, error.max_px) == pytest.approx((0.5, 0.5))
    assert error.rms_deg == pytest.approx(math.degrees(0.5 / 600.0), rel=0.2)  # 1 px is 1/601 rad near the axis
    assert error.rms_deg < error.max_deg < 2.0 * error.rms_deg


def test_an_angle_is_that_between_directions() -> None:
    turned = SKY.directions + 1e-6 * np.cross([0.0, 0.0, 1.0], SKY.directions)
    off = np.linalg.norm(turned - SKY.directions, axis=-1)
    error = fit_error(LENS, SKY, project(LENS, turned / np.linalg.norm(turned, axis=-1, keepdims=True)))
    assert error.max_deg == pytest.approx(math.degrees(float(off.max())), rel=0.01)
    assert error.rms_deg == pytest.approx(math.degrees(float(np.sqrt(np.mean(off**2)))), rel=0.01)


def test_one_bad_direction_is_the_largest_error() -> None:
    pixels = SKY.pixels.copy()
    pixels[17, 1] += 2.0
    error = fit_error(LENS, SKY, pixels)
    assert error.max_px == pytest.approx(2.0)
    assert error.rms_px == pytest.approx(2.0 / math.sqrt(len(pixels)))


def test_directions_without_a_pixel_limit_the_angle_that_is_stated() -> None:
    off_axis = np.arccos(SKY.rays[:, 2])
    pixels = np.where((off_axis > 1.0)[:, None], np.nan, SKY.pixels)
    error = fit_error(LENS, SKY, pixels)
    assert error.within_deg == pytest.approx(math.degrees(off_axis[off_axis > 1.0].min()))
    assert error.max_px == 0.0
