"""Reading of calibration documents: checked against their checksum, parsed once, cached by id."""

from __future__ import annotations

import hashlib
import threading
from collections import OrderedDict
from collections.abc import Mapping
from dataclasses import asdict, replace
from typing import Any

from sqlalchemy import Connection, RowMapping, select

from sunarc.archive.json_text import json_text, parsed_json
from sunarc.archive.tables import calibration
from sunarc.archive.types import stored_bytes
from sunarc.archive.values import CalibrationRecord
from sunarc.findings import Finding
from sunarc.utc import EPOCH

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
            return _damaged(values)
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


def row_of(record: CalibrationRecord) -> dict[str, Any]:
    """Return the columns of a record, with the checksum of the document as it will be stored."""
    row = asdict(replace(record, document=dict(record.document))) | {"findings": record.findings}
    row.pop("damaged")
    row["document_sha256"] = hashlib.sha256(json_text(row["document"]).encode()).hexdigest()
    return row


def _times(row: RowMapping) -> tuple[object, ...]:
    return row["created_at"], row["valid_from"], row["state"]


def _damaged(values: dict[str, Any]) -> CalibrationRecord:
    """Return a record that shows what is left of a damaged calibration, with a document that no fit can use."""
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
