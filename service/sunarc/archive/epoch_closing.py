"""Closing a pose epoch that was opened by mistake, and serving again what was served before it."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import replace
from datetime import datetime
from itertools import pairwise
from types import MappingProxyType
from typing import Any, Literal

from sqlalchemy import Connection, func, insert, select, update

from sunarc.archive.calibration_inputs import copy_used
from sunarc.archive.calibrations import Calibrations
from sunarc.archive.days_and_events import insert_event
from sunarc.archive.documents import row_of
from sunarc.archive.messages import MESSAGES
from sunarc.archive.sighting_revisions import ELSEWHERE, MOVED
from sunarc.archive.sightings import not_closed
from sunarc.archive.store import values_of
from sunarc.archive.tables import calibration, pose_epoch, sun_point
from sunarc.archive.validity import SERVED, end_others, set_columns, with_interval, wrong_state
from sunarc.archive.values import CalibrationRecord, Event, PoseEpoch
from sunarc.errors import InputError, NotFoundError
from sunarc.findings import Finding
from sunarc.utc import rfc3339

# Manual decisions on calibrations: reinstate, pin, unpin.

_COPY = re.compile(r"-r\d+$")


class History(Calibrations):
    """The part of the archive with manual decisions; each is also an event."""

    def reinstate(self, calibration_id: str, *, at: datetime, reason: str) -> CalibrationRecord:
        """Make any calibration of the record current by hand, whatever is current or pinned.

        Parameters
        ----------
        calibration_id : a candidate or a refused one, which takes its own place in the history; or one that answered
            before, of which a copy takes over (its `parent` is the one copied), so that no past answer is rewritten.
        at : from when on it answers.
        reason : why, in words; kept with the calibration and in the event.
        """
        with self._writing() as connection:
            record = self._required(connection, calibration_id)
            if record.state == "current":
                raise wrong_state(calibration_id, "is current already", remedy="name another one")
            findings = (Finding("activated_by_operator", {"reason": reason}), *record.findings)
            end_others(connection, record.camera, at)
            if record.state in SERVED:
                reinstated = add_copy(connection, record, at=at, findings=findings)
            else:
                decided: dict[str, Any] = {"state": "current", "valid_from": at, "valid_until": None}
                set_columns(connection, record.id, **decided, findings=findings)
                reinstated = replace(record, **decided, findings=findings)
            copied = reinstated.parent if record.state in SERVED else None
            found = Finding("calibration_reinstated", {"calibration": reinstated.id, "reason": reason})
            store_decision(connection, found, at=at, camera=reinstated.camera, details={"copied": copied})
        return with_interval(reinstated)

    def pin(self, calibration_id: str, *, at: datetime, reason: str) -> CalibrationRecord:
        """Keep the current calibration, whatever a refit finds, until it is unpinned or another is reinstated."""
        return self._hold(calibration_id, "pinned", at=at, reason=reason)

    def unpin(self, calibration_id: str, *, at: datetime, reason: str) -> CalibrationRecord:
        """Allow refits to replace the current calibration."""
        return self._hold(calibration_id, "unpinned", at=at, reason=reason)

    def _hold(
        self, calibration_id: str, what: Literal["pinned", "unpinned"], *, at: datetime, reason: str
    ) -> CalibrationRecord:
        with self._writing() as connection:
            record = self._required(connection, calibration_id)
            if record.state != "current":
                raise wrong_state(calibration_id, f"is {record.state}", remedy="name the current one")
            changed = replace(record, pinned=what == "pinned")
            set_columns(connection, record.id, pinned=changed.pinned)
            found = Finding(f"calibration_{what}", {"calibration": record.id, "reason": reason})
            store_decision(connection, found, at=at, camera=record.camera)
        return with_interval(changed)


def add_copy(
    connection: Connection, record: CalibrationRecord, *, at: datetime, findings: tuple[Finding, ...]
) -> CalibrationRecord:
    """Store a copy of a calibration that answered before, current from `at` on, with the same sightings."""
    copy = _copy(record, id=_name_of_copy(connection, record.id), at=at, findings=findings)
    connection.execute(insert(calibration).values(row_of(copy)))
    copy_used(connection, record.id, to=copy.id)
    return copy


def _copy(record: CalibrationRecord, *, id: str, at: datetime, findings: tuple[Finding, ...]) -> CalibrationRecord:  # noqa: A002 - the field's name
    document: Mapping[str, Any] = {**record.document, "id": id, "created_at": rfc3339(at)}
    return replace(
        record,
        id=id,
        created_at=at,
        valid_from=at,
        valid_until=None,
        state="current",
        pinned=False,
        parent=record.id,
        findings=findings,
        document=document,
    )


def _name_of_copy(connection: Connection, calibration_id: str) -> str:
    original = _COPY.sub("", calibration_id)
    copies = select(func.count()).where(calibration.c.id.startswith(f"{original}-r", autoescape=True))
    return f"{original}-r{(connection.scalar(copies) or 0) + 1}"


def store_decision(
    connection: Connection,
    found: Finding,
    *,
    at: datetime,
    camera: str,
    details: Mapping[str, Any] = MappingProxyType({}),
) -> None:
    """Store the event of a decision in the transaction that carries it out."""
    insert_event(connection, Event.of(found, MESSAGES, time=at, severity="info", camera=camera, details=details))


EPOCH_CLOSED = "epoch_closed"
"""Kind of the event of a pose epoch that was closed as wrong."""


class EpochClosing(History):
    """The part of the archive that closes pose epochs opened by mistake."""

    def close_epoch(self, epoch_id: str, *, at: datetime, reason: str) -> str | None:
        """Undo a pose epoch: the one before it continues, and the calibration served before is current again.

        The epoch's row stays, with a duration of 0. Its sightings move to the epoch before; those that were accepted
        only because of the supposed move are rejected again. Its calibrations stop answering at `at`.

        Parameters
        ----------
        epoch_id : any pose epoch but the camera's first.
        at : now; no answer given for an earlier time changes.
        reason : why, in words; kept in the event.

        Returns
        -------
        The id of the calibration that is current afterwards; None where none was served before.

        Raises
        ------
        NotFoundError : there is no such pose epoch, or it is closed already.
        InputError : it is the camera's first.
        """
        with self._writing() as connection:
            wrong, before = _with_the_one_before(connection, epoch_id)
            _join(connection, wrong, before)
            current = self._serve_again(connection, wrong, at=at, reason=reason)
            data = {"pose_epoch": wrong.id, "started_at": wrong.started_at.isoformat(), "reason": reason}
            details = {"continues": before.id, "calibration": current}
            store_decision(connection, Finding(EPOCH_CLOSED, data), at=at, camera=wrong.camera, details=details)
        return current

    def _serve_again(self, connection: Connection, wrong: PoseEpoch, *, at: datetime, reason: str) -> str | None:
        """Make the calibration that was served before an epoch current again, and return the id of the current one."""
        c = calibration.c
        current = self._records(connection, c.camera == wrong.camera, c.state == "current")
        if current and current[0].pose_epoch != wrong.id:
            return current[0].id
        answered = self._records(connection, *self._may_stand_in(connection, wrong.camera, until=at))
        undamaged = [record for record in answered if not record.damaged]
        end_others(connection, wrong.camera, at)
        if not undamaged:
            return None
        last = max(undamaged, key=lambda record: (record.valid_from, record.created_at))
        if last.valid_until is None or last.valid_until > at:  # it still answers: nothing else ever did
            set_columns(connection, last.id, state="current", valid_until=None)
            return last.id
        again = Finding("served_again", {"reason": reason})
        return add_copy(connection, last, at=at, findings=(again, *last.findings)).id


def _with_the_one_before(connection: Connection, epoch_id: str) -> tuple[PoseEpoch, PoseEpoch]:
    epochs = pose_epoch.c
    in_order = values_of(connection, select(pose_epoch).where(not_closed()).order_by(epochs.started_at), PoseEpoch)
    camera = next((epoch.camera for epoch in in_order if epoch.id == epoch_id), None)
    if camera is None:
        raise NotFoundError(
            field="id", problem=f"there is no open pose epoch {epoch_id}", remedy="see `sunarc epochs list`"
        )
    for before, wrong in pairwise(epoch for epoch in in_order if epoch.camera == camera):
        if wrong.id == epoch_id:
            return wrong, before
    raise InputError(
        field="id", problem=f"{epoch_id} is the camera's first pose epoch", remedy="name one that followed another"
    )


def _join(connection: Connection, wrong: PoseEpoch, before: PoseEpoch) -> None:
    """End an epoch where it began, and extend the one before it over its time and its sightings."""
    epochs, c = pose_epoch.c, sun_point.c
    # The row stays, of no duration: its id is never given again, and the event can still name it.
    connection.execute(update(pose_epoch).where(epochs.id == wrong.id).values(ended_at=wrong.started_at))
    connection.execute(update(pose_epoch).where(epochs.id == before.id).values(ended_at=wrong.ended_at))
    admitted = update(sun_point).where(c.pose_epoch == wrong.id, c.reason == MOVED, c.accepted.is_(True))
    connection.execute(admitted.values(accepted=False, verdict=ELSEWHERE, reason="not where it should be"))
    connection.execute(update(sun_point).where(c.pose_epoch == wrong.id).values(pose_epoch=before.id))
