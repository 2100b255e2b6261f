"""A folder of images, played again as though a camera took them now."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import cast

import numpy as np

from sunarc.common.array_types import Image
from sunarc.common.errors import CameraLostError, InputError
from sunarc.common.foreign_files import read_regular
from sunarc.imager.cameras.frame import CameraCondition, CameraInfo, Frame, largest_count
from sunarc.imager.cameras.options import ReplayOptions
from sunarc.imaging.preview import decoded
from sunarc.sources.file_kinds import find_kind
from sunarc.sources.image_times import parse_name_exposure

_TIME = re.compile(r"(?<!\d)(\d{8}T\d{6})(\.\d{1,6})?Z")


@dataclass(frozen=True, slots=True, kw_only=True)
class SkippedFile:
    """An image that was left out, and why."""

    path: Path
    reason: str


class ReplayCamera:
    """A `SkyCamera` over a folder; made by `open_replay`.

    Each exposure gives the next image in order of time, with the exposure that it was taken with. The time in a
    file's name (``20130513T173000.250Z``) is the middle of the exposure, ``_12000us`` the exposure.

    Attributes
    ----------
    skipped : what was left out so far, with the reasons.
    """

    def __init__(self, options: ReplayOptions) -> None:
        self._options = options
        self.skipped: list[SkippedFile] = []
        self._files = self._list_dated_files()
        self._pending = self._read_frames()
        self._next = next(self._pending, None)
        if self._next is None:
            skipped = self._summarise_skipped() or "it is empty"
            raise InputError(
                field="folder",
                problem=f"{options.folder} has no image that could be played ({skipped})",
                remedy="name images as 20130513T173000.250Z_12000us.png",
            )
        self._info = self._make_camera_info(self._next)

    @property
    def info(self) -> CameraInfo:
        """Record of the images; the first one decides."""
        return self._info

    def expose(self, exposure_us: float) -> Frame:  # noqa: ARG002 - what was exposed was exposed
        """Return the next image, whatever the exposure; CameraLostError after the last one."""
        frame = self._next
        if frame is None:
            raise CameraLostError(f"{self._options.folder} has been played to its end")
        self._next = next(self._pending, None)
        return frame

    def distrust(self) -> None:
        """Do nothing: a file does not change."""

    def check(self) -> CameraCondition:
        """Return nothing: a folder has no settings."""
        return CameraCondition()

    def close(self) -> None:
        """End the replay."""
        self._pending = iter(())
        self._next = None

    def _list_dated_files(self) -> list[tuple[datetime, float, Path]]:
        dated = []
        for path in sorted(self._options.folder.rglob("*")):
            if find_kind(path.name) != "picture":
                continue
            time, exposure_us = parse_name_time(path.name), parse_name_exposure(path.name) or self._options.exposure_us
            if time is None:
                self._note_skipped(path, "no time in its name")
            elif exposure_us is None:
                self._note_skipped(path, "no exposure in its name")
            else:
                dated.append((time, exposure_us, path))
        return sorted(dated)

    def _read_frames(self) -> Iterator[Frame]:
        shape: tuple[int, ...] | None = None
        for number, (time, exposure_us, path) in enumerate(self._files, start=1):
            try:
                image = decoded(read_regular(path))
            except OSError:  # taken away since the folder was listed
                image = None
            reason = _find_fault(image, shape, self._options.pixel_format)
            if image is None or reason is not None:
                self._note_skipped(path, reason or "not readable")
                continue
            shape = image.shape
            yield self._make_frame(cast("Image", image), time=time, exposure_us=exposure_us, number=number)

    def _make_frame(self, image: Image, *, time: datetime, exposure_us: float, number: int) -> Frame:
        pixel_format = self._options.pixel_format or ("Mono8" if image.dtype == np.uint8 else "Mono16")
        image.flags.writeable = False
        return Frame(
            image=image,
            time=time,
            exposure_us=exposure_us,
            gain_db=0.0,
            pixel_format=pixel_format,
            full_scale=largest_count(pixel_format),
            frame_id=number,
        )

    def _make_camera_info(self, first: Frame) -> CameraInfo:
        exposures = [exposure_us for _, exposure_us, _ in self._files]
        height, width = first.image.shape
        return CameraInfo(
            address=str(self._options.folder),
            vendor="",
            model="replay",
            serial="",
            width=width,
            height=height,
            pixel_format=first.pixel_format,
            full_scale=first.full_scale,
            exposure_min_us=min(exposures),
            exposure_max_us=max(exposures),
            exposure_step_us=0.0,
        )

    def _note_skipped(self, path: Path, reason: str) -> None:
        self.skipped.append(SkippedFile(path=path, reason=reason))

    def _summarise_skipped(self) -> str:
        counts = Counter(skipped.reason for skipped in self.skipped)
        return ", ".join(f"{count}× {reason}" for reason, count in counts.items())


def open_replay(options: ReplayOptions) -> ReplayCamera:
    """Open a folder of images; InputError when nothing in it can be played."""
    if not options.folder.is_dir():
        raise InputError(field="folder", problem=f"{options.folder} is not a folder", remedy="give a folder of images")
    return ReplayCamera(options)


def parse_name_time(name: str) -> datetime | None:
    """Return the UTC time in a file's name (``YYYYmmddTHHMMSS[.ffffff]Z``), None without one."""
    match = _TIME.search(name)
    if match is None:
        return None
    try:
        return datetime.strptime(match.group(1) + (match.group(2) or ".0"), "%Y%m%dT%H%M%S.%f").replace(tzinfo=UTC)
    except ValueError:
        return None


def _find_fault(image: object, shape: tuple[int, ...] | None, pixel_format: str | None) -> str | None:
    """Return why an image cannot be played, None if it can."""
    if not isinstance(image, np.ndarray):
        return "not readable"
    if image.ndim != 2 or image.dtype not in {np.dtype(np.uint8), np.dtype(np.uint16)}:
        return "not a single channel of 8 or 16 bits"
    if shape is not None and image.shape != shape:
        return "another size than the first one"
    if pixel_format is not None and (largest_count(pixel_format) == 255) != (image.dtype == np.uint8):
        return f"not of depth {pixel_format}"
    return None
