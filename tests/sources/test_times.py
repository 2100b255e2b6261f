"""When an image was taken: names of known cameras, sidecars and headers; what is doubtful is refused."""

from __future__ import annotations

import random
import re
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any
from zoneinfo import ZoneInfo

import pytest
from tests.archives.test_ingest_times import TAKEN, ZONE, taken, with_exif
from tests.fixtures.packed_archives import GREY, encoded, folder_of
from tests.sources.test_frames import fits_of

from sunarc.common.errors import InputError
from sunarc.common.findings import FindingError
from sunarc.sources.file_kinds import path_stem
from sunarc.sources.image_times import (
    TimedFrame,
    TimeRules,
    parse_utc_offset,
    timed_frames,
)
from sunarc.sources.name_examples import EXAMPLES, NameExample, names_as_markdown
from sunarc.sources.name_times import ambiguous_times, parse_zone, time_in_name
from sunarc.sources.sources import open_source
from sunarc.sources.time_patterns import checked_pattern, time_pattern

NOON = datetime(2013, 5, 13, 18, 30, tzinfo=UTC)
NAMES = {
    "sgptsiskyimageC1.a1.20130513.183000.jpg": ("ARM", "sgptsiskyimageC1.a1.", "utc"),
    "sgptsiskyimageC1.a1.20130513.183000.jpg.20130513183000.jpg": ("ARM", "sgptsiskyimageC1.a1.", "utc"),
    "FF_HR0001_20130513_183000_250_0000000.fits": ("RMS", "FF_HR0001_", "utc"),
    "image-20130513183000.jpg": ("Allsky", "image-", "unknown"),
    "ccd1_20130513_183000.jpg": ("indi-allsky", "ccd1_", "unknown"),
    "20130513183000_11.jpg": ("EKO", "", "unknown"),
    "20130513_183000_160.jpg": ("Eye2Sky", "", "unknown"),
    "20130513183000.jpg": ("SKIPP'D or TSI", "", "unknown"),
    "20130513T183000Z.png": ("date and time, UTC", "", "utc"),
    "roof7_2013-05-13_18-30-00.png": ("date and time", "roof7_", "unknown"),
    "1234_2013-05-13_18-30-00.jpg": ("date and time", "1234_", "unknown"),
    "cam0001_2013-05-13_18-30-00.jpg": ("date and time", "cam0001_", "unknown"),
    "192.168.10.20_2013-05-13_18-30-00.jpg": ("date and time", "192.168.10.20_", "unknown"),
    "cam-10-12-2013-05-13-18-30-00.jpg": ("date and time", "cam-10-12-", "unknown"),
    "1012_20130513_183000Z.jpg": ("date and time, UTC", "1012_", "utc"),
}


def frame_of(name: str, folder: Path, *, content: bytes | None = None, **rules: Any) -> TimedFrame:  # noqa: ANN401 - as `TimeRules`
    picture = encoded(GREY, ".png") if content is None else content
    source = open_source(str(folder_of({name: picture}, folder)))
    names = {file.name for file in source.files()}
    (frame,) = timed_frames(source, name, TimeRules(**rules), names=names)
    return frame


def code_of(name: str, folder: Path, **more: object) -> str:
    with pytest.raises(FindingError) as refused:
        frame_of(name, folder, **more)  # type: ignore[arg-type]
    return refused.value.finding.code


@pytest.mark.parametrize("name", NAMES)
def test_names_of_known_cameras_tell_time_family_and_camera(name: str) -> None:
    named = time_in_name(name)
    assert named is not None
    assert (named.family, named.prefix, "unknown" if named.ahead is None else "utc") == NAMES[name]
    fraction = timedelta(milliseconds=250) if named.family == "RMS" else timedelta(0)
    assert named.time == NOON.replace(tzinfo=None) + fraction


@pytest.mark.parametrize("name", [name for name in NAMES if not name.endswith(".fits")])
def test_a_name_without_a_zone_needs_an_offset_and_one_in_utc_ignores_it(name: str, tmp_path: Path) -> None:
    hours = timedelta(hours=2)
    if NAMES[name][2] == "utc":
        assert frame_of(name, tmp_path).time == frame_of(name, tmp_path, offset=hours).time == NOON
    else:
        assert code_of(name, tmp_path) == "file_time_zone"
        assert frame_of(name, tmp_path, offset=hours).time == NOON - hours
        assert frame_of(name, tmp_path, offset=timedelta(0)).time == NOON


@pytest.mark.parametrize(
    ("name", "readings"),
    [
        ("05-06-2013_12-30-00.jpg", ("2013-06-05T12:30:00", "2013-05-06T12:30:00")),
        ("13.05.2013 12.30.00.jpg", ("2013-05-13T12:30:00", "-")),
        ("cam_05132013_123000.jpg", ("-", "2013-05-13T12:30:00")),
        ("20-06-2023_19-45-00.jpg", ("2023-06-20T19:45:00", "-")),
        ("cam0001_05-06-2013_12-30-00.jpg", ("2013-06-05T12:30:00", "2013-05-06T12:30:00")),
        ("05-06-2013-12-10-09-123456.jpg", ("2013-06-05T12:10:09", "2013-05-06T12:10:09")),
        ("05-06-2013-12-10-09-17.jpg", ("2013-06-05T12:10:09", "2013-05-06T12:10:09")),
        ("05062013_12_10_09_10_11.jpg", ("2013-06-05T12:10:09", "2013-05-06T12:10:09")),
        ("34-56-2013_12-30-00.jpg", None),
        ("20130513_123000.jpg", None),
        ("sky.jpg", None),
    ],
)
def test_a_date_that_ends_with_its_year_is_ambiguous(
    name: str, readings: tuple[str, str] | None, tmp_path: Path
) -> None:
    assert ambiguous_times(name) == readings
    if readings is not None:
        assert code_of(name, tmp_path) == "file_time_ambiguous"


def test_a_pattern_goes_before_everything(tmp_path: Path) -> None:
    (tmp_path / "05-06-2013_18-30-00.json").write_text('{"time_utc": "2001-01-01T00:00:00Z"}')
    frame = frame_of("05-06-2013_18-30-00.png", tmp_path, pattern="%d-%m-%Y_%H-%M-%S", offset=timedelta(hours=1))
    assert frame.time == datetime(2013, 6, 5, 17, 30, tzinfo=UTC)
    assert code_of("05-06-2013_18-30-00.png", tmp_path, pattern="%d-%m-%Y_%H-%M-%S") == "file_time_zone"
    assert code_of("sky.png", tmp_path, pattern="%d-%m-%Y_%H-%M-%S") == "file_time_pattern"


def test_a_sidecar_goes_before_the_name_and_tells_the_exposure(tmp_path: Path) -> None:
    (tmp_path / "20010101000000.json").write_text('{"time_utc": "2013-05-13T18:30:00Z", "exposure_us": 20}')
    frame = frame_of("20010101000000.png", tmp_path)
    assert (frame.time, frame.exposure_us, frame.family) == (NOON, 20.0, "sidecar")
    (tmp_path / "20010101000000.json").write_text("{}")
    assert code_of("20010101000000.png", tmp_path) == "file_sidecar"


def test_a_header_with_a_zone_stands_in_for_the_names_missing_one(tmp_path: Path) -> None:
    name = "20130513143000.jpg"
    content = with_exif(tmp_path / "exif.jpg", {TAKEN: "2013:05:13 14:30:00", ZONE: "-04:00"}).read_bytes()
    frame = frame_of(name, tmp_path / "a", content=content)
    assert (frame.time, frame.family) == (NOON, "EXIF")
    unzoned = with_exif(tmp_path / "exif.jpg", {TAKEN: "2013:05:13 14:30:00"}).read_bytes()
    assert code_of(name, tmp_path / "a", content=unzoned) == "file_time_zone"
    assert frame_of(name, tmp_path / "a", content=unzoned, offset=timedelta(hours=-4)).time == NOON


@pytest.mark.parametrize(("zone", "clock"), [("GMT+1", "19:30:00.000"), ("GMT", "18:30:00.000"), ("GMT-5", "13:30:00")])
def test_a_mobotix_cameras_header_tells_time_and_zone(zone: str, clock: str, tmp_path: Path) -> None:
    picture = encoded(GREY, ".jpg")
    text = f"#:M1IMG\nPRD=MOBOTIX\nDAT=2013-05-13\nTIM={clock}\nTZN={zone}\n".encode()
    comment = b"\xff\xfe" + (len(text) + 2).to_bytes(2, "big") + text
    frame = frame_of("e00017.jpg", tmp_path, content=picture[:2] + comment + picture[2:])
    assert (frame.time, frame.family) == (NOON, "Mobotix header")


def test_a_placeholder_in_a_fits_header_does_not_hide_the_time_of_the_name(tmp_path: Path) -> None:
    frame = frame_of("20130513T183000Z.fits", tmp_path, content=fits_of(GREY, **{"MJD-OBS": 0.0}))
    assert (frame.time, frame.family) == (NOON, "date and time, UTC")


def test_what_nothing_tells_is_refused(tmp_path: Path) -> None:
    assert code_of("sky.png", tmp_path) == "file_time_unknown"
    assert code_of("99991231235959.png", tmp_path, offset=timedelta(hours=-5)) == "file_time_unknown"
    assert code_of("sky.png", tmp_path, content=b"") == "file_time_unknown"


BERLIN = ZoneInfo("Europe/Berlin")
CHANGES = {
    "summer begins": (datetime(2023, 3, 26, tzinfo=UTC), 0),
    "summer ends": (datetime(2023, 10, 29, tzinfo=UTC), 12),
}


@pytest.mark.parametrize("change", CHANGES)
def test_names_in_local_time_are_dated_rightly_over_both_changes_of_the_year_or_refused(
    change: str, tmp_path: Path
) -> None:
    """A camera that follows summer time, an image every ten minutes: two share a name in the doubled hour."""
    midnight, doubtful = CHANGES[change]
    truth: dict[str, list[datetime]] = {}
    for step in range(-36, 72):
        time = midnight + timedelta(minutes=10 * step)
        truth.setdefault(f"{time.astimezone(BERLIN):%Y%m%d_%H%M%S}.png", []).append(time)
    source = open_source(str(folder_of(dict.fromkeys(truth, encoded(GREY, ".png")), tmp_path)))
    dated: list[datetime] = []
    refused = 0
    for name, times in truth.items():
        if len(times) == 2:
            assert code_of(name, tmp_path, offset=BERLIN) == "file_time_twice"
            refused += 2
            continue
        (frame,) = timed_frames(source, name, TimeRules(offset=BERLIN), names=set(truth))
        assert [frame.time] == times
        assert taken(tmp_path / name, None, BERLIN)[0] == frame.time
        dated.append(frame.time)
    assert refused == doubtful
    assert len(set(dated)) == len(dated) == 108 - doubtful


@pytest.mark.parametrize("pattern", [None, "%Y%m%d_%H%M%S"])
@pytest.mark.parametrize(
    ("name", "zone", "code"),
    [
        ("20230326_023000.png", "Europe/Berlin", "file_time_never"),
        ("20231029_023000.png", "Europe/Berlin", "file_time_twice"),
        ("20231105_013000.png", "America/Chicago", "file_time_twice"),
        ("20231001_021500.png", "Australia/Lord_Howe", "file_time_never"),
    ],
)
def test_a_time_that_the_clocks_of_a_place_showed_twice_or_never_is_refused(
    name: str, zone: str, code: str, pattern: str | None, tmp_path: Path
) -> None:
    assert code_of(name, tmp_path, offset=ZoneInfo(zone), pattern=pattern) == code
    with pytest.raises(FindingError) as refused:
        taken(tmp_path / name, pattern, ZoneInfo(zone))
    assert refused.value.finding.code == code


@pytest.mark.parametrize(
    ("given", "offset"), [("-5", timedelta(hours=-5)), (5.5, timedelta(hours=5.5)), ("0", timedelta(0))]
)
def test_an_offset_is_hours(given: str | float, offset: timedelta) -> None:
    assert parse_utc_offset(given, field="--utc-offset") == offset


@pytest.mark.parametrize("given", ["Europe", "Nowhere/Mast", "", "nan", "24", "../etc/passwd"])
def test_an_offset_that_is_neither_hours_nor_a_zone_is_refused(given: str) -> None:
    with pytest.raises(InputError) as refused:
        parse_utc_offset(given, field="--utc-offset")
    assert refused.value.field == "--utc-offset"


H2 = timedelta(hours=2)
WRITTEN = {
    "cam_2024-06-11_01-22-00_PM.jpg": ("2024-06-11T13:22:00", None),
    "cam_2024-06-11_12-22-00 am.jpg": ("2024-06-11T00:22:00", None),
    "20240611T064800+0200.jpg": ("2024-06-11T06:48:00", H2),
    "2024-08-23T09-30-00-006516+02-00.png": ("2024-08-23T09:30:00.006516", H2),
    "2024-06-11_06-48-00_CEST.jpg": ("2024-06-11T06:48:00", H2),
    "a_20240611T064800-0930.jpg": ("2024-06-11T06:48:00", timedelta(hours=-9.5)),
    "20240611_064800_UTC+5-45.jpg": ("2024-06-11T06:48:00", timedelta(hours=5.75)),
    "20240611064800.25Z.png": ("2024-06-11T06:48:00.250000", timedelta(0)),
    "PXL_20240611_064800123.jpg": ("2024-06-11T06:48:00.123000", None),
    "01-20240611064800-05.jpg": ("2024-06-11T06:48:00", None),
    "2024-06-11_06-48-00-0001.jpg": ("2024-06-11T06:48:00", None),
    "20240611T064800_12000us.png": ("2024-06-11T06:48:00", None),
}
NOT_ONE_TIME = {
    "img_1711022310.jpg": "file_time_ambiguous",
    "img_1711022310_1234.jpg": "file_time_ambiguous",
    "img_1711022310123.jpg": "file_time_ambiguous",
    "cam7_240611_064800.jpg": "file_time_ambiguous",
    "240611064800.jpg": "file_time_ambiguous",
    "24-06-11 06.48.00.jpg": "file_time_ambiguous",
    "17110223101234.jpg": "file_time_unknown",
    "cam120240611064800.jpg": "file_time_unknown",
    "2024-06-11_13-22-00_PM.jpg": "file_time_unknown",
    "2024-06-11_13-22-001.jpg": "file_time_unknown",
    "20240611T064800+0517.jpg": "file_time_unknown",
    "20240611T064800-05.jpg": "file_time_ambiguous",
    "2024-06-11_06-48-00-0500.jpg": "file_time_ambiguous",
    "20240611T064800_20240611T065000.jpg": "file_time_ambiguous",
}


@pytest.mark.parametrize("name", WRITTEN)
def test_a_time_in_a_name_is_read_with_its_half_of_the_day_and_zone(name: str, tmp_path: Path) -> None:
    named = time_in_name(name)
    assert named is not None
    assert (named.time.isoformat(), named.ahead) == WRITTEN[name]
    if named.ahead is not None:
        assert frame_of(name, tmp_path).time == named.time.replace(tzinfo=UTC) - named.ahead


@pytest.mark.parametrize("name", NOT_ONE_TIME)
def test_a_name_of_which_a_part_alone_is_a_time_has_none(name: str, tmp_path: Path) -> None:
    assert code_of(name, tmp_path, offset=timedelta(0)) == NOT_ONE_TIME[name]


def test_a_zone_in_a_name_that_contradicts_the_option_is_refused(tmp_path: Path) -> None:
    name, taken_at = "20240611T064800+0200.jpg", datetime(2024, 6, 11, 4, 48, tzinfo=UTC)
    assert code_of(name, tmp_path, offset=timedelta(0)) == "file_zone_contradicts"
    assert code_of(name, tmp_path, offset=ZoneInfo("Europe/London")) == "file_zone_contradicts"
    for rules in ({}, {"offset": H2}, {"offset": BERLIN}, {"offset": timedelta(0), "is_offset_assumed": True}):
        assert frame_of(name, tmp_path, **rules).time == taken_at


@pytest.mark.parametrize("one", EXAMPLES, ids=lambda one: one.name)
def test_each_name_of_the_table_has_its_time_by_itself_or_by_its_pattern(one: NameExample) -> None:
    stem = "below/" + one.name
    if one.why:
        assert time_in_name(stem) is None
    if one.time and one.pattern is None:
        named = time_in_name(stem)
        assert named is not None
        assert (named.time, named.ahead) == _stated(one.time)
    if one.pattern is not None:
        assert time_pattern(one.pattern).read(path_stem(stem)) == _stated(one.time)


def _stated(text: str) -> tuple[datetime, timedelta | None]:
    time = datetime.fromisoformat(text)
    return time.replace(tzinfo=None), time.utcoffset()


def test_the_page_of_names_is_the_table() -> None:
    again = "python -c 'from sunarc.sources.name_examples import *; print(names_as_markdown(), end=\"\")'"
    assert PAGE.read_text("utf-8") == names_as_markdown(), f"run: {again} > {PAGE}"


@pytest.mark.parametrize("folder", ["", "all/"])
def test_a_pattern_with_folders_reads_them(folder: str, tmp_path: Path) -> None:
    rules: dict[str, Any] = {"pattern": "%Y/%m/%d/%H%M%S", "offset": timedelta(0)}
    assert frame_of(folder + "2013/05/13/183000.png", tmp_path, **rules).time == NOON


@pytest.mark.parametrize(
    ("pattern", "stem"),
    [
        ("%Y%m%d_%H%M%S", "cam_20240611_064800"),
        ("%Y%m%d_%H%M%S", "20240611_064800_1"),
        ("%Y%m%d_%H%M%S", "2024611_064800"),
        ("*%Y%m%d_%H%M%S", "0120240611_064800"),
        ("%Y%m%d_%H%M*", "20240611_064800"),
        ("img_%s", "img_171808848"),
        ("img_%s", "img_17180884801"),
        ("*%s*", "171808848012345"),
        ("%Y/%m/%d/%Y%m%d%H%M", "2024/06/11/202406120648"),
        ("%a_%Y%m%d%H", "Wed_2024061106"),
        ("%Y%j_%m%d_%H", "2024163_0612_06"),
        ("%Y%m%d%H%M%S%z", "20240611064800+0517"),
        ("%Y%m%d%H%M%S%Z", "20240611064800IST"),
        ("%Y%j%H", "202336606"),
        ("%I%p_%Y%m%d", "13PM_20240611"),
    ],
)
def test_a_path_that_a_pattern_does_not_read_whole_has_no_time(pattern: str, stem: str) -> None:
    assert time_pattern(pattern).read(stem) is None


@pytest.mark.parametrize(
    "pattern", ["%Y%m%d", "%m%d%H%M%S", "%H%M", "%Y%m%d%I%M", "%Y%m%d%H%q", "cam", "", "%", "%Y%j%H%", "%s_%H", "%c"]
)
def test_a_pattern_of_a_part_of_a_time_is_refused_where_it_is_given(pattern: str) -> None:
    with pytest.raises(InputError) as refused:
        checked_pattern(pattern, field="--time-pattern")
    assert refused.value.field == "--time-pattern"


def test_what_strftime_writes_is_read_to_the_second_or_not_at_all() -> None:
    """Patterns drawn of all directives, with and without something between them; the writer is Python's."""
    draw = random.Random(58)
    days = (["%Y", "%m", "%d"], ["%y", "%j"], ["%d", "%b", "%Y"], ["%a", "%B", "%d", "%y"], ["%Y", "%m", "%d", "%Y%j"])
    clocks = (["%H", "%M", "%S"], ["%I", "%M", "%S", "%p"], ["%S", "%M", "%H"])
    for _ in range(500):
        time = datetime.fromtimestamp(draw.randrange(2**31), UTC).replace(tzinfo=None)
        parts = [*draw.choice(days), *draw.choice(clocks)]
        between = draw.choice(["", "-", "_", ".", "x", "."])
        pattern = between.join(parts)
        stem = time.strftime(pattern)
        assert time_pattern(pattern).read(stem) == (time, None), (pattern, stem)
        assert time_pattern(pattern).read(stem + "1") is None
        assert time_pattern("*" + pattern).read("cam_" + stem) == (time, None)
    for seconds in (0, 999_999_999):  # nine digits
        assert time_pattern("%s").read(str(seconds)) is None


@pytest.mark.parametrize(
    ("zone", "hours"),
    [("CEST", 2.0), ("GMT+5:30", 5.5), ("AWST", 8.0), ("GMT-5", -5.0), ("IST", None), ("+0517", None)],
)
def test_a_zone_of_one_meaning_is_read(zone: str, hours: float | None) -> None:
    assert parse_zone(zone) == (None if hours is None else timedelta(hours=hours))


@pytest.mark.parametrize("zone", ["CEST", "GMT+5:30", "IST"])
def test_the_seconds_of_a_mobotix_header_go_before_its_local_time(zone: str, tmp_path: Path) -> None:
    picture = encoded(GREY, ".jpg")
    text = f"#:M1IMG\nPRD=MOBOTIX\nDAT=2024-06-11\nTIM=12:00:00.323\nTZN={zone}\nTIT=1718100000.323\n".encode()
    content = picture[:2] + b"\xff\xfe" + (len(text) + 2).to_bytes(2, "big") + text + picture[2:]
    found = frame_of("e1.jpg", tmp_path / "with", content=content)
    assert found.time == datetime(2024, 6, 11, 10, 0, 0, 323000, tzinfo=UTC)
    without = content.replace(b"TIT=", b"XXX=")
    if zone == "IST":
        assert code_of("e1.jpg", tmp_path / "out", content=without) == "file_time_zone"
    else:
        local = datetime(2024, 6, 11, 12, 0, 0, 323000, tzinfo=UTC)
        ahead = parse_zone(zone)
        assert ahead is not None
        assert frame_of("e1.jpg", tmp_path / "out", content=without).time == local - ahead


def test_no_name_raises_or_is_read_in_part() -> None:
    draw = random.Random(5310)
    parts = [
        "2024",
        "06",
        "11",
        "1711022310",
        "20240611",
        "064800",
        "T",
        "Z",
        "-",
        "_",
        ":",
        "+",
        "PM",
        "CEST",
        "UTC",
        ".",
        "+0200",
        "-0500",
        "٢٠٢٤",
        "cam",
        "99",
        "00",
    ]
    read = 0
    for _ in range(10_000):
        n = draw.randint(1, 12)
        name = "".join(draw.choice([*parts, str(draw.randrange(10 ** draw.randint(1, 18)))]) for _ in range(n)) + ".jpg"
        ambiguous_times(name)
        named = time_in_name(name)
        if named is not None:
            read += 1
            assert 1970 <= named.time.year <= 2100
            assert named.prefix[-1:] not in set("0123456789")
            assert re.match(rf"{named.time.year}(?=[-_]|\d{{4}})", name[len(named.prefix) :])
    assert read > 50


PAGE = Path(__file__).parents[2] / "docs/operating/names.md"
CASES = Path(__file__).parents[2] / "../shared/cases/scout"


@pytest.mark.skipif(not CASES.is_dir(), reason="the cases of others are not here")
def test_the_cases_of_others_have_their_right_times() -> None:
    """The names state the time of a sun that was rendered; of the headers each is 09:30 or 11:30 UTC of the day."""
    right = {
        "04-names-am-pm/cam_2024-06-11_03-31-00_PM.jpg": "2024-06-11T15:31:00",
        "06-offset-in-name/20240611T064800+0200.jpg": "2024-06-11T04:48:00",
        "07-mobotix/sky-CEST.jpg": "2024-06-11T10:00:00.323000",
        "07-mobotix/sky-GMTp530.jpg": "2024-06-11T10:00:00.323000",
        "09-fits/f_mjd.fits": "2024-06-11T11:30:00",
        "09-fits/h_underscore.fits": "2024-06-11T11:30:00",
        "09-fits/i_zone.fits": "2024-06-11T09:30:00",
        "09-fits/j_space.fits": "2024-06-11T11:30:00",
        "09-fits/l_beg.fits": "2024-06-11T11:30:30",
        "09-fits/x_rice.fits": "2024-06-11T11:30:00",
    }
    source = open_source(str(CASES))
    rules = TimeRules(offset=timedelta(0), is_offset_assumed=True)
    found = {name: timed_frames(source, name, rules, names=set())[0].time for name in right}
    assert {name: time.replace(tzinfo=None).isoformat() for name, time in found.items()} == right
