"""Times in the names of image files, read whole: fraction, half of the day and zone; an ambiguous name has no time.

Sources: ARM, https://www.arm.gov (datastreams; ordered files repeat the time at the end); RMS,
https://github.com/CroatianMeteorNetwork/RMS; indi-allsky, https://github.com/aaronwmorris/indi-allsky; Allsky,
https://github.com/AllskyTeam/allsky; Eye2Sky, https://eye2sky.de/data/data_description (`date_time_EXPOSURE`); EKO
ASI-16 (the last number for the exposure); Axis, Dahua: default names of uploads. `name_examples` has them all.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from datetime import UTC, datetime, timedelta
from pathlib import PurePosixPath
from typing import NamedTuple

from sunarc.common.findings import Finding

_FIRST_YEAR, _LAST_YEAR = 1970, 2100
"""No sky camera wrote files before."""


def is_plausible_time(time: datetime) -> bool:
    """Return whether a time is within the years 1970 to 2100: others are of damaged names, headers and clocks."""
    return _FIRST_YEAR <= time.year <= _LAST_YEAR


class NamedTime(NamedTuple):
    """Time in a name: its family, the text before it, the time as it is written, and how far ahead of UTC."""

    family: str
    prefix: str
    time: datetime
    ahead: timedelta | None


# Zones as they are written.

_ZONES = {
    "Z": 0.0, "UTC": 0.0, "GMT": 0.0, "CET": 1.0, "CEST": 2.0, "EET": 2.0, "EEST": 3.0, "SAST": 2.0, "AWST": 8.0,
    "ACST": 9.5, "ACDT": 10.5, "AEST": 10.0, "AEDT": 11.0, "NZST": 12.0, "NZDT": 13.0, "JST": 9.0, "KST": 9.0,
    "EDT": -4.0, "MDT": -6.0, "PDT": -7.0, "AKST": -9.0, "AKDT": -8.0,
}  # fmt: skip
"""Hours ahead of UTC by abbreviation (tz database): those of one meaning. CST, IST, BST, EST, PST, MST have several."""
_PARTS_OF_HOURS = {
    -570,
    -210,
    -150,
    210,
    270,
    330,
    345,
    390,
    525,
    570,
    630,
    765,
    825,
}
_IN_USE = {60 * hours for hours in range(-12, 15)} | _PARTS_OF_HOURS
"""Minutes that clocks of places are ahead of UTC (tz database, since 1970)."""
_HOURS = r"(?P<hours>\d{1,2})(?:[:_-]?(?P<minutes>00|15|30|45))?(?![0-9A-Za-z])"
_ZONE = re.compile(rf"(?:(?P<letters>[A-Z]{{1,5}})|(?P<base>UTC|GMT)?(?P<sign>[+-]){_HOURS})$", re.ASCII)


def parse_zone(text: str) -> timedelta | None:
    """Return how far a zone as "CEST", "+02:00" or "GMT+5:30" is ahead of UTC; None where that has not one sense."""
    found = _ZONE.match(text.strip().upper())
    if found is None:
        return None
    if found["letters"]:
        hours = _ZONES.get(found["letters"])
        return None if hours is None else timedelta(hours=hours)
    return _parse_offset(found)


def _parse_offset(found: re.Match[str]) -> timedelta | None:
    """Return the time of a zone; None where no place's clocks are so far ahead."""
    minutes = 60 * int(found["hours"]) + int(found["minutes"] or 0)
    signed = -minutes if found["sign"] == "-" else minutes
    return timedelta(minutes=signed) if signed in _IN_USE else None


# Names of known families.

_COMPACT = r"(\d{4})(\d{2})(\d{2})(\d{2})(\d{2})(\d{2})()"
_PARTED = r"(\d{4})(\d{2})(\d{2})_(\d{2})(\d{2})(\d{2})()"
_SUFFIX = r"\.[A-Za-z]\w*$"


class NameFamily(NamedTuple):
    """Names of one kind of camera or archive: the text before the time tells cameras apart.

    A pattern with "/" is of the path below the source.
    """

    name: str
    pattern: re.Pattern[str]
    ahead: timedelta | None


def _make_family(name: str, pattern: str, ahead: timedelta | None = None) -> NameFamily:
    return NameFamily(name, re.compile(pattern, re.ASCII), ahead)


FAMILIES = (
    _make_family(
        "ARM", r"^(\w+\.\w\d\.)(\d{4})(\d{2})(\d{2})\.(\d{2})(\d{2})(\d{2})()\.\w+(?:\.\d{14}\.\w+)?$", timedelta(0)
    ),
    _make_family("RMS", r"^(FF_?\w+?_)(\d{4})(\d{2})(\d{2})_(\d{2})(\d{2})(\d{2})(_\d{3})_\d+\.", timedelta(0)),
    _make_family("Allsky", rf"^(image-){_COMPACT}{_SUFFIX}"),
    _make_family("indi-allsky", rf"^(ccd\d+_){_PARTED}{_SUFFIX}"),
    # years of two digits: the date's order is that of the camera
    _make_family("Axis", rf"^(image|snapshot)(\d\d)-(\d\d)-(\d\d)_(\d\d)-(\d\d)-(\d\d)(-\d\d)(?:_\d+)?{_SUFFIX}"),
    _make_family(
        "Dahua",
        r"^((?:.*/)?)(\d{4})-(\d\d)-(\d\d)/(?:\d{3}/jpg|pic_\d{3})/(\d\d)[/.](\d\d)[/.](\d\d)()"
        r"\[[A-Z]+\]\[\d+@\d+\]\[\d+\]\.jpe?g$",
    ),
    _make_family("EKO", rf"^(){_COMPACT}_1[12]{_SUFFIX}"),
    _make_family("Eye2Sky", rf"^(){_PARTED}_\d+{_SUFFIX}"),
    _make_family("SKIPP'D or TSI", rf"^(){_COMPACT}{_SUFFIX}"),
)
"""Known families, the most specific first."""


def _match_family(path: str) -> NamedTime | None:
    for family in FAMILIES:
        match = family.pattern.search(path if "/" in family.pattern.pattern else PurePosixPath(path).name)
        if match is not None:
            prefix, year, *numbers, fraction = match.groups()
            time = _parse_numbers([year if len(year) == 4 else f"20{year}", *numbers])
            if time is not None:
                time += timedelta(seconds=float(f"0.{fraction[1:] or 0}"))
                return NamedTime(family.name, prefix, time, family.ahead)
    return None


def _parse_numbers(numbers: list[str]) -> datetime | None:
    """Return year to second as a time; None where they are no time of images."""
    try:
        time = datetime(*(int(number) for number in numbers))  # type: ignore[arg-type] # noqa: DTZ001 - of a name
    except ValueError:
        return None
    return time if is_plausible_time(time) else None


# Any other names.

_WHEN = re.compile(
    r"(?<!\d)(\d{4})(?P<dash>[-_]?)(\d{2})(?P=dash)(\d{2})(?P<between>[-_T ]*)"
    r"(?:(\d{2})[-_:h](\d{2})[-_:m](\d{2})|(\d{2})(\d{2})(\d{2})(?P<run>\d{3}|\d{6})?)(?!\d)s?",
    re.ASCII,
)
_SIGNED = rf"(?P<base>UTC|GMT)?(?P<sign>[+-]){_HOURS}"
_REST = re.compile(
    r"(?P<fraction>[.,]\d+|[-_]\d{6}(?=Z|[+-]\d{2}))?"
    r"(?:[-_ ]?(?P<half>[AaPp])\.?[Mm](?![A-Za-z]))?"
    rf"(?:[-_ ]?(?:{_SIGNED}|(?P<letters>{'|'.join(sorted(_ZONES, key=len, reverse=True))})(?![0-9A-Za-z+])))?",
    re.ASCII,
)
_UNREAD_ZONE = re.compile(r"[-_ ]?(?:UTC|GMT)?\+\d|[-_ ]?(?:UTC|GMT)-\d", re.ASCII)
_YEAR_LAST = re.compile(
    r"(?<!\d)(\d{2})[-_.]?(\d{2})[-_.]?((?:19|20)\d{2})[-_T. ]+(\d{2})[-_:h.]?(\d{2})[-_:m.]?(\d{2})(?!\d)", re.ASCII
)
_SINCE_1970 = re.compile(r"(?<!\d)(?:(\d{2})(\d{2})(\d{2})(\d{2})(\d{2})|(\d{10})(\d{3}))(?!\d)", re.ASCII)
_SHORT_YEAR = re.compile(
    r"(?<!\d)(\d{2})(?P<dash>[-_.]?)(\d{2})(?P=dash)(\d{2})[-_T ]?(\d{2})[-_:h.]?(\d{2})[-_:m.]?(\d{2})(?!\d)", re.ASCII
)


def time_in_name(path: str) -> NamedTime | None:
    """Return the time in a file's name, or in its path below its source where a camera's folders have the date.

    None where it states none, or has more than one reading.
    """
    named = _match_family(path)
    if named is not None:
        return named
    name = PurePosixPath(path).name
    if _find_year_last(name) is not None:
        return None
    readings = _list_readings(name)
    return readings[0] if len({(one.time, one.ahead) for one in readings}) == 1 else None


def ambiguous_times(name: str) -> tuple[str, str] | None:
    """Return two readings of a name that has more than one; None for others. A reading that is no time is "-"."""
    last = _find_year_last(name)
    if last is not None:
        return _show_time(last[0]), _show_time(last[1])
    found = list(dict.fromkeys(_show_time(one.time, one.ahead) for one in _list_readings(name)))
    if len(found) > 1:
        return found[0], found[1]
    return None if found else _find_short_year(name) or _find_epoch_digits(name)


def _find_short_year(name: str) -> tuple[str, str] | None:
    """Return a date whose year has two digits, the year first and the year last; None without one."""
    for match in _SHORT_YEAR.finditer(name):
        first, month, last, *clock = match.group(1, 3, 4, 5, 6, 7)
        times = [_parse_numbers([f"20{year}", month, day, *clock]) for year, day in ((first, last), (last, first))]
        if any(times):
            return _show_time(times[0]), _show_time(times[1])
    return None


def _find_epoch_digits(name: str) -> tuple[str, str] | None:
    """Return digits read as seconds or milliseconds since 1970, and as a date of ten digits; None without them."""
    digits = _SINCE_1970.search(name)
    if digits is None:
        return None
    at = datetime.fromtimestamp(int(digits[0][:10]), UTC).replace(tzinfo=None)
    short = None if digits[6] else _parse_numbers([f"20{digits[1]}", *digits.group(2, 3, 4, 5), "0"])
    return _show_time(at), _show_time(short)


def _find_year_last(name: str) -> tuple[datetime | None, datetime | None] | None:
    """Return a date that ends with its year and its time, the day first and the month first; None without one.

    Digits before a year that begins a date and a time (`cam-10-12-2023-06-20-19-45-00`) are of something else.
    """
    for match in _YEAR_LAST.finditer(name):
        begun = _WHEN.match(name, match.start(3))
        if begun is not None and _parse_numbers(_get_numbers(begun)) is not None:
            continue
        first, second, year, *clock = match.groups()
        day_first, month_first = (
            _parse_numbers([year, second, first, *clock]),
            _parse_numbers([year, first, second, *clock]),
        )
        if day_first is not None or month_first is not None:
            return day_first, month_first
    return None


def _get_numbers(match: re.Match[str]) -> list[str]:
    return [one for one in match.group(1, 3, 4, 6, 7, 8, 9, 10, 11) if one is not None]


def _show_time(time: datetime | None, ahead: timedelta | None = None) -> str:
    if time is None:
        return "-"
    return (time if ahead is None else time.replace(tzinfo=UTC) - ahead).isoformat(timespec="seconds")


def _list_readings(name: str) -> list[NamedTime]:
    """Return the possible readings of a name's dates and times, each with its rest read to the end."""
    found = list[NamedTime]()
    for match in _WHEN.finditer(name):
        time, rest = _parse_numbers(_get_numbers(match)), _REST.match(name, match.end())
        if time is None or rest is None:
            continue
        clock = [_apply_half_day(time, rest["half"])] if rest["half"] else [time]
        seconds = float(f"0.{match['run']}") if match["run"] else float("0." + (rest["fraction"] or "-0")[1:])
        iso = "T" in match["between"]
        for at in clock:
            for ahead in _list_zones(rest, name, iso=iso):
                utc = ahead == timedelta(0)
                family = "date and time, UTC" if utc else "date and time"
                prefix = name[: match.start()]
                if at is not None:
                    found.append(NamedTime(family, prefix, at + timedelta(seconds=seconds), ahead))
    return found


def _apply_half_day(time: datetime, half: str) -> datetime | None:
    """Return the time of a clock of 12 hours; None where it shows another hour."""
    if not 1 <= time.hour <= 12:
        return None
    return time.replace(hour=time.hour % 12 + (12 if half in "Pp" else 0))


def _list_zones(rest: re.Match[str], name: str, *, iso: bool) -> Iterator[timedelta | None]:
    """Yield the possible zones after a time (None: none is written), two where the end may be a number of images."""
    if rest["letters"]:
        yield timedelta(hours=_ZONES[rest["letters"]])
    elif rest["sign"] is None:
        if not _UNREAD_ZONE.match(name, rest.end()):
            yield None
    else:
        yield from _list_signed_offsets(rest, iso=iso)


def _list_signed_offsets(rest: re.Match[str], *, iso: bool) -> Iterator[timedelta | None]:
    ahead, whole = _parse_offset(rest), rest["minutes"] is not None and len(rest["hours"]) == 2
    if rest["sign"] == "+":
        if ahead is not None:
            yield ahead
    elif rest["base"]:
        if not whole:
            yield timedelta(0)
        if ahead is not None:
            yield ahead
    else:
        # -0500 may be a zone or the image's number, -05 is a zone in ISO 8601 alone
        if not (whole and iso and ahead):
            yield None
        if ahead and len(rest["hours"]) == 2 and (whole or iso):
            yield ahead


def no_time_finding(name: str) -> Finding:
    """Return why nothing states the time of a file."""
    readings = ambiguous_times(name)
    if readings is None:
        return Finding("file_time_unknown")
    return Finding("file_time_ambiguous", {"first": readings[0], "second": readings[1]})
