"""Sightings of image files: the key with the file, answers in place of former ones, learned sigma."""

from __future__ import annotations

import sqlite3
from contextlib import closing
from dataclasses import replace
from datetime import timedelta
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tests.fixtures.stores import NOON

from sunarc.common.errors import InputError
from sunarc.common.utc import to_microseconds
from sunarc.imager.archive.archive import Archive, open_archive
from sunarc.imager.archive.database.schema import downgrade, upgrade
from sunarc.imager.archive.values import Event, SunPoint
from sunarc.sources.image_key import ImageKey, image_key

from .test_calibrations import document

FOUND = SunPoint(
    camera="roof",
    pose_epoch="roof-1",
    time=NOON,
    method="paper",
    accepted=True,
    verdict="clear",
    x_px=900.0,
    y_px=700.0,
    sigma_px=2.0,
    file="a.jpg",
    ingest_pass=1,
)
REFUSED = replace(FOUND, accepted=False, verdict="hidden", x_px=None, y_px=None, sigma_px=None)
LEARNED = Event(time=NOON, kind="sigma_learned", severity="info", text="", camera="roof")
AT_NOON = {to_microseconds(NOON)}


def test_the_exposures_of_a_stack_share_their_time_and_are_all_stored(archive: Archive) -> None:
    stack = [replace(FOUND, file=f"{number}.jpg") for number in range(14)]
    assert archive.sightings.add(stack) == 14
    assert archive.sightings.find("roof") == tuple(stack)


def test_a_new_answer_takes_the_place_of_the_former_and_keeps_its_id(archive: Archive, path: Path) -> None:
    archive.sightings.replace([REFUSED, replace(FOUND, file="b.jpg")])
    archive.sightings.replace([replace(FOUND, x_px=901.0, ingest_pass=2)])
    with closing(sqlite3.connect(path)) as connection:
        rows = connection.execute("SELECT id, file, accepted, x_px, ingest_pass FROM sun_point ORDER BY id").fetchall()
    assert rows == [(1, "a.jpg", 1, 901.0, 2), (2, "b.jpg", 1, 900.0, 1)]


def test_an_image_counts_once_and_by_the_method_that_accepted_it_last(archive: Archive) -> None:
    archive.sightings.replace([FOUND, replace(FOUND, file="b.jpg")])
    archive.sightings.replace([replace(FOUND, method="disc")])
    assert [(p.method, p.file, p.verdict) for p in archive.sightings.find("roof", accepted=True)] == [
        ("paper", "b.jpg", "clear"),
        ("disc", "a.jpg", "clear"),
    ]
    assert [p.verdict for p in archive.sightings.find("roof", accepted=False)] == ["set_aside"]


def test_a_sighting_of_an_unknown_folder_is_set_aside_by_another_methods(archive: Archive) -> None:
    archive.sightings.replace([FOUND])
    archive.sightings.replace([replace(FOUND, method="disc", folder="raw")])
    accepted = archive.sightings.find("roof", accepted=True)
    assert [(p.method, p.folder) for p in accepted] == [("disc", "raw")]
    assert [p.verdict for p in archive.sightings.find("roof", accepted=False)] == ["set_aside"]


def test_a_refusal_by_another_method_leaves_the_accepted_sighting(archive: Archive) -> None:
    archive.sightings.replace([FOUND])
    archive.sightings.replace([replace(REFUSED, method="disc")])
    assert [p.method for p in archive.sightings.find("roof", accepted=True)] == ["paper"]


def test_images_that_are_a_stack_now_count_once_and_by_no_former_method(archive: Archive) -> None:
    archive.sightings.replace([replace(FOUND, file=name, method="disc") for name in ("a.jpg", "b.jpg")])
    member = replace(REFUSED, file="b.jpg", verdict="in_stack")
    archive.sightings.replace([REFUSED, member])  # of a stack without a sun nothing is set aside
    assert len(archive.sightings.find("roof", accepted=True)) == 2
    archive.sightings.replace([FOUND, member])
    assert [(p.method, p.file) for p in archive.sightings.find("roof", accepted=True)] == [("paper", "a.jpg")]


def test_what_is_stored_of_files_is_found_by_its_time(archive: Archive) -> None:
    later = replace(REFUSED, time=NOON + timedelta(seconds=1))
    archive.sightings.replace([FOUND, later, replace(FOUND, body="moon", file="c.jpg")])
    (found,) = archive.sightings.file_sightings("roof", times_us=AT_NOON)
    assert found.key == ImageKey(to_microseconds(NOON), 0.0, "a.jpg", "")
    assert (found.accepted, found.verdict, found.ingest_pass) == (True, "clear", 1)
    assert (found.x_px, found.y_px, found.sigma_px) == (900.0, 700.0, 2.0)
    assert archive.sightings.file_sightings("attic", times_us=AT_NOON) == []


def test_sightings_of_version_0_2_get_the_names_of_their_files(archive: Archive) -> None:
    unnamed = replace(FOUND, file="", exposure_us=20.0)
    archive.sightings.replace([unnamed, replace(unnamed, exposure_us=40.0)])
    former = ImageKey(to_microseconds(NOON), 20.0, "")
    archive.sightings.rename_files("roof", {former: image_key(to_microseconds(NOON), 20.0, "short.png")})
    assert [p.file for p in archive.sightings.find("roof")] == ["short.png", ""]


def test_a_learned_sigma_changes_one_methods_sightings_of_files_alone(archive: Archive) -> None:
    others = [replace(FOUND, method="disc"), replace(FOUND, file="", time=NOON + timedelta(seconds=9))]
    archive.sightings.add([FOUND, *others])
    assert archive.sightings.scale_sigma("roof", method="paper", factor=1.5, event=LEARNED) == 1
    assert [p.sigma_px for p in archive.sightings.find("roof")] == [3.0, 2.0, 2.0]
    assert [event.kind for event in archive.events.find("roof")] == ["sigma_learned"]


def test_a_calibration_keeps_the_sigma_that_it_was_given(archive: Archive) -> None:
    sigma = [1.0, 2.0, 4.0]
    archive.sightings.add(replace(FOUND, time=NOON + timedelta(minutes=n), sigma_px=one) for n, one in enumerate(sigma))
    archive.calibrations.add(document("a"), used=archive.sightings.columns("roof"))
    for _ in range(2):
        archive.sightings.scale_sigma("roof", method="paper", factor=2.0, event=LEARNED)
        archive.calibrations.add(document(f"b{_}"), used=archive.sightings.columns("roof"))
    given = {name: archive.calibrations.sightings_given_to(name).sigma_px.tolist() for name in ("a", "b0", "b1")}
    assert given == {"a": sigma, "b0": [2.0, 4.0, 8.0], "b1": [4.0, 8.0, 16.0]}


@pytest.mark.parametrize("n_learned", [0, 1])
def test_a_calibration_keeps_what_is_measured_anew(archive: Archive, n_learned: int) -> None:
    minutes = [replace(FOUND, time=NOON + timedelta(minutes=n)) for n in range(3)]
    archive.sightings.add(minutes)
    archive.calibrations.add(document("a"), used=archive.sightings.columns("roof"))
    before = archive.calibrations.sightings_given_to("a")
    for _ in range(n_learned):
        archive.sightings.scale_sigma("roof", method="paper", factor=2.0, event=LEARNED)
    archive.sightings.replace([replace(minutes[1], x_px=905.0, sigma_px=0.5)])
    archive.calibrations.add(document("b"), used=archive.sightings.columns("roof"))
    archive.sightings.widen_clock_errors("roof", since=NOON, until=NOON + timedelta(hours=1), error_s=3.0)
    archive.sightings.replace([replace(minutes[2], x_px=None, y_px=None, accepted=False, verdict="no_sun")])
    kept = archive.calibrations.sightings_given_to("a")
    for name in ("unix_s", "pixels", "sigma_px", "clock_error_s", "ids"):
        np.testing.assert_array_equal(getattr(kept, name), getattr(before, name))
    assert archive.calibrations.sightings_given_to("b").pixels[:, 0].tolist() == [900.0, 905.0, 900.0]


def test_sightings_measured_anew_during_a_fit_are_kept_as_the_fit_had_them(archive: Archive) -> None:
    archive.sightings.add([FOUND])
    used = archive.sightings.columns("roof")
    archive.sightings.scale_sigma("roof", method="paper", factor=2.0, event=LEARNED)
    archive.calibrations.add(document("a"), used=used)
    assert archive.calibrations.sightings_given_to("a").sigma_px.tolist() == [2.0]


def test_a_moved_sighting_of_a_calibration_is_still_noticed(archive: Archive, path: Path) -> None:
    archive.sightings.add([FOUND])
    archive.calibrations.add(document("a"), used=archive.sightings.columns("roof"))
    archive.sightings.scale_sigma("roof", method="paper", factor=2.0, event=LEARNED)
    with closing(sqlite3.connect(path)) as connection, connection:
        connection.execute("UPDATE sun_point SET x_px = x_px + 1")
    with pytest.raises(InputError, match="changed since"):
        archive.calibrations.sightings_given_to("a")


@pytest.mark.parametrize("damage", ["x'00'", "'text'"])
def test_a_damaged_sigma_of_a_calibration_is_named(archive: Archive, path: Path, damage: str) -> None:
    archive.sightings.add([FOUND])
    archive.calibrations.add(document("a"), used=archive.sightings.columns("roof"))
    with closing(sqlite3.connect(path)) as connection, connection:
        connection.execute(f"UPDATE used_sightings SET sigma = {damage}")  # noqa: S608 - the test's own
    with pytest.raises(InputError, match="damaged"):
        archive.calibrations.sightings_given_to("a")


def test_an_older_database_gets_the_new_key_and_its_ids_stay(archive: Archive, path: Path) -> None:
    archive.sightings.add(replace(FOUND, time=NOON + timedelta(seconds=n), file="") for n in range(5))
    archive.calibrations.add(document("a"), used=archive.sightings.columns("roof"))
    archive.close()
    downgrade(path, "0010")
    with closing(sqlite3.connect(path)) as connection:
        columns = [row[1] for row in connection.execute("PRAGMA table_info(sun_point)")]
        assert not {"file", "ingest_pass"} & set(columns)
        with pytest.raises(sqlite3.IntegrityError):
            connection.execute(_a_double(columns))
    upgrade(path)
    with open_archive(path) as opened:
        assert [point.file for point in opened.sightings.find("roof")] == [""] * 5
        np.testing.assert_array_equal(opened.calibrations.sightings_given_to("a").ids, [1, 2, 3, 4, 5])
        assert opened.sightings.add([FOUND]) == 1


def test_an_older_revision_keeps_the_first_of_a_stack(archive: Archive, path: Path) -> None:
    files: list[dict[str, Any]] = [{"file": name, "x_px": float(x)} for x, name in enumerate("abc", start=1)]
    archive.sightings.add(replace(FOUND, **one) for one in files)
    archive.close()
    downgrade(path, "0010")
    with closing(sqlite3.connect(path)) as connection:
        assert connection.execute("SELECT id, x_px FROM sun_point").fetchall() == [(1, 1.0)]


def _a_double(columns: list[str]) -> str:
    """Return the statement that stores the first sighting again, under another id."""
    names = ", ".join(name for name in columns if name != "id")
    return f"INSERT INTO sun_point ({names}) SELECT {names} FROM sun_point WHERE id = 1"  # noqa: S608 - own names
