"""Pictures of one time in two folders: both rows are stored, and one counts, or neither."""

from __future__ import annotations

import sqlite3
from collections.abc import Sequence
from contextlib import closing
from dataclasses import replace
from datetime import timedelta
from pathlib import Path

import pytest
from tests.fixtures.stores import NOON

from sunarc.common.findings import Finding
from sunarc.imager.archive.archive import Archive, open_archive
from sunarc.imager.archive.database.schema import downgrade, upgrade
from sunarc.imager.archive.pictures_of_one_time import TWO_PICTURES
from sunarc.imager.archive.values import SunPoint

from .test_file_sightings import FOUND, REFUSED

RAW = replace(FOUND, folder="raw")
DRAWN = replace(FOUND, folder="annotated")
LATER = NOON + timedelta(minutes=1)


def rows(archive: Archive) -> dict[str, tuple[bool, str]]:
    return {one.folder: (one.accepted, one.verdict) for one in archive.sightings.find("roof")}


@pytest.mark.parametrize("batches", [[[RAW, DRAWN]], [[RAW], [DRAWN]], [[DRAWN], [RAW]]])
@pytest.mark.parametrize(("apart_px", "counts"), [(0.0, 1), (0.99, 1), (1.01, 0), (400.0, 0)])
def test_both_are_stored_and_one_counts_where_their_suns_agree(
    archive: Archive, batches: list[list[SunPoint]], apart_px: float, counts: int
) -> None:
    aside = {}
    for batch in batches:
        aside = archive.sightings.replace([replace(one, x_px=900.0 + apart_px * (one is RAW)) for one in batch])
    found = archive.sightings.find("roof")
    assert len(found) == 2
    assert [one.folder for one in found if one.accepted] == ["annotated"][:counts]
    others = [one for one in found if not one.accepted]
    assert {one.verdict for one in others} == {"set_aside"}
    assert {path: one.data["other"] for path, one in aside.items()} == {
        f"{one.folder}/a.jpg": {"raw": "annotated/a.jpg", "annotated": "raw/a.jpg"}[one.folder] for one in others
    }
    assert {one.findings[0].code for one in others} == {TWO_PICTURES}
    assert {one.x_px for one in found} == {900.0, 900.0 + apart_px}  # where each sun was is kept


def test_a_sun_in_one_picture_alone_counts_not(archive: Archive) -> None:
    archive.sightings.replace([RAW, replace(REFUSED, folder="annotated")])
    assert rows(archive) == {"raw": (False, "set_aside"), "annotated": (False, "hidden")}
    archive.sightings.replace([DRAWN])  # looked at again
    assert rows(archive) == {"annotated": (True, "clear"), "raw": (False, "set_aside")}


def test_what_was_set_aside_counts_again_once_they_agree(archive: Archive) -> None:
    archive.sightings.replace([DRAWN, replace(RAW, x_px=950.0)])
    assert [one.accepted for one in archive.sightings.find("roof")] == [False, False]
    archive.sightings.replace([RAW])
    assert rows(archive) == {"annotated": (True, "clear"), "raw": (False, "set_aside")}


def test_a_sighting_keeps_its_own_findings_while_it_is_set_aside_and_after(archive: Archive) -> None:
    own = (Finding("sun_near_edge"), Finding("sighting_superseded"))
    for _ in range(2):  # and does not gain this rule's twice
        archive.sightings.replace([replace(DRAWN, findings=own), replace(RAW, x_px=950.0)])
        aside = next(one for one in archive.sightings.find("roof") if one.folder == "annotated")
        assert (aside.verdict, aside.findings[0].code, aside.findings[1:]) == ("set_aside", TWO_PICTURES, own)
        archive.sightings.replace([replace(RAW, x_px=950.0)])
        aside = next(one for one in archive.sightings.find("roof") if one.folder == "annotated")
        assert (aside.findings[0].code, aside.findings[1:]) == (TWO_PICTURES, own)
    archive.sightings.replace([RAW])
    (counts,) = archive.sightings.find("roof", accepted=True)
    assert (counts.folder, counts.verdict, counts.findings) == ("annotated", "clear", own)


def test_a_sun_elsewhere_is_not_accepted_twice_once_the_camera_is_known_to_have_moved(archive: Archive) -> None:
    elsewhere = [replace(one, accepted=False, verdict="elsewhere") for one in (RAW, DRAWN)]
    archive.sightings.replace(elsewhere)
    assert archive.sightings.readmit("roof", since=NOON) == 1
    assert [one.folder for one in archive.sightings.find("roof", accepted=True)] == ["annotated"]


@pytest.mark.parametrize("verdict", ["in_stack", "frozen"])
def test_a_row_that_shows_nothing_of_the_sky_is_no_second_picture(archive: Archive, verdict: str) -> None:
    archive.sightings.replace([RAW, replace(REFUSED, folder="annotated", verdict=verdict)])
    assert rows(archive)["raw"] == (True, "clear")


def test_exposures_in_one_folder_and_frames_of_no_file_are_left_alone(archive: Archive) -> None:
    points = [RAW, replace(RAW, file="b.jpg", x_px=500.0), replace(FOUND, file="", method="disc", x_px=100.0)]
    assert archive.sightings.replace(points) == {}
    assert len(archive.sightings.find("roof", accepted=True)) == 3


def test_a_sighting_of_an_unknown_folder_is_replaced_by_that_of_its_image(archive: Archive) -> None:
    archive.sightings.replace([FOUND])
    archive.sightings.replace([replace(REFUSED, folder="raw")])
    assert rows(archive) == {"raw": (False, "hidden")}


def stored(path: Path) -> list[Sequence[object]]:
    with closing(sqlite3.connect(path)) as connection:
        return connection.execute("SELECT id, accepted, x_px FROM sun_point ORDER BY id").fetchall()


def test_an_older_version_has_one_row_of_them_the_one_that_counts(archive: Archive, path: Path) -> None:
    archive.sightings.replace([replace(RAW, x_px=900.5), DRAWN, replace(FOUND, file="b.jpg", folder="raw", time=LATER)])
    archive.close()
    assert stored(path) == [(1, 0, 900.5), (2, 1, 900.0), (3, 1, 900.0)]
    downgrade(path, "0019")
    assert stored(path) == [(2, 1, 900.0), (3, 1, 900.0)]
    upgrade(path)
    again = open_archive(path)
    assert [(one.file, one.folder) for one in again.sightings.find("roof")] == [("a.jpg", ""), ("b.jpg", "")]
    again.close()
