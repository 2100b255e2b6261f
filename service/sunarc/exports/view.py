"""What a file of any format says of a camera: directions to pixels and pixels to directions."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from sunarc.array_types import FloatArray, IntArray
from sunarc.optics.camera import Camera
from sunarc.optics.forward import project
from sunarc.optics.inverse import unproject

Convert = Callable[[FloatArray], FloatArray]

_ITERATIONS = 12
_STEP_U = 1e-6
"""Of a difference quotient in the stereographic plane, where a lens is 1e-6 of its focal length: 1e-3 px."""
_STEP_PX = 0.25
"""Of a difference quotient in a map: within one cell, where it is smooth."""
_SAME_PX = 1e-4
_START_NODES = 40_000
"""Nodes of a map among which a direction's nearest is looked for: a few px apart, from where Newton converges."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class View:
    """A camera as a file describes it.

    Attributes
    ----------
    form : the format's name.
    width, height : image size, px.
    project : (n, 3) unit vectors, east-north-up, to (n, 2) pixels; NaN where the file has none.
    unproject : (n, 2) pixels to (n, 3) unit vectors; NaN where the file has none.
    camera : the model itself, where the file is a calibration document.
    has_pose : whether the file says how the camera stands; without, its frame (x right, y down, z out of the lens) is
        taken for east-north-up.
    """

    form: str
    width: int
    height: int
    project: Convert
    unproject: Convert
    camera: Camera | None = None
    has_pose: bool = True


def camera_view(camera: Camera) -> View:
    """Return the view of our own model."""
    return View(
        form="json",
        width=camera.width,
        height=camera.height,
        project=lambda directions: project(camera, directions),
        unproject=lambda pixels: unproject(camera, pixels),
        camera=camera,
    )


def rotated(view: View, rotation: FloatArray) -> View:
    """Return a view whose directions are rotated: `rotation` (3, 3) takes those of the view to the new ones."""
    return replace(
        view,
        project=lambda directions: view.project(directions @ rotation),
        unproject=lambda pixels: view.unproject(pixels) @ rotation.T,
        camera=None,
    )


def lens_view(
    form: str,
    *,
    size: tuple[int, int],
    rotation: FloatArray,
    pixels_of_rays: Convert,
    center: FloatArray,
    focal: FloatArray,
    has_pose: bool = True,
) -> View:
    """Return the view of a model that is given from rays to pixels; the other way is solved by Newton's method.

    Parameters
    ----------
    form, size : name of the format; width and height.
    rotation : (3, 3) from east-north-up to the camera; the identity where the file has no pose.
    pixels_of_rays : (n, 3) rays in the camera frame to (n, 2) px.
    center, focal : (2,) px, where and at what scale the solution starts: 2 tan(θ/2) times `focal` from `center`.
    has_pose : whether the file has one.
    """
    return View(
        form=form,
        width=size[0],
        height=size[1],
        project=lambda directions: pixels_of_rays(directions @ rotation.T),
        unproject=lambda pixels: _rays(pixels_of_rays, pixels, (pixels - center) / focal) @ rotation,
        has_pose=has_pose,
    )


def _rays(pixels_of_rays: Convert, pixels: FloatArray, start: FloatArray) -> FloatArray:
    """Return (n, 3) rays that land on pixels (n, 2), from a start (n, 2) in the stereographic plane."""
    u = start
    with np.errstate(all="ignore"):  # beyond the model's field there is no solution: NaN
        for _ in range(_ITERATIONS):
            off = pixels_of_rays(_stereographic_ray(u)) - pixels
            columns = [
                (pixels_of_rays(_stereographic_ray(u + step)) - pixels - off) / _STEP_U for step in np.eye(2) * _STEP_U
            ]
            u = u - _solved(np.stack(columns, axis=-1), off)
        rays = _stereographic_ray(u)
        solved = np.linalg.norm(pixels_of_rays(rays) - pixels, axis=-1) < _SAME_PX
    return np.where(solved[:, None], rays, np.nan)


def _stereographic_ray(u: FloatArray) -> FloatArray:
    """Return (n, 3) unit vectors of (n, 2) places 2 tan(θ/2) from the axis."""
    quarter = 0.25 * np.sum(u**2, axis=-1, keepdims=True)
    return np.asarray(np.concatenate([u, 1.0 - quarter], axis=-1) / (1.0 + quarter))


def _solved(matrix: FloatArray, right: FloatArray) -> FloatArray:
    """Return the solutions of (n, 2, 2) systems; not finite where one has none."""
    (a, b), (c, d) = np.moveaxis(matrix, 0, -1)
    x, y = right.T
    return np.asarray(np.stack([d * x - b * y, a * y - c * x], axis=-1) / (a * d - b * c)[:, None])


def grid_view(form: str, *, size: tuple[int, int], x: IntArray, y: IntArray, directions: FloatArray) -> View:
    """Return the view of a map: unit vectors, interpolated bilinearly and made unit again.

    Parameters
    ----------
    form, size : name of the format; width and height.
    x, y : (columns,), (rows,) px, rising.
    directions : (rows, columns, 3) unit vectors, east-north-up; NaN outside the field.
    """
    from scipy.interpolate import RegularGridInterpolator  # noqa: PLC0415 - the service starts sooner without it

    between = RegularGridInterpolator((y, x), directions, bounds_error=False, fill_value=None)

    def looked_at(pixels: FloatArray) -> FloatArray:
        inside = np.all((pixels >= -0.5) & (pixels <= np.array(size) - 0.5), axis=-1)
        found = np.where(inside[:, None], between(pixels[:, ::-1]), np.nan)
        return np.asarray(found / np.linalg.norm(found, axis=-1, keepdims=True))

    return View(
        form=form,
        width=size[0],
        height=size[1],
        project=lambda wanted: _pixels(looked_at, wanted, nodes=_nodes(x, y, directions)),
        unproject=looked_at,
    )


def _nodes(x: IntArray, y: IntArray, directions: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return some of a map's nodes that have a direction: pixels (n, 2) and directions (n, 3)."""
    step = max(1, round((directions[..., 0].size / _START_NODES) ** 0.5))
    some = directions[::step, ::step]
    pixels = np.stack(np.meshgrid(x[::step], y[::step]), axis=-1).astype(np.float64)
    valid = np.isfinite(some[..., 0])
    return pixels[valid], np.asarray(some[valid], dtype=np.float64)


def _pixels(looked_at: Convert, wanted: FloatArray, *, nodes: tuple[FloatArray, FloatArray]) -> FloatArray:
    """Return the pixels (n, 2) of a map that look at directions (n, 3)."""
    from scipy.spatial import cKDTree  # noqa: PLC0415 - the service starts sooner without it

    pixels = nodes[0][cKDTree(nodes[1]).query(wanted)[1]]
    with np.errstate(all="ignore"):
        for _ in range(_ITERATIONS):
            here = looked_at(pixels)
            columns = [(looked_at(pixels + step) - here) / _STEP_PX for step in np.eye(2) * _STEP_PX]
            jacobian = np.stack(columns, axis=-1)
            normal = np.swapaxes(jacobian, -1, -2)
            pixels = pixels + _solved(normal @ jacobian, (normal @ (wanted - here)[..., None])[..., 0])
        apart = np.linalg.norm(looked_at(pixels) - wanted, axis=-1)
    return np.where((apart < 1e-6)[:, None], pixels, np.nan)
