"""The list of warm pixels on disk: read after a restart, written when a night is over."""

from __future__ import annotations

import json
import logging
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from sunarc.archive.images import write_atomically
from sunarc.array_types import IntArray
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


class WarmPixelFile:
    """The file of a camera's warm pixels; a file that cannot be read or written is reported, and the night goes on.

    Parameters
    ----------
    path : of the file.
    report : stores a finding as an event.
    """

    def __init__(self, path: Path, report: Callable[[Finding], object]) -> None:
        self._path = path
        self._report = report

    def read(self, sensor: SensorFormat) -> IntArray:
        """Return the flat indices, ascending; none without a file, or where it is damaged or of another sensor."""
        try:
            with self._path.open("rb") as file:
                content = file.read(_MOST_BYTES + 1)
            stored, pixels = _parsed(content)
        except FileNotFoundError:
            return np.zeros(0, dtype=np.int64)
        except (OSError, ValueError, OverflowError, RecursionError) as error:
            why = error.strerror if isinstance(error, OSError) else None
            self._report(Finding("warm_pixels_unread", {"file": self._path.name, "error": why or str(error)}))
            return np.zeros(0, dtype=np.int64)
        if stored != sensor:
            data = {"file": self._path.name, "stored": _said(stored), "present": _said(sensor)}
            self._report(Finding("warm_pixels_other_sensor", data))
            return np.zeros(0, dtype=np.int64)
        return pixels

    def write(self, sensor: SensorFormat, pixels: IntArray) -> None:
        """Write a list in place of the former one: the whole of it, or nothing."""
        document = {"version": _VERSION, "sensor": sensor._asdict(), "pixels": pixels[:_MOST].tolist()}
        try:
            write_atomically(self._path, json.dumps(document).encode())
        except OSError as error:
            found = Finding("warm_pixels_unwritten", {"file": self._path.name, "error": error.strerror or str(error)})
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
