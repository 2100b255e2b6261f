"""Manual decisions on calibrations: reinstate, pin, unpin."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import replace
from datetime import datetime
from types import MappingProxyType
from typing import Any, Literal

from sqlalchemy import Connection, func, insert, select

from sunarc.archive.calibration_inputs import copy_used
from sunarc.archive.calibrations import Calibrations
from sunarc.archive.days_and_events import insert_event
from sunarc.archive.documents import row_of
from sunarc.archive.messages import MESSAGES
from sunarc.archive.tables import calibration
from sunarc.archive.validity import SERVED, end_others, set_columns, with_interval, wrong_state
from sunarc.archive.values import CalibrationRecord, Event
from sunarc.findings import Finding
from sunarc.utc import rfc3339

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
