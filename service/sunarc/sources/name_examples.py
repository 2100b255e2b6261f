"""One table of the times in names: whose they are, an example each, and its time; tests and a page are made of it."""

from __future__ import annotations

from typing import NamedTuple

from sunarc.sources.time_patterns import DIRECTIVES


class NameExample(NamedTuple):
    """A name as a camera or program writes it."""

    writers: str
    name: str
    """With the folders that state a part of its time."""
    time: str
    """As it is read, RFC 3339 with a zone where the name has one; of a name that is not read by itself the true one."""
    pattern: str | None = None
    """By which it is read; None where it is read without one."""
    why: str = ""
    """Why it is not read by itself."""


_ORDER = "day and month may be exchanged"
_SHORT = "of a year with two digits the order is not known"
_FOLDERS = "a folder may be a night, which has two dates"
_NO_YEAR = "it has no year; the header's time is read"
EXAMPLES = (
    NameExample("ARM", "sgptsiskyimageC1.a1.20240611.064800.jpg", "2024-06-11T06:48:00Z"),
    NameExample("RMS", "FF_HR0001_20240611_064800_250_0000000.fits", "2024-06-11T06:48:00.25Z"),
    NameExample("AllskyTeam", "image-20240611064800.jpg", "2024-06-11T06:48:00"),
    NameExample("indi-allsky", "ccd1_20240611_064800.jpg", "2024-06-11T06:48:00"),
    NameExample("EKO ASI-16", "20240611064800_11.jpg", "2024-06-11T06:48:00"),
    NameExample("Eye2Sky (in UTC)", "20240611_064800_160.jpg", "2024-06-11T06:48:00"),
    NameExample("SKIPP'D, TSI", "20240611064800.jpg", "2024-06-11T06:48:00"),
    NameExample("Axis", "image24-06-11_06-48-00-53.jpg", "2024-06-11T06:48:00.53"),
    NameExample("Dahua, Amcrest", "2024-06-11/001/jpg/06/48/00[M][0@0][0].jpg", "2024-06-11T06:48:00"),
    NameExample("Dahua, hours as folders", "2024-06-11/001/jpg/06/48.00[M][0@0][0].jpg", "2024-06-11T06:48:00"),
    NameExample("Dahua, one folder a day", "2024-06-11/pic_001/06.48.00[R][0@0][0].jpg", "2024-06-11T06:48:00"),
    NameExample("Hikvision", "192.168.1.64_01_20240611064800123_TIMING.jpg", "2024-06-11T06:48:00.123"),
    NameExample("Reolink", "2024/06/11/Roof_00_20240611064800.jpg", "2024-06-11T06:48:00"),
    NameExample("Foscam", "MDAlarm_20240611-064800.jpg", "2024-06-11T06:48:00"),
    NameExample("date and time", "roof-2024-06-11_06-48-00.jpg", "2024-06-11T06:48:00"),
    NameExample("… of 12 hours", "cam_2024-06-11_06-48-00_PM.jpg", "2024-06-11T18:48:00"),
    NameExample("… with Z", "20240611T064800Z.png", "2024-06-11T06:48:00Z"),
    NameExample("… with a zone", "20240611T064800+0200.png", "2024-06-11T06:48:00+02:00"),
    NameExample("… with a zone's letters", "2024-06-11_06-48-00_CEST.jpg", "2024-06-11T06:48:00+02:00"),
    NameExample("folders of days", "2024/06/11/064800.jpg", "2024-06-11T06:48:00", "%Y/%m/%d/%H%M%S", _FOLDERS),
    NameExample("folders of days", "20240611/06-48-00.jpg", "2024-06-11T06:48:00", "%Y%m%d/%H-%M-%S", _FOLDERS),
    NameExample("date that ends with its year", "11-06-2024_06-48-00.jpg", "2024-06-11T06:48:00",
                "%d-%m-%Y_%H-%M-%S", _ORDER),
    NameExample("two-digit year", "cam7_240611_064800.jpg", "2024-06-11T06:48:00", "cam*_%y%m%d_%H%M%S", _SHORT),
    NameExample("day of the year", "sky_2024163_0648.jpg", "2024-06-11T06:48:00", "sky_%Y%j_%H%M", "it has no month"),
    NameExample("seconds since 1970: `rpicam-still --timestamp`, `raspistill -ts`", "img_1718088480.jpg",
                "2024-06-11T06:48:00Z", "img_%s", "ten digits may be a date or a number"),
    NameExample("milliseconds since 1970", "1718088480123.jpg", "2024-06-11T06:48:00.123Z", "%s",
                "its digits may be a number"),
    NameExample("12 hours by a pattern", "Jun 11, 2024 06.48.00 PM.jpg", "2024-06-11T18:48:00",
                "%b %d, %Y %I.%M.%S %p", "it has no month in digits"),
    NameExample("month, day and time: `rpicam-still --datetime`, `raspistill -dt`", "0611064800.jpg", "", None,
                _NO_YEAR),
    NameExample("Mobotix", "m00017.jpg", "", None, "it has no time; the header's is read"),
)  # fmt: skip
"""Names that are read, names that a pattern reads, and names without a whole time."""


def names_as_markdown() -> str:
    """Return the page of the table: docs/operating/names.md."""
    read = [one for one in EXAMPLES if not one.why]
    by_pattern = [one for one in EXAMPLES if one.pattern is not None]
    neither = [one for one in EXAMPLES if one.why and one.pattern is None]
    lines = [
        "# Times in names",
        "",
        "A time that a name states is read whole, or the file is left out: `file_time_unknown`, or",
        "`file_time_ambiguous` where it has two readings. A time without a zone needs `--utc-offset`.",
        "",
        "## Read as they are",
        "",
        "| written by | example | time |",
        "|---|---|---|",
        *(f"| {one.writers} | `{one.name}` | {one.time} |" for one in read),
        "",
        "What precedes the time tells cameras apart.",
        "",
        "## Read by `--time-pattern`",
        "",
        "| names | example | pattern | time | why not by itself |",
        "|---|---|---|---|---|",
        *(f"| {one.writers} | `{one.name}` | `{one.pattern}` | {one.time} | {one.why} |" for one in by_pattern),
        *(f"| {one.writers} | `{one.name}` | – | – | {one.why} |" for one in neither),
        "",
        "A pattern is of the name without its ending, and of as many folders before it as it has. It states a date",
        "and an hour. `*` stands for any letters but `/`; where two parts state the same they have to agree.",
        "",
        "| in a pattern | is |",
        "|---|---|",
        *(f"| `%{letter}` | {meaning} |" for letter, (_, meaning) in DIRECTIVES.items()),
    ]
    return "\n".join(lines) + "\n"
