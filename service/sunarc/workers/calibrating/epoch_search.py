"""Search of unmonitored sightings for steps of the pose, each of which begins a pose epoch."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from datetime import datetime

import numpy as np

from sunarc.archive.camera_archive import CameraArchive
from sunarc.archive.sighting_revisions import LENS_CHANGED
from sunarc.archive.values import Event, SunPointColumns
from sunarc.calibration.messages import MESSAGES as CHANGES
from sunarc.calibration.model.options import CalibrationOptions, ImageCircle
from sunarc.calibration.model.result import Calibration
from sunarc.calibration.model.sightings import MAX_CLOCK_ERROR_S
from sunarc.calibration.pose_step_search import PoseStep
from sunarc.errors import InputError
from sunarc.findings import Data, Finding
from sunarc.utc import DAY_S, utc_time
from sunarc.workers.calibrating.provisional_pose import is_provisional
from sunarc.workers.calibrating.solver_process import Problem
from sunarc.workers.fit_input import points_of
from sunarc.workers.messages import MESSAGES

SEARCHED = "epochs_searched"
"""Kind of the event that remembers up to which sighting the record was searched, and which epochs it divided."""

_BESIDE_S = 4.0 * DAY_S
"""Time about new sightings that is searched with them: a step at their first or last day needs days on both sides."""


@dataclass(frozen=True, slots=True)
class _Search:
    time: datetime
    last_id: int
    divided: tuple[str, ...]


class EpochSearch:
    """Selects the sightings to search, and stores the result.

    Sightings are searched once: all of them while no calibration was ever served, later those that were imported.
    What the service saw itself under a calibration is the monitor's.

    Parameters
    ----------
    camera : its archive and site.
    options, circle : how to fit.
    now : frame time, which dates events.
    """

    def __init__(
        self,
        camera: CameraArchive,
        *,
        options: CalibrationOptions,
        circle: ImageCircle | None,
        now: Callable[[], datetime],
    ) -> None:
        self._camera = camera
        self._options = options
        self._circle = circle
        self._now = now
        self._last_id = 0

    def due(self) -> Problem | None:
        """Return what is to be searched; None where nothing is new."""
        columns, record = self._near_new(), self._camera.record()
        if columns is None or record is None or float(np.ptp(columns.unix_s)) < DAY_S:
            return None
        self._last_id = int(columns.ids.max())
        return Problem(
            points=points_of(columns),
            site=self._camera.site,
            image_size=record.image_size,
            options=self._options,
            circle=self._circle,
            lens=self._lens(),
        )

    def _near_new(self) -> SunPointColumns | None:
        """Return the sightings that are new to the search, or lie within days of such; None where none are."""
        now = self._now()
        since = since_lens(self._camera, now)
        searched = max((search.last_id for search in self._searches()), default=0)
        method = None if self._camera.current_calibration() is None else "import"
        new = self._camera.sun_point_columns(since=since, until=now, method=method, after_id=searched).unix_s
        if new.size == 0:
            return None
        first = utc_time(new[0] - _BESIDE_S)
        columns = self._camera.sun_point_columns(
            since=first if since is None else max(since, first), until=min(now, utc_time(new[-1] + _BESIDE_S))
        )
        times = columns.unix_s
        index = np.searchsorted(new, times)
        after = np.append(new, np.inf)[index] - times
        before = times - np.insert(new, 0, -np.inf)[index]
        sure = ~(np.abs(np.nan_to_num(columns.clock_error_s)) > MAX_CLOCK_ERROR_S)
        near = sure & (np.minimum(after, before) <= _BESIDE_S)
        return columns.select(near) if np.any(near) else None

    def _lens(self) -> Calibration | None:
        """Return the calibration that is served, where it is a full fit that this version can read."""
        calibration = self._camera.current_model()
        return None if calibration is None or is_provisional(calibration) else calibration

    def keep(self, steps: tuple[PoseStep, ...]) -> None:
        """Open the epochs that steps begin, with an event each, and remember that the search was made."""
        divided: list[str] = []
        for step in steps:
            at = utc_time(step.after_unix_s)
            try:
                parts = self._camera.split_epoch(at=at, reason="bump")
            except InputError:  # an epoch begins there already
                continue
            divided += [part.id for part in parts]
            self._camera.add_event(
                _found(step, at), CHANGES, time=at, severity="warning", kind="bump", details={"searched": True}
            )
        found = Finding(SEARCHED, {"steps": len(steps), "last_id": self._last_id})
        self._camera.add_event(
            found, MESSAGES, time=self._now(), severity="info", details={"divided": sorted(set(divided))}
        )

    def unanswered(self, epoch: str) -> bool:
        """Return whether no calibration of a pose epoch answered since it has its present bounds."""
        served_at = self._camera.last_served(pose_epoch=epoch)
        now = self._now()
        divided = [search.time for search in self._searches() if epoch in search.divided]
        return served_at is None or any(served_at < time <= now for time in divided)

    def _searches(self) -> list[_Search]:
        """Return the searches that were made; one whose event is damaged says nothing."""
        events = self._camera.events(kind=SEARCHED)
        return [_search(event) for event in events]


def since_lens(camera: CameraArchive, now: datetime) -> datetime | None:
    """Return when the lens was last changed before now; None where it never was."""
    changed = [
        epoch.started_at for epoch in camera.epochs() if epoch.reason == LENS_CHANGED and epoch.started_at <= now
    ]
    return changed[-1] if changed else None


def _search(event: Event) -> _Search:
    """Return what an event says of a search; details with a flipped bit are read as far as they make sense."""
    last_id, divided = event.details.get("last_id"), event.details.get("divided")
    return _Search(
        event.time,
        last_id if isinstance(last_id, int) else 0,
        tuple(str(name) for name in divided) if isinstance(divided, list) else (),
    )


def _found(step: PoseStep, at: datetime) -> Finding:
    before = utc_time(step.before_unix_s).isoformat(timespec="seconds")
    data: Data = {"before": before, "after": at.isoformat(timespec="seconds"), "turn_deg": step.turn_deg}
    return Finding("pose_changed", data)
