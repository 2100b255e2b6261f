"""The fisheye model as ROS and COLMAP write it: `camera_info` in YAML and `cameras.txt`.

Neither has a mirror, and neither says how the camera stands: the rotation from east-north-up is in a comment.
References: ROS REP 104 and `camera_calibration_parsers`; COLMAP's `cameras.txt` and its camera models.
"""

from __future__ import annotations

import re

import numpy as np

from sunarc.array_types import FloatArray
from sunarc.errors import InputError
from sunarc.exports.fisheye import RADIAL, Fisheye, FisheyeModel, fisheye_view
from sunarc.exports.view import View
from sunarc.extras import extra_module
from sunarc.optics.camera import Camera

_ROTATION = "rotation_cam_enu, row by row: "
_COLMAP_ORIGIN_PX = 0.5
"""COLMAP's (0, 0) is the corner of the top-left pixel."""
_COLMAP_MODELS = {
    "THIN_PRISM_FISHEYE": tuple(Fisheye),
    "OPENCV_FISHEYE": (Fisheye.FX, Fisheye.FY, Fisheye.CX, Fisheye.CY, *RADIAL),
}


def require_no_mirror(camera: Camera, form: str) -> None:
    """Raise InputError for a mirrored camera, where a format has no mirror."""
    if camera.mirrored:
        raise InputError(
            field="calibration",
            problem=f"it is of mirrored images, which {form} cannot describe",
            remedy="use opencv (a negative focal length), or flip the images and calibrate again",
        )


def colmap_text(model: FisheyeModel, *, size: tuple[int, int], notes: list[str]) -> bytes:
    """Return COLMAP's cameras.txt with one camera of the model THIN_PRISM_FISHEYE."""
    values = model.parameters.copy()
    values[[Fisheye.CX, Fisheye.CY]] += _COLMAP_ORIGIN_PX
    numbers = " ".join(f"{value:.15g}" for value in values)
    return _commented(model, notes) + f"1 THIN_PRISM_FISHEYE {size[0]} {size[1]} {numbers}\n".encode()


def read_colmap(content: bytes, *, name: str) -> View:
    """Return the view of the first camera of a cameras.txt, THIN_PRISM_FISHEYE or OPENCV_FISHEYE."""
    lines = [
        line.split() for line in content.decode(errors="replace").splitlines() if line and not line.startswith("#")
    ]
    try:
        _, kind, width, height, *numbers = lines[0]
        values = np.array(numbers, dtype=np.float64)
        size = (int(width), int(height))
    except (ValueError, IndexError) as error:
        raise InputError(field=name, problem=f"no camera ({error})", remedy="give COLMAP's cameras.txt") from None
    places = _COLMAP_MODELS.get(kind, ())
    if not places or len(values) != len(places):
        problem = f"a camera {kind} with {len(values)} parameters"
        raise InputError(field=name, problem=problem, remedy=f"use {' or '.join(_COLMAP_MODELS)}")
    parameters = np.zeros(len(Fisheye))
    parameters[list(places)] = values
    parameters[[Fisheye.CX, Fisheye.CY]] -= _COLMAP_ORIGIN_PX
    return _view("colmap", parameters, content, size)


def ros_yaml(model: FisheyeModel, *, size: tuple[int, int], camera: str, notes: list[str]) -> bytes:
    """Return ROS's camera_info, distortion model `equidistant` (image_proc's fisheye)."""

    def matrix(name: str, values: FloatArray) -> list[str]:
        rows, columns = np.atleast_2d(values).shape
        data = ", ".join(f"{value:.15g}" for value in values.ravel())
        return [f"{name}:", f"  rows: {rows}", f"  cols: {columns}", f"  data: [{data}]"]

    lines = [
        f"image_width: {size[0]}",
        f"image_height: {size[1]}",
        f"camera_name: {re.sub(r'[^A-Za-z0-9_]+', '_', camera)}",
        *matrix("camera_matrix", model.matrix),
        "distortion_model: equidistant",
        *matrix("distortion_coefficients", model.distortion),
        *matrix("rectification_matrix", np.eye(3)),
        *matrix("projection_matrix", np.column_stack([model.matrix, np.zeros(3)])),
    ]
    return _commented(model, notes) + ("\n".join(lines) + "\n").encode()


def read_ros(content: bytes, *, name: str) -> View:
    """Return the view of a camera_info whose distortion model is `equidistant` (or `fisheye`)."""
    yaml = extra_module("yaml", extra="formats")
    try:
        read = yaml.safe_load(content)
        size = (int(read["image_width"]), int(read["image_height"]))
        matrix = np.array(read["camera_matrix"]["data"], dtype=np.float64).reshape(3, 3)
        distortion = np.array(read["distortion_coefficients"]["data"], dtype=np.float64)
        kind = read["distortion_model"]
    except (yaml.YAMLError, KeyError, TypeError, ValueError) as error:
        raise InputError(field=name, problem=f"no camera_info ({error})", remedy="give ROS's YAML file") from None
    if kind not in ("equidistant", "fisheye") or distortion.shape != (4,):
        problem = f"distortion model {kind} with {distortion.size} coefficients"
        raise InputError(field=name, problem=problem, remedy="give one of the model equidistant, which has 4")
    parameters = np.zeros(len(Fisheye))
    parameters[:4] = matrix[0, 0], matrix[1, 1], matrix[0, 2], matrix[1, 2]
    parameters[list(RADIAL)] = distortion
    return _view("ros", parameters, content, size)


def _commented(model: FisheyeModel, notes: list[str]) -> bytes:
    rotation = " ".join(f"{value:.15g}" for value in model.rotation.ravel())
    return "".join(f"# {note}\n" for note in [*notes, _ROTATION + rotation]).encode()


def _view(form: str, parameters: FloatArray, content: bytes, size: tuple[int, int]) -> View:
    found = re.search(re.escape(_ROTATION.encode()) + rb"([^\n]+)", content)
    rotation = np.eye(3) if found is None else np.array(found.group(1).split(), dtype=np.float64).reshape(3, 3)
    return fisheye_view(
        form, FisheyeModel(parameters=parameters, rotation=rotation), size=size, has_pose=found is not None
    )
