"""The contract of a feed: its schema, and rows with whatever is wrong are set apart; none stops those after it."""

from __future__ import annotations

import json
import os
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from jsonschema_rs import Draft202012Validator
from tests.fixtures.feed_cases import good_rows, has_whole_floats, spoilt
from tests.fixtures.fleet import NOW, batch_of, sighting

from sunarc.common.errors import InputError
from sunarc.hub.archive import HubArchive
from sunarc.hub.feed_schema import feed_schema, find_problem, typed
from sunarc.imager.archive.database.schema import head_revision
from sunarc.imager.archive.feed_rows import FED, REMOVED, STATUS, FeedRow, Refusal, feed_lines, read_feed_lines

CASES = int(os.environ.get("SUNARC_FEED_CASES", "40"))
"""Batches of each engine; `tests/long feed-cases` has more."""
slowly = settings(
    max_examples=CASES, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow]
)


def test_every_column_is_described() -> None:
    kinds = feed_schema(head_revision())["$defs"]
    lacking = [
        (kind, name)
        for kind in (*FED, STATUS)
        for name, column in kinds[kind]["properties"].items()
        if not column.get("description")
    ]
    assert lacking == []


def taken(kind: str, data: dict[str, Any]) -> bool:
    """Whether the hub finds nothing wrong with the form of a row."""
    table = kind.removesuffix(REMOVED)
    if find_problem(table, data, only_key=table != kind) is not None:
        return False
    try:
        return bool(kind == STATUS or typed(table, data) is not None)
    except (ValueError, OverflowError):
        return False


def test_the_hub_takes_what_the_schema_takes(tmp_path: Path) -> None:
    validator = Draft202012Validator(feed_schema(head_revision()), validate_formats=True)
    rows = good_rows(tmp_path)
    assert {kind for kind, _ in rows} == {*FED, *(kind + REMOVED for kind in FED), STATUS}
    for kind, data in rows:
        assert validator.is_valid({"seq": 1, "kind": kind, "data": data})
        assert taken(kind, data)
    answers: set[bool] = set()

    @settings(slowly, max_examples=max(CASES, 300))
    @given(spoilt(rows))
    def compare(row: tuple[str, dict[str, Any]]) -> None:
        kind, data = row
        if not has_whole_floats(data):
            found = validator.is_valid({"seq": 1, "kind": kind, "data": json.loads(json.dumps(data))})
            assert taken(kind, data) == found, (kind, data)
            answers.add(found)

    compare()
    assert answers == {True, False}


def test_whatever_a_row_is_it_is_stored_or_set_apart_and_the_next_one_is_stored(
    hub: HubArchive, tmp_path: Path
) -> None:
    (tmp_path / "mast").mkdir()
    others = good_rows(tmp_path / "mast", "mast")
    rows = good_rows(tmp_path)
    whole = [row for row in others if not row[0].endswith(REMOVED)]
    assert hub.feeds.take(batch_of(*whole, camera="mast"), now=NOW) == len(whole)
    before = {name: getattr(hub, name).find("mast") for name in ("sightings", "days", "calibrations", "refits")}
    hub.feeds.take(batch_of(*[row for row in rows if not row[0].endswith(REMOVED)]), now=NOW)
    sent = [len(whole)]

    @slowly
    @given(st.lists(spoilt(rows), min_size=1, max_size=4))
    def send(batch: list[tuple[str, dict[str, Any]]]) -> None:
        after = sent[0]
        moment = sighting(after).time
        last = dict(rows[2][1]) | {"time": int(moment.timestamp() * 1e6), "pose_epoch": "roof-1", "file": "last"}
        epoch = dict(rows[1][1])
        every = [rows[0], *batch, rows[0], ("pose_epoch", epoch), ("sun_point", last)]
        lines = feed_lines([FeedRow(seq=after + n, kind=kind, data=data) for n, (kind, data) in enumerate(every, 1)])
        made = replace(batch_of(after=after), rows=read_feed_lines(lines, after=after))
        committed = hub.feeds.take(made, now=max(NOW, moment))
        assert not isinstance(committed, Refusal)
        assert committed == after + len(every)
        assert len(hub.sightings.find("roof", since=moment, until=moment.replace(microsecond=1))) >= 1
        sent[0] = committed

    send()
    assert before == {name: getattr(hub, name).find("mast") for name in before}
    assert all(found.camera == "roof" for found in hub.feeds.quarantine())


@pytest.mark.parametrize("name", ["", "a/b", ".", "..", " roof", "roof ", "a\nb", "x" * 101, "(others)", "half \ud800"])
def test_a_name_that_no_address_can_have_gets_no_token(hub: HubArchive, name: str) -> None:
    with pytest.raises(InputError) as error:
        hub.feeds.add_token(name, "d", now=NOW, former_until=NOW)
    assert error.value.field == "camera"
    hub.feeds.add_token("Wetterstation 2, Süd", "d", now=NOW, former_until=NOW)
