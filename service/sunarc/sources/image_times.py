"""When images were taken: by the file's name, a sidecar, a header, or our own composite's document."""

from __future__ import annotations

import io
import json
import math
import re
from collections.abc import Collection
from contextlib import suppress
from datetime import UTC, datetime, timedelta, timezone
from pathlib import PurePosixPath
from typing import Any, BinaryIO, NamedTuple, TypeAlias
from zoneinfo import ZoneInfo

from PIL import ExifTags
from PIL import Image as Pictures

from sunarc.common.errors import InputError
from sunarc.common.findings import Finding, FindingError
from sunarc.common.utc import parse_time, utc_time
from sunarc.sources.file_kinds import find_kind, path_stem
from sunarc.sources.image_files import document_in, frames_in
from sunarc.sources.name_times import NamedTime, is_plausible_time, no_time_finding, parse_zone, time_in_name
from sunarc.sources.source_files import FileImage, ImageSource, read_content
from sunarc.sources.time_patterns import time_pattern

_EXPOSURE = re.compile(r"_(\d+(?:\.\d+)?)us(?![a-zA-Z])")

UtcOffset: TypeAlias = timedelta | ZoneInfo
"""How far written times are ahead of UTC: always as far, or as the clocks of a place are (summer time)."""


def local_to_utc(written: datetime, offset: UtcOffset, *, name: str) -> datetime:
    """Return the UTC time of a file's local one.

    Parameters
    ----------
    written : without a zone.
    offset : how far it is ahead of UTC.
    name : of the file.

    Raises
    ------
    FindingError : the place's clocks showed it twice or never, as they were set at a change of summer time.
    OverflowError : it is before the year 1 or after 9999.
    """
    if isinstance(offset, timedelta):
        return written.replace(tzinfo=UTC) - offset
    first, second = (written.replace(tzinfo=offset, fold=fold) for fold in (0, 1))
    if first.utcoffset() == second.utcoffset():
        return first.astimezone(UTC)
    shown = first.astimezone(UTC).astimezone(offset).replace(tzinfo=None) == written
    data = {"written": written.isoformat(timespec="seconds"), "zone": str(offset)}
    raise FindingError(name, Finding("file_time_twice" if shown else "file_time_never", data))


def parse_utc_offset(given: str | float, *, field: str) -> UtcOffset:
    """Return how far times are ahead of UTC, given in hours or as the name of a zone, as "Europe/Berlin".

    Raises
    ------
    InputError : it is neither, or more than a day.
    """
    try:
        hours = float(given)
    except ValueError:
        pass
    else:
        if math.isfinite(hours) and abs(hours) < 24.0:
            return timedelta(hours=hours)
    try:
        return ZoneInfo(str(given))
    except (OSError, ValueError, KeyError):  # no such zone, or no list of zones on this machine
        raise InputError(
            field=field,
            problem=f"{given!r} is neither a number of hours (-24 to 24) nor a time zone that is known here",
            remedy="give hours, or a zone as Europe/Berlin where names follow summer time (package tzdata)",
        ) from None


def sidecar_time(text: bytes, name: str, exposure_us: float | None) -> tuple[datetime, float | None]:
    """Return the time that a sidecar states, and the exposure (us): its own, or the one given.

    Raises
    ------
    FindingError : it has no time, or an invalid value.
    """
    try:
        sidecar: dict[str, Any] = json.loads(text)
        exposure = _parse_exposure(sidecar.get("exposure_us", exposure_us), where=f"{name}, exposure_us")
        return parse_time(str(sidecar["time_utc"]), where=f"{name}, time_utc"), exposure
    except InputError as error:
        raise FindingError(error.field, Finding("file_sidecar", {"error": error.problem})) from None
    except (ValueError, KeyError, AttributeError, OverflowError, RecursionError):
        raise FindingError(name, Finding("file_sidecar", {"error": "no JSON with time_utc"})) from None


def _parse_exposure(value: object, *, where: str) -> float | None:
    """Return an exposure in us that JSON holds; None for null and for 0, which stands for "not known"."""
    if value is None:
        return None
    if isinstance(value, bool) or not isinstance(value, int | float) or not 0.0 <= value < math.inf:
        raise InputError(field=where, problem=f"{value!r} is not an exposure", remedy="give microseconds, or null")
    return float(value) or None


def exif_time(file: BinaryIO) -> datetime | None:
    """Return the time in a picture's EXIF: aware where that has a zone, else naive; None where it has no time."""
    try:
        with Pictures.open(file) as picture:
            tags = picture.getexif()
            details = tags.get_ifd(ExifTags.IFD.Exif)
    except Exception:  # noqa: BLE001 - of damaged heads Pillow raises errors of many kinds
        return None
    text, zone = details.get(ExifTags.Base.DateTimeOriginal), details.get(ExifTags.Base.OffsetTimeOriginal)
    if not text:
        text, zone = tags.get(ExifTags.Base.DateTime), details.get(ExifTags.Base.OffsetTime)
    try:
        time = datetime.strptime(str(text), "%Y:%m:%d %H:%M:%S")  # noqa: DTZ007 - the zone follows, if there is one
        return datetime.fromisoformat(time.isoformat() + str(zone)).astimezone(UTC) if zone else time
    except (ValueError, OverflowError):
        return None


_MOBOTIX, _MOBOTIX_FIELD = b"PRD=MOBOTIX", re.compile(rb"^(DAT|TIM|TZN|TIT)=([^\r\n]{1,40})\r?$", re.MULTILINE)
HEADER_FAMILIES = {"netpbm": "PGM header", "fits": "FITS header", "netcdf": "NetCDF time", "video": "video"}


class TimeRules(NamedTuple):
    """Rules of reading times.

    pattern: of the names without suffix, see `time_pattern`. offset: how far times without a zone are ahead of UTC;
    None refuses them. documents: whether a picture's head is read for the document of our own composites.
    is_offset_assumed: nobody stated the offset, so that a name may have another zone.
    """

    pattern: str | None = None
    offset: UtcOffset | None = None
    documents: bool = False
    is_offset_assumed: bool = False


ASSUMED_UTC = TimeRules(offset=timedelta(0), documents=True, is_offset_assumed=True)
"""Times without a zone are UTC unless stated."""


def name_sidecar(name: str) -> str:
    """Return the name of the JSON file that may accompany a file."""
    return path_stem(name) + ".json"


class TimedFrame(NamedTuple):
    """An image of a file: its number, mid-exposure time (aware, UTC), exposure, and the source of the time.

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
    is FITS, NetCDF, a video or our own composite, then the name, then the header of a picture: Mobotix, EXIF. A name
    whose zone is not known gives way to a header that has one.

    Parameters
    ----------
    source, name : the file.
    rules : how times are read.
    names : of all files of the source.

    Raises
    ------
    FindingError : nothing states the time, or nothing states its zone.
    """
    kind = find_kind(name)
    if kind in {"picture", None}:  # a name of no kind may hold a picture; its content decides
        return [timed_picture(source, name, rules, names=names)]
    sidecar_name = name_sidecar(name)
    frames = frames_in(source, name, sidecar=lambda: source.read(sidecar_name) if sidecar_name in names else None)
    if len(frames) == 1 and kind in {"netpbm", "fits"} and (rules.pattern is not None or frames[0].time is None):
        frame = timed_picture(source, name, rules, names=names)
        return [frame._replace(exposure_us=frames[0].exposure_us or frame.exposure_us)]
    named = _find_name_time(source, name)
    family = HEADER_FAMILIES[str(kind)]
    return [
        _require_plausible_time(_make_header_frame(frame, name, named, rules, family=family), name) for frame in frames
    ]


def _find_name_time(source: ImageSource, name: str) -> NamedTime | None:
    """Return the time in a file's path, or in that with the name of its source, which may be the folder of a day."""
    return time_in_name(name) or time_in_name(f"{PurePosixPath(source.address).name}/{name}")


def _require_plausible_time(frame: TimedFrame, name: str) -> TimedFrame:
    if is_plausible_time(frame.time):
        return frame
    written = frame.time.isoformat(timespec="seconds")
    raise FindingError(name, Finding("file_time_range", {"written": written}))


def timed_picture(source: ImageSource, name: str, rules: TimeRules, *, names: Collection[str]) -> TimedFrame:
    """Return the image of a picture with its time; see `timed_frames`."""
    return _require_plausible_time(_date_picture(source, name, rules, names=names), name)


def _date_picture(source: ImageSource, name: str, rules: TimeRules, *, names: Collection[str]) -> TimedFrame:
    path = PurePosixPath(name)
    sidecar_name = name_sidecar(name)
    named = _find_name_time(source, name)
    prefix = "" if named is None else named.prefix
    if rules.pattern is not None:
        return _date_by_pattern(source, path, rules, prefix)
    if sidecar_name in names:
        time, exposure_us = sidecar_time(
            read_content(source, sidecar_name), sidecar_name, parse_name_exposure(path.name)
        )
        return TimedFrame(0, time, exposure_us, "sidecar", prefix)
    composed = _read_document_time(source, name) if rules.documents else None
    if composed is not None:
        return TimedFrame(0, composed, parse_name_exposure(path.name), "document", prefix)
    return _make_picture_frame(source, name, named, rules)


def _read_document_time(source: ImageSource, name: str) -> datetime | None:
    """Return the time that one of our own composites states; None for other pictures. A preview is refused."""
    stated = document_in(source, name).get("time_utc")
    try:
        return None if stated is None else parse_time(str(stated), where=name)
    except InputError:
        return None


def _date_by_pattern(source: ImageSource, path: PurePosixPath, rules: TimeRules, prefix: str) -> TimedFrame:
    pattern = str(rules.pattern)
    written = time_pattern(pattern).read(path_stem(f"{source.address.rstrip('/')}/{path}"))
    if written is None:
        raise FindingError(path.name, Finding("file_time_pattern", {"pattern": pattern}))
    utc = _convert_written_time(*written, path.name, rules)
    return TimedFrame(0, utc, parse_name_exposure(path.name), "pattern", prefix)


def _make_picture_frame(source: ImageSource, name: str, named: NamedTime | None, rules: TimeRules) -> TimedFrame:
    exposure_us = parse_name_exposure(name)
    prefix = "" if named is None else named.prefix
    if named is not None and (named.ahead is not None or rules.offset is not None):
        return TimedFrame(
            0, _convert_written_time(named.time, named.ahead, name, rules), exposure_us, named.family, prefix
        )
    found = _read_header_time(read_content(source, name))
    if found is not None and (found[0].tzinfo is not None or named is None):
        return TimedFrame(0, _convert_to_utc(found[0], name, rules), exposure_us, found[1], prefix)
    if named is None:
        raise FindingError(name, no_time_finding(PurePosixPath(name).name))
    return TimedFrame(0, _convert_written_time(named.time, named.ahead, name, rules), exposure_us, named.family, prefix)


def _make_header_frame(
    frame: FileImage, name: str, named: NamedTime | None, rules: TimeRules, *, family: str
) -> TimedFrame:
    """Return a frame with the time of its file's header, or of its name where it has none."""
    prefix = "" if named is None else named.prefix
    if frame.time is not None:
        return TimedFrame(frame.number, frame.time, frame.exposure_us, family, prefix)
    if named is None:
        raise FindingError(name, no_time_finding(PurePosixPath(name).name))
    return TimedFrame(
        frame.number,
        _convert_written_time(named.time, named.ahead, name, rules),
        frame.exposure_us,
        named.family,
        prefix,
    )


def _read_header_time(content: bytes) -> tuple[datetime, str] | None:
    """Return the time in a picture's header, naive where that has no zone, and which header it is."""
    head = content[: 1 << 16]
    if _MOBOTIX in head:
        time = _parse_mobotix_time({key: text.decode(errors="replace") for key, text in _MOBOTIX_FIELD.findall(head)})
        if time is not None:
            return time, "Mobotix header"
    time = exif_time(io.BytesIO(content))
    return None if time is None else (time, "EXIF")


def _parse_mobotix_time(fields: dict[bytes, str]) -> datetime | None:
    """Return the time of a Mobotix header: seconds since 1970, else its local time, naive without a known zone."""
    with suppress(ValueError, OverflowError, KeyError):
        time = utc_time(float(fields[b"TIT"]))
        if is_plausible_time(time):
            return time
    try:
        local = datetime.fromisoformat(f"{fields[b'DAT'].strip()}T{fields[b'TIM'].strip()}")
    except (ValueError, KeyError):  # digits that are no date
        return None
    ahead = parse_zone(fields.get(b"TZN", ""))
    return local if ahead is None else local.replace(tzinfo=timezone(ahead))


def _convert_written_time(written: datetime, ahead: timedelta | None, name: str, rules: TimeRules) -> datetime:
    """Return the time that a name states, in UTC; FindingError where nothing states its zone, or two things do."""
    if ahead is None:
        return _convert_to_utc(written, name, rules)
    _require_agreement(written, ahead, name, rules)
    try:
        return written.replace(tzinfo=UTC) - ahead
    except OverflowError:
        raise FindingError(name, Finding("file_time_unknown")) from None


def _require_agreement(written: datetime, ahead: timedelta | None, name: str, rules: TimeRules) -> None:
    """Refuse a local time whose own zone is not the one that was stated for times; one in UTC says nothing of that."""
    if not ahead or rules.offset is None or rules.is_offset_assumed:
        return
    at = written.replace(tzinfo=UTC) - ahead
    stated = rules.offset if isinstance(rules.offset, timedelta) else at.astimezone(rules.offset).utcoffset()
    if stated != ahead:
        text, hours = written.isoformat(timespec="seconds"), ahead / timedelta(hours=1)
        finding = Finding("file_zone_contradicts", {"written": text, "hours": hours, "stated": str(rules.offset)})
        raise FindingError(name, finding)


def _convert_to_utc(time: datetime, name: str, rules: TimeRules) -> datetime:
    if time.tzinfo is None and rules.offset is None:
        raise _unknown_zone_error(name, time)
    try:
        if time.tzinfo is not None or rules.offset is None:
            return time.astimezone(UTC)
        return local_to_utc(time, rules.offset, name=name)
    except OverflowError:
        raise FindingError(name, Finding("file_time_unknown")) from None


def _unknown_zone_error(name: str, time: datetime) -> FindingError:
    return FindingError(name, Finding("file_time_zone", {"written": time.isoformat(timespec="seconds")}))


def parse_name_exposure(name: str) -> float | None:
    """Return the exposure in microseconds in a file's name (``_<n>us``), None without one."""
    match = _EXPOSURE.search(name)
    return float(match.group(1)) if match else None
