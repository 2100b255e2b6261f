"""FITS files by astropy: the image, the time and site of its header, the colours of its mosaic."""

from __future__ import annotations

import io
import itertools
import math
import os
import re
import warnings
from datetime import UTC, datetime, timedelta
from typing import Any, BinaryIO, cast

import numpy as np
from numpy.typing import NDArray

from sunarc.common.array_types import Image
from sunarc.common.extras import extra_module
from sunarc.common.findings import Finding, FindingError
from sunarc.common.utc import EPOCH
from sunarc.detection.values import BAYERS, Bayer
from sunarc.sources.name_times import is_plausible_time
from sunarc.sources.source_files import MOST_PIXELS, FileImage, refusing, require_size, unreadable

FitsFile = bytes | BinaryIO
"""Content of a FITS file, or a file that is open."""
_EXPOSURES = ("EXPTIME", "EXPOSURE")
_MIDDLES = ("DATE-AVG", "MJD-AVG")
_BEGINS = ("DATE-OBS", "DATE_OBS", "DATE-BEG", "MJD-OBS", "MJD-BEG", "MJD_OBS", "MJD", "JD-OBS", "JD", "DATE")
"""Cards of the beginning (FITS 4.0, table 22) and of programs; DATE, which is of the file, with another clock alone."""
_CLOCKS = ("TIME-OBS", "TIME_OBS", "UT", "UTC", "UT-OBS", "UTSTART", "UTC-OBS")
"""Cards of the time of day where a date has none."""
_MEAN = "AVEPIXEL"
"""The mean of 256 frames in the files of RMS, whose first image is the maximum."""


def fits_frame(file: FitsFile, name: str) -> FileImage:
    """Return the time and exposure that a FITS file's header states."""
    merged = _read_cards(file, name)
    exposure_s = next((_number_or_nan(merged[key]) for key in _EXPOSURES if key in merged), math.nan)
    exposure_us = 1e6 * exposure_s if exposure_s > 0.0 else None
    middle, begin, end = (_read_header_time(merged, *keys) for keys in (_MIDDLES, _BEGINS, ("DATE-END",)))
    if exposure_us is None and begin is not None and end is not None and end > begin:
        exposure_s = (end - begin).total_seconds()
        exposure_us = 1e6 * exposure_s
    if middle is None and begin is not None:
        middle = begin + timedelta(seconds=0.5 * exposure_s if exposure_us is not None else 0.0)
    return FileImage(0, middle, exposure_us)


_SITES = (("SITELAT", "SITELONG"), ("OBSLAT", "OBSLONG"), ("LAT-OBS", "LONG-OBS"), ("OBSGEO-B", "OBSGEO-L"))


def fits_site(file: FitsFile, name: str) -> tuple[float, float] | None:
    """Return the latitude and longitude, degrees, that a FITS file's header states as numbers; None without them."""
    merged = _read_cards(file, name)
    stated = [
        (_number_or_nan(merged[north]), _number_or_nan(merged[east]))
        for north, east in _SITES
        if {north, east} <= set(merged)
    ]
    return next((place for place in stated if math.isfinite(place[0]) and math.isfinite(place[1])), None)


def fits_image(file: FitsFile, name: str, *, size: tuple[int, int] | None) -> Image:
    """Return the image of a FITS file as `counts`, (rows, columns) or (rows, columns, 3).

    Raises
    ------
    FindingError : it has none, or one of another size.
    """
    images = [hdu for hdu in _open_units(file, name) if len(hdu.shape) in {2, 3} and 0 not in hdu.shape]
    images.sort(key=lambda hdu: hdu.name != _MEAN)
    if not images:
        raise unreadable(name, "no image in it (astropy)")
    shape = images[0].shape
    planes = len(shape) == 3
    if planes and shape[0] != 3:
        raise unreadable(name, f"axes {shape}, of which the first is no three colours (astropy)")
    require_size(shape[1:] if planes else shape, name, size)
    _require_pixels(shape, name)
    with refusing(name, "no FITS file by astropy"):
        place = images[0].fileinfo()
        end = place["datLoc"] + min(images[0].size, place["datSpan"])  # tiles are shorter than their image
        if end > (len(file) if isinstance(file, bytes) else file.seek(0, os.SEEK_END)):
            raise FindingError(name, Finding("file_truncated"))
    with refusing(name, "its pixels cannot be read by astropy"):
        native = counts(np.asarray(images[0].data))
    if native is None:
        raise unreadable(name, "its pixels are no numbers (astropy)")
    # OpenCV's order of colours, as all images here
    return cast("Image", np.ascontiguousarray(np.moveaxis(native, 0, -1)[..., ::-1])) if planes else native


_LOWEST = 0.001
"""Quantile of the pixels that becomes 0 where it is negative: the lowest ones are of dead pixels."""
_EVERY = 7
"""Pixel that the quantile is taken of, one in so many."""
_TOP = 65_535


def counts(data: NDArray[Any]) -> Image | None:
    """Return numbers as counts of 8 or 16 bits; None where they are not.

    Counts stay as they are. Other numbers (of floating point, of 32 bits, negative ones) are shifted until hardly one
    is negative, and multiplied where they are of 1 or 255 at most (a share of the full scale, a mean of images of 8
    bits) or of more than 65535 at most, so that the full scale stays one. What is not finite becomes 0.
    """
    kind = data.dtype.newbyteorder("=")
    if kind in {np.dtype(np.uint8), np.dtype(np.uint16)}:
        return cast("Image", data.astype(kind))
    if data.dtype.kind not in "iuf" or data.size == 0:
        return None
    if kind.kind in "iu" and data.min() >= 0 and data.max() <= _TOP:
        return data.astype(np.uint16)
    scaled = data.astype(np.float32)
    if not np.isfinite(scaled).any():
        return None
    np.nan_to_num(scaled, copy=False, posinf=0.0, neginf=0.0)
    scaled -= min(float(np.quantile(scaled.ravel()[::_EVERY], _LOWEST)), 0.0)
    np.clip(scaled, 0.0, None, out=scaled)
    top = float(scaled.max())
    scaled *= next((_TOP / most for most in (1.0, 255.0) if top <= most), _TOP / max(top, _TOP))
    return np.rint(scaled, out=scaled).astype(np.uint16)


def _require_pixels(shape: tuple[int, ...], name: str) -> None:
    """Refuse an image of more pixels than a picture may have."""
    most = 2 * MOST_PIXELS
    if math.prod(shape) > 3 * most or math.prod(shape[-2:]) > most:
        raise FindingError(name, Finding("file_too_many_pixels", {"most": most}))


def fits_bayer(file: FitsFile, name: str) -> Bayer | None:
    """Return the colours of a raw mosaic as the header states them (BAYERPAT, of its first stored row); None: none."""
    merged = _read_cards(file, name)
    stated = str(merged.get("BAYERPAT", "")).strip().upper()
    rows = [stated[:2], stated[2:]]
    if _is_odd(merged.get("XBAYROFF")):
        rows = [row[::-1] for row in rows]
    if _is_odd(merged.get("YBAYROFF")):
        rows = rows[::-1]
    return next((bayer for bayer in BAYERS if bayer == "".join(rows)), None)


def _read_cards(file: FitsFile, name: str) -> dict[str, Any]:
    """Return the cards of all headers by their names, those of the first before those of the others."""
    merged: dict[str, Any] = {}
    with refusing(name, "no header of FITS"):
        for hdu in reversed(_open_units(file, name)):
            merged.update(hdu.header)
    return merged


def _is_odd(value: object) -> bool:
    return isinstance(value, int) and value % 2 == 1


def _open_units(file: FitsFile, name: str) -> list[Any]:
    fits = extra_module("astropy.io.fits", extra="fits")
    with refusing(name, "no FITS file by astropy"), warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of headers beside the standard, and of truncation, which is looked at here
        content = io.BytesIO(file) if isinstance(file, bytes) else file
        content.seek(0)
        units = itertools.islice(fits.open(content, uint=True, memmap=False), _MOST_UNITS)
        return [hdu for hdu in units if hdu.is_image]


_MOST_UNITS = 64
"""Header and data units that are read."""


def _read_header_time(header: dict[str, Any], *keys: str) -> datetime | None:
    """Return the first time of images under some keys of a header, read with its zone; None of another scale than UTC.

    Cameras without a clock write a placeholder, as 0.
    """
    times = (
        _parse_julian_days(header, key) if key.startswith(("MJD", "JD")) else _parse_date_card(header, key)
        for key in keys
    )
    time = next((one for one in times if one is not None and is_plausible_time(one)), None)
    scale = str(header.get("TIMESYS", "UTC")).strip().upper()
    return time if scale in {"UTC", "UT"} else None


_DATE = re.compile(r"\d{4}-\d{2}-\d{2}")
_CLOCK = re.compile(r"(\d{1,2}):(\d{2}):(\d{2}(?:\.\d*)?)")


def _parse_date_card(header: dict[str, Any], key: str) -> datetime | None:
    """Return the time of a card, or of the date in it and the clock of another card."""
    text = str(header.get(key, "")).strip()
    if _DATE.fullmatch(text):
        clock = next((_CLOCK.fullmatch(str(header[one]).strip()) for one in _CLOCKS if one in header), None)
        text = "" if clock is None else f"{text}T{clock[1]:0>2}:{clock[2]}:{clock[3].rstrip('.'):0>2}"
    elif key == "DATE":  # when the file was written
        return None
    try:
        time = datetime.fromisoformat(_SPACED.sub("T", text, count=1))
    except ValueError:
        return None
    try:
        return time.astimezone(UTC) if time.tzinfo is not None else time.replace(tzinfo=UTC)
    except OverflowError:
        return None


_SPACED = re.compile(r"\s+")
_DAYS_OF_1970 = {"MJD": 40_587.0, "JD": 2_440_587.5}
"""Modified Julian date and Julian date of 1970-01-01T00:00:00."""


def _parse_julian_days(header: dict[str, Any], key: str) -> datetime | None:
    try:
        return EPOCH + timedelta(days=_number_or_nan(header.get(key)) - _DAYS_OF_1970[key[: 3 if key[0] == "M" else 2]])
    except (ValueError, OverflowError):
        return None


def _number_or_nan(value: object) -> float:
    return float(value) if isinstance(value, int | float) else math.nan
