"""The source of frames: the camera's cycle of exposures and its composite, or the replay of a folder of images."""

from __future__ import annotations

import logging
import math
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import KW_ONLY, dataclass
from datetime import datetime, timedelta
from typing import Any

import cv2

import sunarc
from sunarc.common.array_types import Image
from sunarc.common.errors import CameraError, CameraLostError, ConfigurationError, InputError, OutsideError
from sunarc.common.utc import rfc3339
from sunarc.detection.values import bayer_of
from sunarc.imager.archive.images import ImageStore
from sunarc.imager.cameras.frame import CameraCondition, Frame, GainCamera, SkyCamera
from sunarc.imager.runtime.clock import Clock
from sunarc.imager.runtime.loop import DropOldestQueue, Loop, Pauses, entries
from sunarc.imager.runtime.status import CameraStatus, StatusRegistry, condition
from sunarc.imager.workers.capture_status import CaptureReport
from sunarc.imager.workers.clock_watch import FrameTime
from sunarc.imager.workers.exposures import ExposureSequence, SunExposures
from sunarc.imager.workers.night.exposures import NightCapture
from sunarc.imager.workers.options import CaptureOptions, SensorOptions, sensor_of
from sunarc.imager.workers.sun_prediction import SunPredictor
from sunarc.imaging.brightness import MOST_ALL_OVER, Exposed, Level, factor_all_over, level_of
from sunarc.imaging.hdr import HdrImage, merge_hdr
from sunarc.imaging.metadata import jpeg_with, png_with
from sunarc.imaging.preview import preview
from sunarc.sky.site import Site
from sunarc.sky.sun import DARK_ZENITH_DEG, sun_angles

# Consistency of consecutive cycles: the overall brightness may not jump from one to the next.

COMPARABLE_S = 120.0
"""Cycles further apart may show another sky: their levels are not compared."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Cycle:
    """The frames of one cycle; a normal exposure that failed is None."""

    normal: tuple[Frame | None, ...]
    sun: tuple[Frame, ...]

    @property
    def good(self) -> list[Frame]:
        """The normal frames that succeeded."""
        return [frame for frame in self.normal if frame is not None]

    @property
    def complete(self) -> bool:
        """True where every normal exposure succeeded."""
        return None not in self.normal


class CycleConsistencyFilter:
    """Delays the first cycle until a second has the same brightness; compares each later one with the last accepted.

    Parameters
    ----------
    cadence_s : seconds between cycles; beyond half of `COMPARABLE_S`, where one that is missed leaves the others too
        far apart, nothing is compared and nothing held back.
    """

    def __init__(self, *, cadence_s: float) -> None:
        self._comparing = cadence_s <= COMPARABLE_S / 2.0
        self._reference: _CycleLevel | None = None
        self._held_back: tuple[Cycle, _CycleLevel] | None = None

    def contradiction(self, frames: Sequence[Frame]) -> str | None:
        """Return how a cycle's normal frames contradict the last accepted cycle, one sentence; None: they do not."""
        if not frames or self._reference is None:
            return None
        factor = self._reference.factor_to(_level_of_cycle(frames))
        if factor is None or _is_possible(factor):
            return None
        return (
            f"image {factor:.2g}× as bright as the previous cycle; accepted only if it stays so for {COMPARABLE_S:g} s"
        )

    def accepted_cycles(self, taken: Cycle) -> list[Cycle]:
        """Return the cycles to hand on now that this one is whole: an empty list, this one, or one held back too."""
        level = _level_of_cycle(taken.good)
        if self._reference is not None and self._reference.factor_to(level) is not None:
            self._reference, self._held_back = level, None
            return [taken]
        if not self._comparing or not level.tells:
            self._reference = self._held_back = None
            return [taken]
        return self._first(taken, level)

    def _first(self, taken: Cycle, level: _CycleLevel) -> list[Cycle]:
        """Delay a cycle without a reference; or return it together with the delayed one before it.

        Two that are too far apart to be compared are let go: nothing speaks against them, and nothing ever could.
        """
        held_back, self._held_back = self._held_back, (taken, level)
        self._reference = None
        if held_back is None:
            return []
        factor = held_back[1].factor_to(level)
        if factor is not None and not _is_possible(factor):
            _log.warning("discarded a cycle: brightness inconsistent with the cycles before and after")
            return []
        self._reference, self._held_back = level, None
        return [held_back[0], taken]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _CycleLevel:
    """A cycle's level, and when it was, seconds since 1970."""

    level: Level
    at_s: float

    @property
    def tells(self) -> bool:
        """True where there is contrast enough to compare others with it."""
        return factor_all_over(self.level, self.level) is not None

    def factor_to(self, later: _CycleLevel) -> float | None:
        """Return `factor_all_over` from here to there; None where the two are too far apart too."""
        if abs(later.at_s - self.at_s) > COMPARABLE_S * 1.001:
            return None
        return factor_all_over(self.level, later.level)


def _level_of_cycle(frames: Sequence[Frame]) -> _CycleLevel:
    exposed = [Exposed(image=f.image, exposure_us=f.exposure_us, full_scale=f.full_scale) for f in frames]
    return _CycleLevel(level=level_of(exposed), at_s=frames[0].time.timestamp())


def _is_possible(factor: float) -> bool:
    return 1.0 / MOST_ALL_OVER <= factor <= MOST_ALL_OVER


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
                    for _ in self._slots(camera, loop):
                        # Only a slot that succeeded ends the back-off: a camera may open and then fail at once.
                        failures = 1
            except CameraError as error:
                self._report.lost(error)
            except (ConfigurationError, InputError) as error:
                self._report.refused(error)
                failures = _REFUSED
            loop.wait(pauses.after(failures))

    def _slots(self, camera: SkyCamera, loop: Loop) -> Iterator[datetime]:
        """Serve slot after slot, and yield each that succeeded."""
        exposer = self._exposer(camera, deadline_s=math.inf)
        # The camera dates the frames: before its first one there is no time to find a slot by.
        if not self.frame_time.is_known:
            self._sign_of_life(exposer, camera.info.exposure_min_us)
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
                self._serve(real_every_s=real_every_s)
                self.cycle(camera, slot, within_s=real_every_s - lead_s)
            else:
                self._last_slot_at_s = None
                self._at_night(exposer, camera)
            yield slot

    def _next_slot(self, *, every_s: float) -> datetime:
        """Return the next slot that was not served."""
        slot = self.frame_time.next_slot(every_s=every_s)
        real_every_s = every_s / self.frame_time.speed
        at_s = self.clock.monotonic() + self.frame_time.real_seconds_until(slot)
        if self._last_slot_at_s is not None and at_s - self._last_slot_at_s < real_every_s / 2.0:
            slot += timedelta(seconds=every_s)  # the clock was set back, or repeats a leap second
        return slot

    def _serve(self, *, real_every_s: float) -> None:
        """Note that a slot is served, and count those that passed since the last."""
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
        """Take the exposures of one slot and hand them over, once the camera says that nothing of it has changed."""
        began_at = self.clock.monotonic()
        done_at: list[float] = []
        exposer = self._exposer(camera, deadline_s=began_at + within_s)
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
        taken = Cycle(normal=tuple(normal), sun=tuple(self._sun_frames_beside(good, exposer, camera)))
        self._report.condition(camera.check())
        for accepted in self._consistency.accepted_cycles(taken):
            self._hand_over(accepted)
        self._report.cycle(
            complete=taken.complete,
            overran=overran,
            jitter_s=None if normal[0] is None else self._late_s(normal[0], slot),
            hdr_s=done_at[-1] - began_at,
        )

    def _hand_over(self, taken: Cycle) -> None:
        # A composite needs every normal exposure; the sun's frames are of use one by one.
        if taken.complete:
            self.cycles.put(taken.good)
        for frame in taken.sun:
            self.sun_frames.put(frame)

    def _sun_frames_beside(self, normal: Sequence[Frame], exposer: ExposureSequence, camera: SkyCamera) -> list[Frame]:
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

    def _at_night(self, exposer: ExposureSequence, camera: SkyCamera) -> None:
        """Take the stars and the moon once it is dark, before that and without `night` a sign of life."""
        if self.night is None or self.apparent_zenith() < DARK_ZENITH_DEG:
            self._sign_of_life(exposer, max(self.options.hdr_exposures_us))
            return
        exposure_us, raised_db = self.night.exposures.next_us(camera.info.exposure_bounds)
        frame = self._night_gain.take(camera, raised_db, lambda: exposer.take(exposure_us))
        self._report.sign_of_life(succeeded=frame is not None)
        if frame is not None:
            if self._report.night_level(frame, apparent_zenith=self.apparent_zenith()):
                self._sign_of_life(exposer, max(self.options.hdr_exposures_us))  # daylight, or stars in a bright sky
            self.night.frames.put(frame)
        if self.night.moon is not None:
            wanted = self.night.moon.exposures.next_us(self.frame_time.now(), camera.info.exposure_bounds)
            taken = tuple(one for us in wanted if (one := exposer.take(us)) is not None)
            if taken:
                self.night.moon.frames.put(taken)

    def _sign_of_life(self, exposer: ExposureSequence, exposure_us: float) -> None:
        """Take an exposure that shows only that the camera answers, and its time."""
        frame = exposer.take(exposure_us)
        self._report.sign_of_life(succeeded=frame is not None)
        if frame is not None:
            self._report.night_level(frame, apparent_zenith=self.apparent_zenith())

    def _exposer(self, camera: SkyCamera, *, deadline_s: float) -> ExposureSequence:
        return ExposureSequence(
            camera=camera,
            has_time=lambda: self.clock.monotonic() < deadline_s,
            report=self._report,
            received=self._received,
        )

    def _late_s(self, first: Frame, slot: datetime) -> float | None:
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

    def _received(self, frame: Frame) -> None:
        """Take the time from a frame, whose exposure has just ended."""
        ended_at = frame.time + timedelta(microseconds=frame.exposure_us / 2.0)
        self.frame_time.note(ended_at, host_offset_s=frame.host_offset_s)
        self._report.frame(frame)
        self.on_frame(frame)


# The gain of the night: raised for one exposure, restored after it, and days blocked where that fails.

_log = logging.getLogger(__name__)
CODE = "gain_not_restored"


class NightGain:
    """Takes an exposure with a raised gain.

    A frame of the day with the gain of the night would spoil its sightings. So the gain is restored and read back
    before anything else is done with the camera; where it stays raised, the camera is let go, and after it was opened
    again no slot is served before the gain is what the settings say.

    Parameters
    ----------
    board : where the condition `gain_not_restored` is set.
    """

    def __init__(self, board: StatusRegistry) -> None:
        self._board = board
        self._raised = False

    def take(self, camera: SkyCamera, raised_db: float, expose: Callable[[], Frame | None]) -> Frame | None:
        """Return a frame with a gain raised by `raised_db`, or as it is where the camera has no gain to set.

        Raises
        ------
        CameraLostError
            The gain could not be restored.
        """
        if raised_db <= 0.0 or camera.info.gain_raise_db <= 0.0 or not isinstance(camera, GainCamera):
            return expose()
        self._raised = True
        try:
            camera.raise_gain(min(raised_db, camera.info.gain_raise_db))
            return expose()
        except CameraLostError:
            raise
        except CameraError as error:
            _log.warning("the gain of the night was not set: %s", error)
            return None
        finally:
            self.restore(camera)

    def restore(self, camera: SkyCamera) -> None:
        """Restore the gain where it was raised, and read it back; CameraLostError where it is another one."""
        if not self._raised or not isinstance(camera, GainCamera):
            return
        try:
            camera.restore_gain()
        except CameraError as error:
            reason = condition(CODE, severity="not_ready", error=str(error))
            self._board.set_condition(CODE, reason)
            raise CameraLostError(f"the gain of the night was not restored: {error}") from error
        self._raised = False
        self._board.set_condition(CODE, None)


_POLL_S = 0.2
_SUN_EXPOSURE_BELOW_US = 1000.0


@dataclass(kw_only=True, eq=False)
class ReplayWorker:
    """Puts the microsecond images of a folder into the queue, in order, and then waits to be stopped.

    Parameters
    ----------
    open_camera : opens the folder; raises `CameraError` when there is nothing to play.
    clock, frame_time : real time, and the time of the images.
    name : the camera's name on the board.
    sun_frames : where the images of the sun go; nothing is dropped, the replay waits for room.
    board : where the replay's state is shown.
    """

    open_camera: Callable[[], SkyCamera]
    clock: Clock
    frame_time: FrameTime
    name: str
    sun_frames: DropOldestQueue[Frame]
    board: StatusRegistry

    def run(self, stop: threading.Event, heartbeat: Callable[[], None]) -> None:
        """Play the folder once; one that does not match the stored camera is refused with a condition."""
        loop = Loop(self.clock, stop, heartbeat)
        try:
            with closing(self.open_camera()) as camera:
                self.board.note(camera=CameraStatus(name=self.name, connected=True, address=camera.info.address))
                self._play(camera, loop)
        except (ConfigurationError, InputError) as error:
            CaptureReport(self.board, name=self.name).refused(error)
        loop.every(_POLL_S, lambda: None)

    def _play(self, camera: SkyCamera, loop: Loop) -> None:
        for _ in loop.turns():
            try:
                frame = camera.expose(0.0)
            except CameraLostError as end:
                _log.info("%s", end)
                return
            self.frame_time.note(frame.time)
            self.board.note(last_frame_at=frame.time)
            if frame.exposure_us < _SUN_EXPOSURE_BELOW_US:
                self._hand_on(frame, loop)

    def _hand_on(self, frame: Frame, loop: Loop) -> None:
        while self.sun_frames.full and not loop.wait(_POLL_S):
            pass
        self.sun_frames.put(frame)


# Composites from the normal exposures of a cycle, and their metadata.

NOT_WRITTEN = "images_not_written"
"""Condition of a disk that refuses images."""


@dataclass(eq=False)
class ComposeWorker:
    """Merges the exposures of each cycle and writes the composite and its preview.

    Parameters
    ----------
    cycles : the frames of one cycle at a time.
    store : where composites go.
    options : the sensor.
    describe : text of a composite's file about itself.
    board : where a disk that refuses is reported.
    show : called with each composite and its time.
    """

    cycles: DropOldestQueue[Sequence[Frame]]
    _: KW_ONLY
    store: ImageStore
    options: SensorOptions
    describe: Callable[[Sequence[Frame], HdrImage], Mapping[str, Any]]
    board: StatusRegistry
    show: Callable[[Image, datetime], None] = lambda _image, _time: None

    def run(self, stop: threading.Event, heartbeat: Callable[[], None]) -> None:
        """Work until stopped, and then until nothing waits."""
        for frames in entries(self.cycles, stop, heartbeat):
            if frames is not None:
                self.compose(frames)

    def compose(self, frames: Sequence[Frame]) -> None:
        """Merge the exposures of one cycle and write both files; a disk that refuses costs this composite alone."""
        sensor = sensor_of(frames[0], self.options)
        composite = merge_hdr(
            [frame.image for frame in frames],
            [frame.exposure_us for frame in frames],
            sensor=sensor,
        )
        document = self.describe(frames, composite)
        png = png_with(
            encode(composite.image, ".png"),
            document,
            software=f"sunarc {sunarc.__version__}",
            created=document["time_utc"],
        )
        jpeg = jpeg_with(encode(preview(composite.image, bayer=sensor.bayer), ".jpg"), {**document, "preview": True})
        captured_at = frames[0].time
        try:
            self.store.write(captured_at, png, kind="hdr.png")
            self.store.write(captured_at, jpeg, kind="hdr.jpg")
        except OutsideError as error:
            self.board.set_condition(NOT_WRITTEN, condition(NOT_WRITTEN, error=str(error)))
        else:
            self.board.set_condition(NOT_WRITTEN, None)
        self.show(composite.image, captured_at)


def encode(image: Image, suffix: str) -> bytes:
    """Return an image as the bytes of a file of this kind; PNG at its fastest compression.

    That is OpenCV's own choice: level 1 named alone gives up its filter and strategy, and takes twice the time.
    """
    done, encoded = cv2.imencode(suffix, image)
    if not done:
        raise OutsideError(f"an image could not be encoded as {suffix}")
    return encoded.tobytes()


SCHEMA = "sunarc.image/1"


def image_document(
    frames: Sequence[Frame], composite: HdrImage, *, camera: str, site: Site, predictor: SunPredictor
) -> dict[str, Any]:
    """Return the document of a composite, as docs/operating.md lists it.

    Parameters
    ----------
    frames : what it was merged from, in the order taken.
    composite : the merge.
    camera, site : its name, and where it stands.
    predictor : which calibration is current, and where it puts the sun.
    """
    first = frames[0]
    return {
        "schema": SCHEMA,
        "preview": False,
        "camera": camera,
        "time_utc": rfc3339(first.time, timespec="microseconds"),
        "exposures": [
            {
                "time_utc": rfc3339(frame.time, timespec="microseconds"),
                "exposure_us": frame.exposure_us,
                "gain_db": frame.gain_db,
                "frame_id": frame.frame_id,
            }
            for frame in frames
        ],
        "pixel_format": first.pixel_format,
        "bayer": bayer_of(first.pixel_format),
        "counts_per_us": composite.counts_per_us,
        "saturated_px": composite.saturated_px,
        "calibration": predictor.calibration_id(),
        "sun": _sun(first.time, site, predictor),
        "site": {"latitude": site.latitude, "longitude": site.longitude, "altitude": site.altitude},
        "software": {"name": "sunarc", "version": sunarc.__version__},
    }


def _sun(time: datetime, site: Site, predictor: SunPredictor) -> dict[str, float | None]:
    angles = sun_angles(time.timestamp(), site)
    expected = predictor.expectation(time)
    return {
        "apparent_zenith": round(float(angles.apparent_zenith), 5),
        "azimuth": round(float(angles.azimuth), 5),
        "x_px": None if expected is None else round(expected.x_px, 3),
        "y_px": None if expected is None else round(expected.y_px, 3),
    }
