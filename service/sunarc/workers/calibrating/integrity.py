"""Integrity of stored calibrations: changes by hand or by other versions are reported once."""

from __future__ import annotations

from collections.abc import Callable
from datetime import datetime

from sunarc.archive.camera_archive import CameraArchive
from sunarc.archive.values import CalibrationRecord
from sunarc.errors import InputError, NotFoundError
from sunarc.findings import Finding
from sunarc.runtime.status import Reason, StatusRegistry
from sunarc.workers.messages import MESSAGES, condition

_CODES = ("no_calibration", "calibration_unreadable", "calibration_damaged")


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
        """Check again where another calibration is current than at the last check."""
        revision = self._camera.archive.revision()
        if revision == self._revision:
            return
        self._revision = revision
        current = self._camera.current_calibration()
        if (None if current is None else current.id) != self._current:
            self.check()

    def check(self) -> None:
        """Check, set the condition, and store an event the first time."""
        current = self._camera.current_calibration()
        self._current = None if current is None else current.id
        self._board.set_one_condition(_CODES, self._reason(current))
        if current is not None:
            self._check_sightings(current)

    def _reason(self, current: CalibrationRecord | None) -> Reason | None:
        damaged = self._camera.damaged_calibration()
        reason = None
        if current is None:
            reason = condition("no_calibration")
        if damaged is not None:
            active = "no calibration" if current is None else current.id
            reason = self._report("calibration_damaged", calibration=damaged, served=active)
        if current is not None:
            try:
                self._camera.archive.model(current.id)
            except InputError as error:
                reason = self._report("calibration_unreadable", calibration=current.id, error=str(error))
        return reason

    def _check_sightings(self, current: CalibrationRecord) -> None:
        try:
            self._camera.archive.sightings_of(current.id)
        except NotFoundError:
            return  # imported, or made before evidence was kept
        except InputError as error:
            self._report("evidence_changed", calibration=current.id, error=str(error))

    def _report(self, code: str, *, calibration: str, **data: str) -> Reason:
        """Write an event the first time, and return the condition."""
        finding = Finding(code, {"calibration": calibration, **data})
        if (code, calibration) not in self._reported:
            self._reported.add((code, calibration))
            self._camera.add_event(finding, MESSAGES, time=self._now(), severity="alarm")
        return Reason.of(finding, MESSAGES)
