"""The time of the frames, and monitoring of the clock that dates them: the bound of its error, its steps."""

from __future__ import annotations

import logging
import math
import threading
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, replace
from datetime import datetime, timedelta

from sunarc.calibration.model.sightings import MAX_CLOCK_ERROR_S
from sunarc.common.errors import InputError, OutsideError
from sunarc.common.findings import Finding
from sunarc.common.messages import significant
from sunarc.common.utc import DAY_S, rfc3339, utc_time
from sunarc.imager.archive.archive import CameraArchive
from sunarc.imager.cameras.options import TAI_MINUS_UTC_S
from sunarc.imager.runtime.clock import Clock
from sunarc.imager.runtime.loop import Loop
from sunarc.imager.runtime.status import ClockStatus, Reason, StatusRegistry
from sunarc.imager.workers.options import ClockOptions

_COMPARED = 4
"""Frames whose time is compared with the host's: a bracket, so that a sighting's own frame is among them."""


class FrameTime:
    """The host's wall clock, or the camera's disciplined clock carried on between its frames.

    Parameters
    ----------
    clock : the host's clocks.
    follows_camera : take the time from the frames.
    speed : seconds of frame time in a real second; other than 1 only for a simulated camera.
    """

    def __init__(self, clock: Clock, *, follows_camera: bool, speed: float = 1.0) -> None:
        if not follows_camera and speed != 1.0:
            raise InputError(
                field="capture.speed", problem="the host's clock runs at speed 1", remedy='set timestamps = "camera"'
            )
        self.clock = clock
        self._follows_camera = follows_camera
        self._speed = speed
        self._lock = threading.Lock()
        self._last: tuple[datetime, float] | None = None
        self._offsets_s: deque[float] = deque(maxlen=_COMPARED)

    @property
    def follows_camera(self) -> bool:
        """True where the time is taken from the frames."""
        return self._follows_camera

    @property
    def speed(self) -> float:
        """Seconds of frame time in a real second."""
        return self._speed

    def set_speed(self, speed: float) -> None:
        """Go on at another speed from now on; only a simulated camera changes it."""
        now, at = self.now(), self.clock.monotonic()
        with self._lock:
            if self._last is not None:
                self._last = (now, at)
            self._speed = speed

    @property
    def is_known(self) -> bool:
        """True where the frame time is known: at once from the host, after the first frame from a camera."""
        return not self._follows_camera or self._last is not None

    def note(self, captured_at: datetime, *, host_offset_s: float | None = None) -> None:
        """Set the frame time by a frame just received.

        Parameters
        ----------
        captured_at : when its exposure ended.
        host_offset_s : the camera's time less the host's, seconds; None where the host dated the frame.
        """
        with self._lock:
            self._last = (captured_at, self.clock.monotonic())
            if host_offset_s is not None:
                self._offsets_s.append(host_offset_s)

    @property
    def host_offsets_s(self) -> tuple[float, ...]:
        """Camera time less host time of the last few frames, seconds; empty where they are not compared."""
        with self._lock:
            return tuple(self._offsets_s)

    def now(self) -> datetime:
        """Return the frame time, aware, UTC; the host's until the camera's is known."""
        with self._lock:
            last = self._last
        if not self._follows_camera or last is None:
            return self.clock.now()
        captured_at, at = last
        # Between frames the time goes on by the monotonic clock, which no time service sets.
        return captured_at + timedelta(seconds=(self.clock.monotonic() - at) * self._speed)

    def real_seconds_until(self, time: datetime) -> float:
        """Return how long to wait for a moment in frame time; negative when it is past."""
        return (time - self.now()).total_seconds() / self._speed

    def next_slot(self, *, every_s: float) -> datetime:
        """Return the next moment that is a whole multiple of `every_s` since 1970-01-01 UTC."""
        slots = math.floor(self.now().timestamp() / every_s) + 1
        return utc_time(slots * every_s)


# Finding that a clock was set, from readings of it against monotonic time.

_WINDOWS_S = (60.0, 3600.0)
"""Times over which many small steps are added up."""
_SLEW = 500e-6
"""Rate of wall time against monotonic time below a step: that of a time service which corrects a quartz, piecemeal."""
_INTERVALS_KEPT = 64


@dataclass(frozen=True, slots=True, kw_only=True)
class ClockReading:
    """Wall time and monotonic time, the two read within `within_s` of one another."""

    wall: datetime
    monotonic_s: float
    within_s: float


@dataclass(frozen=True, slots=True, kw_only=True)
class ClockStep:
    """Step of a clock by `step_s` between two readings.

    Attributes
    ----------
    step_s : seconds, positive where it was set forward.
    at, found_s : when it was found, in wall time and in monotonic time.
    doubted : the intervals of wall time between the readings, by the clock before and after the step.
    gradual : made of many small steps, each too small to be found between two looks.
    """

    step_s: float
    at: datetime
    found_s: float
    doubted: tuple[tuple[datetime, datetime], ...]
    gradual: bool = False

    @property
    def within_s(self) -> float:
        """Seconds between the two readings."""
        return (self.doubted[0][1] - self.doubted[0][0]).total_seconds()

    def doubts(self, time: datetime) -> bool:
        """Return whether a wall time may be from before or after the step."""
        return any(since <= time <= until for since, until in self.doubted)


def step_between(before: ClockReading, now: ClockReading, *, least_s: float) -> ClockStep | None:
    """Return the step between two readings; None below `least_s`.

    A kernel that slews its clock slews its monotonic clock alike, so that their difference moves by steps alone.
    """
    elapsed = timedelta(seconds=now.monotonic_s - before.monotonic_s)
    step_s = (now.wall - before.wall - elapsed).total_seconds()
    if abs(step_s) <= least_s + before.within_s + now.within_s:
        return None
    return ClockStep(
        step_s=step_s,
        at=now.wall,
        found_s=now.monotonic_s,
        doubted=((before.wall, before.wall + elapsed), (now.wall - elapsed, now.wall)),
    )


class GradualSteps:
    """Search for steps that are too small between successive readings, by comparing readings far apart."""

    def __init__(self) -> None:
        self._anchors: dict[float, ClockReading] = {}

    def restart(self, reading: ClockReading) -> None:
        """Compare with this reading from now on, after a known step."""
        self._anchors = dict.fromkeys(_WINDOWS_S, reading)

    def step_to(self, reading: ClockReading, *, least_s: float) -> ClockStep | None:
        """Return the sum of the steps over a window that has ended with this reading; None where it is too small."""
        for window_s in _WINDOWS_S:
            anchor = self._anchors.setdefault(window_s, reading)
            elapsed_s = reading.monotonic_s - anchor.monotonic_s
            if elapsed_s < window_s:
                continue
            self._anchors[window_s] = reading
            step = step_between(anchor, reading, least_s=least_s + _SLEW * elapsed_s)
            if step is not None:
                self.restart(reading)
                return replace(step, gradual=True)
        return None


class UntrustedTimes:
    """Intervals of wall time in which the clock could not be trusted.

    A frame is dated when it is taken and its sighting stored later, perhaps when the clock is right again.
    """

    def __init__(self) -> None:
        self._intervals: deque[tuple[datetime, datetime]] = deque(maxlen=_INTERVALS_KEPT)
        self._growing = False

    def note(self, before: ClockReading | None, now: ClockReading, *, step: ClockStep | None, trusted: bool) -> None:
        """Record the clock: its reading, the one before, the step between them, and whether it is trusted."""
        since = now.wall if before is None else before.wall
        if step is not None:
            if self._growing:
                self._extend_last_interval(step.doubted[0][1])
            self._growing, since = False, step.doubted[1][0]
        if self._growing:
            self._extend_last_interval(now.wall)
        elif not trusted:
            self._intervals.append((since, now.wall))
        self._growing = not trusted

    def _extend_last_interval(self, until: datetime) -> None:
        self._intervals[-1] = (self._intervals[-1][0], until)

    def covers(self, time: datetime) -> bool:
        """Return whether a wall time is in an interval in which the clock could not be trusted."""
        return any(since <= time < until for since, until in self._intervals)


_log = logging.getLogger(__name__)

UNKNOWN_ERROR_S = 1e9
"""Stands for "no bound": a host without a battery starts years off."""
_TRANSPORT_S = 1.0  # a camera's time is learnt when its frame has come
_LEAP_WITHIN_S = 0.1
_MAX_STEPS = 16
_CAMERA_OFFSET_S = 0.5
"""Largest difference between camera and host that is not reported: a busy host triggers late by tenths of a second."""
_CLEANING_WAIT_S = 3600.0
"""How long a clock must have been left alone before images are removed by their age."""

_CHECK_EVERY_S = 1.0
LEAST_ERROR_S = 0.02
"""The least bound that a sighting carries, s; just after a correction, time services report 0 to the kernel."""
SHOW_STEP_S = 3600.0
"""How long a step stands in /readyz, s: an operator who looks once an hour sees it."""


@dataclass(kw_only=True, eq=False)
class ClockWatch:
    """Comparison of wall time and monotonic time, and the kernel's error bound of its clock.

    Parameters
    ----------
    frame_time : the time that dates frames, with the clock that it is counted by.
    camera : its archive, where a step is stored and the bounds of sightings are widened.
    options : how closely to look.
    camera_error_s : bound of the camera's disciplined clock where it dates the frames; None where the host's does.
    finds_steps : false for times that jump by nature: a replay's, or a simulation's that skips its nights.
    board : where the clock's state is shown.
    """

    frame_time: FrameTime
    camera: CameraArchive
    options: ClockOptions
    camera_error_s: float | None
    finds_steps: bool
    board: StatusRegistry

    def __post_init__(self) -> None:
        """Begin without a reading."""
        self._clock = self.frame_time.clock
        self._lock = threading.Lock()
        self._last: ClockReading | None = None
        self._undisturbed_since_s = self.frame_time.clock.monotonic()
        self._agreement = ClockAgreement()
        self._gradual = GradualSteps()
        self._untrusted = UntrustedTimes()
        self._is_compared_with_record = False
        self._camera_off_s = 0.0
        self._doubts: deque[ClockStep] = deque(maxlen=_MAX_STEPS)
        self._unwritten: deque[tuple[ClockStep, float]] = deque(maxlen=_MAX_STEPS)
        self._last_step: ClockStep | None = None
        self._is_offset_written = False

    def run(self, stop: threading.Event, heartbeat: Callable[[], None]) -> None:
        """Check until stopped."""
        Loop(self._clock, stop, heartbeat).every(_CHECK_EVERY_S, self.check)

    def check(self) -> None:
        """Check the clock once, store a step, and publish the clock's state."""
        self._compare_with_last_reading()
        with self._lock:
            if self._last is not None and not self._is_compared_with_record:  # the database could not be read
                self._begin_comparison(self._last)
        self._store_steps()
        self._publish_clock()

    def trusted(self) -> bool:
        """Return whether sightings made now can be used for a calibration."""
        if self._last is None:
            self._compare_with_last_reading()
        return self._error_bound_s() < UNKNOWN_ERROR_S and not self._camera_off_s and not self._is_camera_far_off()

    def error_s(self, time: datetime) -> float:
        """Return the bound of the error of a frame's time; `UNKNOWN_ERROR_S` without one."""
        self._compare_with_last_reading()
        with self._lock:
            doubts = [abs(step.step_s) for step in self._doubts if step.doubts(time)]
            if self._untrusted.covers(time):
                doubts.append(UNKNOWN_ERROR_S)
        return max([self._error_bound_s(), *doubts])

    def cleaning_time(self) -> datetime | None:
        """Return the time from which the age of images is counted; None while the clock is not trusted."""
        if not self.frame_time.is_known or not self.trusted():
            return None
        undisturbed_s = self._clock.monotonic() - self._undisturbed_since_s
        return self.frame_time.now() if undisturbed_s >= _CLEANING_WAIT_S or not self.finds_steps else None

    def _error_bound_s(self) -> float:
        if self.camera_error_s is not None:
            differing = (self._bound_camera_error_s(offset) for offset in self._camera_offsets_s())
            return max(self.camera_error_s, abs(self._camera_off_s), *differing, 0.0)
        if self._agreement.wait_s(self._clock.monotonic()) > 0.0:
            return UNKNOWN_ERROR_S
        return self._kernel_bound_s()

    def _kernel_bound_s(self) -> float:
        state = self._clock.state()
        if state.synchronised:
            return max(state.error_bound_s, LEAST_ERROR_S)
        return self.options.assumed_error_s or UNKNOWN_ERROR_S

    def _camera_offsets_s(self) -> tuple[float, ...]:
        """Return by how much the camera's time differs from the host's, 0 where the host's own error explains it.

        TAI less UTC is no host's error, whether its clock is synchronised, assumed to be right, or neither.
        """
        if not self.finds_steps or self.camera_error_s is None:
            return ()
        host_s = 0.0 if self._clock.state().synchronised else self._kernel_bound_s()
        return tuple(
            offset if abs(offset) > host_s or is_tai(offset) else 0.0 for offset in self.frame_time.host_offsets_s
        )

    def _bound_camera_error_s(self, offset_s: float) -> float:
        """Return the bound of the camera's error by its difference from the host: the host's own is added."""
        if offset_s == 0.0:
            return 0.0
        assumed_s = 0.0 if self._clock.state().synchronised else self.options.assumed_error_s or 0.0
        return max(abs(offset_s) + assumed_s, TAI_MINUS_UTC_S if is_tai(offset_s) else 0.0)

    def _is_camera_far_off(self) -> bool:
        smallest_s = min(self._camera_offsets_s(), key=abs, default=0.0)
        return abs(smallest_s) > MAX_CLOCK_ERROR_S

    def _compare_with_last_reading(self) -> None:
        if not self.finds_steps or not self.frame_time.is_known:
            return
        with self._lock:
            before, now = self._last, self._read_clocks()
            self._last = now
            step = None
            if before is None:
                self._gradual.restart(now)
                self._begin_comparison(now)
            else:
                step = step_between(before, now, least_s=self._least_step_s)
                step = step or self._gradual.step_to(now, least_s=self._least_step_s)
            if step is not None:
                self._handle_step(step, now)
            if self._kernel_bound_s() < UNKNOWN_ERROR_S:
                self._agreement.agreed(now)
            self._untrusted.note(before, now, step=step, trusted=self.trusted())

    def _begin_comparison(self, now: ClockReading) -> None:
        """Compare a first reading with the record: its newest sighting, and a wait that has not ended."""
        day = timedelta(seconds=IMPLAUSIBLE_SETTLE_S)
        try:
            newest = self.camera.archive.sightings.newest_time(
                self.camera.name, largest_clock_error_s=MAX_CLOCK_ERROR_S
            )
            events = self.camera.archive.events.find(
                self.camera.name, since=now.wall - day, until=now.wall + timedelta(seconds=1)
            )
        except OutsideError as error:
            _log.warning("could not compare the clock with the record: %s", error)
            return
        last = next((event for event in events if event.kind == "clock_step"), None)
        remaining_s = 0.0
        if last is not None and self.camera_error_s is None:
            remaining_s = float(last.details.get("distrusted_s", 0.0)) - (now.wall - last.time).total_seconds()
        self._agreement.begin(now, newest_stored=newest, remaining_s=remaining_s)
        self._is_compared_with_record = True

    def _handle_step(self, step: ClockStep, now: ClockReading) -> None:
        """Record a step, start the wait, and widen the clock error of affected sightings."""
        self._doubts.append(step)
        if self._is_leap_second(step):
            return
        self._gradual.restart(now)
        self._undisturbed_since_s = now.monotonic_s
        self._last_step = step
        wait_s = 0.0
        if self.camera_error_s is not None:
            self._camera_off_s = self._estimate_camera_error_s(step.step_s)
        elif step.gradual or abs(step.step_s) >= LARGE_STEP_S:
            wait_s = self._agreement.stepped(now)
        self._unwritten.append((step, wait_s))

    def _is_leap_second(self, step: ClockStep) -> bool:
        return self._clock.state().leap_second and abs(abs(step.step_s) - 1.0) < _LEAP_WITHIN_S

    @property
    def _least_step_s(self) -> float:
        return self.options.step_s + (0.0 if self.camera_error_s is None else _TRANSPORT_S)

    def _read_clocks(self) -> ClockReading:
        # The two clocks cannot be read at once: the wall's lies between two readings of the other, half of whose
        # distance bounds the error of the pair.
        before_s = self._clock.monotonic()
        wall = self.frame_time.now()
        after_s = self._clock.monotonic()
        return ClockReading(wall=wall, monotonic_s=(before_s + after_s) / 2.0, within_s=after_s - before_s)

    def _estimate_camera_error_s(self, step_s: float) -> float:
        """Return how far the camera's clock may be off: nothing when it stepped back, or agrees with a good host."""
        off_s = self._camera_off_s + step_s
        difference_s = abs((self.frame_time.now() - self._clock.now()).total_seconds())
        agrees = self._kernel_bound_s() <= MAX_CLOCK_ERROR_S and difference_s < _TRANSPORT_S
        return 0.0 if agrees or abs(off_s) <= self._least_step_s else off_s

    def _store_steps(self) -> None:
        """Store the steps, and widen the bounds of sightings stored before a step was found."""
        while self._unwritten:
            step, wait_s = self._unwritten[0]
            try:
                for since, until in step.doubted:
                    self.camera.archive.sightings.widen_clock_errors(
                        self.camera.name, since=since, until=until, error_s=abs(step.step_s)
                    )
                self._store_step_event(step, wait_s)
            except OutsideError as error:
                _log.warning("could not store clock step, will retry: %s", error)
                return
            # Forgotten only now: widening a bound twice changes nothing, and the event was written last.
            self._unwritten.popleft()

    def _store_step_event(self, step: ClockStep, wait_s: float) -> None:
        self.camera.add_event(
            stepped("clock_step", self._name_stepped_clock, step),
            time=step.at,
            severity="warning",
            details={
                "noticed_within_s": step.within_s,
                "synchronised_after": self._clock.state().synchronised,
                "error_bound_s": self._error_bound_s(),
                "gradual": step.gradual,
                "distrusted_s": wait_s,
            },
        )

    @property
    def _name_stepped_clock(self) -> str:
        return "host" if self.camera_error_s is None else "camera"

    def _publish_clock(self) -> None:
        state = self._clock.state()
        last = self._last_step
        self.board.note(
            clock=ClockStatus(
                synchronised=state.synchronised,
                max_error_s=state.error_bound_s,
                last_step_s=None if last is None else last.step_s,
                last_step_at=None if last is None else last.at,
            )
        )
        recent = last is not None and self._clock.monotonic() - last.found_s < SHOW_STEP_S
        self._set_condition(
            "clock_stepped", stepped("clock_stepped", self._name_stepped_clock, last) if last and recent else None
        )
        self._publish_trust()

    def _publish_trust(self) -> None:
        """Show why the time cannot be calibrated with."""
        wait_s = self._agreement.wait_s(self._clock.monotonic())
        offset_s = min(self._camera_offsets_s(), key=abs, default=0.0)
        is_off = abs(offset_s) > _CAMERA_OFFSET_S
        without = bool(self._camera_off_s) or (
            self.camera_error_s is None and self._kernel_bound_s() >= UNKNOWN_ERROR_S
        )
        offset = camera_offset(offset_s, limit_s=_CAMERA_OFFSET_S) if is_off else None
        self._set_condition(
            "clock_settling", Finding("clock_settling", {"wait_s": wait_s}) if wait_s > 0.0 else None, log=True
        )
        self._set_condition("camera_clock_offset", offset)
        self._set_condition("clock_unsynchronised", self._unsynchronised_finding() if without else None, log=True)
        if offset is not None and not self._is_offset_written:
            self._write_offset_event(offset)
        self._is_offset_written = is_off

    def _unsynchronised_finding(self) -> Finding:
        """Return that the clock is not synchronised, with the error that it makes in degrees."""
        return Finding(
            "clock_unsynchronised",
            {
                "clock": self._name_stepped_clock,
                "cost": clock_cost_text(self._served_sigma_deg(), error_s=self._supposed_error_s()),
            },
        )

    def _supposed_error_s(self) -> float:
        """Return how far the unsynchronised clock may be off: the camera's step, or what the kernel states last."""
        return abs(self._camera_off_s) or self._clock.state().error_bound_s

    def _served_sigma_deg(self) -> float | None:
        """Return the 1-sigma over the sky of the served calibration; None without one that can be read."""
        try:
            record = self.camera.archive.calibrations.current(self.camera.name)
        except OutsideError:
            return None
        return None if record is None else record.document.get("uncertainty", {}).get("sky_rms_deg")

    def _write_offset_event(self, offset: Finding) -> None:
        """Write an event when the camera's time is found not to be the host's."""
        try:
            self.camera.add_event(offset, time=self.frame_time.now(), severity="alarm")
        except OutsideError as error:
            _log.warning("could not store an event: %s", error)

    def _set_condition(self, code: str, finding: Finding | None, *, log: bool = False) -> None:
        """Set or clear a condition; without a log line where an event states the same."""
        self.board.set_condition(code, None if finding is None else Reason.of(finding), log=log)


# Conditions of the clock that dates the frames.

_SUN_DEG_PER_S = 360.0 / DAY_S
"""Turn of the sun about the pole in a second, degrees."""
_QUARTZ = 50e-6
"""Rate by which a computer's quartz may be wrong outdoors (data sheets: 20 to 100 ppm)."""
_ABOUT_S = 1.0
"""How near to TAI less UTC a difference must be to be called that."""


def clock_cost_text(sigma_deg: float | None, *, error_s: float = 0.0) -> str:
    """Return in words the error of directions by a clock that nothing corrects.

    Parameters
    ----------
    sigma_deg : the served 1-sigma; None without a calibration.
    error_s : how far the clock may be off now, seconds; 0 where that is not known.
    """
    a_day_deg = significant(_SUN_DEG_PER_S * DAY_S * _QUARTZ, 1)
    if error_s >= DAY_S / 2.0:
        sky = "the clock may be off by a day or more: the sun may be expected anywhere"
    elif error_s > 0.0:
        error_deg = significant(_SUN_DEG_PER_S * error_s, 1)
        sky = f"the clock may be {significant(error_s, 2)} s off: the expected sun may be {error_deg}° off"
        sky += f", and {a_day_deg}° more each day"
    else:
        sky = f"each second that it is wrong moves the expected sun by {_SUN_DEG_PER_S:.4f}°"
    kept = "" if sigma_deg is None else f"; directions of pixels keep their 1-sigma of {significant(sigma_deg, 2)}°"
    return sky + kept


def stepped(code: str, clock: str, step: ClockStep) -> Finding:
    """Return that a clock was set, or moved in small steps."""
    how = f"in small steps within {step.within_s:.0f} s" if step.gradual else "at once"
    at = rfc3339(step.at, timespec="seconds")
    return Finding(code, {"clock": clock, "step_s": step.step_s, "how": how, "at": at})


def is_tai(offset_s: float) -> bool:
    """Return whether two clocks differ by about TAI minus UTC."""
    return abs(abs(offset_s) - TAI_MINUS_UTC_S) < _ABOUT_S


def camera_offset(offset_s: float, *, limit_s: float) -> Finding:
    """Return the finding of a camera's time that differs from the host's, with the likely cause."""
    if is_tai(offset_s):
        cause = f"; {TAI_MINUS_UTC_S:.0f} s is TAI - UTC"
        remedy = f'set camera.timestamp_scale = "{"tai" if offset_s > 0.0 else "utc"}"'
    else:
        cause = ""
        remedy = (
            "check the camera's PTP master and the host's time service; set camera.timestamp_offset_s for a known "
            'offset, or camera.timestamps = "host"'
        )
    return Finding("camera_clock_offset", {"offset_s": offset_s, "limit_s": limit_s, "cause": cause, "remedy": remedy})


# Whether the host's clock has agreed with monotonic time for long enough after a large step.

LARGE_STEP_S = 60.0
"""From this size on a step is no correction of a disciplined clock: a minute turns the sky by 0.25 degrees."""
SETTLE_S = 600.0
"""How long a clock must go without a large or gradual step afterwards; time services settle within minutes."""
IMPLAUSIBLE_SETTLE_S = DAY_S
"""The same where the new time contradicts both the time before and the record: longer than a fault is left alone."""
_LONGEST_GAP = timedelta(days=2)
"""A service that ran until now has a newer sighting than this, unless the sky was covered."""


@dataclass(frozen=True, slots=True)
class _Settling:
    began_s: float
    wait_s: float


class ClockAgreement:
    """Difference of wall clock and monotonic clock, and the time from which a new wall time is accepted."""

    def __init__(self) -> None:
        self._newest_stored: datetime | None = None
        self._good: ClockReading | None = None
        self._began_s: float | None = None
        self._settling: _Settling | None = None

    def wait_s(self, monotonic_s: float) -> float:
        """Return for how long the clock is still distrusted, seconds; 0 where it is not."""
        if self._settling is None:
            return 0.0
        return max(self._settling.began_s + self._settling.wait_s - monotonic_s, 0.0)

    def begin(self, reading: ClockReading, *, newest_stored: datetime | None, remaining_s: float) -> None:
        """Take the first reading of the process that can be compared with the record.

        Parameters
        ----------
        reading : wall time and monotonic time.
        newest_stored : the newest time in the record with a good clock; None without one.
        remaining_s : what is left of a wait that an earlier process began, seconds.
        """
        self._began_s, self._newest_stored = reading.monotonic_s, newest_stored
        if newest_stored is not None:
            gap = reading.wall - newest_stored
            if not -timedelta(seconds=LARGE_STEP_S) <= gap <= _LONGEST_GAP:  # not one service's end and start
                remaining_s = max(remaining_s, SETTLE_S)
        if remaining_s > self.wait_s(reading.monotonic_s):
            self._settling = _Settling(reading.monotonic_s, min(remaining_s, IMPLAUSIBLE_SETTLE_S))

    def stepped(self, reading: ClockReading) -> float:
        """Start the wait after a large or gradual step, and return its length in seconds."""
        wait_s = SETTLE_S if self._is_plausible(reading) else IMPLAUSIBLE_SETTLE_S
        self._settling = _Settling(reading.monotonic_s, wait_s)
        return wait_s

    def agreed(self, reading: ClockReading) -> None:
        """Take a reading of a synchronised clock; once settled, later steps are compared with it."""
        if self.wait_s(reading.monotonic_s) == 0.0:
            self._settling = None
            self._good = reading

    def _is_plausible(self, reading: ClockReading) -> bool:
        """Return whether a new time agrees with the last good one, or follows shortly on the record."""
        if self._good is None:
            return True  # nothing is known that it could contradict
        since_good = timedelta(seconds=reading.monotonic_s - self._good.monotonic_s)
        if abs((reading.wall - self._good.wall - since_good).total_seconds()) <= LARGE_STEP_S:
            return True
        if self._newest_stored is None or self._began_s is None:
            return False
        ran = timedelta(seconds=reading.monotonic_s - self._began_s)
        return self._newest_stored <= reading.wall <= self._newest_stored + ran + _LONGEST_GAP
