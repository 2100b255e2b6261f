"""What the routes serve: the collaborators of one application, handed to `create_app` and to nobody else."""

from __future__ import annotations

import threading
from collections import OrderedDict
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from datetime import datetime
from pathlib import Path

from starlette.requests import Request

from sunarc.api.options import ApiOptions
from sunarc.archive import Archive, CalibrationRecord, Refit
from sunarc.board import StatusSnapshot
from sunarc.calibration import Calibration, from_document
from sunarc.errors import InputError, NotFoundError
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

    def of(self, request: Request) -> Served:
        """Return what is served of the camera in a request's path; of this service's own where the path names none."""
        name = request.path_params.get("camera", self.camera)
        return self if name == self.camera else self._of_another(name)

    def _of_another(self, name: str) -> Served:
        """Return what the archive remembers of a camera that another service drives."""
        known = next((camera for camera in self.archive.cameras() if camera.name == name), None)
        if known is None:
            raise NotFoundError(field="camera", problem=f"there is no camera {name}", remedy="see /v1/cameras")
        site = Site(latitude=known.latitude, longitude=known.longitude, altitude=known.altitude)
        return replace(self, camera=name, site=site, latest_image=lambda: None, request_refit=_refuse_refit)

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

    def calibration(self, calibration_id: str) -> CalibrationRecord:
        """Return this camera's calibration of an id; NotFoundError without one."""
        record = self.archive.calibration(calibration_id)
        if record.camera != self.camera:
            raise NotFoundError(
                field="id", problem=f"calibration {calibration_id} is another camera's", remedy="see /v1/cameras"
            )
        return record

    def calibration_or_none(self, at: datetime | None) -> tuple[CalibrationRecord, Calibration] | None:
        """Return the calibration that answers, in both its forms; None without one."""
        record = self.archive.current_calibration(self.camera, at=at)
        return None if record is None else (record, self.parsed.get(record))


def _refuse_refit(_reason: str) -> Refit:
    raise InputError(
        field="camera", problem="another service solves this camera", remedy="ask the service that drives it"
    )
