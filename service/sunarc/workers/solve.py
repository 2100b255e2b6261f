"""A solve in a process of its own, so that a night's fit never delays a frame."""

from __future__ import annotations

import multiprocessing
import os
import threading
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from multiprocessing.connection import Connection

from sunarc.calibration import (
    Calibration,
    CalibrationOptions,
    ImageCircle,
    PoseStep,
    SunPoints,
    calibrate,
    find_pose_steps,
)
from sunarc.clock import Clock
from sunarc.sky import Site

_POLL_S = 0.25
_NICENESS = 10


class SolveFailedError(Exception):
    """The child process ended without an answer, or took too long."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Problem:
    """What `sunarc.calibration.calibrate` or `find_pose_steps` is given; `lens` is for the latter alone."""

    points: SunPoints
    site: Site
    image_size: tuple[int, int]
    options: CalibrationOptions
    circle: ImageCircle | None = None
    lens: Calibration | None = None


def solve_in_child(
    problem: Problem,
    *,
    clock: Clock,
    time_limit_s: float,
    stop: threading.Event,
    heartbeat: Callable[[], None],
) -> Calibration | None:
    """Solve in a fresh process (spawned, never forked: the camera library has threads).

    Returns
    -------
    The calibration; None when `stop` was set before it was there.

    Raises
    ------
    SolveFailedError : when the process died or took longer than `time_limit_s`.
    """
    answer = _in_child(_solve, problem, clock=clock, time_limit_s=time_limit_s, stop=stop, heartbeat=heartbeat)
    if answer is not None and not isinstance(answer, Calibration):
        raise SolveFailedError(f"the solve failed: {answer}")
    return answer


def search_in_child(
    problem: Problem,
    *,
    clock: Clock,
    time_limit_s: float,
    stop: threading.Event,
    heartbeat: Callable[[], None],
) -> tuple[PoseStep, ...] | None:
    """Search a record for steps of the pose, as `solve_in_child` solves.

    Raises
    ------
    SolveFailedError : when the process died or took longer than `time_limit_s`.
    """
    answer = _in_child(_search, problem, clock=clock, time_limit_s=time_limit_s, stop=stop, heartbeat=heartbeat)
    if answer is not None and not isinstance(answer, tuple):
        raise SolveFailedError(f"the search for pose epochs failed: {answer}")
    return answer


def _in_child(
    target: Callable[[Connection[object, object], Problem], None],
    problem: Problem,
    *,
    clock: Clock,
    time_limit_s: float,
    stop: threading.Event,
    heartbeat: Callable[[], None],
) -> object:
    """Return what a fresh process sends; None when `stop` was set before."""
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # read by the child alone: its matrices are small
    context = multiprocessing.get_context("spawn")
    receiving, sending = context.Pipe(duplex=False)
    process = context.Process(target=target, args=(sending, problem), name="solve", daemon=True)
    process.start()
    sending.close()
    try:
        return _answer(receiving, clock.monotonic, time_limit_s=time_limit_s, stop=stop, heartbeat=heartbeat)
    finally:
        receiving.close()
        process.kill()
        process.join()


def _answer(
    receiving: Connection[object, object],
    monotonic: Callable[[], float],
    *,
    time_limit_s: float,
    stop: threading.Event,
    heartbeat: Callable[[], None],
) -> object:
    end = monotonic() + time_limit_s
    while not stop.is_set():
        heartbeat()
        if receiving.poll(_POLL_S):
            try:
                return receiving.recv()
            except EOFError:
                raise SolveFailedError("the solving process died; see the log") from None
        if monotonic() > end:
            raise SolveFailedError(f"the solve took longer than {time_limit_s:g} s")
    return None


def _solve(sending: Connection[object, object], problem: Problem) -> None:
    _send(
        sending,
        lambda: calibrate(
            problem.points,
            site=problem.site,
            image_size=problem.image_size,
            options=problem.options,
            circle=problem.circle,
        ),
    )


def _search(sending: Connection[object, object], problem: Problem) -> None:
    _send(
        sending,
        lambda: find_pose_steps(
            problem.points,
            site=problem.site,
            image_size=problem.image_size,
            options=problem.options,
            circle=problem.circle,
            lens=problem.lens,
        ),
    )


def _send(sending: Connection[object, object], work: Callable[[], object]) -> None:
    """Send what the work returns, or its error in words."""
    with suppress(PermissionError):  # the unit's filter knows no priorities: it then runs as an equal
        os.nice(_NICENESS)
    try:
        answer = work()
    except Exception as error:  # noqa: BLE001 - the parent tells it; the process ends anyway
        answer = f"{type(error).__name__}: {error}"
    with suppress(BrokenPipeError):  # the service was killed meanwhile; its next start asks anew
        sending.send(answer)
