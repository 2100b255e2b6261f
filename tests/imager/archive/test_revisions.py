"""Every older revision of the database, something in every table: nothing of it is lost on the way there and back."""

from __future__ import annotations

import json
import runpy
import sqlite3
from contextlib import closing
from dataclasses import replace
from datetime import datetime, timedelta
from itertools import pairwise
from pathlib import Path
from string import Formatter
from typing import Any

import pytest
from tests.fixtures.nights import judged, whole_night
from tests.fixtures.stores import NOON

from sunarc.common.findings import Finding, uncoded
from sunarc.hub.archive import HubArchive, open_hub_archive
from sunarc.hub.nightly_store import NightlyRun
from sunarc.imager.archive.database.schema import check, downgrade, upgrade
from sunarc.imager.archive.database.tables import metadata
from sunarc.imager.archive.days import NightImage
from sunarc.imager.archive.feed_rows import FeedBatch, FeedRow, Refusal
from sunarc.imager.archive.seen_files import SeenFile
from sunarc.imager.archive.sightings import MOVED
from sunarc.imager.archive.values import Day, DayAir, Event, Housekeeping, Refit, SunPoint
from sunarc.imager.workers.night.night import night_event

from .test_calibrations import document

Rows = list[dict[str, object]]
VERSIONS = Path(__file__).parents[3] / "migrations" / "versions"
REVISIONS = sorted((script.name[:4] for script in VERSIONS.glob("[0-9]*.py")), reverse=True)


@pytest.fixture
def filled(archive: HubArchive, path: Path) -> Path:
    """Return a database of the head revision with a row or more in every table."""
    epoch = archive.epochs.at("roof", NOON, reason="installed").id
    archive.days.set_air(DayAir(camera="roof", date=NOON.date(), temperature_c=35.0, pressure_hpa=980.0, set_at=NOON))
    archive.sightings.add(
        SunPoint(camera="roof", pose_epoch=epoch, time=NOON + timedelta(seconds=30 * i), method="disc", accepted=True,
                 verdict="clear", x_px=500.0 + i, y_px=900.0, sigma_px=0.02, temperature_c=30.0 + 0.01 * i)
        for i in range(100)
    )  # fmt: skip
    archive.calibrations.add(document("a", pose_epoch=epoch), used=archive.sightings.columns("roof"))
    archive.calibrations.activate("a")
    archive.calibrations.pin("a", at=NOON, reason="by hand")
    archive.refits.add(Refit(id="r", camera="roof", requested_at=NOON, reason="by hand"))
    archive.days.save(Day(camera="roof", date=NOON.date(), verdict="clear", findings=(), n=100, n_possible=100,
                         n_cycles=100, decided_at=NOON, pose_offset_deg=(0.1, 0.2, 0.3)))  # fmt: skip
    archive.events.add(Event(time=NOON, kind="note", severity="info", text="here", camera="roof"))
    _feed(archive)
    _notify(archive)
    archive.housekeeping.add(
        "roof", [Housekeeping(time=NOON, disk_free_bytes=2**40, temperature_c=40.5, n_temperatures=1)]
    )
    archive.conditions.replace_since("roof", {"disk_low": NOON})
    archive.nights.add_image("roof", night_image(NOON), keep_since=NOON)
    archive.nights.save(whole_night(NOON), event=night_event(whole_night(NOON)))
    archive.seen_files.add([SeenFile(camera="roof", file="a.jpg", stamp="1 2", content="ff", time=NOON)])
    archive.nightly.summarise_days()
    archive.nightly.save(NightlyRun(night=NOON.date(), started_at=NOON, finished_at=NOON, results={"a": {"days": 1}}))
    archive.close()
    return path


def night_image(time: datetime) -> NightImage:
    """Return an image of the night without stars."""
    return NightImage(
        time=time,
        kind="stars",
        exposure_us=5e6,
        gain_db=0.0,
        pixel_format="Mono12",
        full_scale=4095,
        width=8,
        height=6,
        binning=1,
        serial="1",
        clock_error_s=0.01,
        measured=b"",
    )


def _feed(archive: HubArchive) -> None:
    """Queue what there is for a hub, and take, as a hub, what another one sends."""
    archive.outbox.enable()
    archive.feeds.add_token("roof", "digest", now=NOON, former_until=NOON)
    status = FeedRow(seq=1, kind="status", data={"time": NOON.isoformat()})
    archive.feeds.take(FeedBatch(camera="roof", installation="other", after=0, rows=(status,)), now=NOON)
    forged = Refusal(reason="forged_token", text="unknown")
    archive.feeds.refuse(camera="roof", installation="third", refusal=forged, now=NOON)


def _notify(archive: HubArchive) -> None:
    """Store a notice for a receiver."""
    archive.notices.name_sinks(["broker"])
    archive.notices.record("roof", {}, now=NOON)
    archive.notices.record("roof", {"disk_low": {"free_mb": 1.0}}, now=NOON)


def everything(path: Path) -> dict[str, Rows]:
    with closing(sqlite3.connect(path)) as connection:
        connection.row_factory = sqlite3.Row
        names = connection.execute("SELECT name FROM sqlite_master WHERE type = 'table' ORDER BY name").fetchall()
        return {
            name: [dict(row) for row in connection.execute(f'SELECT * FROM "{name}" ORDER BY 1')]  # noqa: S608 - its own names
            for (name,) in names
            if name not in {"alembic_version", "sqlite_sequence"}
        }


def shared(left: dict[str, Rows], right: dict[str, Rows]) -> tuple[dict[str, Rows], dict[str, Rows]]:
    """Return what both revisions can hold, as either holds it."""
    columns = {name: left[name][0].keys() & right[name][0].keys() for name in left.keys() & right.keys()}
    unknown = (left.keys() | right.keys()) - columns.keys()  # rows of these cannot be sent by the older one
    cut = [
        {
            name: [{key: row[key] for key in keys} for row in held[name] if row.get("kind") not in unknown]
            for name, keys in columns.items()
        }
        for held in (left, right)
    ]
    return cut[0], cut[1]


def test_every_table_has_a_row_to_lose(filled: Path) -> None:
    held = everything(filled)
    assert {name for name, rows in held.items() if rows} == set(metadata.tables)


def test_every_step_down_and_up_again_keeps_what_both_revisions_hold(filled: Path) -> None:
    former = everything(filled)
    for newer, older in pairwise(REVISIONS):
        copy = downgrade(filled, older)
        assert everything(copy) == former, f"the copy that {newer} leaves behind"
        present = everything(filled)
        kept, wanted = shared(present, former)
        assert kept == wanted, f"from {newer} to {older}"
        former = present
    upgrade(filled)
    kept, wanted = shared(everything(filled), former)
    assert kept == wanted
    assert check(filled).sound


def test_the_sentence_of_an_older_refit_is_its_finding(filled: Path) -> None:
    archive = open_hub_archive(filled)
    archive.refits.add(Refit(id="new", camera="roof", requested_at=NOON, reason="by hand"))
    no_arc = (Finding("no_camera_fits"),)
    archive.refits.finish("r", state="failed", finished_at=NOON, message="no camera's arc", findings=no_arc)
    assert archive.refits.get("r").findings == no_arc
    archive.close()
    downgrade(filled, "0009")
    upgrade(filled)
    archive = open_hub_archive(filled)
    assert archive.refits.get("r").findings == (uncoded("no camera's arc"),)
    assert archive.refits.get("new").findings == ()
    archive.close()


MIGRATION = runpy.run_path(str(VERSIONS / "0018_findings_of_sightings.py"))


def reasons_at(path: Path, revision: str, reasons: list[object]) -> list[object]:
    """Return what these reasons of sightings of revision 0017 are after a way there and back."""
    downgrade(path, "0017")
    told = [(text, row) for row, text in enumerate(reasons, 1)]
    with closing(sqlite3.connect(path)) as connection, connection:
        connection.executemany("UPDATE sun_point SET reason = ? WHERE id = ?", told)
    upgrade(path)
    if revision != "0018":
        downgrade(path, revision)
    with closing(sqlite3.connect(path)) as connection:
        return [text for (text,) in connection.execute("SELECT reason FROM sun_point ORDER BY id LIMIT ?", [len(told)])]


def test_sentences_of_sightings_become_findings_where_their_codes_are_sure(filled: Path) -> None:
    found = "a disc, reduced chi² 1.04"
    sentences: list[object] = [
        *("", found, f"{found}, 12 saturated pixels left out", f"sun covered in another frame of the bracket: {found}"),
        *("uneven brightness, worth 0.30 px (chi² 9 for 4)", "a cloud; in words of nobody", "bump: a turn", "[{1}]"),
        *(f"{found}: 12 saturated pixels left out", "the camera had moved", 5, b"\xff"),
    ]
    reasons_at(filled, "0018", sentences)
    archive = open_hub_archive(filled)
    stored = [point.findings for point in archive.sightings.find("roof")][: len(sentences)]
    disc = Finding("disc_found", {"chi2": 1.04})
    assert stored[:5] == [
        (), (disc,), (disc, Finding("saturated_left_out", {"n": 12})), (Finding("bracket_covered"), disc),
        (Finding("disc_uneven", {"uneven_px": 0.3, "chi2": 9, "limit_px": 0.03, "limit_chi2": 16.0}),),
    ]  # fmt: skip
    assert stored[5:9] == [(uncoded(str(text)),) for text in sentences[5:9]]
    assert stored[9] == MOVED
    assert [one[0].code for one in stored[10:]] == ["uncoded", "uncoded"]
    archive.close()


ELSEWHERE = "not where it should be: a disc, reduced chi² 1.04"


def test_the_sentences_of_sightings_are_the_same_after_a_way_there_and_back(filled: Path) -> None:
    left_out = "a disc, reduced chi² 1.04, 12 saturated pixels left out"
    sentences: list[object] = [
        *("", f"{left_out}; mean of 3 frames (chi² 2.3, 4 degrees of freedom)", "something else"),
        *(ELSEWHERE, "the camera had moved"),
    ]
    assert reasons_at(filled, "0017", sentences) == sentences


def test_findings_of_sightings_are_sentences_again_for_an_older_version(filled: Path) -> None:
    archive = open_hub_archive(filled)
    point = archive.sightings.find("roof")[0]
    findings = (Finding("sun_elsewhere"), Finding("disc_found", {"chi2": 1.0449}), Finding("of_tomorrow", {"n": 1}))
    archive.sightings.replace([replace(point, findings=findings)])
    archive.close()
    downgrade(filled, "0017")
    with closing(sqlite3.connect(filled)) as connection:
        (reason,) = connection.execute("SELECT reason FROM sun_point ORDER BY time LIMIT 1").fetchone()
    assert reason.split("; ") == [ELSEWHERE, " ".join(("of_tomorrow", str(findings[-1].data)))]


@pytest.mark.parametrize(("code", "sentence"), MIGRATION["_SENTENCES"].items())
def test_the_migration_knows_each_sentence_as_that_of_its_code_alone(code: str, sentence: str) -> None:
    data = {name: 0.25 if spec else 7 for _, name, spec, _ in Formatter().parse(sentence) if name}
    text = sentence.format_map(data)
    told = MIGRATION["_as_findings"](text)
    if code == "file_unreadable":
        assert told is None
    else:
        assert [one["code"] for one in json.loads(told)] == [code]
        assert MIGRATION["_as_sentence"](told) == text


def test_the_events_of_former_nights_become_rows_the_last_of_each_night(filled: Path) -> None:
    archive = open_hub_archive(filled)
    night = archive.nights.find("roof")[0]
    why = (Finding("night_without_calibration"),)
    second = judged("2013-05-11", at=NOON - timedelta(days=1), findings=why, n_images=9)
    archive.events.add(night_event(replace(night, decided_at=NOON + timedelta(hours=1), verdict="cloudy")))
    archive.events.add(night_event(night))
    archive.events.add(night_event(second))
    unread: list[dict[str, Any]] = [
        {"date": "2013-05-10", "verdict": "clear", "findings": []},
        {"date": "2013-05-09", "verdict": "bright", "n_images": 3},
        {"date": "2013-05-32", "verdict": "clear", "n_images": 3},
        {"date": "2013-05-08", "n_images": 3},
        {},
    ]
    for number, details in enumerate(unread):
        time = NOON - timedelta(days=2, hours=number)
        archive.events.add(replace(night_event(second), details=details, time=time))
    archive.close()
    downgrade(filled, "0016")
    with closing(sqlite3.connect(filled)) as connection, connection:
        connection.execute("UPDATE event SET details = '{' WHERE id = (SELECT max(id) FROM event)")
    upgrade(filled)
    archive = open_hub_archive(filled)
    first, former, *damaged = archive.nights.find("roof")
    assert (first, former) == (night, second)
    assert [(f"{one.date}", one.verdict, one.findings[0].code, one.findings[0].data["field"]) for one in damaged] == [
        ("2013-05-10", "unusable", "night_damaged", "n_images"),
        ("2013-05-09", "unusable", "night_damaged", "verdict"),
    ]
    archive.close()
    assert check(filled).sound


@pytest.mark.parametrize(
    "damaged", ["CAST('short' AS BLOB)", "X'ff41'", "CAST(X'80ff41' AS TEXT)", "5", "'a' || char(0)"]
)
def test_a_damaged_sentence_of_a_refit_does_not_stop_the_upgrade(filled: Path, damaged: str) -> None:
    downgrade(filled, "0009")
    with closing(sqlite3.connect(filled)) as connection, connection:
        connection.execute(f"UPDATE refit SET message = {damaged}")  # noqa: S608 - the test's own
    upgrade(filled)
    archive = open_hub_archive(filled)
    (refit,) = archive.refits.find("roof")
    assert [finding.code for finding in refit.findings] == ["uncoded"]
    archive.close()


@pytest.mark.parametrize("revision", REVISIONS[1:])
def test_an_older_database_is_upgraded_at_once_and_serves(filled: Path, revision: str) -> None:
    downgrade(filled, revision)
    older = everything(filled)
    copy = upgrade(filled)
    assert copy is not None
    assert everything(copy) == older
    archive = open_hub_archive(filled)
    current = archive.calibrations.current("roof")
    assert current is not None
    assert current.id == "a"
    assert len(archive.sightings.columns("roof").ids) == 100
    archive.close()
