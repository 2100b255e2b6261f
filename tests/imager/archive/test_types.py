"""Column types: exact round trips, and None (or nothing) for what cannot be read."""

from __future__ import annotations

from datetime import UTC, date, datetime, timedelta, timezone
from typing import Any

import pytest
from sqlalchemy import TypeDecorator
from sqlalchemy.dialects import sqlite

from sunarc.common.findings import UNCODED, Finding, uncoded
from sunarc.common.utc import to_microseconds
from sunarc.imager.archive.database.tables import CalendarDate, FindingTuple, JsonObject, NumberTuple, UtcTime, Word

DIALECT = sqlite.dialect()


def read(column: TypeDecorator[Any], stored: object) -> object:
    return column.process_result_value(stored, DIALECT)


@pytest.mark.parametrize(
    ("time", "microseconds"),
    [
        (datetime(1970, 1, 1, tzinfo=UTC), 0),
        (datetime(1970, 1, 1, 0, 0, 0, 1, tzinfo=UTC), 1),
        (datetime(1969, 12, 31, 23, 59, 59, 999_999, tzinfo=UTC), -1),
        (datetime(2013, 5, 13, 18, 30, tzinfo=UTC), 1_368_469_800_000_000),
        (datetime(2013, 5, 13, 20, 30, tzinfo=timezone(timedelta(hours=2))), 1_368_469_800_000_000),
    ],
)
def test_a_time_is_its_microseconds(time: datetime, microseconds: int) -> None:
    assert to_microseconds(time) == microseconds
    assert read(UtcTime(), microseconds) == time


@pytest.mark.parametrize("stored", [None, "2013-05-13", 1.5, 10**30, -(10**30), b"\x00"])
def test_what_is_no_time_is_none(stored: object) -> None:
    assert read(UtcTime(), stored) is None


@pytest.mark.parametrize(
    ("stored", "day"),
    [("2013-05-13", date(2013, 5, 13)), ("2013-13-05", None), ("13 May", None), (20130513, None), (None, None)],
)
def test_a_date_is_iso_8601(stored: object, day: date | None) -> None:
    assert CalendarDate().result_processor(DIALECT, None)(stored) == day


@pytest.mark.parametrize(("stored", "word"), [("clear", "clear"), ("Clear", None), ("", None), (3, None), (None, None)])
def test_a_word_is_one_of_those_known(stored: object, word: str | None) -> None:
    assert read(Word(("clear", "cloudy")), stored) == word


@pytest.mark.parametrize(
    ("stored", "findings"),
    [
        ([{"code": "a", "data": {"n": 1}}, {"code": "b"}], (Finding("a", {"n": 1}), Finding("b"))),
        (["a", 1], (uncoded("a"), uncoded("1"))),
        ([{}], (Finding(UNCODED),)),
        ([], ()),
        (None, ()),
        ("a", ()),
        ({}, ()),
    ],
)
def test_findings_are_a_list(stored: object, findings: tuple[Finding, ...]) -> None:
    assert read(FindingTuple(), stored) == findings


def test_findings_are_stored_as_a_list() -> None:
    column = FindingTuple()
    assert column.process_bind_param((Finding("a", {"n": 1}),), DIALECT) == [{"code": "a", "data": {"n": 1}}]
    assert column.process_bind_param(None, DIALECT) == []


@pytest.mark.parametrize(
    ("stored", "numbers"),
    [
        ([1.5, 2, -3.0], (1.5, 2, -3.0)),
        ([1.5, 2], None),
        ([1.5, 2, "3"], None),
        ([1.5, 2, None], None),
        ("abc", None),
        (None, None),
    ],
)
def test_numbers_are_as_many_as_stated(stored: object, numbers: tuple[float, ...] | None) -> None:
    assert read(NumberTuple(3), stored) == numbers


def test_no_numbers_are_stored_as_none() -> None:
    assert NumberTuple(2).process_bind_param(None, DIALECT) is None
    assert NumberTuple(2).process_bind_param((1.0, 2.0), DIALECT) == [1.0, 2.0]


@pytest.mark.parametrize(("stored", "value"), [({"a": [1]}, {"a": [1]}), ([1], {}), ("x", {}), (None, {})])
def test_an_object_is_an_object(stored: object, value: dict[str, Any]) -> None:
    assert read(JsonObject(), stored) == value
