"""Integrity of stored calibrations: changes by hand or by other versions are reported once."""

from __future__ import annotations

from collections.abc import Callable
from datetime import datetime

from sunarc.archive import CalibrationRecord, CameraArchive, Event
from sunarc.errors import InputError, NotFoundError
from sunarc.runtime.status import Reason, StatusRegistry


class CalibrationIntegrityCheck:
    """Looks whether the current calibration can be read, and the sightings that it rests on are still there.

    Parameters
    ----------
    camera : its archive.
    now : frame time, which dates events.
    board : where the lack of a calibration that can be used is shown.
    """

    def __init__(self, camera: CameraArchive, *, now: Callable[[], datetime], board: StatusRegistry) -> None:
        self._camera = camera
        self._now = now
        self._board = board
        self._reported: set[tuple[str, str]] = set()
        self._revision: int | None = None
        self._current: str | None = None

    def follow(self) -> None:
        """Look again where another calibration is current than at the last look; cheap where nothing was written."""
        revision = self._camera.archive.revision()
        if revision == self._revision:
            return
        self._revision = revision
        current = self._camera.current_calibration()
        if (None if current is None else current.id) != self._current:
            self.look()

    def look(self) -> None:
        """Look, show what is wrong on the board, and write an event the first time."""
        current = self._camera.current_calibration()
        self._current = None if current is None else current.id
        damaged = self._camera.damaged_calibration()
        if damaged is not None:
            reason = _damaged(damaged, current)
            self._show(reason)
            self._tell("calibration_damaged", damaged, reason.text)
        else:
            self._show(None if current is not None else _none())
        if current is None:
            return
        try:
            self._camera.archive.model(current.id)
        except InputError as error:
            self._show(_unreadable(current))
            self._tell("calibration_unreadable", current.id, f"calibration {current.id} cannot be read: {error}")
            return
        try:
            self._camera.archive.sightings_of(current.id)
        except NotFoundError:
            return  # imported, or made before evidence was kept
        except InputError as error:
            self._tell("evidence_changed", current.id, f"the record was changed: {error}")

    def _show(self, reason: Reason | None) -> None:
        for code in ("no_calibration", "calibration_unreadable", "calibration_damaged"):
            if reason is None or reason.code != code:
                self._board.clear_reason(code)
        if reason is not None:
            self._board.set_reason(reason)

    def _tell(self, kind: str, calibration: str, text: str) -> None:
        if (kind, calibration) in self._reported:
            return
        self._reported.add((kind, calibration))
        details = {"calibration": calibration}
        event = Event(
            time=self._now(), kind=kind, severity="alarm", text=text, camera=self._camera.name, details=details
        )
        self._camera.archive.add_event(event)


def _none() -> Reason:
    return Reason(
        code="no_calibration",
        severity="degraded",
        text="no calibration is current",
        remedy="wait for a clear day, or import sightings with `sunarc points import`",
    )


def _damaged(damaged: str, served: CalibrationRecord | None) -> Reason:
    instead = "none can take its place" if served is None else f"the earlier {served.id} is served in its place"
    return Reason(
        code="calibration_damaged",
        severity="degraded",
        text=f"the stored document of calibration {damaged} does not match its checksum; {instead}",
        remedy="request a refit (POST /v1/refits), or restore a copy with `sunarc db restore --latest`; check the disk",
    )


def _unreadable(record: CalibrationRecord) -> Reason:
    return Reason(
        code="calibration_unreadable",
        severity="degraded",
        text=f"the current calibration {record.id} was written by another version and cannot be used",
        remedy="install that version, or serve an older one with `sunarc calibrations activate ID`",
    )
