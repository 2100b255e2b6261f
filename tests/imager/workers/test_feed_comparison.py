"""The nightly comparison of an imager with its hub: rows that never came are sent again, and what cannot be is said."""

from __future__ import annotations

import json
from datetime import date, datetime, timedelta
from pathlib import Path

import pytest
from sqlalchemy import delete, update
from tests.fixtures.fleet import NOON, NOW, sighting
from tests.imager.workers.test_feed import Bench, answering, bench, put_back, send_all, step

from sunarc.common.errors import OutsideError
from sunarc.hub.archive import HubArchive, open_hub_archive
from sunarc.imager.archive.database.schema import head_revision
from sunarc.imager.archive.database.tables import sun_point
from sunarc.imager.archive.day_digests import DayDigest, StoredDays
from sunarc.imager.archive.feed_rows import FeedBatch, Refusal
from sunarc.imager.archive.values import Event
from sunarc.imager.runtime.clock import SystemClock
from sunarc.imager.workers.feed import FeedWorker
from sunarc.imager.workers.hub_connection import HubAnswerError, HubConnection, HubRefusal
from sunarc.imager.workers.options import HubOptions

__all__ = ["bench"]

NIGHT_S = 86_400.0


@pytest.fixture
def asked(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> list[tuple[date, date]]:
    """Return the windows that the hub is asked for."""
    found, ask = [], bench.wire.ask

    def noting(installation: str, since: date, until: date, heartbeat: object) -> StoredDays:
        found.append((since, until))
        return ask(installation, since, until, heartbeat)  # type: ignore[arg-type]

    monkeypatch.setattr(bench.wire, "ask", noting)
    return found


def lose(hub: HubArchive, *, first: int, n_rows: int) -> None:
    """Delete sightings as if they had never come."""
    times = [NOON + timedelta(seconds=30.0 * n) for n in range(first, first + n_rows)]
    with hub.database.writing() as connection:
        assert connection.execute(delete(sun_point).where(sun_point.c.time.in_(times))).rowcount == n_rows


def night(bench: Bench, worker: FeedWorker) -> None:
    bench.clock.advance(NIGHT_S)
    for _ in range(8):
        step(worker)


def events(bench: Bench) -> list[str]:
    return [event.kind for event in bench.imager.events.find("roof")]


def same(bench: Bench) -> bool:
    return bench.hub.sightings.find("roof") == bench.imager.sightings.find("roof")


def test_rows_that_never_came_come_the_next_night_and_it_is_said(bench: Bench, asked: list[tuple[date, date]]) -> None:
    bench.imager.sightings.add(sighting(n) for n in range(3750))
    worker = bench.worker()
    send_all(worker)
    step(worker)
    step(worker)
    assert asked[-1] == (date(2026, 5, 1), date(2026, 6, 2))
    asked.clear()
    lose(bench.hub, first=100, n_rows=350)
    bench.clock.advance(3600.0)
    step(worker)
    assert len(asked) == 0  # not yet
    night(bench, worker)
    assert same(bench)
    assert len(asked) == 3  # once more, when they were sent
    assert events(bench) == ["hub_rows_sent_again"]
    assert bench.codes() == set()
    night(bench, worker)
    assert len(asked) == 5  # and nothing goes twice
    assert bench.hub.feeds.quarantine() == ()


def test_rows_that_could_not_be_queued_are_compared_again(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    bench.imager.sightings.add(sighting(n) for n in range(10))
    worker = bench.worker()
    send_all(worker)
    for _ in range(8):
        step(worker)
    lose(bench.hub, first=1, n_rows=2)

    def fail(*_: object) -> int:
        raise OutsideError("the disk is full")

    with monkeypatch.context() as full:
        full.setattr(type(bench.imager.outbox), "queue_days", fail)
        night(bench, worker)
    assert events(bench) == []
    bench.clock.advance(601.0)
    for _ in range(8):
        step(worker)
    assert bench.codes() == set()
    assert same(bench)
    assert events(bench) == ["hub_rows_sent_again"]


def test_a_value_that_the_hub_has_otherwise_is_written_again(bench: Bench) -> None:
    bench.imager.sightings.add(sighting(n) for n in range(5))
    worker = bench.worker()
    send_all(worker)
    with bench.hub.database.writing() as connection:
        connection.execute(update(sun_point).values(x_px=7.0))
    night(bench, worker)
    assert same(bench)


def test_rows_that_the_hub_has_besides_stay_there_and_are_said_once(bench: Bench) -> None:
    bench.imager.sightings.add(sighting(n) for n in range(30))
    worker = bench.worker()
    send_all(worker)
    with bench.imager.database.writing() as connection:
        connection.exec_driver_sql("DROP TRIGGER outbox_sun_point_delete")
        gone = sun_point.c.time < NOON + timedelta(seconds=30.0 * 22)
        assert connection.execute(delete(sun_point).where(gone)).rowcount == 22
    worker._status_s = bench.clock.monotonic() + 10 * NIGHT_S  # what puts the trigger back sends all
    for _ in range(3):
        night(bench, worker)
    assert len(bench.hub.sightings.find("roof")) == 30
    assert events(bench).count("hub_has_other_rows") == 1
    assert events(bench).count("hub_rows_sent_again") == 1
    (said,) = (event for event in bench.imager.events.find("roof") if event.kind == "hub_has_other_rows")
    assert said.details["n_rows"] == 22
    assert bench.codes() == set()


def test_a_restore_while_the_hub_is_away_ends_with_both_parts_at_the_hub(bench: Bench, tmp_path: Path) -> None:
    send_all(bench.worker())
    bench.imager.close()
    copy = (tmp_path / "roof.sqlite").read_bytes()
    with open_hub_archive(tmp_path / "roof.sqlite") as before:
        bench.imager = before
        before.sightings.add(sighting(n) for n in range(22))
        send_all(bench.worker())
    put_back(tmp_path, copy)
    with open_hub_archive(tmp_path / "roof.sqlite") as again:
        bench.imager = again
        worker, bench.wire.faults = bench.worker(), ["cut"] * 30
        for n in range(100, 140):
            again.sightings.add([sighting(n)])
            step(worker)
        bench.hub.feeds.accept_installation("roof", again.outbox.position().installation, now=NOW)
        bench.clock.advance(100.0)
        for _ in range(8):
            step(worker)
        assert {point.time for point in again.sightings.find("roof")} <= {
            point.time for point in bench.hub.sightings.find("roof")
        }
        assert "hub_has_other_rows" in events(bench)


def test_rows_that_the_hub_refuses_again_are_a_condition_until_it_takes_them(
    bench: Bench,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    bench.imager.sightings.add(sighting(n) for n in range(10))
    take, refused = bench.hub.feeds.take, [sighting(n).time for n in (3, 4)]

    def without(batch: FeedBatch, *, now: datetime) -> int | Refusal:
        committed = take(batch, now=now)
        with bench.hub.database.writing() as connection:
            connection.execute(delete(sun_point).where(sun_point.c.time.in_(refused)))
        return committed

    monkeypatch.setattr(bench.hub.feeds, "take", without)
    worker = bench.worker()
    send_all(worker)
    for _ in range(8):
        step(worker)
    assert bench.codes() == {"hub_lacks_rows"}
    night(bench, worker)
    assert bench.codes() == {"hub_lacks_rows"}
    refused.clear()
    night(bench, worker)
    assert same(bench)
    assert bench.codes() == set()


def test_years_are_compared_by_turns(bench: Bench, asked: list[tuple[date, date]]) -> None:
    bench.imager.sightings.add(sighting(0, time=NOON - timedelta(days=day)) for day in range(0, 200, 5))
    worker = bench.worker()
    send_all(worker)
    for _ in range(8):
        night(bench, worker)
    older = {window for window in asked if window[1] <= date(2026, 5, 12)}
    assert all(until - since == timedelta(days=32) for since, until in older)
    covered = {since + timedelta(days=n) for since, until in asked for n in range((until - since).days)}
    assert {(NOON - timedelta(days=day)).date() for day in range(0, 200, 5)} <= covered


def test_sightings_that_the_hub_keeps_no_more_are_not_sent(bench: Bench) -> None:
    bench.imager.sightings.add([sighting(0, time=NOON - timedelta(days=100)), sighting(1)])
    worker = bench.worker()
    send_all(worker)
    with bench.hub.database.writing() as connection:
        connection.execute(delete(sun_point).where(sun_point.c.time < NOON - timedelta(days=90)))
    for _ in range(6):
        night(bench, worker)
    assert len(bench.hub.sightings.find("roof")) == 1
    assert events(bench) == []


@pytest.mark.parametrize("status", [404, 405])
def test_with_an_older_hub_the_comparison_is_skipped_and_said_once(
    bench: Bench,
    monkeypatch: pytest.MonkeyPatch,
    status: int,
) -> None:
    def refuse(*_: object) -> StoredDays:
        raise HubRefusal(status, "Method Not Allowed")

    monkeypatch.setattr(bench.wire, "ask", refuse)
    bench.imager.sightings.add([sighting(0)])
    worker = bench.worker()
    send_all(worker)
    for _ in range(3):
        night(bench, worker)
    assert events(bench) == ["hub_not_compared"]
    assert same(bench)
    assert bench.codes() == set()


def test_with_a_hub_of_another_revision_nothing_is_compared(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    def other(_installation: str, since: date, _until: date, _heartbeat: object) -> StoredDays:
        return StoredDays(revision="9999", until=since, days={})

    monkeypatch.setattr(bench.wire, "ask", other)
    worker = bench.worker()
    send_all(worker)
    night(bench, worker)
    assert events(bench) == ["hub_not_compared"]


@pytest.mark.parametrize(
    "error", [OutsideError("gone"), HubRefusal(429, "busy"), HubRefusal(401, "no"), HubAnswerError("<p>")]
)
def test_a_comparison_that_fails_is_tried_again_and_holds_up_no_row(
    bench: Bench,
    monkeypatch: pytest.MonkeyPatch,
    error: Exception,
) -> None:
    ask, asked = bench.wire.ask, list[int]()

    def fail(*_: object) -> StoredDays:
        asked.append(1)
        raise error

    monkeypatch.setattr(bench.wire, "ask", fail)
    worker = bench.worker()
    for n in range(5):
        bench.imager.sightings.add([sighting(n)])
        send_all(worker)
    assert len(asked) == 1
    assert same(bench)
    assert bench.codes() == set()
    lose(bench.hub, first=1, n_rows=2)
    worker._comparison.ask = ask
    bench.clock.advance(601.0)
    for _ in range(4):
        step(worker)
    assert same(bench)


def test_an_answer_about_other_days_ends(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    def wrong(_installation: str, since: date, _until: date, _heartbeat: object) -> StoredDays:
        return StoredDays(revision=head_revision(), until=since, days={})

    monkeypatch.setattr(bench.wire, "ask", wrong)
    worker = bench.worker()
    send_all(worker)
    assert bench.imager.outbox.waiting() == 0


def test_an_event_without_a_camera_is_the_cameras(bench: Bench) -> None:
    bench.imager.events.add(Event(time=NOON, kind="start", severity="info", text="begun"))
    worker = bench.worker()
    send_all(worker)
    night(bench, worker)
    assert events(bench) == ["start"]


def said(content: str) -> str:
    return f"200 OK\r\ncontent-length: {len(content)}\r\n\r\n{content}"


def test_what_a_hub_says_arrives_over_http(tmp_path: Path) -> None:
    days = {"sun_point": {"2026-05-13": [3, "00ff"], "2026-05-14": None}, "day": {}}
    content = json.dumps({"revision": "0019", "until": "2026-05-15", "days": days})
    with answering(said(content)) as url:
        found = stored_days(url, tmp_path)
    assert (found.revision, found.until) == ("0019", date(2026, 5, 15))
    assert found.days["sun_point"] == {date(2026, 5, 13): DayDigest(3, "00ff"), date(2026, 5, 14): None}


@pytest.mark.parametrize(
    "content",
    [
        "<p>hi</p>",
        "[]",
        "{}",
        '{"committed": 5}',
        '{"revision": "0019", "until": "2026-05-15", "days": {"sun_point": {"2026-05-13": [3]}}}',
        '{"revision": "0019", "until": "2026-05-15", "days": {"sun_point": {"soon": [3, "00"]}}}',
        '{"revision": 19, "until": 5e99, "days": []}',
        "[" * 60_000,
    ],
)
def test_an_answer_that_says_nothing_of_days_is_an_error(tmp_path: Path, content: str) -> None:
    with answering(said(content)) as url, pytest.raises(HubAnswerError):
        stored_days(url, tmp_path)


def stored_days(url: str, folder: Path) -> StoredDays:
    (folder / "token").write_text("a token\n")
    hub = HubConnection(HubOptions(url=url, token_file=folder / "token"), camera="roof", clock=SystemClock())
    return hub.stored_days("here", date(2026, 5, 1), date(2026, 6, 2), lambda: None)
