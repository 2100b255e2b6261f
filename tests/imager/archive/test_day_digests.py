"""Digests of days: equal where an imager and a hub have the same rows, on either engine, and of one camera alone."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from datetime import date, timedelta
from pathlib import Path

import pytest
from pydantic import TypeAdapter
from sqlalchemy import Connection
from tests.fixtures.fleet import NOON, NOW, feed, new_imager, next_batch, sighting
from tests.hub.archive.test_feeds import live_a_little

from sunarc.common.findings import uncoded
from sunarc.hub.archive import HubArchive
from sunarc.imager.archive import day_digests as digests_module
from sunarc.imager.archive.database.schema import head_revision
from sunarc.imager.archive.day_digests import MOST_DAYS, DayDigest, DayDigests, StoredDays
from sunarc.imager.archive.values import Day, Event

DAY = NOON.date()
SINCE, UNTIL = date(2026, 5, 1), date(2026, 6, 2)


@pytest.fixture
def imager(tmp_path: Path) -> Iterator[HubArchive]:
    with new_imager(tmp_path) as archive:
        yield archive


def of_imager(imager: HubArchive) -> DayDigests:
    found = imager.outbox.digests("roof", since=SINCE, until=UNTIL)
    assert found is not None
    return found


def of_hub(hub: HubArchive, imager: HubArchive) -> DayDigests:
    found = hub.feeds.digests("roof", imager.outbox.position().installation, since=SINCE, until=UNTIL)
    assert found is not None
    return found


def test_they_are_equal_where_the_rows_are(imager: HubArchive, hub: HubArchive) -> None:
    live_a_little(imager)
    imager.sightings.add([sighting(50, x_px=-0.0, residual_chi2=1e-300, snr=float("inf"), findings=())])
    imager.sightings.add([sighting(51, findings=(uncoded("a sentence of a former version"),), file="ä\n.png")])
    for _ in range(2):  # equal ones are one at the hub
        imager.events.add(Event(time=NOON, kind="start", severity="info", text="again", details={"n": 1}))
    feed(imager, hub)
    own = of_imager(imager)
    assert own == of_hub(hub, imager)
    assert {kind for kind, days in own.days.items() if days} == digests_module._DAY_COLUMNS.keys() - {"housekeeping"}
    assert own.days["sun_point"][DAY].n == len(imager.sightings.find("roof"))  # type: ignore[union-attr]
    assert own.until == UNTIL


@pytest.mark.parametrize(
    "change",
    [{"x_px": 1.0000000000000002}, {"accepted": False}, {"findings": ()}, {"clock_error_s": 0.5}, {"sigma_px": None}],
)
def test_one_digit_of_one_row_is_another_hash(imager: HubArchive, hub: HubArchive, change: dict[str, object]) -> None:
    imager.sightings.add([sighting(0, x_px=1.0), sighting(1)])
    feed(imager, hub)
    batch = next_batch(imager)
    assert not batch.rows
    imager.outbox.disable()
    imager.sightings.replace([replace(sighting(0, x_px=1.0), **change)])  # type: ignore[arg-type]
    imager.outbox.enable()
    imager.outbox.acknowledge(imager.outbox.rows_to_send(imager.outbox.position(), most=99, most_bytes=10**9)[-1].seq)  # type: ignore[index]
    own = of_imager(imager).days["sun_point"][DAY]
    there = hub.feeds.digests("roof", batch.installation, since=SINCE, until=UNTIL)
    assert there is not None
    other = there.days["sun_point"][DAY]
    assert own is not None
    assert other is not None
    assert own.n == other.n == 2
    assert own.hash != other.hash


def test_while_rows_wait_an_imager_has_none(imager: HubArchive) -> None:
    assert imager.outbox.digests("roof", since=SINCE, until=UNTIL) is None


def test_they_are_of_one_camera_and_of_the_installation_that_is_taken(
    imager: HubArchive, hub: HubArchive, tmp_path: Path
) -> None:
    imager.sightings.add([sighting(0)])
    feed(imager, hub)
    with new_imager(tmp_path, "mast") as mast:
        mast.sightings.add(sighting(n, camera="mast") for n in range(5))
        feed(mast, hub, "mast")
        assert of_hub(hub, imager).days["sun_point"][DAY].n == 1  # type: ignore[union-attr]
        other = mast.outbox.position().installation
        assert hub.feeds.digests("roof", other, since=SINCE, until=UNTIL) is None
        assert hub.feeds.digests("none", other, since=SINCE, until=UNTIL) is None


def test_no_more_is_read_than_may_be_at_once(imager: HubArchive, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(digests_module, "MOST_ROWS", 10)
    for day, n_rows in enumerate([4, 6, 1, 11, 2]):
        imager.sightings.add(sighting(n, time=NOON + timedelta(days=day, seconds=n)) for n in range(n_rows))
    rows = imager.outbox.rows_to_send(imager.outbox.position(), most=99, most_bytes=10**9)
    assert rows
    imager.outbox.acknowledge(rows[-1].seq)
    found = imager.outbox.digests("roof", since=DAY, until=UNTIL)
    assert found is not None
    assert found.until == DAY + timedelta(days=2)
    rest = imager.outbox.digests("roof", since=found.until, until=UNTIL)
    assert rest is not None
    sightings = rest.days["sun_point"]
    assert sightings[DAY + timedelta(days=3)] is None  # too many for once
    assert sightings[DAY + timedelta(days=4)] is not None
    long = imager.outbox.digests("roof", since=date(2020, 1, 1), until=date.max)
    assert long is not None
    assert long.until == date(2020, 1, 1) + timedelta(days=MOST_DAYS)
    for since, until in ((date.max, date.max), (date.max, date.min), (date.min, date.max)):
        assert imager.outbox.digests("roof", since=since, until=until) is not None


def test_of_a_day_with_too_many_rows_the_largest_kinds_are_left_out(
    imager: HubArchive, monkeypatch: pytest.MonkeyPatch
) -> None:
    read = list[str]()
    digest = digests_module._compute_day_digest

    def counting(connection: Connection, kind: str, camera: str, day: date) -> DayDigest:
        read.append(kind)
        return digest(connection, kind, camera, day)

    monkeypatch.setattr(digests_module, "MOST_ROWS", 10)
    monkeypatch.setattr(digests_module, "_compute_day_digest", counting)
    imager.sightings.add(sighting(n) for n in range(8))
    for n in range(7):
        imager.events.add(Event(time=NOON, kind=f"start{n}", severity="info", text="begun"))
    rows = imager.outbox.rows_to_send(imager.outbox.position(), most=99, most_bytes=10**9)
    assert rows
    imager.outbox.acknowledge(rows[-1].seq)
    found = imager.outbox.digests("roof", since=DAY, until=UNTIL)
    assert found is not None
    assert found.days["sun_point"] == {DAY: None}
    assert found.days["event"][DAY] is not None
    assert found.until == UNTIL
    assert read == ["event"]


def test_days_are_queued_again_after_what_they_refer_to(imager: HubArchive, hub: HubArchive) -> None:
    live_a_little(imager)
    imager.sightings.add([sighting(9000)])  # three days later
    feed(imager, hub)
    before = of_hub(hub, imager)
    assert imager.outbox.queue_days("roof", [("sun_point", DAY), ("day", DAY), ("night", DAY)]) == 24
    kinds = [row.kind for row in imager.outbox.rows(most=99, most_bytes=10**9)]
    assert kinds == ["camera", "pose_epoch", "pose_epoch", *["sun_point"] * 20, "day"]
    feed(imager, hub, now=NOW)
    assert of_hub(hub, imager) == before == of_imager(imager)
    assert hub.feeds.quarantine() == ()


def test_a_day_without_time_is_of_its_date(imager: HubArchive, hub: HubArchive) -> None:
    day = Day(camera="roof", date=date(2026, 5, 20), verdict="clear", findings=(), n=1, n_possible=2, decided_at=NOON)
    imager.days.save(day)
    feed(imager, hub)
    assert set(of_hub(hub, imager).days["day"]) == {date(2026, 5, 20)}


def test_the_example_of_a_revision_is_the_head() -> None:
    examples = TypeAdapter(StoredDays).json_schema()["properties"]["revision"]["examples"]
    assert examples == [head_revision()]
