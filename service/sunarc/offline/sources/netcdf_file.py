"""Images in NetCDF files: the largest variable of 8 or 16 bits whose first axis is the time."""

from __future__ import annotations

import io
import re
from collections.abc import Iterator, Sequence
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import numpy as np

from sunarc.array_types import Image
from sunarc.errors import InputError
from sunarc.extras import extra_module
from sunarc.findings import Finding
from sunarc.offline.messages import RefusedImageError
from sunarc.offline.sources.frames import Frame, require_size
from sunarc.utc import parse_time

_UNITS = re.compile(
    r"^(\w+) since (\d{4}-\d{1,2}-\d{1,2})[T ]?(\d{1,2}:\d{2}(?::\d{2}(?:\.\d+)?)?)?\s*(Z|UTC|[+-]0?0:?00|0:00)?$"
)
_SECONDS = {"days": 86_400.0, "hours": 3600.0, "minutes": 60.0, "seconds": 1.0, "milliseconds": 1e-3}


def netcdf_frames(file: Path | bytes, name: str) -> list[Frame]:
    """Return the images of a NetCDF file, with the times of their coordinate (CF conventions, section 4.4).

    Raises
    ------
    RefusedImageError : it is none, has no images, or no times in UTC.
    """
    with _opened(file, name) as opened:
        images = _images(opened, name)
        times = opened.variables[images.dimensions[0]]
        values = np.asarray(times[...], dtype=np.float64)
        begin, unit_s = _units(str(_text(times.attrs.get("units", ""))), name)
        return [Frame(n, begin + timedelta(seconds=unit_s * float(value))) for n, value in enumerate(values.tolist())]


def netcdf_images(
    file: Path | bytes, name: str, numbers: Sequence[int], *, size: tuple[int, int] | None
) -> Iterator[tuple[int, Image | Finding]]:
    """Yield images of a NetCDF file by their numbers."""
    with _opened(file, name) as opened:
        images = _images(opened, name)
        require_size(images.shape[1:], name, size)
        for number in numbers:
            image = np.asarray(images[number])
            # RGB, as is usual in files for viewers, to OpenCV's order
            yield number, np.ascontiguousarray(image[..., ::-1]) if image.ndim == 3 else image


def _opened(file: Path | bytes, name: str) -> Any:  # noqa: ANN401 - h5netcdf's file
    legacy = extra_module("h5netcdf", extra="netcdf")
    try:
        return legacy.File(io.BytesIO(file) if isinstance(file, bytes) else file, "r")
    except (OSError, ValueError, TypeError) as error:
        raise _unusable(name, f"no NetCDF-4 file ({error})") from None


def _images(opened: Any, name: str) -> Any:  # noqa: ANN401 - h5netcdf's variables
    found = [
        variable
        for variable in opened.variables.values()
        if variable.ndim in {3, 4}
        and variable.dtype in {np.dtype(np.uint8), np.dtype(np.uint16)}
        and variable.dimensions[0] in opened.variables
        and (variable.ndim == 3 or variable.shape[-1] == 3)
    ]
    if not found:
        raise _unusable(name, "no variable (time, rows, columns[, 3]) of 8 or 16 bits with its times")
    return max(found, key=lambda variable: int(np.prod(variable.shape)))


def _units(units: str, name: str) -> tuple[datetime, float]:
    match = _UNITS.match(units.strip())
    if match is None or match[1] not in _SECONDS:
        raise RefusedImageError(name, Finding("file_time_units", {"units": units}))
    try:
        year, month, day = (int(part) for part in match[2].split("-"))
        clock = f"{match[3] or '00:00:00'}".zfill(5)
        return parse_time(f"{year:04d}-{month:02d}-{day:02d}T{clock}Z", where=name).astimezone(UTC), _SECONDS[match[1]]
    except (InputError, ValueError):
        raise RefusedImageError(name, Finding("file_time_units", {"units": units})) from None


def _text(value: object) -> str:
    return value.decode() if isinstance(value, bytes) else str(value)


def _unusable(name: str, error: str) -> RefusedImageError:
    return RefusedImageError(name, Finding("file_not_image", {"error": error}))
