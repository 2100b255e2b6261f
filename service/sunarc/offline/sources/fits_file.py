"""Images in FITS files: the first one of two or three axes, its rows as they are stored.

Times by the FITS standard (section 4.4.2.1, 9.1.2): DATE-OBS is the begin of the exposure in UTC, DATE-AVG its middle.
"""

from __future__ import annotations

import io
import math
import warnings
from datetime import UTC, datetime, timedelta
from typing import Any

import numpy as np

from sunarc.array_types import Image
from sunarc.detection.values import BAYERS, Bayer
from sunarc.extras import extra_module
from sunarc.findings import Finding
from sunarc.offline.messages import RefusedImageError
from sunarc.offline.sources.frames import Frame, require_size

_EXPOSURES = ("EXPTIME", "EXPOSURE")
_MEAN = "AVEPIXEL"
"""The mean of 256 frames in the files of RMS, whose first image is the maximum."""


def fits_frame(content: bytes, name: str) -> Frame:
    """Return the time and exposure that a FITS file's header states."""
    merged = _header(content, name)
    exposure_s = next((_number(merged[key]) for key in _EXPOSURES if key in merged), math.nan)
    exposure_us = 1e6 * exposure_s if exposure_s > 0.0 else None
    middle, begin = _time(merged, "DATE-AVG"), _time(merged, "DATE-OBS")
    if middle is None and begin is not None:
        middle = begin + timedelta(seconds=0.5 * exposure_s if exposure_us is not None else 0.0)
    return Frame(0, middle, exposure_us)


def fits_image(content: bytes, name: str, *, size: tuple[int, int] | None) -> Image:
    """Return the image of a FITS file, (rows, columns) or (rows, columns, 3).

    Raises
    ------
    RefusedImageError : it has none of 8 or 16 bits, or of another size.
    """
    images = [hdu for hdu in _opened(content, name) if len(hdu.shape) in {2, 3}]
    images.sort(key=lambda hdu: hdu.name != _MEAN)
    if not images:
        raise _unusable(name, "no image in it")
    shape = images[0].shape
    planes = len(shape) == 3
    if planes and shape[0] != 3:
        raise _unusable(name, f"axes {shape}, of which the first is no three colours")
    require_size(shape[1:] if planes else shape, name, size)
    if images[0].fileinfo()["datLoc"] + images[0].size > len(content):
        raise RefusedImageError(name, Finding("file_truncated"))
    try:
        data = np.asarray(images[0].data)
    except (OSError, ValueError, TypeError) as error:
        raise _unusable(name, f"its pixels cannot be read ({type(error).__name__})") from None
    if data.dtype.newbyteorder("=") == np.dtype(np.int16) and data.size and data.min() >= 0:
        data = data.astype(np.uint16)  # of cameras that write counts below 32768 without an offset
    if data.dtype.newbyteorder("=") not in {np.dtype(np.uint8), np.dtype(np.uint16)}:
        raise _unusable(name, f"pixels are {data.dtype.name}, not 8 or 16 bits")
    native = data.astype(data.dtype.newbyteorder("="))
    # OpenCV's order of colours, as all images here
    return np.ascontiguousarray(np.moveaxis(native, 0, -1)[..., ::-1]) if planes else native


def fits_bayer(content: bytes, name: str) -> Bayer | None:
    """Return the colours of a raw mosaic as the header states them (BAYERPAT, of its first stored row); None: none."""
    merged = _header(content, name)
    stated = str(merged.get("BAYERPAT", "")).strip().upper()
    rows = [stated[:2], stated[2:]]
    if _odd(merged.get("XBAYROFF")):
        rows = [row[::-1] for row in rows]
    if _odd(merged.get("YBAYROFF")):
        rows = rows[::-1]
    return next((bayer for bayer in BAYERS if bayer == "".join(rows)), None)


def _header(content: bytes, name: str) -> dict[str, Any]:
    """Return the cards of all headers by their names, those of the first before those of the others."""
    merged: dict[str, Any] = {}
    for hdu in reversed(_opened(content, name)):
        merged.update(hdu.header)
    return merged


def _odd(value: object) -> bool:
    return isinstance(value, int) and value % 2 == 1


def _opened(content: bytes, name: str) -> list[Any]:
    fits = extra_module("astropy.io.fits", extra="fits")
    try:
        with warnings.catch_warnings():  # of headers beside the standard, and of truncation, which is looked at here
            warnings.simplefilter("ignore")
            return [hdu for hdu in fits.open(io.BytesIO(content), uint=True, memmap=False) if hdu.is_image]
    except (OSError, ValueError, TypeError, KeyError) as error:
        raise _unusable(name, f"no FITS file ({error})") from None


def _unusable(name: str, error: str) -> RefusedImageError:
    return RefusedImageError(name, Finding("file_not_image", {"error": error}))


def _time(header: dict[str, Any], key: str) -> datetime | None:
    text, clock = str(header.get(key, "")), header.get("TIME-OBS")
    if clock is not None and len(text) == len("2013-05-13"):
        text = f"{text}T{clock}"
    try:
        time = datetime.fromisoformat(text.removesuffix("Z")[:26]) if "T" in text else None
    except ValueError:
        return None
    scale = str(header.get("TIMESYS", "UTC")).strip().upper()
    return time.replace(tzinfo=UTC) if time is not None and scale in {"UTC", "UT"} else None


def _number(value: object) -> float:
    return float(value) if isinstance(value, int | float) else math.nan
