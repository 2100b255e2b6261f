"""Times in the names of image files, by the patterns of cameras and archives that are known.

Sources: ARM, https://www.arm.gov (datastreams, as `sgptsiskyimageC1.a1.20130513.123000.jpg`; ordered files repeat the
time at the end); RMS, https://github.com/CroatianMeteorNetwork/RMS (`FF_CODE_date_time_ms_frame.fits`); indi-allsky,
https://github.com/aaronwmorris/indi-allsky (`ccd1_date_time.jpg`); Allsky, https://github.com/AllskyTeam/allsky
(`image-datetime.jpg`); Eye2Sky, https://eye2sky.de/data/data_description (`date_time_EXPOSURE.jpg`); EKO ASI-16
(`datetime_11.jpg`, the last number for the exposure); SKIPP'D and TSI (`datetime.jpg`).
"""

from __future__ import annotations

import math
import re
from datetime import UTC, datetime, timedelta
from typing import Literal, NamedTuple, TypeAlias
from zoneinfo import ZoneInfo

from sunarc.errors import InputError
from sunarc.findings import Finding
from sunarc.offline.messages import RefusedImageError

UtcOffset: TypeAlias = timedelta | ZoneInfo
"""How far written times are ahead of UTC: always as far, or as the clocks of a place are (summer time)."""
Zone = Literal["utc", "unknown"]

_DATE_AND_TIME = r"(\d{4})[-_]?(\d{2})[-_]?(\d{2})[-_T ]*(\d{2})[-_:h]?(\d{2})[-_:m]?(\d{2})(\.\d{1,6})?"
_COMPACT = r"(\d{4})(\d{2})(\d{2})(\d{2})(\d{2})(\d{2})()"
_PARTED = r"(\d{4})(\d{2})(\d{2})_(\d{2})(\d{2})(\d{2})()"
_DAY_OR_MONTH_FIRST = re.compile(
    r"(?<!\d)(\d{2})[-_.]?(\d{2})[-_.]?((?:19|20)\d{2})[-_T. ]+(\d{2})[-_:h.]?(\d{2})[-_:m.]?(\d{2})(?!\d)"
)


class NameFamily(NamedTuple):
    """Names of one kind of camera or archive: what precedes the time tells cameras apart."""

    name: str
    pattern: re.Pattern[str]
    zone: Zone


class NamedTime(NamedTuple):
    """What a name tells: its family, what precedes the time, the time as it is written, and whether that is UTC."""

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
    """Return the time in a file's name, by the first family that it is of; None where it tells none."""
    for family in (*FAMILIES, _ANY_UTC, _ANY):
        match = family.pattern.search(name)
        if match is None:
            continue
        prefix, *numbers, fraction = match.groups()
        try:
            time = datetime(*(int(number) for number in numbers), tzinfo=UTC)  # type: ignore[misc,arg-type]
        except ValueError:
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
