"""The pose before a fit: from a lens prior file, or after the camera moved.

The lens is that of an earlier calibration, or, without one, of its type as the settings' lens prior file has it.
"""

from __future__ import annotations

import logging
from collections.abc import Callable
from dataclasses import KW_ONLY, dataclass
from datetime import UTC, datetime, timedelta
from typing import NamedTuple

import sunarc
from sunarc.calibration.lens_library.first_pose import first_pose
from sunarc.calibration.lens_library.lens_type import LensType
from sunarc.calibration.model.options import CalibrationOptions, FirstPoseOptions, Mirrored
from sunarc.calibration.model.result import Calibration, Verdict
from sunarc.calibration.model.sightings import MAX_CLOCK_ERROR_S, Sightings
from sunarc.calibration.pose import estimate_pose
from sunarc.calibration.verdict import add_stated_clock
from sunarc.common.errors import InputError
from sunarc.formats.calibration_document import to_document
from sunarc.formats.lens_prior import read_lens_type
from sunarc.imager.archive.archive import CameraArchive
from sunarc.imager.archive.calibrations import PROVISIONAL
from sunarc.imager.archive.epochs import LENS_CHANGED
from sunarc.imager.archive.values import CalibrationRecord, PoseEpoch
from sunarc.imager.workers.calibrating.solver_process import columns_to_sightings
from sunarc.imager.workers.options import LensPriorOptions
from sunarc.sources.files import read_file


class FirstPose(NamedTuple):
    """Type of lens, and prior of the pose."""

    lens: LensType
    pose: FirstPoseOptions

    @classmethod
    def of(cls, options: LensPriorOptions) -> FirstPose | None:
        """Return the prior that the settings name; None where they name no lens prior file.

        Raises
        ------
        InputError
            Where the file is invalid.
        """
        path = options.lens_prior
        return None if path is None else cls(read_lens_type(read_file(path), name=path.name), options)


_log = logging.getLogger(__name__)
_GROWTH = 1.3
FEWEST = 4
_JITTER = timedelta(seconds=1)
"""A camera that dates its frames may be ahead of the time carried on from its last one by its own jitter."""


def is_provisional(calibration: Calibration) -> bool:
    """Return whether only the pose was fitted, with the lens of an earlier calibration."""
    return calibration.evidence.options.get("free") == "pose"


def is_first_pose(calibration: Calibration) -> bool:
    """Return whether only the pose was fitted, with a lens that is known by its type alone."""
    return is_provisional(calibration) and "lens_prior" in calibration.evidence.options


@dataclass(frozen=True, slots=True)
class _LastAttempt:
    epoch: str
    count: int


@dataclass(eq=False)
class ProvisionalPoseEstimator:
    """Estimates the pose of an epoch that has no full fit.

    Parameters
    ----------
    camera : its archive and site.
    options : what makes a pose acceptable.
    wander_deg : 1-sigma by which the mount wanders.
    now : frame time, which dates calibrations; pose epochs and sightings dated later are not used.
    first : the type of lens, where no calibration knows the lens; None: there is no pose before the first full fit.
    clock_error_s : the bound of the clock that is stated for all sightings, s; None where none is.

    Attributes
    ----------
    first : the same.
    count : sightings of the epoch when a pose was last due.
    refusal : the verdict of the last estimate where it was refused; None where it was not.
    """

    camera: CameraArchive
    _: KW_ONLY
    options: CalibrationOptions
    wander_deg: float
    now: Callable[[], datetime]
    first: FirstPose | None = None
    clock_error_s: float | None = None

    def __post_init__(self) -> None:
        """Begin without a pose."""
        self._tried: _LastAttempt | None = None
        self.count = 0
        self.refusal: Verdict | None = None

    @property
    def mirrored(self) -> Mirrored:
        """The handedness of the images, as the settings or the type of lens say it."""
        if self.first is None:
            return self.options.mirrored or "no"
        return "yes" if self.first.lens.camera.mirrored else "no"

    def improve(self) -> bool:
        """Estimate the provisional pose again where that is due; return whether the result was activated."""
        now = self.now()
        epoch = self.camera.archive.epochs.current(self.camera.name, at=now + _JITTER)
        current = self.camera.archive.calibrations.current(self.camera.name)
        if epoch is None or epoch.reason == LENS_CHANGED or (current is None and self.first is None):
            return False
        if current is not None and self._is_answered(current, epoch):
            return False
        lens = None if current is None else self._find_lens(current)
        if lens is None and self.first is None:
            return False
        columns = self.camera.archive.sightings.columns(
            self.camera.name, pose_epoch=epoch.id, until=now + _JITTER, largest_clock_error_s=MAX_CLOCK_ERROR_S
        )
        self.count = count = int(columns.unix_s.size)
        done = self._tried.count if self._tried is not None and self._tried.epoch == epoch.id else 0
        if count < max(FEWEST, _GROWTH * done):
            return False
        self._tried = _LastAttempt(epoch.id, count)
        points = columns_to_sightings(columns)
        posed = self._pose_by_type(points) if lens is None else self._pose_by_lens(points, lens)
        self.refusal = None if posed.verdict.accepted else posed.verdict
        if not posed.verdict.accepted:
            _log.info("pose estimation failed: %s", "; ".join(posed.verdict.reasons))
            return False
        document = self._make_document(posed, epoch, count)
        record = self.camera.archive.calibrations.add(document, parent=None if lens is None else lens.id, used=columns)
        return self.camera.archive.calibrations.activate(record.id, at=epoch.started_at).state == "current"

    def _is_answered(self, current: CalibrationRecord, epoch: PoseEpoch) -> bool:
        """Return whether the pose epoch has a full fit, or the current calibration is of a later epoch."""
        if current.pose_epoch == epoch.id and not is_provisional(self.camera.archive.calibrations.model(current.id)):
            return True
        return self._belongs_to_later(current, epoch)

    def _pose_by_type(self, points: Sightings) -> Calibration:
        """Return a first pose, of a lens that is known by its type."""
        if self.first is None:
            raise InputError(field="first_pose.lens_prior", problem="unset", remedy="name a lens prior file")
        lens, pose = self.first
        return first_pose(points, lens=lens, site=self.camera.site, options=self.options, pose=pose)

    def _pose_by_lens(self, points: Sightings, lens: CalibrationRecord) -> Calibration:
        """Return a new pose of a lens that was calibrated."""
        return estimate_pose(
            points,
            start=self.camera.archive.calibrations.model(lens.id),
            site=self.camera.site,
            options=self.options,
            wander_deg=self.wander_deg,
        )

    def _find_lens(self, current: CalibrationRecord) -> CalibrationRecord | None:
        """Return the full fit whose lens is kept."""
        record = current
        try:
            while record.parent is not None and is_provisional(self.camera.archive.calibrations.model(record.id)):
                record = self.camera.archive.calibrations.get(record.parent)
            return None if is_provisional(self.camera.archive.calibrations.model(record.id)) else record
        except InputError:  # gone, damaged, or of another version
            return None

    def _belongs_to_later(self, current: CalibrationRecord, epoch: PoseEpoch) -> bool:
        """Return whether a calibration is of a pose epoch after this one: one that a clock ahead has opened."""
        started = {each.id: each.started_at for each in self.camera.archive.epochs.find(self.camera.name)}
        return current.pose_epoch in started and started[current.pose_epoch] > epoch.started_at

    def _make_document(self, posed: Calibration, epoch: PoseEpoch, count: int) -> dict[str, object]:
        now = self.now()
        return to_document(
            add_stated_clock(posed, self.clock_error_s),
            id=f"{now.astimezone(UTC):%Y%m%dT%H%M%SZ}{PROVISIONAL}{count}",
            camera=self.camera.name,
            state="candidate",
            created_at=now,
            valid_from=epoch.started_at,
            valid_until=None,
            pose_epoch=epoch.id,
            software_version=sunarc.__version__,
        )
