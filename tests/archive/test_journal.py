from __future__ import annotations

from dataclasses import replace
from datetime import UTC, date, datetime, timedelta
from typing import Any

import pytest

from sunarc.archive.archive import Archive
from sunarc.archive.values import Day, Event, Refit
from sunarc.errors import NotFoundError
from sunarc.findings import Finding, uncoded

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
    archive.save_day(CLEAR)
    partly = replace(
        CLEAR,
        verdict="partly",
        findings=(Finding("day_scatter"), uncoded("noon")),
        sd_px=None,
    )
    archive.save_day(partly)
    assert archive.days("roof") == (partly,)


def test_days_are_the_newest_first_within_bounds(archive: Archive) -> None:
    for day in range(1, 6):
        archive.save_day(replace(CLEAR, date=date(2013, 5, day)))
    dates = [day.date.day for day in archive.days("roof", since=date(2013, 5, 2), until=date(2013, 5, 5))]
    assert dates == [4, 3, 2]
    assert len(archive.days("roof", limit=1)) == 1


def test_a_refit_is_followed_to_its_end(archive: Archive) -> None:
    asked = archive.add_refit(Refit(id="r1", camera="roof", requested_at=NOW, reason="clear day"))
    assert archive.refit("r1") == asked
    archive.start_refit("r1", started_at=NOW + timedelta(seconds=1))
    assert [refit.state for refit in archive.refits("roof", unfinished=True)] == ["running"]
    ended = archive.finish_refit("r1", state="failed", finished_at=NOW + timedelta(seconds=9), message="no arc")
    assert (ended.state, ended.message) == ("failed", "no arc")
    assert archive.refits("roof", unfinished=True) == ()
    assert archive.refits("roof") == (ended,)


def test_refits_that_are_asked_for_while_one_waits_are_one(archive: Archive) -> None:
    def asked(number: int, camera: str = "roof") -> str:
        refit = Refit(id=f"{camera}{number}", camera=camera, requested_at=NOW + timedelta(seconds=number), reason="x")
        return archive.request_refit(refit).id

    archive.save_camera(replace(archive.cameras()[0], name="mast"))
    assert [asked(number) for number in range(3)] == ["roof0"] * 3
    assert asked(3, "mast") == "mast3"
    archive.start_refit("roof0", started_at=NOW)  # it may have read the sightings already
    assert [asked(number) for number in range(4, 7)] == ["roof4"] * 3
    archive.finish_refit("roof0", state="refused", finished_at=NOW)
    archive.start_refit("roof4", started_at=NOW)
    archive.finish_refit("roof4", state="failed", finished_at=NOW)
    assert asked(7) == "roof7"
    assert len(archive.refits("roof")) == 3


def test_an_unknown_refit_is_not_found(archive: Archive) -> None:
    with pytest.raises(NotFoundError, match="no refit r9"):
        archive.finish_refit("r9", state="failed", finished_at=NOW)


def test_events_are_told_the_newest_first(archive: Archive) -> None:
    bump = Event(time=NOW, kind="bump", severity="alarm", text="it moved", camera="roof", details={"deg": 0.2})
    stored = archive.add_event(bump)
    assert stored == replace(bump, id=stored.id)
    archive.add_event(Event(time=NOW + timedelta(seconds=1), kind="disk", severity="warning", text="nearly full"))
    archive.add_event(Event(time=NOW - timedelta(days=9), kind="start", severity="info", text="started"))
    assert [event.kind for event in archive.events("roof")] == ["disk", "bump", "start"]
    assert archive.events("attic", severity="alarm") == ()
    assert archive.events(since=NOW, until=NOW + timedelta(seconds=1)) == (stored,)


def night(date: str, verdict: str, *, judged: datetime) -> Event:
    details = {"date": date, "verdict": verdict}
    return Event(camera="roof", time=judged, kind="night", severity="info", text="a night", details=details)


def listed(archive: Archive, **limits: Any) -> list[tuple[str, str]]:  # noqa: ANN401 - arguments of any kind
    return [(event.details["date"], event.details["verdict"]) for event in archive.nights("roof", **limits)]


def test_a_night_that_is_judged_again_is_one_night_as_it_was_judged_last(archive: Archive) -> None:
    for day in range(20):
        archive.add_event(night(f"2013-05-{day + 1:02d}", "partly", judged=NOW + timedelta(days=day)))
    # of the last image of the night: before the service judged it, and stored after that
    archive.add_event(night("2013-05-03", "clear", judged=NOW + timedelta(days=2, minutes=-20)))
    archive.add_event(night("2013-05-20", "cloudy", judged=NOW + timedelta(days=19, minutes=-20)))
    every = listed(archive)
    assert [date for date, _ in every] == [f"2013-05-{day:02d}" for day in range(20, 0, -1)]
    assert (every[0][1], every[17][1], every[1][1]) == ("cloudy", "clear", "partly")
    for limit in range(1, 21):
        assert listed(archive, limit=limit) == every[:limit]
    third = NOW + timedelta(days=2)
    assert listed(archive, since=third, until=third + timedelta(minutes=1)) == []  # it was judged again at another time
    assert listed(archive, since=third - timedelta(hours=1), until=third) == [("2013-05-03", "clear")]
    assert listed(archive, until=datetime.max.replace(tzinfo=UTC), limit=1) == every[:1]
    assert archive.nights("mast") == ()


def test_of_a_night_that_was_judged_a_hundred_times_the_nights_before_are_found(archive: Archive) -> None:
    for _ in range(100):
        archive.add_event(night("2013-05-04", "clear", judged=NOW + timedelta(days=3)))
    archive.add_event(night("2013-05-01", "clear", judged=NOW))
    damaged = replace(night("", "clear", judged=NOW), details={})
    archive.add_event(damaged)
    assert listed(archive, limit=2) == [("2013-05-04", "clear"), ("2013-05-01", "clear")]
