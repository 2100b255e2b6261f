"""The outbox: every change of a row, in the transaction of the change, with all its digits."""

from __future__ import annotations

import json
import sqlite3
from collections.abc import Iterator
from contextlib import closing
from dataclasses import replace
from datetime import date, timedelta
from pathlib import Path

import numpy as np
import pytest
from tests.fixtures.fleet import NOON, new_imager, sighting
from tests.imager.archive.test_calibrations import document

from sunarc.common.errors import InputError
from sunarc.common.findings import Finding, uncoded
from sunarc.hub.feed_schema import find_problem
from sunarc.imager.archive.archive import Archive, open_archive
from sunarc.imager.archive.database.tables import metadata
from sunarc.imager.archive.feed_rows import FED, STATUS, FeedRow, feed_lines, read_feed_lines, sent_columns
from sunarc.imager.archive.outbox import outbox_triggers
from sunarc.imager.archive.values import Day, DayAir, Event, Housekeeping, Refit
from sunarc.sources.image_key import ImageKey

DAY = Day(
    camera="roof",
    date=date(2026, 5, 13),
    verdict="clear",
    findings=(Finding("day", {"n": 1}),),
    n=1,
    n_possible=2,
    decided_at=NOON,
)


@pytest.fixture
def imager(tmp_path: Path) -> Iterator[Archive]:
    with new_imager(tmp_path) as archive:
        yield archive


def waiting(archive: Archive) -> list[FeedRow]:
    return list(archive.outbox.rows(most=10**6, most_bytes=10**9))


def kinds(archive: Archive) -> list[str]:
    return [row.kind for row in waiting(archive)]


def forget(archive: Archive) -> None:
    archive.outbox.acknowledge(send(archive)[-1].seq)


def send(archive: Archive) -> tuple[FeedRow, ...]:
    return archive.outbox.rows_to_send(archive.outbox.position(), most=10**6, most_bytes=10**9) or ()


def test_every_kind_of_row_is_queued_with_all_its_columns_in_the_order_of_the_changes(imager: Archive) -> None:
    imager.sightings.add([sighting(0), sighting(1)])
    imager.days.save(DAY)
    imager.days.set_air(DayAir(camera="roof", date=DAY.date, temperature_c=3.5, pressure_hpa=None, set_at=NOON))
    imager.calibrations.add(document("a"))
    imager.refits.request(Refit(id="r", camera="roof", requested_at=NOON, reason="asked"))
    imager.events.add(Event(time=NOON, kind="start", severity="info", text="begun", details={"a": 1.5}))
    imager.housekeeping.add(
        "roof", [Housekeeping(time=NOON, disk_free_bytes=2**40, temperature_c=0.1, n_temperatures=1)]
    )
    rows = waiting(imager)
    expected = ["camera", "pose_epoch", "sun_point", "sun_point", "day", "day_air", "calibration", "refit", "event"]
    assert [row.kind for row in rows] == [*expected, "housekeeping", "housekeeping"]  # an hour and a day
    assert [row.seq for row in rows] == list(range(1, 12))
    for row in rows:
        assert row.data is not None
        assert set(row.data) == set(sent_columns(row.kind))
        assert find_problem(row.kind, row.data) is None


def test_every_table_is_sent_or_left_out_for_a_reason() -> None:
    of_the_feed = {"outbox", "outbox_position", "feed_token", "feed", "quarantine", "fleet"}
    of_its_own_receivers = {"notice", "notice_position", "notice_sink"}
    made_on_the_hub = {"day_summary", "nightly_run"}
    names_rows_by_the_imagers_own_ids = {"used_sightings"}
    of_the_service_alone = {
        "condition",
        "seen_file",
        "night_image",
    }  # the last until the night's verdict, which is sent
    left_out = (
        of_the_service_alone | of_the_feed | of_its_own_receivers | made_on_the_hub | names_rows_by_the_imagers_own_ids
    )
    assert set(FED) == set(metadata.tables) - left_out
    assert len(dict(outbox_triggers())) == 3 * len(FED)


def test_numbers_keep_all_their_digits(imager: Archive) -> None:
    forget(imager)
    numbers = np.random.default_rng(0).normal(0.0, 1.0, 200) * 10.0 ** np.random.default_rng(1).integers(-200, 200, 200)
    imager.sightings.add(sighting(n, x_px=float(x)) for n, x in enumerate(numbers))
    found = read_feed_lines(feed_lines(waiting(imager)), after=2)
    assert [row.data["x_px"] for row in found if row.data is not None] == numbers.tolist()


def test_what_is_no_number_is_sent_as_none(imager: Archive) -> None:
    forget(imager)
    imager.sightings.add([sighting(0, residual_chi2=float("inf"), snr=float("nan"))])
    (row,) = waiting(imager)
    assert row.data is not None
    assert (row.data["residual_chi2"], row.data["snr"]) == (None, None)


def test_a_change_that_is_taken_back_queues_nothing(imager: Archive) -> None:
    before = kinds(imager)
    with pytest.raises(InputError):
        imager.sightings.add([sighting(0), sighting(1, camera="mast")])
    assert kinds(imager) == before


def test_the_same_values_again_queue_nothing(imager: Archive) -> None:
    imager.sightings.add([sighting(0)])
    forget(imager)
    imager.sightings.add([sighting(0)])
    imager.cameras.save(imager.cameras.all()[0])
    assert kinds(imager) == []


def test_changes_of_many_rows_queue_each(imager: Archive) -> None:
    imager.sightings.add(sighting(n) for n in range(5))
    forget(imager)
    assert imager.sightings.exclude("roof", uncoded("test"), since=NOON + timedelta(seconds=60)) == 3
    assert kinds(imager) == ["sun_point"] * 3
    forget(imager)
    imager.epochs.open("roof", at=NOON + timedelta(seconds=90), reason="bumped")
    assert kinds(imager) == ["pose_epoch", "pose_epoch", "sun_point", "sun_point"]


def test_a_row_that_moves_to_another_key_or_goes_is_said_to_be_removed(imager: Archive) -> None:
    air = DayAir(camera="roof", date=DAY.date, temperature_c=3.5, pressure_hpa=None, set_at=NOON)
    imager.days.set_air(air)
    imager.sightings.replace([sighting(0)])
    forget(imager)
    imager.days.set_air(replace(air, temperature_c=None))
    key = ImageKey(int(NOON.timestamp() * 1e6), 47.3, "")
    imager.sightings.rename_files("roof", {key: key._replace(file="a.png")})
    removed_air, removed, moved = waiting(imager)
    assert (removed_air.kind, removed_air.data) == ("day_air.removed", {"camera": "roof", "date": "2026-05-13"})
    assert removed.kind == "sun_point.removed"
    assert removed.data is not None
    assert moved.data is not None
    assert (removed.data["file"], moved.data["file"]) == ("", "a.png")


def test_a_damaged_row_does_not_keep_a_change_from_being_made(imager: Archive, tmp_path: Path) -> None:
    imager.sightings.add([sighting(0)])
    with closing(sqlite3.connect(tmp_path / "roof.sqlite")) as hand, hand:
        hand.execute("UPDATE sun_point SET reason = x'ff00fe', snr = x'ff', saturated_px = 'many'")
    assert imager.sightings.exclude("roof", uncoded("test"), since=NOON) == 1
    assert waiting(imager)[-1].kind == "sun_point"


def test_rows_come_in_parts_of_a_size(imager: Archive) -> None:
    imager.sightings.add(sighting(n) for n in range(10))
    assert len(imager.outbox.rows(most=4, most_bytes=10**9)) == 4
    one = len(imager.outbox.rows(most=1, most_bytes=0))
    assert one == 1
    assert 1 < len(imager.outbox.rows(most=100, most_bytes=2000)) < 12


def test_what_the_hub_has_is_forgotten_and_numbers_are_not_given_again(imager: Archive, tmp_path: Path) -> None:
    forget(imager)
    assert imager.outbox.waiting() == 0
    assert (imager.outbox.position().committed, imager.outbox.position().sent) == (2, 2)
    imager.sightings.add([sighting(0)])
    assert [row.seq for row in waiting(imager)] == [3]
    with open_archive(tmp_path / "roof.sqlite") as again:
        assert not again.outbox.enable()  # it went on: nothing is queued again
        assert [row.seq for row in waiting(again)] == [3]


def test_a_trigger_that_is_missing_has_all_rows_queued_again(imager: Archive, tmp_path: Path) -> None:
    imager.sightings.add([sighting(0)])
    forget(imager)
    former = imager.outbox.position().installation
    with closing(sqlite3.connect(tmp_path / "roof.sqlite")) as hand, hand:
        hand.execute("DROP TRIGGER outbox_sun_point_insert")
    imager.sightings.add([sighting(1)])
    assert kinds(imager) == []
    assert imager.outbox.enable()
    assert kinds(imager) == ["camera", "pose_epoch", "sun_point", "sun_point"]
    assert waiting(imager)[0].seq > 3
    assert imager.outbox.position().installation != former


def test_of_a_kind_that_a_former_version_did_not_send_the_rows_alone_are_queued(
    imager: Archive, tmp_path: Path
) -> None:
    imager.sightings.add([sighting(0)])
    forget(imager)
    former = imager.outbox.position()
    with closing(sqlite3.connect(tmp_path / "roof.sqlite")) as hand, hand:
        for change in ("insert", "update", "delete"):
            hand.execute(f"DROP TRIGGER outbox_housekeeping_{change}")
    imager.housekeeping.add("roof", [Housekeeping(time=NOON, disk_free_bytes=1)])
    assert kinds(imager) == []
    assert not imager.outbox.enable()
    assert kinds(imager) == ["housekeeping", "housekeeping"]
    assert imager.outbox.position() == former
    imager.housekeeping.add("roof", [Housekeeping(time=NOON, disk_free_bytes=0)])
    assert kinds(imager) == ["housekeeping"] * 4
    assert not imager.outbox.enable()
    assert kinds(imager) == ["housekeeping"] * 4


def test_without_a_hub_nothing_is_queued(imager: Archive) -> None:
    imager.outbox.disable()
    imager.sightings.add([sighting(0)])
    assert kinds(imager) == []
    assert imager.outbox.enable()
    assert kinds(imager) == ["camera", "pose_epoch", "sun_point"]


def test_of_what_the_imager_tells_of_itself_only_the_newest_waits(imager: Archive) -> None:
    for n in range(3):
        imager.outbox.queue_status({"n": n})
    assert [row.data for row in waiting(imager) if row.kind == STATUS] == [{"n": 2}]
    send(imager)  # under way: it may be at the hub
    imager.outbox.queue_status({"n": 3})
    assert [row.data for row in waiting(imager) if row.kind == STATUS] == [{"n": 2}, {"n": 3}]


@pytest.mark.parametrize(
    "line",
    [
        "",
        "no json",
        "[]",
        "{}",
        '{"seq": 0, "kind": "day", "data": {}}',
        '{"seq": true, "kind": "day", "data": {}}',
        '{"seq": 5.5, "kind": "day", "data": {}}',
        '{"seq": 5, "kind": 7, "data": {}}',
        '{"seq": 5, "kind": "day", "data": []}',
        '{"seq": 4, "kind": "day", "data": {}}',
        '{"seq": 99999999999999999999, "kind": "day", "data": {}}',
        "[" * 100_000,
    ],
)
def test_a_line_that_is_no_row_is_named(line: str) -> None:
    good = json.dumps({"seq": 4, "kind": "day", "data": {}})
    with pytest.raises(InputError) as error:
        read_feed_lines(f"{good}\n{line}\n".encode(), after=3)
    assert error.value.field.split(", ") == ["body", "line 2"]


def test_numbers_follow_what_was_there_before() -> None:
    body = feed_lines([FeedRow(seq=4, kind="day", data={})])
    assert len(read_feed_lines(body, after=3)) == 1
    with pytest.raises(InputError):
        read_feed_lines(body, after=4)
