"""The images in a file: one in a picture or FITS file, many in NetCDF or a video; what cannot be used is refused."""

from __future__ import annotations

import io
import json
import math
import os
import re
import struct
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from datetime import UTC, datetime, timedelta
from pathlib import Path, PurePosixPath
from typing import Any, BinaryIO, Literal, NamedTuple, Protocol

import cv2
import numpy as np
from PIL import ExifTags
from PIL import Image as Pictures

from sunarc.common.array_types import Image
from sunarc.common.errors import InputError
from sunarc.common.extras import extra_module
from sunarc.common.findings import Finding, FindingError
from sunarc.common.foreign_files import UnfitFileError, open_regular, read_regular
from sunarc.common.utc import DAY_S, EPOCH, parse_time
from sunarc.detection.values import BAYERS, Bayer
from sunarc.imaging.metadata import document_of
from sunarc.imaging.preview import decoded
from sunarc.sources.name_times import is_of_images


class SourceFile(NamedTuple):
    """A file of a source: its name below the source, its size in bytes, and what changes with its content."""

    name: str
    size: int
    stamp: str


class ImageSource(Protocol):
    """Files that can be listed and read, in any number of processes at once.

    Attributes
    ----------
    address : what `open_source` opens it by.
    """

    @property
    def address(self) -> str:
        """What `open_source` opens it by."""

    def files(self) -> Iterator[SourceFile]:
        """Yield all files, in the order of their names."""

    def read(self, name: str) -> bytes:
        """Return a file's content.

        Raises
        ------
        OSError : it cannot be read.
        """

    def path(self, name: str) -> Path | None:
        """Return where a file is on this disk; None where it is within another file, or elsewhere."""


_FORMATS = ("JPEG", "PNG", "TIFF", "JPEG2000")  # a JPEG of several images (MPO) opens as JPEG
_ONE_IMAGE = ("JPEG", "MPO")  # further images of an MPO are previews
_UPRIGHT = 1
_START_OF_SCAN, _END_OF_IMAGE = 0xDA, b"\xff\xd9"


def checked_image(encoded: bytes, name: str, *, size: tuple[int, int] | None = None) -> Image:
    """Return the image of a picture's content, (rows, columns) or (rows, columns, 3), uint8 or uint16, as it is stored.

    Parameters
    ----------
    encoded, name : content of a PNG, JPEG, TIFF or JPEG 2000 file, and what it is called.
    size : width and height that it must have, px.

    Raises
    ------
    FindingError : it is truncated, animated, transparent, for print, to be rotated, of another size, or no image.
    """
    fault = _header_fault(encoded, size)
    if fault is not None:
        raise FindingError(name, fault)
    image = decoded(encoded)
    if image is not None and image.dtype == np.uint8:
        return _opaque(image.astype(np.uint8, copy=False), name)
    if image is not None and image.dtype == np.uint16:
        return _opaque(image.astype(np.uint16, copy=False), name)
    raise _unreadable(name, "no image of 8 or 16 bits")


def _unreadable(name: str, error: str) -> FindingError:
    return FindingError(name, Finding("file_not_image", {"error": error}))


def _not_read(name: str, error: OSError) -> FindingError:
    """Return the refusal of a file that cannot be read: one that is there may be readable later."""
    text = error.strerror or str(error)
    if isinstance(error, FileNotFoundError | NotADirectoryError | UnfitFileError):
        return _unreadable(name, text)
    return FindingError(name, Finding(NOT_READ, {"error": text}))


def _opaque(image: Image, name: str) -> Image:
    """Return an image without its alpha channel; one that is not opaque everywhere is refused."""
    if image.ndim == 2 or image.shape[2] == 3:
        return image
    if image.shape[2] != 4:
        raise _unreadable(name, f"{image.shape[2]} channels")
    transparent = float(np.mean(image[..., 3] < np.iinfo(image.dtype).max))
    if transparent > 0.0:
        raise FindingError(name, Finding("file_transparent", {"share": transparent}))
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
    except Pictures.DecompressionBombError:
        return Finding("file_too_many_pixels", {"most": 2 * (Pictures.MAX_IMAGE_PIXELS or 0)})
    except (OSError, ValueError, TypeError, SyntaxError) as error:
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


Kind = Literal["picture", "fits", "netcdf", "video"]
_KINDS: dict[str, Kind] = {
    **dict.fromkeys((".png", ".jpg", ".jpeg", ".tif", ".tiff", ".jp2"), "picture"),
    **dict.fromkeys((".fits", ".fit", ".fts"), "fits"),
    **dict.fromkeys((".nc", ".nc4"), "netcdf"),
    **dict.fromkeys((".mp4", ".m4v", ".mov", ".avi"), "video"),
}
MOST_PIXELS = 100_000_000
"""Of an image that a running service decodes: its camera has the size that it always has."""
NOT_READ = "file_not_read"
_HEAD_BYTES = 1 << 17


class FileImage(NamedTuple):
    """An image in a file: its number there, its mid-exposure time (aware, UTC) and exposure, None where not known."""

    number: int
    time: datetime | None = None
    exposure_us: float | None = None


def kind_of(name: str) -> Kind | None:
    """Return the kind of a file by its name; None for one that holds no images."""
    return _KINDS.get(PurePosixPath(name).suffix.lower())


def frames_in(source: ImageSource, name: str, *, sidecar: Callable[[], bytes | None]) -> list[FileImage]:
    """Return the images in a file; a picture is not read for that.

    Parameters
    ----------
    source, name : the file.
    sidecar : reads the JSON file beside it; None where there is none.

    Raises
    ------
    FindingError : it cannot be read, or does not state when its images were taken.
    """
    kind = kind_of(name)
    if kind == "fits":
        return [fits_frame(content_of(source, name), name)]
    if kind == "netcdf":
        return netcdf_frames(source.path(name) or content_of(source, name), name)
    if kind == "video":
        return video_frames(source.path(name) or content_of(source, name), name, sidecar=sidecar())
    return [FileImage(0)]


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
        yield from _images(source, name, numbers, size)
    except FindingError as error:
        yield from ((number, error.finding) for number in numbers)
    except InputError as error:  # an extra is missing
        unread = Finding("file_not_image", {"error": f"{error.problem}; {error.remedy}"})
        yield from ((number, unread) for number in numbers)


def _images(
    source: ImageSource, name: str, numbers: Sequence[int], size: tuple[int, int] | None
) -> Iterator[tuple[int, Image | Finding]]:
    kind = kind_of(name)
    if kind == "fits":
        yield numbers[0], fits_image(content_of(source, name), name, size=size)
    elif kind == "netcdf":
        yield from netcdf_images(source.path(name) or content_of(source, name), name, numbers, size=size)
    elif kind == "video":
        yield from video_images(source.path(name) or content_of(source, name), name, numbers, size=size)
    else:
        content = content_of(source, name)
        if (document_of(content[:_HEAD_BYTES]) or {}).get("preview"):
            raise FindingError(name, Finding("file_preview"))
        yield numbers[0], checked_image(content, name, size=size)


def image_of(
    source: ImageSource, name: str, number: int = 0, *, size: tuple[int, int] | None = None
) -> Image | Finding:
    """Return one image of a file, or the finding why it cannot be used; see `images_in`."""
    ((_, found),) = images_in(source, name, [number], size=size)
    return found


def image_size(source: ImageSource, name: str, number: int = 0) -> tuple[int, int] | None:
    """Return width and height of an image of a file, px, as a picture's header states it; None where unread."""
    try:
        if kind_of(name) == "picture":
            with _opened(source, name) as file, Pictures.open(file, formats=_FORMATS) as picture:
                return picture.size
    except (OSError, ValueError, SyntaxError, Pictures.DecompressionBombError):
        return None
    found = image_of(source, name, number)
    return None if isinstance(found, Finding) else (found.shape[1], found.shape[0])


def content_of(source: ImageSource, name: str) -> bytes:
    """Return a file's content; FindingError where it cannot be read."""
    try:
        return source.read(name)
    except OSError as error:
        raise _not_read(name, error) from None


def _opened(source: ImageSource, name: str) -> BinaryIO:
    path = source.path(name)
    return io.BytesIO(source.read(name)) if path is None else open_regular(path)


def document_in(source: ImageSource, name: str) -> Mapping[str, Any]:
    """Return the document of our own composites in a picture, empty in others.

    Raises
    ------
    FindingError : it is the preview of a composite, or cannot be read.
    """
    try:
        with _opened(source, name) as file:
            document = document_of(file.read(_HEAD_BYTES)) or {}
    except OSError as error:
        raise _not_read(name, error) from None
    if document.get("preview"):
        raise FindingError(name, Finding("file_preview"))
    return document


def require_size(shape: tuple[int, ...], name: str, size: tuple[int, int] | None) -> None:
    """Refuse an image, (rows, columns[, colours]), that has another size than it must have.

    Raises
    ------
    FindingError : it has.
    """
    height, width = shape[:2]
    if size is not None and (width, height) != size:
        sizes = {"width": width, "height": height, "camera_width": size[0], "camera_height": size[1]}
        raise FindingError(name, Finding("file_size_differs", sizes))


_EXPOSURES = ("EXPTIME", "EXPOSURE")
_MIDDLES, _BEGINS = ("DATE-AVG", "MJD-AVG"), ("DATE-OBS", "DATE_OBS", "DATE-BEG", "MJD-OBS", "MJD-BEG")
_MEAN = "AVEPIXEL"
"""The mean of 256 frames in the files of RMS, whose first image is the maximum."""


@contextmanager
def _refusing(name: str, what: str) -> Iterator[None]:
    """Refuse a file that a library does not bear: of damaged ones each raises errors of any kind."""
    try:
        yield
    except InputError:
        raise
    except Exception as error:  # noqa: BLE001 - of any kind
        raise _unreadable(name, f"{what} ({type(error).__name__})") from None


def fits_frame(content: bytes, name: str) -> FileImage:
    """Return the time and exposure that a FITS file's header states."""
    merged = _fits_cards(content, name)
    exposure_s = next((_number(merged[key]) for key in _EXPOSURES if key in merged), math.nan)
    exposure_us = 1e6 * exposure_s if exposure_s > 0.0 else None
    middle, begin, end = (_fits_time(merged, *keys) for keys in (_MIDDLES, _BEGINS, ("DATE-END",)))
    if exposure_us is None and begin is not None and end is not None and end > begin:
        exposure_s = (end - begin).total_seconds()
        exposure_us = 1e6 * exposure_s
    if middle is None and begin is not None:
        middle = begin + timedelta(seconds=0.5 * exposure_s if exposure_us is not None else 0.0)
    return FileImage(0, middle, exposure_us)


_SITES = (("SITELAT", "SITELONG"), ("OBSLAT", "OBSLONG"), ("LAT-OBS", "LONG-OBS"), ("OBSGEO-B", "OBSGEO-L"))


def fits_site(content: bytes, name: str) -> tuple[float, float] | None:
    """Return the latitude and longitude, degrees, that a FITS file's header states as numbers; None without them."""
    merged = _fits_cards(content, name)
    stated = [(_number(merged[north]), _number(merged[east])) for north, east in _SITES if {north, east} <= set(merged)]
    return next((place for place in stated if math.isfinite(place[0]) and math.isfinite(place[1])), None)


def fits_image(content: bytes, name: str, *, size: tuple[int, int] | None) -> Image:
    """Return the image of a FITS file, (rows, columns) or (rows, columns, 3).

    Raises
    ------
    FindingError : it has none of 8 or 16 bits, or of another size.
    """
    images = [hdu for hdu in _fits_units(content, name) if len(hdu.shape) in {2, 3}]
    images.sort(key=lambda hdu: hdu.name != _MEAN)
    if not images:
        raise _unreadable(name, "no image in it")
    shape = images[0].shape
    planes = len(shape) == 3
    if planes and shape[0] != 3:
        raise _unreadable(name, f"axes {shape}, of which the first is no three colours")
    require_size(shape[1:] if planes else shape, name, size)
    place = images[0].fileinfo()
    if place["datLoc"] + min(images[0].size, place["datSpan"]) > len(content):  # tiles are shorter than their image
        raise FindingError(name, Finding("file_truncated"))
    with _refusing(name, "its pixels cannot be read"):
        data = np.asarray(images[0].data)
    if data.dtype.newbyteorder("=") == np.dtype(np.int16) and data.size and data.min() >= 0:
        data = data.astype(np.uint16)  # of cameras that write counts below 32768 without an offset
    if data.dtype.newbyteorder("=") not in {np.dtype(np.uint8), np.dtype(np.uint16)}:
        raise _unreadable(name, f"pixels are {data.dtype.name}, not 8 or 16 bits")
    native = data.astype(data.dtype.newbyteorder("="))
    # OpenCV's order of colours, as all images here
    return np.ascontiguousarray(np.moveaxis(native, 0, -1)[..., ::-1]) if planes else native


def fits_bayer(content: bytes, name: str) -> Bayer | None:
    """Return the colours of a raw mosaic as the header states them (BAYERPAT, of its first stored row); None: none."""
    merged = _fits_cards(content, name)
    stated = str(merged.get("BAYERPAT", "")).strip().upper()
    rows = [stated[:2], stated[2:]]
    if _odd(merged.get("XBAYROFF")):
        rows = [row[::-1] for row in rows]
    if _odd(merged.get("YBAYROFF")):
        rows = rows[::-1]
    return next((bayer for bayer in BAYERS if bayer == "".join(rows)), None)


def _fits_cards(content: bytes, name: str) -> dict[str, Any]:
    """Return the cards of all headers by their names, those of the first before those of the others."""
    merged: dict[str, Any] = {}
    with _refusing(name, "no header of FITS"):
        for hdu in reversed(_fits_units(content, name)):
            merged.update(hdu.header)
    return merged


def _odd(value: object) -> bool:
    return isinstance(value, int) and value % 2 == 1


def _fits_units(content: bytes, name: str) -> list[Any]:
    fits = extra_module("astropy.io.fits", extra="fits")
    with _refusing(name, "no FITS file"), warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of headers beside the standard, and of truncation, which is looked at here
        return [hdu for hdu in fits.open(io.BytesIO(content), uint=True, memmap=False) if hdu.is_image]


def _fits_time(header: dict[str, Any], *keys: str) -> datetime | None:
    """Return the first time of images under some keys of a header, read with its zone; None of another scale than UTC.

    Cameras without a clock write a placeholder, as 0.
    """
    times = (_fits_mjd(header, key) if key.startswith("MJD") else _fits_date(header, key) for key in keys)
    time = next((one for one in times if one is not None and is_of_images(one)), None)
    scale = str(header.get("TIMESYS", "UTC")).strip().upper()
    return time if scale in {"UTC", "UT"} else None


def _fits_date(header: dict[str, Any], key: str) -> datetime | None:
    text, clock = str(header.get(key, "")).strip(), header.get("TIME-OBS")
    if clock is not None and len(text) == len("2013-05-13"):
        text = f"{text}T{clock}"
    try:
        time = datetime.fromisoformat(text) if len(text) > len("2013-05-13") else None
        return None if time is None else time.astimezone(UTC) if time.tzinfo is not None else time.replace(tzinfo=UTC)
    except (ValueError, OverflowError):
        return None


_MJD_OF_1970 = 40_587.0


def _fits_mjd(header: dict[str, Any], key: str) -> datetime | None:
    try:
        return EPOCH + timedelta(days=_number(header.get(key)) - _MJD_OF_1970)
    except (ValueError, OverflowError):
        return None


def _number(value: object) -> float:
    return float(value) if isinstance(value, int | float) else math.nan


_UNITS = re.compile(
    r"^(\w+) since (\d{4}-\d{1,2}-\d{1,2})[T ]?(\d{1,2}:\d{2}(?::\d{2}(?:\.\d+)?)?)?\s*(Z|UTC|[+-]0?0:?00|0:00)?$"
)
_SECONDS = {"days": DAY_S, "hours": 3600.0, "minutes": 60.0, "seconds": 1.0, "milliseconds": 1e-3}


def netcdf_frames(file: Path | bytes, name: str) -> list[FileImage]:
    """Return the images of a NetCDF file, with the times of their coordinate (CF conventions, section 4.4).

    Raises
    ------
    FindingError : it is none, has no images, or no times in UTC.
    """
    with _refusing(name, "no NetCDF-4 file"), _netcdf(file) as opened:
        images = _netcdf_images(opened, name)
        times = opened.variables[images.dimensions[0]]
        values = np.asarray(times[...], dtype=np.float64)
        begin, unit_s = _units(str(_text(times.attrs.get("units", ""))), name)
        return [
            FileImage(n, begin + timedelta(seconds=unit_s * float(value))) for n, value in enumerate(values.tolist())
        ]


def netcdf_images(
    file: Path | bytes, name: str, numbers: Sequence[int], *, size: tuple[int, int] | None
) -> Iterator[tuple[int, Image | Finding]]:
    """Yield images of a NetCDF file by their numbers."""
    with _refusing(name, "no NetCDF-4 file"), _netcdf(file) as opened:
        images = _netcdf_images(opened, name)
        require_size(images.shape[1:], name, size)
        for number in numbers:
            image = np.asarray(images[number])
            # RGB, as is usual in files for viewers, to OpenCV's order
            yield number, np.ascontiguousarray(image[..., ::-1]) if image.ndim == 3 else image


@contextmanager
def _netcdf(file: Path | bytes) -> Iterator[Any]:
    """Open a file; by h5py first, since h5netcdf prints a trace of its own where that fails."""
    hdf5, legacy = extra_module("h5py", extra="netcdf"), extra_module("h5netcdf", extra="netcdf")
    content = io.BytesIO(file) if isinstance(file, bytes) else open_regular(file)
    with content, hdf5.File(content, "r") as raw, legacy.File(raw, "r") as opened:
        yield opened


def _netcdf_images(opened: Any, name: str) -> Any:  # noqa: ANN401 - h5netcdf's variables
    found = [
        variable
        for variable in opened.variables.values()
        if variable.ndim in {3, 4}
        and variable.dtype in {np.dtype(np.uint8), np.dtype(np.uint16)}
        and variable.dimensions[0] in opened.variables
        and (variable.ndim == 3 or variable.shape[-1] == 3)
    ]
    if not found:
        raise _unreadable(name, "no variable (time, rows, columns[, 3]) of 8 or 16 bits with its times")
    return max(found, key=lambda variable: int(np.prod(variable.shape)))


def _units(units: str, name: str) -> tuple[datetime, float]:
    match = _UNITS.match(units.strip())
    if match is None or match[1] not in _SECONDS:
        raise FindingError(name, Finding("file_time_units", {"units": units}))
    try:
        year, month, day = (int(part) for part in match[2].split("-"))
        clock = f"{match[3] or '00:00:00'}".zfill(5)
        return parse_time(f"{year:04d}-{month:02d}-{day:02d}T{clock}Z", where=name).astimezone(UTC), _SECONDS[match[1]]
    except (InputError, ValueError):
        raise FindingError(name, Finding("file_time_units", {"units": units})) from None


def _text(value: object) -> str:
    return value.decode() if isinstance(value, bytes) else str(value)


_SINCE_1904 = datetime(1904, 1, 1, tzinfo=UTC)
"""Epoch of the times in MPEG-4 containers (ISO/IEC 14496-12, 8.2.2)."""
_MOST_FRAMES = 1_000_000
"""A year of a frame every half minute; a damaged file states more."""
_REAL_TIME_S = 1.0
"""Interval of a container's frames from which it is taken for that of the images: a time-lapse plays many a second."""


def video_frames(file: Path | bytes, name: str, *, sidecar: bytes | None) -> list[FileImage]:
    """Return the images of a video with their times.

    Parameters
    ----------
    file, name : the video.
    sidecar : JSON with `times_utc`, one a frame, or with `start_utc` and `interval_s`; None without one.

    Raises
    ------
    FindingError : it is no video, or nothing states when its images were taken.
    """
    with _video(file, name) as video:
        count = int(video.get(cv2.CAP_PROP_FRAME_COUNT))
        rate = float(video.get(cv2.CAP_PROP_FPS))
    if not 1 <= count <= min(_MOST_FRAMES, len(file) if isinstance(file, bytes) else file.stat().st_size):
        raise FindingError(name, Finding("file_not_image", {"error": f"no video: it states {count} frames"}))
    if sidecar is not None:
        times = _sidecar_times(sidecar, name, count)
    elif rate > 0.0 and 1.0 / rate >= _REAL_TIME_S and (created := _created(file)) is not None:
        with _refusing(name, "no video whose times are known"):
            times = [created + timedelta(seconds=number / rate) for number in range(count)]
    else:
        raise FindingError(name, Finding("file_video_times", {"frames": count, "frames_per_s": rate}))
    return [FileImage(number, time) for number, time in enumerate(times)]


def video_images(
    file: Path | bytes, name: str, numbers: Sequence[int], *, size: tuple[int, int] | None
) -> Iterator[tuple[int, Image | Finding]]:
    """Yield frames of a video by their numbers; it is decoded from its beginning, since seeking misses frames."""
    wanted = set(numbers)
    with _video(file, name) as video:
        for number in range(max(numbers) + 1):
            done = video.grab()
            if number not in wanted:
                continue
            image = video.retrieve()[1] if done else None
            if image is None:
                yield number, Finding("file_truncated")
                continue
            require_size(image.shape, name, size)
            yield number, image.astype(np.uint8, copy=False)


@contextmanager
def _video(file: Path | bytes, name: str) -> Iterator[cv2.VideoCapture]:
    with _path(file, name) as path:
        video = cv2.VideoCapture(str(path), cv2.CAP_FFMPEG)
        try:
            if not video.isOpened():
                raise FindingError(name, Finding("file_not_image", {"error": "no video that can be decoded"}))
            yield video
        finally:
            video.release()


@contextmanager
def _path(file: Path | bytes, name: str) -> Iterator[Path]:
    """Give a path of a file that is open; one within an archive is laid into memory, never onto the disk."""
    try:
        opened = open_regular(file) if isinstance(file, Path) else _in_memory(file)
    except OSError as error:
        raise _not_read(name, error) from None
    with opened:
        yield Path(f"/proc/self/fd/{opened.fileno()}")


def _in_memory(content: bytes) -> BinaryIO:
    file = os.fdopen(os.memfd_create("video"), "w+b")
    file.write(content)
    file.flush()
    return file


def _sidecar_times(text: bytes, name: str, count: int) -> list[datetime]:
    try:
        sidecar = json.loads(text)
        if "times_utc" in sidecar:
            times = [parse_time(str(one), where=name) for one in sidecar["times_utc"]]
        else:
            start, interval_s = parse_time(str(sidecar["start_utc"]), where=name), float(sidecar["interval_s"])
            times = [start + timedelta(seconds=number * interval_s) for number in range(count)]
    except (ValueError, KeyError, TypeError, AttributeError, OverflowError, RecursionError, InputError):
        error = "no JSON with times_utc, or with start_utc and interval_s"
        raise FindingError(name, Finding("file_sidecar", {"error": error})) from None
    if len(times) != count:
        raise FindingError(name, Finding("file_sidecar", {"error": f"{len(times)} times for {count} frames"}))
    return times


def _created(file: Path | bytes) -> datetime | None:
    """Return when a container says that its recording began: the `mvhd` box; None where it does not say."""
    try:
        content = file if isinstance(file, bytes) else read_regular(file)
    except OSError:
        return None
    at = content.find(b"mvhd")
    if at < 0 or at + 16 > len(content):
        return None
    version = content[at + 4]
    (seconds,) = struct.unpack_from(">Q" if version == 1 else ">I", content, at + 8)
    try:
        return _SINCE_1904 + timedelta(seconds=seconds) if seconds else None
    except OverflowError:
        return None
