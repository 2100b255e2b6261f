"""The images in a file by the reader of its kind; the pictures among them are checked by their headers."""

from __future__ import annotations

import io
import struct
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, BinaryIO, NamedTuple

import numpy as np
from PIL import ExifTags
from PIL import Image as Pictures

from sunarc.common.array_types import Image
from sunarc.common.errors import InputError
from sunarc.common.findings import Finding, FindingError
from sunarc.common.foreign_files import open_regular
from sunarc.imaging.metadata import embedded_document
from sunarc.imaging.preview import decoded
from sunarc.sources.file_kinds import FILE_KINDS, Kind, find_kind, unread_content, unread_finding
from sunarc.sources.fits_files import fits_frame, fits_image
from sunarc.sources.source_files import (
    MOST_PIXELS,
    UPRIGHT_ADDRESS,
    FileImage,
    ImageSource,
    not_read,
    opened,
    read_content,
    unreadable,
)
from sunarc.sources.stack_files import (
    NETPBM,
    netcdf_frames,
    netcdf_images,
    netpbm_frames,
    netpbm_images,
    video_frames,
    video_images,
)

FORMATS = ("JPEG", "PNG", "TIFF", "JPEG2000", "BMP", "WEBP")  # a JPEG of several images (MPO) opens as JPEG
_FORMAT_LABELS = ", ".join(one.label for one in FILE_KINDS if one.kind == "picture")
_HEADER_ERRORS = (OSError, ValueError, TypeError, SyntaxError)
_TOO_MANY_PIXELS = Finding("file_too_many_pixels", {"most": 2 * (Pictures.MAX_IMAGE_PIXELS or 0)})
_HEAD_BYTES = 1 << 17
_ONE_IMAGE = ("JPEG", "MPO")  # further images of an MPO are previews
UPRIGHT = 1
_TURNS: Mapping[int, Callable[[Image], Image]] = {
    2: lambda image: image[:, ::-1],
    3: lambda image: image[::-1, ::-1],
    4: lambda image: image[::-1],
    5: lambda image: np.swapaxes(image, 0, 1),
    6: lambda image: np.rot90(image, -1),
    7: lambda image: np.swapaxes(image[::-1, ::-1], 0, 1),
    8: np.rot90,
}
"""From the stored rows to the upright picture, by EXIF orientation."""
_FIRST_SIDEWAYS = 5
"""Orientations from this one on exchange width and height."""
_START_OF_SCAN, _END_OF_IMAGE = 0xDA, b"\xff\xd9"


def checked_image(encoded: bytes, name: str, *, size: tuple[int, int] | None = None) -> Image:
    """Return the image of a picture's content, (rows, columns) or (rows, columns, 3), uint8 or uint16, as it is stored.

    Parameters
    ----------
    encoded, name : content of a picture (`file_kinds`), and what it is called.
    size : width and height that it must have, px.

    Raises
    ------
    FindingError : it is truncated, animated, transparent, for print, of another size, or no image.
    """
    if encoded.startswith(NETPBM):
        return next(image for _, image in netpbm_images(io.BytesIO(encoded), name, [0], size=size))
    fault = _find_header_fault(encoded, size)
    if fault is not None:
        raise FindingError(name, fault)
    image = decoded(encoded)
    if image is not None and image.dtype == np.uint8:
        return _remove_alpha(image.astype(np.uint8, copy=False), name)
    if image is not None and image.dtype == np.uint16:
        return _remove_alpha(image.astype(np.uint16, copy=False), name)
    raise unreadable(name, "no image of 8 or 16 bits that OpenCV can decode")


def _remove_alpha(image: Image, name: str) -> Image:
    """Return an image without its alpha channel; one that is not opaque everywhere is refused."""
    if image.ndim == 2 or image.shape[2] == 3:
        return image
    if image.shape[2] != 4:
        raise unreadable(name, f"{image.shape[2]} channels")
    transparent = float(np.mean(image[..., 3] < np.iinfo(image.dtype).max))
    if transparent > 0.0:
        raise FindingError(name, Finding("file_transparent", {"share": transparent}))
    return image[..., :3]


class _Header(NamedTuple):
    kind: str
    size: tuple[int, int]
    mode: str
    frames: int


def _find_header_fault(encoded: bytes, size: tuple[int, int] | None) -> Finding | None:
    """Return the fault of an image, by its header and its end."""
    unread = unread_content(encoded[:16])
    if unread is not None:
        return unread
    try:
        header = _read_header(encoded)
    except Pictures.DecompressionBombError:
        return _TOO_MANY_PIXELS
    except _HEADER_ERRORS as error:
        return Finding("file_not_image", {"error": f"no {_FORMAT_LABELS} image by Pillow ({type(error).__name__})"})
    width, height = header.size
    wanted = size or header.size
    faults = (
        (_is_truncated(encoded, header.kind), Finding("file_truncated")),
        (header.frames > 1, Finding("file_animated", {"frames": header.frames})),
        (header.mode == "CMYK", Finding("file_cmyk")),
        (
            header.size != wanted,
            Finding(
                "file_size_differs",
                {"width": width, "height": height, "camera_width": wanted[0], "camera_height": wanted[1]},
            ),
        ),
    )
    return next((finding for is_so, finding in faults if is_so), None)


def _read_header(encoded: bytes) -> _Header:
    with Pictures.open(io.BytesIO(encoded), formats=FORMATS) as picture:
        kind = str(picture.format)
        frames = 1 if kind in _ONE_IMAGE else int(getattr(picture, "n_frames", 1))
        return _Header(kind, picture.size, picture.mode, frames)


def _is_truncated(encoded: bytes, kind: str) -> bool:
    """Return whether the marks at the end of the image data are missing; a decoder would fill in grey."""
    if kind == "PNG":
        return b"IEND" not in encoded
    if kind in _ONE_IMAGE:
        return _END_OF_IMAGE not in encoded[_find_scan_start(encoded) :]
    if kind == "WEBP":
        return int.from_bytes(encoded[4:8], "little") + 8 > len(encoded)
    return kind == "BMP" and _compute_bmp_end(encoded) > len(encoded)


def _compute_bmp_end(encoded: bytes) -> int:
    """Return where the pixels of a BMP file end, at least: rows of whole words of 4 bytes; 0 of compressed ones."""
    begin, _, width, height, _, bits, compression = struct.unpack_from("<IIiiHHI", encoded, 10)
    is_compressed = compression not in {0, 3}
    return 0 if is_compressed else int(begin + 4 * ((abs(width) * bits + 31) // 32) * abs(height))


def _find_scan_start(jpeg: bytes) -> int:
    """Return where a JPEG's image data begin: its thumbnail, before them, has an end mark of its own."""
    at = 2
    while at + 4 <= len(jpeg) and jpeg[at] == 0xFF:
        if jpeg[at + 1] == _START_OF_SCAN:
            return at
        at += 2 + int.from_bytes(jpeg[at + 2 : at + 4], "big")
    return len(jpeg)


def frames_in(source: ImageSource, name: str, *, sidecar: Callable[[], bytes | None]) -> list[FileImage]:
    """Return the images in a file; a picture is not read for that.

    Parameters
    ----------
    source, name : the file.
    sidecar : reads the JSON file of the same name; None without one.

    Raises
    ------
    FindingError : it cannot be read, or does not state when its images were taken.
    """
    kind = find_kind(name)
    return [FileImage(0)] if kind is None else _READERS[kind].frames(source, name, sidecar)


def images_in(
    source: ImageSource, name: str, numbers: Sequence[int], *, size: tuple[int, int] | None
) -> Iterator[tuple[int, Image | Finding]]:
    """Yield images of a file, each with its number; one that cannot be used gives the finding why.

    Parameters
    ----------
    source, name : the file.
    numbers : of the images, ascending.
    size : width and height that they must have, px; None for any.
    """
    try:
        yield from _read_images(source, name, numbers, size)
    except FindingError as error:
        yield from ((number, error.finding) for number in numbers)
    except InputError as error:  # an extra is missing
        unread = Finding("file_not_image", {"error": f"{error.problem}; {error.remedy}"})
        yield from ((number, unread) for number in numbers)


def _read_images(
    source: ImageSource, name: str, numbers: Sequence[int], size: tuple[int, int] | None
) -> Iterator[tuple[int, Image | Finding]]:
    kind = find_kind(name)
    if (unread := unread_finding(name)) is not None:
        raise FindingError(name, unread)
    yield from _READERS[kind or "picture"].images(source, name, numbers, size)


Images = Iterator[tuple[int, Image | Finding]]
Sidecar = Callable[[], bytes | None]


class _Reader(NamedTuple):
    """Reader of files of a kind: their frames with times, and some of their images."""

    frames: Callable[[ImageSource, str, Sidecar], list[FileImage]]
    images: Callable[[ImageSource, str, Sequence[int], tuple[int, int] | None], Images]


def _read_picture(source: ImageSource, name: str, numbers: Sequence[int], size: tuple[int, int] | None) -> Images:
    content = _read_picture_content(source, name)
    if (embedded_document(content[:_HEAD_BYTES]) or {}).get("preview"):
        raise FindingError(name, Finding("file_preview"))
    turn = _orientation(io.BytesIO(content)) if follows_exif(source.address) else UPRIGHT
    stored = checked_image(content, name, size=_turned_size(size, turn))
    yield numbers[0], stored if turn == UPRIGHT else _TURNS[turn](stored).copy()


def _turned_size(size: tuple[int, int] | None, orientation: int) -> tuple[int, int] | None:
    """Return width and height of a picture with its rows stored as an EXIF orientation states, or turned back."""
    return size[::-1] if size is not None and orientation >= _FIRST_SIDEWAYS else size


def _list_netpbm_frames(source: ImageSource, name: str, sidecar: Sidecar) -> list[FileImage]:
    del sidecar
    with opened(source, name) as file:
        return netpbm_frames(file, name)


def _read_netpbm_images(source: ImageSource, name: str, numbers: Sequence[int], size: tuple[int, int] | None) -> Images:
    with opened(source, name) as file:
        yield from netpbm_images(file, name, numbers, size=size)


def _list_fits_frames(source: ImageSource, name: str, sidecar: Sidecar) -> list[FileImage]:
    del sidecar
    with opened(source, name) as file:
        return [fits_frame(file, name)]


def _read_fits_images(source: ImageSource, name: str, numbers: Sequence[int], size: tuple[int, int] | None) -> Images:
    with opened(source, name) as file:
        yield numbers[0], fits_image(file, name, size=size)


def _open_file(source: ImageSource, name: str) -> Path | bytes:
    return source.path(name) or read_content(source, name)


_READERS: Mapping[Kind, _Reader] = {
    "picture": _Reader(lambda *_: [FileImage(0)], _read_picture),
    "netpbm": _Reader(_list_netpbm_frames, _read_netpbm_images),
    "fits": _Reader(_list_fits_frames, _read_fits_images),
    "netcdf": _Reader(
        lambda source, name, _: netcdf_frames(_open_file(source, name), name),
        lambda source, name, numbers, size: netcdf_images(_open_file(source, name), name, numbers, size=size),
    ),
    "video": _Reader(
        lambda source, name, sidecar: video_frames(_open_file(source, name), name, sidecar=sidecar()),
        lambda source, name, numbers, size: video_images(_open_file(source, name), name, numbers, size=size),
    ),
}


def read_one_image(
    source: ImageSource, name: str, number: int = 0, *, size: tuple[int, int] | None = None
) -> Image | Finding:
    """Return one image of a file, or the finding why it cannot be used; see `images_in`."""
    ((_, found),) = images_in(source, name, [number], size=size)
    return found


def image_size(source: ImageSource, name: str, number: int = 0) -> tuple[int, int] | None:
    """Return width and height of an image of a file, px, as a picture's header states it; None where unread."""
    try:
        if find_kind(name) == "picture":
            with opened(source, name) as file, Pictures.open(file, formats=FORMATS) as picture:
                size = picture.size
            turn = exif_orientation(source, name) if follows_exif(source.address) else UPRIGHT
            return _turned_size(size, turn)
    except (InputError, *_HEADER_ERRORS, Pictures.DecompressionBombError):
        return None
    found = read_one_image(source, name, number)
    return None if isinstance(found, Finding) else (found.shape[1], found.shape[0])


def _read_picture_content(source: ImageSource, name: str) -> bytes:
    """Return a picture's content; of a compressed one not more is inflated than its header states twice over."""
    if not name.lower().endswith(".gz"):
        return read_content(source, name)
    with opened(source, name) as file:
        head = file.read(_HEAD_BYTES)
        most = _bound_decoded_bytes(head, name)
        content = head + file.read(max(most - len(head), 0) + 1)
    if len(content) > most:
        raise FindingError(name, Finding("file_too_large", {"bytes": len(content), "most": most}))
    return content


def _bound_decoded_bytes(head: bytes, name: str) -> int:
    """Return twice the bytes of the image that the head of a file states, or of a WebP file those that it states."""
    if head[:4] == b"RIFF":
        return min(int.from_bytes(head[4:8], "little") + 8, 2 * 3 * MOST_PIXELS)
    try:
        header = _read_header(head)
    except Pictures.DecompressionBombError:
        raise FindingError(name, _TOO_MANY_PIXELS) from None
    except _HEADER_ERRORS as error:
        raise unreadable(name, f"no {_FORMAT_LABELS} image by Pillow ({type(error).__name__})") from None
    return 2 * header.size[0] * header.size[1] * len(header.mode) + _HEAD_BYTES


def exif_orientation(source: ImageSource, name: str) -> int:
    """Return the EXIF orientation of a picture: 1 of one that is upright, or states none."""
    if find_kind(name) != "picture":
        return UPRIGHT
    try:
        with opened(source, name) as file:
            return _orientation(file)
    except InputError:
        return UPRIGHT


def follows_exif(address: str) -> bool:
    """Return whether the pictures of a source are turned as their EXIF orientation states."""
    return address.startswith(UPRIGHT_ADDRESS)


def _orientation(file: BinaryIO) -> int:
    try:
        file.seek(0)
        with Pictures.open(file, formats=FORMATS) as picture:
            stated = int(picture.getexif().get(ExifTags.Base.Orientation, UPRIGHT))
    except Exception:  # noqa: BLE001 - of damaged heads Pillow raises errors of many kinds
        return UPRIGHT
    return stated if stated in _TURNS else UPRIGHT


def document_in(source: ImageSource, name: str) -> Mapping[str, Any]:
    """Return the document of our own composites in a picture, empty in others.

    Raises
    ------
    FindingError : it is the preview of a composite, or cannot be read.
    """
    try:
        path = source.path(name)
        with io.BytesIO(source.read(name)) if path is None else open_regular(path) as file:
            document = embedded_document(file.read(_HEAD_BYTES)) or {}
    except OSError as error:
        raise not_read(name, error) from None
    if document.get("preview"):
        raise FindingError(name, Finding("file_preview"))
    return document
