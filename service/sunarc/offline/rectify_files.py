"""Images mapped to a grid of the sky, or of the ground under a cloud layer."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any, get_args

import cv2
import numpy as np
from numpy.typing import NDArray

from sunarc.array_types import Image
from sunarc.calibration.model.result import Calibration
from sunarc.detection.values import Bayer
from sunarc.errors import InputError, OutsideError
from sunarc.exports.remap import Grid, grid_directions, reach_m, remap_tables, remapped
from sunarc.extras import extra_module
from sunarc.imaging.metadata import document_of
from sunarc.imaging.preview import demosaiced
from sunarc.offline.files import read_file, read_image
from sunarc.offline.project_files import read_calibration


def rectify_files(
    images: Sequence[Path],
    calibration: Path,
    *,
    grid: Grid,
    size: int,
    cloud_height_m: float | None,
    half_width_m: float | None,
    folder: Path,
) -> list[dict[str, Any]]:
    """Map images to a grid, write them into a folder, and return what was written.

    Parameters
    ----------
    images : of the camera, all of its size.
    calibration : a calibration document.
    grid : `sky` writes PNG, an equidistant map; `ground` writes GeoTIFF, azimuthal equidistant about the camera.
        North is at the top, east at the right; 0 where the image has nothing.
    size : pixels along a side.
    cloud_height_m, half_width_m : of the ground grid: the layer's height above the camera, and the distance from the
        camera to the middle of the outermost pixels (unless given: what lies within 78 degrees of zenith angle).
    folder : it is made where it is not there.

    Raises
    ------
    InputError : the grid needs a height, an image is of another size, or the extra `geotiff` is not installed.
    """
    if size < 2 or not all(value is None or 0.0 < value < math.inf for value in (cloud_height_m, half_width_m)):
        raise InputError(field="grid", problem="a size or length that is not positive", remedy="give px and m")
    if grid == "ground" and cloud_height_m is None:
        raise InputError(field="--cloud-height", problem="missing", remedy="give the cloud base above the camera in m")
    solved = read_calibration(calibration)
    height = cloud_height_m or 0.0
    half_width = half_width_m or reach_m(height)
    directions = grid_directions(grid, size, half_width_m=half_width, height_m=height)
    tables = remap_tables(solved.camera, directions)
    _make(folder)
    written = []
    for path in images:
        found = _remapped(path, solved, tables)
        target = folder / f"{path.stem}_{grid}.{'png' if grid == 'sky' else 'tif'}"
        if grid == "sky":
            _write_png(target, found)
        else:
            _write_geotiff(target, found, solved, pixel_m=2.0 * half_width / (size - 1))
        written.append({"file": str(path), "written": str(target), "seen": float(np.mean(tables[0] >= -0.5))})
    return written


def _remapped(path: Path, solved: Calibration, tables: tuple[NDArray[Any], NDArray[Any]]) -> NDArray[Any]:
    image = _in_colour(path, read_image(path))
    size = (solved.camera.width, solved.camera.height)
    if (image.shape[1], image.shape[0]) != size:
        problem = f"{image.shape[1]}x{image.shape[0]} px, the calibration is of {size[0]}x{size[1]}"
        raise InputError(field=str(path), problem=problem, remedy="give images of this camera")
    return remapped(image, *tables)


def _in_colour(path: Path, image: Image) -> Image:
    """Return the image in its colours where it is a composite of ours that says which mosaic it is."""
    said = (document_of(read_file(path)) or {}).get("bayer")
    bayer: Bayer | None = next((known for known in get_args(Bayer) if known == said), None)
    return image if bayer is None or image.ndim != 2 else demosaiced(image, bayer)


def _make(folder: Path) -> None:
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise OutsideError(f"cannot make the folder {folder}: {error.strerror}") from error


def _write_png(path: Path, image: NDArray[Any]) -> None:
    try:
        path.write_bytes(cv2.imencode(".png", image)[1].tobytes())
    except OSError as error:
        raise OutsideError(f"cannot write {path}: {error.strerror}") from error


def _write_geotiff(path: Path, image: NDArray[Any], solved: Calibration, *, pixel_m: float) -> None:
    rasterio = extra_module("rasterio", extra="geotiff")
    site, (rows, columns) = solved.site, image.shape[:2]
    bands = np.atleast_3d(image)[..., ::-1]  # OpenCV's blue, green, red
    left, top = -columns / 2.0 * pixel_m, rows / 2.0 * pixel_m
    profile = {
        "driver": "GTiff",
        "width": columns,
        "height": rows,
        "count": bands.shape[2],
        "dtype": bands.dtype.name,
        "nodata": 0,
        "crs": f"+proj=aeqd +lat_0={site.latitude!r} +lon_0={site.longitude!r} +datum=WGS84 +units=m",
        "transform": rasterio.Affine(pixel_m, 0.0, left, 0.0, -pixel_m, top),
        "compress": "deflate",
    }
    try:
        with rasterio.open(path, "w", **profile) as file:
            file.write(np.moveaxis(bands, -1, 0))
    except rasterio.errors.RasterioIOError as error:
        raise OutsideError(f"cannot write {path}: {error}") from error
