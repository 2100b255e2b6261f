"""Heartbeats of loops: recorded by the loop, checked by the supervisor, shown on the status board."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from sunarc.runtime.messages import of_worker, worker_code
from sunarc.runtime.status import Severity, StatusRegistry, WorkerStatus

_STUCK, _OPTIONAL_STUCK = "worker_stuck", "optional_worker_stuck"


class Heartbeat:
    """Monotonic time at which a loop last turned.

    Parameters
    ----------
    monotonic : seconds that never jump.
    """

    def __init__(self, monotonic: Callable[[], float]) -> None:
        self._monotonic = monotonic
        self._beat_at_s = monotonic()

    def beat(self) -> None:
        """Record a turn of the loop."""
        self._beat_at_s = self._monotonic()

    def age_s(self) -> float:
        """Return the seconds since the last turn."""
        return self._monotonic() - self._beat_at_s


@dataclass(frozen=True, slots=True, kw_only=True)
class Monitored:
    """A loop that has a thread or an event loop of its own, watched by its heartbeat.

    Attributes
    ----------
    name : on the status board.
    heartbeat : beaten by the loop.
    stale_after_s : seconds without a heartbeat after which the loop is stuck, and the watchdog no longer fed.
    """

    name: str
    heartbeat: Heartbeat
    stale_after_s: float


class Monitor:
    """Checks the heartbeat of a loop that runs elsewhere.

    Parameters
    ----------
    loop : what to check.
    board : where it is shown.
    """

    def __init__(self, loop: Monitored, *, board: StatusRegistry) -> None:
        self._loop = loop
        self._board = board
        self._staleness = Staleness(loop.name, stale_after_s=loop.stale_after_s, board=board)

    def check(self) -> bool:
        """Write the heartbeat's age on the board, and return whether the loop is alive."""
        age_s = self._loop.heartbeat.age_s()
        self._board.set_worker(WorkerStatus(name=self._loop.name, state="running", heartbeat_age_s=age_s))
        return not self._staleness.update(age_s)


class Staleness:
    """Whether a heartbeat is too old, and a condition on the board while it is.

    Parameters
    ----------
    name : of the worker or loop.
    stale_after_s : seconds without a heartbeat that are too many.
    board : where the condition is shown.
    optional : whether the measurement goes on without it: the condition is then `degraded`, else `not_ready`.
    """

    def __init__(self, name: str, *, stale_after_s: float, board: StatusRegistry, optional: bool = False) -> None:
        self._name = name
        self._stale_after_s = stale_after_s
        self._board = board
        self._code = _OPTIONAL_STUCK if optional else _STUCK
        self._severity: Severity = "degraded" if optional else "not_ready"

    def update(self, age_s: float) -> bool:
        """Take the heartbeat's age, and return whether it is too old."""
        stuck = age_s > self._stale_after_s
        reason = None
        if stuck:
            reason = of_worker(self._code, self._name, severity=self._severity, limit_s=self._stale_after_s)
        self._board.set_condition(worker_code(self._code, self._name), reason)
        return stuck
