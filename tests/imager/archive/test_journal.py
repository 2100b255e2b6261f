from __future__ import annotations

import sqlite3
from contextlib import closing
from dataclasses import replace
from datetime import UTC, date, datetime, timedelta
from pathlib import Path
from typing import Any

import pytest
from tests.fixtures.archive import make_empty
from tests.fixtures.nights import judged, whole_night
from tests.fixtures.stores import ROOF

from sunarc.common.errors import InputError, NotFoundError
from sunarc.common.findings import Finding, uncoded
from sunarc.imager.archive.archive import Archive, open_archive
from sunarc.imager.archive.days import event_night
from sunarc.imager.archive.values import Day, Event, Refit

from .test_revisions import night_image

NOW = datetime(2013, 5, 14, 2, tzinfo=UTC)
CLEAR = Day(
    camera="roof",
    date=date(2013, 5, 13),
    verdict="clear",
    findings=(Finding("day_share_on_arc", {"share": 0.98, "n_observed": 810}),),
    n=800,
    n_possible=810,
    arc_deg=140.0,
    sd_px=0.05,
    rmsd_px=0.07,
    decided_at=NOW,
)


def test_a_day_comes_back_and_a_later_verdict_replaces_it(archive: Archive) -> None:
    archive.days.save(CLEAR)
    partly = replace(
        CLEAR,
        verdict="partly",
        findings=(Finding("day_scatter"), uncoded("noon")),
        sd_px=None,
    )
    archive.days.save(partly)
    assert archive.days.find("roof") == (partly,)


def test_days_are_the_newest_first_within_bounds(archive: Archive) -> None:
    for day in range(1, 6):
        archive.days.save(replace(CLEAR, date=date(2013, 5, day)))
    dates = [day.date.day for day in archive.days.find("roof", since=date(2013, 5, 2), until=date(2013, 5, 5))]
    assert dates == [4, 3, 2]
    assert len(archive.days.find("roof", limit=1)) == 1


def test_a_refit_is_followed_to_its_end(archive: Archive) -> None:
    asked = archive.refits.add(Refit(id="r1", camera="roof", requested_at=NOW, reason="clear day"))
    assert archive.refits.get("r1") == asked
    archive.refits.start("r1", started_at=NOW + timedelta(seconds=1))
    assert [refit.state for refit in archive.refits.find("roof", unfinished=True)] == ["running"]
    ended = archive.refits.finish("r1", state="failed", finished_at=NOW + timedelta(seconds=9), message="no arc")
    assert (ended.state, ended.message) == ("failed", "no arc")
    assert archive.refits.find("roof", unfinished=True) == ()
    assert archive.refits.find("roof") == (ended,)


def test_refits_that_are_asked_for_while_one_waits_are_one(archive: Archive) -> None:
    def asked(number: int, camera: str = "roof") -> str:
        refit = Refit(id=f"{camera}{number}", camera=camera, requested_at=NOW + timedelta(seconds=number), reason="x")
        return archive.refits.request(refit).id

    archive.cameras.save(replace(archive.cameras.all()[0], name="mast"))
    assert [asked(number) for number in range(3)] == ["roof0"] * 3
    assert asked(3, "mast") == "mast3"
    archive.refits.start("roof0", started_at=NOW)  # it may have read the sightings already
    assert [asked(number) for number in range(4, 7)] == ["roof4"] * 3
    archive.refits.finish("roof0", state="refused", finished_at=NOW)
    archive.refits.start("roof4", started_at=NOW)
    archive.refits.finish("roof4", state="failed", finished_at=NOW)
    assert asked(7) == "roof7"
    assert len(archive.refits.find("roof")) == 3


def test_an_unknown_refit_is_not_found(archive: Archive) -> None:
    with pytest.raises(NotFoundError, check=lambda error: error.field == "id"):
        archive.refits.finish("r9", state="failed", finished_at=NOW)


def test_events_are_told_the_newest_first(archive: Archive) -> None:
    bump = Event(time=NOW, kind="bump", severity="alarm", text="it moved", camera="roof", details={"deg": 0.2})
    stored = archive.events.add(bump)
    assert stored == replace(bump, id=stored.id)
    archive.events.add(Event(time=NOW + timedelta(seconds=1), kind="disk", severity="warning", text="nearly full"))
    archive.events.add(Event(time=NOW - timedelta(days=9), kind="start", severity="info", text="started"))
    assert [event.kind for event in archive.events.find("roof")] == ["disk", "bump", "start"]
    assert archive.events.find("attic", severity="alarm") == ()
    assert archive.events.find(since=NOW, until=NOW + timedelta(seconds=1)) == (stored,)


def listed(archive: Archive, **limits: Any) -> list[tuple[str, str]]:  # noqa: ANN401 - arguments of any kind
    return [(f"{night.date}", night.verdict) for night in archive.nights.find("roof", **limits)]


def test_a_night_that_is_judged_again_is_one_night_as_it_was_judged_last(archive: Archive) -> None:
    for day in range(20):
        archive.nights.save(judged(f"2013-05-{day + 1:02d}", at=NOW + timedelta(days=day), verdict="partly"))
    # of the last image of the night: before the service judged it, and stored after that
    archive.nights.save(judged("2013-05-03", at=NOW + timedelta(days=2, minutes=-20), verdict="clear"))
    archive.nights.save(judged("2013-05-20", at=NOW + timedelta(days=19, minutes=-20), verdict="cloudy"))
    every = listed(archive)
    assert [date for date, _ in every] == [f"2013-05-{day:02d}" for day in range(20, 0, -1)]
    assert (every[0][1], every[17][1], every[1][1]) == ("cloudy", "clear", "partly")
    for limit in range(1, 21):
        assert listed(archive, limit=limit) == every[:limit]
    third = NOW + timedelta(days=2)
    assert listed(archive, since=third, until=third + timedelta(minutes=1)) == []  # it was judged again at another time
    assert listed(archive, since=third - timedelta(hours=1), until=third) == [("2013-05-03", "clear")]
    assert listed(archive, until=datetime.max.replace(tzinfo=UTC), limit=1) == every[:1]
    assert archive.nights.find("mast") == ()


def test_a_night_is_read_as_it_was_stored(archive: Archive) -> None:
    night = whole_night(NOW)
    archive.nights.save(night)
    assert archive.nights.find("roof") == (night,)
    archive.nights.save(replace(night, images=None, picture_time=None, halo=None))
    assert archive.nights.find("roof") == (replace(night, images=None, picture_time=None, halo=None),)


def test_a_night_and_its_event_are_stored_together_and_end_its_images(archive: Archive) -> None:
    archive.nights.add_image("roof", night_image(NOW), keep_since=NOW)
    night = whole_night(NOW)
    archive.nights.save(night, event=Event(time=NOW, kind="night", severity="info", text="", camera="roof"))
    assert len(archive.nights.images("roof")) == len(archive.events.find("roof", kind="night")) == 1
    with pytest.raises(InputError):
        archive.nights.save(replace(night, date=date(2013, 5, 20), camera="none"), drops_images=True)
    assert (archive.nights.find("roof"), len(archive.nights.images("roof"))) == ((night,), 1)
    archive.nights.save(night, drops_images=True)
    assert archive.nights.images("roof") == ()


@pytest.mark.parametrize(
    ("column", "value"),
    [
        ("verdict", "'bright'"),
        ("n_images", "'many'"),
        ("n_matched", "x'00'"),
        ("zenith_bands", """'[{"from": 0.0, "to": 30.0}]'"""),
        ("zenith_bands", "'['"),
    ],
)
def test_a_night_that_lacks_a_value_is_damaged_and_none_of_its_numbers_is_made_up(
    path: Path, column: str, value: str
) -> None:
    make_empty(path)
    with open_archive(path) as archive:
        archive.cameras.save(ROOF)
        archive.nights.save(whole_night(NOW))
        archive.nights.save(replace(whole_night(NOW), date=date(2013, 5, 11)))
        with closing(sqlite3.connect(path, isolation_level=None)) as connection:
            connection.execute(f"UPDATE night SET {column} = {value} WHERE date = '2013-05-11'")  # noqa: S608
        sound, damaged = archive.nights.find("roof")
        assert sound == whole_night(NOW)
        assert damaged.findings == (Finding("night_damaged", {"field": column}),)
        assert (damaged.verdict, damaged.n_accepted, damaged.halo) == ("unusable", 0, None)
        with closing(sqlite3.connect(path, isolation_level=None)) as connection:
            connection.execute("UPDATE night SET date = 'yesterday' WHERE date = '2013-05-11'")
        assert archive.nights.find("roof") == (sound,)


def test_an_event_of_a_former_version_is_a_night() -> None:
    numbers = {"n_images": 48, "n_accepted": 46, "halo": 0.01, "another": 1.0, "reasons": "as it was"}
    details = {"date": "2013-05-12", "verdict": "clear", **numbers, "findings": [{"code": "a", "data": {"x": None}}]}
    told = event_night("roof", NOW, details)
    assert told is not None
    assert (told.date, told.verdict, told.decided_at) == (date(2013, 5, 12), "clear", NOW)
    assert (told.n_images, told.n_accepted, told.n_warm_pixels) == (48, 46, 0)
    assert (told.halo, told.zero_point, told.images, told.zenith_bands) == (0.01, None, None, ())
    assert [finding.code for finding in told.findings] == ["a"]
    for lacking, expected in (({"n_images": None}, "n_images"), ({"verdict": "bright"}, "verdict")):
        damaged = event_night("roof", NOW, {**details, **lacking})
        assert damaged is not None
        assert (damaged.verdict, damaged.findings) == ("unusable", (Finding("night_damaged", {"field": expected}),))
    for unread in ({"date": "yesterday"}, {}):
        assert event_night("roof", NOW, unread and {**details, **unread}) is None
