"""The exposures of a slot: how long the sun's are, and taking them until their brightness agrees."""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable, Sequence
from dataclasses import KW_ONLY, dataclass
from itertools import pairwise

import numpy as np

from sunarc.common.errors import CameraError, CameraLostError, ExposureMismatchError
from sunarc.detection.values import Detection
from sunarc.imager.cameras.frame import CameraInfo, Frame, SkyCamera
from sunarc.imager.runtime.status import StatusRegistry, condition
from sunarc.imager.workers.capture_status import CaptureReport
from sunarc.imaging import exposure
from sunarc.imaging.brightness import Exposed, light_ratio_contradiction

_log = logging.getLogger(__name__)

_ATTEMPTS = 2
"""How often one exposure is tried before the cycle goes on without it: a third try would take the next one's slot."""
_COMPARABLE_S = 5.0  # frames further apart may show another sky


@dataclass(frozen=True, slots=True, kw_only=True)
class ExposureSequence:
    """Exposures taken until a deadline, so that the next slot finds the camera free.

    Parameters
    ----------
    camera : open.
    has_time : whether another attempt may begin.
    report : where retries and losses are counted.
    received : called with every frame as soon as it is there.
    """

    camera: SkyCamera
    has_time: Callable[[], bool]
    report: CaptureReport
    received: Callable[[Frame], None]

    def take(self, exposure_us: float) -> Frame | None:
        """Return a frame, or None when every attempt failed; CameraLostError passes."""
        for attempt in range(_ATTEMPTS):
            if attempt and not self.has_time():
                break
            self.report.add(retries=int(attempt > 0))
            try:
                frame = self.camera.expose(exposure_us)
            # Not worth a second try: only opening the camera anew helps, which the worker does.
            except CameraLostError:
                raise
            except CameraError as error:
                _log.warning("exposure of %g us failed: %s", exposure_us, error)
                self.report.failed(error)
            else:
                self.received(frame)
                return frame
        self.report.add(failures=1)
        return None

    def take_agreeing(
        self,
        exposures_us: Sequence[float],
        *,
        taken: Callable[[], None] = lambda: None,
        inconsistency_of: Callable[[Sequence[Frame]], str | None] = lambda _: None,
    ) -> list[Frame | None]:
        """Return frames whose brightness agrees from neighbour to neighbour; those that failed are None.

        Parameters
        ----------
        exposures_us : in the order of taking.
        taken : called after each round, before anything is judged.
        inconsistency_of : says what else speaks against a round as a whole, one sentence.

        Raises
        ------
        ExposureMismatchError
            They never agreed: the camera is to be opened anew.
        """
        for attempt in range(_ATTEMPTS):
            if attempt and not self.has_time():
                break
            self.report.add(retries=len(exposures_us) if attempt else 0)
            frames = [self.take(exposure_us) for exposure_us in exposures_us]
            taken()
            good = [frame for frame in frames if frame is not None]
            # Neighbours alone are compared: of two distant exposures one may be black or saturated.
            inconsistency = next(
                (d for pair in pairwise(good) if (d := contradiction(*pair)) is not None), inconsistency_of(good)
            )
            if inconsistency is None:
                return frames
            self._mark_suspect(inconsistency)
        raise ExposureMismatchError(f"frame brightness inconsistent with exposure times: {inconsistency}")

    def take_bracket(
        self,
        exposures_us: Sequence[float],
        references: Sequence[Frame],
        *,
        refused_before_us: frozenset[float] = frozenset(),
    ) -> tuple[list[Frame], frozenset[float]]:
        """Return the frames whose brightness agrees with that of other exposures, and the exposures that never did.

        A shorter frame may be too dark to be compared. Where a longer one of the bracket contradicts its stated
        exposure, the shorter ones before it may have had the same wrong exposure and are dropped; where no attempt
        agrees, those after it too. An exposure that was refused in the slot before as well says nothing of others: a
        camera whose frames of this length can never be compared loses these alone.
        """
        taken: list[Frame] = []
        refused_us: set[float] = set()
        for exposure_us in exposures_us:
            if any(exposure_us < one for one in refused_us - refused_before_us):
                continue
            for attempt in range(_ATTEMPTS):
                if not self.has_time():
                    return taken, frozenset(refused_us)
                self.report.add(retries=int(attempt > 0))
                frame = self.take(exposure_us)
                inconsistency = None if frame is None else _find_contradiction(references, frame)
                if inconsistency is None:
                    taken += [] if frame is None else [frame]
                    break
                self._mark_suspect(inconsistency)
                if exposure_us not in refused_before_us:
                    taken = [one for one in taken if one.exposure_us > exposure_us]
            else:
                self.report.add(failures=1)
                refused_us.add(exposure_us)
        return taken, frozenset(refused_us)

    def _mark_suspect(self, inconsistency: str) -> None:
        _log.warning("suspect frame: %s", inconsistency)
        self.report.add(doubts=1)
        self.camera.distrust()


def _find_contradiction(references: Sequence[Frame], frame: Frame) -> str | None:
    """Return how a frame contradicts the first reference that it does."""
    return next((d for reference in references if (d := contradiction(reference, frame)) is not None), None)


def contradiction(first: Frame, second: Frame) -> str | None:
    """Return how two frames contradict their stated exposures; None where they agree or are too far apart in time."""
    if abs((second.time - first.time).total_seconds()) > _COMPARABLE_S or first.image.shape != second.image.shape:
        return None
    return light_ratio_contradiction(_make_exposed(first), _make_exposed(second))


def _make_exposed(frame: Frame) -> Exposed:
    return Exposed(image=frame.image, exposure_us=frame.exposure_us, full_scale=frame.full_scale)


_SATURATED = 0.98
_BURNT_PX = 30
_BURNT_LEVEL = 4.0  # of a sun that left a streak and no disc: "much shorter"
_CODE = "sun_too_bright"

SPOILED_AFTER = 20
"""Cycles in which even the shortest exposure was burnt beyond use, after which it is reported: 10 minutes."""


@dataclass(eq=False)
class SunExposures:
    """Link of the exposure control with detections and capture.

    Parameters
    ----------
    options : what the controller aims at.
    apparent_zenith : the sun's now, degrees.
    clear_level_per_us : the clear sun's level in 1 µs over full scale; 0 while unknown.
    board : where a sun too bright for the camera is shown.
    """

    options: exposure.SunExposureOptions
    _: KW_ONLY
    apparent_zenith: Callable[[], float] = lambda: 0.0
    clear_level_per_us: Callable[[], float] = lambda: 0.0
    board: StatusRegistry | None = None

    def __post_init__(self) -> None:
        """Begin without a detection."""
        self._lock = threading.Lock()
        self._state: exposure.SunExposureState | None = None
        self._shortest_us = 0.0
        self._peaks: list[exposure.Peak] = []
        self._spoiled = False
        self._reported = 0

    def choose(self, info: CameraInfo) -> tuple[float, ...]:
        """Return this cycle's sun exposures in microseconds, within the camera's bounds.

        A cycle whose frames have not been measured yet changes nothing.
        """
        bounds = info.exposure_bounds
        zenith, clear_level = self.apparent_zenith(), self.clear_level_per_us()
        with self._lock:
            observation = exposure.SunLook(
                peaks=tuple(self._peaks), apparent_zenith=zenith, clear_level_per_us=clear_level, spoiled=self._spoiled
            )
            if self._state is None:
                self._state = exposure.first_sun_exposures(self.options, bounds)
            elif self._reported:
                self._state = exposure.next_sun_exposures(self._state, observation, options=self.options, bounds=bounds)
                self._publish_state(self._state, bounds)
            self._shortest_us = bounds.minimum_us + bounds.step_us
            self._peaks, self._spoiled, self._reported = [], False, 0
            return self._state.exposures_us

    def report(self, frame: Frame, detection: Detection) -> None:
        """Record the result of a sun exposure; one that is too bright to be accepted still shortens the next."""
        with self._lock:
            self._reported += 1
            burnt = not detection.accepted and _is_burnt(frame)
            is_informative = detection.accepted or detection.saturated_px > 0
            if burnt:  # whatever was fitted to the streak
                level = max(detection.peak_fraction or 0.0, _BURNT_LEVEL)
                self._peaks.append(exposure.Peak(exposure_us=frame.exposure_us, fraction=level))
            elif is_informative and detection.peak_fraction is not None:
                self._peaks.append(exposure.Peak(exposure_us=frame.exposure_us, fraction=detection.peak_fraction))
            self._spoiled |= burnt and frame.exposure_us <= self._shortest_us

    def _publish_state(self, state: exposure.SunExposureState, bounds: exposure.ExposureBounds) -> None:
        if self.board is None:
            return
        if state.cycles_spoiled >= SPOILED_AFTER:
            self.board.set_condition(_CODE, condition(_CODE, exposure_us=bounds.minimum_us))
        elif state.cycles_spoiled == 0:
            self.board.set_condition(_CODE, None)


def _is_burnt(frame: Frame) -> bool:
    """Return whether so much is saturated that only the sun can have done it."""
    saturated = int(np.count_nonzero(frame.image >= _SATURATED * frame.full_scale))
    return saturated * frame.binning**2 > _BURNT_PX
