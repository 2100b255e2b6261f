"""View of a camera by a file, directions to pixels and pixels to directions; difference of two cameras."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from sunarc.calibration.answers.covariance import hemisphere
from sunarc.calibration.model.result import Calibration
from sunarc.common.array_types import FloatArray, IntArray
from sunarc.common.errors import InputError
from sunarc.optics.camera import Camera, Param, camera_sees
from sunarc.optics.forward import project, project_with_jacobian, rising_limit
from sunarc.optics.inverse import unproject
from sunarc.optics.pose import rotation_matrix, rotation_vector
from sunarc.optics.projections import Projection, ideal_radius

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
    """Camera as a file describes it: functions from directions to pixels and back.

    Attributes
    ----------
    form : the format's name.
    width, height : image size, px.
    project : (n, 3) unit vectors, east-north-up, to (n, 2) pixels; NaN where the file has none.
    unproject : (n, 2) pixels to (n, 3) unit vectors; NaN where the file has none.
    camera : the model itself, where the file is a calibration document.
    document, calibration : that document, and the calibration that it holds.
    has_pose : whether the file says how the camera stands; without, its frame (x right, y down, z out of the lens) is
        taken for east-north-up.
    sigma_limit_deg : of a provisional calibration, the 1-sigma up to which it answers.
    """

    form: str
    width: int
    height: int
    project: Convert
    unproject: Convert
    camera: Camera | None = None
    document: dict[str, Any] | None = None
    calibration: Calibration | None = None
    has_pose: bool = True
    sigma_limit_deg: float | None = None


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
        document=None,
        calibration=None,
    )


def lens_view(
    form: str,
    *,
    size: tuple[int, int],
    rotation: FloatArray,
    pixels_of_rays: Convert,
    start: Convert,
    has_pose: bool = True,
) -> View:
    """Return the view of a model that is given from rays to pixels; the other way is solved by Newton's method.

    Parameters
    ----------
    form, size : name of the format; width and height.
    rotation : (3, 3) from east-north-up to the camera; the identity where the file has no pose.
    pixels_of_rays : (n, 3) rays in the camera frame to (n, 2) px.
    start : (n, 2) px to where the solution starts, (n, 2) in the stereographic plane, whose radius is 2 tan(θ/2).
    has_pose : whether the file has one.
    """
    return View(
        form=form,
        width=size[0],
        height=size[1],
        project=lambda directions: pixels_of_rays(directions @ rotation.T),
        unproject=lambda pixels: _solve_rays(pixels_of_rays, pixels, start(pixels)) @ rotation,
        has_pose=has_pose,
    )


def _solve_rays(pixels_of_rays: Convert, pixels: FloatArray, start: FloatArray) -> FloatArray:
    """Return (n, 3) rays that land on pixels (n, 2), from a start (n, 2) in the stereographic plane."""
    u = start
    with np.errstate(all="ignore"):  # beyond the model's field there is no solution: NaN
        for _ in range(_ITERATIONS):
            off = pixels_of_rays(_stereographic_ray(u)) - pixels
            columns = [
                (pixels_of_rays(_stereographic_ray(u + step)) - pixels - off) / _STEP_U for step in np.eye(2) * _STEP_U
            ]
            u = u - _solve_two_by_two(np.stack(columns, axis=-1), off)
        rays = _stereographic_ray(u)
        solved = np.linalg.norm(pixels_of_rays(rays) - pixels, axis=-1) < _SAME_PX
    return np.where(solved[:, None], rays, np.nan)


def _stereographic_ray(u: FloatArray) -> FloatArray:
    """Return (n, 3) unit vectors of (n, 2) places 2 tan(θ/2) from the axis."""
    quarter = 0.25 * np.sum(u**2, axis=-1, keepdims=True)
    return np.asarray(np.concatenate([u, 1.0 - quarter], axis=-1) / (1.0 + quarter))


def _solve_two_by_two(matrix: FloatArray, right: FloatArray) -> FloatArray:
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

    def interpolate_directions(pixels: FloatArray) -> FloatArray:
        inside = np.all((pixels >= -0.5) & (pixels <= np.array(size) - 0.5), axis=-1)
        found = np.where(inside[:, None], between(pixels[:, ::-1]), np.nan)
        return np.asarray(found / np.linalg.norm(found, axis=-1, keepdims=True))

    return View(
        form=form,
        width=size[0],
        height=size[1],
        project=lambda wanted: _search_pixels(interpolate_directions, wanted, nodes=_select_nodes(x, y, directions)),
        unproject=interpolate_directions,
    )


def _select_nodes(x: IntArray, y: IntArray, directions: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return some of a map's nodes that have a direction: pixels (n, 2) and directions (n, 3)."""
    step = max(1, round((directions[..., 0].size / _START_NODES) ** 0.5))
    some = directions[::step, ::step]
    pixels = np.stack(np.meshgrid(x[::step], y[::step]), axis=-1).astype(np.float64)
    valid = np.isfinite(some[..., 0])
    return pixels[valid], np.asarray(some[valid], dtype=np.float64)


def _search_pixels(looked_at: Convert, wanted: FloatArray, *, nodes: tuple[FloatArray, FloatArray]) -> FloatArray:
    """Return the pixels (n, 2) of a map whose directions are (n, 3)."""
    from scipy.spatial import cKDTree  # noqa: PLC0415 - the service starts sooner without it

    pixels = nodes[0][cKDTree(nodes[1]).query(wanted)[1]]
    with np.errstate(all="ignore"):
        for _ in range(_ITERATIONS):
            here = looked_at(pixels)
            columns = [(looked_at(pixels + step) - here) / _STEP_PX for step in np.eye(2) * _STEP_PX]
            jacobian = np.stack(columns, axis=-1)
            normal = np.swapaxes(jacobian, -1, -2)
            pixels = pixels + _solve_two_by_two(normal @ jacobian, (normal @ (wanted - here)[..., None])[..., 0])
        apart = np.linalg.norm(looked_at(pixels) - wanted, axis=-1)
    return np.where((apart < 1e-6)[:, None], pixels, np.nan)


ZENITH_RANGES_DEG = ((0.0, 30.0), (30.0, 60.0), (60.0, 80.0), (80.0, 90.0))
_COMPARED_DIRECTIONS = 5003
"""Directions that are compared. Not the number of those that a model is fitted to (see `sky`): other directions."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Differences:
    """Statistics of the differences between two cameras.

    Attributes
    ----------
    n : how many directions.
    rms_px, max_px : from a direction to its pixel.
    rms_deg, max_deg : from a pixel to its direction.
    """

    n: int
    rms_px: float
    max_px: float
    rms_deg: float
    max_deg: float


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Comparison:
    """Difference of a second camera from a first one, over the sky in the first one's image.

    Attributes
    ----------
    total : over all of it that the second one describes.
    by_zenith : in `ZENITH_RANGES_DEG`; n = 0 and NaN where the image has none.
    undescribed : share of the sky for which the second one has no pixel or no direction.
    described_to_deg : smallest zenith angle of such a direction; 90 without one.
    rotation_deg : angle of the rotation that brings the second one's directions closest to the first one's.
    rotation_vector_deg : the same as a vector: about east, north and up.
    rms_rotated_deg : of the differences that are left by that rotation.
    directions : (n, 3) those compared, east-north-up.
    off_px : (n, 2) second pixel minus first one; NaN where undescribed.
    off_deg : (n,) angle between the directions; NaN where undescribed.
    """

    total: Differences
    by_zenith: tuple[Differences, ...]
    undescribed: float
    described_to_deg: float
    rotation_deg: float
    rotation_vector_deg: tuple[float, float, float]
    rms_rotated_deg: float
    directions: FloatArray
    off_px: FloatArray
    off_deg: FloatArray

    def __str__(self) -> str:
        """Return the comparison in one sentence."""
        ranges = ", ".join(
            f"{low:.0f}-{high:.0f}: {one.rms_px:.2g} px ({one.rms_deg:.2g})"
            for (low, high), one in zip(ZENITH_RANGES_DEG, self.by_zenith, strict=True)
            if one.n
        )
        total = self.total
        beyond = (
            ""
            if self.undescribed == 0.0
            else f"; the format cannot describe {100.0 * self.undescribed:.2g} % of the sky in the image, from "
            f"{self.described_to_deg:.1f} degrees of zenith angle on"
        )
        return (
            f"differs from the calibration by {total.rms_px:.2g} px RMS and {total.max_px:.2g} px at most from a "
            f"direction to a pixel, by {total.rms_deg:.2g} degrees RMS and {total.max_deg:.2g} degrees at most from a "
            f"pixel to a direction, over the sky in the image; RMS by degrees of zenith angle {ranges}{beyond}"
        )


def compare(first: View, second: View) -> Comparison:
    """Return the differences in direction and in pixel position between two cameras.

    Where one of the two has no pose, the second one is rotated to fit best before.

    Raises
    ------
    InputError
        The images are of different sizes, or nothing of the sky is described by both.
    """
    if (first.width, first.height) != (second.width, second.height):
        raise InputError(
            field="image size",
            problem=f"{first.width}x{first.height} and {second.width}x{second.height}",
            remedy="compare calibrations of images of one size",
        )
    directions = hemisphere(_COMPARED_DIRECTIONS)
    pixels = first.project(directions)
    inside = np.all((pixels >= -0.5) & (pixels <= np.array([first.width, first.height]) - 0.5), axis=-1)
    directions, pixels = directions[inside], pixels[inside]
    here = first.unproject(pixels)
    rotation = _best_rotation(here, second.unproject(pixels))
    if not (first.has_pose and second.has_pose):
        second = rotated(second, rotation)
    there = second.unproject(pixels)
    off_px = second.project(directions) - pixels
    off_deg = _angle_deg(here, there)
    described = np.isfinite(off_px[:, 0]) & np.isfinite(off_deg)
    off_px[~described], off_deg[~described] = np.nan, np.nan
    left = _angle_deg(here, there @ _best_rotation(here, there).T)[described]
    zenith_deg = np.degrees(np.arccos(np.clip(directions[:, 2], -1.0, 1.0)))
    vector = np.degrees(rotation_vector(rotation))
    return Comparison(
        total=_summarise_differences(off_px, off_deg, described),
        by_zenith=tuple(
            _summarise_differences(off_px, off_deg, described & (zenith_deg >= low) & (zenith_deg < high))
            for low, high in ZENITH_RANGES_DEG
        ),
        undescribed=float(np.mean(~described)),
        described_to_deg=float(np.min(zenith_deg[~described], initial=90.0)),
        rotation_deg=float(np.linalg.norm(vector)),
        rotation_vector_deg=(float(vector[0]), float(vector[1]), float(vector[2])),
        rms_rotated_deg=float(np.sqrt(np.mean(left**2))),
        directions=directions,
        off_px=off_px,
        off_deg=off_deg,
    )


def _summarise_differences(off_px: FloatArray, off_deg: FloatArray, which: np.typing.NDArray[np.bool_]) -> Differences:
    n = int(np.sum(which))
    if n == 0:
        return Differences(n=0, rms_px=math.nan, max_px=math.nan, rms_deg=math.nan, max_deg=math.nan)
    px, deg = np.linalg.norm(off_px[which], axis=-1), off_deg[which]
    return Differences(
        n=n,
        rms_px=float(np.sqrt(np.mean(px**2))),
        max_px=float(np.max(px)),
        rms_deg=float(np.sqrt(np.mean(deg**2))),
        max_deg=float(np.max(deg)),
    )


def _best_rotation(first: FloatArray, second: FloatArray) -> FloatArray:
    """Return the (3, 3) rotation that takes the second directions (n, 3) closest to the first ones (Kabsch's)."""
    both = np.isfinite(first[:, 0]) & np.isfinite(second[:, 0])
    if np.sum(both) < 3:
        raise InputError(
            field="comparison", problem="no direction of the sky is in both", remedy="compare two whole calibrations"
        )
    from scipy.spatial.transform import Rotation  # noqa: PLC0415 - a fit loads without it

    return np.asarray(Rotation.align_vectors(first[both], second[both])[0].as_matrix())


def _angle_deg(first: FloatArray, second: FloatArray) -> FloatArray:
    """Return the angles between unit vectors (n, 3); the half chord is exact where they are close."""
    half = 0.5 * np.linalg.norm(first - second, axis=-1)
    return np.asarray(np.degrees(2.0 * np.arcsin(np.minimum(half, 1.0))))


_FITTED_DIRECTIONS = 4000


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Sky:
    """Rays spread evenly over the lens's field, and their pixels.

    Attributes
    ----------
    within : radians off the axis that they reach to.
    rays : (n, 3) unit vectors in the camera frame.
    pixels : (n, 2) where our model puts them, all in the image.
    """

    within: float
    rays: FloatArray
    pixels: FloatArray


def camera_sky(camera: Camera, *, within: float) -> Sky:
    """Return a camera's sky, up to an angle in radians off its axis."""
    limit = min(within, rising_limit(camera, up_to=camera.max_angle))
    rays = hemisphere(_FITTED_DIRECTIONS)
    cosine = 1.0 - (1.0 - rays[:, 2]) * (1.0 - math.cos(limit))  # the hemisphere, stretched over the cap
    across = np.sqrt((1.0 - cosine**2) / (1.0 - rays[:, 2] ** 2))
    rays = np.stack([rays[:, 0] * across, rays[:, 1] * across, cosine], axis=-1)
    pixels = project(camera, rays @ rotation_matrix(camera.rotation_cam_enu))
    inside = camera_sees(camera, pixels)
    return Sky(within=limit, rays=rays[inside], pixels=pixels[inside])


# The camera of ours that is closest to a view.

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
    pixels, directions = _sample_view(view)
    fitted = [_fit_projection(view, pixels, directions, one) for one in ((projection,) if projection else _PROJECTIONS)]
    camera = min(fitted, key=lambda found: found[1])[0]
    return camera, compare(camera_view(camera), view)


def _sample_view(view: View) -> tuple[FloatArray, FloatArray]:
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


def _fit_projection(
    view: View, pixels: FloatArray, directions: FloatArray, projection: Projection
) -> tuple[Camera, float]:
    """Return the closest camera of a projection, and the sum of its squared residuals in px²."""
    start = _make_ideal_lens(view, pixels, directions, projection)
    vector, scale = start.to_vector(), 1.0 / np.maximum(np.abs(start.to_vector()[_FITTED]), 1.0)

    def make_camera(moving: FloatArray) -> Camera:
        vector[_FITTED] = moving
        return start.replace_parameters(vector)

    def residuals(moving: FloatArray) -> FloatArray:
        found = project_with_jacobian(make_camera(moving), directions)[0]
        return np.nan_to_num(found - pixels).ravel()

    def jacobian(moving: FloatArray) -> FloatArray:
        rows = project_with_jacobian(make_camera(moving), directions)[1][..., _FITTED]
        return np.nan_to_num(rows).reshape(-1, len(_FITTED))

    from scipy.optimize import least_squares  # noqa: PLC0415 - the service starts sooner without it

    best = least_squares(residuals, vector[_FITTED], jacobian, x_scale=1.0 / scale, method="lm")
    return make_camera(best.x), 2.0 * float(best.cost)


def _make_ideal_lens(view: View, pixels: FloatArray, directions: FloatArray, projection: Projection) -> Camera:
    """Return the ideal lens about the image's centre, with the handedness that fits there."""
    center = np.array([view.width - 1.0, view.height - 1.0]) / 2.0
    off = pixels - center
    near = np.linalg.norm(off, axis=-1) < _NEAR_AXIS * min(view.width, view.height)
    axis = directions[np.argmin(np.linalg.norm(off, axis=-1))]
    angle = np.arccos(np.clip(directions @ axis, -1.0, 1.0))
    radius = np.linalg.norm(off, axis=-1)
    scale = ideal_radius(projection, np.minimum(angle, math.pi / 2))
    focal = float(np.sum(radius[near] * scale[near]) / np.sum(scale[near] ** 2))
    from scipy.spatial.transform import Rotation  # noqa: PLC0415 - a fit loads without it

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
