"""A folder of archived images to sightings in the archive; can be broken off and begun again at any file."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Iterator
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any, NamedTuple

from PIL import ExifTags, UnidentifiedImageError
from PIL import Image as Pictures

from sunarc.archive import Archive, open_archive, sun_point_of, upgrade_present
from sunarc.cameras import exposure_of_name
from sunarc.errors import InputError
from sunarc.imaging import document_of
from sunarc.offline.cameras import known_camera, register_camera
from sunarc.offline.detect_files import Method, detect_in_image
from sunarc.offline.files import read_file, read_image
from sunarc.settings import Settings
from sunarc.sky import sun_angles
from sunarc.utc import parse_time

_SUFFIXES = {".png", ".jpg", ".jpeg", ".tif", ".tiff"}
_NAME = re.compile(r"(\d{4})[-_]?(\d{2})[-_]?(\d{2})[-_T ]*(\d{2})[-_:h]?(\d{2})[-_:m]?(\d{2})(\.\d{1,6})?")


class _Naming(NamedTuple):
    pattern: str | None
    offset: timedelta


@dataclass(frozen=True, slots=True, kw_only=True)
class Ingested:
    """What became of one file: "added", "known" already, or "skipped", with the reason or the verdict."""

    path: Path
    outcome: str
    text: str


def ingest_folder(
    settings: Settings,
    folder: Path,
    *,
    method: Method = "auto",
    time_pattern: str | None = None,
    utc_offset_h: float = 0.0,
) -> Iterator[Ingested]:
    """Look for the sun in every image below a folder, in the order of their names, and store what was seen.

    Parameters
    ----------
    settings : camera name, site and state folder.
    folder : where the images are.
    method : as in `detect_in_image`.
    time_pattern : `strptime` pattern of the files' stems; unless given, any date and time in the name is found, then a
        sidecar (`NAME.json` with `time_utc` and `exposure_us`) is asked, then EXIF; our own composites tell it
        themselves.
    utc_offset_h : hours that times without a zone are ahead of UTC.

    Yields
    ------
    One answer a file.
    """
    files = _images(folder)
    upgrade_present(settings.database)
    with open_archive(settings.database) as archive:
        known_camera(archive, settings)
        known = {point.time for point in archive.sun_points(settings.name)}
        for path in files:
            naming = _Naming(time_pattern, timedelta(hours=utc_offset_h))
            yield _ingested(archive, settings, path, method=method, naming=naming, known=known)


def _images(folder: Path) -> list[Path]:
    if not folder.is_dir():
        raise InputError(field=str(folder), problem="is no folder", remedy="name a folder of images")
    files = sorted(path for path in folder.rglob("*") if path.suffix.lower() in _SUFFIXES)
    if not files:
        raise InputError(field=str(folder), problem="has no images", remedy="name a folder of PNG, JPEG or TIFF files")
    return files


def _ingested(
    archive: Archive,
    settings: Settings,
    path: Path,
    *,
    method: Method,
    naming: _Naming,
    known: set[datetime],
) -> Ingested:
    try:
        captured_at, exposure_us = _taken(path, naming.pattern, naming.offset)
        if captured_at in known:
            return Ingested(path=path, outcome="known", text="is in the archive already")
        image = read_image(path)
        register_camera(archive, settings, (image.shape[1], image.shape[0]))
        if float(sun_angles(captured_at.timestamp(), settings.site).apparent_zenith) > settings.capture.sun_zenith_deg:
            return Ingested(path=path, outcome="skipped", text="the sun is below the horizon")
        found = detect_in_image(image, method=method, exposure_us=exposure_us)
    except InputError as error:
        return Ingested(path=path, outcome="skipped", text=str(error))
    epoch = archive.epoch_at(settings.name, captured_at, reason="first image")
    point = sun_point_of(
        found, camera=settings.name, pose_epoch=epoch.id, time=captured_at, exposure_us=exposure_us or 0.0
    )
    archive.add_sun_points([point])
    known.add(captured_at)
    return Ingested(path=path, outcome="added", text=f"{found.verdict}: {found.reason}")


def _taken(path: Path, pattern: str | None, offset: timedelta) -> tuple[datetime, float | None]:
    """Return when an image was taken, and with what exposure where that is known."""
    exposure_us = exposure_of_name(path.name)
    if pattern is not None:
        try:
            return _zoned(datetime.strptime(path.stem, pattern), offset), exposure_us  # noqa: DTZ007 - zoned here
        except (ValueError, OverflowError):
            raise InputError(
                field=path.name, problem=f"its name does not match {pattern!r}", remedy="correct --time-pattern"
            ) from None
    sidecar = path.with_suffix(".json")
    if sidecar.exists():
        return _from_sidecar(sidecar, exposure_us)
    captured_at = _from_document(path) or _from_name(path.name, offset) or _from_exif(path, offset)
    if captured_at is None:
        raise InputError(field=path.name, problem="no time in its name, sidecar or EXIF", remedy="give --time-pattern")
    return captured_at, exposure_us


def _from_document(path: Path) -> datetime | None:
    """Return the time that one of our own composites tells."""
    document = document_of(read_file(path)) or {}
    if document.get("preview"):
        raise InputError(
            field=path.name, problem="a preview, not linear in light", remedy="the composite beside it is read"
        )
    try:
        return parse_time(str(document["time_utc"]), where=path.name)
    except (KeyError, InputError):
        return None


def _from_name(name: str, offset: timedelta) -> datetime | None:
    match = _NAME.search(name)
    if match is None:
        return None
    *numbers, fraction = match.groups()
    try:
        time = datetime(*(int(number) for number in numbers), tzinfo=UTC)  # type: ignore[misc,arg-type]
        time += timedelta(seconds=float(fraction or 0.0))
        return time if name[match.end() :].startswith("Z") else time - offset
    except (ValueError, OverflowError):
        return None


def _from_sidecar(path: Path, exposure_us: float | None) -> tuple[datetime, float | None]:
    try:
        sidecar: dict[str, Any] = json.loads(path.read_text())
        exposure = _exposure(sidecar.get("exposure_us", exposure_us), where=f"{path.name}, exposure_us")
        return parse_time(str(sidecar["time_utc"]), where=f"{path.name}, time_utc"), exposure
    except (ValueError, KeyError, AttributeError, OSError):
        raise InputError(
            field=path.name, problem="no sidecar that could be read", remedy='write {"time_utc": "…Z"}'
        ) from None


def _exposure(value: object, *, where: str) -> float | None:
    """Return an exposure in us that JSON holds; None for null and for 0, which stands for "not known"."""
    if value is None:
        return None
    if isinstance(value, bool) or not isinstance(value, int | float) or not 0.0 <= value < math.inf:
        raise InputError(field=where, problem=f"{value!r} is no exposure", remedy="give microseconds, or null")
    return float(value) or None


def _from_exif(path: Path, offset: timedelta) -> datetime | None:
    try:
        with Pictures.open(path) as picture:
            tags = picture.getexif()
            details = tags.get_ifd(ExifTags.IFD.Exif)
    except (OSError, UnidentifiedImageError, ValueError):
        return None
    text = details.get(ExifTags.Base.DateTimeOriginal) or tags.get(ExifTags.Base.DateTime)
    zone = details.get(ExifTags.Base.OffsetTimeOriginal)
    try:
        time = datetime.strptime(str(text), "%Y:%m:%d %H:%M:%S")  # noqa: DTZ007 - zoned below
        if zone:
            return datetime.fromisoformat(time.isoformat() + str(zone)).astimezone(UTC)
        return _zoned(time, offset)
    except (ValueError, OverflowError):
        return None


def _zoned(time: datetime, offset: timedelta) -> datetime:
    return time.astimezone(UTC) if time.tzinfo else time.replace(tzinfo=UTC) - offset
