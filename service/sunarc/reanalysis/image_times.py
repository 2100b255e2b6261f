"""When images were taken: by the file's name, a sidecar, a header, or our own composite's document.

Sources: ARM, https://www.arm.gov (datastreams, as `sgptsiskyimageC1.a1.20130513.123000.jpg`; ordered files repeat the
time at the end); RMS, https://github.com/CroatianMeteorNetwork/RMS (`FF_CODE_date_time_ms_frame.fits`); indi-allsky,
https://github.com/aaronwmorris/indi-allsky (`ccd1_date_time.jpg`); Allsky, https://github.com/AllskyTeam/allsky
(`image-datetime.jpg`); Eye2Sky, https://eye2sky.de/data/data_description (`date_time_EXPOSURE.jpg`); EKO ASI-16
(`datetime_11.jpg`, the last number for the exposure); SKIPP'D and TSI (`datetime.jpg`).
"""

from __future__ import annotations

import io
import json
import math
import re
from collections.abc import Collection
from contextlib import suppress
from datetime import UTC, datetime, timedelta
from pathlib import PurePosixPath
from typing import Any, BinaryIO, Literal, NamedTuple, TypeAlias
from zoneinfo import ZoneInfo

from PIL import ExifTags
from PIL import Image as Pictures

from sunarc.cameras.replay import exposure_of_name
from sunarc.errors import InputError
from sunarc.findings import Finding
from sunarc.reanalysis.image_files import FileImage, ImageSource, content_of, document_in, frames_in, kind_of
from sunarc.reanalysis.messages import RefusedImageError
from sunarc.utc import parse_time

UtcOffset: TypeAlias = timedelta | ZoneInfo
"""How far written times are ahead of UTC: always as far, or as the clocks of a place are (summer time)."""
Zone = Literal["utc", "unknown"]

_DATE_AND_TIME = r"(\d{4})[-_]?(\d{2})[-_]?(\d{2})[-_T ]*(\d{2})[-_:h]?(\d{2})[-_:m]?(\d{2})(\.\d{1,6})?"
_COMPACT = r"(\d{4})(\d{2})(\d{2})(\d{2})(\d{2})(\d{2})()"
_PARTED = r"(\d{4})(\d{2})(\d{2})_(\d{2})(\d{2})(\d{2})()"
_DAY_OR_MONTH_FIRST = re.compile(
    r"(?<!\d)(\d{2})[-_.]?(\d{2})[-_.]?((?:19|20)\d{2})[-_T. ]+(\d{2})[-_:h.]?(\d{2})[-_:m.]?(\d{2})(?!\d)"
)


_FIRST_YEAR, _LAST_YEAR = 1900, 2199
"""Photographs of the sky have been taken since; the positions of sun and planets hold for them."""


def is_of_images(time: datetime) -> bool:
    """Return whether a time is within the years 1900 to 2199: others are of damaged names, headers and clocks."""
    return _FIRST_YEAR <= time.year <= _LAST_YEAR


class NameFamily(NamedTuple):
    """Names of one kind of camera or archive: what precedes the time tells cameras apart."""

    name: str
    pattern: re.Pattern[str]
    zone: Zone


class NamedTime(NamedTuple):
    """What a name states: its family, what precedes the time, the time as it is written, and whether that is UTC."""

    family: str
    prefix: str
    time: datetime
    zone: Zone

    def utc(self, offset: UtcOffset, *, name: str) -> datetime:
        """Return the time in UTC; a time of unknown zone is `offset` ahead of it (see `utc_of_local`)."""
        return self.time.replace(tzinfo=UTC) if self.zone == "utc" else utc_of_local(self.time, offset, name=name)


def utc_of_local(written: datetime, offset: UtcOffset, *, name: str) -> datetime:
    """Return the UTC time of a file's local one.

    Parameters
    ----------
    written : without a zone.
    offset : how far it is ahead of UTC.
    name : of the file.

    Raises
    ------
    RefusedImageError : the place's clocks showed it twice or never, as they were set at a change of summer time.
    OverflowError : it is before the year 1 or after 9999.
    """
    if isinstance(offset, timedelta):
        return written.replace(tzinfo=UTC) - offset
    first, second = (written.replace(tzinfo=offset, fold=fold) for fold in (0, 1))
    if first.utcoffset() == second.utcoffset():
        return first.astimezone(UTC)
    shown = first.astimezone(UTC).astimezone(offset).replace(tzinfo=None) == written
    data = {"written": written.isoformat(timespec="seconds"), "zone": str(offset)}
    raise RefusedImageError(name, Finding("file_time_twice" if shown else "file_time_never", data))


def utc_offset_of(given: str | float, *, field: str) -> UtcOffset:
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


def _family(name: str, pattern: str, zone: Zone = "unknown") -> NameFamily:
    return NameFamily(name, re.compile(pattern), zone)


FAMILIES = (
    _family("ARM", r"^(\w+\.\w\d\.)(\d{4})(\d{2})(\d{2})\.(\d{2})(\d{2})(\d{2})()\.\w+(?:\.\d{14}\.\w+)?$", "utc"),
    _family("RMS", r"^(FF_?\w+?_)(\d{4})(\d{2})(\d{2})_(\d{2})(\d{2})(\d{2})(_\d{3})_\d+\.", "utc"),
    _family("Allsky", rf"^(image-){_COMPACT}\."),
    _family("indi-allsky", rf"^(ccd\d+_){_PARTED}\."),
    _family("EKO", rf"^(){_COMPACT}_1[12]\."),
    _family("Eye2Sky", rf"^(){_PARTED}_\d+\."),
    _family("SKIPP'D or TSI", rf"^(){_COMPACT}\."),
)
"""Known families, the most specific first."""
_ANY_UTC = _family("date and time, UTC", rf"^(.*?){_DATE_AND_TIME}Z", "utc")
_ANY = _family("date and time", rf"^(.*?){_DATE_AND_TIME}")


def time_in_name(name: str) -> NamedTime | None:
    """Return the time in a file's name, by the first family that it is of; None where it states none."""
    for family in (*FAMILIES, _ANY_UTC, _ANY):
        match = family.pattern.search(name)
        if match is None:
            continue
        prefix, *numbers, fraction = match.groups()
        try:
            time = datetime(*(int(number) for number in numbers), tzinfo=UTC)  # type: ignore[misc,arg-type]
        except ValueError:
            continue
        if not is_of_images(time):
            continue
        time += timedelta(seconds=float((fraction or "0").replace("_", "0.")))
        return NamedTime(family.name, prefix, time.replace(tzinfo=None), family.zone)
    return None


def ambiguous_dates(name: str) -> tuple[str, str] | None:
    """Return the day-first and the month-first reading of a name whose date ends with the year; None for others.

    A reading that is no date is "-".
    """
    match = _DAY_OR_MONTH_FIRST.search(name)
    if match is None:
        return None
    first, second, year, *clock = (int(number) for number in match.groups())
    return _reading(year, second, first, clock), _reading(year, first, second, clock)


def _reading(year: int, month: int, day: int, clock: list[int]) -> str:
    try:
        return datetime(year, month, day, *clock).isoformat()  # type: ignore[arg-type] # noqa: DTZ001 - a name
    except ValueError:
        return "-"


def no_time_finding(name: str) -> Finding:
    """Return why nothing states the time of a file."""
    readings = ambiguous_dates(name)
    if readings is None:
        return Finding("file_time_unknown")
    return Finding("file_time_ambiguous", {"day_first": readings[0], "month_first": readings[1]})


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
    except (ValueError, KeyError, AttributeError, OverflowError, RecursionError):
        raise RefusedImageError(name, Finding("file_sidecar", {"error": "no JSON with time_utc"})) from None


def _exposure(value: object, *, where: str) -> float | None:
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
    text = details.get(ExifTags.Base.DateTimeOriginal) or tags.get(ExifTags.Base.DateTime)
    zone = details.get(ExifTags.Base.OffsetTimeOriginal)
    try:
        time = datetime.strptime(str(text), "%Y:%m:%d %H:%M:%S")  # noqa: DTZ007 - the zone follows, if there is one
        return datetime.fromisoformat(time.isoformat() + str(zone)).astimezone(UTC) if zone else time
    except (ValueError, OverflowError):
        return None


_MOBOTIX = re.compile(
    rb"PRD=MOBOTIX.*?DAT=(\d{4}-\d{2}-\d{2}).*?TIM=(\d{2}:\d{2}:\d{2}(?:\.\d+)?).*?TZN=(?:GMT|UTC)([+-]\d{1,2})?\b",
    re.DOTALL,
)
_HEADER_FAMILIES = {"fits": "FITS header", "netcdf": "NetCDF time", "video": "video"}


class TimeRules(NamedTuple):
    """How times are read.

    pattern: `strptime` pattern of the names without suffix. offset: how far times without a zone are ahead of UTC; None
    refuses them. documents: whether a picture's head is read for the document of our own composites.
    """

    pattern: str | None = None
    offset: UtcOffset | None = None
    documents: bool = False


class TimedFrame(NamedTuple):
    """An image of a file: its number, mid-exposure time (aware, UTC), exposure, and what states the time.

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
    RefusedImageError : nothing states the time, or nothing states its zone.
    """
    kind, path = kind_of(name), PurePosixPath(name)
    if kind == "picture":
        return [timed_picture(source, name, rules, names=names)]
    sidecar_name = path.with_suffix(".json").as_posix()
    frames = frames_in(source, name, sidecar=lambda: source.read(sidecar_name) if sidecar_name in names else None)
    named = time_in_name(path.name)
    family = _HEADER_FAMILIES[str(kind)]
    return [_in_range(_of_header(frame, name, named, rules, family=family), name) for frame in frames]


def _in_range(frame: TimedFrame, name: str) -> TimedFrame:
    if is_of_images(frame.time):
        return frame
    written = frame.time.isoformat(timespec="seconds")
    raise RefusedImageError(name, Finding("file_time_range", {"written": written}))


def timed_picture(source: ImageSource, name: str, rules: TimeRules, *, names: Collection[str]) -> TimedFrame:
    """Return the image of a picture with its time; see `timed_frames`."""
    return _in_range(_timed_picture(source, name, rules, names=names), name)


def _timed_picture(source: ImageSource, name: str, rules: TimeRules, *, names: Collection[str]) -> TimedFrame:
    path = PurePosixPath(name)
    sidecar_name = path.with_suffix(".json").as_posix()
    named = time_in_name(path.name)
    prefix = "" if named is None else named.prefix
    if rules.pattern is not None:
        return _by_pattern(path, rules, prefix)
    if sidecar_name in names:
        time, exposure_us = sidecar_time(content_of(source, sidecar_name), sidecar_name, exposure_of_name(path.name))
        return TimedFrame(0, time, exposure_us, "sidecar", prefix)
    composed = _of_document(source, name) if rules.documents else None
    if composed is not None:
        return TimedFrame(0, composed, exposure_of_name(path.name), "document", prefix)
    return _of_picture(source, name, named, rules)


def _of_document(source: ImageSource, name: str) -> datetime | None:
    """Return the time that one of our own composites states; None for other pictures. A preview is refused."""
    stated = document_in(source, name).get("time_utc")
    try:
        return None if stated is None else parse_time(str(stated), where=name)
    except InputError:
        return None


def _by_pattern(path: PurePosixPath, rules: TimeRules, prefix: str) -> TimedFrame:
    pattern = str(rules.pattern)
    try:
        time = datetime.strptime(path.stem, pattern)  # noqa: DTZ007 - the zone follows
    except (ValueError, OverflowError):
        raise RefusedImageError(path.name, Finding("file_time_pattern", {"pattern": pattern})) from None
    return TimedFrame(0, _in_utc(time, path.name, rules), exposure_of_name(path.name), "pattern", prefix)


def _of_picture(source: ImageSource, name: str, named: NamedTime | None, rules: TimeRules) -> TimedFrame:
    exposure_us = exposure_of_name(name)
    prefix = "" if named is None else named.prefix
    if named is not None and (named.zone == "utc" or rules.offset is not None):
        return TimedFrame(0, _utc(named, name, rules), exposure_us, named.family, prefix)
    found = _from_header(content_of(source, name))
    if found is not None and (found[0].tzinfo is not None or named is None):
        return TimedFrame(0, _in_utc(found[0], name, rules), exposure_us, found[1], prefix)
    if named is None:
        raise RefusedImageError(name, no_time_finding(PurePosixPath(name).name))
    return TimedFrame(0, _utc(named, name, rules), exposure_us, named.family, prefix)


def _of_header(frame: FileImage, name: str, named: NamedTime | None, rules: TimeRules, *, family: str) -> TimedFrame:
    """Return a frame with the time of its file's header, or of its name where it has none."""
    prefix = "" if named is None else named.prefix
    if frame.time is not None:
        return TimedFrame(frame.number, frame.time, frame.exposure_us, family, prefix)
    if named is None:
        raise RefusedImageError(name, Finding("file_time_unknown"))
    return TimedFrame(frame.number, _utc(named, name, rules), frame.exposure_us, named.family, prefix)


def _from_header(content: bytes) -> tuple[datetime, str] | None:
    """Return the time in a picture's header, naive where that has no zone, and which header it is."""
    match = _MOBOTIX.search(content[: 1 << 16])
    if match is not None:
        date, clock, hours = (part.decode() if part else "0" for part in match.groups())
        with suppress(ValueError, OverflowError):  # digits that are no date
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


def _in_utc(time: datetime, name: str, rules: TimeRules) -> datetime:
    if time.tzinfo is None and rules.offset is None:
        raise _unknown_zone(name, time)
    try:
        if time.tzinfo is not None or rules.offset is None:
            return time.astimezone(UTC)
        return utc_of_local(time, rules.offset, name=name)
    except OverflowError:
        raise RefusedImageError(name, Finding("file_time_unknown")) from None


def _unknown_zone(name: str, time: datetime) -> RefusedImageError:
    return RefusedImageError(name, Finding("file_time_zone", {"written": time.isoformat(timespec="seconds")}))
