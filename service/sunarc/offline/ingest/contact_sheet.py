"""A contact sheet: five example pictures of each verdict, the whole image and what was found in it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from sunarc.archive.file_sightings import FileSighting
from sunarc.array_types import Image
from sunarc.errors import InputError, OutsideError
from sunarc.imaging.preview import preview
from sunarc.offline.ingest.image_checks import read_checked_image
from sunarc.offline.ingest.index import ImageFile

_EXAMPLES = 5
_TILE_PX = 220
_TITLE_PX = 30
_CROP_RADII = 6.0
"""Half a crop's side, in radii of what was found."""
_LEAST_CROP_PX = 24
_ACCEPTED, _REJECTED, _TEXT = (0, 200, 0), (0, 140, 255), (230, 230, 230)

_Picture = np.ndarray[Any, np.dtype[np.uint8]]


def write_contact_sheet(folder: Path, found: Mapping[ImageFile, FileSighting], target: Path) -> None:
    """Write a PNG with a row of pictures for each verdict, the most frequent first.

    An example is the whole image with a mark, and beside it a crop around the mark at its own brightness. They are
    spread evenly over the folder.

    Raises
    ------
    OutsideError : the file cannot be written.
    """
    by_verdict: dict[str, list[ImageFile]] = {}
    for image, sighting in found.items():
        by_verdict.setdefault(sighting.verdict, []).append(image)
    rows = [
        _row(folder, verdict, images, found)
        for verdict, images in sorted(by_verdict.items(), key=lambda one: -len(one[1]))
    ]
    encoded = cv2.imencode(".png", np.vstack(rows))[1]
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        target.write_bytes(encoded.tobytes())
    except OSError as error:
        raise OutsideError(f"{target} could not be written: {error.strerror}") from None


def _row(folder: Path, verdict: str, images: Sequence[ImageFile], found: Mapping[ImageFile, FileSighting]) -> _Picture:
    some = np.unique(np.linspace(0, len(images) - 1, _EXAMPLES).astype(int))
    tiles = [_example(folder / images[index].path, found[images[index]]) for index in some]
    row = np.zeros((_TITLE_PX + _TILE_PX, 2 * _TILE_PX * _EXAMPLES, 3), dtype=np.uint8)
    _write(row, f"{verdict}: {len(images)}", (6, _TITLE_PX - 9), scale=0.7)
    for number, tile in enumerate(tiles):
        row[_TITLE_PX:, 2 * _TILE_PX * number : 2 * _TILE_PX * (number + 1)] = tile
    return row


def _example(path: Path, sighting: FileSighting) -> _Picture:
    """Return one example, (tile, 2 tiles, 3); an image that is gone meanwhile leaves it dark."""
    tile = np.zeros((_TILE_PX, 2 * _TILE_PX, 3), dtype=np.uint8)
    try:
        image = read_checked_image(path)
    except InputError:
        return tile
    small, shrink = _fitted(_colours(image))
    if sighting.x_px is not None and sighting.y_px is not None:
        at = round(shrink * sighting.x_px), round(shrink * sighting.y_px)
        colour = _ACCEPTED if sighting.accepted else _REJECTED
        cv2.drawMarker(small, at, colour, markerType=cv2.MARKER_CROSS, markerSize=18, thickness=1)
        crop = _crop(image, sighting)
        tile[: crop.shape[0], _TILE_PX : _TILE_PX + crop.shape[1]] = crop
    tile[: small.shape[0], : small.shape[1]] = small
    _write(tile, path.name[-34:], (3, _TILE_PX - 5), scale=0.36)
    return tile


def _crop(image: Image, sighting: FileSighting) -> _Picture:
    """Return the surroundings of a sighting, enlarged, its centre and radius marked."""
    x, y, radius = float(sighting.x_px or 0.0), float(sighting.y_px or 0.0), sighting.radius_px or 0.0
    half = max(round(_CROP_RADII * radius), _LEAST_CROP_PX)
    left, top = max(0, round(x) - half), max(0, round(y) - half)
    part = image[top : round(y) + half + 1, left : round(x) + half + 1]
    if part.size == 0:
        return np.zeros((1, 1, 3), dtype=np.uint8)
    enlarged, scale = _fitted(_colours(part))
    centre = round(scale * (x - left)), round(scale * (y - top))
    colour = _ACCEPTED if sighting.accepted else _REJECTED
    cv2.drawMarker(enlarged, centre, colour, markerType=cv2.MARKER_CROSS, markerSize=9, thickness=1)
    if radius > 0.0:
        cv2.circle(enlarged, centre, round(scale * radius), colour, 1)
    return enlarged


def _fitted(picture: _Picture) -> tuple[_Picture, float]:
    """Return a picture as large as a tile holds, and by how much it was enlarged."""
    scale = _TILE_PX / max(picture.shape[:2])
    size = max(1, round(scale * picture.shape[1])), max(1, round(scale * picture.shape[0]))
    method = cv2.INTER_AREA if scale < 1.0 else cv2.INTER_NEAREST
    return np.ascontiguousarray(cv2.resize(picture, size, interpolation=method), dtype=np.uint8), scale


def _colours(image: Image) -> _Picture:
    """Return an image as 8 bit colours, blue first."""
    if image.ndim == 3:
        return (image if image.dtype == np.uint8 else image // 257).astype(np.uint8)
    grey = image if image.dtype == np.uint8 else preview(image)
    return cv2.cvtColor(grey, cv2.COLOR_GRAY2BGR).astype(np.uint8)


def _write(picture: _Picture, text: str, at: tuple[int, int], *, scale: float) -> None:
    cv2.putText(picture, text, at, cv2.FONT_HERSHEY_SIMPLEX, scale, (0, 0, 0), 3, cv2.LINE_AA)
    cv2.putText(picture, text, at, cv2.FONT_HERSHEY_SIMPLEX, scale, _TEXT, 1, cv2.LINE_AA)
