"""The outbox: every change of a row that a hub is to know, written by triggers in the transaction of the change."""

from __future__ import annotations

import uuid
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from datetime import date
from itertools import chain
from typing import Any

import sqlalchemy as sa

from sunarc.common.errors import ConfigurationError
from sunarc.imager.archive.database.connections import json_text, parsed_json
from sunarc.imager.archive.database.store import Part
from sunarc.imager.archive.database.tables import outbox, outbox_position
from sunarc.imager.archive.day_digests import DayDigests, day_condition, day_digests, first_and_last_day
from sunarc.imager.archive.feed_rows import FED, REMOVED, STATUS, FeedRow, from_trigger, plain_type, sent_columns

_CHANGES = ("insert", "update", "delete")
_TRIGGERS = "SELECT name, sql FROM sqlite_master WHERE type = 'trigger' AND name LIKE 'outbox!_%' ESCAPE '!'"


@dataclass(frozen=True, slots=True, kw_only=True)
class OutboxPosition:
    """Position up to which an imager's rows were sent.

    Attributes
    ----------
    installation : id of this database's outbox; a database that was put back to an earlier state needs another.
    committed : the hub has everything up to this number.
    sent : nothing beyond this number was ever sent; raised only after the hub has said where it stands.
    """

    installation: str
    committed: int
    sent: int


class Outbox(Part):
    """Rows that an imager sends to a hub."""

    def enable(self) -> bool:
        """Begin to write changes to the outbox; all present rows are queued first unless there was no break.

        A migration that makes a table anew takes its triggers away: they are compared with what they should be, and
        where one differs all rows are queued again. Sent twice, a row is stored once. Of a kind that a former version
        did not send the rows are queued, and no others.

        Returns
        -------
        Whether all rows were queued.
        """
        if self._database.file is None:
            raise ConfigurationError("hub.url: only an archive in SQLite is sent to a hub; unset `store` or `hub.url`")
        wanted = dict(outbox_triggers())
        with self._database.reading() as connection:
            if _is_begun(connection) and _read_triggers(connection) == wanted:
                return False
        with self._database.writing() as connection:
            present, begun = _read_triggers(connection), _is_begun(connection)
            new = [kind for kind in FED if not present.keys() & _list_trigger_names(kind)]
            others = {
                name: sql for name, sql in wanted.items() if not any(name in _list_trigger_names(kind) for kind in new)
            }
            if begun and present and present == others:
                for name in wanted.keys() - others.keys():
                    connection.exec_driver_sql(wanted[name])
                _queue_rows(connection, new)
                return False
            _drop_triggers(connection, present)
            for sql in wanted.values():
                connection.exec_driver_sql(sql)
            _queue_all(connection)
            _write_position(connection, OutboxPosition(installation=uuid.uuid4().hex, committed=0, sent=0))
        return True

    def disable(self) -> None:
        """End the outbox, with all that waits in it."""
        if self._database.file is None:
            return
        with self._database.reading() as connection:
            present = [str(name) for name, _ in connection.execute(sa.text(_TRIGGERS))]
        if present:
            with self._database.writing() as connection:
                _drop_triggers(connection, present)
                connection.execute(sa.delete(outbox))
                connection.execute(sa.delete(outbox_position))

    def enabled(self) -> bool:
        """Return whether changes are written to the outbox."""
        with self._database.reading() as connection:
            return _is_begun(connection)

    def position(self) -> OutboxPosition:
        """Return the number up to which rows were sent and confirmed; the outbox has to be enabled."""
        with self._database.reading() as connection:
            return _read_position(connection)

    def waiting(self) -> int:
        """Return how many rows wait."""
        with self._database.reading() as connection:
            return connection.scalar(sa.select(sa.func.count()).select_from(outbox)) or 0

    def rows(self, *, most: int, most_bytes: int) -> tuple[FeedRow, ...]:
        """Return the next rows in their order: at most so many, and so many bytes, but at least one."""
        with self._database.reading() as connection:
            stored = _read_next_rows(connection, most, most_bytes)
        return _parse_rows(stored)

    def rows_to_send(self, position: OutboxPosition, *, most: int, most_bytes: int) -> tuple[FeedRow, ...] | None:
        """Return the next rows as `rows` does, and note that the hub may have them.

        Both in one transaction: the database may be put back to an earlier copy at any time, and must then not know of
        rows that only the copy's successor had.

        Returns
        -------
        The rows; None where the outbox does not stand at `position`.
        """
        with self._database.writing() as connection:
            if _read_position(connection) != position:
                return None
            stored = _read_next_rows(connection, most, most_bytes)
            if stored:
                c = outbox_position.c
                connection.execute(
                    sa.update(outbox_position).where(c.sent < stored[-1].seq).values(sent=stored[-1].seq)
                )
        return _parse_rows(stored)

    def queue_status(self, status: Mapping[str, Any]) -> None:
        """Queue the imager's own state, in place of one that was not sent yet."""
        with self._database.writing() as connection:
            sent = sa.select(outbox_position.c.sent).scalar_subquery()
            connection.execute(sa.delete(outbox).where(outbox.c.kind == STATUS, outbox.c.seq > sent))
            connection.execute(sa.insert(outbox).values(kind=STATUS, data=json_text(status)))

    def acknowledge(self, seq: int) -> bool:
        """Remove the rows up to a number, which the hub has stored; nothing where the hub lacks an earlier row.

        Returns
        -------
        Whether the number can be one that the hub was sent.
        """
        with self._database.writing() as connection:
            newest = connection.scalar(sa.select(sa.func.max(outbox.c.seq)).where(outbox.c.seq <= seq))
            if newest not in {None, seq} or seq > _read_position(connection).sent:
                return False
            connection.execute(sa.delete(outbox).where(outbox.c.seq <= seq))
            connection.execute(sa.update(outbox_position).values(committed=seq))
        return True

    def send_again(self, *, committed: int) -> None:
        """Queue all rows again: the hub has less than it once confirmed."""
        with self._database.writing() as connection:
            _queue_all(connection)
            connection.execute(sa.update(outbox_position).values(committed=committed))

    def digests(self, camera: str, *, since: date, until: date) -> DayDigests | None:
        """Return the digests of a camera's days where the hub was sent all rows; None while some wait."""
        with self._database.reading() as connection:
            if connection.scalar(sa.select(sa.func.count()).select_from(outbox)):
                return None
            return day_digests(connection, camera, since=since, until=until)

    def first_and_last_day(self, camera: str) -> tuple[date, date] | None:
        """Return the days of a camera's first and last sighting; None without any."""
        with self._database.reading() as connection:
            return first_and_last_day(connection, camera)

    def queue_days(self, camera: str, days: Iterable[tuple[str, date]]) -> int:
        """Queue again a camera's rows of kinds and days, after all that they refer to; return how many they are."""
        with self._database.writing() as connection:
            before = connection.scalar(sa.select(sa.func.count()).select_from(outbox)) or 0
            wanted = sorted(days, key=lambda one: (list(FED).index(one[0]), one[1]))
            if wanted:
                _queue_rows(connection, ("camera", "pose_epoch"))
            for kind, day in wanted:
                _queue_rows(connection, (kind,), day_condition(kind, camera, day))
            return (connection.scalar(sa.select(sa.func.count()).select_from(outbox)) or 0) - before

    def begin_installation(self, installation: str) -> None:
        """Begin a feed of its own with all rows, under an id: another one went on under the former id."""
        with self._database.writing() as connection:
            _queue_all(connection)
            _write_position(connection, OutboxPosition(installation=installation, committed=0, sent=0))


def _is_begun(connection: sa.Connection) -> bool:
    return connection.scalar(sa.select(sa.func.count()).select_from(outbox_position)) == 1


def _read_triggers(connection: sa.Connection) -> dict[str, str]:
    return {str(name): str(sql) for name, sql in connection.execute(sa.text(_TRIGGERS))}


def _read_position(connection: sa.Connection) -> OutboxPosition:
    return OutboxPosition(**connection.execute(sa.select(outbox_position)).mappings().one())


def _read_next_rows(connection: sa.Connection, most: int, most_bytes: int) -> list[sa.Row[Any]]:
    """Return the next rows as they are stored: at most so many, and so many bytes, but at least one."""
    found: list[sa.Row[Any]] = []
    size = 0
    for row in connection.execute(sa.select(outbox).order_by(outbox.c.seq).limit(most)):
        size += len(row.data)
        if found and size > most_bytes:
            break
        found.append(row)
    return found


def _parse_rows(stored: Iterable[sa.Row[Any]]) -> tuple[FeedRow, ...]:
    rows: list[FeedRow] = []
    for row in stored:
        values = parsed_json(row.data) or {}
        data = values if row.kind == STATUS else from_trigger(row.kind, values)
        rows.append(FeedRow(seq=row.seq, kind=row.kind, data=data))
    return tuple(rows)


def _write_position(connection: sa.Connection, position: OutboxPosition) -> None:
    connection.execute(sa.delete(outbox_position))
    values = {"installation": position.installation, "committed": position.committed, "sent": position.sent}
    connection.execute(sa.insert(outbox_position).values(values))


def _drop_triggers(connection: sa.Connection, names: Mapping[str, str] | list[str]) -> None:
    for name in names:
        connection.exec_driver_sql(f'DROP TRIGGER "{name}"')


def _queue_all(connection: sa.Connection) -> None:
    """Queue every row as it is now, in the order of the tables' references and in which rows were made."""
    connection.execute(sa.delete(outbox))
    _queue_rows(connection, FED)


def _queue_rows(connection: sa.Connection, kinds: Iterable[str], where: sa.ColumnElement[bool] | None = None) -> None:
    for kind in kinds:
        queued = (sa.literal_column(f"'{kind}'", sa.Text), sa.literal_column(_make_row_sql(kind, kind), sa.Text))
        rows = sa.select(*queued).select_from(FED[kind][0]).where(sa.true() if where is None else where)
        in_order = rows.order_by(sa.literal_column(f'"{kind}".rowid'))
        connection.execute(sa.insert(outbox).from_select(["kind", "data"], in_order))


def outbox_triggers() -> Iterator[tuple[str, str]]:
    """Yield the triggers that queue changed rows, each with its name and its SQL."""
    for kind, (_, key) in FED.items():
        changed = " OR ".join(
            f'OLD."{column.name}" IS NOT NEW."{column.name}"' for column in sent_columns(kind).values()
        )
        moved = " OR ".join(f'OLD."{name}" IS NOT NEW."{name}"' for name in key)
        stored = f"INSERT INTO outbox (kind, data) VALUES ('{kind}', {_make_row_sql(kind, 'NEW')});"  # noqa: S608 - constants
        removed = f"INSERT INTO outbox (kind, data) SELECT '{kind}{REMOVED}', {_make_row_sql(kind, 'OLD', only=key)}"
        for event, condition, actions in (
            ("insert", "", stored),
            ("update", f"WHEN {changed} ", f"{removed} WHERE {moved}; {stored}"),
            ("delete", "", f"{removed};"),
        ):
            name = f"outbox_{kind}_{event}"
            yield name, f'CREATE TRIGGER "{name}" AFTER {event.upper()} ON "{kind}" {condition}BEGIN {actions} END'


def _list_trigger_names(kind: str) -> set[str]:
    """Return the names of a table's triggers."""
    return {f"outbox_{kind}_{event}" for event in _CHANGES}


def _make_row_sql(kind: str, row: str, *, only: tuple[str, ...] | None = None) -> str:
    """Return the expression of a row's JSON object."""
    columns = [column for column in sent_columns(kind).values() if only is None or column.name in only]
    pairs = chain.from_iterable((f"'{column.name}'", _make_column_sql(column, f'"{row}"')) for column in columns)
    return f"json_object({', '.join(pairs)})"


def _make_column_sql(column: sa.Column[Any], row: str) -> str:
    """Return the expression of a column in a row; it fails with no value, or the change itself would fail."""
    kind, value = plain_type(column), f'{row}."{column.name}"'
    if isinstance(kind, sa.Float):
        return f"quote({value})"  # SQLite's JSON has 15 digits, its literals have all
    return f"CAST({value} AS {'TEXT' if isinstance(kind, sa.Text | sa.JSON | sa.Date) else 'INTEGER'})"
