"""Warm pixels of a camera: those that stand out in every image of a night, learned and repaired."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable
from datetime import datetime, timedelta
from typing import NamedTuple, Protocol

import numpy as np

from sunarc.common.array_types import BoolArray, Image, IntArray
from sunarc.detection.stars.detect import outstanding_pixels, repaired, warm_pixels
from sunarc.detection.values import Bayer, Stars


class SensorFormat(NamedTuple):
    """Format of a list of pixels: rows and columns of the image, pixel format, binning, serial number."""

    rows: int
    columns: int
    pixel_format: str
    binning: int
    serial: str


class NightFrame(Protocol):
    """An image of the night, and the format of the sensor that took it."""

    @property
    def image(self) -> Image:
        """Counts (height, width) of 8 or 16 bits."""

    @property
    def time(self) -> datetime:
        """Middle of the exposure, aware, UTC."""

    @property
    def pixel_format(self) -> str:
        """GenICam's name, as "Mono12"."""

    @property
    def binning(self) -> int:
        """Pixels of the sensor that each pixel is the mean of, in either direction."""


class WarmPixelList(Protocol):
    """Storage of a camera's warm pixels over a restart."""

    def read(self, sensor: SensorFormat) -> IntArray:
        """Return the flat indices that are stored of a sensor, ascending."""

    def write(self, sensor: SensorFormat, pixels: IntArray) -> None:
        """Store the flat indices of a sensor in place of the former ones."""


_MOST_IMAGES = 36
"""Six hours of slots of ten minutes; 6 MB at most."""
_FEWEST, _SHORTEST = 6, timedelta(minutes=90)


class WarmPixelMap:
    """Warm pixels of a camera: learned from frames, and repaired in later ones.

    From an hour and a half after the first image on there is a list; it is made anew with each image and stays over
    the day. With a file it is read before the first image, and written by `save`.

    Parameters
    ----------
    file : where the list is kept over a restart; None: nowhere.
    """

    def __init__(self, file: WarmPixelList | None = None) -> None:
        self._file = file
        self._seen: deque[tuple[datetime, IntArray]] = deque(maxlen=_MOST_IMAGES)
        self._sensor: SensorFormat | None = None
        self._warm: IntArray = np.zeros(0, dtype=np.int64)
        self._saved = self._warm

    def __len__(self) -> int:
        return int(self._warm.size)

    def repair(self, frame: NightFrame, bayer: Bayer | None, *, serial: str = "") -> Image:
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
            self._begin_with_sensor(sensor)
        self._seen.append((frame.time, outstanding_pixels(frame.image, bayer=bayer)))
        self._learn_warm_pixels()
        return repaired(frame.image, self._warm, bayer=bayer) if len(self) else frame.image

    @property
    def newest(self) -> IntArray:
        """The pixels that stand out in the last image, by flat index."""
        return self._seen[-1][1] if self._seen else np.zeros(0, dtype=np.int64)

    def resume(self, sensor: SensorFormat, seen: Iterable[tuple[datetime, IntArray]]) -> None:
        """Restore the images of a night from before a restart: time and outstanding pixels of each."""
        self._begin_with_sensor(sensor)
        self._seen.extend(seen)
        self._learn_warm_pixels()

    def _learn_warm_pixels(self) -> None:
        if len(self._seen) >= _FEWEST and self._seen[-1][0] - self._seen[0][0] >= _SHORTEST:
            self._warm = warm_pixels([pixels for _, pixels in self._seen])

    def _begin_with_sensor(self, sensor: SensorFormat) -> None:
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
