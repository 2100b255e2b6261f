"""The input of a solve, and solving in a child process, so that a fit never delays a frame."""

from __future__ import annotations

import multiprocessing
import threading
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from multiprocessing.connection import Connection
from multiprocessing.context import SpawnProcess
from typing import NamedTuple, TypeVar

import numpy as np

from sunarc.calibration.calibrate import calibrate
from sunarc.calibration.model.options import CalibrationOptions, ImageCircle
from sunarc.calibration.model.pose_change import PoseChange
from sunarc.calibration.model.result import Calibration
from sunarc.calibration.model.sightings import Sightings
from sunarc.changes.record import find_pose_steps
from sunarc.common.findings import Finding
from sunarc.imager.archive.values import SunPointColumns
from sunarc.imager.runtime.child_process import answer_call, one_thread_each
from sunarc.imager.runtime.clock import Clock
from sunarc.sky.night import SUN, body_directions
from sunarc.sky.site import Site

_Answer = TypeVar("_Answer")

_POLL_S = 0.25
_STOP_FOLLOWS_S = 1.0


class SolveFailedError(Exception):
    """Error of a fit that gave no answer, or took too long.

    Parameters
    ----------
    finding : what happened.
    """

    def __init__(self, finding: Finding) -> None:
        super().__init__(finding.text)
        self.finding = finding


class SolverDiedError(SolveFailedError):
    """Error of a child process that ended without an answer: it was killed, or memory is short."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SolveProblem:
    """Arguments of `sunarc.calibration.calibrate` or `find_pose_steps`.

    `tilt_known` is for the former alone, `lens` for the latter.
    """

    points: Sightings
    site: Site
    image_size: tuple[int, int]
    options: CalibrationOptions
    circle: ImageCircle | None = None
    lens: Calibration | None = None
    tilt_known: bool = False


class ChildControl(NamedTuple):
    """Control of a child process: clock, time limit (s), stop event, and the caller's heartbeat."""

    clock: Clock
    time_limit_s: float
    stop: threading.Event
    heartbeat: Callable[[], None]


def solve_in_child(problem: SolveProblem, control: ChildControl) -> Calibration | None:
    """Return the fit made in a fresh process (spawned, never forked: the camera library has threads).

    Returns
    -------
    The calibration; None when the stop was set before it was there.

    Raises
    ------
    SolverDiedError : when the process died.
    SolveFailedError : when it failed, or took too long.
    """
    answer = in_child(partial(call_on(problem, calibrate), tilt_known=problem.tilt_known), control)
    if answer is not None and not isinstance(answer, Calibration):
        raise SolveFailedError(Finding("solve_failed", {"error": str(answer)}))
    return answer


def search_in_child(problem: SolveProblem, control: ChildControl) -> tuple[PoseChange, ...] | None:
    """Search a record for steps of the pose, as `solve_in_child` solves, with the same errors."""
    answer = in_child(partial(call_on(problem, find_pose_steps), lens=problem.lens), control)
    if answer is not None and not isinstance(answer, tuple):
        raise SolveFailedError(Finding("search_failed", {"error": str(answer)}))
    return answer


def call_on(problem: SolveProblem, function: Callable[..., _Answer]) -> partial[_Answer]:
    """Return the call of a function of the core on a problem, so that the child imports no more than the core."""
    return partial(
        function,
        problem.points,
        site=problem.site,
        image_size=problem.image_size,
        options=problem.options,
        circle=problem.circle,
    )


def in_child(call: Callable[[], object], control: ChildControl) -> object:
    """Return the result of a call in a fresh process; None when the stop was set before."""
    one_thread_each()  # read by the processes that are started
    context = multiprocessing.get_context("spawn")
    receiving, sending = context.Pipe()
    process = context.Process(target=answer_call, args=(sending,), name="solve", daemon=True)
    try:
        process.start()
        sending.close()
        # Not an argument of the process: `start` holds both ends of the pipe that carries those, and more than the
        # pipe takes would block it for ever where the child has died. The child reads before it imports: no heartbeat
        # is due while it does.
        receiving.send(call)
        return _wait_for_answer(receiving, control)
    except (EOFError, ConnectionError):  # it died before it answered, or before it had read its problem
        exit_code = _wait_for_exit_code(process)
        if control.clock.wait(
            control.stop, _STOP_FOLLOWS_S
        ):  # one stop ends both, and the child a moment before this is reached
            return None
        raise SolverDiedError(Finding("solver_died", {"end": _describe_end(exit_code)})) from None
    finally:
        receiving.close()
        if process.pid is not None:
            process.kill()
            process.join()


def _wait_for_answer(receiving: Connection[object, object], control: ChildControl) -> object:
    end = control.clock.monotonic() + control.time_limit_s
    while not control.stop.is_set():
        control.heartbeat()
        if receiving.poll(_POLL_S):
            return receiving.recv()
        if control.clock.monotonic() > end:
            raise SolveFailedError(Finding("solve_too_long", {"limit_s": control.time_limit_s}))
    return None


def _wait_for_exit_code(process: SpawnProcess) -> int | None:
    if process.pid is None:  # it died while it was being started
        return None
    process.join(_STOP_FOLLOWS_S)
    return process.exitcode


def _describe_end(exit_code: int | None) -> str:
    if exit_code is None:
        return "exit code unknown"
    return f"signal {-exit_code}" if exit_code < 0 else f"exit code {exit_code}"


def columns_to_sightings(columns: SunPointColumns, *, site: Site | None = None, latest: str | None = None) -> Sightings:
    """Return the sightings of an archive's columns.

    Parameters
    ----------
    columns : sightings in the order of time.
    site : where the camera stands, for the directions of stars and planets; None where all are of the sun.
    latest : the pose epoch that is numbered last, so that a fit is of it; the last in time where None or not present.
    """
    epoch = columns.epoch
    if latest in columns.epoch_ids[:-1]:
        index = columns.epoch_ids.index(latest)
        epoch = np.where(epoch == index, len(columns.epoch_ids) - 1, epoch - (epoch > index))
    if site is None and np.any(columns.body != SUN):
        raise ValueError("sightings of stars without a site")
    temperature, pressure = columns.temperature, columns.pressure
    directions = np.full((1, 3), np.nan)
    if site is not None:
        directions = body_directions(columns.body, columns.unix_s, site, temperature=temperature, pressure=pressure)
    return Sightings.of(
        unix_s=columns.unix_s,
        pixels=columns.pixels,
        sigma_px=columns.sigma_px,
        epoch=epoch,
        clock_error_s=columns.clock_error_s,
        body=columns.body,
        temperature=temperature,
        pressure=pressure,
        directions=directions,
    )
