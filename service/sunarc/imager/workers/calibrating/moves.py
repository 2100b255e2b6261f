"""Conditions of a camera that was moved, refocused or replaced: until it is fitted again, then until acknowledged."""

from __future__ import annotations

import logging
import math
from collections.abc import Callable, Iterable
from dataclasses import KW_ONLY, dataclass
from datetime import datetime
from pathlib import Path

from sunarc.common.errors import InputError, OutsideError
from sunarc.common.findings import Finding
from sunarc.common.messages import significant
from sunarc.imager.archive.archive import CameraArchive
from sunarc.imager.archive.move_pictures import MovePictures
from sunarc.imager.archive.values import CAMERA_CHANGES, Event
from sunarc.imager.runtime.status import Reason, StatusRegistry
from sunarc.imager.workers.calibrating.provisional_pose import is_provisional
from sunarc.optics.camera import Camera
from sunarc.optics.forward import distorted_radius, radius_slope
from sunarc.optics.inverse import largest_angle

_log = logging.getLogger(__name__)

_FITTED = "_fitted"
"""End of the code once a fit after the change was accepted."""
_LENS_WORDS = {"lens": "lens changed", "refocus": "focus changed", "shift": "lens shifted against the sensor"}
_NO_POSE, _PROVISIONAL = "no calibration since", "provisional pose since"
_FORMER = "served by an earlier calibration"


@dataclass(eq=False)
class MoveConditions:
    """Sets the conditions of the last move, the last change of the lens, and the last change of the camera.

    Parameters
    ----------
    camera : its archive.
    board : where they are set, as notes: the health is that of the other conditions.
    pictures : keeps those before and after a move; None keeps none.
    newest_picture : returns the newest picture's file, None without one.

    Attributes
    ----------
    waiting : the events that an operator has to acknowledge, the newest first.
    """

    camera: CameraArchive
    board: StatusRegistry
    _: KW_ONLY
    pictures: MovePictures | None = None
    newest_picture: Callable[[], Path | None] = lambda: None

    def __post_init__(self) -> None:
        """Begin without having read the archive."""
        self._revision: int | None = None
        self.waiting: tuple[Event, ...] = ()

    def follow(self) -> None:
        """Set and clear the conditions where anything was written to the archive."""
        try:
            revision = self.camera.archive.revision()
            if revision != self._revision:
                self._set_conditions(self.camera.archive.events.find(self.camera.name, severity="alarm"))
                self._revision = revision
        except OutsideError as error:
            _log.warning("could not look for moves of the camera: %s", error)

    def keep_pictures(self, at: datetime) -> None:
        """Copy the newest picture now and then, and keep those before and after the moves that wait.

        Parameters
        ----------
        at : time of the last sighting.
        """
        if self.pictures is None:
            return
        try:
            incomplete = [event for event in self.waiting if not self.pictures.is_complete(event)]
            is_due = self.pictures.is_due(at)
            newest = self.newest_picture() if incomplete or is_due else None
            if newest is None:
                return
            for event in incomplete:
                self.pictures.keep(event, newest, sighted_at=at)
            if is_due:
                self.pictures.remember(newest, sighted_at=at)
        except (OSError, OutsideError) as error:
            _log.warning("could not keep a picture: %s", error)

    def _set_conditions(self, alarms: Iterable[Event]) -> None:
        last: dict[str, Event] = {}
        alarms = tuple(alarms)
        self.waiting = tuple(event for event in alarms if event.to_acknowledge)
        for event in alarms:  # the newest first
            if event.kind in CAMERA_CHANGES:
                last.setdefault(CAMERA_CHANGES[event.kind], event)
        pose = self._get_pose_state(min((event.time for event in last.values()), default=None))
        for code in set(CAMERA_CHANGES.values()):
            reason = self._make_condition(code, last[code], pose) if code in last else None
            for one in (code, code + _FITTED):
                shown = reason is not None and reason.code == one
                self.board.set_condition(one, reason if shown else None, log=False)

    def _make_condition(self, code: str, event: Event, pose: _PoseState) -> Reason | None:
        if event.time in pose.closed:
            return None
        if pose.fitted_from is None or pose.fitted_from < event.time:
            return move_condition(code, event, since=pose.words + _error_text(event, pose.served))
        return move_condition(code + _FITTED, event) if event.to_acknowledge else None

    def _get_pose_state(self, earliest: datetime | None) -> _PoseState:
        """Return the state of the present pose; nothing is read where `earliest` is None."""
        if earliest is None:
            return _PoseState(None, _NO_POSE, frozenset())
        archive, name = self.camera.archive, self.camera.name
        epochs = archive.epochs.find(name, include_closed=True)
        present = {epoch.id: epoch.started_at for epoch in archive.epochs.find(name)}
        closed = frozenset(epoch.started_at for epoch in epochs if epoch.id not in present)
        record = archive.calibrations.current(name)
        if record is None:
            return _PoseState(None, _NO_POSE, closed)
        try:
            model = archive.calibrations.model(record.id)
        except InputError:
            return _PoseState(None, _NO_POSE, closed)
        if is_provisional(model):
            return _PoseState(None, _PROVISIONAL, closed)
        return _PoseState(present.get(record.pose_epoch or "", record.valid_from), _FORMER, closed, model.camera)


@dataclass(frozen=True, slots=True)
class _PoseState:
    """State of the present pose.

    Attributes
    ----------
    fitted_from : beginning of the pose epoch of which a full fit is served; None where none is.
    words : what answers since a move that is later.
    closed : beginnings of the pose epochs that were closed as wrong.
    served : camera of the full fit that is served; None without one.
    """

    fitted_from: datetime | None
    words: str
    closed: frozenset[datetime]
    served: Camera | None = None


def move_condition(code: str, event: Event, *, since: str = "") -> Reason:
    """Return the condition of a move, a change of the lens or of the camera.

    Parameters
    ----------
    code : of the condition.
    event : what happened.
    since : in words, what answers since then; not where a fit after it was accepted.
    """
    number = event.id or 0
    date = f"{event.time:%-d %b %Y %H:%M} UTC"
    size, sigma = (_number_or_nan(event, name) for name in ("size", "sigma"))
    change = _LENS_WORDS.get(event.kind, event.kind)
    serials = {name: str(event.details.get(name, "")) for name in ("serial", "serial_before")}
    found = {
        "camera_moved": Finding(
            "camera_moved", {"size": size, "sigma": sigma, "date": date, "since": since, "event": number}
        ),
        "camera_moved_fitted": Finding(
            "camera_moved_fitted", {"size": size, "sigma": sigma, "date": date, "event": number}
        ),
        "lens_changed": Finding("lens_changed", {"change": change, "date": date, "since": since, "event": number}),
        "lens_changed_fitted": Finding("lens_changed_fitted", {"change": change, "date": date, "event": number}),
        "camera_replaced": Finding(
            "camera_replaced",
            {
                "model": str(event.details.get("model", "")),
                "serial": serials["serial"],
                "serial_before": serials["serial_before"],
                "calibration": str(event.details.get("calibration") or "none"),
            },
        ),
        "camera_replaced_fitted": Finding(
            "camera_replaced_fitted",
            {"serial": serials["serial"], "serial_before": serials["serial_before"], "date": date, "event": number},
        ),
    }
    return Reason.of(found[code], severity="note")


def _error_text(event: Event, served: Camera | None) -> str:
    """Return in words by how much an earlier calibration is wrong after a change of the lens; else nothing."""
    if served is None or event.kind not in _LENS_WORDS:
        return ""
    percent = abs(_number_or_nan(event, "size"))
    if event.kind != "refocus" or not percent > 0.0:
        return " (its directions are those of the lens before)"
    error_deg = largest_scale_error_deg(served, percent / 100.0)
    return f" (its directions are wrong by up to {significant(error_deg, 1)}°, at the horizon)"


def largest_scale_error_deg(camera: Camera, fraction: float) -> float:
    """Return by how much directions are wrong, degrees, that are 90° from the axis, or at the edge of a narrower field.

    Parameters
    ----------
    camera : its focal length is used after it has changed.
    fraction : of the focal length, by which it has grown.
    """
    theta = min(math.pi / 2.0, largest_angle(camera))
    radius, slope = distorted_radius(camera, theta), radius_slope(camera, theta)
    return math.degrees(abs(fraction) * float(radius) / float(slope))


def _number_or_nan(event: Event, name: str) -> float:
    value = event.details.get(name)
    return float(value) if isinstance(value, int | float) else math.nan
