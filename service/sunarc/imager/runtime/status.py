"""The status board: the state of the service, as values; its workers write it, the API reads it."""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, replace
from datetime import datetime, timedelta
from typing import Annotated, Any, Literal, TypedDict, Unpack

from pydantic import Field as PydanticField
from pydantic import TypeAdapter, computed_field

from sunarc.common.findings import Data, Finding
from sunarc.imager.runtime.json_fields import EXAMPLE_TIME, Returned, Time, described
from sunarc.imager.runtime.states import Severity, State, condition_state, state_and_text

_log = logging.getLogger(__name__)

Health = Literal["ready", "degraded", "not_ready"]
WorkerState = Literal["starting", "running", "restarting", "stopped", "failed"]


@dataclass(frozen=True, slots=True, kw_only=True)
class WorkerStatus(Returned):
    """Status of one worker."""

    name: Annotated[str, described("Its name.", "capture")]
    state: Annotated[WorkerState, described("`failed`: it ended too often and is not started again.")]
    heartbeat_age_s: Annotated[
        float | None, described("Seconds since its last heartbeat; null before the first.", 0.4)
    ] = None
    restarts: Annotated[int, described("How often it was restarted.", 0)] = 0
    last_error: Annotated[
        str | None, described("Error that ended it last; null without one.", "CameraLostError: no answer")
    ] = None


@dataclass(frozen=True, slots=True, kw_only=True)
class Reason(Returned):
    """Condition of the service: why it is degraded or not ready, or a note; one for each code."""

    code: Annotated[str, described("Stable name of the reason.", "no_calibration")]
    severity: Annotated[
        Severity, described("`degraded` still answers, with less; `not_ready` cannot answer; a `note` limits nothing.")
    ]
    text: Annotated[str, described("The reason, in a sentence.", "the camera does not answer")]
    remedy: Annotated[str, described("What to do about it.", "check power, cable and address")]
    since: Annotated[
        Time | None, described("Since when, by the host's clock; a restart does not begin it anew.", EXAMPLE_TIME)
    ] = None
    data: Annotated[Data, PydanticField(exclude=True)] = field(default_factory=dict)

    @computed_field(description="The state of a service with this reason alone.", examples=["starting"])  # type: ignore[prop-decorator]
    @property
    def state(self) -> State:
        """Service state to which the condition leads, by its code and severity."""
        return condition_state(self.code, self.severity)

    @staticmethod
    def of(finding: Finding, *, severity: Severity = "degraded", code: str | None = None) -> Reason:
        """Return the condition of a finding, with its message; `code` where it is one of several of its kind."""
        return Reason(
            code=code or finding.code,
            severity=severity,
            text=finding.text,
            remedy=finding.remedy,
            data=finding.data,
        )


def condition(code: str, *, severity: Severity = "degraded", **data: float | str) -> Reason:
    """Return a condition for the status board."""
    return Reason.of(Finding(code, data), severity=severity)


def make_condition(code: str, name: str, *, severity: Severity = "degraded", **data: float | str) -> Reason:
    """Return a condition of one worker or receiver, whose name ends its code."""
    return Reason.of(Finding(code, {"name": name, **data}), severity=severity, code=worker_code(code, name))


def worker_code(code: str, name: str) -> str:
    """Return the code of a condition of one worker or receiver: that of its message and the name."""
    return f"{code}_{name}"


_REASON = TypeAdapter(Reason)


@dataclass(frozen=True, slots=True, kw_only=True)
class CameraStatus(Returned):
    """The camera as it last answered."""

    name: Annotated[str, described("Name of this service's camera.", "imager")]
    connected: Annotated[bool, described("Whether the camera answers.", True)]
    address: Annotated[str, described("Of the camera on its network; empty where not known.", "192.168.0.2")] = ""
    model: Annotated[str, described("Vendor and model, as the camera states them.", "Vendor Model")] = ""
    serial: Annotated[str, described("Serial number, as the camera states it.", "SIM-0001")] = ""
    pixel_format: Annotated[str, described("As the camera is set; empty where not known.", "Mono12")] = ""
    temperature_c: Annotated[
        float | None, described("Of the camera, degrees Celsius; null where it does not measure it.", 41.5)
    ] = None


@dataclass(frozen=True, slots=True, kw_only=True)
class CaptureStatus(Returned):
    """Counts of the capture since the service started; times in real seconds."""

    cycles: Annotated[int, described("Slots served by day, a count.", 2880)] = 0
    complete: Annotated[int, described("Cycles whose normal exposures all succeeded, a count.", 2870)] = 0
    missed: Annotated[
        int, described("Slots that passed without a cycle (camera lost, or the previous one too long), a count.", 0)
    ] = 0
    sun_missed: Annotated[
        int, described("Slots with the sun up in which no sun exposure was taken, cycle or not, a count.", 0)
    ] = 0
    sun_dropped: Annotated[
        int, described("Sun exposures not evaluated because detection was too slow, a count.", 0)
    ] = 0
    frames: Annotated[int, described("Exposures that succeeded, a count.", 14400)] = 0
    retries: Annotated[int, described("Exposures tried again, a count.", 3)] = 0
    losses: Annotated[int, described("Exposures without a frame, or with one that lacked packets, a count.", 3)] = 0
    refusals: Annotated[int, described("Frames of a wrong size, frame number or exposure, a count.", 0)] = 0
    doubts: Annotated[
        int, described("Rounds of exposures whose brightness contradicted their exposure times, a count.", 1)
    ] = 0
    failures: Annotated[int, described("Exposures that failed at every attempt, a count.", 0)] = 0
    openings: Annotated[int, described("How often the camera was opened, a count.", 1)] = 0
    jitter_s: Annotated[float | None, described("From the last slot to its first exposure, s.", 0.002)] = None
    jitter_max_s: Annotated[float | None, described("The largest jitter since the service started, s.", 0.012)] = None
    hdr_s: Annotated[
        float | None,
        described("From the beginning of the last cycle to the end of its normal exposures, s.", 0.31),
    ] = None


@dataclass(frozen=True, slots=True, kw_only=True)
class ClockStatus(Returned):
    """State of the host's clock: disciplined or not, bound of its error, and when the frames' clock was last set."""

    synchronised: Annotated[
        bool | None, described("Whether a time service disciplines the host's clock; null where not known.", True)
    ]
    max_error_s: Annotated[
        float | None, described("Bound of the host clock's error, s; null where not known.", 0.01)
    ] = None
    last_step_s: Annotated[
        float | None, described("By how much the frames' clock was last set, s; positive is forward.", 0.8)
    ] = None
    last_step_at: Annotated[
        Time | None, described("When the frames' clock was last set; null without a step.", EXAMPLE_TIME)
    ] = None


@dataclass(frozen=True, slots=True, kw_only=True)
class DiskStatus(Returned):
    """Free space of the images' disk, and the size of the images."""

    free_bytes: Annotated[int, described("Free space where the images are, bytes.", 82_000_000_000)]
    images_bytes: Annotated[int, described("Size of the stored images, bytes.", 12_000_000_000)]
    oldest_image_at: Annotated[
        Time | None, described("Time of the oldest stored image; null without one.", EXAMPLE_TIME)
    ] = None


class Notes(TypedDict, total=False):
    """Type of the argument of `StatusRegistry.note`."""

    camera: CameraStatus
    capture: CaptureStatus
    clock: ClockStatus
    disk: DiskStatus
    last_frame_at: datetime
    last_sighting_at: datetime


@dataclass(frozen=True, slots=True, kw_only=True)
class StatusSnapshot:
    """Whole status board at one moment; None means "not known yet". Times are aware, UTC, and of the frames.

    `reasons` are the conditions that make the health; `notes` are those of severity `note`.
    """

    version: str
    started_at: datetime
    workers: tuple[WorkerStatus, ...] = ()
    reasons: tuple[Reason, ...] = ()
    notes: tuple[Reason, ...] = ()
    camera: CameraStatus | None = None
    capture: CaptureStatus | None = None
    clock: ClockStatus | None = None
    disk: DiskStatus | None = None
    last_frame_at: datetime | None = None
    last_sighting_at: datetime | None = None

    @property
    def findings(self) -> list[dict[str, Any]]:
        """The reasons as the JSON of codes and data."""
        return [Finding(reason.code, reason.data).as_json() for reason in self.reasons]

    @property
    def conditions(self) -> dict[str, dict[str, Any]]:
        """The reasons as JSON, by code."""
        return {reason.code: _REASON.dump_python(reason, mode="json") for reason in self.reasons}

    @property
    def health(self) -> Health:
        """The worst of the reasons' severities."""
        severities = {reason.severity for reason in self.reasons}
        if "not_ready" in severities:
            return "not_ready"
        return "degraded" if severities else "ready"

    @property
    def state(self) -> State:
        """The worst state of the reasons and notes."""
        return state_and_text((*self.reasons, *self.notes))[0]

    @property
    def state_text(self) -> str:
        """The sentence of the condition that decides the state."""
        return state_and_text((*self.reasons, *self.notes))[1]


class StatusRegistry:
    """Status board: the state of the service as values; any thread may write or read.

    Parameters
    ----------
    version : the software's version.
    started_at : when the service started, aware.
    monotonic : seconds that never jump (`Clock.monotonic`); heartbeats age by it between writing and reading.
    """

    def __init__(self, *, version: str, started_at: datetime, monotonic: Callable[[], float]) -> None:
        self._lock = threading.Lock()
        self._monotonic = monotonic
        self._started_at = started_at
        self._started_s = monotonic()
        self._noted = StatusSnapshot(version=version, started_at=started_at)
        self._workers: dict[str, tuple[WorkerStatus, float]] = {}
        self._reasons: dict[str, Reason] = {}
        self._earlier: dict[str, datetime] = {}
        self._earlier_until_s = 0.0

    def set_worker(self, status: WorkerStatus) -> None:
        """Set the status of a worker, in place of the former one."""
        with self._lock:
            self._workers[status.name] = (status, self._monotonic())

    def set_condition(self, code: str, reason: Reason | None, *, log: bool = True) -> None:
        """Set the condition of a code, or clear it (None). That it begins or ends is logged, once.

        Parameters
        ----------
        code : of the condition.
        reason : why it is set; one that is set already gets the new text.
        log : whether to log; not where an event says the same, which the archive logs.
        """
        with self._lock:
            before = self._reasons.pop(code, None)
            if reason is not None:
                since = self._get_start(code) if before is None else before.since
                self._reasons[code] = replace(reason, since=since)
        # Logged outside the lock: the log's handler may block on the journal's socket.
        if not log or (before is None) == (reason is None):
            return
        if reason is None:
            _log.info("condition %s has ended", code)
        else:
            level = logging.ERROR if reason.severity == "not_ready" else logging.WARNING
            _log.log(level, "condition %s: %s; %s", code, reason.text, reason.remedy)

    def set_one_condition(self, codes: Iterable[str], reason: Reason | None, *, log: bool = True) -> None:
        """Set one condition of several that exclude each other, or none of them (None)."""
        for code in codes:
            self.set_condition(code, reason if reason is not None and reason.code == code else None, log=log)

    def resume(self, earlier: Mapping[str, datetime], *, within_s: float) -> None:
        """Take over since when conditions held before a restart; one that ends and is set again begins anew.

        Parameters
        ----------
        earlier : the times by code.
        within_s : a condition that is first set later than this from now on is a new one.
        """
        with self._lock:
            now = self._estimate_now()
            self._earlier_until_s = self._monotonic() + within_s
            for code, since in earlier.items():
                present = self._reasons.get(code)
                if present is None:
                    self._earlier[code] = since
                elif since < (present.since or now):
                    self._reasons[code] = replace(present, since=since)

    def awaited(self) -> Mapping[str, datetime]:
        """Return the start times of conditions from before a restart that have not been set again yet."""
        with self._lock:
            return dict(self._earlier) if self._monotonic() < self._earlier_until_s else {}

    def _get_start(self, code: str) -> datetime:
        """Return since when a condition holds that is set now."""
        now, earlier = self._estimate_now(), self._earlier.pop(code, None)
        return now if earlier is None or self._monotonic() >= self._earlier_until_s else min(earlier, now)

    def _estimate_now(self) -> datetime:
        """Return the time by the clock that dated the start; a later step of that clock is not followed."""
        return self._started_at + timedelta(seconds=self._monotonic() - self._started_s)

    def note(self, **changes: Unpack[Notes]) -> None:
        """Set facts on the board, by the names of `StatusSnapshot`: `board.note(last_frame_at=frame.time)`."""
        with self._lock:
            self._noted = replace(self._noted, **changes)

    def snapshot(self) -> StatusSnapshot:
        """Return the whole board, workers and reasons in the order of their names."""
        with self._lock:
            now = self._monotonic()
            workers = tuple(_age_status(status, now - at) for _, (status, at) in sorted(self._workers.items()))
            conditions = [reason for _, reason in sorted(self._reasons.items())]
            reasons = tuple(one for one in conditions if one.severity != "note")
            notes = tuple(one for one in conditions if one.severity == "note")
            # Parts are frozen and replaced as wholes: a snapshot shares them with later ones.
            return replace(self._noted, workers=workers, reasons=reasons, notes=notes)


def _age_status(status: WorkerStatus, elapsed_s: float) -> WorkerStatus:
    if status.heartbeat_age_s is None:
        return status
    return replace(status, heartbeat_age_s=status.heartbeat_age_s + elapsed_s)
