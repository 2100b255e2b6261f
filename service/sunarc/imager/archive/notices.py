"""Notices: messages for receivers about cameras, kept in the store until every receiver has them."""

from __future__ import annotations

import uuid
from collections.abc import Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from datetime import datetime
from typing import Any, Literal, NamedTuple

from pydantic import TypeAdapter
from sqlalchemy import ColumnElement, Connection, delete, func, insert, select, update

from sunarc.imager.archive.database.store import Part, insert_new, read_records, upsert
from sunarc.imager.archive.database.tables import calibration, event, notice, notice_position, notice_sink
from sunarc.imager.archive.values import Event

NoticeKind = Literal["calibration", "bump", "day", "event", "condition_set", "condition_cleared"]
_OWN_KINDS = ("bump", "day")
"""Kinds of events that are kinds of notices too."""
_EVENT = TypeAdapter(Event)
_MOST_EVENTS = 500
"""Events of one camera that are taken at once; the others at the next time."""


class StoreChange(NamedTuple):
    """Something that is new in the store, and the newest event's number and the current calibration after it."""

    kind: NoticeKind
    data: Mapping[str, Any]
    event: int
    calibration: str


@dataclass(frozen=True, slots=True, kw_only=True)
class Notice:
    """A message for receivers.

    Attributes
    ----------
    seq : its number; they rise.
    id : unique, and the same however often it is sent.
    camera, time, kind, data : whose, when, and what, as in the stream of events.
    """

    seq: int
    id: str
    camera: str
    time: datetime
    kind: NoticeKind
    data: Mapping[str, Any]


@dataclass(frozen=True, slots=True, kw_only=True)
class SinkState:
    """State of a receiver: the messages that it was sent, and those that it refused.

    Attributes
    ----------
    seq : it has all up to this number, but for what it refused.
    waiting : so many are to be sent.
    refused : so many it refused; they are not sent again.
    """

    seq: int
    waiting: int
    refused: int


@dataclass(frozen=True, slots=True, kw_only=True)
class CameraState:
    """State of a camera in messages to receivers.

    Attributes
    ----------
    health : "ready", "degraded", "not_ready"; at a hub also "silent", "quarantine", "uncalibrated".
    state, state_text : the state in one word (`runtime/states.py`), and the sentence of what decides it.
    conditions : the data of what is set, by code.
    calibration, calibrated_at, sky_rms_deg : the current one, when it was made, and its 1-sigma over the sky.
    """

    health: str
    state: str
    state_text: str
    conditions: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    calibration: str | None = None
    calibrated_at: datetime | None = None
    sky_rms_deg: float | None = None


def stored_changes(events: Iterable[Event], current: str, *, after_event: int, known: str) -> Iterator[StoreChange]:
    """Yield the changes of the store, events in their order and then the calibration.

    Parameters
    ----------
    events : those after the number `after_event`, the oldest first.
    current, known : id of the current calibration, and of the one that is known; empty without one.
    """
    number = after_event
    for one in events:
        number = one.id or number
        kind: Any = one.kind if one.kind in _OWN_KINDS else "event"
        yield StoreChange(kind, _EVENT.dump_python(one, mode="json"), number, known)
    if current != known:
        yield StoreChange("calibration", {"calibration": current or None, "previous": known or None}, number, current)


class NoticeStore(Part):
    """Store of the messages for receivers."""

    def name_sinks(self, names: Collection[str]) -> None:
        """Serve these receivers and no others: a new one gets the events from now on; former ones are removed.

        Parameters
        ----------
        names : of the receivers.
        """
        with self._database.writing() as connection:
            connection.execute(delete(notice_sink).where(notice_sink.c.sink.not_in(names)))
            last = connection.scalar(select(func.max(notice.c.seq))) or 0
            rows = [{"sink": name, "seq": last, "refused": 0} for name in names]
            if rows:
                insert_new(connection, notice_sink, rows)
            else:
                connection.execute(delete(notice))
                connection.execute(delete(notice_position))

    def record(
        self,
        camera: str,
        conditions: Mapping[str, Mapping[str, Any]],
        *,
        now: datetime,
        clears: bool = True,
    ) -> Mapping[str, Mapping[str, Any]]:
        """Store notices of a camera's changes since the last call, with the position, in one transaction.

        The first call of a camera stores none: what was before is no news. Nor are events of before it that are
        stored later, as a hub's of the years before a camera joined it.

        Parameters
        ----------
        camera : its name.
        conditions : the data of what is set, by code.
        now : real time.
        clears : whether a condition that is not there has ended; not while a service starts and does not know yet.

        Returns
        -------
        The conditions that hold: with those that have not ended.
        """
        look = _PresentState(camera, conditions, now, clears)
        with self._database.reading() as connection:
            position = _read_position(connection, camera)
            if position is not None and _make_new_notices(connection, position, look)[1] == position:
                return position.conditions
        with self._database.writing(camera=camera) as connection:
            # Read again under the lock: another process may have stored what is new since; a notice is stored once.
            position, rows = _read_position(connection, camera), list[dict[str, Any]]()
            if position is None:
                position = _NoticePosition(
                    _last_event(connection, camera), _read_current_calibration(connection, camera), conditions, now
                )
            else:
                rows, position = _make_new_notices(connection, position, look)
            if rows:
                connection.execute(insert(notice), rows)
            upsert(connection, notice_position, {"camera": camera, **position._asdict()}, key=["camera"])
        return position.conditions

    def after(self, sink: str, *, limit: int) -> tuple[Notice, ...]:
        """Return the next notices that a receiver has not had, in their order."""
        seq = select(notice_sink.c.seq).where(notice_sink.c.sink == sink).scalar_subquery()
        return self._database.records(
            select(notice).where(notice.c.seq > seq).order_by(notice.c.seq).limit(limit), Notice
        )

    def done(self, sink: str, seq: int, *, refused: bool = False) -> None:
        """Store that a receiver has the notices up to a number, or has refused the last of them for good."""
        c = notice_sink.c
        with self._database.writing() as connection:
            values = {"seq": seq, "refused": c.refused + int(refused)}
            connection.execute(update(notice_sink).where(c.sink == sink, c.seq < seq).values(values))

    def drop(self, *, most: int) -> int:
        """Remove the notices that every receiver has, and the oldest beyond so many; return how many those were."""
        # Read first, so that nothing to remove takes no write lock; what is delivered between counts as lost.
        with self._database.reading() as connection:
            done = connection.scalar(select(func.min(notice_sink.c.seq))) or 0
            last = connection.scalar(select(func.max(notice.c.seq))) or 0
            first = connection.scalar(select(func.min(notice.c.seq))) or last + 1
        until = max(done, last - most)
        if first > until:
            return 0
        with self._database.writing() as connection:
            lost = connection.execute(delete(notice).where(notice.c.seq <= until, notice.c.seq > done)).rowcount
            connection.execute(delete(notice).where(notice.c.seq <= until))
        return lost

    def sink_states(self) -> Mapping[str, SinkState]:
        """Return how each receiver stands, by its name."""
        waiting = select(func.count()).where(notice.c.seq > notice_sink.c.seq).scalar_subquery()
        with self._database.reading() as connection:
            rows = connection.execute(select(notice_sink, waiting.label("waiting")).order_by(notice_sink.c.sink)).all()
        return {row.sink: SinkState(seq=row.seq, waiting=row.waiting, refused=row.refused) for row in rows}


class _NoticePosition(NamedTuple):
    """Up to where a camera's notices are stored; `since` is the first moment of which there are any."""

    event: int
    calibration: str
    conditions: Mapping[str, Mapping[str, Any]]
    since: datetime


class _PresentState(NamedTuple):
    """Present state of a camera; see `NoticeStore.record`."""

    camera: str
    conditions: Mapping[str, Mapping[str, Any]]
    now: datetime
    clears: bool


def _read_position(connection: Connection, camera: str) -> _NoticePosition | None:
    row = connection.execute(select(notice_position).where(notice_position.c.camera == camera)).one_or_none()
    return None if row is None else _NoticePosition(row.event, row.calibration, row.conditions, row.since)


def _last_event(connection: Connection, camera: str) -> int:
    return int(connection.scalar(select(func.max(event.c.id)).where(_camera_condition(camera))) or 0)


def _camera_condition(camera: str) -> ColumnElement[bool]:
    return (event.c.camera == camera) | event.c.camera.is_(None)


def _read_current_calibration(connection: Connection, camera: str) -> str:
    c = calibration.c
    return str(connection.scalar(select(c.id).where(c.camera == camera, c.state == "current")) or "")


def _make_new_notices(
    connection: Connection, position: _NoticePosition, look: _PresentState
) -> tuple[list[dict[str, Any]], _NoticePosition]:
    """Return the rows of new notices, and the position after them."""
    camera, conditions, now, clears = look
    following = select(event).where(_camera_condition(camera), event.c.id > position.event).order_by(event.c.id)
    events = read_records(connection, following.limit(_MOST_EVENTS), Event)
    times = {one.id: one.time for one in events}
    rows: list[dict[str, Any]] = []
    reached = position
    current = _read_current_calibration(connection, camera)
    for change in stored_changes(events, current, after_event=position.event, known=position.calibration):
        time = now if change.kind == "calibration" else times[change.event]
        reached = reached._replace(event=change.event, calibration=change.calibration)
        if time >= position.since:
            rows.append(_make_notice_row(camera, time, change.kind, change.data))
    ended = {} if clears else position.conditions
    # what is set keeps the data that it was set with: its numbers change all the time
    held = {**ended, **{code: position.conditions.get(code, data) for code, data in conditions.items()}}
    rows += [_make_notice_row(camera, now, kind, data) for kind, data in condition_changes(position.conditions, held)]
    return rows, reached._replace(conditions=held)


def _make_notice_row(camera: str, time: datetime, kind: str, data: Mapping[str, Any]) -> dict[str, Any]:
    return {"id": uuid.uuid4().hex, "camera": camera, "time": time, "kind": kind, "data": dict(data)}


def condition_changes(
    before: Mapping[str, Mapping[str, Any]], now: Mapping[str, Mapping[str, Any]]
) -> Iterator[tuple[NoticeKind, Mapping[str, Any]]]:
    """Yield the conditions that were set and those that ended, with their data by code."""
    for code in sorted(now.keys() - before.keys()):
        yield ("condition_set", now[code])
    for code in sorted(before.keys() - now.keys()):
        yield ("condition_cleared", before[code])
