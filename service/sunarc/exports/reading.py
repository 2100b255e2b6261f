"""Files of any format that is read, recognised by what they contain."""

from __future__ import annotations

import json
import math
from collections.abc import Callable

import numpy as np
from scipy.spatial.transform import Rotation

from sunarc.array_types import FloatArray
from sunarc.calibration.model.document import from_document
from sunarc.errors import InputError
from sunarc.exports.asi_core import mask_file, read_asi_core
from sunarc.exports.fisheye import read_colmap, read_opencv, read_ros
from sunarc.exports.mrcal import read_mrcal
from sunarc.exports.ocam import read_ocamcalib
from sunarc.exports.pixel_maps import read_fits, read_matlab, read_sixteen_bit
from sunarc.exports.remap import is_remap, read_remap
from sunarc.exports.tables import read_table
from sunarc.exports.view import Comparison, View, camera_view, compare
from sunarc.optics.camera import Camera, Param
from sunarc.optics.forward import project_with_jacobian
from sunarc.optics.pose import rotation_vector
from sunarc.optics.projections import Projection, ideal_radius

Beside = Callable[[str], bytes | None]
"""Returns a file that another one names, None where it is not there."""

READ_FORMATS = (
    "json",
    "opencv",
    "ocamcalib",
    "asi-core",
    "mrcal",
    "netcdf",
    "npz",
    "opencv-remap",
    "colmap",
    "ros",
    "fits",
    "matlab",
    "azimuth-zenith-png",
    "azimuth-zenith-jp2",
)

_BY_CONTENT: tuple[tuple[bytes, Callable[..., View]], ...] = (
    (b"internal_calibration", read_asi_core),
    (b"LENSMODEL_", read_mrcal),
    (b"distortion_model:", read_ros),
    (b"_FISHEYE ", read_colmap),
    (b"polynomial coefficients for the DIRECT mapping", read_ocamcalib),
    (b"%YAML", read_opencv),
    (b"opencv_storage", read_opencv),
    (b"<?xml", read_opencv),
)
_PROBED = 9
"""Pixels along a side that are asked for a direction: a fisheye shows some of them, whatever its field."""
_IMAGES = (b"\x89PNG", b"\x00\x00\x00\x0cjP  ")


def _read_npz(content: bytes, *, name: str) -> View:
    return (read_remap if is_remap(content) else read_table)(content, name=name)


_BY_START: tuple[tuple[bytes, Callable[..., View]], ...] = (
    (b"PK", _read_npz),
    (b"\x89HDF", read_table),
    (b"SIMPLE  =", read_fits),
    (b"MATLAB 5.0", read_matlab),
)


def read_view(content: bytes, *, name: str, beside: Beside = lambda _: None) -> View:
    """Return the view of a camera that a file of any format holds (`READ_FORMATS`).

    Raises
    ------
    InputError
        The format is unknown, the file is not what its format says, or no pixel of its image has a direction.
    """
    view = _view_of(content, name=name, beside=beside)
    across = [np.linspace(0.0, size - 1.0, _PROBED) for size in (view.width, view.height)]
    if not np.any(np.isfinite(view.unproject(np.stack(np.meshgrid(*across), axis=-1).reshape(-1, 2)))):
        raise InputError(
            field=name, problem="no pixel of its image has a direction", remedy="look for NaN among its numbers"
        )
    return view


def _view_of(content: bytes, *, name: str, beside: Beside) -> View:
    for start, read in _BY_START:
        if content.startswith(start):
            return read(content, name=name)
    if content.startswith(_IMAGES):
        return read_sixteen_bit(content, name=name, beside=beside)
    for mark, read in _BY_CONTENT:
        if mark in content:
            if read is read_asi_core:
                called = mask_file(content)
                return read_asi_core(content, name=name, mask=None if called is None else beside(called))
            return read(content, name=name)
    try:
        document = json.loads(content)
    except ValueError:
        known = ", ".join(READ_FORMATS)
        raise InputError(field=name, problem="of no format that is read", remedy=f"give one of {known}") from None
    return camera_view(from_document(document).camera)


_PROJECTIONS: tuple[Projection, ...] = ("equisolid", "equidistant", "stereographic")
_FITTED = [p for p in Param if p not in (Param.TRANSLATION_X, Param.TRANSLATION_Y, Param.TRANSLATION_Z)]
_GRID = 60
"""Pixels along a side that are compared: 3,600 for 20 parameters."""
_NEAR_AXIS = 0.2
"""Share of the image's shorter side about its centre in which the handedness and the scale are judged."""


def closest_camera(view: View, *, projection: Projection | None = None) -> tuple[Camera, Comparison]:
    """Return the camera that is closest to a view, and how far the view is from it.

    Parameters
    ----------
    view : of a file.
    projection : the ideal projection to use; the best one unless given.

    Raises
    ------
    InputError
        The view describes too few pixels to fit a camera to.
    """
    if view.camera is not None:
        return view.camera, compare(camera_view(view.camera), view)
    pixels, directions = _samples(view)
    fitted = [_fitted(view, pixels, directions, one) for one in ((projection,) if projection else _PROJECTIONS)]
    camera = min(fitted, key=lambda found: found[1])[0]
    return camera, compare(camera_view(camera), view)


def _samples(view: View) -> tuple[FloatArray, FloatArray]:
    """Return pixels (n, 2) over the image and their directions (n, 3)."""
    x, y = (np.linspace(0.0, size - 1.0, _GRID) for size in (view.width, view.height))
    pixels = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
    directions = view.unproject(pixels)
    valid = np.isfinite(directions[:, 0])
    if np.sum(valid) < 2 * len(_FITTED):
        raise InputError(
            field=view.form, problem="it describes hardly any pixel of its image", remedy="give a whole calibration"
        )
    return pixels[valid], directions[valid]


def _fitted(view: View, pixels: FloatArray, directions: FloatArray, projection: Projection) -> tuple[Camera, float]:
    """Return the closest camera of a projection, and the sum of its squared residuals in px²."""
    start = _ideal(view, pixels, directions, projection)
    vector, scale = start.to_vector(), 1.0 / np.maximum(np.abs(start.to_vector()[_FITTED]), 1.0)

    def parameters_of(moving: FloatArray) -> Camera:
        vector[_FITTED] = moving
        return start.with_parameters(vector)

    def residuals(moving: FloatArray) -> FloatArray:
        found = project_with_jacobian(parameters_of(moving), directions)[0]
        return np.nan_to_num(found - pixels).ravel()

    def jacobian(moving: FloatArray) -> FloatArray:
        rows = project_with_jacobian(parameters_of(moving), directions)[1][..., _FITTED]
        return np.nan_to_num(rows).reshape(-1, len(_FITTED))

    from scipy.optimize import least_squares  # noqa: PLC0415 - the service starts sooner without it

    best = least_squares(residuals, vector[_FITTED], jacobian, x_scale=1.0 / scale, method="lm")
    return parameters_of(best.x), 2.0 * float(best.cost)


def _ideal(view: View, pixels: FloatArray, directions: FloatArray, projection: Projection) -> Camera:
    """Return the ideal lens about the image's centre, with the handedness that fits there."""
    center = np.array([view.width - 1.0, view.height - 1.0]) / 2.0
    off = pixels - center
    near = np.linalg.norm(off, axis=-1) < _NEAR_AXIS * min(view.width, view.height)
    axis = directions[np.argmin(np.linalg.norm(off, axis=-1))]
    angle = np.arccos(np.clip(directions @ axis, -1.0, 1.0))
    radius = np.linalg.norm(off, axis=-1)
    scale = ideal_radius(projection, np.minimum(angle, math.pi / 2))
    focal = float(np.sum(radius[near] * scale[near]) / np.sum(scale[near] ** 2))
    tried = []
    for mirrored in (False, True):
        x = -off[near, 0] if mirrored else off[near, 0]
        rays = np.column_stack([x, off[near, 1], np.zeros(np.sum(near))])
        rays *= (np.sin(angle[near]) / np.maximum(radius[near], 1e-9))[:, None]
        rays[:, 2] = np.cos(angle[near])
        rotation, loss = Rotation.align_vectors(rays, directions[near])[:2]
        tried.append((loss, mirrored, rotation))
    _, mirrored, rotation = min(tried, key=lambda one: one[0])
    turn = rotation_vector(rotation.as_matrix())
    return Camera(
        width=view.width,
        height=view.height,
        projection=projection,
        focal_length_px=(focal, focal),
        principal_point_px=(float(center[0]), float(center[1])),
        rotation_cam_enu=turn,
        mirrored=mirrored,
        max_angle=math.radians(120.0),
    )
