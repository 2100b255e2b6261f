"""The numbers for Prometheus, read from the status board and the archive when they are asked for."""

from __future__ import annotations

from collections.abc import Iterator
from datetime import datetime
from typing import get_args

from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily, Metric
from prometheus_client.registry import Collector

from sunarc.api.context import ApiContext
from sunarc.api.routes.calibrations import summary
from sunarc.runtime.status import CaptureStatus, DiskStatus, Health, StatusSnapshot, WorkerState

_EVENTS_LOOKED_AT = 1000
_CAPTURE_COUNTS = {
    "cycles": "Slots served by day.",
    "complete": "Those whose normal exposures all succeeded.",
    "missed": "Slots that passed without a cycle.",
    "sun_missed": "Slots with the sun up without a sun exposure.",
    "sun_dropped": "Sun exposures not evaluated because detection was too slow.",
    "frames": "Exposures that succeeded.",
    "retries": "Exposures tried again.",
    "losses": "Exposures without a frame, or with one that lacked packets.",
    "refusals": "Frames of a wrong size, count or exposure.",
    "doubts": "Rounds of exposures whose brightness contradicted what they said.",
    "failures": "Exposures that failed at every attempt.",
    "openings": "How often the camera was opened.",
}


class StatusCollector(Collector):
    """Collects what an application serves.

    Parameters
    ----------
    served : its collaborators.
    """

    def __init__(self, served: ApiContext) -> None:
        self._served = served
        self._stored_step_at = _stored_step_at(served)

    def describe(self) -> Iterator[Metric]:
        """Name nothing beforehand, so that registering asks nobody."""
        return iter(())

    def collect(self) -> Iterator[Metric]:
        """Read the board and the archive once."""
        snapshot = self._served.status()
        yield _labelled("sunarc_build_info", "The version that runs.", ("version",), {(snapshot.version,): 1.0})
        yield _labelled(
            "sunarc_health",
            "1 for the state that holds.",
            ("state",),
            {(state,): float(state == snapshot.health) for state in get_args(Health)},
        )
        yield _labelled(
            "sunarc_reason",
            "1 for each reason why the service is not wholly ready.",
            ("code", "severity"),
            {(reason.code, reason.severity): 1.0 for reason in snapshot.reasons},
        )
        yield from _workers(snapshot)
        yield _single("sunarc_started_seconds", "Unix time at which the service started.", _unix_s(snapshot.started_at))
        yield from _facts(snapshot, self._stored_step_at)
        yield from _capture(snapshot.capture)
        yield from self._calibration()

    def _calibration(self) -> Iterator[Metric]:
        record = self._served.archive.current_calibration(self._served.camera)
        summary_now = None if record is None else summary(record)
        yield _single("sunarc_calibration_present", "1 when a calibration is current.", float(summary_now is not None))
        if summary_now is not None:
            yield _single("sunarc_calibration_rmse_px", "Of the sightings used, in distance.", summary_now.rmse_px)
            yield _single(
                "sunarc_calibration_sky_rms_degrees", "1-sigma per axis over the sky.", summary_now.sky_rms_deg
            )
            yield _single("sunarc_calibration_valid_from_seconds", "Unix time.", _unix_s(summary_now.valid_from))


def _workers(snapshot: StatusSnapshot) -> Iterator[Metric]:
    workers = snapshot.workers
    yield _labelled(
        "sunarc_worker_state",
        "1 for the state that each worker is in.",
        ("worker", "state"),
        {(w.name, state): float(state == w.state) for w in workers for state in get_args(WorkerState)},
    )
    yield _labelled(
        "sunarc_worker_heartbeat_age_seconds",
        "Seconds since each worker's last sign of life.",
        ("worker",),
        {(w.name,): w.heartbeat_age_s for w in workers if w.heartbeat_age_s is not None},
    )
    yield _labelled(
        "sunarc_worker_restarts",
        "How often each worker was made anew.",
        ("worker",),
        {(w.name,): float(w.restarts) for w in workers},
    )


def _stored_step_at(served: ApiContext) -> datetime | None:
    """Return when the frames' clock was last set before the service started, as its events have it."""
    events = served.archive.events(served.camera, severity="warning", limit=_EVENTS_LOOKED_AT)
    return next((event.time for event in events if event.kind == "clock_step"), None)


def _facts(snapshot: StatusSnapshot, stored_step_at: datetime | None) -> Iterator[Metric]:
    connected = float(snapshot.camera is not None and snapshot.camera.connected)  # not so yet is 0: alerts go by it
    error_s = None if snapshot.clock is None else snapshot.clock.max_error_s
    temperature = None if snapshot.camera is None else snapshot.camera.temperature_c
    yield _single("sunarc_camera_temperature_celsius", "Where the camera tells it.", temperature)
    yield _single("sunarc_camera_connected", "1 while the camera answers.", connected)
    synchronised = None if snapshot.clock is None else snapshot.clock.synchronised
    stepped_at = _unix_s((snapshot.clock and snapshot.clock.last_step_at) or stored_step_at)
    yield _single("sunarc_clock_synchronised", "1 while a time service disciplines the host's clock.", synchronised)
    yield _single("sunarc_clock_last_step_seconds", "Unix time at which the frames' clock was last set.", stepped_at)
    yield _single("sunarc_clock_error_seconds", "Bound of the host clock's error.", error_s)
    yield from _disk(snapshot.disk)
    yield _single("sunarc_last_frame_seconds", "Unix time of the last frame.", _unix_s(snapshot.last_frame_at))
    yield _single("sunarc_last_sighting_seconds", "Unix time of the last sighting.", _unix_s(snapshot.last_sighting_at))


def _capture(capture: CaptureStatus | None) -> Iterator[Metric]:
    for name, text in _CAPTURE_COUNTS.items():
        family = CounterMetricFamily(f"sunarc_capture_{name}", text)
        family.add_metric((), 0.0 if capture is None else getattr(capture, name))
        yield family
    jitter = None if capture is None else capture.jitter_s
    jitter_max = None if capture is None else capture.jitter_max_s
    hdr = None if capture is None else capture.hdr_s
    yield _single("sunarc_capture_jitter_seconds", "From the last slot to its first exposure.", jitter)
    yield _single("sunarc_capture_jitter_max_seconds", "The largest since the service started.", jitter_max)
    yield _single("sunarc_capture_hdr_seconds", "From a cycle's beginning to the end of its normal exposures.", hdr)


def _disk(disk: DiskStatus | None) -> Iterator[Metric]:
    if disk is not None:
        yield _single("sunarc_disk_free_bytes", "Free space where the images are.", disk.free_bytes)
        yield _single("sunarc_images_bytes", "What the images take.", disk.images_bytes)
        yield _single("sunarc_oldest_image_seconds", "Unix time of the oldest image.", _unix_s(disk.oldest_image_at))


def _unix_s(time: datetime | None) -> float | None:
    return None if time is None else time.timestamp()


def _single(name: str, text: str, value: float | None) -> Metric:
    return _labelled(name, text, (), {} if value is None else {(): value})


def _labelled(name: str, text: str, labels: tuple[str, ...], values: dict[tuple[str, ...], float]) -> Metric:
    family = GaugeMetricFamily(name, text, labels=labels)
    for label_values, value in values.items():
        family.add_metric(label_values, value)
    return family
