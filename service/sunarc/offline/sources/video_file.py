"""Images in videos; when they were taken is in a sidecar, or in the container where that keeps real time."""

from __future__ import annotations

import json
import os
import struct
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from datetime import UTC, datetime, timedelta
from pathlib import Path

import cv2
import numpy as np

from sunarc.array_types import Image
from sunarc.errors import InputError
from sunarc.findings import Finding
from sunarc.offline.messages import RefusedImageError
from sunarc.offline.sources.frames import Frame, require_size
from sunarc.utc import parse_time

_SINCE_1904 = datetime(1904, 1, 1, tzinfo=UTC)
"""Epoch of the times in MPEG-4 containers (ISO/IEC 14496-12, 8.2.2)."""
_REAL_TIME_S = 1.0
"""Interval of a container's frames from which it is taken for that of the images: a time-lapse plays many a second."""


def video_frames(file: Path | bytes, name: str, *, sidecar: bytes | None) -> list[Frame]:
    """Return the images of a video with their times.

    Parameters
    ----------
    file, name : the video.
    sidecar : JSON with `times_utc`, one a frame, or with `start_utc` and `interval_s`; None without one.

    Raises
    ------
    RefusedImageError : it is no video, or nothing tells when its images were taken.
    """
    with _opened(file, name) as video:
        count = int(video.get(cv2.CAP_PROP_FRAME_COUNT))
        rate = float(video.get(cv2.CAP_PROP_FPS))
    if count < 1:
        raise RefusedImageError(name, Finding("file_not_image", {"error": "no video with frames"}))
    if sidecar is not None:
        times = _sidecar_times(sidecar, name, count)
    elif rate > 0.0 and 1.0 / rate >= _REAL_TIME_S and (created := _created(file)) is not None:
        times = [created + timedelta(seconds=number / rate) for number in range(count)]
    else:
        raise RefusedImageError(name, Finding("file_video_times", {"frames": count, "frames_per_s": rate}))
    return [Frame(number, time) for number, time in enumerate(times)]


def video_images(
    file: Path | bytes, name: str, numbers: Sequence[int], *, size: tuple[int, int] | None
) -> Iterator[tuple[int, Image | Finding]]:
    """Yield frames of a video by their numbers; it is decoded from its beginning, since seeking misses frames."""
    wanted = set(numbers)
    with _opened(file, name) as video:
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
def _opened(file: Path | bytes, name: str) -> Iterator[cv2.VideoCapture]:
    with _path(file, name) as path:
        video = cv2.VideoCapture(str(path), cv2.CAP_FFMPEG)
        try:
            if not video.isOpened():
                raise RefusedImageError(name, Finding("file_not_image", {"error": "no video that can be decoded"}))
            yield video
        finally:
            video.release()


@contextmanager
def _path(file: Path | bytes, name: str) -> Iterator[Path]:
    """Give a path of a video; one within an archive is laid into memory, never onto the disk."""
    if isinstance(file, Path):
        yield file
        return
    descriptor = os.memfd_create(Path(name).name)
    try:
        os.write(descriptor, file)
        yield Path(f"/proc/self/fd/{descriptor}")
    finally:
        os.close(descriptor)


def _sidecar_times(text: bytes, name: str, count: int) -> list[datetime]:
    try:
        sidecar = json.loads(text)
        if "times_utc" in sidecar:
            times = [parse_time(str(one), where=name) for one in sidecar["times_utc"]]
        else:
            start, interval_s = parse_time(str(sidecar["start_utc"]), where=name), float(sidecar["interval_s"])
            times = [start + timedelta(seconds=number * interval_s) for number in range(count)]
    except (ValueError, KeyError, TypeError, AttributeError, OverflowError, InputError):
        error = "no JSON with times_utc, or with start_utc and interval_s"
        raise RefusedImageError(name, Finding("file_sidecar", {"error": error})) from None
    if len(times) != count:
        raise RefusedImageError(name, Finding("file_sidecar", {"error": f"{len(times)} times for {count} frames"}))
    return times


def _created(file: Path | bytes) -> datetime | None:
    """Return when a container says that its recording began: the `mvhd` box; None where it does not say."""
    content = file if isinstance(file, bytes) else file.read_bytes()
    at = content.find(b"mvhd")
    if at < 0 or at + 16 > len(content):
        return None
    version = content[at + 4]
    (seconds,) = struct.unpack_from(">Q" if version == 1 else ">I", content, at + 8)
    return _SINCE_1904 + timedelta(seconds=seconds) if seconds else None
