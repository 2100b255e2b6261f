"""Status of capture: the camera, counts since the start, and the conditions of slots without use."""

from __future__ import annotations

import logging
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import KW_ONLY, dataclass, field, replace

import numpy as np

from sunarc.common.errors import CameraError, CameraTimeoutError, ConfigurationError, ExposureMismatchError, InputError
from sunarc.imager.cameras.frame import CameraCondition, CameraInfo, Frame
from sunarc.imager.runtime.clock import Clock
from sunarc.imager.runtime.states import Severity
from sunarc.imager.runtime.status import CameraStatus, CaptureStatus, StatusRegistry, condition
from sunarc.imager.workers.clock_watch import FrameTime
from sunarc.imaging.brightness import is_dark
from sunarc.sky.sun import DARK_ZENITH_DEG

LIT_ZENITH_DEG = 80.0
"""The sun's apparent zenith angle below which the longest normal exposure shows the sky in any weather."""
_DARK_SLOTS = 10


@dataclass(eq=False)
class RepeatedCondition:
    """Condition that is set after a number of repetitions in a row.

    Parameters
    ----------
    board, code : where the condition is set, and its code.
    key : the name of the count in the condition's data.
    least : how often is a condition.
    severity : of the condition.
    """

    board: StatusRegistry
    code: str
    _: KW_ONLY
    key: str = "cycles"
    least: int = 1
    severity: Severity = "degraded"
    n: int = field(default=0, init=False)

    def note(self, happened: bool, **data: float | str) -> None:  # noqa: FBT001 - what it is about
        """Count a repetition, or begin anew; set or clear the condition."""
        self.n = self.n + 1 if happened else 0
        reason = condition(self.code, severity=self.severity, **{self.key: self.n, **data})
        self.board.set_condition(self.code, reason if self.n >= self.least else None)


_log = logging.getLogger(__name__)
_LASTING = 10  # cycles in a row
_DAYLIGHT = "daylight_at_night"
_LIT_LEVEL, _DAYLIGHT_PER_S, _LIT_FRAMES = 0.15, 1.0, 2
"""Median over full scale, and the same in a second: the day has 10 a second, a night with a full moon 1e-4."""
_FULL_LEVEL = 0.9
_REDUCED = "packets_too_large"
_SUN_LASTING = 3


@dataclass(eq=False)
class CaptureReport:
    """Counts of the capture thread, published on the status board.

    Parameters
    ----------
    board : where it is shown.
    name : the camera's.
    """

    board: StatusRegistry
    _: KW_ONLY
    name: str

    def __post_init__(self) -> None:
        """Begin without a camera, all counts 0."""
        self._camera = CameraStatus(name=self.name, connected=False)
        self._counts = CaptureStatus()
        self._missed_slots = MissedSlots(self.board)
        self._dark = RepeatedCondition(self.board, "black_frames", key="slots", least=_DARK_SLOTS, severity="not_ready")
        self._incomplete = RepeatedCondition(self.board, "exposures_failing")
        self._overrun = RepeatedCondition(self.board, "cycle_too_long", least=_LASTING)
        self._lit = 0  # exposures of the night in a row that show daylight
        self._sun_failed = RepeatedCondition(self.board, "sun_exposures_failing", least=_SUN_LASTING)
        self._failure = ""

    @property
    def failure(self) -> str:
        """Error text of the last exposure."""
        return self._failure

    def add(self, **counts: int) -> None:
        """Add to counts, by the names of `CaptureStatus`; `publish` writes them on the board."""
        self._counts = replace(self._counts, **{name: getattr(self._counts, name) + n for name, n in counts.items()})

    def publish(self) -> None:
        """Write the counts on the board."""
        self.board.note(capture=self._counts)

    def failed(self, error: CameraError) -> None:
        """Count a failed attempt at an exposure."""
        lost = isinstance(error, CameraTimeoutError)
        self.add(losses=int(lost), refusals=int(not lost))
        self._failure = str(error)

    def cycle(self, *, complete: bool, overran: bool, jitter_s: float | None, hdr_s: float) -> None:
        """Record the cycle of a slot.

        Parameters
        ----------
        complete : whether all of its normal exposures succeeded.
        overran : whether they left no time for the sun's.
        jitter_s : how late it was triggered; None where that is unknown.
        hdr_s : from its beginning to the end of the normal exposures.
        """
        worst_s = max(self._counts.jitter_max_s or 0.0, jitter_s or 0.0)
        self._counts = replace(self._counts, jitter_s=jitter_s, jitter_max_s=worst_s, hdr_s=hdr_s)
        self.add(cycles=1, complete=int(complete))
        self.publish()
        self._incomplete.note(not complete, error=self._failure)
        self._overrun.note(overran, hdr_s=hdr_s)

    def sun_slot(self, *, observed: bool, failed: bool, missed_before: int, dropped: int) -> None:
        """Record a slot with the sun up.

        Parameters
        ----------
        observed : whether a sun exposure was taken.
        failed : whether none was though there was time.
        missed_before : slots that passed without a cycle since the last one.
        dropped : sun exposures that were not evaluated, since the service started.
        """
        self.add(sun_missed=missed_before + int(not observed))
        self._counts = replace(self._counts, sun_dropped=dropped)
        self._missed_slots.add(missed_before=missed_before)
        self._sun_failed.note(failed, error=self._failure)

    def normal_frames(self, frames: Sequence[Frame], *, apparent_zenith: float) -> None:
        """Record a slot's normal exposures; black ones count by day alone, bright ones always."""
        longest = max(frames, key=lambda frame: frame.exposure_us)
        dark = is_dark(longest.image, full_scale=longest.full_scale)
        if not dark or apparent_zenith < LIT_ZENITH_DEG:
            self._dark.note(dark, exposure_us=longest.exposure_us)

    def frame(self, frame: Frame) -> None:
        """Record a frame."""
        self.add(frames=1)
        self.board.note(last_frame_at=frame.time)

    def night_level(self, frame: Frame, *, apparent_zenith: float) -> bool:
        """Record a night exposure's brightness, and return whether it is full; two of daylight set a condition."""
        level = float(np.median(frame.image[::8, ::8])) / frame.full_scale
        lit = level > _LIT_LEVEL and level / (frame.exposure_us * 1e-6) > _DAYLIGHT_PER_S
        full = level > _FULL_LEVEL
        if lit and apparent_zenith > DARK_ZENITH_DEG:
            self._lit += 1
        elif not full:  # one of seconds may be full at night, too
            self._lit = 0
        below_deg = apparent_zenith - 90.0
        reason = condition(_DAYLIGHT, level=level, exposure_us=frame.exposure_us, below_deg=below_deg)
        self.board.set_condition(_DAYLIGHT, reason if self._lit >= _LIT_FRAMES else None)
        return full

    def record_test_exposure(self, *, succeeded: bool) -> None:
        """Record whether the night's test exposure succeeded."""
        self.publish()
        self._incomplete.note(not succeeded, error=self._failure)
        self._overrun.n = 0  # the condition stays over the night: a cycle of the next day ends it

    def opened(self, info: CameraInfo) -> None:
        """Record that a camera has answered."""
        _log.info("camera %s %s (%s) answers at %s", info.vendor, info.model, info.serial, info.address)
        self._set_lost(None)
        self.board.set_condition("camera_refused", None)
        reduced = condition(_REDUCED, lost=info.packet_bytes_lost or 0, used=info.packet_bytes or 0)
        self.board.set_condition(_REDUCED, None if info.packet_bytes_lost is None else reduced)
        self._camera = CameraStatus(
            name=self.name,
            connected=True,
            address=info.address,
            model=f"{info.vendor} {info.model}".strip(),
            serial=info.serial,
            pixel_format=info.pixel_format,
        )
        self.board.note(camera=self._camera)
        self.add(openings=1)
        self.publish()

    def condition(self, condition: CameraCondition) -> None:
        """Publish the condition that the camera reports."""
        self.board.note(camera=replace(self._camera, temperature_c=condition.temperature_c))

    def lost(self, error: CameraError) -> None:
        """Record that the camera is lost."""
        self._missed_slots.outage()
        if (
            self._camera.connected
        ):  # it costs a cycle, and is shown until one is complete, though the camera answers again
            self._failure = str(error)
            self._incomplete.note(True, error=self._failure)
        self.publish()
        self._camera = CameraStatus(name=self.name, connected=False)
        self.board.note(camera=self._camera)
        doubted = isinstance(error, ExposureMismatchError)
        self._set_lost("exposures_contradicted" if doubted else "camera_lost", str(error))

    def _set_lost(self, code: str | None, error: str = "") -> None:
        """Publish why there is no connection, one cause at a time; None where there is one."""
        for one in ("camera_lost", "exposures_contradicted"):
            self.board.set_condition(one, condition(one, error=error) if one == code else None)

    def refused(self, error: ConfigurationError | InputError) -> None:
        """Record that the camera and the settings do not match; nothing is stored until they do."""
        text, remedy = str(error), "run: sunarc check --camera"
        if isinstance(error, InputError):
            text, remedy = f"{error.field}: {error.problem}", error.remedy
        self._camera = CameraStatus(name=self.name, connected=False)
        self.board.note(camera=self._camera)
        self._set_lost(None)
        reason = condition("camera_refused", severity="not_ready", error=text, remedy=remedy)
        self.board.set_condition("camera_refused", reason)


# Whether most slots get a cycle, or the host or the camera is too slow for the cadence.

SLOTS_MISSED = "slots_missed"
_SLOTS_OF_SHARE = 40
"""Over how many slots the share is taken: 20 min at the default cadence."""
_FEWEST_SLOTS = 10
_SET_SHARE, _CLEAR_SHARE = 0.25, 0.1
"""Shares of missed slots at which the condition is set and cleared; between them it stays as it is."""


class MissedSlots:
    """Record of the last slots with the sun up, with the condition `slots_missed`.

    Parameters
    ----------
    board : where the condition is set.
    """

    def __init__(self, board: StatusRegistry) -> None:
        self._board = board
        self._taken: deque[bool] = deque(maxlen=_SLOTS_OF_SHARE)
        self._after_outage = False

    def add(self, *, missed_before: int) -> None:
        """Record a slot with a cycle, and the slots missed before it; set or clear the condition.

        Parameters
        ----------
        missed_before : slots without a cycle since the last one; not counted after the camera was lost, which has a
            condition of its own.
        """
        if not self._after_outage:
            self._taken.extend([False] * min(missed_before, _SLOTS_OF_SHARE))
        self._after_outage = False
        self._taken.append(True)
        missed = self._taken.count(False)
        if len(self._taken) >= _FEWEST_SLOTS and missed >= _SET_SHARE * len(self._taken):
            self._board.set_condition(SLOTS_MISSED, condition(SLOTS_MISSED, missed=missed, slots=len(self._taken)))
        elif missed <= _CLEAR_SHARE * len(self._taken):
            self._board.set_condition(SLOTS_MISSED, None)

    def outage(self) -> None:
        """Record that the camera is lost: slots until its return do not count."""
        self._after_outage = True


NO_SIGHTINGS = "no_sightings"
_OVERDUE_SLOTS = 10
"""As many as of black frames: 5 min at the default cadence."""


@dataclass(kw_only=True, eq=False)
class OverdueSightings:
    """Condition `no_sightings`: no sighting, accepted or rejected, in ten slots with the sun up.

    Time is counted by the monotonic clock, which a wrong or stepped wall clock leaves alone.

    Parameters
    ----------
    stored : how many sightings this process has stored so far.
    apparent_zenith : the sun's now, degrees.
    clock, frame_time : real time, and the time of the frames, with its speed.
    cadence_s : seconds of frame time from slot to slot.
    board : where the condition is set.
    """

    stored: Callable[[], int]
    apparent_zenith: Callable[[], float]
    clock: Clock
    frame_time: FrameTime
    cadence_s: float
    board: StatusRegistry

    def __post_init__(self) -> None:
        """Count from now on."""
        self._n_stored = 0
        self._since_s = self.clock.monotonic()

    def check(self) -> None:
        """Compare with the last check, and set or clear the condition."""
        now_s, n_stored = self.clock.monotonic(), self.stored()
        sun_is_up = self.frame_time.is_known and self.apparent_zenith() < LIT_ZENITH_DEG
        if n_stored != self._n_stored or not sun_is_up:
            self._n_stored, self._since_s = n_stored, now_s
            self.board.set_condition(NO_SIGHTINGS, None)
            return
        slots = int((now_s - self._since_s) * self.frame_time.speed / self.cadence_s)
        if slots >= _OVERDUE_SLOTS:
            self.board.set_condition(NO_SIGHTINGS, condition(NO_SIGHTINGS, slots=slots))
