"""What a hub makes of what imagers send: every row once, and what is refused set apart with its reason."""

from __future__ import annotations

import json
import threading
from collections.abc import Iterator
from dataclasses import replace
from datetime import UTC, date, datetime, timedelta
from pathlib import Path
from typing import Any

import pytest
from tests.fixtures.fleet import NOON, NOW, batch_of, feed, new_imager, next_batch, sighting
from tests.fixtures.nights import judged, whole_night
from tests.imager.archive.test_calibrations import document

from sunarc.common.errors import NotFoundError
from sunarc.common.findings import Finding, uncoded
from sunarc.hub.archive import HubArchive
from sunarc.hub.feed_schema import FUTURE
from sunarc.hub.feeds import KEPT
from sunarc.imager.archive.feed_rows import FED, FeedBatch, FeedRow, Refusal, read_feed_lines
from sunarc.imager.archive.values import Day, DayAir, Event, Refit, SunPoint, field_values
from sunarc.sources.image_key import ImageKey


@pytest.fixture
def imager(tmp_path: Path) -> Iterator[HubArchive]:
    with new_imager(tmp_path) as archive:
        yield archive


def contents(archive: HubArchive, camera: str = "roof") -> dict[str, Any]:
    """Return all that is sent of a camera."""
    return {
        "camera": archive.cameras.get(camera),
        "epochs": archive.epochs.find(camera, include_closed=True),
        "sightings": archive.sightings.find(camera),
        "days": archive.days.find(camera),
        "air": archive.days.air(camera),
        "calibrations": archive.calibrations.find(camera),
        "refits": archive.refits.find(camera),
        "nights": archive.nights.find(camera),
        "events": [replace(event, id=None) for event in archive.events.find(camera)],
    }


def reasons(hub: HubArchive) -> list[str]:
    return [found.reason for found in hub.feeds.quarantine()]


def live_a_little(imager: HubArchive) -> None:
    """Write and change rows of every kind."""
    imager.sightings.add(sighting(n) for n in range(20))
    imager.days.save(
        Day(
            camera="roof",
            date=date(2026, 5, 13),
            verdict="clear",
            findings=(Finding("day_share_on_arc", {"share": 0.9}),),
            n=20,
            n_possible=21,
            decided_at=NOON,
            pose_offset_deg=(0.1, 0.2, 1 / 3),
        )
    )
    imager.days.set_air(
        DayAir(camera="roof", date=date(2026, 5, 13), temperature_c=3.5, pressure_hpa=None, set_at=NOON)
    )
    imager.nights.save(whole_night(NOON))
    imager.nights.save(judged("2026-05-11", at=NOON, n_images=3, findings=(Finding("night_given_up", {"n": 3}),)))
    imager.calibrations.add(document("a"))
    imager.calibrations.activate("a")
    imager.calibrations.add(document("b", day=1), parent="a")
    imager.calibrations.activate("b")
    imager.calibrations.reinstate("a", at=NOON, reason="better")
    imager.refits.request(Refit(id="r", camera="roof", requested_at=NOON, reason="asked"))
    imager.refits.finish("r", state="accepted", finished_at=NOON, calibration="b", findings=(Finding("x", {"n": 1}),))
    imager.events.add(Event(time=NOON, kind="start", severity="info", text="begun", camera="roof", details={"a": 1.5}))
    imager.epochs.open("roof", at=NOON + timedelta(seconds=300), reason="bumped")
    imager.sightings.exclude("roof", uncoded("test"), since=NOON + timedelta(seconds=400))
    imager.sightings.widen_clock_errors("roof", since=NOON, until=NOW, error_s=1 / 3)


@pytest.mark.parametrize("most", [1, 7, 1000])
def test_the_hub_has_what_the_imager_has(imager: HubArchive, hub: HubArchive, most: int) -> None:
    live_a_little(imager)
    feed(imager, hub, most=most)
    assert contents(hub) == contents(imager)
    assert hub.feeds.quarantine() == ()
    assert hub.calibrations.current("roof") == imager.calibrations.current("roof")
    assert hub.sightings.dates("roof", longitude=-97.5) == (date(2026, 5, 13),)


def test_rows_that_are_all_sent_again_change_nothing(imager: HubArchive, hub: HubArchive) -> None:
    live_a_little(imager)
    feed(imager, hub)
    imager.outbox.send_again(committed=imager.outbox.position().committed)
    imager.calibrations.reinstate("b", at=NOON + timedelta(hours=1), reason="no, this one")
    feed(imager, hub)
    assert contents(hub) == contents(imager)
    assert hub.feeds.quarantine() == ()


def test_a_night_that_only_its_event_tells_of_is_a_night_at_the_hub(imager: HubArchive, hub: HubArchive) -> None:
    """An imager of a former revision has no rows of nights."""
    details = {"date": "2026-05-12", "verdict": "clear", "n_images": 48, "halo": 0.01, "findings": []}
    told = Event(time=NOON, kind="night", severity="info", text="clear", camera="roof", details=details)
    imager.events.add(told)
    imager.events.add(replace(told, text="none", details={}))
    feed(imager, hub)
    assert hub.nights.find("roof") == (judged("2026-05-12", at=NOON, verdict="clear", n_images=48, halo=0.01),)
    imager.nights.save(judged("2026-05-12", at=NOON, verdict="partly"))
    feed(imager, hub)
    assert [night.verdict for night in hub.nights.find("roof")] == ["partly"]
    assert hub.feeds.quarantine() == ()


@pytest.mark.parametrize(
    "change",
    [{"n_images": None}, {"zenith_bands": [{"from_deg": 1.0}]}, {"images": {"time": []}}, {"n_accepted": "many"}],
)
def test_a_night_that_lacks_a_value_is_set_apart(imager: HubArchive, hub: HubArchive, change: dict[str, Any]) -> None:
    imager.nights.save(whole_night(NOON))
    batch = next_batch(imager)
    rows = tuple(
        replace(row, data={**(row.data or {}), **change}) if row.kind == "night" else row for row in batch.rows
    )
    hub.feeds.take(replace(batch, rows=rows), now=NOW)
    assert reasons(hub) == ["malformed"]
    assert hub.nights.find("roof") == ()


def test_a_removed_row_is_removed(imager: HubArchive, hub: HubArchive) -> None:
    live_a_little(imager)
    feed(imager, hub)
    imager.days.set_air(
        DayAir(camera="roof", date=date(2026, 5, 13), temperature_c=None, pressure_hpa=None, set_at=NOON)
    )
    key = ImageKey(int(NOON.timestamp() * 1e6), 47.3, "")
    imager.sightings.rename_files("roof", {key: key._replace(file="a.png")})
    feed(imager, hub)
    assert contents(hub) == contents(imager)
    assert hub.days.air("roof") == ()


def test_a_batch_that_comes_twice_is_stored_once(imager: HubArchive, hub: HubArchive) -> None:
    imager.events.add(Event(time=NOON, kind="start", severity="info", text="begun", camera="roof"))
    batch = next_batch(imager)
    assert [hub.feeds.take(batch, now=NOW) for _ in range(3)] == [3, 3, 3]
    assert len(hub.events.find("roof")) == 1


def test_a_late_repetition_of_an_earlier_batch_changes_nothing(imager: HubArchive, hub: HubArchive) -> None:
    imager.sightings.add([sighting(0)])
    early = next_batch(imager)
    feed(imager, hub)
    imager.sightings.exclude("roof", uncoded("test"), since=NOON)
    feed(imager, hub)
    assert hub.feeds.take(early, now=NOW) == imager.outbox.position().committed
    assert not hub.sightings.find("roof")[0].accepted


def test_a_gap_is_seen_and_what_is_missing_is_sent_again(imager: HubArchive, hub: HubArchive) -> None:
    feed(imager, hub)
    hub.feeds.ask_again("roof")  # as a hub that was put back to an earlier copy
    imager.sightings.add([sighting(0)])
    batch = next_batch(imager)
    assert hub.feeds.take(batch, now=NOW) == -1
    assert reasons(hub) == ["gap"]
    imager.outbox.send_again(committed=-1)
    feed(imager, hub)
    assert contents(hub) == contents(imager)


def test_a_second_installation_is_set_apart_until_it_is_accepted(
    imager: HubArchive, hub: HubArchive, tmp_path: Path
) -> None:
    feed(imager, hub)
    (tmp_path / "other").mkdir()
    with new_imager(tmp_path / "other") as other:
        other.sightings.add([sighting(5)])
        for _ in range(2):
            refused = hub.feeds.take(next_batch(other), now=NOW)
            assert isinstance(refused, Refusal)
        (found,) = hub.feeds.quarantine("roof")
        assert (found.reason, found.n, found.installation) == (
            "second_installation",
            2,
            other.outbox.position().installation,
        )
        assert hub.sightings.find("roof") == ()
        imager.sightings.add([sighting(1)])
        feed(imager, hub)  # nothing else stops
        hub.feeds.accept_installation("roof", other.outbox.position().installation, now=NOW)
        feed(other, hub)
        assert len(hub.sightings.find("roof")) == 2
        imager.sightings.add([sighting(2)])
        assert isinstance(hub.feeds.take(next_batch(imager), now=NOW), Refusal)
    with pytest.raises(NotFoundError):
        hub.feeds.ask_again("attic")


def row_of(number: int = 0, **changes: Any) -> dict[str, Any]:  # noqa: ANN401 - of many types
    row = field_values(sighting(number))
    row["reason"] = json.dumps([one.as_json() for one in row.pop("findings")])
    return row | {"time": int(row["time"].timestamp() * 1e6)} | changes


AHEAD = int((NOW + FUTURE).timestamp() * 1e6)
EVENT = {"camera": "roof", "time": AHEAD, "kind": "k", "severity": "info", "text": "t", "details": {}}


@pytest.mark.parametrize(
    ("kind", "data", "reason"),
    [
        ("sun_point", row_of(time=AHEAD), None),
        ("sun_point", row_of(time=AHEAD + 1), "future_clock"),
        ("sun_point", row_of(time=int(datetime(2099, 1, 1, tzinfo=UTC).timestamp() * 1e6)), "future_clock"),
        ("sun_point", row_of(time=2**62), "malformed"),
        ("sun_point", row_of(time=-1), "malformed"),
        ("sun_point", row_of(time="noon"), "malformed"),
        ("sun_point", row_of(time=None), "malformed"),
        ("sun_point", row_of(accepted=1), "malformed"),
        ("sun_point", row_of(x_px="1"), "malformed"),
        ("sun_point", row_of(x_px=True), "malformed"),
        ("sun_point", row_of(reason="\0"), "malformed"),
        ("sun_point", row_of(reason="half a pair \ud83d"), "malformed"),
        ("sun_point", row_of(reason="ein Wölkchen ☁"), None),
        ("sun_point", row_of(reason='[{"code": 5, "data": []}, 7]'), None),
        ("sun_point", row_of(reason='[{"code":' + 9999 * "["), None),
        ("sun_point", {name: value for name, value in row_of().items() if name != "snr"}, None),
        ("sun_point", dict(reversed(row_of().items())), None),
        ("sun_point", row_of(x_px=10**400), "malformed"),
        ("sun_point", row_of(a_new_column=1), "malformed"),
        ("sun_point", row_of(camera="mast"), "other_camera"),
        ("sun_point", row_of(pose_epoch="roof-9"), "contradiction"),
        ("sun_point", None, "body_too_large"),
        ("sun_point.removed", {"camera": "mast"}, "malformed"),
        ("moon_point", {}, "malformed"),
        ("event", EVENT, None),
        ("event", EVENT | {"camera": None}, None),
        ("event", EVENT | {"time": AHEAD + 1}, "future_clock"),
        ("day_air", {"camera": "roof", "date": "2026-02-30", "set_at": 0}, "malformed"),
        ("status", {"anything": [1]}, None),
        ("status.removed", {}, "malformed"),
        ("moon\0\ud800", {}, "malformed"),
        ("day_air.removed", {"camera": "roof", "date": "2026-02-30"}, "malformed"),
        ("housekeeping.removed", {"camera": "roof", "step": "hour", "time": 2**62}, "malformed"),
        ("sun_point.removed", {name: row_of()[name] for name in FED["sun_point"][1] if name != "file"}, "malformed"),
        ("event.removed", {"camera": None, "time": AHEAD, "kind": "k", "text": "t"}, None),
        ("calibration.removed", {"id": "none"}, None),
        ("pose_epoch.removed", {"id": "roof-1"}, "contradiction"),
        ("camera.removed", {"name": "roof"}, "contradiction"),
    ],
)
def test_a_row_that_cannot_be_stored_is_set_apart_and_the_others_are_stored(
    imager: HubArchive, hub: HubArchive, kind: str, data: dict[str, Any] | None, reason: str | None
) -> None:
    feed(imager, hub)
    after = imager.outbox.position().committed
    installation = imager.outbox.position().installation
    made = batch_of(("sun_point", row_of(7)), (kind, data), ("sun_point", row_of(8)), after=after)
    assert hub.feeds.take(replace(made, installation=installation), now=NOW) == after + 3
    assert reasons(hub) == ([] if reason is None else [reason])
    assert len(hub.sightings.find("roof")) == 2 + (reason is None and kind == "sun_point")
    for found in hub.feeds.quarantine():
        assert (found.seq, found.camera) == (after + 2, "roof")
        assert found.kind == kind.replace("\0", "?").replace("\ud800", "?")


def test_of_rows_of_one_key_in_one_batch_the_last_is_stored(imager: HubArchive, hub: HubArchive) -> None:
    feed(imager, hub)
    position = imager.outbox.position()
    rows = [("sun_point", row_of(number, x_px=float(x))) for number, x in ((1, 5), (2, 6), (1, 7))]
    made = batch_of(*rows, after=position.committed)
    hub.feeds.take(replace(made, installation=position.installation), now=NOW)
    assert [point.x_px for point in hub.sightings.find("roof")] == [7.0, 6.0]


def test_a_document_of_a_newer_version_or_a_damaged_one_is_set_apart(imager: HubArchive, hub: HubArchive) -> None:
    imager.calibrations.add(document("a"))
    imager.calibrations.add(document("b", day=1))
    batch = next_batch(imager)
    changed = []
    for row in batch.rows:
        data = dict(row.data or {})
        if data.get("id") == "a":
            data["document"] = data["document"] | {"schema": "sunarc.calibration/3"}
        if data.get("id") == "b":
            data["document"] = data["document"] | {"method": "paper"}
        changed.append(replace(row, data=data))
    hub.feeds.take(replace(batch, rows=tuple(changed)), now=NOW)
    assert sorted(reasons(hub)) == ["damaged_document", "newer_document"]
    assert hub.calibrations.find("roof") == ()


@pytest.mark.parametrize("damage", [{"method": "paper"}, None], ids=["changed", "no JSON any more"])
def test_a_document_damaged_later_leaves_the_hubs_and_the_other_columns_are_taken(
    imager: HubArchive, hub: HubArchive, damage: dict[str, str] | None
) -> None:
    imager.calibrations.add(document("a"))
    imager.calibrations.activate("a")
    feed(imager, hub)
    imager.calibrations.retire("a", at=NOW)
    batch = next_batch(imager)
    rows = [
        replace(row, data={**row.data, "document": damage and {**row.data["document"], **damage}})
        if row.data is not None and row.data.get("id") == "a" and row.kind == "calibration"
        else row
        for row in batch.rows
    ]
    assert any(row.data is not None and row.data.get("id") == "a" for row in rows)
    hub.feeds.take(replace(batch, rows=tuple(rows)), now=NOW)
    assert reasons(hub) == []
    assert hub.calibrations.find("roof") == imager.calibrations.find("roof")
    assert hub.calibrations.damaged("roof") is None


def test_a_row_is_never_written_over_another_cameras(imager: HubArchive, hub: HubArchive, tmp_path: Path) -> None:
    live_a_little(imager)
    feed(imager, hub)
    before = contents(hub)
    with new_imager(tmp_path, "mast") as other:
        feed(other, hub, "mast")
        after = other.outbox.position()
        stolen = {"id": "roof-1", "camera": "mast", "started_at": 1, "ended_at": None, "reason": "mine"}
        batch = FeedBatch(
            camera="mast",
            installation=after.installation,
            after=after.committed,
            rows=(FeedRow(seq=after.committed + 1, kind="pose_epoch", data=stolen),),
        )
        hub.feeds.take(batch, now=NOW)
    assert reasons(hub) == ["contradiction"]
    assert contents(hub) == before


@pytest.mark.parametrize(
    ("kind", "data"),
    [
        ("pose_epoch.removed", {"id": "roof-2"}),
        ("calibration.removed", {"id": "a"}),
        ("refit.removed", {"id": "r"}),
        ("sun_point", row_of(30, camera="mast", pose_epoch="roof-1")),
        ("refit", {"id": "q", "camera": "mast", "calibration": "b"}),
        ("calibration", {"id": "c", "camera": "mast", "parent": "a"}),
        ("calibration", {"id": "c", "camera": "mast", "pose_epoch": "roof-1"}),
        ("event.removed", {"camera": None, "time": int(NOON.timestamp() * 1e6), "kind": "start", "text": "begun"}),
        ("day.removed", {"camera": "roof", "date": "2026-05-13"}),
        ("day_air.removed", {"camera": "roof", "date": "2026-05-13"}),
        ("sun_point.removed", {name: row_of()[name] for name in FED["sun_point"][1]}),
        ("housekeeping.removed", {"camera": "roof", "step": "hour", "time": 0}),
        ("camera.removed", {"name": "roof"}),
    ],
)
def test_a_camera_touches_no_row_of_another(
    imager: HubArchive, hub: HubArchive, tmp_path: Path, kind: str, data: dict[str, Any]
) -> None:
    """By whatever role the hub is run: these tests run as the owner of the tables."""
    live_a_little(imager)
    feed(imager, hub)
    before = contents(hub)
    with new_imager(tmp_path, "mast") as other:
        other.calibrations.add(document("x", camera="mast", pose_epoch="mast-1"))
        other.refits.request(Refit(id="q", camera="mast", requested_at=NOON, reason="asked"))
        batch = next_batch(other, "mast")
        whole = {row.kind: dict(row.data or {}) for row in batch.rows}
        hub.feeds.take(batch, now=NOW)
    last = batch.rows[-1].seq
    made = batch_of((kind, whole.get(kind, {}) | data), camera="mast", after=last)
    assert hub.feeds.take(replace(made, installation=batch.installation), now=NOW) == last + 1
    assert reasons(hub) == ([] if kind == "event.removed" else [hub.feeds.quarantine()[0].reason])
    assert set(reasons(hub)) <= {"contradiction", "other_camera"}
    assert contents(hub) == before
    assert contents(hub, "mast")["sightings"] == ()


def test_an_event_that_concerns_all_of_an_imager_is_removed_with_its_camera(
    imager: HubArchive, hub: HubArchive
) -> None:
    imager.events.add(Event(time=NOON, kind="start", severity="info", text="begun"))
    feed(imager, hub)
    assert len(hub.events.find("roof")) == 1
    after = imager.outbox.position().committed
    gone = {"camera": None, "time": int(NOON.timestamp() * 1e6), "kind": "start", "text": "begun"}
    made = batch_of(("event.removed", gone), after=after)
    hub.feeds.take(replace(made, installation=imager.outbox.position().installation), now=NOW)
    assert hub.events.find("roof") == ()
    assert reasons(hub) == []


def test_a_status_with_what_is_no_json_blocks_nothing(imager: HubArchive, hub: HubArchive) -> None:
    feed(imager, hub)
    position = imager.outbox.position()
    line = b'{"seq": %d, "kind": "status", "data": {"drift_deg": NaN, "health": "ready"}}\n' % (position.committed + 1)
    rows = read_feed_lines(line, after=position.committed)
    batch = FeedBatch(camera="roof", installation=position.installation, after=position.committed, rows=rows)
    assert hub.feeds.take(batch, now=NOW) == position.committed + 1
    assert hub.feeds.fleet()[0].status == {"drift_deg": None, "health": "ready"}


def test_names_that_nobody_registered_do_not_fill_the_quarantine(hub: HubArchive) -> None:
    refusal = Refusal(reason="unknown_camera", text="no token")
    for n in range(110):
        hub.feeds.refuse(camera=f"c{n}", installation=str(n), refusal=refusal, now=NOW)
    assert len(hub.feeds.quarantine()) == 101
    assert len(hub.feeds.quarantine(limit=7)) == 7


def test_tokens_are_kept_as_digests_end_and_overlap_while_one_replaces_another(hub: HubArchive) -> None:
    later = NOW + timedelta(days=7)
    assert hub.feeds.tokens("roof", now=NOW) is None
    hub.feeds.add_token("roof", "d1", now=NOW, former_until=later)
    hub.feeds.add_token("roof", "d2", now=NOW, former_until=later)
    assert set(hub.feeds.tokens("roof", now=NOW) or ()) == {"d1", "d2"}
    assert hub.feeds.tokens("roof", now=later) == ("d2",)
    assert hub.feeds.end_tokens("roof", now=NOW) == 2
    assert hub.feeds.tokens("roof", now=NOW) == ()


def test_the_fleet_is_every_camera_that_was_registered_or_fed(imager: HubArchive, hub: HubArchive) -> None:
    hub.feeds.add_token("attic", "d", now=NOW, former_until=NOW)
    live_a_little(imager)
    imager.calibrations.add(document("c", day=3) | {"uncertainty": {"sky_rms_deg": 0.0123}})
    imager.calibrations.reinstate("c", at=NOW, reason="test")
    imager.outbox.queue_status({"health": "ready", "disk_free_bytes": 5})
    feed(imager, hub)
    hub.feeds.refuse(camera="roof", installation="x", refusal=Refusal(reason="forged_token", text="t"), now=NOW)
    attic, roof = hub.feeds.fleet()
    assert (attic.camera, attic.received_at, attic.latitude, attic.n_quarantined) == ("attic", None, None, 0)
    assert (roof.received_at, roof.last_sighting_at) == (NOW, NOON + timedelta(seconds=19 * 30))
    assert roof.status == {"health": "ready", "disk_free_bytes": 5}
    assert (roof.latitude, roof.n_quarantined) == (36.6, 1)
    current = imager.calibrations.current("roof")
    assert current is not None
    assert roof.calibration == current.id
    assert roof.sky_rms_deg == 0.0123


def test_feeds_of_many_cameras_at_the_same_time_are_each_complete(hub: HubArchive, tmp_path: Path) -> None:
    names = [f"c{n}" for n in range(6)]
    imagers = [new_imager(tmp_path, name) for name in names]
    for name, one in zip(names, imagers, strict=True):
        one.sightings.add(sighting(n, camera=name) for n in range(100))
    threads = [
        threading.Thread(target=feed, args=(one, hub, name), kwargs={"most": 17})
        for name, one in zip(names, imagers, strict=True)
    ]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(60.0)
    for name, one in zip(names, imagers, strict=True):
        assert contents(hub, name) == contents(one, name)
        one.close()
    assert hub.feeds.quarantine() == ()


def test_a_gap_that_is_closed_leaves_the_quarantine_by_itself(imager: HubArchive, hub: HubArchive) -> None:
    feed(imager, hub)
    hub.feeds.ask_again("roof")
    imager.sightings.add([sighting(0)])
    hub.feeds.take(next_batch(imager), now=NOW)
    assert (reasons(hub), hub.feeds.fleet()[0].n_quarantined) == (["gap"], 1)
    imager.outbox.send_again(committed=-1)
    feed(imager, hub, now=NOW + timedelta(seconds=5))
    assert (reasons(hub), hub.feeds.fleet()[0].n_quarantined) == ([], 0)
    assert hub.feeds.expire(now=NOW + timedelta(seconds=5)) == 1


def test_of_a_camera_and_a_reason_a_hundred_rows_are_kept_and_the_others_are_counted(
    imager: HubArchive, hub: HubArchive
) -> None:
    feed(imager, hub)
    position = imager.outbox.position()
    rows = [("sun_point", row_of(n, pose_epoch="none")) for n in range(250)]
    made = replace(batch_of(*rows, after=position.committed), installation=position.installation)
    for _ in range(2):
        hub.feeds.take(made, now=NOW)
        hub.feeds.take(
            replace(made, rows=tuple(replace(row, seq=row.seq + 250) for row in made.rows), after=made.rows[-1].seq),
            now=NOW,
        )
    found = hub.feeds.quarantine("roof")
    assert len(found) == 101
    (others,) = [one for one in found if one.seq == 0]
    assert (others.n, others.reason, {one.n for one in found} - {others.n}) == (400, "contradiction", {1})
    assert hub.feeds.n_failing("roof") == 2
    later = NOW + KEPT
    assert (hub.feeds.expire(now=later), hub.feeds.expire(now=later + timedelta(seconds=1))) == (0, 101)
    long = batch_of(("x" * 5000, {"y": "z" * 20_000}), after=position.committed + 500)
    hub.feeds.take(replace(long, installation=position.installation), now=NOW)
    (found_long,) = hub.feeds.quarantine("roof")
    assert (len(found_long.kind), found_long.data) == (500, "")
    feed_good = batch_of(("sun_point", row_of(1)), after=position.committed + 501)
    hub.feeds.take(replace(feed_good, installation=position.installation), now=NOW)
    assert hub.feeds.n_failing("roof") == 0


def test_a_calibrations_parent_may_come_in_the_same_batch_and_not_after_it(imager: HubArchive, hub: HubArchive) -> None:
    for name, parent in (("a", None), ("b", "a"), ("c", "b")):
        imager.calibrations.add(document(name), parent=parent)
    batch = next_batch(imager)
    calibrations = [row for row in batch.rows if row.kind == "calibration"]
    assert len(calibrations) == 3
    turned = [replace(row, seq=n) for n, row in enumerate([*batch.rows[:2], *reversed(calibrations)], 1)]
    hub.feeds.take(replace(batch, rows=tuple(turned)), now=NOW)
    assert [one.id for one in hub.calibrations.find("roof")] == ["a"]
    assert reasons(hub) == ["contradiction", "contradiction"]


def test_a_former_imager_sends_sightings_without_a_folder_and_has_them_removed(
    imager: HubArchive, hub: HubArchive
) -> None:
    live_a_little(imager)
    feed(imager, hub)
    (first, *_) = hub.sightings.find("roof")
    assert first.folder == ""
    row = {name: value for name, value in _key_of(first).items() if name != "folder"}
    position = imager.outbox.position()
    after = hub.feeds.take(
        FeedBatch(camera="roof", installation=position.installation, after=position.committed, rows=()), now=NOW
    )
    assert isinstance(after, int)
    rows = (FeedRow(seq=after + 1, kind="sun_point.removed", data=row),)
    n_before = len(hub.sightings.find("roof"))
    batch = FeedBatch(camera="roof", installation=position.installation, after=after, rows=rows)
    assert hub.feeds.take(batch, now=NOW) == after + 1
    assert len(hub.sightings.find("roof")) == n_before - 1
    assert hub.feeds.quarantine("roof") == ()


def _key_of(point: SunPoint) -> dict[str, object]:
    values = {name: getattr(point, name) for name in FED["sun_point"][1]}
    return {**values, "time": int(point.time.timestamp() * 1e6)}
