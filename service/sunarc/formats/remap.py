"""Tables that remap an image to a grid, as `cv2.remap` takes them: the sky, or the ground under a cloud layer."""

from __future__ import annotations

import io
import json
import math
import zlib
from collections.abc import Mapping
from typing import Any, Literal
from zipfile import BadZipFile

import cv2
import numpy as np
from numpy.typing import NDArray

from sunarc.common.array_types import FloatArray, Image
from sunarc.common.errors import InputError
from sunarc.formats.exported import Table, Variable
from sunarc.formats.view import View, lens_view
from sunarc.optics.camera import Camera
from sunarc.optics.forward import project

Grid = Literal["sky", "ground"]

_LARGEST_ZENITH = math.radians(78.0)
"""Out to which a ground grid reaches unless said: as far as forecasting software looks."""
_NOTHING = -0.5
"""Coordinates below this are the -1 of cells outside the image."""
_EARTH_RADIUS_M = 6_371_008.8
"""Mean radius of the earth (IUGG), m."""
_RIGHT_ANGLE_DEG = 90.0
_EAST_AT_LEFT = "at the top, east at the left"
"""Attribute `north` of tables of the sky; those of versions to 0.3 have east at the right."""


def sky_grid(size: int) -> FloatArray:
    """Return the directions (size, size, 3) of an equidistant map of the sky; NaN beyond the horizon.

    North is at the top and east at the left, as in a picture of the sky from below. The zenith is at (size - 1) / 2,
    the horizon size / 2 from it.
    """
    across = (np.arange(size) - (size - 1) / 2.0) / (size / 2.0)
    east, north = np.meshgrid(-across, -across)
    zenith = np.hypot(east, north) * (math.pi / 2.0)
    scale = np.sinc(zenith / math.pi) * (math.pi / 2.0)  # sin(zenith) / radius
    directions = np.stack([east * scale, north * scale, np.cos(zenith)], axis=-1)
    directions[zenith > math.pi / 2.0] = np.nan
    return np.asarray(directions)


def ground_grid(size: int, *, half_width_m: float, height_m: float) -> FloatArray:
    """Return the directions (size, size, 3) from the camera to points of a cloud layer above a grid on the ground.

    Parameters
    ----------
    size : points along a side; north at the top, east at the right, the camera in the middle.
    half_width_m : from the camera to the outermost points, m along the ground.
    height_m : of the layer above the camera, m; it follows the earth's curvature (a sphere).
    """
    across = np.linspace(-half_width_m, half_width_m, size)
    east, north = np.meshgrid(across, -across)
    angle = np.hypot(east, north) / _EARTH_RADIUS_M
    radius = _EARTH_RADIUS_M + height_m
    outward = radius * np.sinc(angle / math.pi) / _EARTH_RADIUS_M  # radius * sin(angle) over the distance
    up = radius * np.cos(angle) - _EARTH_RADIUS_M
    directions = np.stack([east * outward, north * outward, up], axis=-1)
    directions[up <= 0.0] = np.nan
    return np.asarray(directions / np.linalg.norm(directions, axis=-1, keepdims=True))


def reach_m(height_m: float) -> float:
    """Return the reach of a ground grid unless it is stated, m: up to 78 degrees of zenith angle at a height."""
    return height_m * math.tan(_LARGEST_ZENITH)


def grid_directions(grid: Grid, size: int, *, half_width_m: float, height_m: float) -> FloatArray:
    """Return the directions (size, size, 3) of `sky_grid` or of `ground_grid`, by name."""
    return sky_grid(size) if grid == "sky" else ground_grid(size, half_width_m=half_width_m, height_m=height_m)


def remapped(image: Image, map_x: NDArray[Any], map_y: NDArray[Any]) -> Image:
    """Return an image taken to a grid by its tables, interpolated bilinearly; 0 where the image has nothing."""
    # Half a pixel beyond the image belongs to its outermost pixels; the rest of the border stays 0.
    found = cv2.remap(image, map_x, map_y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    found[map_x < _NOTHING] = 0
    return found.astype(np.uint8) if image.dtype == np.uint8 else found.astype(np.uint16)


def remap_tables(camera: Camera, directions: FloatArray) -> tuple[NDArray[np.floating[Any]], NDArray[np.floating[Any]]]:
    """Return map_x and map_y of `cv2.remap`, (rows, columns), single precision; -1 where the image has nothing."""
    pixels = project(camera, directions)
    limits = np.array([camera.width, camera.height]) - 0.5
    with np.errstate(invalid="ignore"):
        inside = np.all((pixels >= -0.5) & (pixels <= limits), axis=-1)
    filled = np.where(inside[..., None], pixels, -1.0).astype(np.float32)
    return filled[..., 0], filled[..., 1]


def remap_table(
    camera: Camera,
    directions: FloatArray,
    *,
    grid: Grid,
    attributes: Mapping[str, Any],
    half_width_m: float = 0.0,
    place: tuple[float, float] | None = None,
) -> Table:
    """Return map_x and map_y of a grid's directions (size, size, 3), with the attributes of grid and image.

    Parameters
    ----------
    camera, directions, grid : of the image, of the grid, and which grid it is.
    attributes : of the whole, in addition to its own.
    half_width_m : of a ground grid, m.
    place : latitude and longitude of the camera, degrees: the origin of a ground grid's coordinates.
    """
    described = {"units": "1", "long_name": "coordinate in px in the image; -1 where the image has nothing"}
    side = _EAST_AT_LEFT if grid == "sky" else "at the top, east at the right"
    said = {"grid": grid, "north": side, "image_size": [camera.width, camera.height]}
    if place is not None:
        described["grid_mapping"] = "crs"
    tables = zip(("map_x", "map_y"), remap_tables(camera, directions), strict=True)
    arrays = {n: Variable(dimensions=("y", "x"), values=v, attributes=described) for n, v in tables}
    return Table(
        variables=arrays | _make_cell_coordinates(len(directions), half_width_m, place),
        attributes={"Conventions": "CF-1.11", "title": f"Tables for cv2.remap: {grid} grid", **said, **attributes},
    )


def _make_cell_coordinates(size: int, half_width_m: float, place: tuple[float, float] | None) -> dict[str, Variable]:
    """Return x, y of the cells: m on a sphere about the camera for a ground grid, else degrees of zenith angle."""
    across = (np.arange(size) - (size - 1) / 2.0) / (size / 2.0) * _RIGHT_ANGLE_DEG
    named = [{"units": "degree", "long_name": f"zenith angle towards the {side}"} for side in ("east", "north")]
    eastwards = -across
    crs: dict[str, Variable] = {}
    if place is not None:
        eastwards = across = np.linspace(-half_width_m, half_width_m, size)
        named = [
            {"units": "m", "standard_name": f"projection_{axis}_coordinate", "long_name": f"{side} of the camera"}
            for axis, side in (("x", "east"), ("y", "north"))
        ]
        mapping = {
            "grid_mapping_name": "azimuthal_equidistant",
            "latitude_of_projection_origin": place[0],
            "longitude_of_projection_origin": place[1],
            "false_easting": 0.0,
            "false_northing": 0.0,
            "earth_radius": _EARTH_RADIUS_M,
        }
        crs = {"crs": Variable(dimensions=(), values=np.array(0, dtype=np.int32), attributes=mapping)}
    x, y = (
        Variable(dimensions=(name,), values=values, attributes={"axis": name.upper(), **attributes})
        for name, values, attributes in zip("xy", (eastwards, -across), named, strict=True)
    )
    return {"x": x, "y": y, **crs}


def is_remap(content: bytes) -> bool:
    """Return whether an npz file holds remap tables."""
    return b"map_x.npy" in content


def read_remap(content: bytes, *, name: str) -> View:
    """Return the view of remap tables of the sky, interpolated bilinearly."""
    try:
        with np.load(io.BytesIO(content), allow_pickle=False) as file:
            tables = np.stack([file["map_x"], file["map_y"]], axis=-1).astype(np.float64)
            said: Mapping[str, Any] = json.loads(str(file["attributes"]))["attributes"]
        width, height = (int(value) for value in said["image_size"])
        size = tables.shape[0]
        if said["grid"] != "sky" or tables.shape != (size, size, 2):
            raise ValueError("its grid is not the sky")  # noqa: TRY301 - one message for all that is wrong
    except (KeyError, ValueError, TypeError, OSError, BadZipFile, zlib.error) as error:
        raise InputError(
            field=name,
            problem=f"no remap tables of the sky ({error})",
            remedy="give an opencv-remap file of sunarc export, or /v1/remap?grid=sky",
        ) from None
    if said.get("north") == _EAST_AT_LEFT:
        tables = tables[:, ::-1]
    return _table_view(np.where(tables < _NOTHING, np.nan, tables), (width, height))


def _table_view(tables: FloatArray, size: tuple[int, int]) -> View:
    """Return the view of tables with east at the right."""
    from scipy.interpolate import RegularGridInterpolator  # noqa: PLC0415 - the service starts sooner without it

    count = tables.shape[0]
    middle, across = (count - 1) / 2.0, np.arange(count)
    between = RegularGridInterpolator((across, across), tables, bounds_error=False, fill_value=np.nan)

    def look_up_pixels(rays: FloatArray) -> FloatArray:
        radius = np.hypot(rays[:, 0], rays[:, 1])
        zenith_deg = np.degrees(np.arctan2(radius, rays[:, 2]))
        cells = (
            rays[:, :2] * (zenith_deg / _RIGHT_ANGLE_DEG * count / 2.0 / np.where(radius > 0.0, radius, 1.0))[:, None]
        )
        return np.asarray(between(np.stack([middle - cells[:, 1], middle + cells[:, 0]], axis=-1)))

    at_zenith = look_up_pixels(np.array([[0.0, 0.0, 1.0]]))[0]
    east, north = look_up_pixels(np.array([[math.sin(0.1), 0.0, math.cos(0.1)], [0.0, math.sin(0.1), math.cos(0.1)]]))
    frame = np.column_stack([east - at_zenith, north - at_zenith]) / (
        2.0 * math.tan(0.05)
    )  # px per unit, by east and north
    first, scale, second = np.linalg.svd(frame)
    focal = float(np.mean(scale))
    turn = np.eye(3)  # orthogonal, and a mirroring where the image is none of the map's
    turn[:2, :2] = first @ second
    return lens_view(
        "opencv-remap",
        size=size,
        rotation=turn,
        pixels_of_rays=lambda rays: look_up_pixels(rays @ turn),
        start=lambda pixels: (pixels - at_zenith) / focal,
    )
