"""The numbers for Prometheus that the store has: they are the same after a restart."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from datetime import UTC, datetime, time, timedelta
from typing import get_args

from prometheus_client.core import GaugeMetricFamily, Metric

from sunarc.archive import Archive, Day, DayVerdict, RefitState

_A_DAY = timedelta(days=1)


def record_metrics(archive: Archive, camera: str, *, now: datetime) -> Iterator[Metric]:
    """Yield counts of sightings, days and refits, and the scatter and the rotation of the last day.

    Parameters
    ----------
    archive, camera : whose.
    now : the frames' time.
    """
    sightings = archive.count_sightings(camera, since=now - _A_DAY, until=now + _A_DAY)
    text = "Sightings of the last 24 h by verdict, also those of a clock that was ahead."
    yield _counts("sunarc_sightings_last_day", text, "verdict", sightings)
    days = dict.fromkeys(get_args(DayVerdict), 0) | dict(archive.count_days(camera))
    yield _counts("sunarc_days", "Days that were judged, by verdict.", "verdict", days)
    refits = dict.fromkeys(get_args(RefitState), 0) | dict(archive.count_refits(camera))
    yield _counts("sunarc_refits", "Refits by state.", "state", refits)
    yield from _of_last_day(next(iter(archive.days(camera, limit=1)), None))


def _of_last_day(day: Day | None) -> Iterator[Metric]:
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
        family = GaugeMetricFamily(f"sunarc_last_day_{name}", text)
        if value is not None:
            family.add_metric((), value)
        yield family


def _counts(name: str, text: str, label: str, counts: Mapping[str, int]) -> Metric:
    family = GaugeMetricFamily(name, text, labels=(label,))
    for value, n in sorted(counts.items()):
        family.add_metric((value,), float(n))
    return family
