"""When the images of a source were taken, and by what that is known."""

from __future__ import annotations

import io
import re
from collections.abc import Collection
from datetime import UTC, datetime, timedelta
from pathlib import PurePosixPath
from typing import NamedTuple

from sunarc.cameras.replay import exposure_of_name
from sunarc.findings import Finding
from sunarc.offline.image_names import NamedTime, UtcOffset, time_in_name, utc_of_local
from sunarc.offline.ingest.image_times import exif_time, no_time_finding, sidecar_time
from sunarc.offline.messages import RefusedImageError
from sunarc.offline.sources.frames import Frame, frames_in, kind_of
from sunarc.offline.sources.values import ImageSource

_MOBOTIX = re.compile(
    rb"PRD=MOBOTIX.*?DAT=(\d{4}-\d{2}-\d{2}).*?TIM=(\d{2}:\d{2}:\d{2}(?:\.\d+)?).*?TZN=(?:GMT|UTC)([+-]\d{1,2})?\b",
    re.DOTALL,
)
_HEADER_FAMILIES = {"fits": "FITS header", "netcdf": "NetCDF time", "video": "video"}


class TimeRules(NamedTuple):
    """How times are read: a `strptime` pattern of the names without suffix, and how far ahead of UTC they are.

    An offset of None refuses times whose zone nothing tells.
    """

    pattern: str | None = None
    offset: UtcOffset | None = None


class TimedFrame(NamedTuple):
    """An image of a file: its number, mid-exposure time (aware, UTC), exposure, and what tells the time.

    `prefix` is what precedes the time in the name, by which cameras differ.
    """

    number: int
    time: datetime
    exposure_us: float | None
    family: str
    prefix: str


def timed_frames(source: ImageSource, name: str, rules: TimeRules, *, names: Collection[str]) -> list[TimedFrame]:
    """Return the images of a file with their times.

    A pattern goes first, then a sidecar (`NAME.json` with `time_utc` and `exposure_us`), then the file itself where it
    is FITS, NetCDF or a video, then the name, then the header of a picture: Mobotix, EXIF. A name whose zone is not
    known gives way to a header that has one.

    Parameters
    ----------
    source, name : the file.
    rules : how times are read.
    names : of all files of the source.

    Raises
    ------
    RefusedImageError : nothing tells the time, or nothing tells its zone.
    """
    kind, path = kind_of(name), PurePosixPath(name)
    sidecar_name = path.with_suffix(".json").as_posix()
    named = time_in_name(path.name)
    prefix = "" if named is None else named.prefix
    if kind == "picture":
        if rules.pattern is not None:
            return [_by_pattern(path, rules, prefix)]
        if sidecar_name in names:
            time, exposure_us = sidecar_time(source.read(sidecar_name), sidecar_name, exposure_of_name(path.name))
            return [TimedFrame(0, time, exposure_us, "sidecar", prefix)]
        return [_of_picture(source, name, named, rules)]
    frames = frames_in(source, name, sidecar=lambda: source.read(sidecar_name) if sidecar_name in names else None)
    return [_of_header(frame, name, named, rules, family=_HEADER_FAMILIES[str(kind)]) for frame in frames]


def _by_pattern(path: PurePosixPath, rules: TimeRules, prefix: str) -> TimedFrame:
    pattern = str(rules.pattern)
    try:
        time = datetime.strptime(path.stem, pattern)  # noqa: DTZ007 - the zone follows
    except (ValueError, OverflowError):
        raise RefusedImageError(path.name, Finding("file_time_pattern", {"pattern": pattern})) from None
    return TimedFrame(0, _zoned(time, path.name, rules), exposure_of_name(path.name), "pattern", prefix)


def _of_picture(source: ImageSource, name: str, named: NamedTime | None, rules: TimeRules) -> TimedFrame:
    exposure_us = exposure_of_name(name)
    prefix = "" if named is None else named.prefix
    if named is not None and (named.zone == "utc" or rules.offset is not None):
        return TimedFrame(0, _utc(named, name, rules), exposure_us, named.family, prefix)
    found = _from_header(_read(source, name))
    if found is not None and (found[0].tzinfo is not None or named is None):
        return TimedFrame(0, _zoned(found[0], name, rules), exposure_us, found[1], prefix)
    if named is None:
        raise RefusedImageError(name, no_time_finding(PurePosixPath(name).name))
    return TimedFrame(0, _utc(named, name, rules), exposure_us, named.family, prefix)


def _of_header(frame: Frame, name: str, named: NamedTime | None, rules: TimeRules, *, family: str) -> TimedFrame:
    """Return a frame with the time of its file's header, or of its name where it has none."""
    prefix = "" if named is None else named.prefix
    if frame.time is not None:
        return TimedFrame(frame.number, frame.time, frame.exposure_us, family, prefix)
    if named is None:
        raise RefusedImageError(name, Finding("file_time_unknown"))
    return TimedFrame(frame.number, _utc(named, name, rules), frame.exposure_us, named.family, prefix)


def _read(source: ImageSource, name: str) -> bytes:
    try:
        return source.read(name)
    except OSError as error:
        unread = Finding("file_not_image", {"error": error.strerror or str(error)})
        raise RefusedImageError(name, unread) from None


def _from_header(content: bytes) -> tuple[datetime, str] | None:
    """Return the time in a picture's header, naive where that has no zone, and which header it is."""
    match = _MOBOTIX.search(content[: 1 << 16])
    if match is not None:
        date, clock, hours = (part.decode() if part else "0" for part in match.groups())
        local = datetime.fromisoformat(f"{date}T{clock}")
        return local.replace(tzinfo=UTC) - timedelta(hours=int(hours)), "Mobotix header"
    time = exif_time(io.BytesIO(content))
    return None if time is None else (time, "EXIF")


def _utc(named: NamedTime, name: str, rules: TimeRules) -> datetime:
    if named.zone == "unknown" and rules.offset is None:
        raise _unknown_zone(name, named.time)
    try:
        return named.utc(timedelta(0) if rules.offset is None else rules.offset, name=name)
    except OverflowError:
        raise RefusedImageError(name, Finding("file_time_unknown")) from None


def _zoned(time: datetime, name: str, rules: TimeRules) -> datetime:
    if time.tzinfo is not None:
        return time.astimezone(UTC)
    if rules.offset is None:
        raise _unknown_zone(name, time)
    try:
        return utc_of_local(time, rules.offset, name=name)
    except OverflowError:
        raise RefusedImageError(name, Finding("file_time_unknown")) from None


def _unknown_zone(name: str, time: datetime) -> RefusedImageError:
    return RefusedImageError(name, Finding("file_time_zone", {"written": time.isoformat(timespec="seconds")}))
