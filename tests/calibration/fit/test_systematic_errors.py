"""Errors that many sightings share: displacements against cameras that are turned, and where none are."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from tests.fixtures.calibration import observed, small_camera, small_problem, spread_directions

from sunarc.calibration.fit.effects import DECENTRED_PX, OFFSET_PX, POSE_DIFFERENCE_DEG, with_effects
from sunarc.calibration.model.sightings import Kind, kinds_of
from sunarc.optics.forward import project
from sunarc.optics.pose import rotation_matrix, rotation_vector

FloatArray = NDArray[np.float64]

CAMERA = small_camera()
COUNT = 12
KIND = np.repeat([Kind.SUN, Kind.STAR, Kind.MOON], [4, 6, 2])


def displaced(block: str, kind: NDArray[np.int64] = KIND) -> FloatArray:
    """Return the displacements (n, 2, s) of sightings of some kinds by one block."""
    seen = replace(observed(CAMERA, spread_directions(COUNT)), kind=kind, night=kind != Kind.SUN)
    problem = small_problem(CAMERA)
    found, shared = with_effects(problem, problem.unknowns([CAMERA]), seen)
    columns = {one.name: one.columns for one in found.blocks}
    return shared.systematic_px[..., columns.get(block, slice(0, 0))]


def test_bodies_have_kinds() -> None:
    names = np.array(["sun", "moon", "venus", "saturn", "star:HIP32349", "stated"])
    assert kinds_of(names).tolist() == [Kind.SUN, Kind.MOON, Kind.STAR, Kind.STAR, Kind.STAR, Kind.SUN]


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_turns_are_those_of_a_camera_that_is_turned_about_east_north_and_up(axis: int) -> None:
    turn = np.radians(POSE_DIFFERENCE_DEG) * np.eye(3)[axis]
    # a camera turned by R(d) has the rotation from world to camera R_cam R(d)'
    turned = rotation_vector(rotation_matrix(CAMERA.rotation_cam_enu) @ rotation_matrix(tuple(turn)).T)
    directions = spread_directions(COUNT)
    expected = project(replace(CAMERA, rotation_cam_enu=turned), directions) - project(CAMERA, directions)
    found = displaced("night_pose")[..., axis]
    assert np.abs(expected).max() > 0.01
    np.testing.assert_allclose(found[4:], expected[4:], rtol=2e-3, atol=1e-5)
    np.testing.assert_allclose(found[:4], 0.0)


def test_stars_alone_are_displaced_outwards() -> None:
    found = displaced("night_offset")
    outwards = project(CAMERA, spread_directions(COUNT)) - np.array(CAMERA.principal_point_px)
    along = outwards / np.linalg.norm(outwards, axis=-1, keepdims=True)
    np.testing.assert_allclose(found[:4], 0.0)
    np.testing.assert_allclose(found[10:], 0.0)
    size = np.einsum("nak,na->nk", found[4:10], along[4:10])
    np.testing.assert_allclose(size[..., None] * along[4:10, None], np.moveaxis(found[4:10], 1, -1), atol=1e-12)
    radius = size[:, 0] / OFFSET_PX
    assert np.all((radius > 0.0) & (radius < 1.0))
    np.testing.assert_allclose(size[:, 1:3], OFFSET_PX * radius[:, None] ** [2, 3], rtol=1e-9)
    np.testing.assert_allclose(size[:, 3:], DECENTRED_PX * radius[:, None] ** 2 * along[4:10], rtol=1e-9)


@pytest.mark.parametrize("kind", [Kind.STAR, Kind.SUN])
def test_a_night_without_a_day_and_a_day_without_a_night_have_none(kind: Kind) -> None:
    for block in ("night_offset", "night_pose"):
        assert displaced(block, np.full(COUNT, kind)).shape == (COUNT, 2, 0)
