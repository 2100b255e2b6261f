"""Which calibration answers when, against a model that keeps an answer for every hour."""

from __future__ import annotations

from collections.abc import Iterator
from datetime import datetime, timedelta
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from sqlalchemy import Connection, create_engine, insert, select
from tests.fixtures.stores import NOON, ROOF

from sunarc.imager.archive.calibration_rows import apply_row_interval, clear_interval, end_others, set_columns
from sunarc.imager.archive.database.tables import calibration, camera, metadata
from sunarc.imager.archive.values import CalibrationRecord

HOURS = range(40)
SERVED = ("current", "retired")


def hour(number: int) -> datetime:
    return NOON + timedelta(hours=number)


@pytest.fixture
def connection(tmp_path: Path) -> Iterator[Connection]:
    engine = create_engine(f"sqlite:///{tmp_path / 'rules.sqlite'}")
    metadata.create_all(engine)
    with engine.connect() as opened:
        names = {"name": "roof", "latitude": 36.6, "longitude": -97.5, "altitude": 318.0, "width": 8, "height": 6}
        opened.execute(insert(camera).values({"model": "", "serial": "", "pixel_format": ""} | names))
        yield opened
    engine.dispose()


def store(connection: Connection, name: str, first: int, last: int | None, **more: Any) -> None:  # noqa: ANN401 - columns
    row: dict[str, Any] = {
        "id": name, "camera": "roof", "state": "current" if last is None else "retired", "method": "robust",
        "created_at": hour(first), "valid_from": hour(first), "valid_until": None if last is None else hour(last),
        "accepted": True, "findings": (), "document": {}, "pinned": last is None,
    }  # fmt: skip
    connection.execute(insert(calibration).values(row | more))


def answers(connection: Connection) -> list[set[str]]:
    """Return the ids that answer in the middle of every hour."""
    rows = connection.execute(select(calibration)).all()
    served = [row for row in rows if row.state in SERVED]
    return [
        {
            row.id
            for row in served
            if row.valid_from <= hour(h) + timedelta(minutes=30)
            and (row.valid_until is None or row.valid_until > hour(h) + timedelta(minutes=30))
        }
        for h in HOURS
    ]


def tiled(connection: Connection, seed: int) -> list[set[str]]:
    """Store calibrations that follow one another, with a gap here and there, and return who answers."""
    rng = np.random.default_rng(seed)
    bounds = np.sort(rng.choice(np.arange(1, 36), size=6, replace=False)).tolist()
    for number, (first, last) in enumerate(zip(bounds, [*bounds[1:], None], strict=True)):
        gap = last is not None and last - first > 2 and rng.uniform() < 0.3
        store(connection, f"c{number}", first, last - 1 if gap and last is not None else last)
    return answers(connection)


@pytest.mark.parametrize("seed", range(12))
def test_a_cleared_interval_has_no_answer_and_all_else_keeps_its_own(connection: Connection, seed: int) -> None:
    before = tiled(connection, seed)
    since, until = sorted(np.random.default_rng(100 + seed).choice(39, size=2, replace=False).tolist())
    clear_interval(connection, "roof", hour(since), hour(until))
    after = answers(connection)
    assert [after[h] for h in range(since, until)] == [set()] * (until - since)
    beyond = [h for h in HOURS if h >= until]
    reached_in = [h for h in beyond if before[h] and before[h] == (before[since - 1] if since else None)]
    # what began before the interval ends with it; only what began within it goes on beyond
    assert [after[h] for h in beyond if h not in reached_in] == [before[h] for h in beyond if h not in reached_in]
    assert [after[h] for h in range(since)] == [before[h] for h in range(since)]


@pytest.mark.parametrize("seed", range(12))
def test_from_a_calibrations_end_on_no_other_answers(connection: Connection, seed: int) -> None:
    before = tiled(connection, seed)
    at = int(np.random.default_rng(200 + seed).integers(0, 39))
    end_others(connection, "roof", hour(at))
    after = answers(connection)
    assert after[:at] == before[:at]
    assert after[at:] == [set()] * (len(after) - at)


@pytest.mark.parametrize("seed", range(4))
def test_no_interval_ends_before_it_begins(connection: Connection, seed: int) -> None:
    tiled(connection, seed)
    end_others(connection, "roof", hour(10))
    clear_interval(connection, "roof", hour(3), hour(6))
    rows = connection.execute(select(calibration)).all()
    assert [row.id for row in rows if row.valid_until is not None and row.valid_until < row.valid_from] == []


def test_what_ended_is_neither_current_nor_pinned(connection: Connection) -> None:
    store(connection, "a", 1, None)
    end_others(connection, "roof", hour(5))
    (row,) = connection.execute(select(calibration)).all()
    assert (row.state, row.pinned, row.valid_until) == ("retired", False, hour(5))


def test_what_ended_before_keeps_its_end(connection: Connection) -> None:
    store(connection, "a", 1, 3)
    end_others(connection, "roof", hour(5))
    (row,) = connection.execute(select(calibration)).all()
    assert row.valid_until == hour(3)


@pytest.mark.parametrize("state", ["candidate", "refused"])
def test_what_never_answered_is_left_as_it_is(connection: Connection, state: str) -> None:
    store(connection, "a", 1, None, state=state, pinned=False)
    end_others(connection, "roof", hour(0))
    clear_interval(connection, "roof", hour(0), hour(9))
    (row,) = connection.execute(select(calibration)).all()
    assert (row.state, row.valid_from, row.valid_until) == (state, hour(1), None)


def test_another_cameras_calibrations_are_left_as_they_are(connection: Connection) -> None:
    store(connection, "a", 1, None)
    end_others(connection, "mast", hour(0))
    clear_interval(connection, "mast", hour(0), hour(9))
    assert answers(connection)[5] == {"a"}


def test_columns_of_one_calibration_are_written(connection: Connection) -> None:
    store(connection, "a", 1, 3)
    store(connection, "b", 4, 6)
    set_columns(connection, "b", valid_until=hour(5))
    ends = {row.id: row.valid_until for row in connection.execute(select(calibration)).all()}
    assert ends == {"a": hour(3), "b": hour(5)}


def test_a_document_says_what_the_archive_decided() -> None:
    document = {"id": "a", "state": "candidate", "verdict": {"accepted": False, "reasons": ["x"], "more": 1}}
    record = CalibrationRecord(
        id="a", camera=ROOF.name, state="retired", method="robust", created_at=NOON, valid_from=hour(1),
        valid_until=hour(2), pose_epoch=None, parent=None, accepted=True, findings=(), document=document,
    )  # fmt: skip
    decided = apply_row_interval(record).document
    assert (decided["state"], decided["valid_from"], decided["valid_until"]) == (
        "retired", "2013-05-13T19:30:00Z", "2013-05-13T20:30:00Z",
    )  # fmt: skip
    assert decided["verdict"] == {"accepted": True, "reasons": [], "findings": [], "more": 1}
    assert document["state"] == "candidate"  # the stored one is not changed
