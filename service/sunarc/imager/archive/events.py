"""Refits, events, conditions, disk space and temperatures."""

from __future__ import annotations

import logging
from collections.abc import Iterable, Mapping
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from typing import get_args

from sqlalchemy import Connection, and_, delete, func, insert, or_, select, update

from sunarc.common.errors import ConflictError, NotFoundError
from sunarc.common.findings import Finding
from sunarc.common.utc import rfc3339
from sunarc.imager.archive.database import tables
from sunarc.imager.archive.database.store import Part, given, read_records, upsert
from sunarc.imager.archive.database.tables import condition, housekeeping, refit
from sunarc.imager.archive.values import (
    ACKNOWLEDGED_AT,
    ACKNOWLEDGED_BECAUSE,
    Event,
    EventSeverity,
    Housekeeping,
    HousekeepingStep,
    Refit,
    RefitState,
    field_values,
    merged,
)

_log = logging.getLogger(__name__)
_LEVELS = {"info": logging.INFO, "warning": logging.WARNING, "alarm": logging.ERROR}


class RefitStore(Part):
    """The refits."""

    def count(self, camera: str) -> Mapping[str, int]:
        """Return how many refits are in each state."""
        return self._database.counts(select(refit.c.state, func.count()).where(refit.c.camera == camera), refit.c.state)

    def add(self, refit: Refit) -> Refit:
        """Store a refit that was requested, or has begun."""
        with self._database.writing() as connection:
            connection.execute(insert(tables.refit).values(field_values(refit)))
        return refit

    def request(self, refit: Refit) -> Refit:
        """Store a requested refit, or return the camera's earlier one that still waits.

        One that has not begun yet will see every sighting that this one would: there is never more than one of them,
        request while one runs.
        """
        c = tables.refit.c
        waiting = select(tables.refit).where(c.camera == refit.camera, c.state == "requested", c.finished_at.is_(None))
        # Read under the write lock: two requests at once would otherwise both find nothing.
        with self._database.writing() as connection:
            found = read_records(connection, waiting.order_by(c.requested_at, c.id).limit(1), Refit)
            if found:
                return found[0]
            connection.execute(insert(tables.refit).values(field_values(refit)))
        return refit

    def start(self, refit_id: str, *, started_at: datetime) -> Refit:
        """Store that a refit has begun."""
        return self._update_refit(refit_id, state="running", started_at=started_at)

    def finish(
        self,
        refit_id: str,
        *,
        state: RefitState,
        finished_at: datetime,
        calibration: str | None = None,
        message: str = "",
        findings: tuple[Finding, ...] = (),
    ) -> Refit:
        """Store how a refit ended, and the calibration it made (accepted or refused)."""
        return self._update_refit(
            refit_id,
            state=state,
            finished_at=finished_at,
            calibration=calibration,
            message=message,
            findings=findings,
        )

    def get(self, refit_id: str) -> Refit:
        """Return a refit by its id; NotFoundError for an unknown id."""
        found = self._database.records(select(tables.refit).where(tables.refit.c.id == refit_id), Refit)
        if not found:
            raise NotFoundError(field="id", problem=f"there is no refit {refit_id}", remedy="use an id that was given")
        return found[0]

    def find(
        self, camera: str, *, unfinished: bool = False, until: datetime | None = None, limit: int | None = None
    ) -> tuple[Refit, ...]:
        """Return a camera's refits asked for before `until`, the newest first; those that have not ended, if asked."""
        c = tables.refit.c
        filters = given((c.camera.__eq__, camera), (c.requested_at.__lt__, until))
        statement = select(tables.refit).where(*filters).order_by(c.requested_at.desc(), c.id.desc()).limit(limit)
        return self._database.records(statement.where(c.finished_at.is_(None)) if unfinished else statement, Refit)

    def _update_refit(self, refit_id: str, **columns: object) -> Refit:
        self.get(refit_id)
        this_refit = tables.refit.c.id == refit_id
        with self._database.writing() as connection:
            connection.execute(update(tables.refit).where(this_refit).values(**columns))
            return read_records(connection, select(tables.refit).where(this_refit), Refit)[0]


class EventStore(Part):
    """The events."""

    def add(self, event: Event) -> Event:
        """Store an event, log it, and return it with its id."""
        with self._database.writing() as connection:
            stored = insert_event(connection, event)
        log_event(stored)
        return stored

    def find(
        self,
        camera: str | None = None,
        *,
        since: datetime | None = None,
        until: datetime | None = None,
        severity: EventSeverity | None = None,
        kind: str | None = None,
        to_acknowledge: bool = False,
        limit: int | None = None,
    ) -> tuple[Event, ...]:
        """Return the events with `since` <= time < `until`, the newest first; None does not filter.

        With `to_acknowledge`, those alone that an operator has to acknowledge.
        """
        c = tables.event.c
        of_camera = [] if camera is None else [(c.camera == camera) | c.camera.is_(None)]
        filters = given((c.time.__ge__, since), (c.time.__lt__, until), (c.severity.__eq__, severity))
        filters += given((c.kind.__eq__, kind))
        statement = select(tables.event).where(*of_camera, *filters).order_by(c.time.desc(), c.id.desc())
        if not to_acknowledge:
            return self._database.records(statement.limit(limit), Event)
        alarms = self._database.records(statement.where(c.severity == "alarm"), Event)
        return tuple(event for event in alarms if event.to_acknowledge)[:limit]

    def count_alarms(self, camera: str) -> Mapping[str, int]:
        """Return how many alarms of each kind a camera had."""
        c = tables.event.c
        counts = select(c.kind, func.count()).where(c.camera == camera, c.severity == "alarm")
        return self._database.counts(counts, c.kind)

    def get(self, camera: str, event_id: int) -> Event:
        """Return an event of a camera by its number; NotFoundError where it is no event of this camera."""
        with self._database.reading() as connection:
            return _read_event(connection, camera, event_id)

    def acknowledge(self, camera: str, event_id: int, *, at: datetime, reason: str) -> Event:
        """Note that an operator has acknowledged an event, and return it.

        Raises
        ------
        NotFoundError
            It is no event of this camera.
        ConflictError
            It needs no acknowledgement, or has one.
        """
        with self._database.writing() as connection:
            found = _read_event(connection, camera, event_id)
            if not found.to_acknowledge:
                before = found.details.get(ACKNOWLEDGED_AT)
                problem = (
                    f"was acknowledged at {before}" if before else f"of kind {found.kind} needs no acknowledgement"
                )
                remedy = "see /v1/events?to_acknowledge=true for those that do"
                raise ConflictError(field="id", problem=f"event {event_id} {problem}", remedy=remedy)
            return _acknowledge(connection, found, at=at, reason=reason)

    def last_id(self) -> int:
        """Return the number of the newest event of all cameras; 0 without one."""
        with self._database.reading() as connection:
            return int(connection.scalar(select(func.max(tables.event.c.id))) or 0)

    def after(self, event_id: int, *, camera: str, limit: int) -> tuple[Event, ...]:
        """Return a camera's events that were stored after another one, the oldest first; of many the newest ones."""
        c = tables.event.c
        of_camera = (c.camera == camera) | c.camera.is_(None)
        newest = select(tables.event).where(of_camera, c.id > event_id).order_by(c.id.desc()).limit(limit)
        return self._database.records(newest, Event)[::-1]


def _read_event(connection: Connection, camera: str, event_id: int) -> Event:
    c = tables.event.c
    of_camera = (c.camera == camera) | c.camera.is_(None)
    found = read_records(connection, select(tables.event).where(c.id == event_id, of_camera), Event)
    if not found:
        problem = f"there is no event {event_id} of camera {camera}"
        raise NotFoundError(field="id", problem=problem, remedy="see /v1/events for those that there are")
    return found[0]


def _acknowledge(connection: Connection, event: Event, *, at: datetime, reason: str) -> Event:
    details = {**event.details, ACKNOWLEDGED_AT: rfc3339(at), ACKNOWLEDGED_BECAUSE: reason}
    connection.execute(update(tables.event).where(tables.event.c.id == event.id).values(details=details))
    return replace(event, details=details)


def acknowledge_at(connection: Connection, camera: str, time: datetime, *, at: datetime, reason: str) -> None:
    """Acknowledge, within a transaction, the open events of a camera and a time."""
    c = tables.event.c
    for event in read_records(connection, select(tables.event).where(c.camera == camera, c.time == time), Event):
        if event.to_acknowledge:
            _acknowledge(connection, event, at=at, reason=reason)


def log_event(stored: Event) -> None:
    """Log an event that is stored."""
    shared = {"event_id": stored.id, "event_kind": stored.kind}  # what the journal's line has of /v1/events
    _log.log(_LEVELS[stored.severity], "%s: %s", stored.kind, stored.text, extra=shared)


def insert_event(connection: Connection, event: Event) -> Event:
    """Store an event in a transaction, and return it with its id."""
    row = field_values(event)
    row.pop("id")
    key = connection.execute(insert(tables.event).values(row)).inserted_primary_key
    return replace(event, id=None if key is None else int(key[0]))


class ConditionStore(Part):
    """The conditions that held when they were last stored."""

    def times(self, camera: str) -> Mapping[str, datetime]:
        """Return since when the stored conditions of a camera's service hold, by code; "" is the hub's own."""
        with self._database.reading() as connection:
            rows = connection.execute(select(condition.c.code, condition.c.since).where(condition.c.camera == camera))
            return {str(code): since for code, since in rows if since is not None}

    def replace_since(self, camera: str, times: Mapping[str, datetime]) -> None:
        """Replace all stored times since when conditions of a camera's service hold, by code; "" is the hub's own."""
        rows = [{"camera": camera, "code": code, "since": since} for code, since in times.items()]
        with self._database.writing() as connection:
            connection.execute(delete(condition).where(condition.c.camera == camera))
            if rows:
                connection.execute(insert(condition), rows)


_KEPT: dict[HousekeepingStep, timedelta] = {"hour": timedelta(days=92), "day": timedelta(days=5 * 366)}
_COLUMNS = [column for column in housekeeping.c if column.name not in {"camera", "step"}]


class HousekeepingStore(Part):
    """Disk space and temperatures."""

    def add(self, camera: str, measured: Iterable[Housekeeping]) -> None:
        """Add measurements to the stored ones of their hour and their UTC day, in one transaction.

        Parameters
        ----------
        camera : its name; it need not have answered yet.
        measured : each within one hour.
        """
        with self._database.writing(camera=camera) as connection:
            for one in measured:
                for step in get_args(HousekeepingStep):
                    _add_measurement(connection, camera, step, one)

    def find(
        self, camera: str, *, step: HousekeepingStep, since: datetime | None = None, until: datetime | None = None
    ) -> tuple[Housekeeping, ...]:
        """Return the hours or days that begin with `since` <= time < `until`, the newest first."""
        c = housekeeping.c
        filters = given((c.time.__ge__, since), (c.time.__lt__, until))
        statement = select(*_COLUMNS).where(c.camera == camera, c.step == step, *filters).order_by(c.time.desc())
        return self._database.records(statement, Housekeeping)

    def expire(self, camera: str, *, now: datetime) -> int:
        """Remove a camera's hours older than 92 days and days older than 1830, and return how many."""
        c = housekeeping.c
        old = or_(*(and_(c.step == step, c.time < now - kept) for step, kept in _KEPT.items()))
        with self._database.writing(camera=camera) as connection:
            return connection.execute(delete(housekeeping).where(c.camera == camera, old)).rowcount


def _add_measurement(connection: Connection, camera: str, step: HousekeepingStep, measured: Housekeeping) -> None:
    c, time = housekeeping.c, _start_of_step(measured.time, step)
    this = (c.camera == camera, c.step == step, c.time == time)
    stored = read_records(connection, select(*_COLUMNS).where(*this), Housekeeping)
    total = merged(measured, stored[0] if stored else Housekeeping(time=time), time=time)
    upsert(
        connection,
        housekeeping,
        {"camera": camera, "step": step, **field_values(total)},
        key=["camera", "step", "time"],
    )


def _start_of_step(time: datetime, step: HousekeepingStep) -> datetime:
    """Return the beginning of the hour or the UTC day of a time."""
    hour = time.astimezone(UTC).replace(minute=0, second=0, microsecond=0)
    return hour if step == "hour" else hour.replace(hour=0)
