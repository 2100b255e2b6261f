"""Time and exposure of an image: from its name, its sidecar, EXIF, or our own composite's document."""

from __future__ import annotations

import json
import math
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any, BinaryIO, NamedTuple

from PIL import ExifTags, UnidentifiedImageError
from PIL import Image as Pictures

from sunarc.cameras.replay import exposure_of_name
from sunarc.errors import InputError
from sunarc.findings import Finding
from sunarc.imaging.metadata import document_of
from sunarc.offline.image_names import UtcOffset, ambiguous_dates, time_in_name, utc_of_local
from sunarc.offline.messages import RefusedImageError
from sunarc.utc import parse_time

_HEAD_BYTES = 1 << 17
"""A document stands before the image data, and is shorter than a JPEG's comment (64 KiB) or about so."""


class Naming(NamedTuple):
    """How times are read: a `strptime` pattern of the names without suffix, and how far ahead of UTC they are."""

    pattern: str | None = None
    offset: UtcOffset = timedelta(0)


def taken(path: Path, naming: Naming) -> tuple[datetime, float | None]:
    """Return when an image was taken, and with what exposure (us) where that is known.

    Without a pattern a sidecar (`NAME.json` with `time_utc` and `exposure_us`) goes first, then our own composites'
    document, then any date and time in the name, then EXIF.

    Raises
    ------
    RefusedImageError : nothing tells the time, or it is the preview of a composite.
    """
    pattern, offset = naming
    exposure_us = exposure_of_name(path.name)
    if pattern is not None:
        try:
            time = datetime.strptime(path.stem, pattern)  # noqa: DTZ007 - zoned below
            return _zoned(time, offset, name=path.name), exposure_us
        except (ValueError, OverflowError):
            raise RefusedImageError(path.name, Finding("file_time_pattern", {"pattern": pattern})) from None
    sidecar = path.with_suffix(".json")
    if sidecar.exists():
        return _from_sidecar(sidecar, exposure_us)
    captured_at = _from_document(path) or _from_name(path.name, offset) or _from_exif(path, offset)
    if captured_at is None:
        raise RefusedImageError(path.name, no_time_finding(path.name))
    return captured_at, exposure_us


def no_time_finding(name: str) -> Finding:
    """Return why nothing tells the time of a file."""
    readings = ambiguous_dates(name)
    if readings is None:
        return Finding("file_time_unknown")
    return Finding("file_time_ambiguous", {"day_first": readings[0], "month_first": readings[1]})


def _from_document(path: Path) -> datetime | None:
    """Return the time that one of our own composites tells."""
    try:
        with path.open("rb") as file:
            document = document_of(file.read(_HEAD_BYTES)) or {}
    except OSError as error:
        unreadable = Finding("file_not_image", {"error": error.strerror or str(error)})
        raise RefusedImageError(path.name, unreadable) from None
    if document.get("preview"):
        raise RefusedImageError(path.name, Finding("file_preview"))
    try:
        return parse_time(str(document["time_utc"]), where=path.name)
    except (KeyError, InputError):
        return None


def _from_name(name: str, offset: UtcOffset) -> datetime | None:
    named = time_in_name(name)
    try:
        return None if named is None else named.utc(offset, name=name)
    except OverflowError:
        return None


def _from_sidecar(path: Path, exposure_us: float | None) -> tuple[datetime, float | None]:
    try:
        return sidecar_time(path.read_bytes(), path.name, exposure_us)
    except OSError:
        raise RefusedImageError(path.name, Finding("file_sidecar", {"error": "no JSON with time_utc"})) from None


def sidecar_time(text: bytes, name: str, exposure_us: float | None) -> tuple[datetime, float | None]:
    """Return the time that a sidecar states, and the exposure (us): its own, or the one given.

    Raises
    ------
    RefusedImageError : it has no time, or one of its values is none.
    """
    try:
        sidecar: dict[str, Any] = json.loads(text)
        exposure = _exposure(sidecar.get("exposure_us", exposure_us), where=f"{name}, exposure_us")
        return parse_time(str(sidecar["time_utc"]), where=f"{name}, time_utc"), exposure
    except InputError as error:
        raise RefusedImageError(error.field, Finding("file_sidecar", {"error": error.problem})) from None
    except (ValueError, KeyError, AttributeError):
        raise RefusedImageError(name, Finding("file_sidecar", {"error": "no JSON with time_utc"})) from None


def _exposure(value: object, *, where: str) -> float | None:
    """Return an exposure in us that JSON holds; None for null and for 0, which stands for "not known"."""
    if value is None:
        return None
    if isinstance(value, bool) or not isinstance(value, int | float) or not 0.0 <= value < math.inf:
        raise InputError(field=where, problem=f"{value!r} is no exposure", remedy="give microseconds, or null")
    return float(value) or None


def _from_exif(path: Path, offset: UtcOffset) -> datetime | None:
    time = exif_time(path)
    try:
        return None if time is None else _zoned(time, offset, name=path.name)
    except OverflowError:
        return None


def exif_time(file: Path | BinaryIO) -> datetime | None:
    """Return the time in a picture's EXIF: aware where that has a zone, else naive; None where it has no time."""
    try:
        with Pictures.open(file) as picture:
            tags = picture.getexif()
            details = tags.get_ifd(ExifTags.IFD.Exif)
    except (OSError, UnidentifiedImageError, ValueError):
        return None
    text = details.get(ExifTags.Base.DateTimeOriginal) or tags.get(ExifTags.Base.DateTime)
    zone = details.get(ExifTags.Base.OffsetTimeOriginal)
    try:
        time = datetime.strptime(str(text), "%Y:%m:%d %H:%M:%S")  # noqa: DTZ007 - the zone follows, if there is one
        return datetime.fromisoformat(time.isoformat() + str(zone)).astimezone(UTC) if zone else time
    except (ValueError, OverflowError):
        return None


def _zoned(time: datetime, offset: UtcOffset, *, name: str) -> datetime:
    return time.astimezone(UTC) if time.tzinfo else utc_of_local(time, offset, name=name)
