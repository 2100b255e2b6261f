"""The numbers for Prometheus that the store has: they are the same after a restart."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from datetime import UTC, date, datetime, time, timedelta
from typing import get_args

from prometheus_client.core import GaugeMetricFamily, Metric

from sunarc.archive.archive import Archive
from sunarc.archive.values import Day, DayVerdict, Event, RefitState

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
    yield from _of_last_night(next(iter(archive.nights(camera, limit=1)), None))


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
        yield _gauge(f"sunarc_last_day_{name}", text, value)


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
"""Numbers of the event of a night that are metrics, and what they are."""


def _of_last_night(event: Event | None) -> Iterator[Metric]:
    """Yield the numbers of the last night that was judged; none where no night was, or where one is not known."""
    details = {} if event is None else event.details
    night = details.get("date")
    evening = None if night is None else datetime.combine(date.fromisoformat(str(night)), time(), UTC).timestamp()
    yield _gauge("sunarc_night_seconds", "Date of the last night that was judged (its evening) as Unix time.", evening)
    for name, text in _OF_NIGHT.items():
        value = details.get(name)
        number = float(value) if isinstance(value, int | float) else None
        yield _gauge(f"sunarc_night_{name}", f"Last night: {text}", number)


def _gauge(name: str, text: str, value: float | None) -> Metric:
    family = GaugeMetricFamily(name, text)
    if value is not None:
        family.add_metric((), value)
    return family


def _counts(name: str, text: str, label: str, counts: Mapping[str, int]) -> Metric:
    family = GaugeMetricFamily(name, text, labels=(label,))
    for value, n in sorted(counts.items()):
        family.add_metric((value,), float(n))
    return family
