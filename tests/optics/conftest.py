from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from sunarc.optics.camera import Camera
from sunarc.optics.pose import PoseAngles, rotation_from_pose_angles, rotation_matrix
from sunarc.optics.projections import PROJECTIONS, Projection, ideal_radius


def _edge(projection: Projection) -> float:
    return math.radians(60.0) if projection == "perspective" else math.radians(88.0)


@pytest.fixture(params=PROJECTIONS)
def camera(request: pytest.FixtureRequest) -> Camera:
    """One imperfect, tilted camera of each projection; the equisolid one is mirrored."""
    projection: Projection = request.param
    edge = _edge(projection)
    focal = 850.0 / float(ideal_radius(projection, edge))
    return Camera(
        width=1748,
        height=1748,
        projection=projection,
        focal_length_px=(focal, focal + 0.3),
        skew_px=0.4,
        principal_point_px=(871.96, 883.0),
        rotation_cam_enu=rotation_from_pose_angles(PoseAngles(47.91, 12.46, 140.16)),
        radial=(2e-3, -4e-3, 1e-3, 2e-3, 0.0, -1e-3, 5e-4, 1e-4),
        decentering=(2e-4, -1e-4, 0.1, -0.05),
        mirrored=projection == "equisolid",
        max_angle=edge,
    )


@pytest.fixture
def directions(camera: Camera) -> NDArray[np.float64]:
    """Directions all over the camera's field, its axis among them."""
    rng = np.random.default_rng(4)
    theta = np.r_[0.0, 1e-9, rng.uniform(0.0, camera.max_angle * 0.999, 400)]
    phi = rng.uniform(-math.pi, math.pi, theta.size)
    rays = np.stack([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)], axis=-1)

    return np.asarray(rays @ rotation_matrix(camera.rotation_cam_enu))


@pytest.fixture
def level(camera: Camera) -> Camera:
    return replace(camera, rotation_cam_enu=(0.0, 0.0, 0.0))
