"""OpenCV's fisheye model: K, D and R, as `cv2.FileStorage` writes and reads them."""

from __future__ import annotations

import cv2
import numpy as np

from sunarc.array_types import FloatArray
from sunarc.errors import InputError
from sunarc.exports.fisheye import RADIAL, Fisheye, FisheyeModel, fisheye_view
from sunarc.exports.view import View

_MATRIX = ("camera_matrix", "cameraMatrix", "Camera_Matrix", "K", "intrinsic_matrix")
_DISTORTION = ("distortion_coefficients", "distCoeffs", "Distortion_Coefficients", "D", "dist_coeffs")
_SIZES = (("image_width", "image_height"), ("image_Width", "image_Height"), ("width", "height"))
_ROTATION = "rotation_cam_enu"


def opencv_yaml(model: FisheyeModel, *, width: int, height: int, notes: dict[str, str]) -> bytes:
    """Return the file of a model, with its notes."""
    storage = cv2.FileStorage(".yml", cv2.FILE_STORAGE_WRITE | cv2.FILE_STORAGE_MEMORY)
    for name, text in notes.items():
        storage.write(name, text)
    for name, size in (("image_width", width), ("image_height", height)):
        storage.write(name, size)
    storage.write("camera_matrix", model.matrix)
    storage.write("distortion_coefficients", model.distortion[:, None])
    storage.write(_ROTATION, model.rotation)
    text = str(storage.releaseAndGetString())
    return text.replace("\\'", "'").encode()  # OpenCV escapes an apostrophe, which YAML does not know


def read_opencv(content: bytes, *, name: str) -> View:
    """Return the view of a fisheye calibration, YAML, XML or JSON of `cv2.FileStorage`.

    Raises
    ------
    InputError
        It is none: not four distortion coefficients (a calibration of cv2.calibrateCamera has 5 and more), or no size.
    """
    try:
        storage = cv2.FileStorage(content.decode(), cv2.FILE_STORAGE_READ | cv2.FILE_STORAGE_MEMORY)
        matrix, distortion, rotation = (_first(storage, names) for names in (_MATRIX, _DISTORTION, (_ROTATION,)))
        sizes = [[int(storage.getNode(one).real()) for one in pair] for pair in _SIZES]
    except (cv2.error, SystemError, UnicodeDecodeError):  # its constructor fails without saying how
        raise InputError(field=name, problem="OpenCV cannot read it", remedy="give a cv2.FileStorage file") from None
    if matrix is None or matrix.shape != (3, 3):
        raise InputError(field=name, problem="no 3x3 camera matrix", remedy=f"name it {_MATRIX[0]}")
    if distortion is None or distortion.size != 4:
        count = "no" if distortion is None else str(distortion.size)
        raise InputError(
            field=name,
            problem=f"{count} distortion coefficients, where cv2.fisheye has 4",
            remedy="give a calibration of cv2.fisheye; that of cv2.calibrateCamera cannot describe a fisheye lens",
        )
    width, height = next((pair for pair in sizes if min(pair) > 0), (0, 0))
    if width == 0:
        raise InputError(field=name, problem="no image size", remedy="add image_width and image_height, px")
    parameters = np.zeros(len(Fisheye))
    parameters[:4] = matrix[0, 0], matrix[1, 1], matrix[0, 2], matrix[1, 2]
    parameters[list(RADIAL)] = distortion.ravel()
    model = FisheyeModel(parameters=parameters, rotation=np.eye(3) if rotation is None else rotation)
    return fisheye_view("opencv", model, size=(width, height), has_pose=rotation is not None)


def _first(storage: cv2.FileStorage, names: tuple[str, ...]) -> FloatArray | None:
    """Return the first matrix that a file has of several names."""
    nodes = (storage.getNode(name) for name in names)
    return next((np.asarray(node.mat(), dtype=np.float64) for node in nodes if node.isMap()), None)
