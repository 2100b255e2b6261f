"""Watch: each sighting compared with the current calibration, and changes of the pose acted on."""

from __future__ import annotations

import logging
import threading
from collections import deque
from collections.abc import Callable
from dataclasses import KW_ONLY, dataclass, replace
from datetime import datetime, timedelta
from pathlib import Path

import numpy as np

from sunarc.calibration.lens_library.first_pose import north_sigma_deg
from sunarc.calibration.model.pose_change import PoseChange
from sunarc.calibration.model.result import Calibration, Verdict
from sunarc.calibration.model.sightings import MAX_CLOCK_ERROR_S
from sunarc.calibration.quality.first_motion import FEWEST_IN_MOTION, site_contradiction
from sunarc.changes.online import REMEMBERED, change_details, change_finding, update_window
from sunarc.changes.values import LENS_KINDS, Sighting, SightingWindow, WatchOptions
from sunarc.common.errors import InputError, OutsideError
from sunarc.common.findings import Finding
from sunarc.common.utc import MICROSECOND, utc_time
from sunarc.imager.archive.archive import CameraArchive
from sunarc.imager.archive.calibrations import EPOCH_CLOSED
from sunarc.imager.archive.epochs import LENS_CHANGED
from sunarc.imager.archive.move_pictures import MovePictures
from sunarc.imager.archive.pictures_of_one_time import ELSEWHERE
from sunarc.imager.archive.values import (
    CAMERA_CHANGES,
    TO_ACKNOWLEDGE,
    PoseEpoch,
    SunPoint,
)
from sunarc.imager.runtime.loop import DropOldestQueue, turns
from sunarc.imager.runtime.status import Reason, StatusRegistry, condition
from sunarc.imager.workers.calibrating.moves import MoveConditions
from sunarc.imager.workers.calibrating.provisional_pose import (
    FEWEST,
    ProvisionalPoseEstimator,
    is_first_pose,
    is_provisional,
)
from sunarc.optics.mounting import top_azimuth_deg
from sunarc.sky.site import Site
from sunarc.sky.sun import sun_directions

_log = logging.getLogger(__name__)
_POLL_S = 0.5
_WAITING = 256
_JITTER = timedelta(seconds=1)
"""A camera that dates its frames may be ahead of the time carried on from its last one by its own jitter."""
_POSE_CODES = ("provisional_pose", "first_pose_provisional", "provisional_calibration")
_SITE_CODES = ("sun_seen_below_horizon", "sun_contradicts_site")
_FIRST = 10
_FIRST_WITHIN_S = 7200.0
"""The last sightings of a camera without a calibration, whose motion is compared with the stated site's sun: an evening
and the next morning do not count."""
_FUTURE_EPOCH = "epoch_in_future"
_RECOVERED_AFTER = 4
"""Consecutive sightings that agree again before a fault of the clock, the image or the site is cleared."""
_MANY_AGREEING = 8
"""Sightings that agree with a turn before it takes the place of a step of a clock that nothing watches."""


@dataclass(eq=False)
class WatchWorker:
    """Worker that compares sightings with the active calibration, and acts on changes of the pose.

    Parameters
    ----------
    camera : its archive and site.
    options : thresholds of a change.
    reposer : poses the camera anew.
    now : frame time; sightings and pose epochs dated later are not used.
    board : where a change degrades the service.
    host_dates : whether the sightings' times are of the host's clock, whose steps are known.
    pictures : keeps those before and after a move; None keeps none.
    newest_picture : returns the newest picture's file, None without one.
    """

    camera: CameraArchive
    _: KW_ONLY
    options: WatchOptions
    reposer: ProvisionalPoseEstimator
    now: Callable[[], datetime]
    board: StatusRegistry
    host_dates: bool = True
    pictures: MovePictures | None = None
    newest_picture: Callable[[], Path | None] = lambda: None

    def __post_init__(self) -> None:
        """Begin with an empty window."""
        self._sightings: DropOldestQueue[Sighting] = DropOldestQueue(capacity=_WAITING)
        self._older_came = threading.Event()
        self._watch = SightingWindow()
        self._epoch: str | None = None
        self._has_future_epochs = False
        self._shown: str | None = None
        self._first: deque[Sighting] = deque(maxlen=_FIRST)
        self._fault: PoseChange | None = None
        self._agreeing = 0
        self._moves = MoveConditions(
            self.camera, self.board, pictures=self.pictures, newest_picture=self.newest_picture
        )

    def notice(
        self,
        time: datetime,
        *,
        x_px: float,
        y_px: float,
        sigma_px: float | None,
        clock_error_s: float | None = None,
    ) -> None:
        """Queue a sighting, unless its time is doubtful; never waits."""
        if clock_error_s is None or clock_error_s <= MAX_CLOCK_ERROR_S:
            self._sightings.put(self._make_sighting(time, x_px, y_px, sigma_px))

    def run(self, stop: threading.Event, heartbeat: Callable[[], None]) -> None:
        """Work until stopped; sightings from before the start are remembered first."""
        self.remember()
        for _ in turns(stop, heartbeat):
            self.process_next(timeout_s=_POLL_S)

    def remember(self) -> None:
        """Fill the window with the last sightings of the current pose epoch whose times are trusted and past."""
        self._watch = SightingWindow()
        epoch = self._present_epoch()
        self._epoch = None if epoch is None else epoch.id
        self._publish_future_epochs()
        if epoch is None:
            return
        # what an operator has judged is not judged again: the move would be found once more in the same sightings
        closed = self.camera.archive.events.find(
            self.camera.name, kind=EPOCH_CLOSED, until=self._latest_trusted_time(), limit=1
        )
        points = self.camera.archive.sightings.find(
            self.camera.name,
            since=max([epoch.started_at, *(event.time for event in closed)]),
            until=self._latest_trusted_time(),
            largest_clock_error_s=MAX_CLOCK_ERROR_S,
            newest_first=True,
            limit=2 * REMEMBERED,
        )
        usable = [point for point in points if point.accepted or point.verdict == ELSEWHERE][:REMEMBERED]
        for point in reversed(usable):
            self._process_safely(_as_sighting(point, self._make_sighting))

    def look_again(self) -> None:
        """Have the window filled again: older sightings than its last were stored; never waits."""
        self._older_came.set()

    def process_next(self, *, timeout_s: float = 0.0) -> bool:
        """Compare the next sighting, if there is one within `timeout_s`; return whether there was."""
        sighting = self._sightings.get(timeout_s=timeout_s)
        if sighting is not None or self._older_came.is_set():
            self._begin_anew_if_outdated()
        if sighting is not None:
            self._process_safely(sighting)
        self._moves.follow()
        if sighting is not None:
            self._moves.keep_pictures(utc_time(sighting.unix_s))
        return sighting is not None

    def _begin_anew_if_outdated(self) -> None:
        try:
            if self._epoch_changed():
                self._clear_move()
                self.remember()
            elif self._is_ahead() or (self._older_came.is_set() and self._fault is None):
                self._older_came.clear()
                self.remember()
            elif self._has_future_epochs:
                self._publish_future_epochs()
        except OutsideError as error:
            _log.warning("could not compare the pose epochs with the time: %s", error)

    def _latest_trusted_time(self) -> datetime:
        return self.now() + _JITTER

    def _present_epoch(self) -> PoseEpoch | None:
        return self.camera.archive.epochs.current(self.camera.name, at=self._latest_trusted_time())

    def _is_ahead(self) -> bool:
        """Return whether the time went back to before the remembered sightings."""
        return bool(len(self._watch)) and float(self._watch.unix_s[-1]) > self._latest_trusted_time().timestamp()

    def _epoch_changed(self) -> bool:
        """Return whether an operator, the refit worker or another camera changed the pose epoch."""
        epoch = self._present_epoch()
        return epoch is not None and epoch.id != self._epoch

    def _process_safely(self, sighting: Sighting) -> None:
        try:
            self._process_sighting(sighting)
        except (np.linalg.LinAlgError, InputError, OutsideError) as error:
            _log.warning("could not compare a sighting with the calibration: %s", error)

    def _process_sighting(self, sighting: Sighting) -> None:
        current = self._get_current_model()
        if sighting.unix_s > self._latest_trusted_time().timestamp():
            return
        if current is None:
            self._improve_first_pose(sighting)
            return
        if len(self._watch) and sighting.unix_s <= self._watch.unix_s[-1]:
            return
        site = self.camera.site_with_air_at(utc_time(sighting.unix_s))
        if site != self.camera.site:  # not in `notice`, which must not wait for the database
            sighting = replace(sighting, direction=_sun_direction(sighting.unix_s, site))
        self._watch, change = update_window(
            self._watch,
            sighting,
            calibration=current,
            site=site,
            options=self.options,
            clock_stepped=self._clock_stepped(),
            posed_from_few=is_provisional(current),
        )
        if self._is_turn_after_all(change):
            self._clear_fault()
        if self._fault is not None:
            self._wait_for_recovery(sighting)
        elif change is not None:
            self._act_on_change(change)
        if self.reposer.improve():
            self._publish_pose()

    def _improve_first_pose(self, sighting: Sighting) -> None:
        """Estimate the first pose of a camera with a known type of lens, and publish its progress."""
        self._compare_with_site(sighting)
        if self.reposer.first is None:
            return
        if self.reposer.improve():
            self._publish_pose()
            return
        n, refusal = self.reposer.count, self.reposer.refusal
        self.board.set_condition("first_sun", _waiting_condition(n, sighting.pixel) if n < FEWEST else None)
        self.board.set_condition("first_pose_refused", None if refusal is None else _refused_condition(refusal))

    def _compare_with_site(self, sighting: Sighting) -> None:
        """Set or clear the conditions of a sun whose path contradicts the stated site."""
        while self._first and abs(sighting.unix_s - self._first[0].unix_s) > _FIRST_WITHIN_S:
            self._first.popleft()
        self._first.append(sighting)
        if len(self._first) < FEWEST_IN_MOTION:  # what the evening showed stands until the morning shows something
            return
        record = self.camera.archive.cameras.get(self.camera.name)
        if record is None:
            return
        found = site_contradiction(
            np.array([one.unix_s for one in self._first]),
            np.array([one.pixel for one in self._first]),
            site=self.camera.site,
            image_size=record.image_size,
            mirrored=self.reposer.mirrored,
        )
        self._show_contradiction(found)

    def _show_contradiction(self, found: Finding | None) -> None:
        for code in _SITE_CODES:
            of_code = found is not None and found.code == code
            self.board.set_condition(code, Reason.of(found) if of_code and found is not None else None)

    def _act_on_change(self, change: PoseChange) -> None:
        """Report a change, and open an epoch or wait according to its cause."""
        at = utc_time(change.time)
        moved = change.cause == "bump" or change.cause in LENS_KINDS
        epoch = self._epoch_begun_by(change) if moved else None
        if epoch is not None:
            self._publish_change(change, epoch.started_at)
            self.camera.archive.sightings.readmit(self.camera.name, since=at, until=self._latest_trusted_time())
            return
        self._report_change(change, at)
        if moved:
            self._open_epoch(change, at)
        else:
            self._fault, self._agreeing = change, 0
            self.camera.archive.sightings.exclude(self.camera.name, change_finding(change), since=at)

    def _epoch_begun_by(self, change: PoseChange) -> PoseEpoch | None:
        """Return the present epoch where the move began it and no pose has been found since; None for another move."""
        epoch = self._present_epoch()
        if epoch is None or self._watch.unix_s[0] < change.time:
            return None
        reported = self.camera.archive.events.find(
            self.camera.name, kind=change.cause, since=epoch.started_at, until=self._latest_trusted_time()
        )
        return epoch if reported else None

    def _open_epoch(self, change: PoseChange, at: datetime) -> None:
        """Open a pose epoch at the first sighting after the change, and exclude those that may be of either side."""
        earliest = utc_time(change.bracket[0])
        ambiguous = Finding("sighting_ambiguous", {"earliest": earliest.isoformat()})
        self.camera.archive.sightings.exclude(self.camera.name, ambiguous, since=earliest + MICROSECOND, until=at)
        try:
            reason = LENS_CHANGED if change.cause in LENS_KINDS else change.cause
            self.camera.archive.epochs.open(self.camera.name, at=at, reason=reason)
        except InputError as error:  # the whole epoch is of the new pose or lens
            _log.info("%s", error)
        self.camera.archive.sightings.readmit(self.camera.name, since=at, until=self._latest_trusted_time())
        epoch = self._present_epoch()
        self._epoch = None if epoch is None else epoch.id
        current = self.camera.archive.calibrations.current(self.camera.name)
        if change.cause in LENS_KINDS:
            if current is not None:
                self.camera.archive.calibrations.retire(current.id, at=max(at, current.valid_from))
            self._watch = SightingWindow()
        else:
            self._watch = self._watch.since(change.time)

    def _is_turn_after_all(self, change: PoseChange | None) -> bool:
        """Return whether a change taken for a clock step by a few sightings is a turn by many."""
        if change is None or self._fault is None or self.host_dates:
            return False
        agreeing = int(change_finding(change).data["agreeing"])
        return (self._fault.cause, change.cause) == ("clock", "bump") and agreeing >= _MANY_AGREEING

    def _clear_fault(self) -> None:
        if self._fault is not None:
            self.board.set_condition(change_finding(self._fault).code, None)
            self._fault = None

    def _wait_for_recovery(self, sighting: Sighting) -> None:
        """Leave out sightings while the clock, the image or the site is wrong."""
        fault = self._fault
        if fault is None:
            return
        self._agreeing = self._agreeing + 1 if self._watch.trusted[-1] else 0
        if self._agreeing >= _RECOVERED_AFTER:
            self._clear_fault()
            return
        time = utc_time(sighting.unix_s)
        self.camera.archive.sightings.exclude(
            self.camera.name, change_finding(fault), since=time, until=time + MICROSECOND
        )

    def _report_change(self, change: PoseChange, at: datetime) -> None:
        details = change_details(change) | ({TO_ACKNOWLEDGE: True} if change.cause in CAMERA_CHANGES else {})
        self.camera.add_event(change_finding(change), time=at, severity="alarm", kind=change.cause, details=details)
        self._publish_change(change, at)

    def _publish_change(self, change: PoseChange, at: datetime) -> None:
        text = f"since {at.isoformat(timespec='seconds')}: {change_finding(change).text}"
        reason = Reason.of(change_finding(change))
        self.board.set_condition(reason.code, replace(reason, text=text, data=change_details(change)), log=False)

    def _clear_move(self) -> None:
        for kind in ("bump", *LENS_KINDS):
            self.board.set_condition(f"changed_{kind}", None)

    def _publish_pose(self) -> None:
        """Set or clear the conditions of a provisional pose; a full fit of the epoch clears them."""
        current = self._get_current_model()
        if current is None:
            return
        self._clear_move()
        if not is_provisional(current):
            self._first.clear()
            self._show_contradiction(None)
        reason = _pose_condition(current)
        for code in (*_POSE_CODES, "first_sun", "first_pose_refused"):
            self.board.set_condition(code, reason if reason is not None and reason.code == code else None)

    def _get_current_model(self) -> Calibration | None:
        """Return the served calibration, and show its pose where it is another calibration than before."""
        record = self.camera.archive.calibrations.current(self.camera.name)
        model = self.camera.archive.calibrations.current_model(self.camera.name)
        before, self._shown = self._shown, None if record is None else record.id
        if record is None:
            for code in _POSE_CODES:
                self.board.set_condition(code, None)
        elif model is not None and before != record.id:
            self._publish_pose()
        return model

    def _clock_stepped(self) -> bool | None:
        """Return whether the clock was set while the sightings in question were made; None where nothing watches it."""
        if not self.host_dates:
            return None
        if not len(self._watch):
            return False
        since = utc_time(float(self._watch.unix_s[max(len(self._watch) - 12, 0)]))
        events = self.camera.archive.events.find(self.camera.name, since=since)
        return any(event.kind == "clock_step" for event in events)

    def _publish_future_epochs(self) -> None:
        """Set or clear the condition of pose epochs that begin later than now: they block new ones."""
        epochs = self.camera.archive.epochs.find(self.camera.name)
        later = [epoch for epoch in epochs if epoch.started_at > self._latest_trusted_time()]
        self._has_future_epochs = bool(later)
        self.board.set_condition(_FUTURE_EPOCH, _future_epoch_reason(later[0]) if later else None)

    def _make_sighting(self, time: datetime, x_px: float, y_px: float, sigma_px: float | None) -> Sighting:
        return Sighting(
            unix_s=time.timestamp(),
            pixel=(x_px, y_px),
            direction=_sun_direction(time.timestamp(), self.camera.site),
            sigma_px=np.nan if sigma_px is None else sigma_px,
        )


def _as_sighting(point: SunPoint, watched: Callable[[datetime, float, float, float | None], Sighting]) -> Sighting:
    if point.x_px is None or point.y_px is None:
        raise InputError(field="sighting", problem="without a pixel", remedy="look at accepted ones")
    return watched(point.time, point.x_px, point.y_px, point.sigma_px)


def _sun_direction(unix_s: float, site: Site) -> tuple[float, float, float]:
    """Return the sun's apparent direction, east-north-up."""
    east, north, up = sun_directions(unix_s, site).tolist()
    return east, north, up


def _future_epoch_reason(epoch: PoseEpoch) -> Reason:
    return condition(_FUTURE_EPOCH, pose_epoch=epoch.id, started_at=epoch.started_at.isoformat(timespec="seconds"))


def _waiting_condition(n: int, pixel: tuple[float, float]) -> Reason:
    """Return the condition of a first pose that waits for sightings: how many there are, and where the last one is."""
    return condition("first_sun", n=n, least=FEWEST, x_px=pixel[0], y_px=pixel[1])


def _pose_condition(current: Calibration) -> Reason | None:
    """Return the condition of a pose that is provisional; None for that of a full fit."""
    if current.sigma_limit_deg is not None:
        return condition("provisional_calibration", limit_deg=current.sigma_limit_deg, n=current.evidence.n_used)
    if not is_provisional(current):
        return None
    if not is_first_pose(current):
        return condition("provisional_pose", n=current.evidence.n_used, sigma_deg=current.sky_rms_deg)
    return condition(
        "first_pose_provisional",
        n=current.evidence.n_used,
        sigma_deg=current.sky_rms_deg,
        north_sigma_deg=north_sigma_deg(current),
        top_azimuth_deg=top_azimuth_deg(current.camera),
    )


def _refused_condition(verdict: Verdict) -> Reason:
    """Return the condition of a first pose that is refused."""
    finding = verdict.findings[0]
    return condition("first_pose_refused", reason=finding.text, remedy=finding.remedy)
