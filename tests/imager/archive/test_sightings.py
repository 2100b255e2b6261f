from __future__ import annotations

import math
from dataclasses import replace
from datetime import UTC, date, datetime, timedelta
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sunarc.common.errors import InputError
from sunarc.common.findings import Finding
from sunarc.imager.archive.archive import Archive
from sunarc.imager.archive.database.tables import UtcTime
from sunarc.imager.archive.values import PoseEpoch, SunPoint

NOON = datetime(2013, 5, 13, 18, 30, tzinfo=UTC)
SEEN = SunPoint(
    camera="roof",
    pose_epoch="roof-1",
    time=NOON,
    method="disc",
    accepted=True,
    verdict="clear",
    findings=(Finding("disc_found", {"chi2": 1.0523456789012345}), Finding("saturated_left_out", {"n": 12})),
    exposure_us=47.3,
    x_px=900.25,
    y_px=700.125,
    sigma_px=0.03,
    peak_fraction=0.6,
    saturated_px=0,
    clock_error_s=0.01,
)
HIDDEN = replace(SEEN, accepted=False, verdict="hidden", x_px=None, y_px=None, sigma_px=None)


def later(point: SunPoint, seconds: float, **changes: Any) -> SunPoint:  # noqa: ANN401 - fields of many types
    return replace(point, time=point.time + timedelta(seconds=seconds), **changes)


@given(st.datetimes(min_value=datetime(1970, 1, 1), max_value=datetime(2200, 1, 1)))  # noqa: DTZ001 - made aware below
@settings(derandomize=True, deadline=None)
def test_a_time_is_stored_exactly(time: datetime) -> None:
    aware, kept = time.replace(tzinfo=UTC), UtcTime()
    stored = kept.process_bind_param(aware, None)  # type: ignore[arg-type]
    assert kept.process_result_value(stored, None) == aware  # type: ignore[arg-type]


def test_a_sighting_comes_back_as_it_went_in(archive: Archive) -> None:
    points = (SEEN, later(HIDDEN, 30.000001))
    assert archive.sightings.add(points) == 2
    assert archive.sightings.find("roof") == points


def test_doubles_are_ignored_and_the_first_one_stays(archive: Archive) -> None:
    assert archive.sightings.add([SEEN, SEEN]) == 1
    assert archive.sightings.add([replace(SEEN, x_px=1.0), later(SEEN, 1e-6)]) == 1
    assert archive.sightings.find("roof")[0].x_px == SEEN.x_px


@pytest.mark.parametrize("change", [{"body": "moon"}, {"exposure_us": 47.4}, {"method": "paper"}])
def test_another_body_exposure_or_method_is_another_sighting(archive: Archive, change: dict[str, Any]) -> None:
    assert archive.sightings.add([SEEN, replace(SEEN, **change)]) == 2


def test_one_bad_sighting_keeps_the_whole_batch_out(archive: Archive) -> None:
    with pytest.raises(InputError, match=r"(?i)foreign key"):
        archive.sightings.add([SEEN, later(SEEN, 30, pose_epoch="nowhere")])
    assert archive.sightings.find("roof") == ()


@pytest.mark.parametrize("x", [None, math.nan, math.inf])
def test_an_accepted_sighting_must_be_somewhere(x: float | None) -> None:
    with pytest.raises(InputError, check=lambda error: error.field == "x_px, y_px"):
        replace(SEEN, x_px=x)


def test_sightings_are_chosen_by_time_verdict_and_epoch(archive: Archive) -> None:
    archive.sightings.add(later(HIDDEN if i % 3 == 0 else SEEN, 30.0 * i) for i in range(10))
    since, until = NOON + timedelta(seconds=60), NOON + timedelta(seconds=240)
    seen = archive.sightings.find("roof", since=since, until=until, accepted=True)
    assert [(p.time - NOON).total_seconds() for p in seen] == [60, 120, 150, 210]
    newest = archive.sightings.find("roof", newest_first=True, limit=2)
    assert [(p.time - NOON).total_seconds() for p in newest] == [270, 240]
    assert archive.sightings.find("roof", pose_epoch="other") == archive.sightings.find("attic") == ()


def test_columns_hold_the_accepted_sightings_in_the_order_of_time(archive: Archive) -> None:
    points = [later(SEEN, 30), SEEN, later(HIDDEN, 60), later(SEEN, 90, sigma_px=None), later(SEEN, 99, body="moon")]
    archive.sightings.add(points)
    columns = archive.sightings.columns("roof")
    np.testing.assert_array_equal(columns.unix_s - NOON.timestamp(), [0, 30, 90])
    np.testing.assert_array_equal(columns.pixels, [[SEEN.x_px, SEEN.y_px]] * 3)
    np.testing.assert_array_equal(columns.sigma_px, [0.03, 0.03, math.nan])
    np.testing.assert_array_equal(columns.clock_error_s, [0.01] * 3)
    assert columns.epoch_ids == ("roof-1",)


def test_columns_of_one_moment_are_in_the_order_of_their_keys(archive: Archive) -> None:
    """An index by time and body has them in another: the moon before the sun."""
    archive.sightings.add([later(SEEN, 30), SEEN, replace(SEEN, body="moon"), replace(SEEN, exposure_us=20.0)])
    columns = archive.sightings.columns("roof", body=None)
    np.testing.assert_array_equal(columns.unix_s - NOON.timestamp(), [0, 0, 0, 30])
    np.testing.assert_array_equal(columns.ids - columns.ids.min(), [1, 2, 3, 0])
    assert columns.body.tolist() == ["sun", "moon", "sun", "sun"]


def test_columns_since_a_key_are_those_that_were_stored_later(archive: Archive) -> None:
    archive.sightings.add([later(SEEN, 30)])
    (first,) = archive.sightings.columns("roof").ids.tolist()
    archive.sightings.add([SEEN, later(SEEN, 60)])
    np.testing.assert_array_equal(archive.sightings.columns("roof", after_id=first).unix_s - NOON.timestamp(), [0, 60])
    assert archive.sightings.columns("roof", after_id=0).ids.size == 3


def test_columns_without_a_sighting_are_empty(archive: Archive) -> None:
    columns = archive.sightings.columns("roof")
    assert (columns.unix_s.shape, columns.pixels.shape, columns.epoch_ids) == ((0,), (0, 2), ())


def test_a_new_epoch_ends_the_one_before_and_takes_the_sightings_since_then(archive: Archive) -> None:
    archive.sightings.add(later(SEEN, 30.0 * i) for i in range(4))
    change = NOON + timedelta(seconds=45)
    epoch = archive.epochs.open("roof", at=change, reason="bumped")
    assert epoch == PoseEpoch(id="roof-2", camera="roof", started_at=change, reason="bumped")
    assert archive.epochs.find("roof")[0].ended_at == change
    assert archive.epochs.current("roof") == epoch
    before = archive.epochs.current("roof", at=NOON)
    assert before is not None
    assert before.id == "roof-1"
    columns = archive.sightings.columns("roof")
    assert [columns.epoch_ids[i] for i in columns.epoch] == ["roof-1", "roof-1", "roof-2", "roof-2"]
    assert archive.sightings.columns("roof", pose_epoch="roof-2").unix_s.size == 2


def test_an_epoch_cannot_begin_before_the_one_that_goes_on(archive: Archive) -> None:
    with pytest.raises(InputError, check=lambda error: error.field == "at"):
        archive.epochs.open("roof", at=datetime(2013, 5, 1, tzinfo=UTC), reason="twice")
    assert len(archive.epochs.find("roof")) == 1


def test_there_is_no_epoch_before_the_first(archive: Archive) -> None:
    assert archive.epochs.current("roof", at=datetime(2013, 4, 1, tzinfo=UTC)) is None
    assert archive.epochs.current("attic") is None


def test_an_unknown_camera_has_no_epochs(archive: Archive) -> None:
    with pytest.raises(InputError, check=lambda error: error.field == "archive"):
        archive.epochs.open("attic", at=NOON, reason="installed")


@pytest.mark.parametrize(
    ("longitude", "expected"),
    [
        (-97.485, [date(2013, 5, 13), date(2013, 5, 15)]),
        (175.0, [date(2013, 5, 14), date(2013, 5, 16)]),
        (-175.0, [date(2013, 5, 13), date(2013, 5, 15)]),
    ],
)
def test_dates_with_points_are_solar_dates(archive: Archive, longitude: float, expected: list[date]) -> None:
    archive.sightings.add([SEEN, later(HIDDEN, 600), later(HIDDEN, 48 * 3600)])
    assert archive.sightings.dates("roof", longitude=longitude) == tuple(expected)
    assert archive.sightings.dates("roof", longitude=longitude, since=expected[1]) == (expected[1],)


def test_a_camera_may_be_described_anew(archive: Archive) -> None:
    changed = replace(archive.cameras.all()[0], serial="42")
    archive.cameras.save(changed)
    assert archive.cameras.all() == (changed,)


def test_the_epoch_of_a_moment_is_opened_when_there_is_none(archive: Archive) -> None:
    archive.cameras.save(replace(archive.cameras.all()[0], name="attic"))
    first = archive.epochs.at("attic", NOON, reason="first frame")
    assert first == PoseEpoch(id="attic-1", camera="attic", started_at=NOON, reason="first frame")
    assert archive.epochs.at("attic", NOON + timedelta(days=9), reason="another") == first


def test_the_first_epoch_reaches_back_to_earlier_sightings_and_no_other_does(archive: Archive) -> None:
    archive.epochs.open("roof", at=NOON, reason="bumped")
    assert archive.epochs.at("roof", NOON - timedelta(seconds=1), reason="import").id == "roof-1"
    early = datetime(2012, 1, 1, tzinfo=UTC)
    reaching = archive.epochs.at("roof", early, reason="import")
    assert (reaching.id, reaching.started_at) == ("roof-1", early)
    assert archive.epochs.find("roof") == (reaching, archive.epochs.current("roof"))


STAR = replace(SEEN, time=NOON + timedelta(hours=12), method="star", body="star:HIP32349")


def test_stars_are_beside_the_sun_and_only_where_they_are_wanted(archive: Archive) -> None:
    other = replace(STAR, body="venus", x_px=12.0)
    archive.sightings.add([SEEN, STAR, other])
    assert archive.sightings.find("roof") == (SEEN,)
    assert archive.sightings.find("roof", body="venus") == (other,)
    assert archive.sightings.find("roof", body=None) == (SEEN, STAR, other)
    assert archive.sightings.columns("roof").body.tolist() == ["sun"]
    every = archive.sightings.columns("roof", body=None)
    assert every.body.tolist() == ["sun", "star:HIP32349", "venus"]
    assert every.select(np.array([2, 1])).body.tolist() == ["venus", "star:HIP32349"]
    assert archive.sightings.dates("roof", longitude=-97.5) == (date(2013, 5, 13),)
