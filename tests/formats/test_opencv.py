from __future__ import annotations

from typing import Any

import cv2
import numpy as np
import yaml
from tests.formats.conftest import FloatArray, worst_stated_px

from sunarc.formats.formats import export
from sunarc.optics.camera import Camera
from sunarc.optics.pose import rotation_matrix

Sky = tuple[FloatArray, FloatArray]


def read(content: bytes) -> tuple[FloatArray, FloatArray, FloatArray, cv2.FileStorage]:
    storage = cv2.FileStorage(content.decode(), cv2.FILE_STORAGE_READ | cv2.FILE_STORAGE_MEMORY)
    matrix, distortion, rotation = (
        np.asarray(storage.getNode(name).mat(), dtype=np.float64)
        for name in ("camera_matrix", "distortion_coefficients", "rotation_cam_enu")
    )
    return matrix, distortion, rotation, storage


def test_opencvs_own_projection_agrees_to_the_stated_error(document: dict[str, Any], camera: Camera, sky: Sky) -> None:
    exported = export(document, "opencv")
    matrix, distortion, rotation, storage = read(exported.content)
    directions, pixels = sky
    near = directions @ rotation_matrix(camera.rotation_cam_enu)[2] > np.cos(np.radians(89.0))
    theirs, _ = cv2.fisheye.projectPoints(
        directions[near][:, None], cv2.Rodrigues(rotation)[0], np.zeros(3), matrix, distortion
    )
    off = np.linalg.norm(theirs[:, 0] - pixels[near], axis=-1)
    assert 0.0 < worst_stated_px(exported.error) < 1.0
    assert off.max() < 1.05 * worst_stated_px(exported.error)
    assert np.linalg.det(rotation) > 0.999
    assert (matrix[0, 0] < 0.0) == camera.mirrored
    assert exported.error in storage.getNode("fit_error").string()
    assert "90 degrees" in storage.getNode("limit").string()


def test_readers_of_yaml_other_than_opencv_read_it_too(document: dict[str, Any]) -> None:
    reader: Any = type("Reader", (yaml.SafeLoader,), {})
    reader.add_constructor(
        "tag:yaml.org,2002:opencv-matrix", lambda loader, node: loader.construct_mapping(node, deep=True)
    )
    document = document | {"id": "the roof's"}
    content = export(document, "opencv").content
    found = yaml.load(content, reader)  # noqa: S506 - a safe one
    assert found["calibration"] == "the roof's" == read(content)[3].getNode("calibration").string()
    assert found["camera_matrix"]["data"] == read(content)[0].ravel().tolist()


def test_opencvs_own_undistortion_finds_the_direction(straight: dict[str, Any]) -> None:
    matrix, distortion, rotation, _ = read(export(straight, "opencv").content)
    pixel = np.array([[[700.0, 900.0]]])
    x, y = cv2.fisheye.undistortPoints(pixel, matrix, distortion)[0, 0]
    found = rotation.T @ np.array([x, y, 1.0])
    theirs, _ = cv2.fisheye.projectPoints(
        found[None, None], cv2.Rodrigues(rotation)[0], np.zeros(3), matrix, distortion
    )
    np.testing.assert_allclose(theirs, pixel, atol=1e-6)
