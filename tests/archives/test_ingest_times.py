"""When an archived image was taken: its name, its sidecar, EXIF, our own composite's document."""

from __future__ import annotations

import json
from datetime import UTC, datetime, timedelta
from pathlib import Path

import cv2
import numpy as np
import pytest
from PIL import Image
from tests.fixtures.settings import new_settings

from sunarc.archives.ingest import IngestOptions, ingest_folder
from sunarc.archives.ingest_summary import IngestSummary
from sunarc.common.errors import InputError
from sunarc.common.findings import FindingError
from sunarc.sources.image_times import TimeRules, UtcOffset, timed_picture
from sunarc.sources.sources import Folder

NOON = datetime(2013, 5, 13, 18, 30, tzinfo=UTC)
EXIF_SECTION, TAKEN, ZONE = 0x8769, 36867, 36881
NO_OFFSET = timedelta(0)


def dark_image(path: Path) -> Path:
    path.parent.mkdir(exist_ok=True)
    cv2.imwrite(str(path), np.zeros((20, 24), dtype=np.uint8))
    return path


def with_exif(path: Path, tags: dict[int, str]) -> Path:
    exif = Image.Exif()
    exif[EXIF_SECTION] = tags
    Image.fromarray(np.zeros((20, 24), dtype=np.uint8)).save(path, exif=exif)
    return path


def taken(path: Path, pattern: str | None = None, offset: UtcOffset = NO_OFFSET) -> tuple[datetime, float | None]:
    """Return time and exposure of a picture."""
    names = [one.name for one in path.parent.iterdir()]
    found = timed_picture(Folder(str(path.parent)), path.name, TimeRules(pattern, offset, documents=True), names=names)
    return found.time, found.exposure_us


def named(folder: Path, name: str, offset: UtcOffset = NO_OFFSET) -> datetime | None:
    """Return the time of a picture of which only the name tells one; None where nothing does."""
    try:
        return taken(dark_image(folder / name), None, offset)[0]
    except FindingError:
        return None


def ingested(folder: Path) -> IngestSummary:
    return ingest_folder(new_settings(folder), folder / "images", options=IngestOptions())


@pytest.mark.parametrize(
    "name",
    [
        "20130513T183000Z_20us.png",
        "20130513183000.png",
        "2013-05-13_18-30-00.jpg",
        "2013_05_13 18:30:00.png",
        "camera7_20130513_183000_sky.tif",
        "2013-05-13T18h30m00.png",
    ],
)
def test_usual_names_are_understood(tmp_path: Path, name: str) -> None:
    assert named(tmp_path, name) == NOON


def test_a_fraction_of_a_second_in_the_name_counts(tmp_path: Path) -> None:
    assert named(tmp_path, "20130513T183000.25Z.png") == NOON + timedelta(milliseconds=250)


def test_a_name_with_z_is_utc_whatever_the_offset(tmp_path: Path) -> None:
    assert named(tmp_path, "20130513T183000Z.png", timedelta(hours=-5)) == NOON


def test_a_name_without_zone_is_the_offset_ahead_of_utc(tmp_path: Path) -> None:
    assert named(tmp_path, "20130513T133000.png", timedelta(hours=-5)) == NOON


@pytest.mark.parametrize("name", ["sky.png", "20131313T183000.png", "20130513T256000.png", "2013-05-13.png"])
def test_a_name_without_a_time_tells_none(tmp_path: Path, name: str) -> None:
    assert named(tmp_path, name) is None


def test_a_time_before_the_year_1_after_its_offset_is_none(tmp_path: Path) -> None:
    assert named(tmp_path, "00010101T000000.png", timedelta(hours=5)) is None


def test_a_pattern_with_a_zone_needs_no_offset(tmp_path: Path) -> None:
    path = dark_image(tmp_path / "2013-05-13 13.30 -0500.png")
    assert taken(path, "%Y-%m-%d %H.%M %z", timedelta(hours=-5)) == (NOON, None)
    with pytest.raises(FindingError) as refused:
        taken(path, "%Y-%m-%d %H.%M %z", timedelta(hours=3))
    assert refused.value.finding.code == "file_zone_contradicts"


def test_a_pattern_without_a_zone_is_the_offset_ahead_of_utc(tmp_path: Path) -> None:
    path = dark_image(tmp_path / "2013-05-13 13.30.png")
    assert taken(path, "%Y-%m-%d %H.%M", timedelta(hours=-5)) == (NOON, None)


@pytest.mark.parametrize(("stem", "offset_h"), [("sky", 0.0), ("0001-01-01_00", 5.0)])
def test_a_name_that_the_pattern_cannot_date_is_refused(tmp_path: Path, stem: str, offset_h: float) -> None:
    with pytest.raises(InputError) as refused:
        taken(dark_image(tmp_path / f"{stem}.png"), "%Y-%m-%d_%H", timedelta(hours=offset_h))
    assert refused.value.field == f"{stem}.png"


def test_a_sidecar_goes_before_the_name(tmp_path: Path) -> None:
    path = dark_image(tmp_path / "20200101T000000Z_5us.png")
    path.with_suffix(".json").write_text('{"time_utc": "2013-05-13T18:30:00Z", "exposure_us": 20}')
    assert taken(path) == (NOON, 20.0)


def test_a_sidecar_without_an_exposure_leaves_the_names(tmp_path: Path) -> None:
    path = dark_image(tmp_path / "20200101T000000Z_5us.png")
    path.with_suffix(".json").write_text('{"time_utc": "2013-05-13T18:30:00Z"}')
    assert taken(path) == (NOON, 5.0)


@pytest.mark.parametrize("exposure", ["null", "0"])
def test_an_exposure_that_is_not_known_is_none(tmp_path: Path, exposure: str) -> None:
    path = dark_image(tmp_path / "a.png")
    path.with_suffix(".json").write_text(f'{{"time_utc": "2013-05-13T18:30:00Z", "exposure_us": {exposure}}}')
    assert taken(path) == (NOON, None)


@pytest.mark.parametrize("exposure", ['"20us"', "-5", "NaN", "Infinity", "[20]", "true"])
def test_a_sidecar_with_a_wrong_exposure_skips_its_image_alone(tmp_path: Path, exposure: str) -> None:
    path = dark_image(tmp_path / "images" / "a.png")
    path.with_suffix(".json").write_text(f'{{"time_utc": "2013-05-13T18:30:00Z", "exposure_us": {exposure}}}')
    dark_image(tmp_path / "images" / "20130513T184000Z.png")
    summary = ingested(tmp_path)
    assert [(one.file, one.finding.code) for one in summary.skipped] == [("a.png", "file_sidecar")]
    assert (summary.accepted, summary.rejected) == (0, 1)


@pytest.mark.parametrize("text", ["", "[]", "{}", '{"time_utc": 3}', '{"time_utc": "yesterday"}', "\udcff"])
def test_a_sidecar_that_cannot_be_read_is_refused(tmp_path: Path, text: str) -> None:
    path = dark_image(tmp_path / "20200101T000000Z.png")
    path.with_suffix(".json").write_bytes(text.encode(errors="surrogateescape"))
    with pytest.raises(FindingError) as refused:
        taken(path)
    assert refused.value.finding.code == "file_sidecar"


def test_the_zone_of_exif_goes_before_the_offset(tmp_path: Path) -> None:
    path = with_exif(tmp_path / "a.jpg", {TAKEN: "2013:05:13 13:30:00", ZONE: "-05:00"})
    assert taken(path, None, timedelta(hours=3)) == (NOON, None)


def test_exif_without_a_zone_is_the_offset_ahead_of_utc(tmp_path: Path) -> None:
    path = with_exif(tmp_path / "a.jpg", {TAKEN: "2013:05:13 20:30:00"})
    assert taken(path, None, timedelta(hours=2)) == (NOON, None)


@pytest.mark.parametrize("tags", [{}, {TAKEN: "    :  :     :  :  "}, {TAKEN: "2013:05:13 13:30:00", ZONE: "noon"}])
def test_an_image_whose_exif_tells_no_time_is_refused(tmp_path: Path, tags: dict[int, str]) -> None:
    with pytest.raises(InputError) as refused:
        taken(with_exif(tmp_path / "a.jpg", tags), None, NO_OFFSET)
    assert refused.value.field == "a.jpg"


def test_an_image_taken_at_night_is_skipped(tmp_path: Path) -> None:
    dark_image(tmp_path / "images" / "20130513T060000Z.png")
    assert [one.finding.code for one in ingested(tmp_path).skipped] == ["file_at_night"]


@pytest.mark.parametrize("content", ["", "notes.txt"])
def test_a_folder_without_images_is_refused(tmp_path: Path, content: str) -> None:
    (tmp_path / "images").mkdir()
    if content:
        (tmp_path / "images" / content).write_text(json.dumps({}))
    with pytest.raises(InputError) as refused:
        ingested(tmp_path)
    assert refused.value.field == str(tmp_path / "images")
