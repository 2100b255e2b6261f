"""The history of calibrations, as a person reads and overrules it."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from datetime import datetime
from typing import Any

from sunarc.archive import Archive, CalibrationRecord, PoseEpoch, open_archive
from sunarc.settings import Settings

_SHOWN = ("id", "state", "pinned", "valid_from", "valid_until", "pose_epoch", "parent", "accepted")


def list_calibrations(settings: Settings, *, limit: int) -> list[dict[str, Any]]:
    """Return the camera's calibrations, the newest first, as rows."""
    with _archive(settings) as archive:
        return [_row(record) for record in archive.calibrations(settings.name, limit=limit)]


def reinstate(settings: Settings, calibration_id: str, *, at: datetime, reason: str) -> dict[str, Any]:
    """Make a calibration current by hand; see `Archive.reinstate`."""
    with _archive(settings) as archive:
        return _row(archive.reinstate(calibration_id, at=at, reason=reason))


def hold(settings: Settings, calibration_id: str, *, at: datetime, reason: str, pinned: bool) -> dict[str, Any]:
    """Pin the current calibration, or let it go."""
    with _archive(settings) as archive:
        change: Callable[..., CalibrationRecord] = archive.pin if pinned else archive.unpin
        return _row(change(calibration_id, at=at, reason=reason))


def list_epochs(settings: Settings) -> list[dict[str, Any]]:
    """Return the camera's pose epochs, the first one first, as rows; closed ones too."""
    with _archive(settings) as archive:
        return [_epoch_row(epoch) for epoch in archive.epochs(settings.name, include_closed=True)]


def close_epoch(settings: Settings, epoch_id: str, *, at: datetime, reason: str) -> dict[str, Any]:
    """Close a pose epoch that was opened by mistake; see `Archive.close_epoch`."""
    with _archive(settings) as archive:
        current = archive.close_epoch(epoch_id, at=at, reason=reason)
        return {"id": epoch_id, "closed": True, "calibration": current}


def _epoch_row(epoch: PoseEpoch) -> dict[str, Any]:
    return {
        "id": epoch.id,
        "started_at": epoch.started_at.isoformat(),
        "ended_at": epoch.ended_at and epoch.ended_at.isoformat(),
        "reason": epoch.reason,
        "closed": epoch.ended_at is not None and epoch.ended_at <= epoch.started_at,
    }


def _row(record: CalibrationRecord) -> dict[str, Any]:
    row = {name: getattr(record, name) for name in _SHOWN}
    row |= {name: value and value.isoformat() for name, value in row.items() if name.startswith("valid")}
    sky = record.document.get("uncertainty", {}).get("sky_rms_deg")
    return {**row, "sky_rms_deg": sky, "reasons": list(record.reasons)}


@contextmanager
def _archive(settings: Settings) -> Iterator[Archive]:
    archive = open_archive(settings.database)
    try:
        yield archive
    finally:
        archive.close()
