"""Calibrations: candidates, the current one, the history of their validity, and decisions by hand."""

from __future__ import annotations

import logging
import re
from collections.abc import Mapping
from dataclasses import replace
from datetime import datetime
from functools import lru_cache
from itertools import pairwise
from types import MappingProxyType
from typing import Any, Literal

from sqlalchemy import ColumnElement, Connection, and_, func, insert, not_, or_, select, update

from sunarc.calibration.model.result import Calibration
from sunarc.common.errors import InputError, NotFoundError
from sunarc.common.findings import Finding, parse_findings
from sunarc.common.utc import rfc3339
from sunarc.formats.calibration_document import from_document
from sunarc.imager.archive.calibration_rows import (
    DAMAGED,
    SERVED,
    Documents,
    apply_row_interval,
    clear_interval,
    end_others,
    read_document,
    record_columns,
    set_columns,
    wrong_state,
)
from sunarc.imager.archive.columns import copy_used, keep_used, sightings_used_by
from sunarc.imager.archive.database.store import Database, Part, given, read_records
from sunarc.imager.archive.database.tables import calibration, pose_epoch, sun_point
from sunarc.imager.archive.epochs import LENS_CHANGED, not_closed
from sunarc.imager.archive.events import acknowledge_at, insert_event
from sunarc.imager.archive.pictures_of_one_time import ELSEWHERE
from sunarc.imager.archive.sightings import MOVED
from sunarc.imager.archive.values import (
    ACTIVATED_BY_OPERATOR,
    CalibrationRecord,
    CalibrationState,
    Event,
    PoseEpoch,
    SunPointColumns,
)

_log = logging.getLogger(__name__)
_MOST_PARSED = 8
PROVISIONAL = "-pose"
"""Part of the id of a pose that was estimated before a fit."""
_FIELDS = ("id", "camera", "method", "pose_epoch")


class CalibrationStore(Part):
    """The calibrations, which are never deleted; each decision by hand is also an event."""

    def __init__(self, database: Database) -> None:
        super().__init__(database)
        self._documents = Documents()
        self._current: dict[str, tuple[int, CalibrationRecord | None]] = {}
        self._parse = lru_cache(_MOST_PARSED)(self._parse_stored)

    def add(
        self, document: Mapping[str, Any], *, parent: str | None = None, used: SunPointColumns | None = None
    ) -> CalibrationRecord:
        """Keep a calibration document, as a candidate (accepted or marginal) or as refused, by its verdict.

        Parameters
        ----------
        document : schema sunarc.calibration/2; `state` and validity in it are those of the archive from now on.
        parent : the id of the calibration that it was compared with, or copied from.
        used : the sightings that it was given, in the order of time; None where the archive does not have them.
        """
        record = _make_record(document, parent)
        with self._database.writing() as connection:
            if self._exists(connection, record.id):
                raise wrong_state(record.id, "is there already", remedy="give it an id of its own")
            connection.execute(insert(calibration).values(record_columns(record)))
            if used is not None:
                keep_used(connection, record.camera, record.id, used)
        return apply_row_interval(record)

    def activate(self, calibration_id: str, *, at: datetime | None = None) -> CalibrationRecord:
        """Make a candidate the current calibration of its camera, in one step, unless the current one is pinned.

        Parameters
        ----------
        calibration_id : a candidate.
        at : from when on it answers; its document's `valid_from` where None. Those that answered for times from then
            on stop doing so: the former current one retires, and no two validities overlap.

        Returns
        -------
        The current one; or the candidate as it was, where the current one is pinned.
        """
        with self._database.writing() as connection:
            record = self._require_record(connection, calibration_id)
            if record.state in SERVED:
                raise wrong_state(
                    calibration_id,
                    f"is {record.state} and has its place in the history",
                    remedy="activate a copy of it with its own id",
                )
            pinned = self._read_records(connection, calibration.c.camera == record.camera, calibration.c.pinned)
            if any(not one.damaged for one in pinned):
                return apply_row_interval(record)
            start = at or record.valid_from
            self._report_changed_past(connection, record, start)
            end_others(connection, record.camera, start)
            activated = replace(record, state="current", valid_from=start, valid_until=None)
            set_columns(connection, calibration_id, state="current", valid_from=start, valid_until=None)
        return apply_row_interval(activated)

    def _report_changed_past(self, connection: Connection, record: CalibrationRecord, start: datetime) -> None:
        """Store an event where another pose has answered for times after `start`, until this one was made.

        A provisional pose that replaces one of the same epoch, with more sightings, is not reported, nor is a fit that
        replaces one of the same epoch: that is an operator's decision, with an event of its own.
        """
        c = calibration.c
        answered = (c.valid_from < record.created_at, or_(c.valid_until.is_(None), c.valid_until > start))
        before = [
            one
            for one in self._read_records(connection, c.camera == record.camera, c.state.in_(SERVED), *answered)
            if one.pose_epoch != record.pose_epoch or (PROVISIONAL in one.id and PROVISIONAL not in record.id)
        ]
        if not before or start >= record.created_at:
            return
        since = max(start, min(one.valid_from for one in before))
        found = Finding(
            "past_answers_changed",
            {
                "calibration": record.id,
                "before": ", ".join(one.id for one in before),
                "since": rfc3339(since, timespec="seconds"),
                "until": rfc3339(record.created_at, timespec="seconds"),
            },
        )
        store_decision(connection, found, at=record.created_at, camera=record.camera)

    def answer_between(self, calibration_id: str, *, since: datetime, until: datetime) -> CalibrationRecord:
        """Make a candidate valid for past times, `since` <= t < `until`, in place of the valid ones.

        What began before `since` ends there; what began between and goes on beyond begins at `until`. Where one answers
        from before `since` until after `until`, or is pinned, nothing is changed: the candidate is returned as it was.
        """
        with self._database.writing() as connection:
            record = self._require_record(connection, calibration_id)
            if record.state != "candidate":
                raise wrong_state(calibration_id, f"is {record.state}", remedy="name a candidate")
            c = calibration.c
            around = (c.valid_from < since, or_(c.valid_until.is_(None), c.valid_until > until))
            pinned = (c.pinned, c.valid_from < until)
            blocking = or_(and_(*around), and_(*pinned))
            if self._read_records(connection, c.camera == record.camera, c.state.in_(SERVED), blocking):
                return apply_row_interval(record)
            clear_interval(connection, record.camera, since, until)
            set_columns(connection, calibration_id, state="retired", valid_from=since, valid_until=until)
            return apply_row_interval(self._require_record(connection, calibration_id))

    def retire(self, calibration_id: str, *, at: datetime) -> CalibrationRecord:
        """End the current calibration with nothing in its place."""
        with self._database.writing() as connection:
            record = self._require_record(connection, calibration_id)
            answering = self._find_answering(connection, record.camera, None)
            if answering is None or answering.id != calibration_id:
                raise wrong_state(calibration_id, f"is {record.state}", remedy="retire the current one")
            end_others(connection, record.camera, at)
            return apply_row_interval(self._require_record(connection, calibration_id))

    def refuse(self, calibration_id: str, *, findings: tuple[Finding, ...]) -> CalibrationRecord:
        """Mark a candidate as refused, with the findings; it is kept."""
        with self._database.writing() as connection:
            record = self._require_record(connection, calibration_id)
            if record.state != "candidate":
                raise wrong_state(calibration_id, f"is {record.state}", remedy="refuse a candidate")
            set_columns(connection, calibration_id, state="refused", accepted=False, findings=findings)
            return apply_row_interval(self._require_record(connection, calibration_id))

    def current(self, camera: str, *, at: datetime | None = None) -> CalibrationRecord | None:
        """Return the calibration that answers now, or the one that answers for the moment `at`; None without one.

        Where that one is damaged, the newest undamaged one that answered before it does, unless the lens was changed
        in between. The one that answers now is read again after anything was written, by whomever.
        """
        if at is not None:
            return self._read_answering(camera, at)
        # Read before the record: a commit between the two makes the pair stale, and it is read again; the other
        # order would keep an old record under the new number.
        revision = self._database.revision()
        cached = self._current.get(camera)
        if cached is None or cached[0] != revision:
            cached = self._current[camera] = (revision, self._read_answering(camera, None))
        return cached[1]

    def _read_answering(self, camera: str, at: datetime | None) -> CalibrationRecord | None:
        with self._database.reading() as connection:
            found = self._find_answering(connection, camera, at)
        return None if found is None else apply_row_interval(found)

    def current_model(self, camera: str) -> Calibration | None:
        """Return the calibration that answers now; None without one, or where another version wrote its document."""
        record = self.current(camera)
        try:
            return None if record is None else self.model(record.id)
        except InputError:
            return None

    def model(self, calibration_id: str) -> Calibration:
        """Return a calibration of the archive, parsed once; InputError where another version wrote its document."""
        found = self._parse(calibration_id)
        if isinstance(found, InputError):
            raise InputError(field=found.field, problem=found.problem, remedy=found.remedy)
        return found

    def _parse_stored(self, calibration_id: str) -> Calibration | InputError:
        document = self.get(calibration_id).document
        try:
            return from_document(document)
        except InputError as error:
            _log.warning("calibration %s cannot be read by this version: %s", calibration_id, error)
            return error

    def damaged(self, camera: str) -> str | None:
        """Return the id of the current calibration of a camera when it is damaged, read from the database anew."""
        c = calibration.c
        with self._database.reading() as connection:
            found = self._read_records(connection, c.camera == camera, c.state == "current")
            if not found or not (found[0].damaged or read_document(connection, found[0].id) is None):
                return None
            return found[0].id

    def _find_answering(self, connection: Connection, camera: str, at: datetime | None) -> CalibrationRecord | None:
        c = calibration.c
        filters = [c.camera == camera]
        if at is None:
            filters.append(c.state == "current")
        else:
            filters += [c.state.in_(SERVED), c.valid_from <= at, or_(c.valid_until.is_(None), c.valid_until > at)]
        found = self._read_records(connection, *filters)
        if not found or not found[0].damaged:
            return found[0] if found else None
        before = self._find_former_undamaged(connection, found[0])
        return before if before is None or at is not None else replace(before, state="current", valid_until=None)

    def _find_former_undamaged(self, connection: Connection, damaged: CalibrationRecord) -> CalibrationRecord | None:
        """Return the newest undamaged calibration that answered before a damaged one, with the same lens."""
        c = calibration.c
        answered = self._stand_in_conditions(connection, damaged.camera, until=damaged.valid_from)
        order = (c.valid_from.desc(), c.created_at.desc())
        for name in connection.scalars(select(c.id).where(*answered, c.id != damaged.id).order_by(*order)).all():
            found = self._read_records(connection, c.id == name)
            if found and not found[0].damaged:
                return found[0]
        return None

    def _stand_in_conditions(
        self, connection: Connection, camera: str, *, until: datetime
    ) -> list[ColumnElement[bool]]:
        """Return the SQL conditions of a calibration that answered until a time and may answer again.

        It is of the lens of that time, and of no pose epoch that was closed as wrong.
        """
        c, e = calibration.c, pose_epoch.c
        lens_changes = (e.camera == camera, e.reason == LENS_CHANGED, e.started_at <= until, not_closed())
        changed = connection.scalar(select(e.started_at).where(*lens_changes).order_by(e.started_at.desc()).limit(1))
        closed = select(e.id).where(e.camera == camera, not_(not_closed()))
        answered = [c.camera == camera, c.state.in_(SERVED), c.valid_from <= until]
        answered.append(or_(c.pose_epoch.is_(None), c.pose_epoch.not_in(closed)))
        return answered + given((c.valid_from.__ge__, changed))

    def last_served(self, camera: str, *, pose_epoch: str) -> datetime | None:
        """Return when the latest calibration of a pose epoch that ever answered was made; None without one."""
        c = calibration.c
        filters = (c.camera == camera, c.pose_epoch == pose_epoch, c.state.in_(SERVED))
        with self._database.reading() as connection:
            return connection.scalar(select(c.created_at).where(*filters).order_by(c.created_at.desc()).limit(1))

    def get(self, calibration_id: str) -> CalibrationRecord:
        """Return a calibration by its id; NotFoundError for an unknown id, ConflictError for a damaged one."""
        with self._database.reading() as connection:
            return apply_row_interval(self._require_record(connection, calibration_id))

    def find(
        self,
        camera: str,
        *,
        state: CalibrationState | None = None,
        until: datetime | None = None,
        provisional: bool = True,
        limit: int | None = None,
    ) -> tuple[CalibrationRecord, ...]:
        """Return a camera's calibrations made before `until`, the newest first.

        Without `provisional`, poses before a fit are left out but for the current one.
        """
        c = calibration.c
        filters = given((c.camera.__eq__, camera), (c.state.__eq__, state), (c.created_at.__lt__, until))
        if not provisional:
            filters = [*filters, or_(c.state == "current", not_(c.id.contains(PROVISIONAL)))]
        with self._database.reading() as connection:
            return tuple(apply_row_interval(record) for record in self._read_records(connection, *filters, limit=limit))

    def _read_records(
        self, connection: Connection, *filters: ColumnElement[bool], limit: int | None = None
    ) -> list[CalibrationRecord]:
        c = calibration.c
        columns = [column.label(column.key) for column in c if column.name != "document"]
        statement = select(*columns).where(*filters).order_by(c.created_at.desc(), c.id.desc()).limit(limit)
        rows = connection.execute(statement).mappings().all()
        return [self._documents.record(connection, row) for row in rows]

    def _exists(self, connection: Connection, calibration_id: str) -> bool:
        return connection.scalar(select(calibration.c.id).where(calibration.c.id == calibration_id)) is not None

    def _require_record(self, connection: Connection, calibration_id: str) -> CalibrationRecord:
        found = self._read_records(connection, calibration.c.id == calibration_id)
        if not found:
            raise NotFoundError(
                field="id", problem=f"there is no calibration {calibration_id}", remedy="see the list of calibrations"
            )
        if found[0].damaged:
            raise wrong_state(
                calibration_id, f"cannot be used: {DAMAGED.text}", remedy="name another one, or calibrate anew"
            )
        return found[0]

    def reinstate(
        self, calibration_id: str, *, at: datetime, reason: str, decided_at: datetime | None = None
    ) -> CalibrationRecord:
        """Make any calibration of the record current by hand, whatever is current or pinned.

        Parameters
        ----------
        calibration_id : a candidate or a refused one, which takes its own place in the history; or one that answered
            before, of which a copy takes over (its `parent` is the one copied), so that no past answer is rewritten.
        at : from when on it answers.
        reason : why, in words; kept with the calibration and in the event.
        decided_at : now, the time of the event; `at` where None.
        """
        decided_at = decided_at or at
        with self._database.writing() as connection:
            record = self._require_record(connection, calibration_id)
            if record.state == "current":
                raise wrong_state(calibration_id, "is current already", remedy="name another one")
            by_hand = Finding(ACTIVATED_BY_OPERATOR, {"reason": reason, "decided_at": rfc3339(decided_at)})
            findings = (by_hand, *record.findings)
            end_others(connection, record.camera, at)
            if record.state in SERVED:
                reinstated = add_copy(connection, record, at=at, findings=findings)
            else:
                decided: dict[str, Any] = {"state": "current", "valid_from": at, "valid_until": None}
                set_columns(connection, record.id, **decided, findings=findings)
                reinstated = replace(record, **decided, findings=findings)
            copied = reinstated.parent if record.state in SERVED else None
            found = Finding("calibration_reinstated", {"calibration": reinstated.id, "reason": reason})
            store_decision(connection, found, at=decided_at, camera=reinstated.camera, details={"copied": copied})
        return apply_row_interval(reinstated)

    def pin(self, calibration_id: str, *, at: datetime, reason: str) -> CalibrationRecord:
        """Keep the current calibration, whatever a refit finds, until it is unpinned or another is reinstated."""
        return self._set_pinned(calibration_id, "pinned", at=at, reason=reason)

    def unpin(self, calibration_id: str, *, at: datetime, reason: str) -> CalibrationRecord:
        """Allow refits to replace the current calibration."""
        return self._set_pinned(calibration_id, "unpinned", at=at, reason=reason)

    def _set_pinned(
        self, calibration_id: str, what: Literal["pinned", "unpinned"], *, at: datetime, reason: str
    ) -> CalibrationRecord:
        with self._database.writing() as connection:
            record = self._require_record(connection, calibration_id)
            if record.state != "current":
                raise wrong_state(calibration_id, f"is {record.state}", remedy="name the current one")
            changed = replace(record, pinned=what == "pinned")
            set_columns(connection, record.id, pinned=changed.pinned)
            found = Finding(f"calibration_{what}", {"calibration": record.id, "reason": reason})
            store_decision(connection, found, at=at, camera=record.camera)
        return apply_row_interval(changed)

    def sightings_given_to(self, calibration_id: str) -> SunPointColumns:
        """Return the sightings that a calibration was given, as they were; see `sightings_used_by`."""
        with self._database.reading() as connection:
            return sightings_used_by(connection, calibration_id)

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
        with self._database.writing() as connection:
            wrong, before = _read_epoch_and_previous(connection, epoch_id)
            _join_epochs(connection, wrong, before)
            acknowledge_at(connection, wrong.camera, wrong.started_at, at=at, reason=reason)
            current = self._serve_again(connection, wrong, at=at, reason=reason)
            data = {"pose_epoch": wrong.id, "started_at": wrong.started_at.isoformat(), "reason": reason}
            details = {"continues": before.id, "calibration": current}
            store_decision(connection, Finding(EPOCH_CLOSED, data), at=at, camera=wrong.camera, details=details)
        return current

    def _serve_again(self, connection: Connection, wrong: PoseEpoch, *, at: datetime, reason: str) -> str | None:
        """Make the calibration that was served before an epoch current again, and return the id of the current one."""
        c = calibration.c
        current = self._read_records(connection, c.camera == wrong.camera, c.state == "current")
        if current and current[0].pose_epoch != wrong.id:
            return current[0].id
        answered = self._read_records(connection, *self._stand_in_conditions(connection, wrong.camera, until=at))
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


def _make_record(document: Mapping[str, Any], parent: str | None) -> CalibrationRecord:
    """Return the record of a calibration document, with its fields taken from the document."""
    try:
        verdict = document["verdict"]
        return CalibrationRecord(
            **{name: document[name] for name in _FIELDS},
            state="candidate" if verdict["accepted"] or verdict.get("marginal", False) else "refused",
            created_at=datetime.fromisoformat(document["created_at"]),
            valid_from=datetime.fromisoformat(document["valid_from"]),
            valid_until=None,
            parent=parent,
            accepted=bool(verdict["accepted"]),
            findings=parse_findings(verdict),
            document=dict(document),
        )
    except (KeyError, TypeError, ValueError) as error:
        raise InputError(
            field="calibration document", problem=f"{error} is missing or malformed", remedy="see sunarc.calibration/2"
        ) from error


# Manual decisions on calibrations: reinstate, pin, unpin.

_COPY = re.compile(r"-r\d+$")


def add_copy(
    connection: Connection, record: CalibrationRecord, *, at: datetime, findings: tuple[Finding, ...]
) -> CalibrationRecord:
    """Store a copy of a calibration that answered before, current from `at` on, with the same sightings."""
    copy = _make_copy(record, id=_make_copy_id(connection, record.id), at=at, findings=findings)
    connection.execute(insert(calibration).values(record_columns(copy)))
    copy_used(connection, record.id, to=copy.id)
    return copy


def _make_copy(record: CalibrationRecord, *, id: str, at: datetime, findings: tuple[Finding, ...]) -> CalibrationRecord:  # noqa: A002 - the field's name
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


def _make_copy_id(connection: Connection, calibration_id: str) -> str:
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
    insert_event(connection, Event.of(found, time=at, severity="info", camera=camera, details=details))


EPOCH_CLOSED = "epoch_closed"
"""Kind of the event of a pose epoch that was closed as wrong."""


def _read_epoch_and_previous(connection: Connection, epoch_id: str) -> tuple[PoseEpoch, PoseEpoch]:
    epochs = pose_epoch.c
    in_order = read_records(connection, select(pose_epoch).where(not_closed()).order_by(epochs.started_at), PoseEpoch)
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


def _join_epochs(connection: Connection, wrong: PoseEpoch, before: PoseEpoch) -> None:
    """End an epoch where it began, and extend the one before it over its time and its sightings."""
    epochs, c = pose_epoch.c, sun_point.c
    # The row stays, of no duration: its id is never given again, and the event can still name it.
    connection.execute(update(pose_epoch).where(epochs.id == wrong.id).values(ended_at=wrong.started_at))
    connection.execute(update(pose_epoch).where(epochs.id == before.id).values(ended_at=wrong.ended_at))
    admitted = update(sun_point).where(c.pose_epoch == wrong.id, c.findings == MOVED, c.accepted.is_(True))
    connection.execute(admitted.values(accepted=False, verdict=ELSEWHERE, findings=(Finding("sun_elsewhere"),)))
    connection.execute(update(sun_point).where(c.pose_epoch == wrong.id).values(pose_epoch=before.id))
