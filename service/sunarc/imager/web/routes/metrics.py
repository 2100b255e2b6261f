"""The numbers for Prometheus, read from the status board and the archive when they are asked for."""

from __future__ import annotations

import math
from bisect import bisect_left
from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import fields
from datetime import UTC, datetime, time, timedelta
from itertools import accumulate
from typing import get_args

from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily, HistogramMetricFamily, Metric
from prometheus_client.registry import Collector

from sunarc.imager.archive.archive import Archive
from sunarc.imager.archive.values import CAMERA_CHANGES, Day, DayVerdict, Night, RefitState
from sunarc.imager.runtime.json_fields import descriptions
from sunarc.imager.runtime.status import (
    CameraStatus,
    CaptureStatus,
    ClockStatus,
    DiskStatus,
    Health,
    StatusSnapshot,
    WorkerState,
)
from sunarc.imager.web.context import ApiContext
from sunarc.imager.web.routes.calibrations import summary

_EVENTS_LOOKED_AT = 1000
_GAUGES = (
    ("sunarc_camera_temperature_celsius", CameraStatus, "temperature_c"),
    ("sunarc_clock_synchronised", ClockStatus, "synchronised"),
    ("sunarc_clock_error_seconds", ClockStatus, "max_error_s"),
    ("sunarc_disk_free_bytes", DiskStatus, "free_bytes"),
    ("sunarc_images_bytes", DiskStatus, "images_bytes"),
    ("sunarc_oldest_image_seconds", DiskStatus, "oldest_image_at"),
    ("sunarc_capture_jitter_seconds", CaptureStatus, "jitter_s"),
    ("sunarc_capture_jitter_max_seconds", CaptureStatus, "jitter_max_s"),
    ("sunarc_capture_hdr_seconds", CaptureStatus, "hdr_s"),
)
"""Metrics of a part of the status: name, part, and its field, which has the description too."""
_PARTS = {CameraStatus: "camera", ClockStatus: "clock", DiskStatus: "disk", CaptureStatus: "capture"}
Labelled = Mapping[tuple[str, ...], float]
"""Values of a metric by those of its labels."""
_COUNTS = tuple(field.name for field in fields(CaptureStatus) if isinstance(field.default, int))


class StatusCollector(Collector):
    """Collects the metrics of an application.

    Parameters
    ----------
    context : its collaborators.
    """

    def __init__(self, context: ApiContext) -> None:
        self._context = context
        self._stored_step_at = _stored_step_at(context)

    def describe(self) -> Iterator[Metric]:
        """Return no metrics, so that registering does not query the archive."""
        return iter(())

    def collect(self) -> Iterator[Metric]:
        """Yield the metrics, from one reading of the status board and of the archive."""
        snapshot = self._context.status()
        yield from service_metrics(snapshot)
        yield from _worker_metrics(snapshot)
        yield from _status_metrics(snapshot, self._stored_step_at)
        yield from _capture_metrics(snapshot.capture)
        yield from self._calibration_metrics()
        yield from push_metrics(self._context.archive)
        now = self._context.frame_clock()
        yield from record_metrics(self._context.archive, self._context.camera, now=now)

    def _calibration_metrics(self) -> Iterator[Metric]:
        record = self._context.archive.calibrations.current(self._context.camera)
        summary_now = None if record is None else summary(record)
        yield _single_gauge(
            "sunarc_calibration_present", "1 when a calibration is current.", float(summary_now is not None)
        )
        if summary_now is not None:
            yield _single_gauge(
                "sunarc_calibration_rmse_px", "Of the sightings used, in distance.", summary_now.rmse_px
            )
            yield _single_gauge(
                "sunarc_calibration_sky_rms_degrees", "1-sigma per axis over the sky.", summary_now.sky_rms_deg
            )
            yield _single_gauge(
                "sunarc_calibration_valid_from_seconds", "Unix time.", _unix_s_or_none(summary_now.valid_from)
            )


def service_metrics(snapshot: StatusSnapshot) -> Iterator[Metric]:
    """Yield version, health, conditions and the time of the start: of an imager and of a hub."""
    yield labelled("sunarc_build_info", "The version that runs.", ("version",), {(snapshot.version,): 1.0})
    yield labelled(
        "sunarc_health",
        "1 for the state that holds.",
        ("state",),
        {(state,): float(state == snapshot.health) for state in get_args(Health)},
    )
    yield labelled(
        "sunarc_reason",
        "1 for each reason why the service is not wholly ready.",
        ("code", "severity"),
        {(reason.code, reason.severity): 1.0 for reason in snapshot.reasons},
    )
    yield _single_gauge(
        "sunarc_started_seconds", "Unix time at which the service started.", _unix_s_or_none(snapshot.started_at)
    )


def push_metrics(archive: Archive) -> Iterator[Metric]:
    """Yield the metrics of receivers of messages: waiting and refused messages; nothing without receivers."""
    states = archive.notices.sink_states()
    waiting: Labelled = {(name,): float(state.waiting) for name, state in states.items()}
    yield labelled("sunarc_push_waiting", "Messages that a receiver has not had yet.", ("receiver",), waiting)
    refused = CounterMetricFamily("sunarc_push_refused", "Messages that a receiver refused.", labels=("receiver",))
    for name, state in states.items():
        refused.add_metric((name,), float(state.refused))
    yield refused


def _worker_metrics(snapshot: StatusSnapshot) -> Iterator[Metric]:
    workers = snapshot.workers
    yield labelled(
        "sunarc_worker_state",
        "1 for the state that each worker is in.",
        ("worker", "state"),
        {(w.name, state): float(state == w.state) for w in workers for state in get_args(WorkerState)},
    )
    yield labelled(
        "sunarc_worker_heartbeat_age_seconds",
        "Seconds since each worker's last sign of life.",
        ("worker",),
        {(w.name,): w.heartbeat_age_s for w in workers if w.heartbeat_age_s is not None},
    )
    yield labelled(
        "sunarc_worker_restarts",
        "How often each worker was made anew.",
        ("worker",),
        {(w.name,): float(w.restarts) for w in workers},
    )


def _stored_step_at(context: ApiContext) -> datetime | None:
    """Return when the frames' clock was last set before the service started, as its events have it."""
    events = context.archive.events.find(context.camera, severity="warning", limit=_EVENTS_LOOKED_AT)
    return next((event.time for event in events if event.kind == "clock_step"), None)


def _status_metrics(snapshot: StatusSnapshot, stored_step_at: datetime | None) -> Iterator[Metric]:
    for name, part, field in _GAUGES:
        value = getattr(getattr(snapshot, _PARTS[part]), field, None)
        yield _single_gauge(
            name, descriptions(part)[field], _unix_s_or_none(value) if isinstance(value, datetime) else value
        )
    connected = float(snapshot.camera is not None and snapshot.camera.connected)  # 0 from the start: alerts read it
    yield _single_gauge("sunarc_camera_connected", "1 while the camera answers.", connected)
    stepped_at = _unix_s_or_none((snapshot.clock and snapshot.clock.last_step_at) or stored_step_at)
    yield _single_gauge(
        "sunarc_clock_last_step_seconds", "Unix time at which the frames' clock was last set.", stepped_at
    )
    yield _single_gauge(
        "sunarc_last_frame_seconds", "Unix time of the last frame.", _unix_s_or_none(snapshot.last_frame_at)
    )
    yield _single_gauge(
        "sunarc_last_sighting_seconds", "Unix time of the last sighting.", _unix_s_or_none(snapshot.last_sighting_at)
    )


def _capture_metrics(capture: CaptureStatus | None) -> Iterator[Metric]:
    texts = descriptions(CaptureStatus)
    for name in _COUNTS:
        family = CounterMetricFamily(f"sunarc_capture_{name}", texts[name])
        family.add_metric((), 0.0 if capture is None else getattr(capture, name))
        yield family


def _unix_s_or_none(time: datetime | None) -> float | None:
    return None if time is None else time.timestamp()


def _single_gauge(name: str, text: str, value: float | None) -> Metric:
    return labelled(name, text, (), {} if value is None else {(): value})


def _count_metric(name: str, text: str, label: str, counts: Mapping[str, int]) -> Metric:
    return labelled(name, text, (label,), {(value,): float(n) for value, n in sorted(counts.items())})


def labelled(name: str, text: str, labels: tuple[str, ...], values: Labelled) -> Metric:
    """Return a gauge with a value for each combination of its labels; without labels, with one or none."""
    family = GaugeMetricFamily(name, text, labels=labels)
    for label_values, value in values.items():
        family.add_metric(label_values, value)
    return family


# The numbers for Prometheus that the store has: they are the same after a restart.

_A_DAY = timedelta(days=1)
_CHANGES = {
    "moves": ("camera_moved", "How often the camera was found moved, a count."),
    "lens_changes": ("lens_changed", "How often the lens was found changed, refocused or shifted, a count."),
    "replaced": ("camera_replaced", "How often a camera with another serial number answered, a count."),
}
"""Counters of changes of the camera: the condition of the alarms that are counted, and a description."""


def record_metrics(archive: Archive, camera: str, *, now: datetime) -> Iterator[Metric]:
    """Yield counts of sightings, days and refits, and the scatter and the rotation of the last day.

    Parameters
    ----------
    archive, camera : whose.
    now : the frames' time.
    """
    sightings = archive.sightings.count(camera, since=now - _A_DAY, until=now + _A_DAY)
    text = "Sightings of the last 24 h by verdict, also those of a clock that was ahead."
    yield _count_metric("sunarc_sightings_last_day", text, "verdict", sightings)
    days = dict.fromkeys(get_args(DayVerdict), 0) | dict(archive.days.count(camera))
    yield _count_metric("sunarc_days", "Days that were judged, by verdict.", "verdict", days)
    refits = dict.fromkeys(get_args(RefitState), 0) | dict(archive.refits.count(camera))
    yield _count_metric("sunarc_refits", "Refits by state.", "state", refits)
    alarms = archive.events.count_alarms(camera)
    for name, (condition, text) in _CHANGES.items():
        counter = CounterMetricFamily(f"sunarc_camera_{name}", text)
        counter.add_metric((), sum(n for kind, n in alarms.items() if CAMERA_CHANGES.get(kind) == condition))
        yield counter
    waiting = archive.events.find(camera, to_acknowledge=True)
    yield _single_gauge("sunarc_events_to_acknowledge", "Events that wait for an operator.", float(len(waiting)))
    yield from _day_metrics(next(iter(archive.days.find(camera, limit=1)), None))
    yield from _night_metrics(next(iter(archive.nights.find(camera, limit=1)), None))


def _day_metrics(day: Day | None) -> Iterator[Metric]:
    values: dict[str, tuple[str, float | None]] = {
        "seconds": (
            "Date of the last day that was judged, its midnight UTC as Unix time.",
            None if day is None else datetime.combine(day.date, time(), UTC).timestamp(),
        ),
        "rms_px": (
            "Root mean square distance of its sightings from its smooth arc, px.",
            None if day is None else day.rmsd_px,
        ),
        "pose_offset_degrees": (
            "Rotation against the calibration on it, degrees.",
            None if day is None or day.pose_offset_deg is None else math.hypot(*day.pose_offset_deg),
        ),
    }
    for name, (text, value) in values.items():
        yield _single_gauge(f"sunarc_last_day_{name}", text, value)


_OF_NIGHT = {
    "limiting_magnitude": "V to which half of the stars are detected.",
    "cloud_fraction": "Share of the stars to V 4 that are not seen.",
    "transparency": "Share of the light that comes through one air mass, with the shading of the lens.",
    "extinction": "Loss of light, magnitudes an air mass, with the shading of the lens.",
    "zero_point": "V of a star outside the air that gives one count a second.",
    "star_fwhm_px": "Full width of the stars at half maximum, px.",
    "star_ellipticity": "1 - minor / major axis of bright stars.",
    "halo": "Light around stars over their own: dew, haze.",
    "width_growth": "Width of the stars at its end over that at its beginning.",
    "halo_growth": "Growth of the halo from its beginning to its end.",
    "fading_mag": "Loss of brightness from its beginning to its end, magnitudes.",
    "n_images": "Exposures of the night.",
    "n_accepted": "Images whose stars were named.",
    "n_matched": "Named stars in an accepted image, median.",
}
"""Numbers of a night that are metrics, and their descriptions."""


def _night_metrics(night: Night | None) -> Iterator[Metric]:
    """Yield the known numbers of the last night that was judged; nothing without one."""
    evening = None if night is None else datetime.combine(night.date, time(), UTC).timestamp()
    yield _single_gauge(
        "sunarc_night_seconds", "Date of the last night that was judged (its evening) as Unix time.", evening
    )
    for name, text in _OF_NIGHT.items():
        yield _single_gauge(
            f"sunarc_night_{name}", f"Last night: {text}", None if night is None else getattr(night, name)
        )


_BOUNDS_S = (0.005, 0.02, 0.1, 0.5, 2.0, 10.0)
"""From an answer out of memory to the largest map."""


class RequestCounts(Collector):
    """Counts of answered requests by status, and their durations; written on the event loop alone."""

    def __init__(self) -> None:
        self._by_status: Counter[str] = Counter()
        self._by_duration = [0] * (len(_BOUNDS_S) + 1)
        self._sum_s = 0.0

    def add(self, status: int, duration_s: float) -> None:
        """Count an answer."""
        self._by_status[str(status)] += 1
        self._by_duration[bisect_left(_BOUNDS_S, duration_s)] += 1
        self._sum_s += duration_s

    def collect(self) -> Iterator[Metric]:
        """Yield the metrics of answered requests."""
        requests = CounterMetricFamily("sunarc_http_requests", "Requests that were answered.", labels=("status",))
        for status, n in sorted(self._by_status.copy().items()):
            requests.add_metric((status,), float(n))
        yield requests
        text = "From the request to the status of the answer, s."
        buckets = [str(bound) for bound in _BOUNDS_S] + ["+Inf"]
        counts = map(float, accumulate(self._by_duration.copy()))
        yield HistogramMetricFamily(
            "sunarc_http_request_seconds", text, buckets=list(zip(buckets, counts, strict=True)), sum_value=self._sum_s
        )
