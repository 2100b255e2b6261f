"""Provisional pose of an epoch without a full fit, from its first sightings on, updated with every few more."""

from __future__ import annotations

import logging
from collections.abc import Callable
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta

import sunarc
from sunarc.archive import LENS_CHANGED, CalibrationRecord, CameraArchive, PoseEpoch
from sunarc.calibration import MAX_CLOCK_ERROR_S, Calibration, CalibrationOptions, estimate_pose, to_document
from sunarc.errors import InputError
from sunarc.workers.fit_input import points_of

_log = logging.getLogger(__name__)
_GROWTH = 1.3
_FEWEST = 4
_JITTER = timedelta(seconds=1)
"""A camera that dates its frames may be ahead of the time carried on from its last one by its own jitter."""


def is_provisional(calibration: Calibration) -> bool:
    """Return whether only the pose was fitted, with the lens of an earlier calibration."""
    return calibration.evidence.options.get("free") == "pose"


@dataclass(frozen=True, slots=True)
class _Tried:
    epoch: str
    count: int


class ProvisionalPoseEstimator:
    """Estimates the pose of an epoch that has no full fit.

    Parameters
    ----------
    camera : its archive and site.
    options : what makes a pose acceptable.
    wander_deg : 1-sigma by which the mount wanders.
    now : frame time, which dates calibrations; pose epochs and sightings dated later are not used.
    """

    def __init__(
        self,
        camera: CameraArchive,
        *,
        options: CalibrationOptions,
        wander_deg: float,
        now: Callable[[], datetime],
    ) -> None:
        self._camera = camera
        self._options = options
        self._wander_deg = wander_deg
        self._now = now
        self._tried: _Tried | None = None

    def improve(self) -> bool:
        """Estimate the pose again where that is due; return whether the result was activated."""
        now = self._now()
        epoch = self._camera.current_epoch(at=now + _JITTER)
        current = self._camera.current_calibration()
        if epoch is None or current is None or epoch.reason == LENS_CHANGED:
            return False
        if current.pose_epoch == epoch.id and not is_provisional(self._camera.archive.model(current.id)):
            return False
        lens = self._lens(current)
        if lens is None or self._is_of_later(current, epoch):
            return False
        columns = self._camera.sun_point_columns(
            pose_epoch=epoch.id, until=now + _JITTER, largest_clock_error_s=MAX_CLOCK_ERROR_S
        )
        count = int(columns.unix_s.size)
        done = self._tried.count if self._tried is not None and self._tried.epoch == epoch.id else 0
        if count < max(_FEWEST, _GROWTH * done):
            return False
        self._tried = _Tried(epoch.id, count)
        posed = estimate_pose(
            points_of(columns),
            start=self._camera.archive.model(lens.id),
            site=self._camera.site,
            options=self._options,
            wander_deg=self._wander_deg,
        )
        if not posed.verdict.accepted:
            _log.info("pose estimation failed: %s", "; ".join(posed.verdict.reasons))
            return False
        document = self._document(posed, epoch, count)
        record = self._camera.archive.add_calibration(document, parent=lens.id, used=columns)
        return self._camera.archive.activate(record.id, at=epoch.started_at).state == "current"

    def _lens(self, current: CalibrationRecord) -> CalibrationRecord | None:
        """Return the full fit whose lens is kept."""
        record = current
        try:
            while record.parent is not None and is_provisional(self._camera.archive.model(record.id)):
                record = self._camera.archive.calibration(record.parent)
            return None if is_provisional(self._camera.archive.model(record.id)) else record
        except InputError:  # gone, damaged, or of another version
            return None

    def _is_of_later(self, current: CalibrationRecord, epoch: PoseEpoch) -> bool:
        """Return whether a calibration is of a pose epoch after this one: one that a clock ahead has opened."""
        started = {each.id: each.started_at for each in self._camera.epochs()}
        return current.pose_epoch in started and started[current.pose_epoch] > epoch.started_at

    def _document(self, posed: Calibration, epoch: PoseEpoch, count: int) -> dict[str, object]:
        now = self._now()
        return to_document(
            posed,
            id=f"{now.astimezone(UTC):%Y%m%dT%H%M%SZ}-pose{count}",
            camera=self._camera.name,
            state="candidate",
            created_at=now,
            valid_from=epoch.started_at,
            valid_until=None,
            pose_epoch=epoch.id,
            software_version=sunarc.__version__,
        )
