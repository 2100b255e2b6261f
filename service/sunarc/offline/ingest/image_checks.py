"""An image file read for detection, or refused: what cannot be measured in is not decoded to something plausible."""

from __future__ import annotations

import io
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np
from PIL import ExifTags
from PIL import Image as Pictures

from sunarc.array_types import Image
from sunarc.errors import InputError
from sunarc.findings import Finding
from sunarc.offline.files import read_file
from sunarc.offline.messages import RefusedImageError

_FORMATS = ("JPEG", "PNG", "TIFF", "JPEG2000")  # a JPEG of several images (MPO) opens as JPEG
_ONE_IMAGE = ("JPEG", "MPO")  # further images of an MPO are previews
_UPRIGHT = 1
_START_OF_SCAN, _END_OF_IMAGE = 0xDA, b"\xff\xd9"


def image_size(path: Path) -> tuple[int, int] | None:
    """Return width and height that a file's header states, px; None where it has none."""
    try:
        with Pictures.open(path, formats=_FORMATS) as picture:
            return picture.size
    except (OSError, ValueError, SyntaxError, Pictures.DecompressionBombError):
        return None


def read_checked_image(path: Path, *, size: tuple[int, int] | None = None) -> Image:
    """Read an image file, (rows, columns) or (rows, columns, 3), uint8 or uint16, as it is stored.

    Parameters
    ----------
    path : PNG, JPEG, TIFF or JPEG 2000.
    size : width and height that it must have, px.

    Raises
    ------
    RefusedImageError : it is truncated, animated, transparent, for print, to be rotated, of another size, or no image.
    """
    try:
        encoded = read_file(path)
    except InputError as error:
        raise _unreadable(path.name, error.problem) from None
    return checked_image(encoded, path.name, size=size)


def checked_image(encoded: bytes, name: str, *, size: tuple[int, int] | None = None) -> Image:
    """Return the image of a file's content; see `read_checked_image`."""
    fault = _header_fault(encoded, size)
    if fault is not None:
        raise RefusedImageError(name, fault)
    try:
        image = cv2.imdecode(np.frombuffer(encoded, dtype=np.uint8), cv2.IMREAD_UNCHANGED)
    except cv2.error:
        image = None
    if image is not None and image.dtype == np.uint8:
        return _opaque(image.astype(np.uint8, copy=False), name)
    if image is not None and image.dtype == np.uint16:
        return _opaque(image.astype(np.uint16, copy=False), name)
    raise _unreadable(name, "no image of 8 or 16 bits")


def _unreadable(name: str, error: str) -> RefusedImageError:
    return RefusedImageError(name, Finding("file_not_image", {"error": error}))


def _opaque(image: Image, name: str) -> Image:
    """Return an image without its alpha channel; one that is not opaque everywhere is refused."""
    if image.ndim == 2 or image.shape[2] == 3:
        return image
    if image.shape[2] != 4:
        raise _unreadable(name, f"{image.shape[2]} channels")
    transparent = float(np.mean(image[..., 3] < np.iinfo(image.dtype).max))
    if transparent > 0.0:
        raise RefusedImageError(name, Finding("file_transparent", {"share": transparent}))
    return image[..., :3]


class _Header(NamedTuple):
    kind: str
    size: tuple[int, int]
    mode: str
    frames: int
    orientation: int


def _header_fault(encoded: bytes, size: tuple[int, int] | None) -> Finding | None:
    """Return what is wrong with an image, by its header and its end."""
    try:
        header = _header_of(encoded)
    except (OSError, ValueError, TypeError, SyntaxError, Pictures.DecompressionBombError) as error:
        return Finding("file_not_image", {"error": f"no PNG, JPEG, TIFF or JPEG 2000 image ({type(error).__name__})"})
    width, height = header.size
    wanted = size or header.size
    faults = (
        (_is_truncated(encoded, header.kind), Finding("file_truncated")),
        (header.frames > 1, Finding("file_animated", {"frames": header.frames})),
        (header.mode == "CMYK", Finding("file_cmyk")),
        (header.orientation != _UPRIGHT, Finding("file_rotated", {"orientation": header.orientation})),
        (
            header.size != wanted,
            Finding(
                "file_size_differs",
                {"width": width, "height": height, "camera_width": wanted[0], "camera_height": wanted[1]},
            ),
        ),
    )
    return next((finding for is_so, finding in faults if is_so), None)


def _header_of(encoded: bytes) -> _Header:
    with Pictures.open(io.BytesIO(encoded), formats=_FORMATS) as picture:
        kind = str(picture.format)
        frames = 1 if kind in _ONE_IMAGE else int(getattr(picture, "n_frames", 1))
        orientation = picture.getexif().get(ExifTags.Base.Orientation, _UPRIGHT)
        return _Header(kind, picture.size, picture.mode, frames, int(orientation))


def _is_truncated(encoded: bytes, kind: str) -> bool:
    """Return whether the marks at the end of the image data are missing; a decoder would fill in grey."""
    if kind == "PNG":
        return b"IEND" not in encoded
    if kind in _ONE_IMAGE:
        return _END_OF_IMAGE not in encoded[_scan_start(encoded) :]
    return False


def _scan_start(jpeg: bytes) -> int:
    """Return where a JPEG's image data begin: its thumbnail, before them, has an end mark of its own."""
    at = 2
    while at + 4 <= len(jpeg) and jpeg[at] == 0xFF:
        if jpeg[at + 1] == _START_OF_SCAN:
            return at
        at += 2 + int.from_bytes(jpeg[at + 2 : at + 4], "big")
    return len(jpeg)
