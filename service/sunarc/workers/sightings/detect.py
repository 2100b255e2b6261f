"""Sightings from sun exposures."""

from __future__ import annotations

import threading
from collections.abc import Callable
from dataclasses import replace
from datetime import datetime, timedelta
from typing import NamedTuple

from sunarc.archive.seen import sun_point_of
from sunarc.cameras.frame import Frame
from sunarc.detection.disc.bracket import beside
from sunarc.detection.disc.detect import detect_sun
from sunarc.detection.options import DiscOptions
from sunarc.detection.values import Detection, Expectation
from sunarc.findings import Finding
from sunarc.runtime.status import StatusRegistry
from sunarc.workers.bounded_queue import DropOldestQueue
from sunarc.workers.sensor import SensorOptions, sensor_of
from sunarc.workers.sightings.frozen_frames import FrozenFrames
from sunarc.workers.sightings.sun_prediction import SunPredictor
from sunarc.workers.sightings.write_buffer import SightingWriteBuffer

_POLL_S = 0.5
_PERHAPS_ELSEWHERE = frozenset({"hidden", "reflection", "obstructed"})


class _FrameResult(NamedTuple):
    """A frame of the bracket: time, detection and prediction."""

    time: datetime
    detection: Detection
    expectation: Expectation | None


class DetectWorker:
    """Detects the sun in each frame of the queue, and stores the sighting, accepted or not.

    Parameters
    ----------
    frames : the sun exposures, oldest first.
    keeper, camera : who stores the sightings, and under which name.
    predictor : where the sun should be.
    options, disc : the sensor, and the detector's settings.
    clock_error_s : bound of the error of a frame's time, seconds.
    report : called with every detection (for the exposure controller).
    board : where the time of the last sighting is shown.
    frozen : rejects sightings in images that the camera had delivered before.
    cadence_s : seconds from cycle to cycle; frames nearer than half of it are one bracket.
    """

    def __init__(
        self,
        frames: DropOldestQueue[Frame],
        *,
        keeper: SightingWriteBuffer,
        camera: str,
        predictor: SunPredictor,
        options: SensorOptions,
        disc: DiscOptions,
        clock_error_s: Callable[[datetime], float],
        report: Callable[[Frame, Detection], None],
        board: StatusRegistry,
        frozen: FrozenFrames,
        cadence_s: float,
    ) -> None:
        self._frames = frames
        self._keeper = keeper
        self._camera = camera
        self._predictor = predictor
        self._options = options
        self._disc = disc
        self._clock_error_s = clock_error_s
        self._report = report
        self._board = board
        self._frozen = frozen
        self._bracket_of = timedelta(seconds=0.5 * cadence_s)
        self._bracket: list[_FrameResult] = []

    def run(self, stop: threading.Event, heartbeat: Callable[[], None]) -> None:
        """Work until stopped, and then until nothing waits."""
        while True:
            heartbeat()
            frame = self._frames.get(timeout_s=_POLL_S)
            if frame is not None:
                self.process(frame)
            elif stop.is_set():
                self._keeper.give_up()
                return
            elif self._keeper.waiting:
                self._keeper.store()

    def process(self, frame: Frame) -> Detection:
        """Detect, store and report one frame."""
        expectation = self._predictor.expectation(frame.time)
        detection = detect_sun(
            frame.image,
            sensor=sensor_of(frame, self._options),
            expectation=expectation,
            options=self._with_brightness(frame.time),
            exposure_us=frame.exposure_us,
        )
        detection = self._beside_bracket(frame, detection, expectation)
        detection = self._or_elsewhere(frame, detection, expectation)
        detection = self._frozen.checked(frame, detection)
        point = sun_point_of(
            detection,
            camera=self._camera,
            pose_epoch="",
            time=frame.time,
            exposure_us=frame.exposure_us,
            clock_error_s=self._clock_error_s(frame.time),
        )
        # While frames wait, their sightings share a commit: on a device that stalls one each would fill the queue.
        self._keeper.keep(point, store=len(self._frames) == 0)
        self._report(frame, detection)
        if detection.accepted:
            self._board.note(last_sighting_at=frame.time)
        return detection

    def _beside_bracket(self, frame: Frame, detection: Detection, expectation: Expectation | None) -> Detection:
        """Return the detection, checked against the cycle's earlier frames, and keep it for the later ones."""
        if self._bracket and not timedelta(0) <= frame.time - self._bracket[0].time < self._bracket_of:
            self._bracket = []
        earlier = tuple(self._bracket)
        self._bracket.append(_FrameResult(frame.time, detection, expectation))
        shifts = [_shift(result.expectation, expectation) for result in earlier]
        known = [shift for shift in shifts if shift is not None]
        complete = known if len(known) == len(shifts) else None
        return beside([result.detection for result in earlier], detection, shifts=complete)

    def _or_elsewhere(self, frame: Frame, found: Detection, expectation: Expectation | None) -> Detection:
        """Return what was found, or a clean disc anywhere in a frame that has none where it is due."""
        if found.accepted or expectation is None or found.verdict not in _PERHAPS_ELSEWHERE:
            return found
        sensor, options = sensor_of(frame, self._options), self._with_brightness(frame.time)
        anywhere = detect_sun(frame.image, sensor=sensor, options=options, exposure_us=frame.exposure_us)
        if not anywhere.accepted:
            return found
        findings = (Finding("sun_elsewhere"), *found.findings)
        return replace(anywhere, accepted=False, verdict="elsewhere", findings=findings)

    def _with_brightness(self, time: datetime) -> DiscOptions:
        """Return the detector's settings with the clear sun's level as it was learned, unless it was set."""
        if self._disc.clear_level_per_us:
            return self._disc
        return replace(self._disc, clear_level_per_us=self._predictor.clear_level_per_us(time))


def _shift(before: Expectation | None, now: Expectation | None) -> tuple[float, float] | None:
    """Return how far the sun moved, px; None where that is not known."""
    return None if before is None or now is None else (now.x_px - before.x_px, now.y_px - before.y_px)
