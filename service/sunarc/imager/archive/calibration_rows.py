"""Rows of calibrations: their documents, checked against their checksums, and their intervals of validity."""

from __future__ import annotations

import hashlib
import threading
from collections import OrderedDict
from collections.abc import Mapping
from dataclasses import replace
from datetime import datetime
from typing import Any

from sqlalchemy import Connection, RowMapping, case, literal, or_, select, update

from sunarc.common.errors import ConflictError
from sunarc.common.findings import Finding
from sunarc.common.utc import EPOCH, rfc3339
from sunarc.imager.archive.database.connections import json_text, parsed_json
from sunarc.imager.archive.database.tables import UtcTime, calibration, stored_bytes
from sunarc.imager.archive.values import CalibrationRecord, CalibrationState, field_values

DAMAGED = Finding("document_damaged")
"""Finding of a damaged calibration."""

UNKNOWN_TIME = EPOCH
"""Stands for a time that cannot be read."""

_CACHE_SIZE = 128
_SAME = ("id", "camera", "method", "pose_epoch")
"""Columns that the document has too."""


class Documents:
    """Least-recently-used cache of documents; parsing one takes longer than finding its row."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._cache: OrderedDict[str, Mapping[str, Any] | None] = OrderedDict()

    def get(self, connection: Connection, calibration_id: str) -> Mapping[str, Any] | None:
        """Return the document of a calibration that exists; None when it is damaged."""
        with self._lock:
            if calibration_id not in self._cache:
                self._cache[calibration_id] = read_document(connection, calibration_id)
            self._cache.move_to_end(calibration_id)
            if len(self._cache) > _CACHE_SIZE:
                self._cache.popitem(last=False)
            return self._cache.get(calibration_id)

    def record(self, connection: Connection, row: RowMapping) -> CalibrationRecord:
        """Return the record of a row (all columns but the document), marked where the document is damaged."""
        document = self.get(connection, row["id"])
        values = {name: value for name, value in row.items() if name != "document_sha256"}
        if document is None or any(document.get(name) != row[name] for name in _SAME) or None in _times(row):
            return _make_damaged_record(values)
        return CalibrationRecord(**values, document=document)


def read_document(connection: Connection, calibration_id: str) -> Mapping[str, Any] | None:
    """Read a document and compare it with its checksum; None when the two differ."""
    columns = select(stored_bytes(calibration.c.document), calibration.c.document_sha256)
    found = connection.execute(columns.where(calibration.c.id == calibration_id)).one_or_none()
    stored, checksum = (None, "") if found is None else found  # an id that is no UTF-8 finds nothing
    if stored is None or hashlib.sha256(stored).hexdigest() != checksum:
        return None
    # The checksum is of the stored bytes: parsing first would raise on a flipped bit.
    document = parsed_json(stored)
    return document if isinstance(document, dict) else None


def damaged_calibrations(connection: Connection) -> dict[str, str | None]:
    """Return the ids of all damaged calibrations, with their states."""
    c = calibration.c
    states = connection.execute(select(c.id, c.state).order_by(c.created_at)).all()
    return {name: state for name, state in states if read_document(connection, name) is None}


def record_columns(record: CalibrationRecord) -> dict[str, Any]:
    """Return the columns of a record, with the checksum of the document as it will be stored."""
    row = field_values(record) | {"document": dict(record.document)}
    row.pop("damaged")
    row["document_sha256"] = hashlib.sha256(json_text(row["document"]).encode()).hexdigest()
    return row


def _times(row: RowMapping) -> tuple[object, ...]:
    return row["created_at"], row["valid_from"], row["state"]


def _make_damaged_record(values: dict[str, Any]) -> CalibrationRecord:
    """Return a record of the rest of a damaged calibration, with a document that no fit can use."""
    shown = {
        **values,
        "state": values["state"] or "refused",
        "created_at": values["created_at"] or UNKNOWN_TIME,
        "valid_from": values["valid_from"] or UNKNOWN_TIME,
        "findings": (DAMAGED, *values["findings"]),
        "accepted": False,
    }
    document = {"id": values["id"], "camera": values["camera"], "damaged": True, "verdict": {}}
    return CalibrationRecord(**shown, document=document, damaged=True)


SERVED: tuple[CalibrationState, ...] = ("current", "retired")


def apply_row_interval(record: CalibrationRecord) -> CalibrationRecord:
    """Return a record whose document has the state, the interval and the verdict of its row."""
    decided = {
        "state": record.state,
        "valid_from": rfc3339(record.valid_from),
        "valid_until": None if record.valid_until is None else rfc3339(record.valid_until),
        "verdict": {
            **record.document["verdict"],
            "accepted": record.accepted,
            "reasons": list(record.reasons),
            "findings": [finding.as_json() for finding in record.findings],
        },
    }
    return replace(record, document={**record.document, **decided})


def wrong_state(calibration_id: str, state: str, *, remedy: str) -> ConflictError:
    """Return the error of a change that a calibration's state does not allow."""
    return ConflictError(field="id", problem=f"calibration {calibration_id} {state}", remedy=remedy)


def end_others(connection: Connection, camera: str, at: datetime) -> None:
    """End the validity of all calibrations of a camera at `at`, and unpin them."""
    c = calibration.c
    answering = update(calibration).where(
        c.camera == camera, c.state.in_(SERVED), or_(c.valid_until.is_(None), c.valid_until > at)
    )
    end = literal(at, UtcTime)
    until = case((c.valid_from > end, c.valid_from), else_=end)  # of one that began later nothing remains
    connection.execute(answering.values(state="retired", valid_until=until, pinned=False))


def clear_interval(connection: Connection, camera: str, since: datetime, until: datetime) -> None:
    """Take `since` <= t < `until` out of the validity of a camera's calibrations; later parts begin at `until`."""
    c = calibration.c
    filters = (c.camera == camera, c.state.in_(SERVED))
    beyond = or_(c.valid_until.is_(None), c.valid_until > until)
    within = (c.valid_from >= since, c.valid_from < until)
    connection.execute(update(calibration).where(*filters, *within, beyond).values(valid_from=until))
    connection.execute(
        update(calibration).where(*filters, *within, c.valid_until <= until).values(valid_until=c.valid_from)
    )
    # Last, for it ends at `since` what the first two left: one that began before and reaches in.
    reaching = update(calibration).where(
        *filters, c.valid_from < since, or_(c.valid_until.is_(None), c.valid_until > since)
    )
    connection.execute(reaching.values(state="retired", valid_until=since, pinned=False))


def set_columns(connection: Connection, calibration_id: str, **columns: Any) -> None:  # noqa: ANN401 - columns of many types
    """Write columns of one calibration."""
    connection.execute(update(calibration).where(calibration.c.id == calibration_id).values(**columns))
