"""The fisheye model of OpenCV, ROS and COLMAP: a polynomial of the angle off the axis (Kannala and Brandt's).

COLMAP's THIN_PRISM_FISHEYE has decentering and a thin prism besides; without them it is OpenCV's `cv2.fisheye`.
References: J. Kannala and S. Brandt, PAMI 28 (2006) 1335; COLMAP's documentation of its camera models.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from enum import IntEnum

import cv2
import numpy as np

from sunarc.common.array_types import BoolArray, FloatArray
from sunarc.common.errors import InputError
from sunarc.common.extras import extra_module
from sunarc.formats.view import View, camera_sky, lens_view
from sunarc.optics.camera import Camera
from sunarc.optics.pose import rotation_matrix

WITHIN_DEG = 89.5
"""Off the axis; readers divide by z, so that they have nothing at 90 degrees and beyond."""

_TURN = slice(12, 15)
_SCALE = np.r_[np.ones(4), np.full(11, 1e-3)]
"""Pixels, distortion and radians differ by three orders: without scales the solver stops early."""
_ANGLES = 2001


class Fisheye(IntEnum):
    """Index of each parameter in COLMAP's model THIN_PRISM_FISHEYE; (fx, fy, cx, cy) in px."""

    FX = 0
    FY = 1
    CX = 2
    CY = 3
    K1 = 4
    K2 = 5
    P1 = 6
    P2 = 7
    K3 = 8
    K4 = 9
    SX1 = 10
    SY1 = 11


RADIAL = (Fisheye.K1, Fisheye.K2, Fisheye.K3, Fisheye.K4)
PRISM = (Fisheye.P1, Fisheye.P2, Fisheye.SX1, Fisheye.SY1)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class FisheyeModel:
    """A fisheye camera.

    Attributes
    ----------
    parameters : (12,) in the order of `Fisheye`; the centre of the top-left pixel is (0, 0); FX is negative for a
        mirrored image.
    rotation : (3, 3) from east-north-up to the camera; the identity where a file has none.
    """

    parameters: FloatArray
    rotation: FloatArray

    @property
    def matrix(self) -> FloatArray:
        """K (3, 3) px."""
        fx, fy, cx, cy = self.parameters[:4]
        return np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])

    @property
    def distortion(self) -> FloatArray:
        """D (4,), k1 … k4."""
        return self.parameters[list(RADIAL)]


def fisheye_model(camera: Camera, *, prism: bool = False) -> FisheyeModel:
    """Return the fisheye model that is closest to a camera; `prism`: with decentering and thin prism."""
    sky = camera_sky(camera, within=math.radians(WITHIN_DEG))
    sign = -1.0 if camera.mirrored else 1.0
    x0, y0 = camera.principal_point_px
    start = np.zeros(15)
    start[:4] = sign * camera.focal_length_px[0], camera.focal_length_px[1], x0, y0
    if camera.mirrored:
        start[Fisheye.CX] = camera.width - 1.0 - x0
    free = np.ones(15, dtype=bool)
    free[list(PRISM)] = prism

    def fill_parameters(moving: FloatArray) -> FloatArray:
        parameters = start.copy()
        parameters[free] = moving
        return parameters

    def misfit(moving: FloatArray) -> FloatArray:
        parameters = fill_parameters(moving)
        rays = sky.rays @ rotation_matrix(parameters[_TURN]).T
        return np.asarray(pixels_of_rays(parameters, rays) - sky.pixels).ravel()

    from scipy.optimize import least_squares  # noqa: PLC0415 - the service starts sooner without it

    found = fill_parameters(least_squares(misfit, start[free], x_scale=_SCALE[free], method="lm").x)
    rotation = rotation_matrix(found[_TURN]) @ rotation_matrix(camera.rotation_cam_enu)
    return FisheyeModel(parameters=found[: len(Fisheye)], rotation=rotation)


def fisheye_view(form: str, model: FisheyeModel, *, size: tuple[int, int], has_pose: bool = True) -> View:
    """Return the view of a model, up to `WITHIN_DEG` and to where its radius stops rising."""
    limit = _find_rising_limit(model.parameters)

    def project_within_limit(rays: FloatArray) -> FloatArray:
        return np.where(_is_within_limit(rays, limit)[:, None], pixels_of_rays(model.parameters, rays), np.nan)

    focal, center = model.parameters[:2], model.parameters[2:4]
    return lens_view(
        form,
        size=size,
        rotation=model.rotation,
        pixels_of_rays=project_within_limit,
        start=lambda pixels: (pixels - center) / focal,
        has_pose=has_pose,
    )


def pixels_of_rays(parameters: FloatArray, rays: FloatArray) -> FloatArray:
    """Return pixels (n, 2) of rays (n, 3) in the camera frame."""
    across = np.hypot(rays[:, 0], rays[:, 1])
    safe = np.where(across > 0.0, across, 1.0)
    u, v = (rays[:, :2] * (np.arctan2(across, rays[:, 2]) / safe)[:, None]).T
    k1, k2, p1, p2, k3, k4, sx, sy = parameters[4 : len(Fisheye)]
    square = u * u + v * v
    radial = 1.0 + square * (k1 + square * (k2 + square * (k3 + square * k4)))
    x = u * radial + 2.0 * p1 * u * v + p2 * (square + 2.0 * u * u) + sx * square
    y = v * radial + 2.0 * p2 * u * v + p1 * (square + 2.0 * v * v) + sy * square
    return np.stack([x, y], axis=-1) * parameters[:2] + parameters[2:4]


def _is_within_limit(rays: FloatArray, limit: float) -> BoolArray:
    return np.asarray(np.arctan2(np.hypot(rays[:, 0], rays[:, 1]), rays[:, 2]) <= limit)


def _find_rising_limit(parameters: FloatArray) -> float:
    theta = np.linspace(0.0, math.radians(WITHIN_DEG), _ANGLES)
    coefficients = np.zeros(10)
    coefficients[1::2] = 1.0, *parameters[list(RADIAL)]
    falls = np.diff(np.polynomial.polynomial.polyval(theta, coefficients)) <= 0.0
    return float(theta[np.argmax(falls)] if np.any(falls) else theta[-1])


_MATRIX = ("camera_matrix", "cameraMatrix", "Camera_Matrix", "K", "intrinsic_matrix")
_DISTORTION = ("distortion_coefficients", "distCoeffs", "Distortion_Coefficients", "D", "dist_coeffs")
_PUNCTUATION = re.compile(r'[][<>{},:"=]')
_NUMBER = r"[-+]?(?:\.Nan|\.Inf|(?:\d+\.?\d*|\.\d+)(?:e[-+]?\d+)?)(?= |$)"
_STORED_MATRIX = re.compile(
    r"(\w+) (?:type_id |!!)opencv-(?:nd-)?matrix (?:rows (\d{1,4} cols \d{1,4})|sizes (\d{1,4}(?: \d{1,4})*)) dt \w+ "
    rf"data((?: {_NUMBER})*)"
)
_STORED_NUMBER = re.compile(r"(\w+) (\d{1,9})\.?(?= |$)")
_SIZES = (("image_width", "image_height"), ("image_Width", "image_Height"), ("width", "height"))
_OPENCV_ROTATION = "rotation_cam_enu"


def opencv_yaml(model: FisheyeModel, *, width: int, height: int, notes: dict[str, str]) -> bytes:
    """Return the file of a model, with its notes."""
    storage = cv2.FileStorage(".yml", cv2.FILE_STORAGE_WRITE | cv2.FILE_STORAGE_MEMORY)
    for name, text in notes.items():
        storage.write(name, text)
    for name, size in (("image_width", width), ("image_height", height)):
        storage.write(name, size)
    storage.write("camera_matrix", model.matrix)
    storage.write("distortion_coefficients", model.distortion[:, None])
    storage.write(_OPENCV_ROTATION, model.rotation)
    text = str(storage.releaseAndGetString())
    return text.replace("\\'", "'").encode()  # OpenCV escapes an apostrophe, which YAML does not know


def read_opencv(content: bytes, *, name: str) -> View:
    """Return the view of a fisheye calibration, YAML, XML or JSON of `cv2.FileStorage`.

    Raises
    ------
    InputError
        It has not four distortion coefficients (a calibration of cv2.calibrateCamera has 5 and more), or no size.
    """
    try:
        matrices, numbers = _read_storage(content.decode())
    except UnicodeDecodeError:
        raise InputError(field=name, problem="is not text", remedy="give a cv2.FileStorage file") from None
    matrix, distortion, rotation = (
        next((matrices[one] for one in names if one in matrices), None)
        for names in (_MATRIX, _DISTORTION, (_OPENCV_ROTATION,))
    )
    sizes = [[numbers.get(one, 0) for one in pair] for pair in _SIZES]
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


def _read_storage(text: str) -> tuple[dict[str, FloatArray], dict[str, int]]:
    """Return the matrices and the whole numbers of a file of `cv2.FileStorage`, by their names.

    Its own reader ends the process on damaged files. Without their punctuation the three forms are one: words.
    """
    words = " ".join(word for word in _PUNCTUATION.sub(" ", text).split() if not word.startswith("/"))
    matrices: dict[str, FloatArray] = {}
    for name, shape, sizes, data in _STORED_MATRIX.findall(words):
        sides = [int(side) for side in (shape.replace("cols", "") or sizes).split()]
        values = [float(word.replace(".Nan", "nan").replace(".Inf", "inf")) for word in data.split()]
        if math.prod(sides) == len(values):
            matrices[name] = np.array(values).reshape(sides)
    return matrices, {name: int(number) for name, number in _STORED_NUMBER.findall(words)}


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
    return _add_comments(model, notes) + f"1 THIN_PRISM_FISHEYE {size[0]} {size[1]} {numbers}\n".encode()


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
    return _make_text_view("colmap", parameters, content, size)


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
    return _add_comments(model, notes) + ("\n".join(lines) + "\n").encode()


def read_ros(content: bytes, *, name: str) -> View:
    """Return the view of a camera_info whose distortion model is `equidistant` (or `fisheye`)."""
    yaml = extra_module("yaml", extra="formats")
    try:
        read = yaml.safe_load(content)
        size = (int(read["image_width"]), int(read["image_height"]))
        matrix = np.array(read["camera_matrix"]["data"], dtype=np.float64).reshape(3, 3)
        distortion = np.array(read["distortion_coefficients"]["data"], dtype=np.float64)
        kind = read["distortion_model"]
    except (yaml.YAMLError, KeyError, TypeError, ValueError, RecursionError) as error:
        raise InputError(field=name, problem=f"no camera_info ({error})", remedy="give ROS's YAML file") from None
    if kind not in ("equidistant", "fisheye") or distortion.shape != (4,):
        problem = f"distortion model {kind} with {distortion.size} coefficients"
        raise InputError(field=name, problem=problem, remedy="give one of the model equidistant, which has 4")
    parameters = np.zeros(len(Fisheye))
    parameters[:4] = matrix[0, 0], matrix[1, 1], matrix[0, 2], matrix[1, 2]
    parameters[list(RADIAL)] = distortion
    return _make_text_view("ros", parameters, content, size)


def _add_comments(model: FisheyeModel, notes: list[str]) -> bytes:
    rotation = " ".join(f"{value:.15g}" for value in model.rotation.ravel())
    return "".join(f"# {note}\n" for note in [*notes, _ROTATION + rotation]).encode()


def _make_text_view(form: str, parameters: FloatArray, content: bytes, size: tuple[int, int]) -> View:
    found = re.search(re.escape(_ROTATION.encode()) + rb"([^\n]+)", content)
    try:
        rotation = np.eye(3) if found is None else np.array(found.group(1).split(), dtype=np.float64).reshape(3, 3)
    except ValueError as error:
        raise InputError(field=form, problem=f"no rotation ({error})", remedy="write the file again") from None
    return fisheye_view(
        form, FisheyeModel(parameters=parameters, rotation=rotation), size=size, has_pose=found is not None
    )
