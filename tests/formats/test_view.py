"""The two ways of a view are inverses of each other."""

from __future__ import annotations

import math

import numpy as np
import pytest
from tests.formats.conftest import LENS, FloatArray, apart_deg

from sunarc.calibration.answers.covariance import hemisphere
from sunarc.formats.view import camera_view, grid_view, lens_view, rotated
from sunarc.optics.camera import camera_sees
from sunarc.optics.forward import project
from sunarc.optics.inverse import unproject
from sunarc.optics.pose import rotation_matrix

SIZE = (LENS.width, LENS.height)


def seen() -> tuple[FloatArray, FloatArray]:
    directions = hemisphere(500)
    pixels = project(LENS, directions)
    inside = camera_sees(LENS, pixels)
    return directions[inside], pixels[inside]


def test_newtons_method_inverts_a_lens_that_is_given_one_way() -> None:
    rotation = rotation_matrix(LENS.rotation_cam_enu)
    view = lens_view(
        "other", size=SIZE, rotation=rotation, pixels_of_rays=lambda rays: project(LENS, rays @ rotation),
        start=lambda pixels: (pixels - LENS.principal_point_px - 9.0) / [580.0, 620.0],
    )  # fmt: skip
    directions, pixels = seen()
    assert view.project(directions) == pytest.approx(pixels)
    assert apart_deg(view.unproject(pixels), directions).max() < 1e-7
    assert np.isnan(view.unproject(np.array([[-4000.0, 0.0]]))).all()  # beyond the field


def test_a_map_is_interpolated_between_its_nodes_and_inverted() -> None:
    x, y = np.arange(0, 1748, 4), np.arange(0, 1600, 4)
    grid = np.stack(np.meshgrid(x, y), axis=-1).astype(np.float64)
    view = grid_view("map", size=SIZE, x=x, y=y, directions=unproject(LENS, grid))
    directions, pixels = seen()
    found = view.unproject(pixels)
    described = np.isfinite(found[:, 0])
    assert described.mean() > 0.98
    assert apart_deg(found[described], directions[described]).max() < 1e-3
    back = view.project(found[described])
    assert back == pytest.approx(pixels[described], abs=1e-3)
    at_nodes = view.unproject(grid[100, 100:110])
    assert apart_deg(at_nodes, unproject(LENS, grid[100, 100:110])).max() < 1e-6
    assert np.isnan(view.unproject(np.array([[-0.6, 800.0], [1747.6, 800.0]]))).all()


def test_a_rotated_view_sees_the_rotated_direction_at_the_same_pixel() -> None:
    c, s = math.cos(0.3), math.sin(0.3)
    turn = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    view = rotated(camera_view(LENS), turn)
    directions, pixels = seen()
    assert view.unproject(pixels) == pytest.approx(directions @ turn.T)
    assert view.project(directions @ turn.T) == pytest.approx(pixels)
    assert view.camera is None
