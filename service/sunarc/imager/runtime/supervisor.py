"""Keeps named workers alive: threads, heartbeats, restarts, and one way to stop them all."""

from __future__ import annotations

import logging
import threading
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Annotated, Protocol

from annotated_types import Ge, Le

from sunarc.common.bounds import Positive, require_bounds
from sunarc.common.errors import OutsideError
from sunarc.imager.runtime.clock import Clock
from sunarc.imager.runtime.loop import Pauses
from sunarc.imager.runtime.states import Severity
from sunarc.imager.runtime.status import StatusRegistry, WorkerState, WorkerStatus, make_condition, worker_code

_STUCK, _OPTIONAL_STUCK = "worker_stuck", "optional_worker_stuck"


class Heartbeat:
    """Monotonic time of a loop's last turn.

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
    """Check of a heartbeat's age, with a condition on the board while it is too old.

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
            reason = make_condition(self._code, self._name, severity=self._severity, limit_s=self._stale_after_s)
        self._board.set_condition(worker_code(self._code, self._name), reason)
        return stuck


_log = logging.getLogger(__name__)

_BACK_OFF = Pauses(1.0, 30.0)
_RETRY_FAILED_S = 300.0  # of a worker that died too often; as systemd retries the service (sunarc-retry.timer)


class Worker(Protocol):
    """A loop with a thread of its own."""

    def run(self, stop: threading.Event, heartbeat: Callable[[], None]) -> None:
        """Work until `stop` is set, and call `heartbeat` at every turn; to raise or return earlier is a death."""


@dataclass(frozen=True, slots=True, kw_only=True)
class SupervisorOptions:
    """Limits after which a worker counts as failed or as stuck.

    Attributes
    ----------
    max_restarts, within_s : a worker that dies once more than `max_restarts` times within `within_s` has failed.
    stale_after_s : a worker without a heartbeat for longer is stuck; systemd's watchdog is then no longer fed, unless
        the worker only sends to a hub, a broker or a webhook.
    """

    max_restarts: Annotated[int, Ge(0)] = 5
    within_s: Positive = 600.0
    stale_after_s: Annotated[float, Ge(5.0), Le(3600.0)] = 120.0  # a worker shows signs of life every second

    def __post_init__(self) -> None:
        """Refuse limits that would end at once, or take a busy worker for stuck."""
        require_bounds(self, section_path="supervisor")


@dataclass(frozen=True, slots=True, kw_only=True)
class Supervised:
    """Worker that the supervisor keeps alive.

    Attributes
    ----------
    name : of the worker, of its thread and on the board.
    make_worker : called before every life, in the worker's thread; what it raises is a death too.
    options : when it has failed, or is taken for stuck.
    essential : whether its failure ends the process; any other failed worker is retried every 300 s.
    severity : of the condition on the board while it keeps dying; `not_ready` where no sighting is stored without it.
    optional : whether the measurement goes on without it: while it is stuck the watchdog is fed all the same.
    """

    name: str
    make_worker: Callable[[], Worker]
    options: SupervisorOptions = SupervisorOptions()
    essential: bool = False
    severity: Severity = "degraded"
    optional: bool = False


@dataclass(frozen=True, slots=True, kw_only=True)
class Watchdog:
    """Inputs and outputs of the supervisor's watchdog.

    Attributes
    ----------
    feed : called while no worker or monitored loop is stuck (optional workers apart) and no essential worker has
        failed: the watchdog's keep-alive. None starts no thread for it.
    every_s : seconds between two checks.
    monitored : loops that run elsewhere, watched by their heartbeats.
    on_check : called at every check; what they raise is logged.
    """

    feed: Callable[[], None] | None = None
    every_s: float = 5.0
    monitored: Sequence[Monitored] = ()
    on_check: Sequence[Callable[[], None]] = ()


class Supervisor:
    """Supervisor that runs workers until `stop`, each in a thread named after it.

    A dead worker is made anew after a back-off; from its second death within the window until it has run for 30 s
    this is a condition on the board. One that keeps dying has failed: it is retried every 300 s while the others go
    on, unless it is essential: then `failed` is set, and the process should end with an error. One that is ended by
    something outside (`OutsideError`: the disk is full) never fails: it is made anew until the cause is gone.
    A supervisor lives once; `start` and `stop` may be called twice.

    Parameters
    ----------
    workers : what to run, names distinct.
    clock : real time; heartbeats, back-offs and windows are measured by it.
    board : where states and reasons are written.
    watchdog : what is checked, from a thread of its own.
    on_failed : called once, when the first essential worker fails, from that worker's thread.
    """

    def __init__(
        self,
        workers: Sequence[Supervised],
        *,
        clock: Clock,
        board: StatusRegistry,
        watchdog: Watchdog = Watchdog(),
        on_failed: Callable[[], None] | None = None,
    ) -> None:
        self.failed = threading.Event()
        self._stop = threading.Event()
        self._clock = clock
        self._board = board
        self._watchdog = watchdog
        self._on_failed = on_failed
        self._lives = [_Life(worker, clock=clock, board=board, stop=self._stop) for worker in workers]
        self._monitors = [Monitor(loop, board=board) for loop in watchdog.monitored]
        names = [worker.name for worker in workers] + [loop.name for loop in watchdog.monitored]
        if len(set(names)) < len(names):
            raise ValueError("two workers have the same name")
        self._threads: list[threading.Thread] = []
        self._lock = threading.Lock()

    def start(self) -> None:
        """Start every worker; once started or stopped, nothing more happens."""
        with self._lock:
            if self._threads or self._stop.is_set():
                return
            self._threads = [
                threading.Thread(target=self._keep_alive, args=(life,), name=life.name, daemon=True)
                for life in self._lives
            ]
            if self._watchdog.feed is not None:
                self._threads.append(threading.Thread(target=self._watch_workers, name="watchdog", daemon=True))
            for thread in self._threads:
                thread.start()

    def stop(self, *, within_s: float = 5.0) -> tuple[str, ...]:
        """Ask all workers to stop, and wait for them, `within_s` in all.

        Returns
        -------
        The names of the threads that still run, the caller's own left out; empty when all is well.
        """
        self._stop.set()
        with self._lock:
            # A worker's own failure may be what stops the service, and a thread cannot join itself.
            others = [thread for thread in self._threads if thread is not threading.current_thread()]
        deadline = self._clock.monotonic() + within_s
        for thread in others:
            thread.join(max(deadline - self._clock.monotonic(), 0.0))
        late = tuple(thread.name for thread in others if thread.is_alive())
        if late:
            _log.error("did not stop within %g s: %s", within_s, ", ".join(late))
        return late

    def check(self) -> bool:
        """Check all heartbeats, write them on the board, and return whether all but optional workers are alive."""
        fresh = [life.check() for life in self._lives] + [monitor.check() for monitor in self._monitors]
        return all(fresh)

    def _watch_workers(self) -> None:
        while not self._stop.is_set():
            if self.check() and self._watchdog.feed is not None:
                self._watchdog.feed()
            for called in self._watchdog.on_check:
                try:
                    called()
                except Exception:  # noqa: BLE001 - the watchdog's thread must go on
                    _log.exception("a periodic check failed")
            self._clock.wait(self._stop, self._watchdog.every_s)

    def _keep_alive(self, life: _Life) -> None:
        life.keep()
        if not life.failed:
            return
        with self._lock:
            # Two essential workers may fail at the same time; the callback runs once.
            first = not self.failed.is_set()
            self.failed.set()
        if first and self._on_failed is not None:
            self._on_failed()


class _Life:
    """Starts, deaths and restarts of one worker; `keep` runs in the worker's thread, `check` in any."""

    def __init__(self, worker: Supervised, *, clock: Clock, board: StatusRegistry, stop: threading.Event) -> None:
        self.name = worker.name
        self.failed = False
        self._worker = worker
        self._clock = clock
        self._board = board
        self._stop = stop
        self._state: WorkerState = "starting"
        self._beat = Heartbeat(clock.monotonic)
        self._deaths: deque[float] = deque()
        self._restarts = 0
        self._last_error: str | None = None
        self._staleness = Staleness(
            worker.name, stale_after_s=worker.options.stale_after_s, board=board, optional=worker.optional
        )
        self._blocked = False
        self._died_too_often = False
        self._born_at = clock.monotonic()
        self._lock = threading.Lock()

    def keep(self) -> None:
        """Run the worker, and start it again when it dies, until stopped; an essential worker until it has failed."""
        while not self._stop.is_set():
            self._last_error = self._run_once()
            if self._stop.is_set():
                break
            if not self._wait_before_restart():
                return
            self._restarts += 1
        self._enter_state("stopped")

    def check(self) -> bool:
        """Write the heartbeat's age on the board, and return whether the watchdog may be fed."""
        with self._lock:
            age_s = self._beat.age_s()
            running = self._state == "running"
            self._write_status(age_s)
            if running and self._clock.monotonic() - self._born_at > _BACK_OFF.longest_s:
                self._clear_death_conditions()
        stuck = self._staleness.update(age_s if running else 0.0)
        return (self._worker.optional or not stuck) and not self.failed

    def _wait_before_restart(self) -> bool:
        """Wait until the next life; return False for the last one, the worker being essential and having failed."""
        deaths = self._count_death()
        if not self._blocked and (self._died_too_often or deaths > self._worker.options.max_restarts):
            self._set_failed()
            if self.failed:
                return False
            self._clock.wait(self._stop, _RETRY_FAILED_S)
            return True
        self._enter_state("restarting")
        if not self._blocked and deaths > 1:
            within_s = self._worker.options.within_s
            self._publish_condition(
                "worker_restarting", severity=self._worker.severity, deaths=deaths, within_s=within_s
            )
        self._clock.wait(self._stop, _BACK_OFF.after(deaths))
        return True

    def _run_once(self) -> str | None:
        """Run the worker once; return the error that it died of, None when it was stopped."""
        # Before it is running: `check` would take the age of the life before for this one's, and have it recovered.
        self._born_at = self._clock.monotonic()
        self._enter_state("running")
        try:
            self._worker.make_worker().run(self._stop, self._beat.beat)
        except OutsideError as error:
            self._blocked = True
            self._last_error = str(error)
            self._publish_condition("worker_hindered")
            return self._last_error
        except BaseException as error:  # noqa: BLE001 - whatever ends a worker is its death, an exit too
            _log.exception("%s died", self.name)
            self._clear_blocked()
            return f"{type(error).__name__}: {error}"
        if self._stop.is_set():
            return None
        _log.error("%s returned without being asked to stop", self.name)
        return "returned without being asked to stop"

    def _clear_blocked(self) -> None:
        if self._blocked:
            self._blocked = False
            # What came from outside says nothing of the worker: it does not count against its restarts.
            self._deaths.clear()
            self._clear_conditions("worker_hindered")

    def _clear_death_conditions(self) -> None:
        """Clear the conditions of a worker that died, once it has run for longer than the longest back-off."""
        self._clear_blocked()
        self._died_too_often = False
        self._clear_conditions("worker_restarting", "worker_failed")

    def _count_death(self) -> int:
        now_s = self._clock.monotonic()
        self._deaths.append(now_s)
        while self._deaths[0] < now_s - self._worker.options.within_s:
            self._deaths.popleft()
        return len(self._deaths)

    def _set_failed(self) -> None:
        self._died_too_often = True
        self.failed = self._worker.essential
        self._enter_state("failed")
        self._clear_conditions("worker_restarting")
        retried = "the service is restarted" if self.failed else f"it is retried every {_RETRY_FAILED_S:g} s"
        self._publish_condition("worker_failed", severity=self._worker.severity, retried=retried)

    def _publish_condition(self, code: str, *, severity: Severity = "degraded", **data: float | str) -> None:
        reason = make_condition(code, self.name, severity=severity, error=self._last_error or "", **data)
        self._board.set_condition(reason.code, reason)

    def _clear_conditions(self, *codes: str) -> None:
        for code in codes:
            self._board.set_condition(worker_code(code, self.name), None)

    def _enter_state(self, state: WorkerState) -> None:
        with self._lock:
            # A back-off may be longer than a heartbeat may be old: the age is counted from the change of state.
            self._state = state
            self._beat.beat()
            self._write_status(0.0)

    def _write_status(self, age_s: float) -> None:
        status = WorkerStatus(
            name=self.name,
            state=self._state,
            heartbeat_age_s=age_s,
            restarts=self._restarts,
            last_error=self._last_error,
        )
        self._board.set_worker(status)
