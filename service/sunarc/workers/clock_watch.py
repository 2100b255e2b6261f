"""Watches the time that frames are dated by: to within what it is known, and whether it was set."""

from __future__ import annotations

import logging
import threading
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from datetime import datetime

from sunarc.archive import Archive, Event
from sunarc.board import ClockStatus, Reason, StatusBoard
from sunarc.clock import Clock
from sunarc.errors import InputError, OutsideError
from sunarc.workers.clock_steps import ClockReading, ClockStep, step_between
from sunarc.workers.frame_time import FrameTime

_log = logging.getLogger(__name__)

UNKNOWN_ERROR_S = 1e9
"""What stands for "no bound": a host without a battery starts years off."""
_TRANSPORT_S = 1.0  # a camera's time is learnt when its frame has come
_LEAP_WITHIN_S = 0.1
_DOUBTS_KEPT = 16


@dataclass(frozen=True, slots=True, kw_only=True)
class ClockOptions:
    """How the time of the frames is watched.

    Attributes
    ----------
    check_every_s : seconds from look to look.
    step_s : wall time that moves against monotonic time by more than this was set; slewing moves both alike.
    least_error_s : the least bound that a sighting carries; just after a correction, time services tell the kernel 0.
    assumed_error_s : bound of the host's clock where it is kept right by something that does not tell the kernel.
    show_step_s : how long a step stands in /readyz.
    """

    check_every_s: float = 1.0
    step_s: float = 0.1
    least_error_s: float = 0.02
    assumed_error_s: float | None = None
    show_step_s: float = 3600.0

    def __post_init__(self) -> None:
        """Refuse what is no duration."""
        durations = (self.check_every_s, self.step_s, self.least_error_s, self.assumed_error_s or 1.0, self.show_step_s)
        if not all(0.0 < seconds < UNKNOWN_ERROR_S for seconds in durations):
            raise InputError(field="clock", problem="a duration is out of bounds", remedy="give seconds above 0")


class ClockWatch:
    """Compares wall time with monotonic time, and keeps the kernel's word on its clock.

    Parameters
    ----------
    clock, frame_time : real time, and the time that dates frames.
    archive, camera : where a step is remembered, and whose sightings it puts in doubt.
    options : how closely to look.
    camera_error_s : bound of the camera's disciplined clock where it dates the frames; None where the host's does.
    finds_steps : false for times that jump by nature: a replay's, or a simulation's that skips its nights.
    board : where the clock's state is shown.
    """

    def __init__(
        self,
        *,
        clock: Clock,
        frame_time: FrameTime,
        archive: Archive,
        camera: str,
        options: ClockOptions,
        camera_error_s: float | None,
        finds_steps: bool,
        board: StatusBoard,
    ) -> None:
        self._clock = clock
        self._frame_time = frame_time
        self._archive = archive
        self._camera = camera
        self._options = options
        self._camera_error_s = camera_error_s
        self._finds_steps = finds_steps
        self._board = board
        self._lock = threading.Lock()
        self._last: ClockReading | None = None
        self._camera_off_s = 0.0
        self._doubts: deque[ClockStep] = deque(maxlen=_DOUBTS_KEPT)
        self._unwritten: deque[ClockStep] = deque(maxlen=_DOUBTS_KEPT)
        self._last_step: ClockStep | None = None

    def run(self, stop: threading.Event, heartbeat: Callable[[], None]) -> None:
        """Look until stopped."""
        while not stop.is_set():
            heartbeat()
            self.look()
            self._clock.wait(stop, self._options.check_every_s)

    def look(self) -> None:
        """Look at the clock once; write down a step, and show how the clock is."""
        self._compare()
        self._write_down()
        self._show()

    def trusted(self) -> bool:
        """Whether sightings made now can be calibrated with."""
        return self._bound_s() < UNKNOWN_ERROR_S and not self._camera_off_s

    def error_s(self, moment: datetime) -> float:
        """Return the bound of the error of a frame's time; `UNKNOWN_ERROR_S` where there is none."""
        self._compare()
        with self._lock:
            doubts = [abs(step.step_s) for step in self._doubts if step.doubts(moment)]
        return max([self._bound_s(), *doubts])

    def _bound_s(self) -> float:
        if self._camera_error_s is not None:
            return max(self._camera_error_s, abs(self._camera_off_s))
        state = self._clock.state()
        if state.synchronised:
            return max(state.error_bound_s, self._options.least_error_s)
        return self._options.assumed_error_s or UNKNOWN_ERROR_S

    def _compare(self) -> None:
        if not self._finds_steps or not self._frame_time.known:
            return
        with self._lock:
            before, self._last = self._last, self._read()
            step = None if before is None else step_between(before, self._last, least_s=self._least_step_s)
            if step is None:
                return
            self._doubts.append(step)
            if self._is_leap_second(step):
                return
            self._last_step = step
            self._unwritten.append(step)
            if self._camera_error_s is not None:
                self._camera_off_s = self._camera_off(step.step_s)

    def _is_leap_second(self, step: ClockStep) -> bool:
        return self._clock.state().leap_second and abs(abs(step.step_s) - 1.0) < _LEAP_WITHIN_S

    @property
    def _least_step_s(self) -> float:
        return self._options.step_s + (0.0 if self._camera_error_s is None else _TRANSPORT_S)

    def _read(self) -> ClockReading:
        before_s = self._clock.monotonic()
        wall = self._frame_time.now()
        after_s = self._clock.monotonic()
        return ClockReading(wall=wall, monotonic_s=(before_s + after_s) / 2.0, within_s=after_s - before_s)

    def _camera_off(self, step_s: float) -> float:
        """Return how far the camera's clock may be off: nothing when it stepped back, or agrees with a good host."""
        off_s = self._camera_off_s + step_s
        apart_s = abs((self._frame_time.now() - self._clock.now()).total_seconds())
        agrees = self._clock.state().synchronised and apart_s < _TRANSPORT_S
        return 0.0 if agrees or abs(off_s) <= self._least_step_s else off_s

    def _write_down(self) -> None:
        """Remember the steps, and widen the bounds of sightings that were stored before a step was found."""
        while self._unwritten:
            step = self._unwritten[0]
            try:
                for since, until in step.doubted:
                    self._archive.doubt_times(self._camera, since=since, until=until, error_s=abs(step.step_s))
                self._archive.add_event(self._event(step))
            except OutsideError as error:
                _log.warning("a step of the clock is not written down yet: %s", error)
                return
            self._unwritten.popleft()

    def _event(self, step: ClockStep) -> Event:
        state = self._clock.state()
        return Event(
            time=step.at,
            kind="clock_step",
            severity="warning",
            text=f"the {self._whose}'s clock was stepped by {step.step_s:+.3f} s",
            camera=self._camera,
            details={
                "step_s": step.step_s,
                "clock": self._whose,
                "noticed_within_s": step.within_s,
                "synchronised_after": state.synchronised,
                "error_bound_s": self._bound_s(),
            },
        )

    @property
    def _whose(self) -> str:
        return "host" if self._camera_error_s is None else "camera"

    def _show(self) -> None:
        state = self._clock.state()
        last = self._last_step
        self._board.note(
            clock=ClockStatus(
                synchronised=state.synchronised,
                max_error_s=state.error_bound_s,
                last_step_s=None if last is None else last.step_s,
                last_step_at=None if last is None else last.at,
            )
        )
        recent = last is not None and self._clock.monotonic() - last.found_s < self._options.show_step_s
        self._put("clock_stepped", _stepped(self._whose, last) if last is not None and recent else None)
        self._put("clock_unsynchronised", None if self.trusted() else _unsynchronised(self._whose))

    def _put(self, code: str, reason: Reason | None) -> None:
        if reason is None:
            self._board.clear_reason(code)
        else:
            self._board.set_reason(reason)


def _stepped(whose: str, step: ClockStep) -> Reason:
    return Reason(
        code="clock_stepped",
        severity="degraded",
        text=f"the {whose}'s clock was stepped by {step.step_s:+.3f} s at {step.at:%Y-%m-%dT%H:%M:%SZ}",
        remedy="see what sets the clock; sightings around the step carry its size as their error",
    )


def _unsynchronised(whose: str) -> Reason:
    if whose == "camera":
        return Reason(
            code="clock_unsynchronised",
            severity="degraded",
            text="the camera's clock was stepped and has not come back; no day is judged and no camera solved",
            remedy='see to its PTP master, or set camera.timestamps = "host"; then restart the service',
        )
    return Reason(
        code="clock_unsynchronised",
        severity="degraded",
        text="the host's clock is not synchronised (1 s turns the sky by 0.004 degrees); capture goes on, "
        "but no day is judged and no camera solved, and sightings made now stay out of fits",
        remedy="start a time service (systemd-timesyncd or chrony) and let it reach its servers",
    )
