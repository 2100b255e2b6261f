"""Column types. A stored value that cannot be read (a flipped bit, a hand) is None, and never an exception.

A row that lacks a value which it must have is then left out of what is returned (see `store.values_of`).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from datetime import date, datetime
from typing import Any

from sqlalchemy import (
    JSON,
    BigInteger,
    Boolean,
    ColumnElement,
    Date,
    Dialect,
    Float,
    LargeBinary,
    Text,
    TypeDecorator,
)
from sqlalchemy.ext.compiler import compiles
from sqlalchemy.sql.compiler import SQLCompiler
from sqlalchemy.sql.functions import GenericFunction

from sunarc.findings import Finding, from_json
from sunarc.utc import from_microseconds, to_microseconds


class UtcTime(TypeDecorator[datetime]):
    """An aware UTC time as whole microseconds since 1970, so that equality and order are exact."""

    impl = BigInteger
    cache_ok = True

    def process_bind_param(self, value: datetime | None, dialect: Dialect) -> int | None:  # noqa: ARG002 - SQLAlchemy's
        """Return the number to store."""
        return None if value is None else to_microseconds(value)

    def process_result_value(self, value: Any | None, dialect: Dialect) -> datetime | None:  # noqa: ANN401, ARG002 - SQLAlchemy's
        """Return the stored time, aware."""
        if not isinstance(value, int):
            return None
        try:
            return from_microseconds(value)
        except OverflowError:  # no year that a datetime can hold
            return None


class Number(TypeDecorator[float]):
    """A number; a text that stands in its place is None, and so is NaN: SQLite stores it as NULL."""

    impl = Float
    cache_ok = True

    def process_bind_param(self, value: float | None, dialect: Dialect) -> float | None:  # noqa: ARG002 - SQLAlchemy's
        """Return the number to store."""
        return None if value is None or math.isnan(value) else value

    def process_result_value(self, value: Any | None, dialect: Dialect) -> float | None:  # noqa: ANN401, ARG002 - SQLAlchemy's
        """Return the stored number."""
        return value if isinstance(value, int | float) else None


class CalendarDate(TypeDecorator[date]):
    """A date, as SQLAlchemy's `Date` stores it: ISO 8601 text in SQLite."""

    impl = Date
    cache_ok = True

    def result_processor(self, dialect: Dialect, coltype: object) -> Callable[[Any], date | None]:  # noqa: ARG002 - SQLAlchemy's
        """Return what reads the stored text."""
        return _date


class Word(TypeDecorator[str]):
    """One word of a few; another one is None."""

    impl = Text
    cache_ok = True

    def __init__(self, words: tuple[str, ...]) -> None:
        super().__init__()
        self.words = words

    def process_result_value(self, value: Any | None, dialect: Dialect) -> str | None:  # noqa: ANN401, ARG002 - SQLAlchemy's
        """Return the stored word."""
        return value if value in self.words else None


class FindingTuple(TypeDecorator[tuple[Finding, ...]]):
    """Findings, as a JSON list of objects; sentences of version 0.2 become findings without a code."""

    impl = JSON
    cache_ok = True

    def process_bind_param(self, value: tuple[Finding, ...] | None, dialect: Dialect) -> list[dict[str, Any]]:  # noqa: ARG002 - SQLAlchemy's
        """Return the list to store."""
        return [finding.as_json() for finding in value or ()]

    def process_result_value(self, value: Any | None, dialect: Dialect) -> tuple[Finding, ...]:  # noqa: ANN401, ARG002 - SQLAlchemy's
        """Return the stored findings; none where they cannot be read."""
        return tuple(from_json(one) for one in value) if isinstance(value, list) else ()


class NumberTuple(TypeDecorator[tuple[float, ...]]):
    """So many numbers, as a JSON list; None where there are none."""

    impl = JSON(none_as_null=True)
    cache_ok = True

    def __init__(self, length: int) -> None:
        super().__init__()
        self.length = length

    def process_bind_param(self, value: tuple[float, ...] | None, dialect: Dialect) -> list[float] | None:  # noqa: ARG002 - SQLAlchemy's
        """Return the list to store."""
        return None if value is None else list(value)

    def process_result_value(self, value: Any | None, dialect: Dialect) -> tuple[float, ...] | None:  # noqa: ANN401, ARG002 - SQLAlchemy's
        """Return the stored numbers."""
        if not isinstance(value, list) or len(value) != self.length:
            return None
        return tuple(value) if all(isinstance(number, int | float) for number in value) else None


class JsonObject(TypeDecorator[dict[str, Any]]):
    """A JSON object; empty where it cannot be read."""

    impl = JSON
    cache_ok = True

    def process_result_value(self, value: Any | None, dialect: Dialect) -> dict[str, Any]:  # noqa: ANN401, ARG002 - SQLAlchemy's
        """Return the stored object."""
        return value if isinstance(value, dict) else {}


def stored_bytes(column: ColumnElement[Any]) -> ColumnElement[bytes]:
    """Return the bytes of a JSON column as they are stored."""
    return _StoredBytes(column)


class _StoredBytes(GenericFunction[bytes]):
    type = LargeBinary()
    inherit_cache = True


@compiles(_StoredBytes)
def _cast_to_blob(element: _StoredBytes, compiler: SQLCompiler, **options: Any) -> str:  # noqa: ANN401 - SQLAlchemy's
    return f"CAST({compiler.process(element.clauses, **options)} AS BLOB)"


@compiles(_StoredBytes, "postgresql")
def _convert_to_bytes(element: _StoredBytes, compiler: SQLCompiler, **options: Any) -> str:  # noqa: ANN401 - SQLAlchemy's
    return f"convert_to(({compiler.process(element.clauses, **options)})::text, 'UTF8')"


class stored_as(GenericFunction[bool]):  # noqa: N801 - a function of SQL
    """Whether a column's value is stored as SQLite's `kind`; on PostgreSQL: whether there is one."""

    type = Boolean()
    inherit_cache = True


@compiles(stored_as)
def _compare_type(element: stored_as, compiler: SQLCompiler, **options: Any) -> str:  # noqa: ANN401 - SQLAlchemy's
    column, kind = element.clauses
    return f"(typeof({compiler.process(column, **options)}) = {compiler.process(kind, **options)})"


class is_number(GenericFunction[bool]):  # noqa: N801 - a function of SQL
    """Whether a column's value is a number; on PostgreSQL: whether there is one."""

    type = Boolean()
    inherit_cache = True


@compiles(is_number)
def _compare_order(element: is_number, compiler: SQLCompiler, **options: Any) -> str:  # noqa: ANN401 - SQLAlchemy's
    # texts and blobs come after all numbers; millions of names of types would take twice as long to compare
    return f"({compiler.process(next(iter(element.clauses)), **options)} <= 9e999)"


@compiles(stored_as, "postgresql")
@compiles(is_number, "postgresql")
def _compare_null(element: stored_as | is_number, compiler: SQLCompiler, **options: Any) -> str:  # noqa: ANN401 - SQLAlchemy's
    return f"({compiler.process(next(iter(element.clauses)), **options)} IS NOT NULL)"


def _date(stored: object) -> date | None:
    if isinstance(stored, date):
        return stored
    try:
        return date.fromisoformat(stored) if isinstance(stored, str) else None
    except ValueError:
        return None
