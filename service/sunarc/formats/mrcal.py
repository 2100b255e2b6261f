"""mrcal's camera model: a splined stereographic lens, which can follow any lens that rises.

Reference: D. Kogan, mrcal's documentation of LENSMODEL_SPLINED_STEREOGRAPHIC: u = 2 tan(θ/2) along the ray's direction
about the axis, moved by a cubic B-spline surface over u, then scaled by the focal lengths and shifted by the centre.
"""

from __future__ import annotations

import ast
import math
from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_array, kron, vstack
from scipy.sparse.linalg import spsolve

from sunarc.common.array_types import FloatArray
from sunarc.common.errors import InputError
from sunarc.formats.view import View, camera_sky, lens_view
from sunarc.optics.camera import Camera
from sunarc.optics.pose import rotation_matrix

_KNOTS = 40
_STIFFNESS = 1e-7
_MARGIN = math.radians(2.0)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SplinedModel:
    """mrcal's splined stereographic camera.

    Attributes
    ----------
    name : of the lens model, with its configuration.
    intrinsics : focal lengths, centre, control points (px, px, then in u).
    rotation_vector : rad, from east-north-up to the camera.
    """

    name: str
    intrinsics: FloatArray
    rotation_vector: tuple[float, float, float]


def splined_model(camera: Camera) -> SplinedModel:
    """Return mrcal's splined model that is closest to a camera; its pose is the camera's own."""
    sky = camera_sky(camera, within=camera.max_angle)
    fov_deg = min(math.ceil(2.0 * math.degrees(sky.within + _MARGIN)), 330)
    sign = -1.0 if camera.mirrored else 1.0
    focal = np.array([sign * camera.focal_length_px[0], camera.focal_length_px[1]])
    x0, y0 = camera.principal_point_px
    center = np.array([camera.width - 1.0 - x0 if camera.mirrored else x0, y0])
    u = 2.0 * sky.rays[:, :2] / (1.0 + sky.rays[:, 2:])
    design = spline_weights(u, _knot_density(fov_deg))
    displacement = (sky.pixels - center) / focal - u
    bending = spline_bending()
    # Control points beyond the image have no data: the third differences continue the surface smoothly.
    normal = (design.T @ design + _STIFFNESS * (bending.T @ bending)).tocsc()
    control = spsolve(normal, design.T @ displacement)
    return SplinedModel(
        name=f"LENSMODEL_SPLINED_STEREOGRAPHIC_order=3_Nx={_KNOTS}_Ny={_KNOTS}_fov_x_deg={fov_deg}",
        intrinsics=np.r_[focal, center, control.ravel()],
        rotation_vector=camera.rotation_cam_enu,
    )


def cameramodel(model: SplinedModel, camera: Camera, *, notes: list[str]) -> bytes:
    """Return mrcal's file; its reference frame is east-north-up."""
    listed = ", ".join(f"{value:.10g}" for value in model.intrinsics)
    rotation = ", ".join(f"{value:.12f}" for value in camera.rotation_cam_enu)
    return (
        "".join(f"# {note}\n" for note in notes)
        + "{\n"
        + f"    'lensmodel':  '{model.name}',\n\n"
        + "    # rotation vector and translation from east-north-up to the camera\n"
        + f"    'extrinsics': [ {rotation}, 0, 0, 0 ],\n\n"
        + f"    'intrinsics': [ {listed} ],\n\n"
        + f"    'imagersize': [ {camera.width}, {camera.height} ]\n"
        + "}\n"
    ).encode()


def splined_view(model: SplinedModel, *, size: tuple[int, int]) -> View:
    """Return the view of a model, up to the field of view that its name states."""
    focal, center, control = model.intrinsics[:2], model.intrinsics[2:4], model.intrinsics[4:].reshape(-1, 2)
    half = math.radians(_parse_field_deg(model.name)) / 2.0

    def project_within_field(rays: FloatArray) -> FloatArray:
        with np.errstate(all="ignore"):
            u = 2.0 * rays[:, :2] / (1.0 + rays[:, 2:])
        valid = np.hypot(u[:, 0], u[:, 1]) <= 2.0 * math.tan(half / 2.0)
        u = np.where(valid[:, None], u, 0.0)
        pixels = (u + spline_weights(u, _knot_density(_parse_field_deg(model.name))) @ control) * focal + center
        return np.where(valid[:, None], pixels, np.nan)

    return lens_view(
        "mrcal",
        size=size,
        rotation=rotation_matrix(model.rotation_vector),
        pixels_of_rays=project_within_field,
        start=lambda pixels: (pixels - center) / focal,
    )


def read_mrcal(content: bytes, *, name: str) -> View:
    """Return the view of a camera model of mrcal: splined as ours.

    Raises
    ------
    InputError
        It is no camera model, or one of another lens model.
    """
    try:
        read = ast.literal_eval(content.decode())
        lens, (width, height) = str(read["lensmodel"]), read["imagersize"]
        extrinsics, intrinsics = (np.array(read[key], dtype=np.float64) for key in ("extrinsics", "intrinsics"))
    except (ValueError, SyntaxError, KeyError, TypeError, OverflowError, RecursionError, MemoryError) as error:
        raise InputError(
            field=name, problem=f"no camera model of mrcal ({error})", remedy="give a .cameramodel"
        ) from None
    expected = f"LENSMODEL_SPLINED_STEREOGRAPHIC_order=3_Nx={_KNOTS}_Ny={_KNOTS}_fov_x_deg="
    if not lens.startswith(expected) or intrinsics.shape != (4 + 2 * _KNOTS**2,) or extrinsics.shape != (6,):
        raise InputError(
            field=name,
            problem=f"lens model {lens} with {intrinsics.size} intrinsics",
            remedy=f"convert it: mrcal-convert-lensmodel {expected}180 FILE",
        )
    x, y, z = extrinsics[:3].tolist()
    model = SplinedModel(name=lens, intrinsics=intrinsics, rotation_vector=(x, y, z))
    return splined_view(model, size=(int(width), int(height)))


def _knot_density(fov_deg: float) -> float:
    return (_KNOTS - 3) / (4.0 * math.tan(math.radians(fov_deg) / 4.0))


def _parse_field_deg(name: str) -> float:
    return float(name.rpartition("=")[2])


def spline_weights(u: FloatArray, knots_per_u: float) -> csr_array:
    """Return (n, knots²): the weight of every control point, the row of the image slowest."""
    # Four knots carry each place; just below the last but one, so that the fourth exists.
    position = np.clip(u * knots_per_u + (_KNOTS - 1) / 2.0, 1.0, _KNOTS - 2.0 - 1e-9)
    node = np.floor(position).astype(np.int64)
    s = position - node
    weights = (
        np.stack(
            [(1.0 - s) ** 3, 3.0 * s**3 - 6.0 * s**2 + 4.0, -3.0 * s**3 + 3.0 * s**2 + 3.0 * s + 1.0, s**3], axis=-1
        )
        / 6.0
    )
    columns = node[..., None] - 1 + np.arange(4)
    index = columns[:, 1, :, None] * _KNOTS + columns[:, 0, None, :]
    value = weights[:, 1, :, None] * weights[:, 0, None, :]
    count = len(u)
    row = np.broadcast_to(np.arange(count)[:, None, None], index.shape)
    return csr_array((value.ravel(), (row.ravel(), index.ravel())), shape=(count, _KNOTS**2))


def spline_bending() -> csr_array:
    """Return the regularisation of control points that no ray reaches: differences of the third order."""
    third = csr_array(np.diff(np.eye(_KNOTS), n=3, axis=0))
    identity = csr_array(np.eye(_KNOTS))
    return csr_array(vstack([kron(third, identity), kron(identity, third)]))
