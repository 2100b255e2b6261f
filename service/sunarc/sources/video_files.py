"""Videos by OpenCV: their frames, dated by a sidecar or by a container that keeps real time."""

from __future__ import annotations

import json
import os
import struct
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import BinaryIO

import cv2
import numpy as np

from sunarc.common.array_types import Image
from sunarc.common.errors import InputError
from sunarc.common.findings import Finding, FindingError
from sunarc.common.foreign_files import open_regular, read_regular
from sunarc.common.utc import parse_time
from sunarc.sources.source_files import FileImage, not_read, refusing, require_size

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
                raise FindingError(name, Finding("file_not_image", {"error": "no video that OpenCV can decode"}))
            yield video
        finally:
            video.release()


@contextmanager
def _path(file: Path | bytes, name: str) -> Iterator[Path]:
    """Give a path of a file that is open; one within an archive is laid into memory, never onto the disk."""
    try:
        opened = open_regular(file) if isinstance(file, Path) else _in_memory(file)
    except OSError as error:
        raise not_read(name, error) from None
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
