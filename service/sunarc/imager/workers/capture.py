"""Capture: the camera's cycle of exposures in each slot, and its images of the night."""

from __future__ import annotations

import math
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing
from dataclasses import dataclass
from datetime import datetime, timedelta

from sunarc.common.errors import CameraError, CameraLostError, ConfigurationError, InputError
from sunarc.imager.cameras.frame import CameraCondition, Frame, SkyCamera
from sunarc.imager.runtime.clock import Clock
from sunarc.imager.runtime.loop import DropOldestQueue, Loop, Pauses
from sunarc.imager.runtime.status import StatusRegistry
from sunarc.imager.workers.capture_status import CaptureReport
from sunarc.imager.workers.clock_watch import FrameTime
from sunarc.imager.workers.cycles import Cycle, CycleConsistencyFilter
from sunarc.imager.workers.exposures import ExposureSequence, SunExposures
from sunarc.imager.workers.night.exposures import NightCapture, NightGain
from sunarc.imager.workers.options import CaptureOptions
from sunarc.sky.sun import DARK_ZENITH_DEG

_REFUSED = 30  # counts as so many failures: the longest pause
_DAYLIGHT_ZENITH_DEG = 96.0
"""Composites are made while the sun's apparent zenith angle is below this: until the end of civil twilight."""
_LEAD_S = 2.0  # before a slot the camera is looked at, and until then the slot before is over
_LEAD_SHARE = 0.2  # of short cadences


@dataclass(kw_only=True, eq=False)
class CaptureWorker:
    """Drives the camera, and reopens it whenever it is lost.

    Parameters
    ----------
    open_camera : opens the camera; raises `CameraError` when it does not answer.
    clock, frame_time : real time, and the time of the frames.
    options : the cadence.
    name : the camera's name on the board.
    apparent_zenith : the sun's, in degrees, at a frame time.
    sun_exposures : which sun exposures to take next.
    cycles, sun_frames : where the normal frames of a cycle and the sun frames go.
    board : where the camera's state is shown.
    night : chooses the exposures of the night, and takes their frames; None takes no stars.
    on_frame : called with every frame as soon as it is there, in the thread of capture.
    """

    open_camera: Callable[[], SkyCamera]
    clock: Clock
    frame_time: FrameTime
    options: CaptureOptions
    name: str
    apparent_zenith: Callable[[], float]
    sun_exposures: SunExposures
    cycles: DropOldestQueue[Sequence[Frame]]
    sun_frames: DropOldestQueue[Frame]
    board: StatusRegistry
    night: NightCapture | None = None
    on_frame: Callable[[Frame], None] = lambda _: None

    def __post_init__(self) -> None:
        """Begin without a slot."""
        self._report = CaptureReport(self.board, name=self.name)
        self._night_gain = NightGain(self.board)
        self._consistency = CycleConsistencyFilter(cadence_s=self.options.cadence_s)
        self._refused_us: frozenset[float] = frozenset()
        self._last_slot_at_s: float | None = None
        self._missed_before = 0

    def run(self, stop: threading.Event, heartbeat: Callable[[], None]) -> None:
        """Capture until stopped; a lost camera is opened again, ever less often."""
        loop = Loop(self.clock, stop, heartbeat)
        pauses, failures = Pauses(self.options.reopen_after_s, self.options.reopen_at_most_s), 0
        for _ in loop.turns():
            failures += 1
            try:
                with closing(self.open_camera()) as camera:
                    self._require_exposures(camera)
                    self._night_gain.restore(camera)
                    self._report.opened(camera.info)
                    for _ in self._serve_slots(camera, loop):
                        # Only a slot that succeeded ends the back-off: a camera may open and then fail at once.
                        failures = 1
            except CameraError as error:
                self._report.lost(error)
            except (ConfigurationError, InputError) as error:
                self._report.refused(error)
                failures = _REFUSED
            loop.wait(pauses.after(failures))

    def _serve_slots(self, camera: SkyCamera, loop: Loop) -> Iterator[datetime]:
        """Serve slot after slot, and yield each that succeeded."""
        exposer = self._new_exposure_sequence(camera, deadline_s=math.inf)
        # The camera dates the frames: before its first one there is no time to find a slot by.
        if not self.frame_time.is_known:
            self._test_camera(exposer, camera.info.exposure_min_us)
        for _ in loop.turns():
            daylight = self.apparent_zenith() < _DAYLIGHT_ZENITH_DEG
            every_s = self.options.cadence_s if daylight else self.options.night_cadence_s
            real_every_s = every_s / self.frame_time.speed
            slot = self._next_slot(every_s=every_s)
            lead_s = min(_LEAD_S, _LEAD_SHARE * real_every_s)
            if loop.wait(self.frame_time.real_seconds_until(slot) - lead_s):
                return
            self._follow_speed(camera.check())  # a change is noticed before the slot, and costs it nothing
            remaining_s = self.frame_time.real_seconds_until(slot)
            if not -real_every_s / 2.0 < remaining_s <= 2.0 * lead_s:
                continue  # the clock was set meanwhile: another slot is the next one
            if loop.wait(remaining_s):
                return
            if daylight:
                self._mark_slot_served(real_every_s=real_every_s)
                self.cycle(camera, slot, within_s=real_every_s - lead_s)
            else:
                self._last_slot_at_s = None
                self._take_night_frames(exposer, camera)
            yield slot

    def _next_slot(self, *, every_s: float) -> datetime:
        """Return the next slot that was not served."""
        slot = self.frame_time.next_slot(every_s=every_s)
        real_every_s = every_s / self.frame_time.speed
        at_s = self.clock.monotonic() + self.frame_time.real_seconds_until(slot)
        if self._last_slot_at_s is not None and at_s - self._last_slot_at_s < real_every_s / 2.0:
            slot += timedelta(seconds=every_s)  # the clock was set back, or repeats a leap second
        return slot

    def _mark_slot_served(self, *, real_every_s: float) -> None:
        """Mark a slot as served, and count the slots missed since the last one."""
        now_s = self.clock.monotonic()
        self._missed_before = 0
        if self._last_slot_at_s is not None:
            self._missed_before = max(round((now_s - self._last_slot_at_s) / real_every_s) - 1, 0)
        self._report.add(missed=self._missed_before)
        self._last_slot_at_s = now_s

    def _follow_speed(self, condition: CameraCondition) -> None:
        """Follow the speed of a simulated camera's clock."""
        if condition.speed is not None and condition.speed != self.frame_time.speed:
            self.frame_time.set_speed(condition.speed)

    def cycle(self, camera: SkyCamera, slot: datetime, *, within_s: float) -> None:
        """Take the exposures of one slot, and pass them on once the camera confirms its settings."""
        began_at = self.clock.monotonic()
        done_at: list[float] = []
        exposer = self._new_exposure_sequence(camera, deadline_s=began_at + within_s)
        normal = exposer.take_agreeing(
            self.options.hdr_exposures_us,
            taken=lambda: done_at.append(self.clock.monotonic()),
            inconsistency_of=self._consistency.contradiction,
        )
        good = [frame for frame in normal if frame is not None]
        if not good:
            raise CameraLostError(f"no exposure of a whole cycle succeeded; the last time: {self._report.failure}")
        overran = not exposer.has_time()
        self._report.normal_frames(good, apparent_zenith=self.apparent_zenith())
        taken = Cycle(normal=tuple(normal), sun=tuple(self._take_sun_frames(good, exposer, camera)))
        self._report.condition(camera.check())
        for accepted in self._consistency.accepted_cycles(taken):
            self._queue_frames(accepted)
        self._report.cycle(
            complete=taken.complete,
            overran=overran,
            jitter_s=None if normal[0] is None else self._measure_delay_s(normal[0], slot),
            hdr_s=done_at[-1] - began_at,
        )

    def _queue_frames(self, taken: Cycle) -> None:
        # A composite needs every normal exposure; the sun's frames are of use one by one.
        if taken.complete:
            self.cycles.put(taken.good)
        for frame in taken.sun:
            self.sun_frames.put(frame)

    def _take_sun_frames(self, normal: Sequence[Frame], exposer: ExposureSequence, camera: SkyCamera) -> list[Frame]:
        """Take the sun exposures of a cycle, while there is time."""
        if self.apparent_zenith() >= self.options.sun_zenith_deg:
            return []
        selected = self.sun_exposures.choose(camera.info)
        taken, self._refused_us = exposer.take_bracket(selected, normal[:1], refused_before_us=self._refused_us)
        self._report.sun_slot(
            observed=bool(taken),
            failed=not taken and exposer.has_time(),
            missed_before=self._missed_before,
            dropped=self.sun_frames.dropped,
        )
        return taken

    def _take_night_frames(self, exposer: ExposureSequence, camera: SkyCamera) -> None:
        """Take the exposures of stars and moon once it is dark; before, or without `night`, a test exposure."""
        if self.night is None or self.apparent_zenith() < DARK_ZENITH_DEG:
            self._test_camera(exposer, max(self.options.hdr_exposures_us))
            return
        exposure_us, raised_db = self.night.exposures.next_us(camera.info.exposure_bounds)
        frame = self._night_gain.take(camera, raised_db, lambda: exposer.take(exposure_us))
        self._report.record_test_exposure(succeeded=frame is not None)
        if frame is not None:
            if self._report.night_level(frame, apparent_zenith=self.apparent_zenith()):
                self._test_camera(exposer, max(self.options.hdr_exposures_us))  # daylight, or stars in a bright sky
            self.night.frames.put(frame)
        if self.night.moon is not None:
            wanted = self.night.moon.exposures.next_us(self.frame_time.now(), camera.info.exposure_bounds)
            taken = tuple(one for us in wanted if (one := exposer.take(us)) is not None)
            if taken:
                self.night.moon.frames.put(taken)

    def _test_camera(self, exposer: ExposureSequence, exposure_us: float) -> None:
        """Take an exposure that only tests whether the camera answers, and gives its time."""
        frame = exposer.take(exposure_us)
        self._report.record_test_exposure(succeeded=frame is not None)
        if frame is not None:
            self._report.night_level(frame, apparent_zenith=self.apparent_zenith())

    def _new_exposure_sequence(self, camera: SkyCamera, *, deadline_s: float) -> ExposureSequence:
        return ExposureSequence(
            camera=camera,
            has_time=lambda: self.clock.monotonic() < deadline_s,
            report=self._report,
            received=self._note_frame,
        )

    def _measure_delay_s(self, first: Frame, slot: datetime) -> float | None:
        """Return the real seconds from a slot to its first frame's beginning; None where the clock was set between."""
        began = first.time - timedelta(microseconds=first.exposure_us / 2.0)
        late_s = (began - slot).total_seconds()
        return late_s / self.frame_time.speed if abs(late_s) < self.options.cadence_s else None

    def _require_exposures(self, camera: SkyCamera) -> None:
        beyond = camera.info.unreachable(self.options.hdr_exposures_us)
        if beyond is not None:
            raise InputError(
                field="capture.hdr_exposures_us", problem=beyond, remedy="set exposures that the camera can take"
            )

    def _note_frame(self, frame: Frame) -> None:
        """Set the frame time by a frame, whose exposure has just ended."""
        ended_at = frame.time + timedelta(microseconds=frame.exposure_us / 2.0)
        self.frame_time.note(ended_at, host_offset_s=frame.host_offset_s)
        self._report.frame(frame)
        self.on_frame(frame)
