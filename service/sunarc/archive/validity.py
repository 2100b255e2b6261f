"""Intervals of validity of calibrations: the rules of every change."""

from __future__ import annotations

from dataclasses import replace
from datetime import datetime
from typing import Any

from sqlalchemy import Connection, case, literal, or_, update

from sunarc.archive.tables import calibration
from sunarc.archive.types import UtcTime
from sunarc.archive.values import CalibrationRecord, CalibrationState
from sunarc.errors import ConflictError
from sunarc.utc import rfc3339

SERVED: tuple[CalibrationState, ...] = ("current", "retired")


def with_interval(record: CalibrationRecord) -> CalibrationRecord:
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
    """Return the refusal of what a calibration's state does not allow."""
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
    """Take `since` <= t < `until` out of the validity of a camera's calibrations; what is valid beyond begins there."""
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
