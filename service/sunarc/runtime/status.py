"""The status board: what the service knows about itself, as values; its workers write it, the API reads it."""

from __future__ import annotations

import threading
from collections.abc import Callable
from dataclasses import dataclass, replace
from datetime import datetime
from typing import Literal, TypedDict, Unpack

Health = Literal["ready", "degraded", "not_ready"]
Severity = Literal["degraded", "not_ready"]
WorkerState = Literal["starting", "running", "restarting", "stopped", "failed"]


@dataclass(frozen=True, slots=True, kw_only=True)
class WorkerStatus:
    """One worker: how it is, and the seconds since it last gave a sign of life (None before the first)."""

    name: str
    state: WorkerState
    heartbeat_age_s: float | None = None
    restarts: int = 0
    last_error: str | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class Reason:
    """Why the service is not, or not wholly, ready.

    Attributes
    ----------
    code : stable name, one reason per code (`no_calibration`, `camera_lost`).
    severity : `degraded` still answers, with less; `not_ready` cannot answer.
    text : what is the matter, one sentence.
    remedy : what to do about it.
    """

    code: str
    severity: Severity
    text: str
    remedy: str


@dataclass(frozen=True, slots=True, kw_only=True)
class CameraStatus:
    """The camera as it last answered."""

    name: str
    connected: bool
    address: str = ""
    model: str = ""
    serial: str = ""
    pixel_format: str = ""
    temperature_c: float | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class CaptureStatus:
    """What capture has counted since the service started.

    Attributes
    ----------
    cycles, complete : slots served by day, and those whose normal exposures all succeeded.
    missed : slots that passed without a cycle, the camera being lost or the cycle before too long.
    sun_missed : slots with the sun up in which no sun exposure was taken, those without a cycle among them.
    sun_dropped : sun exposures that were not evaluated, for detection was too slow.
    frames : exposures that succeeded.
    retries : exposures tried again.
    losses : exposures without a frame, or with one that lacks packets.
    refusals : frames of a wrong size, count or exposure.
    doubts : rounds of exposures whose brightness contradicted what they said.
    failures : exposures that failed at every attempt.
    openings : how often the camera was opened.
    jitter_s, jitter_max_s : from a slot to its first exposure's beginning, real seconds: the last, and the largest.
    hdr_s : from the beginning of the last cycle to the end of its normal exposures, real seconds.
    """

    cycles: int = 0
    complete: int = 0
    missed: int = 0
    sun_missed: int = 0
    sun_dropped: int = 0
    frames: int = 0
    retries: int = 0
    losses: int = 0
    refusals: int = 0
    doubts: int = 0
    failures: int = 0
    openings: int = 0
    jitter_s: float | None = None
    jitter_max_s: float | None = None
    hdr_s: float | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class ClockStatus:
    """Whether the host's clock is disciplined (None: unknown), the bound of its error, and when it was last set."""

    synchronised: bool | None
    max_error_s: float | None = None
    last_step_s: float | None = None
    last_step_at: datetime | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class DiskStatus:
    """What is free where the images are, what they take, and the time of the oldest one."""

    free_bytes: int
    images_bytes: int
    oldest_image_at: datetime | None = None


class Notes(TypedDict, total=False):
    """What `StatusRegistry.note` takes."""

    camera: CameraStatus
    capture: CaptureStatus
    clock: ClockStatus
    disk: DiskStatus
    last_frame_at: datetime
    last_sighting_at: datetime


@dataclass(frozen=True, slots=True, kw_only=True)
class StatusSnapshot:
    """The whole board at one moment; None is "not known yet". Times are aware, UTC, and of the frames."""

    version: str
    started_at: datetime
    workers: tuple[WorkerStatus, ...] = ()
    reasons: tuple[Reason, ...] = ()
    camera: CameraStatus | None = None
    capture: CaptureStatus | None = None
    clock: ClockStatus | None = None
    disk: DiskStatus | None = None
    last_frame_at: datetime | None = None
    last_sighting_at: datetime | None = None

    @property
    def health(self) -> Health:
        """The worst of the reasons' severities."""
        severities = {reason.severity for reason in self.reasons}
        if "not_ready" in severities:
            return "not_ready"
        return "degraded" if severities else "ready"


class StatusRegistry:
    """The one place where the service's state is written down; any thread may write or read.

    Parameters
    ----------
    version : the software's version.
    started_at : when the service started, aware.
    monotonic : seconds that never jump (`Clock.monotonic`); heartbeats age by it between writing and reading.
    """

    def __init__(self, *, version: str, started_at: datetime, monotonic: Callable[[], float]) -> None:
        self._lock = threading.Lock()
        self._monotonic = monotonic
        self._noted = StatusSnapshot(version=version, started_at=started_at)
        self._workers: dict[str, tuple[WorkerStatus, float]] = {}
        self._reasons: dict[str, Reason] = {}

    def set_worker(self, status: WorkerStatus) -> None:
        """Write how a worker is, in place of what was written before."""
        with self._lock:
            self._workers[status.name] = (status, self._monotonic())

    def set_reason(self, reason: Reason) -> None:
        """Write a reason, in place of the one of the same code."""
        with self._lock:
            self._reasons[reason.code] = reason

    def clear_reason(self, code: str) -> None:
        """Take a reason off the board; nothing happens when it is not there."""
        with self._lock:
            self._reasons.pop(code, None)

    def note(self, **changes: Unpack[Notes]) -> None:
        """Write down facts, by the names of `StatusSnapshot`: `board.note(last_frame_at=frame.time)`."""
        with self._lock:
            self._noted = replace(self._noted, **changes)

    def snapshot(self) -> StatusSnapshot:
        """Return the whole board, workers and reasons in the order of their names."""
        with self._lock:
            now = self._monotonic()
            workers = tuple(_aged(status, now - at) for _, (status, at) in sorted(self._workers.items()))
            reasons = tuple(reason for _, reason in sorted(self._reasons.items()))
            return replace(self._noted, workers=workers, reasons=reasons)


def _aged(status: WorkerStatus, elapsed_s: float) -> WorkerStatus:
    if status.heartbeat_age_s is None:
        return status
    return replace(status, heartbeat_age_s=status.heartbeat_age_s + elapsed_s)
