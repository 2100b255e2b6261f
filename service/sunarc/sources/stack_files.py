"""Files of many images: PGM and PPM one behind the other, NetCDF-4, HDF5 of TREx's colour cameras, and videos."""

from __future__ import annotations

import io
import json
import os
import re
import struct
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any, BinaryIO, NamedTuple

import cv2
import numpy as np

from sunarc.common.array_types import Image
from sunarc.common.errors import InputError
from sunarc.common.extras import extra_module
from sunarc.common.findings import Finding, FindingError
from sunarc.common.foreign_files import open_regular, read_regular
from sunarc.common.utc import DAY_S, parse_time
from sunarc.sources.source_files import MOST_PIXELS, FileImage, not_read, refusing, require_size, unreadable

# PGM and PPM (https://netpbm.sourceforge.net/doc/pgm.html): a file may hold several, each with comments in its header.

NETPBM = (b"P5", b"P6", b"P2", b"P3")
"""Beginnings of files of binary counts, and of counts as text."""
_SPACE = rb"(?:\s|#[^\n]*\n)+"
_HEADER = re.compile(
    rb"P(?P<magic>[5623])(?P<comments>" + _SPACE + rb")(?P<width>\d{1,6})" + _SPACE + rb"(?P<height>\d{1,6})" + _SPACE
    + rb"(?P<top>\d{1,5})\s"
)  # fmt: skip
_PART, _MOST_HEADER = 512, 1 << 14
_MOST_IMAGES = 10_000
"""Of a file: a damaged one has no end."""
_REQUEST = re.compile(rb'#"Image request start"\s+([^\n]*)\n')
_EXPOSURE = re.compile(rb'#"(?:Subframe requested exposure|Effective image exposure)"\s+([\d.]{1,12})\s*ms')
"""Comments of the aurora imagers of the University of Calgary (THEMIS, REGO, TREx)."""


def netpbm_frames(file: BinaryIO, name: str) -> list[FileImage]:
    """Return the images of a PGM or PPM file, with the times that aurora imagers write into their headers.

    Raises
    ------
    FindingError : it is invalid, ends within an image, or has several that state no times.
    """
    frames = [
        _parse_frame_comments(number, header["comments"])
        for number, (header, _) in enumerate(_split_netpbm(file, name))
    ]
    if len(frames) > 1 and any(one.time is None for one in frames):
        raise FindingError(name, Finding("file_animated", {"frames": len(frames)}))
    return frames


def netpbm_images(
    file: BinaryIO, name: str, numbers: Sequence[int], *, size: tuple[int, int] | None
) -> Iterator[tuple[int, Image]]:
    """Yield images of a PGM or PPM file by their numbers."""
    for number, (header, image) in enumerate(_split_netpbm(file, name)):
        if number in numbers:
            require_size(image.shape, name, size)
            if header["magic"] in b"63":  # RGB
                image[..., [0, 2]] = image[..., [2, 0]]
            yield number, image
        if number == max(numbers):
            return
    raise FindingError(name, Finding("file_truncated"))


def _split_netpbm(file: BinaryIO, name: str) -> Iterator[tuple[re.Match[bytes], Image]]:
    """Yield each image with its header; bytes after the last one that are no image are passed over."""
    left = b""
    for number in range(_MOST_IMAGES):
        while (header := _HEADER.match(left)) is None and len(left) < _MOST_HEADER and (more := file.read(_PART)):
            left += more
        if header is None and number == 0:
            raise unreadable(name, "no PGM or PPM of counts")
        if header is None:
            return
        if header["magic"] in _TEXT:
            yield header, _parse_text_image(header, left + file.read(), name)
            return
        image = _allocate_image(header, name)
        pixels = image.reshape(-1).view(np.uint8).data
        have = left[header.end() : header.end() + len(pixels)]
        pixels[: len(have)] = have
        if len(have) + file.readinto(pixels[len(have) :]) < len(pixels):  # type: ignore[attr-defined] # both files have it
            raise FindingError(name, Finding("file_truncated"))
        left = left[header.end() + len(have) :]
        yield header, image.byteswap(inplace=True) if image.dtype == np.uint16 else image


_TEXT = (b"2", b"3")


def _parse_text_image(header: re.Match[bytes], content: bytes, name: str) -> Image:
    """Return the image of a file whose counts are written as text."""
    image = _allocate_image(header, name)
    letters = np.frombuffer(content, np.uint8)[header.end() :]
    is_digit = (letters >= ord("0")) & (letters <= ord("9"))
    is_space = (letters == ord(" ")) | ((letters >= ord("\t")) & (letters <= ord("\r")))
    if not (is_digit | is_space).all():
        raise unreadable(name, "letters among its counts")
    if np.count_nonzero(is_digit[1:] & ~is_digit[:-1]) + int(is_digit[:1].any()) < image.size:
        raise FindingError(name, Finding("file_truncated"))
    counts = np.fromstring(content[header.end() :], np.int64, image.size, sep=" ")
    if counts.min() < 0 or counts.max() > int(header["top"]):
        raise unreadable(name, "counts above its header's largest")
    image[...] = counts.reshape(image.shape)
    return image


def _allocate_image(header: re.Match[bytes], name: str) -> Image:
    """Return room for the image of a header: rows, columns and three colours of a PPM."""
    rows, columns, top = int(header["height"]), int(header["width"]), int(header["top"])
    if not 1 <= top < 1 << 16 or 0 in {rows, columns}:
        raise unreadable(name, "its header states no image")
    if rows * columns > 2 * MOST_PIXELS:
        raise FindingError(name, Finding("file_too_many_pixels", {"most": 2 * MOST_PIXELS}))
    shape = (rows, columns, 3) if header["magic"] in b"63" else (rows, columns)
    return np.empty(shape, np.uint8) if top <= np.iinfo(np.uint8).max else np.empty(shape, np.uint16)


def _parse_frame_comments(number: int, comments: bytes) -> FileImage:
    requested, exposure = _REQUEST.search(comments), _EXPOSURE.search(comments)
    try:
        exposure_us = None if exposure is None else 1e3 * float(exposure[1]) or None
        start = None if requested is None else _parse_request_time(requested[1].decode(errors="replace"))
    except ValueError:
        return FileImage(number)
    return FileImage(
        number, None if start is None else start + timedelta(microseconds=0.5 * (exposure_us or 0.0)), exposure_us
    )


def _parse_request_time(text: str) -> datetime:
    """Return the beginning of an exposure as an aurora imager states it, as "2013-05-13 12:30:00.017 UTC"."""
    return datetime.fromisoformat(text.strip().removesuffix("UTC").strip()).replace(tzinfo=UTC)


# NetCDF-4 and HDF5.

_COUNTS = {np.dtype(np.uint8), np.dtype(np.uint16)}
_UNITS = re.compile(
    r"^(\w+) since (\d{4}-\d{1,2}-\d{1,2})[T ]?(\d{1,2}:\d{2}(?::\d{2}(?:\.\d+)?)?)?\s*(Z|UTC|[+-]0?0:?00|0:00)?$"
)
_SECONDS = {"days": DAY_S, "hours": 3600.0, "minutes": 60.0, "seconds": 1.0, "milliseconds": 1e-3}


class _Stack(NamedTuple):
    """Images of a file: their times, their size (rows, columns), and a function that returns one by its number."""

    times: Callable[[], list[datetime]]
    shape: tuple[int, ...]
    image: Callable[[int], Image]


def netcdf_frames(file: Path | bytes, name: str) -> list[FileImage]:
    """Return the images of a NetCDF file, with the times of their coordinate (CF conventions, section 4.4).

    Raises
    ------
    FindingError : it is invalid, has no images, or no times in UTC.
    """
    with _open_hdf5(file, name) as stack:
        return [FileImage(number, time) for number, time in enumerate(stack.times())]


def netcdf_images(
    file: Path | bytes, name: str, numbers: Sequence[int], *, size: tuple[int, int] | None
) -> Iterator[tuple[int, Image | Finding]]:
    """Yield images of a NetCDF file by their numbers."""
    with _open_hdf5(file, name) as stack:
        require_size(stack.shape, name, size)
        for number in numbers:
            yield number, stack.image(number)


@contextmanager
def _open_hdf5(file: Path | bytes, name: str) -> Iterator[_Stack]:
    """Open a file; by h5py first, since h5netcdf prints a trace of its own where that fails."""
    hdf5, netcdf = extra_module("h5py", extra="netcdf"), extra_module("h5netcdf", extra="netcdf")
    with refusing(name, "no NetCDF-4 or HDF5 file by h5py"):
        content = io.BytesIO(file) if isinstance(file, bytes) else open_regular(file)
        with content, hdf5.File(content, "r") as raw:
            if set(raw.get("data", ())) >= _TREX:
                yield _make_trex_stack(raw["data"]["images"], raw["data"]["timestamp"])
            else:
                with netcdf.File(raw, "r") as opened:
                    yield _make_netcdf_stack(opened, name)


_TREX = {"images", "timestamp"}


def _make_trex_stack(images: Any, timestamps: Any) -> _Stack:  # noqa: ANN401 - h5py's data sets
    """Return the images (rows, columns, 3[, time]) of a file of TREx's colour cameras, whose times are texts in UTC."""

    def image(number: int) -> Image:
        found = np.asarray(images[..., number] if images.ndim == 4 else images)
        return np.ascontiguousarray(found[..., ::-1])  # RGB

    def times() -> list[datetime]:
        written = np.atleast_1d(timestamps[()])
        return [_parse_request_time(_decode_text(one)) for one in written.tolist()]

    if images.dtype not in _COUNTS or images.ndim not in {3, 4} or images.shape[2] != 3:
        raise ValueError("no colours of 8 or 16 bits")
    return _Stack(times, images.shape[:2], image)


def _make_netcdf_stack(opened: Any, name: str) -> _Stack:  # noqa: ANN401 - h5netcdf's file
    images = _find_netcdf_images(opened, name)

    def image(number: int) -> Image:
        found = np.asarray(images[number])
        # RGB, as is usual in files for viewers, to OpenCV's order
        return np.ascontiguousarray(found[..., ::-1]) if found.ndim == 3 else found

    def times() -> list[datetime]:
        coordinate = opened.variables[images.dimensions[0]]
        begin, unit_s = _parse_time_units(str(_decode_text(coordinate.attrs.get("units", ""))), name)
        values = np.asarray(coordinate[...], dtype=np.float64)
        return [begin + timedelta(seconds=unit_s * float(value)) for value in values.tolist()]

    return _Stack(times, images.shape[1:3], image)


def _find_netcdf_images(opened: Any, name: str) -> Any:  # noqa: ANN401 - h5netcdf's variables
    found = [
        variable
        for variable in opened.variables.values()
        if variable.ndim in {3, 4}
        and variable.dtype in _COUNTS
        and variable.dimensions[0] in opened.variables
        and (variable.ndim == 3 or variable.shape[-1] == 3)
    ]
    if not found:
        raise unreadable(name, "no variable (time, rows, columns[, 3]) of 8 or 16 bits with its times")
    return max(found, key=lambda variable: int(np.prod(variable.shape)))


def _parse_time_units(units: str, name: str) -> tuple[datetime, float]:
    match = _UNITS.match(units.strip())
    if match is None or match[1] not in _SECONDS:
        raise FindingError(name, Finding("file_time_units", {"units": units}))
    try:
        year, month, day = (int(part) for part in match[2].split("-"))
        clock = f"{match[3] or '00:00:00'}".zfill(5)
        return parse_time(f"{year:04d}-{month:02d}-{day:02d}T{clock}Z", where=name).astimezone(UTC), _SECONDS[match[1]]
    except (InputError, ValueError):
        raise FindingError(name, Finding("file_time_units", {"units": units})) from None


def _decode_text(value: object) -> str:
    return value.decode() if isinstance(value, bytes) else str(value)


# Videos by OpenCV: their frames, dated by a sidecar or by a container that keeps real time.

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
    with _open_video(file, name) as video:
        count = int(video.get(cv2.CAP_PROP_FRAME_COUNT))
        rate = float(video.get(cv2.CAP_PROP_FPS))
    if not 1 <= count <= min(_MOST_FRAMES, len(file) if isinstance(file, bytes) else file.stat().st_size):
        raise unreadable(name, f"no video: it states {count} frames")
    if sidecar is not None:
        times = _parse_sidecar_times(sidecar, name, count)
    elif rate > 0.0 and 1.0 / rate >= _REAL_TIME_S and (created := _read_creation_time(file)) is not None:
        with refusing(name, "no video whose times are known"):
            times = [created + timedelta(seconds=number / rate) for number in range(count)]
    else:
        raise FindingError(name, Finding("file_video_times", {"frames": count, "frames_per_s": rate}))
    return [FileImage(number, time) for number, time in enumerate(times)]


def video_images(
    file: Path | bytes, name: str, numbers: Sequence[int], *, size: tuple[int, int] | None
) -> Iterator[tuple[int, Image | Finding]]:
    """Yield frames of a video by their numbers; it is decoded from its beginning, since seeking misses frames."""
    wanted = set(numbers)
    with _open_video(file, name) as video:
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
def _open_video(file: Path | bytes, name: str) -> Iterator[cv2.VideoCapture]:
    with _provide_path(file, name) as path:
        video = cv2.VideoCapture(str(path), cv2.CAP_FFMPEG)
        try:
            if not video.isOpened():
                raise unreadable(name, "no video that OpenCV can decode")
            yield video
        finally:
            video.release()


@contextmanager
def _provide_path(file: Path | bytes, name: str) -> Iterator[Path]:
    """Provide a path of a file for a reader; one within an archive is written to memory, never to the disk."""
    try:
        opened = open_regular(file) if isinstance(file, Path) else _write_memory_file(file)
    except OSError as error:
        raise not_read(name, error) from None
    with opened:
        yield Path(f"/proc/self/fd/{opened.fileno()}")


def _write_memory_file(content: bytes) -> BinaryIO:
    file = os.fdopen(os.memfd_create("video"), "w+b")
    file.write(content)
    file.flush()
    return file


def _parse_sidecar_times(text: bytes, name: str, count: int) -> list[datetime]:
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


def _read_creation_time(file: Path | bytes) -> datetime | None:
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
