"""Inserts that meet a row of the same key, in the dialect of the database."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from sqlalchemy import Connection, Table, text
from sqlalchemy.dialects import postgresql, sqlite

from sunarc.archive.json_text import json_text


def _insert(connection: Connection, table: Table) -> sqlite.Insert | postgresql.Insert:
    return sqlite.insert(table) if connection.dialect.name == "sqlite" else postgresql.insert(table)


def insert_new(connection: Connection, table: Table, rows: Sequence[Mapping[str, Any]]) -> int:
    """Insert rows and return how many were new; one whose key is there already is left as it is."""
    statement = _insert(connection, table).on_conflict_do_nothing()
    if connection.dialect.name == "sqlite":
        return connection.execute(statement, list(rows)).rowcount
    # psycopg does not count the rows of many statements; RETURNING makes one statement of many rows besides
    return len(connection.execute(statement.returning(next(iter(table.primary_key))), list(rows)).all())


def upsert(
    connection: Connection, table: Table, row: Mapping[str, Any], *, key: Sequence[str], of: str | None = None
) -> int:
    """Insert a row, or write it over the one of the same key, and return how many rows were written.

    Parameters
    ----------
    connection, table, row : where to, and the columns' values by their keys.
    key : the columns of the unique key.
    of : a column that must have the same value in the row that is there; else nothing is written.
    """
    statement = _insert(connection, table).values(row)
    same = None if of is None else table.c[of] == row[of]
    statement = statement.on_conflict_do_update(index_elements=key, set_=dict(row), where=same)
    return connection.execute(statement.execution_options(preserve_rowcount=True)).rowcount


def upsert_all(connection: Connection, table: Table, rows: Sequence[Mapping[str, Any]], *, key: Sequence[str]) -> None:
    """Insert rows that have the same columns, each over the one of the same key, in their order."""
    if not rows:
        return
    statement = _insert(connection, table)
    written = {name: statement.excluded[name] for name in rows[0] if name not in key}
    connection.execute(statement.on_conflict_do_update(index_elements=key, set_=written), list(rows))


def upsert_records(
    connection: Connection,
    table: Table,
    rows: Sequence[Mapping[str, Any]],
    *,
    columns: Sequence[str],
    key: Sequence[str],
) -> None:
    """Do what `upsert_all` does, on PostgreSQL, in one statement, with rows whose values are as JSON has them.

    It takes half the processor time, here and in the server. Of rows of one key the last is stored, in the place of
    the first.
    """
    last = {tuple(row.get(name) for name in key): row for row in rows}
    names = ", ".join(columns)
    written = ", ".join(f"{name} = excluded.{name}" for name in columns if name not in key)
    statement = text(
        f"INSERT INTO {table.name} ({names}) "  # noqa: S608 - names of the table's own columns
        f"SELECT {names} FROM json_populate_recordset(NULL::{table.name}, CAST(:rows AS json)) "
        f"ON CONFLICT ({', '.join(key)}) DO UPDATE SET {written}"
    )
    connection.execute(statement, {"rows": json_text(list(last.values()))})
