"""What a hub does by night in its store, on both engines."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import UTC, date, datetime, timedelta

import pytest
from sqlalchemy import text
from tests.fixtures.archive import store_sun_point
from tests.fixtures.stores import NOON
from tests.imager.archive.test_current import serve

from sunarc.common.errors import OutsideError
from sunarc.common.utc import utc_time
from sunarc.hub.archive import HubArchive
from sunarc.hub.nightly_store import NightlyRun
from sunarc.imager.archive.values import CameraRecord, Day, Event
from sunarc.sky.days import day_bounds_unix_s

DATE = date(2013, 5, 13)
LONGITUDE = -97.485


def judge(archive: HubArchive, day: date = DATE, *, decided_at: datetime = NOON, camera: str = "roof") -> None:
    archive.days.save(
        Day(
            camera=camera,
            date=day,
            verdict="clear",
            findings=(),
            n=2,
            n_possible=3,
            decided_at=decided_at,
            pose_offset_deg=(0.3, 0.0, -0.4),
        )
    )


def test_a_day_is_summarised_once_and_again_when_it_is_judged_anew(archive: HubArchive) -> None:
    first, after = map(utc_time, day_bounds_unix_s(DATE, longitude=LONGITUDE))
    store_sun_point(archive, first, clock_error_s=0.1, temperature_c=20.0)
    store_sun_point(archive, first + timedelta(hours=6), clock_error_s=0.4, temperature_c=30.0)
    store_sun_point(archive, after - timedelta(microseconds=1), accepted=False)
    store_sun_point(archive, after, clock_error_s=9.0)  # the next day's
    archive.events.add(Event(time=first, kind="bump", severity="alarm", text="it was", camera="roof"))
    archive.events.add(Event(time=first, kind="day", severity="info", text="it was", camera="roof"))
    serve(archive, "a", 0)
    judge(archive)
    assert (archive.nightly.summarise_days(), archive.nightly.summarise_days()) == (1, 0)
    (summary,) = archive.nightly.summaries("roof")
    assert (summary.n_sightings, summary.n_accepted, summary.n_warnings) == (3, 2, 1)
    assert (summary.clock_error_s, summary.temperature_c) == (0.4, 25.0)
    assert summary.pose_offset_deg == pytest.approx(0.5)
    assert (summary.verdict, summary.calibration) == ("clear", "a")
    store_sun_point(archive, first + timedelta(hours=7))
    judge(archive, decided_at=NOON + timedelta(days=30))  # it came late
    assert archive.nightly.summarise_days() == 1
    assert archive.nightly.summaries(None)[0].n_sightings == 4


def test_summaries_are_of_days_and_cameras_that_are_asked_for(archive: HubArchive) -> None:
    archive.cameras.save(CameraRecord(name="mast", latitude=0.0, longitude=179.0, altitude=0.0, width=4, height=4))
    for number in range(5):
        judge(archive, DATE + timedelta(days=number))
        judge(archive, DATE + timedelta(days=number), camera="mast")
    assert archive.nightly.summarise_days() == 10
    found = archive.nightly.summaries("mast", since=DATE + timedelta(days=1), until=DATE + timedelta(days=4), limit=2)
    assert [(one.camera, one.date.day) for one in found] == [("mast", 16), ("mast", 15)]
    assert len(archive.nightly.summaries(None)) == 10


def test_of_many_days_every_one_is_summarised(archive: HubArchive, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("sunarc.hub.nightly_store._AT_ONCE", 3)
    for number in range(7):
        judge(archive, DATE + timedelta(days=number))
    assert (archive.nightly.summarise_days(), archive.nightly.summarise_days()) == (7, 0)


def months(archive: HubArchive) -> list[str]:
    points = archive.sightings.find("roof")
    return sorted({point.time.strftime("%Y-%m") for point in points})


def test_sightings_are_removed_by_whole_months(archive: HubArchive) -> None:
    now = NOON
    archive.nightly.remove_sightings(before=now, now=now)  # months of other tests, which a server keeps when empty
    for days in (0, 30, 60, 90, 120, 150, 400):
        store_sun_point(archive, now - timedelta(days=days))
    kept = ["2012-12", "2013-01", "2013-02", "2013-03", "2013-04", "2013-05"]
    assert months(archive) == ["2012-04", *kept]
    assert archive.nightly.remove_sightings(before=datetime(2013, 1, 31, 23, tzinfo=UTC), now=now) == 2
    assert months(archive) == kept[1:]
    assert archive.nightly.remove_sightings(before=datetime(2013, 1, 31, 23, tzinfo=UTC), now=now) == 0
    store_sun_point(archive, now - timedelta(days=400))  # an imager sends all again
    assert months(archive)[0] == "2012-04"


def test_young_sightings_stay_whatever_is_asked(archive: HubArchive) -> None:
    store_sun_point(archive, NOON - timedelta(days=100))
    store_sun_point(archive, NOON - timedelta(days=60))
    archive.nightly.remove_sightings(before=NOON + timedelta(days=1000), now=NOON)
    assert months(archive) == ["2013-02", "2013-03"][-len(months(archive)) :]
    assert "2013-03" in months(archive)


def test_postgresql_itself_refuses_to_drop_what_is_young(archive: HubArchive, engine: str) -> None:
    if engine == "sqlite":
        pytest.skip("SQLite has no functions")
    with pytest.raises((OutsideError, Exception), match="90 days"), archive.database.writing() as connection:
        connection.execute(text("SELECT sunarc_drop_months((extract(epoch FROM now()) * 1000000)::bigint)"))


@pytest.mark.parametrize(
    ("longitudes", "mean"),
    [([], 0.0), ([10.0, 20.0], 15.0), ([170.0, -170.0], 180.0), ([-97.485], -97.485)],
)
def test_the_mean_longitude_is_an_angles(archive: HubArchive, longitudes: Sequence[float], mean: float) -> None:
    with archive.database.writing() as connection:
        connection.execute(text("DELETE FROM pose_epoch"))
        connection.execute(text("DELETE FROM camera"))
    for number, longitude in enumerate(longitudes):
        name = f"c{number}"
        archive.cameras.save(
            CameraRecord(name=name, latitude=0.0, longitude=longitude, altitude=0.0, width=4, height=4)
        )
    assert abs((archive.nightly.mean_longitude() - mean + 180.0) % 360.0 - 180.0) < 1e-9


def test_the_last_nights_are_known(archive: HubArchive) -> None:
    for number in range(3):
        night = DATE + timedelta(days=number)
        archive.nightly.save(NightlyRun(night=night, started_at=NOON, results={"a": {"n": number}}))
    archive.nightly.save(NightlyRun(night=DATE, started_at=NOON, finished_at=NOON, results={"a": {"error": "x"}}))
    runs = archive.nightly.runs(limit=5)
    assert [run.night.day for run in runs] == [15, 14, 13]
    assert runs[-1].failed == {"a": "x"}
    assert runs[0].failed == {}
    assert [run.night.day for run in archive.nightly.runs(limit=1, until=DATE)] == [13]
