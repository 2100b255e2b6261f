"""When an image was taken: names of known cameras, sidecars and headers; what is doubtful is refused."""

from __future__ import annotations

from datetime import UTC, datetime, timedelta
from pathlib import Path
from zoneinfo import ZoneInfo

import pytest
from tests.offline.sources.archives import GREY, encoded, folder_of
from tests.offline.test_ingest_times import TAKEN, ZONE, taken, with_exif

from sunarc.errors import InputError
from sunarc.reanalysis.image_times import (
    TimedFrame,
    TimeRules,
    ambiguous_dates,
    time_in_name,
    timed_frames,
    utc_offset_of,
)
from sunarc.reanalysis.messages import RefusedImageError
from sunarc.reanalysis.sources import open_source

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
}


def frame_of(name: str, folder: Path, *, content: bytes | None = None, **rules: object) -> TimedFrame:
    picture = encoded(GREY, ".png") if content is None else content
    source = open_source(str(folder_of({name: picture}, folder)))
    names = {file.name for file in source.files()}
    (frame,) = timed_frames(source, name, TimeRules(**rules), names=names)  # type: ignore[arg-type]
    return frame


def code_of(name: str, folder: Path, **more: object) -> str:
    with pytest.raises(RefusedImageError) as refused:
        frame_of(name, folder, **more)  # type: ignore[arg-type]
    return refused.value.finding.code


@pytest.mark.parametrize("name", NAMES)
def test_names_of_known_cameras_tell_time_family_and_camera(name: str) -> None:
    named = time_in_name(name)
    assert named is not None
    assert (named.family, named.prefix, named.zone) == NAMES[name]
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
        ("20130513_123000.jpg", None),
        ("sky.jpg", None),
    ],
)
def test_a_date_that_ends_with_its_year_is_ambiguous(
    name: str, readings: tuple[str, str] | None, tmp_path: Path
) -> None:
    assert ambiguous_dates(name) == readings
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
    with pytest.raises(RefusedImageError) as refused:
        taken(tmp_path / name, pattern, ZoneInfo(zone))
    assert refused.value.finding.code == code


@pytest.mark.parametrize(
    ("given", "offset"), [("-5", timedelta(hours=-5)), (5.5, timedelta(hours=5.5)), ("0", timedelta(0))]
)
def test_an_offset_is_hours(given: str | float, offset: timedelta) -> None:
    assert utc_offset_of(given, field="--utc-offset") == offset


@pytest.mark.parametrize("given", ["Europe", "Nowhere/Mast", "", "nan", "24", "../etc/passwd"])
def test_an_offset_that_is_neither_hours_nor_a_zone_is_refused(given: str) -> None:
    with pytest.raises(InputError) as refused:
        utc_offset_of(given, field="--utc-offset")
    assert refused.value.field == "--utc-offset"
