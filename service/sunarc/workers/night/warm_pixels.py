"""The camera's warm pixels, as the images of its nights show them, and their list on disk."""

from __future__ import annotations

import json
import logging
from collections import deque
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from datetime import datetime, timedelta
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from sunarc.archive.images import write_atomically
from sunarc.array_types import BoolArray, Image, IntArray
from sunarc.cameras.frame import Frame
from sunarc.detection.stars.detect import outstanding_pixels, repaired, warm_pixels
from sunarc.detection.values import Bayer, Stars
from sunarc.findings import Finding
from sunarc.workers.messages import text_of

_log = logging.getLogger(__name__)

_VERSION = 1
_MOST = 40_000
"""Pixels of a list: an image has 20,000 that stand out, and a list those that do so in 70 % of the images."""
_MOST_BYTES = 1 << 20
"""A list of 40,000 pixels of up to 10 digits takes half of it; a larger file is none of ours."""


class SensorFormat(NamedTuple):
    """What a list of pixels is of: rows and columns of the image, pixel format, binning, serial number."""

    rows: int
    columns: int
    pixel_format: str
    binning: int
    serial: str


@dataclass(eq=False)
class WarmPixelFile:
    """The file of a camera's warm pixels; a file that cannot be read or written is reported, and the night goes on.

    Parameters
    ----------
    path : of the file.
    report : stores a finding as an event.
    """

    path: Path
    report: Callable[[Finding], object]

    def read(self, sensor: SensorFormat) -> IntArray:
        """Return the flat indices, ascending; none without a file, or where it is damaged or of another sensor."""
        try:
            with self.path.open("rb") as file:
                content = file.read(_MOST_BYTES + 1)
            stored, pixels = _parsed(content)
        except FileNotFoundError:
            return np.zeros(0, dtype=np.int64)
        except (OSError, ValueError, OverflowError, RecursionError) as error:
            why = error.strerror if isinstance(error, OSError) else None
            self.report(Finding("warm_pixels_unread", {"file": self.path.name, "error": why or str(error)}))
            return np.zeros(0, dtype=np.int64)
        if stored != sensor:
            data = {"file": self.path.name, "stored": _said(stored), "present": _said(sensor)}
            self.report(Finding("warm_pixels_other_sensor", data))
            return np.zeros(0, dtype=np.int64)
        return pixels

    def write(self, sensor: SensorFormat, pixels: IntArray) -> None:
        """Write a list in place of the former one: the whole of it, or nothing."""
        document = {"version": _VERSION, "sensor": sensor._asdict(), "pixels": pixels[:_MOST].tolist()}
        try:
            write_atomically(self.path, json.dumps(document).encode())
        except OSError as error:
            found = Finding("warm_pixels_unwritten", {"file": self.path.name, "error": error.strerror or str(error)})
            # no event: a disk that is full has no room for one
            _log.warning("%s: %s", found.code, text_of(found), extra={"event_kind": found.code})


def _parsed(content: bytes) -> tuple[SensorFormat, IntArray]:
    """Return what a file says; ValueError where it is not as it was written."""
    if len(content) > _MOST_BYTES:
        raise ValueError(f"more than {_MOST_BYTES} bytes")
    document = json.loads(content)
    if not isinstance(document, dict) or document.get("version") != _VERSION:
        raise ValueError("not a list of this version")
    sensor, pixels = _sensor(document.get("sensor")), document.get("pixels")
    if not isinstance(pixels, list) or len(pixels) > _MOST or not all(type(one) is int for one in pixels):
        raise ValueError("no list of pixels")
    flat = np.array(pixels, dtype=np.int64)
    if flat.size and (flat[0] < 0 or flat[-1] >= sensor.rows * sensor.columns or np.any(np.diff(flat) <= 0)):
        raise ValueError("pixels outside the image, or not in ascending order")
    return sensor, flat


def _sensor(stored: Any) -> SensorFormat:  # noqa: ANN401 - of JSON
    if not isinstance(stored, dict) or set(stored) != set(SensorFormat._fields):
        raise ValueError("no sensor")
    sensor = SensorFormat(**stored)
    if any(type(one) is not kind for one, kind in zip(sensor, (int, int, str, int, str), strict=True)):
        raise ValueError("no sensor")
    return sensor


def _said(sensor: SensorFormat) -> str:
    binned = f", {sensor.binning}x{sensor.binning} binned" if sensor.binning > 1 else ""
    return (
        f"{sensor.columns}x{sensor.rows} px {sensor.pixel_format}{binned}, serial number {sensor.serial or 'unknown'}"
    )


_MOST_IMAGES = 36
"""Six hours of slots of ten minutes; 6 MB at most."""
_FEWEST, _SHORTEST = 6, timedelta(minutes=90)


class WarmPixelMap:
    """Learns which pixels stand out in every image, and repairs them in those that follow.

    From an hour and a half after the first image on there is a list; it is made anew with each image and stays over
    the day. With a file it is read before the first image, and written by `save`.

    Parameters
    ----------
    file : where the list is kept over a restart; None: nowhere.
    """

    def __init__(self, file: WarmPixelFile | None = None) -> None:
        self._file = file
        self._seen: deque[tuple[datetime, IntArray]] = deque(maxlen=_MOST_IMAGES)
        self._sensor: SensorFormat | None = None
        self._warm: IntArray = np.zeros(0, dtype=np.int64)
        self._saved = self._warm

    def __len__(self) -> int:
        return int(self._warm.size)

    def repair(self, frame: Frame, bayer: Bayer | None, *, serial: str = "") -> Image:
        """Learn from a frame, and return its image without the warm pixels that are known.

        Parameters
        ----------
        frame : of the night.
        bayer : colours of a raw mosaic.
        serial : of the camera.
        """
        rows, columns = frame.image.shape[:2]
        sensor = SensorFormat(rows, columns, frame.pixel_format, frame.binning, serial)
        if sensor != self._sensor:  # at the start, with another camera, region or binning
            self._begin(sensor)
        self._seen.append((frame.time, outstanding_pixels(frame.image, bayer=bayer)))
        self._learn()
        return repaired(frame.image, self._warm, bayer=bayer) if len(self) else frame.image

    @property
    def newest(self) -> IntArray:
        """The pixels that stand out in the last image, by flat index."""
        return self._seen[-1][1] if self._seen else np.zeros(0, dtype=np.int64)

    def resume(self, sensor: SensorFormat, seen: Iterable[tuple[datetime, IntArray]]) -> None:
        """Take up the images of a night from before a restart: the time of each, and the pixels that stood out."""
        self._begin(sensor)
        self._seen.extend(seen)
        self._learn()

    def _learn(self) -> None:
        if len(self._seen) >= _FEWEST and self._seen[-1][0] - self._seen[0][0] >= _SHORTEST:
            self._warm = warm_pixels([pixels for _, pixels in self._seen])

    def _begin(self, sensor: SensorFormat) -> None:
        self._seen.clear()
        self._sensor = sensor
        self._warm = self._saved = np.zeros(0, dtype=np.int64) if self._file is None else self._file.read(sensor)

    def save(self) -> None:
        """Write the list where it is not the one that was read or written last."""
        if self._file is not None and self._sensor is not None and not np.array_equal(self._warm, self._saved):
            self._file.write(self._sensor, self._warm)
            self._saved = self._warm

    def without_warm(self, stars: Stars) -> Stars:
        """Return detections without those on a warm pixel: of images from before there was a list."""
        if self._sensor is None or len(self) == 0 or len(stars) == 0:
            return stars
        column, row = np.round(stars.pixels).astype(np.int64).T
        on_warm: BoolArray = np.isin(row * self._sensor.columns + column, self._warm)
        return stars.select(~on_warm)
