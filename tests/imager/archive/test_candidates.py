"""What decides which sightings a fit uses is read by itself, and agrees with what is read of the sightings whole."""

from __future__ import annotations

import sqlite3
from contextlib import closing
from dataclasses import replace
from datetime import timedelta
from pathlib import Path

import numpy as np
import pytest
from tests.imager.archive.test_sightings import HIDDEN, NOON, SEEN, later

from sunarc.imager.archive.archive import Archive
from sunarc.imager.archive.values import SunPointColumns


def agrees(archive: Archive) -> SunPointColumns:
    """Compare the candidates with the sightings of the sun, and return the latter."""
    read, whole = archive.sightings.candidates("roof"), archive.sightings.columns("roof")
    order = np.lexsort((read.ids, read.candidates.unix_s))
    np.testing.assert_array_equal(read.ids[order], whole.ids)
    for name in ("unix_s", "sigma_px", "clock_error_s"):
        np.testing.assert_array_equal(getattr(read.candidates, name)[order], getattr(whole, name))
    names = [read.epoch_ids[number] for number in read.candidates.epoch[order].tolist()]
    assert names == [whole.epoch_ids[number] for number in whole.epoch.tolist()]
    again = archive.sightings.by_ids("roof", read.ids)
    for name in ("unix_s", "pixels", "sigma_px", "ids", "body", "epoch"):
        np.testing.assert_array_equal(getattr(again, name), getattr(whole, name))
    return whole


def test_candidates_are_the_accepted_sightings_of_the_sun(archive: Archive) -> None:
    points = [later(SEEN, 30), SEEN, later(HIDDEN, 60), later(SEEN, 90, sigma_px=None, clock_error_s=None)]
    archive.sightings.add([*points, later(SEEN, 99, body="moon"), replace(SEEN, exposure_us=12.0)])
    archive.epochs.open("roof", at=NOON + timedelta(seconds=45), reason="bumped")
    whole = agrees(archive)
    assert (whole.ids.size, whole.epoch_ids) == (4, ("roof-1", "roof-2"))
    since, until = NOON + timedelta(seconds=30), NOON + timedelta(seconds=90)
    assert archive.sightings.candidates("roof", since=since, until=until).ids.size == 1


def test_sightings_but_those_of_the_sun(archive: Archive) -> None:
    archive.sightings.add([SEEN, replace(SEEN, body="moon"), later(SEEN, 30, body="star:HIP32349"), later(SEEN, 60)])
    others = archive.sightings.columns("roof", body=None, no_sun=True)
    assert others.body.tolist() == ["moon", "star:HIP32349"]


def test_without_sightings_there_are_no_candidates(archive: Archive) -> None:
    assert agrees(archive).ids.size == 0
    assert archive.sightings.candidates("nowhere").ids.size == 0  # and no pose epoch either
    assert archive.sightings.by_ids("roof", np.array([1, 2])).ids.size == 0


@pytest.mark.parametrize(
    ("damage", "left"),
    [
        ("time = 'noon'", 3),
        ("x_px = NULL", 3),
        ("y_px = 'left'", 3),
        ("pose_epoch = 'roof-9'", 3),
        ("body = 'sum'", 3),
        ("sigma_px = 'small'", 4),
        ("clock_error_s = x'ff'", 4),
    ],
)
def test_a_damaged_cell_leaves_out_no_more_than_its_row(path: Path, archive: Archive, damage: str, left: int) -> None:
    archive.sightings.add(later(SEEN, 30.0 * number) for number in range(4))
    with closing(sqlite3.connect(path, isolation_level=None)) as connection:
        connection.execute(f"UPDATE sun_point SET {damage} WHERE rowid = 2")  # noqa: S608 - of a test
    assert agrees(archive).ids.size == left
