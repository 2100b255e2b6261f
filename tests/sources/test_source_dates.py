"""Folders of days of one camera are one source of images; others stay apart."""

from __future__ import annotations

from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest
from tests.fixtures.packed_archives import GREY, encoded, folder_of

from sunarc.sky.site import Site
from sunarc.sources.image_times import TimeRules
from sunarc.sources.index import CameraPlan, Selector, index_archive
from sunarc.sources.source_dates import by_date


@pytest.mark.parametrize(
    "addresses",
    [
        ["/a/20260101", "/a/20260102"],
        ["/a/2026-01-01/", "/a/2026-01-02/"],
        ["/a/2026/01/01", "/a/2026/02/01"],
        ["/a/2025", "/a/2026"],
        ["/a/202601", "/a/202602"],
        ["/b/a_2026_01_01.zip", "/b/a_2026_01_02.zip"],
        ["s3://bucket/a/20260101", "s3://bucket/a/20260102"],
    ],
)
def test_sources_that_differ_by_their_dates_alone_are_of_one_camera(addresses: list[str]) -> None:
    ((undated, together),) = by_date(addresses)
    assert list(together) == addresses
    assert undated.rpartition("/")[2].partition(".")[0].strip("_") == "a"


@pytest.mark.parametrize(
    "addresses",
    [
        ["/a/roof", "/a/mast"],
        ["/roof/20260101", "/mast/20260102"],
        ["/a/cam2001", "/a/cam2002"],
        ["/a/192.168.20.20", "/a/192.168.20.21"],
        ["/a/roof_20260101", "/a/mast_20260101"],
        ["/a/2026/01/roof", "/a/2026/02/roof"],
        ["/a/123420260101", "/a/123420260102"],
    ],
)
def test_other_sources_are_cameras_of_their_own(addresses: list[str]) -> None:
    assert by_date(addresses) == [(one, (one,)) for one in addresses]


@pytest.mark.parametrize(
    ("name", "pattern"),
    [("123000.png", "%Y-%m-%d/%H%M%S"), ("001/jpg/12/30/00[M][0@0][0].jpg", None), ("20130513_123000.png", None)],
)
def test_a_day_that_its_folder_alone_states_is_read_where_that_is_the_source(
    name: str, pattern: str | None, tmp_path: Path
) -> None:
    folder = folder_of({name: encoded(GREY, name[-4:])}, tmp_path / "2013-05-13")
    plan = CameraPlan(
        name="roof",
        site=Site(latitude=36.6, longitude=-97.5, altitude=318.0),
        selector=Selector((str(folder),)),
        rules=TimeRules(pattern, timedelta(hours=-6)),
    )
    (camera,) = index_archive([plan]).cameras
    assert camera.images[0].unix_s == datetime(2013, 5, 13, 18, 30, tzinfo=UTC).timestamp()
