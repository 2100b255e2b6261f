"""Refits in a child process; the result is activated when it is better than the current calibration."""

from __future__ import annotations

import logging
import threading
import uuid
from collections.abc import Callable, Sequence
from dataclasses import KW_ONLY, asdict, dataclass, field, replace
from datetime import UTC, datetime, timedelta
from itertools import pairwise
from typing import TypeVar

import numpy as np

import sunarc
from sunarc.calibration.acceptance import pose_spread_deg, unseen_points
from sunarc.calibration.model.options import CalibrationOptions, ImageCircle
from sunarc.calibration.model.pose_change import PoseChange
from sunarc.calibration.model.result import Calibration, Verdict
from sunarc.calibration.model.sightings import MAX_CLOCK_ERROR_S
from sunarc.calibration.projection_choice import options_as_served
from sunarc.calibration.quality.day_quality import days_left_out
from sunarc.calibration.quality.fit_checks import is_tilt_shown
from sunarc.calibration.quality.tilt import LEVEL_DEG, proposed_limit_deg
from sunarc.calibration.quality.widening import add_pose_spread
from sunarc.calibration.selection import Selection, SelectionOptions, pick_surest_in_epochs, select_sightings
from sunarc.calibration.verdict import accept, add_stated_clock, provisional
from sunarc.common.array_types import IntArray
from sunarc.common.errors import InputError, NotFoundError
from sunarc.common.findings import Data, Finding
from sunarc.common.utc import DAY_S, rfc3339, utc_time
from sunarc.formats.calibration_document import to_document
from sunarc.imager.archive.archive import CameraArchive
from sunarc.imager.archive.epochs import LENS_CHANGED
from sunarc.imager.archive.values import (
    CalibrationRecord,
    Event,
    EventSeverity,
    PoseEpoch,
    Refit,
    RefitState,
    SunPointColumns,
)
from sunarc.imager.runtime.clock import Clock
from sunarc.imager.runtime.loop import Loop
from sunarc.imager.runtime.status import Reason, StatusRegistry, condition
from sunarc.imager.workers.calibrating import solver_process
from sunarc.imager.workers.calibrating.provisional_pose import is_provisional
from sunarc.imager.workers.options import RefitOptions
from sunarc.sky.days import solar_date
from sunarc.sky.night import SUN

SEARCHED = "epochs_searched"
"""Kind of the event that remembers up to which sighting the record was searched, and which epochs it divided."""

_BESIDE_S = 4.0 * DAY_S
"""Time about new sightings that is searched with them: a step at their first or last day needs days on both sides."""


@dataclass(frozen=True, slots=True)
class _SearchRecord:
    time: datetime
    last_id: int
    divided: tuple[str, ...]


@dataclass(eq=False)
class EpochSearch:
    """Search for steps of the pose: selection of its sightings, and storage of its result.

    Sightings are searched once: all of them while no calibration was ever served, later those that were imported.
    What the service saw itself under a calibration is the monitor's.

    Parameters
    ----------
    camera : its archive and site.
    options, circle : how to fit.
    now : frame time, which dates events.
    """

    camera: CameraArchive
    _: KW_ONLY
    options: CalibrationOptions
    circle: ImageCircle | None
    now: Callable[[], datetime]
    _last_id: int = field(default=0, init=False)

    def due(self) -> solver_process.SolveProblem | None:
        """Return the search that is due; None where nothing is new."""
        columns, record = self._select_near_new(), self.camera.archive.cameras.get(self.camera.name)
        if columns is None or record is None or float(np.ptp(columns.unix_s)) < DAY_S:
            return None
        self._last_id = int(columns.ids.max())
        return solver_process.SolveProblem(
            points=solver_process.columns_to_sightings(columns),
            site=self.camera.site,
            image_size=record.image_size,
            options=self.options,
            circle=self.circle,
            lens=self._find_served_lens(),
        )

    def _select_near_new(self) -> SunPointColumns | None:
        """Return the sightings not yet searched and those within days of them; None where no sighting is new."""
        now = self.now()
        since = since_lens(self.camera, now)
        searched = max((search.last_id for search in self._read_searches()), default=0)
        method = None if self.camera.archive.calibrations.current(self.camera.name) is None else "import"
        new = self.camera.archive.sightings.columns(
            self.camera.name, since=since, until=now, method=method, after_id=searched
        ).unix_s
        if new.size == 0:
            return None
        first = utc_time(new[0] - _BESIDE_S)
        columns = self.camera.archive.sightings.columns(
            self.camera.name,
            since=first if since is None else max(since, first),
            until=min(now, utc_time(new[-1] + _BESIDE_S)),
        )
        times = columns.unix_s
        index = np.searchsorted(new, times)
        after = np.append(new, np.inf)[index] - times
        before = times - np.insert(new, 0, -np.inf)[index]
        sure = ~(np.abs(np.nan_to_num(columns.clock_error_s)) > MAX_CLOCK_ERROR_S)
        near = sure & (np.minimum(after, before) <= _BESIDE_S)
        return columns.select(near) if np.any(near) else None

    def _find_served_lens(self) -> Calibration | None:
        """Return the calibration that is served, where it is a full fit that this version can read."""
        calibration = self.camera.archive.calibrations.current_model(self.camera.name)
        return None if calibration is None or is_provisional(calibration) else calibration

    def keep(self, steps: tuple[PoseChange, ...]) -> None:
        """Open the pose epochs that steps begin, with an event each, and store that the search was made."""
        divided: list[str] = []
        for step in steps:
            at = utc_time(step.time)
            try:
                parts = self.camera.archive.epochs.split(self.camera.name, at=at, reason="bump")
            except InputError:  # an epoch begins there already
                continue
            divided += [part.id for part in parts]
            self.camera.add_event(
                _step_finding(step, at), time=at, severity="warning", kind="bump", details={"searched": True}
            )
        found = Finding(SEARCHED, {"steps": len(steps), "last_id": self._last_id})
        self.camera.add_event(found, time=self.now(), severity="info", details={"divided": sorted(set(divided))})

    def unanswered(self, epoch: str) -> bool:
        """Return whether no calibration has answered for a pose epoch since its bounds were set."""
        served_at = self.camera.archive.calibrations.last_served(self.camera.name, pose_epoch=epoch)
        now = self.now()
        divided = [search.time for search in self._read_searches() if epoch in search.divided]
        return served_at is None or any(served_at < time <= now for time in divided)

    def _read_searches(self) -> list[_SearchRecord]:
        """Return the searches that were made; one whose event is damaged is empty."""
        events = self.camera.archive.events.find(self.camera.name, kind=SEARCHED)
        return [_parse_search(event) for event in events]


def since_lens(camera: CameraArchive, now: datetime) -> datetime | None:
    """Return the time of the last change of the lens; None where it never changed."""
    changed = [
        epoch.started_at
        for epoch in camera.archive.epochs.find(camera.name)
        if epoch.reason == LENS_CHANGED and epoch.started_at <= now
    ]
    return changed[-1] if changed else None


def _parse_search(event: Event) -> _SearchRecord:
    """Return an event's record of a search; details with a flipped bit are read as far as they make sense."""
    last_id, divided = event.details.get("last_id"), event.details.get("divided")
    return _SearchRecord(
        event.time,
        last_id if isinstance(last_id, int) else 0,
        tuple(str(name) for name in divided) if isinstance(divided, list) else (),
    )


def _step_finding(step: PoseChange, at: datetime) -> Finding:
    before = utc_time(step.bracket[0]).isoformat(timespec="seconds")
    data: Data = {"before": before, "after": at.isoformat(timespec="seconds"), "turn_deg": step.turn_deg}
    return Finding("pose_changed", data)


# Input of a refit from the archive.

_LIMITS = SelectionOptions()


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RefitTask:
    """Fit to be made, and the sightings of the archive that it is given.

    Attributes
    ----------
    problem : for the child process.
    used : the sightings, as columns of the archive.
    selection : how they were picked.
    """

    problem: solver_process.SolveProblem
    used: SunPointColumns
    selection: Selection

    @property
    def pose_epoch(self) -> str:
        """The pose epoch of the result."""
        return self.used.epoch_ids[-1]

    def for_epoch(self, epoch: str) -> solver_process.SolveProblem:
        """Return the same task for another pose epoch."""
        return replace(
            self.problem, points=solver_process.columns_to_sightings(self.used, site=self.problem.site, latest=epoch)
        )

    def state_selection(self, solved: Calibration) -> Calibration:
        """Return a calibration whose provenance states how its sightings were selected."""
        counts = {**asdict(_LIMITS), **self.selection.counts()}
        return replace(solved, evidence=replace(solved.evidence, selection=counts))


def next_task(
    camera: CameraArchive,
    *,
    cadence_s: float,
    options: CalibrationOptions,
    circle: ImageCircle | None,
    now: datetime,
) -> RefitTask | Finding:
    """Return the next task of a camera's record; or the reason why there is nothing to solve."""
    record, since = camera.archive.cameras.get(camera.name), since_lens(camera, now)
    read = camera.archive.sightings.candidates(camera.name, since=since, until=now)
    if record is None or read.ids.size == 0:
        return Finding("no_accepted_sightings")
    left_out = days_left_out({day.date: day.verdict for day in camera.archive.days.find(camera.name)})
    selection = select_sightings(
        read.candidates,
        site=camera.site,
        slot_s=cadence_s,
        options=_LIMITS,
        left_out_days=np.array(left_out),
    )
    if selection.index.size == 0:
        counts = {
            "n": selection.n_supplied,
            "n_doubtful_clock": selection.n_doubtful_clock,
            "n_other_days": selection.n_other_days,
        }
        return Finding("no_usable_sightings", counts)
    epochs = [read.epoch_ids[number] for number in np.unique(read.candidates.epoch[selection.index]).tolist()]
    others = camera.archive.sightings.columns(camera.name, since=since, until=now, body=None, no_sun=True)
    stars = _select_stars(others, epochs, record.image_size)
    used = camera.archive.sightings.by_ids(camera.name, np.concatenate([read.ids[selection.index], stars]))
    if not np.any(used.body == SUN):  # deleted meanwhile
        return Finding("no_accepted_sightings")
    problem = solver_process.SolveProblem(
        points=solver_process.columns_to_sightings(used, site=camera.site),
        site=camera.site,
        image_size=record.image_size,
        options=options,
        circle=circle,
        tilt_known=_is_tilt_known(camera),
    )
    return RefitTask(problem=problem, used=used, selection=selection)


_SAME_SITE_DEG = 0.1
"""Difference of latitude or longitude up to which a site was surveyed better: it turns directions by as much."""


def _is_tilt_known(camera: CameraArchive) -> bool:
    """Return whether a calibration is served that was accepted at this site: a tilt since then is not asked about."""
    served = camera.archive.calibrations.current_model(camera.name)
    if served is None or not served.verdict.accepted:
        return False
    before, site = served.site, camera.site
    off_deg = abs(before.latitude - site.latitude), abs(before.longitude - site.longitude)
    return max(off_deg) < _SAME_SITE_DEG


def _select_stars(others: SunPointColumns, epochs: Sequence[str], image_size: tuple[int, int]) -> IntArray:
    """Return the keys of the most certain stars and planets of each part of the image.

    Of the pose epochs that the sun was seen in; those of the latest epoch first, then of the others.
    """
    with_sun = np.array([name in epochs for name in others.epoch_ids], dtype=bool)
    usable = with_sun[others.epoch] & (np.nan_to_num(others.clock_error_s) <= MAX_CLOCK_ERROR_S)
    rows = np.flatnonzero(usable)
    chosen = pick_surest_in_epochs(others.pixels[rows], others.sigma_px[rows], others.epoch[rows], image_size)
    return others.ids[rows[chosen]]


_log = logging.getLogger(__name__)

_POLL_S = 0.5
_LONGEST_WAIT_S = DAY_S
"""How long a refit waits for a time that can be trusted; the day's own refit comes again after the next clear day."""
_DAYS_OF_SPREAD = 60
_Answer = TypeVar("_Answer")
_MOST_PAST = 8
"""Earlier pose epochs that one refit solves for; each costs as long as the fit itself."""


@dataclass(eq=False)
class RefitWorker:
    """Worker that carries out the archive's refits, one at a time.

    Parameters
    ----------
    camera : its archive and site.
    options, calibration : the limits, and how to fit.
    cadence_s : how often the sun is observed.
    clock : real time.
    now : frame time, which dates calibrations.
    board : where the lack of a calibration is shown.
    may_solve : whether a refit may begin now; the others wait.
    solve, search : how a problem is solved, and searched for pose epochs; see `solve_in_child`, `search_in_child`.
    keep_provisional : whether a fit that its sightings do not determine is kept as a candidate, see `provisional`.
    clock_error_s, clock_assumed : the clock that is stated for all sightings, see `add_stated_clock`.
    """

    camera: CameraArchive
    _: KW_ONLY
    options: RefitOptions
    calibration: CalibrationOptions
    cadence_s: float
    clock: Clock
    now: Callable[[], datetime]
    board: StatusRegistry
    may_solve: Callable[[], bool] = lambda: True
    solve: Callable[..., Calibration | None] = solver_process.solve_in_child
    search: Callable[..., tuple[PoseChange, ...] | None] = solver_process.search_in_child
    keep_provisional: bool = False
    clock_error_s: float | None = None
    clock_assumed: bool = False

    def __post_init__(self) -> None:
        """Begin without a refit that waits."""
        self._integrity = CalibrationIntegrityCheck(
            self.camera, now=self.now, board=self.board, level_within_deg=self.calibration.level_within_deg
        )
        self._waits_since_s: float | None = None
        self._epochs = EpochSearch(
            self.camera,
            options=self.calibration,
            circle=self._make_circle(),
            now=self.now,
        )

    def run(self, stop: threading.Event, heartbeat: Callable[[], None]) -> None:
        """Work until stopped; a refit that was cut short is begun again at the next start."""
        self._integrity.check()
        loop = Loop(self.clock, stop, heartbeat)
        for _ in loop.turns():
            self._integrity.follow()
            waiting = self.camera.archive.refits.find(self.camera.name, unfinished=True)
            if waiting and self.may_solve():
                self._set_waiting(0)
                self.carry_out(waiting[-1], stop, heartbeat)
            else:
                self.let_wait(waiting)
                loop.wait(_POLL_S)

    def let_wait(self, waiting: Sequence[Refit]) -> None:
        """Set the condition of refits that wait; those that have waited for a day fail."""
        self._set_waiting(len(waiting))
        if self._waits_since_s is not None and self.clock.monotonic() - self._waits_since_s > _LONGEST_WAIT_S:
            for refit in waiting:
                self._finish_refit(
                    refit, "failed", (Finding("refit_not_begun", {"limit_h": _LONGEST_WAIT_S / 3600.0}),)
                )
            self._set_waiting(0)

    def _set_waiting(self, n: int) -> None:
        if n == 0:
            self._waits_since_s = None
        elif self._waits_since_s is None:
            self._waits_since_s = self.clock.monotonic()
        reason = condition("refit_waiting", n=n, limit_h=_LONGEST_WAIT_S / 3600.0)
        self.board.set_condition("refit_waiting", reason if n else None)

    def carry_out(self, refit: Refit, stop: threading.Event, heartbeat: Callable[[], None]) -> None:
        """Fit, judge and store a calibration, and serve it if it is better; left unfinished when stopped half-way."""
        self.camera.archive.refits.start(refit.id, started_at=self.now())
        child = solver_process.ChildControl(self.clock, self.options.time_limit_s, stop, heartbeat)
        self._search_epochs(child)
        # Left unfinished in the archive: the next start begins it again.
        if stop.is_set():
            return
        served = self.camera.archive.calibrations.current_model(self.camera.name)
        task = next_task(
            self.camera,
            cadence_s=self.cadence_s,
            options=options_as_served(self.calibration, served),
            circle=self._make_circle(),
            now=self.now(),
        )
        if isinstance(task, Finding):
            self._finish_refit(refit, "failed", (task,))
            return
        try:
            solved = _run_in_child(self.solve, task.problem, child)
        except solver_process.SolveFailedError as error:
            self._finish_refit(refit, "failed", (error.finding,))
            return
        if solved is not None:
            self._judge_and_store(refit, task, task.state_selection(solved))
        if solved is not None and solved.verdict.accepted:
            self._answer_for_past(task, child)

    def _make_circle(self) -> ImageCircle | None:
        numbers = self.options.image_circle_px
        return None if numbers is None else ImageCircle(x=numbers[0], y=numbers[1], radius=numbers[2])

    def _search_epochs(self, child: solver_process.ChildControl) -> None:
        """Open the pose epochs in sightings that no monitoring has compared with a calibration."""
        problem = self._epochs.due()
        if problem is None:
            return
        try:
            steps = _run_in_child(self.search, problem, child)
        except solver_process.SolveFailedError as error:  # the fit says itself when it cannot do with one pose
            _log.warning("pose epochs were not searched for: %s", error)
            return
        if steps is not None:
            self._epochs.keep(steps)

    def _answer_for_past(self, task: RefitTask, child: solver_process.ChildControl) -> None:
        """Serve earlier pose epochs without a calibration: each with its own pose, and the lens of all sightings."""
        epochs = self.camera.archive.epochs.find(self.camera.name)
        ends = {epoch.id: next_.started_at for epoch, next_ in pairwise(epochs)}
        starts = {epoch.id: epoch.started_at for epoch in epochs}
        waiting = [epoch for epoch in task.used.epoch_ids[:-1] if epoch in ends and self._epochs.unanswered(epoch)]
        for epoch in reversed(waiting[-_MOST_PAST:]):
            try:
                solved = _run_in_child(self.solve, task.for_epoch(epoch), child)
            except solver_process.SolveFailedError as error:
                _log.warning("no calibration of pose epoch %s: %s", epoch, error)
                continue
            if solved is None:
                return
            solved = task.state_selection(solved)
            record = self._store_calibration(task, replace(solved, verdict=accept(solved)), None, pose_epoch=epoch)
            if record.accepted:
                self.camera.archive.calibrations.answer_between(record.id, since=starts[epoch], until=ends[epoch])

    def _judge_and_store(self, refit: Refit, task: RefitTask, solved: Calibration) -> None:
        current = self.camera.archive.calibrations.current(self.camera.name)
        epoch = self.camera.archive.epochs.current(self.camera.name, at=self.now())
        solved = add_pose_spread(solved, self._measure_pose_spread(epoch))
        if self.keep_provisional:
            solved = provisional(solved, limit_deg=self.calibration.max_sky_deg)
        if epoch is not None and task.pose_epoch != epoch.id:
            moved = Finding("moved_since", {"time": epoch.started_at.isoformat()})
            solved = replace(solved, verdict=Verdict(accepted=False, findings=(moved,)))
        else:
            solved = replace(solved, verdict=self._make_verdict(task, solved, current))
        record = self._store_calibration(task, solved, current)
        state: RefitState = "accepted" if record.accepted else "marginal" if solved.verdict.marginal else "refused"
        is_active = record.accepted and self.camera.archive.calibrations.activate(record.id).state == "current"
        pinned = (Finding("active_is_pinned"),) if record.accepted and not is_active else ()
        self._finish_refit(refit, state, (*record.findings, *pinned), calibration=record.id)
        self._integrity.check()

    def _measure_pose_spread(self, epoch: PoseEpoch | None) -> tuple[float, float, float]:
        """Return the scatter of the pose over the last days of the open epoch."""
        if epoch is None:
            return pose_spread_deg((), ())
        since = solar_date(epoch.started_at.timestamp(), longitude=self.camera.site.longitude) + timedelta(days=1)
        days = self.camera.archive.days.find(self.camera.name, since=since, limit=_DAYS_OF_SPREAD)
        offsets = [(d.pose_offset_deg, d.pose_offset_sigma_deg) for d in days]
        known = [(offset, sigma) for offset, sigma in offsets if offset and sigma]
        return pose_spread_deg([offset for offset, _ in known], [sigma for _, sigma in known])

    def _make_verdict(self, task: RefitTask, solved: Calibration, current: CalibrationRecord | None) -> Verdict:
        if current is None:
            return accept(solved)
        try:
            before = self.camera.archive.calibrations.model(current.id)
        except InputError as error:
            unreadable = Finding("active_unreadable", {"calibration": current.id, "error": str(error)})
            return Verdict(accepted=False, marginal=True, findings=(unreadable,))
        if before.sigma_limit_deg is not None and solved.verdict.accepted:
            return accept(solved)  # what is provisional gives way
        same = current.pose_epoch == task.pose_epoch
        verdict = accept(solved, before, same_pose=same, unseen=unseen_points(task.problem.points, before))
        if verdict.marginal and self.camera.archive.calibrations.damaged(self.camera.name) is not None:
            # what it was compared with only stands in for the damaged current one, and has to be replaced
            return Verdict(accepted=True, findings=(Finding("replaces_damaged"), *verdict.findings))
        return verdict

    def _store_calibration(
        self, task: RefitTask, solved: Calibration, current: CalibrationRecord | None, *, pose_epoch: str | None = None
    ) -> CalibrationRecord:
        """Store the calibration; the first one of a pose epoch answers from the epoch's beginning."""
        now, epoch = self.now(), pose_epoch or task.pose_epoch
        document = to_document(
            add_stated_clock(solved, self.clock_error_s, assumed=self.clock_assumed),
            id=f"{now.astimezone(UTC):%Y%m%dT%H%M%SZ}-{uuid.uuid4().hex[:6]}",
            camera=self.camera.name,
            state="candidate" if solved.verdict.accepted or solved.verdict.marginal else "refused",
            created_at=now,
            valid_from=self._find_start_of_answers(epoch, now),
            valid_until=None,
            pose_epoch=epoch,
            software_version=sunarc.__version__,
        )
        return self.camera.archive.calibrations.add(
            document, parent=None if current is None else current.id, used=task.used
        )

    def _find_start_of_answers(self, pose_epoch: str, now: datetime) -> datetime:
        if not self._epochs.unanswered(pose_epoch):
            return now
        started = {epoch.id: epoch.started_at for epoch in self.camera.archive.epochs.find(self.camera.name)}
        return started.get(pose_epoch, now)

    def _finish_refit(
        self, refit: Refit, state: RefitState, findings: tuple[Finding, ...], *, calibration: str | None = None
    ) -> None:
        now, message = self.now(), "; ".join(one.text for one in findings)
        self.camera.archive.refits.finish(
            refit.id, state=state, finished_at=now, calibration=calibration, message=message, findings=findings
        )
        served = self.camera.archive.calibrations.current(self.camera.name)
        still = (
            "no calibration is served yet"
            if served is None
            else f"the calibration of {_write_date(served)} is still served"
        )
        found = Finding(f"refit_{state}", {"refit": refit.id, "message": message, "served": still})
        severity: EventSeverity = "info" if state == "accepted" else "warning"
        self.camera.add_event(found, time=now, severity=severity, details={"calibration": calibration})


def _write_date(record: CalibrationRecord) -> str:
    return f"{record.created_at.astimezone(UTC):%d %b %Y}"


def _run_in_child(
    run: Callable[..., _Answer], problem: solver_process.SolveProblem, child: solver_process.ChildControl
) -> _Answer:
    """Solve or search, and once more where the process died: it may have been killed for another's need of memory."""
    try:
        return run(problem, child)
    except solver_process.SolverDiedError as error:
        _log.warning("%s; starting it once more", error)
        return run(problem, child)


# Integrity of stored calibrations: changes by hand or by other versions are reported once.

_CODES = ("no_calibration", "calibration_unreadable", "calibration_damaged")
_COUNT_AGAIN = timedelta(minutes=1)
"""Between two counts of the sightings of a camera without a calibration, in frame time."""
_NOT_ACCEPTED = frozenset({"refused", "marginal", "failed"})
_REFITS_LOOKED_AT = 10


@dataclass(eq=False)
class CalibrationIntegrityCheck:
    """Check that the current calibration can be read, and that its sightings are still stored.

    For a damaged one a refit is asked for at once, in its place.

    Parameters
    ----------
    camera : its archive.
    now : frame time, which dates events.
    board : where the lack of a calibration that can be used is shown.
    level_within_deg : the tilt that is stated; None where none is.
    """

    camera: CameraArchive
    _: KW_ONLY
    now: Callable[[], datetime]
    board: StatusRegistry
    level_within_deg: float | None = None

    def __post_init__(self) -> None:
        """Begin without a check."""
        self._revision: int | None = None
        self._current: str | None = None
        self._checked_at: datetime | None = None

    def follow(self) -> None:
        """Check again where another calibration is current than at the last check, and each minute without one."""
        revision = self.camera.archive.revision()
        if revision == self._revision:
            return
        now = self.now()
        is_old = self._checked_at is None or abs(now - self._checked_at) >= _COUNT_AGAIN
        current = self.camera.archive.calibrations.current(self.camera.name)
        if (None if current is None else current.id) != self._current or (current is None and is_old):
            self.check()
        if current is not None or is_old:
            self._revision = revision

    def check(self) -> None:
        """Check, set the condition, and store an event the first time."""
        current = self.camera.archive.calibrations.current(self.camera.name)
        self._current = None if current is None else current.id
        self._checked_at = self.now()
        without = None if current is not None else self._missing_condition()
        self.board.set_one_condition(_CODES, self._make_condition(current, without))
        is_first = without is not None and "n" in without.data
        self.board.set_condition("no_fit_accepted", self._not_accepted_condition() if is_first else None)
        self.board.set_condition("tilt_unstated", self._unstated_tilt_condition(current))
        if current is not None:
            self._check_sightings(current)

    def _missing_condition(self) -> Reason:
        """Return the condition `no_calibration`: the first is awaited, or the last has ended."""
        archive, name, now = self.camera.archive, self.camera.name, self.now()
        ended = [one for one in archive.calibrations.find(name, state="retired") if one.valid_until is not None]
        if not ended:
            return condition("no_calibration", n=archive.sightings.count_accepted_suns(name))
        last = max(ended, key=lambda one: one.valid_until or one.valid_from)
        created_at, ended_at = (
            rfc3339(time or now, timespec="minutes") for time in (last.created_at, last.valid_until)
        )
        found = Finding("calibration_ended", {"calibration": last.id, "created_at": created_at, "ended_at": ended_at})
        return Reason.of(found, code="no_calibration")

    def _not_accepted_condition(self) -> Reason | None:
        """Return that the fits of a camera that was never calibrated were not accepted, with the last one's reason."""
        refits = self.camera.archive.refits.find(self.camera.name, limit=_REFITS_LOOKED_AT)
        last = next((one for one in refits if one.state in _NOT_ACCEPTED), None)
        if last is None:
            return None
        remedy = next((one.remedy for one in last.findings if one.remedy != "none"), "see /v1/refits")
        return condition("no_fit_accepted", state=last.state, message=last.message, remedy=remedy)

    def _make_condition(self, current: CalibrationRecord | None, without: Reason | None) -> Reason | None:
        damaged = self.camera.archive.calibrations.damaged(self.camera.name)
        reason = without
        if damaged is not None:
            active = "no calibration" if current is None else current.id
            reason = self._report_damage("calibration_damaged", calibration=damaged, served=active)
        if current is not None:
            try:
                self.camera.archive.calibrations.model(current.id)
            except InputError as error:
                reason = self._report_damage("calibration_unreadable", calibration=current.id, error=str(error))
        return reason

    def _unstated_tilt_condition(self, current: CalibrationRecord | None) -> Reason | None:
        """Return that the served camera is tilted by more than is stated, and the setting that states it."""
        if current is None:
            return None
        try:
            served = self.camera.archive.calibrations.model(current.id)
        except InputError:
            return None
        tilt_deg, limit_deg = served.pose.theta_zz_deg, self.level_within_deg
        if tilt_deg <= LEVEL_DEG if limit_deg is None else tilt_deg <= limit_deg:
            return None
        if limit_deg is None and is_tilt_shown(served):
            return None
        return condition(
            "tilt_unstated",
            calibration=current.id,
            tilt_deg=tilt_deg,
            stated="unset" if limit_deg is None else f"{limit_deg:g}",
            level_within_deg=proposed_limit_deg(tilt_deg),
        )

    def _check_sightings(self, current: CalibrationRecord) -> None:
        try:
            self.camera.archive.calibrations.sightings_given_to(current.id)
        except NotFoundError:
            return  # imported, or made before evidence was kept
        except InputError as error:
            self._report_damage("evidence_changed", calibration=current.id, error=str(error))

    def _report_damage(self, code: str, *, calibration: str, **data: str) -> Reason:
        """Store an alarm once for each calibration, ask for a refit of a damaged one, and return the condition."""
        finding = Finding(code, {"calibration": calibration, **data})
        if code == "calibration_damaged":
            self._request_replacement(calibration)
        written = self.camera.archive.events.find(self.camera.name, kind=code)
        if all(event.details.get("calibration") != calibration for event in written):
            self.camera.add_event(finding, time=self.now(), severity="alarm")
        return Reason.of(finding)

    def _request_replacement(self, damaged: str) -> None:
        """Ask for a refit in place of a damaged calibration, once."""
        refits, name, reason = self.camera.archive.refits, self.camera.name, f"in place of {damaged}"
        if all(asked.reason != reason for asked in refits.find(name)):
            refits.request(Refit.asked(name, reason, at=self.now()))
