from __future__ import annotations

import sqlite3
from contextlib import closing
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from typing import TYPE_CHECKING

import numpy as np
import pytest

from sunarc.common.errors import InputError, NotFoundError
from sunarc.imager.archive.values import SunPoint

from .test_calibrations import MAY, document

if TYPE_CHECKING:
    from pathlib import Path

    from sunarc.imager.archive.archive import Archive


def point(time: datetime, x_px: float, *, accepted: bool = True, sigma_px: float | None = None) -> SunPoint:
    return SunPoint(
        camera="roof",
        pose_epoch="roof-1",
        time=time,
        method="disc",
        accepted=accepted,
        verdict="clear",
        x_px=x_px,
        y_px=900.0,
        sigma_px=sigma_px,
    )


@pytest.fixture
def rested(archive: Archive) -> Archive:
    """Return an archive with a calibration that rests on every third accepted one of 300 sightings."""
    archive.sightings.add(
        point(MAY + timedelta(minutes=n), 800.0 + n, accepted=n % 7 != 0, sigma_px=None if n % 2 else 0.02)
        for n in range(300)
    )
    columns = archive.sightings.columns("roof")
    archive.calibrations.add(document("a"), used=columns.select(np.arange(0, columns.ids.size, 3)))
    return archive


def test_the_sightings_of_a_calibration_come_back_as_they_were(rested: Archive) -> None:
    given = rested.sightings.columns("roof").select(np.arange(0, 257, 3))
    rested.sightings.add([point(MAY + timedelta(seconds=1), 1.0)])
    rested.epochs.open("roof", at=MAY + timedelta(minutes=30), reason="found out later")
    found = rested.calibrations.sightings_given_to("a")
    for name in ("unix_s", "pixels", "sigma_px", "clock_error_s", "epoch", "ids"):
        assert np.array_equal(getattr(found, name), getattr(given, name), equal_nan=True)
    assert found.epoch_ids == ("roof-1",)


def test_two_epochs_come_back_as_two(rested: Archive) -> None:
    rested.epochs.open("roof", at=MAY + timedelta(minutes=100), reason="moved")
    columns = rested.sightings.columns("roof")
    rested.calibrations.add(document("b", pose_epoch="roof-2"), used=columns)
    found = rested.calibrations.sightings_given_to("b")
    assert found.epoch_ids == ("roof-1", "roof-2")
    assert np.array_equal(found.epoch, columns.epoch)


def test_a_copy_rests_on_the_same_sightings(rested: Archive) -> None:
    rested.calibrations.activate("a")
    rested.calibrations.add(document("b", day=1))
    rested.calibrations.activate("b")
    copy = rested.calibrations.reinstate("a", at=MAY + timedelta(days=2), reason="")
    assert np.array_equal(
        rested.calibrations.sightings_given_to(copy.id).ids, rested.calibrations.sightings_given_to("a").ids
    )


@pytest.mark.parametrize(
    ("edit", "told"),
    [
        ("UPDATE sun_point SET x_px = x_px + 0.001 WHERE id = 5", "were changed since"),
        ("UPDATE sun_point SET sigma_px = 1 WHERE id = 5", "were changed since"),
        ("DELETE FROM sun_point WHERE id BETWEEN 5 AND 12", "of its 86 sightings are gone"),
    ],
)
def test_sightings_edited_by_hand_are_noticed(rested: Archive, path: Path, edit: str, told: str) -> None:
    with closing(sqlite3.connect(path)) as by_hand, by_hand:
        by_hand.execute(edit)
    with pytest.raises(InputError, match=told):
        rested.calibrations.sightings_given_to("a")
    assert rested.calibrations.get("a").id == "a"


def test_a_calibration_without_its_sightings_says_so(rested: Archive) -> None:
    rested.calibrations.add(document("b"))
    with pytest.raises(NotFoundError, check=lambda error: error.field == "id"):
        rested.calibrations.sightings_given_to("b")


def test_the_keys_of_ten_thousand_sightings_take_a_few_kilobytes(rested: Archive, path: Path) -> None:
    moment = datetime(2014, 1, 1, tzinfo=UTC)
    rested.sightings.add(point(moment + timedelta(seconds=n), 1.0) for n in range(20_000))
    columns = rested.sightings.columns("roof", since=moment)
    kept = np.sort(np.random.default_rng(1).choice(20_000, 10_000, replace=False))
    rested.calibrations.add(document("b"), used=columns.select(kept))
    with closing(sqlite3.connect(path)) as by_hand:
        (size,) = by_hand.execute("SELECT length(ids) FROM used_sightings WHERE calibration = 'b'").fetchone()
    assert size < 6000


def test_stars_that_a_calibration_rests_on_come_back_with_their_names(archive: Archive) -> None:
    night = MAY + timedelta(hours=14)
    star = replace(point(night, 300.0, sigma_px=0.1), method="star", body="star:HIP11767")
    archive.sightings.add([point(MAY, 800.0, sigma_px=0.02), star])
    columns = archive.sightings.columns("roof", body=None)
    archive.calibrations.add(document("a"), used=columns)
    found = archive.calibrations.sightings_given_to("a")
    assert found.body.tolist() == ["sun", "star:HIP11767"]
    assert found.ids.tolist() == columns.ids.tolist()
