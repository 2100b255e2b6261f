"""What the routes serve: the collaborators of one application, handed to `create_app` and to nobody else."""

from __future__ import annotations

import threading
from collections import OrderedDict
from collections.abc import Callable
from dataclasses import dataclass, field
from datetime import datetime
from pathlib import Path

from sunarc.api.options import ApiOptions
from sunarc.archive import Archive, CalibrationRecord, Refit
from sunarc.board import StatusSnapshot
from sunarc.calibration import Calibration, from_document
from sunarc.errors import NotFoundError
from sunarc.sky import Site

_MOST_PARSED = 16


class ParsedCalibrations:
    """The calibrations that were asked for lately, ready to compute with; parsing one is slower than using it."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._parsed: OrderedDict[str, Calibration] = OrderedDict()

    def get(self, record: CalibrationRecord) -> Calibration:
        """Return the calibration of a record; its model never changes under one id."""
        with self._lock:
            found = self._parsed.get(record.id)
            if found is None:
                found = self._parsed[record.id] = from_document(record.document)
            self._parsed.move_to_end(record.id)
            while len(self._parsed) > _MOST_PARSED:
                self._parsed.popitem(last=False)
            return found


@dataclass(frozen=True, slots=True, kw_only=True)
class Served:
    """The collaborators of one application (see `create_app`)."""

    archive: Archive
    camera: str
    site: Site
    status: Callable[[], StatusSnapshot]
    request_refit: Callable[[str], Refit]
    frame_clock: Callable[[], datetime]
    latest_image: Callable[[], Path | None]
    options: ApiOptions
    token: bytes | None = field(repr=False)
    parsed: ParsedCalibrations = field(default_factory=ParsedCalibrations)

    def record(self, at: datetime | None) -> CalibrationRecord:
        """Return the calibration that answers now, or for the moment `at`; NotFoundError without one."""
        record = self.archive.current_calibration(self.camera, at=at)
        if record is None:
            when = "is current" if at is None else f"answers for {at.isoformat()}"
            raise NotFoundError(
                field="calibration" if at is None else "at",
                problem=f"no calibration {when}",
                remedy="wait for a clear day, or see /v1/calibrations for what there is",
            )
        return record

    def calibration_or_none(self, at: datetime | None) -> tuple[CalibrationRecord, Calibration] | None:
        """Return the calibration that answers, in both its forms; None without one."""
        record = self.archive.current_calibration(self.camera, at=at)
        return None if record is None else (record, self.parsed.get(record))
