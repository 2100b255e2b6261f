"""Times in the names of image files, by the patterns of cameras and archives that are known.

Sources: ARM, https://www.arm.gov (datastreams, as `sgptsiskyimageC1.a1.20130513.123000.jpg`; ordered files repeat the
time at the end); RMS, https://github.com/CroatianMeteorNetwork/RMS (`FF_CODE_date_time_ms_frame.fits`); indi-allsky,
https://github.com/aaronwmorris/indi-allsky (`ccd1_date_time.jpg`); Allsky, https://github.com/AllskyTeam/allsky
(`image-datetime.jpg`); Eye2Sky, https://eye2sky.de/data/data_description (`date_time_EXPOSURE.jpg`); EKO ASI-16
(`datetime_11.jpg`, the last number for the exposure); SKIPP'D and TSI (`datetime.jpg`).
"""

from __future__ import annotations

import re
from datetime import UTC, datetime, timedelta
from typing import Literal, NamedTuple

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

    def utc(self, offset: timedelta) -> datetime:
        """Return the time in UTC; a time of unknown zone is `offset` ahead of it.

        Raises
        ------
        OverflowError : it is before the year 1 or after 9999.
        """
        written = self.time.replace(tzinfo=UTC)
        return written if self.zone == "utc" else written - offset


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
