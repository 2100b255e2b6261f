"""Solves the camera anew when asked, in a process of its own, and serves the answer only when it is better."""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable
from dataclasses import dataclass, replace
from datetime import UTC, datetime

import sunarc
from sunarc.archive import Archive, CalibrationRecord, Event, Refit, RefitState
from sunarc.board import Reason, StatusBoard
from sunarc.calibration import Calibration, CalibrationOptions, ImageCircle, accept, from_document, to_document
from sunarc.clock import Clock
from sunarc.errors import InputError
from sunarc.sky import Site
from sunarc.workers.points import points_of
from sunarc.workers.solve import Problem, SolveFailedError, solve_in_child

_log = logging.getLogger(__name__)
_POLL_S = 0.5


@dataclass(frozen=True, slots=True, kw_only=True)
class RefitOptions:
    """When the camera is solved anew.

    Attributes
    ----------
    check_every_s : how often ended days are looked for, real seconds.
    time_limit_s : a solve that takes longer is given up, real seconds.
    image_circle_px : x, y and radius of the circle that the lens draws at 90 degrees, where they are known.
    """

    check_every_s: float = 60.0
    time_limit_s: float = 900.0
    image_circle_px: tuple[float, float, float] | None = None

    def __post_init__(self) -> None:
        """Refuse durations that are none."""
        if self.check_every_s <= 0.0 or self.time_limit_s <= 0.0:
            raise InputError(field="refit", problem="a duration is not positive", remedy="give seconds above 0")


class RefitWorker:
    """Takes refits from the archive, one at a time, and carries them out.

    Parameters
    ----------
    archive, camera, site : whose sightings, and where.
    options, calibration : the limits, and how to fit.
    clock : real time.
    now : frame time, which dates calibrations.
    board : where the lack of a calibration is shown.
    may_solve : whether a refit may begin now; the others wait.
    """

    def __init__(
        self,
        *,
        archive: Archive,
        camera: str,
        site: Site,
        options: RefitOptions,
        calibration: CalibrationOptions,
        clock: Clock,
        now: Callable[[], datetime],
        board: StatusBoard,
        may_solve: Callable[[], bool] = lambda: True,
    ) -> None:
        self._archive = archive
        self._camera = camera
        self._site = site
        self._options = options
        self._calibration = calibration
        self._clock = clock
        self._now = now
        self._board = board
        self._may_solve = may_solve

    def run(self, stop: threading.Event, heartbeat: Callable[[], None]) -> None:
        """Work until stopped; a refit that was cut short is begun again at the next start."""
        self._show_calibration()
        while not stop.is_set():
            heartbeat()
            waiting = self._archive.refits(self._camera, unfinished=True)
            if waiting and self._may_solve():
                self.carry_out(waiting[-1], stop, heartbeat)
            else:
                self._clock.wait(stop, _POLL_S)

    def carry_out(self, refit: Refit, stop: threading.Event, heartbeat: Callable[[], None]) -> None:
        """Solve, judge, keep, and serve what is better; leaves the refit unfinished when stopped half-way."""
        self._archive.start_refit(refit.id, started_at=self._now())
        problem = self._problem()
        if problem is None:
            self._finish(refit, "failed", "there are no accepted sightings yet")
            return
        try:
            solved = solve_in_child(
                problem, clock=self._clock, time_limit_s=self._options.time_limit_s, stop=stop, heartbeat=heartbeat
            )
        except SolveFailedError as error:
            self._finish(refit, "failed", str(error))
            return
        if solved is not None:
            self._judge(refit, solved)

    def _problem(self) -> Problem | None:
        known = {camera.name: camera for camera in self._archive.cameras()}
        columns = self._archive.sun_point_columns(self._camera)
        if self._camera not in known or columns.unix_s.size == 0:
            return None
        record = known[self._camera]
        return Problem(
            points=points_of(columns),
            site=self._site,
            image_size=(record.width, record.height),
            options=self._calibration,
            circle=None if self._options.image_circle_px is None else _circle(self._options.image_circle_px),
        )

    def _judge(self, refit: Refit, solved: Calibration) -> None:
        current = self._archive.current_calibration(self._camera)
        if solved.verdict.accepted:
            before = None if current is None else from_document(current.document)
            solved = replace(solved, verdict=accept(solved, before))
        record = self._keep(refit, solved, current)
        if record.accepted:
            served = self._archive.activate(record.id).state == "current"
            held = () if served else ("kept as a candidate: the current one is pinned",)
            self._finish(refit, "accepted", "; ".join((*record.reasons, *held)), calibration=record.id)
        else:
            self._finish(refit, "refused", "; ".join(record.reasons), calibration=record.id)
        self._show_calibration()

    def _keep(self, refit: Refit, solved: Calibration, current: CalibrationRecord | None) -> CalibrationRecord:
        """Store the calibration; the first one of a pose epoch answers from the epoch's beginning."""
        now = self._now()
        epoch = self._archive.current_epoch(self._camera)
        first = epoch is not None and (current is None or current.pose_epoch != epoch.id)
        document = to_document(
            solved,
            id=f"{now.astimezone(UTC):%Y%m%dT%H%M%SZ}-{refit.id[:6]}",
            camera=self._camera,
            state="candidate" if solved.verdict.accepted else "refused",
            created_at=now,
            valid_from=epoch.started_at if epoch is not None and first else now,
            valid_until=None,
            pose_epoch="" if epoch is None else epoch.id,
            software_version=sunarc.__version__,
        )
        return self._archive.add_calibration(document, parent=None if current is None else current.id)

    def _finish(self, refit: Refit, state: RefitState, message: str, *, calibration: str | None = None) -> None:
        now = self._now()
        self._archive.finish_refit(refit.id, state=state, finished_at=now, calibration=calibration, message=message)
        self._archive.add_event(
            Event(
                time=now,
                kind=f"refit_{state}",
                severity="info" if state == "accepted" else "warning",
                text=message,
                camera=self._camera,
                details={"refit": refit.id, "calibration": calibration},
            )
        )
        _log.log(logging.INFO if state == "accepted" else logging.WARNING, "refit %s: %s", state, message)

    def _show_calibration(self) -> None:
        if self._archive.current_calibration(self._camera) is not None:
            self._board.clear_reason("no_calibration")
            return
        self._board.set_reason(
            Reason(
                code="no_calibration",
                severity="degraded",
                text="no calibration is current",
                remedy="wait for a clear day, or import sightings with `sunarc points import`",
            )
        )


def _circle(numbers: tuple[float, float, float]) -> ImageCircle:
    x, y, radius = numbers
    return ImageCircle(x=x, y=y, radius=radius)
