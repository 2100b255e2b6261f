"""A camera is ready where nothing is wrong with it, and else every reason is named, with its value and its limit."""

from __future__ import annotations

from dataclasses import replace
from datetime import UTC, datetime, timedelta
from typing import Any

import pytest

from sunarc.api.fleet_states import LARGEST_DRIFT_DEG, LARGEST_SIGMA_DEG, LEAST_DISK_BYTES, SILENT, members
from sunarc.archive.fleet.feed_rows import FleetCamera

NOON = datetime(2026, 6, 1, 18, 30, tzinfo=UTC)  # at 97.5° west
GOOD = FleetCamera(
    camera="roof",
    latitude=36.6,
    longitude=-97.5,
    altitude=318.0,
    received_at=NOON,
    last_sighting_at=NOON - timedelta(minutes=1),
    calibration="a",
    calibrated_at=NOON,
    sky_rms_deg=LARGEST_SIGMA_DEG,
    status={"health": "ready", "conditions": [], "drift_deg": LARGEST_DRIFT_DEG, "disk_free_bytes": LEAST_DISK_BYTES},
    status_at=NOON,
)


def judged(now: datetime = NOON, **changes: Any) -> tuple[str, list[str]]:  # noqa: ANN401 - of many types
    (member,) = members((replace(GOOD, **changes),), now)
    assert all(one.text for one in member.why)
    return member.state, [one.code for one in member.why]


def reported(**changes: object) -> dict[str, object]:
    return {**(GOOD.status or {}), **changes}


def test_a_camera_at_all_limits_is_ready() -> None:
    assert judged() == ("ready", [])
    assert judged(received_at=NOON - SILENT) == ("ready", [])


@pytest.mark.parametrize(
    ("changes", "state", "codes"),
    [
        ({"received_at": None, "status": {}}, "silent", ["silent"]),
        ({"received_at": NOON - SILENT - timedelta(seconds=1)}, "silent", ["silent"]),
        ({"status": reported(health="not_ready", conditions=["camera_lost"])}, "not_ready", ["camera_lost"]),
        ({"status": reported(health="degraded", conditions=["a", "b"])}, "degraded", ["a", "b"]),
        ({"status": reported(health="degraded", conditions="no list")}, "degraded", ["degraded"]),
        ({"status": reported(drift_deg=LARGEST_DRIFT_DEG + 0.01)}, "degraded", ["drift"]),
        ({"status": reported(drift_deg="3", disk_free_bytes=True)}, "ready", []),
        ({"status": reported(disk_free_bytes=LEAST_DISK_BYTES - 1)}, "degraded", ["disk"]),
        ({"sky_rms_deg": LARGEST_SIGMA_DEG + 0.01}, "degraded", ["calibration_uncertain"]),
        ({"sky_rms_deg": None}, "degraded", ["calibration_uncertain"]),
        ({"n_quarantined": 2}, "quarantine", ["quarantine"]),
        ({"calibration": None, "sky_rms_deg": None}, "uncalibrated", ["uncalibrated"]),
        ({"calibration": None, "last_sighting_at": None}, "uncalibrated", ["uncalibrated"]),
        ({"last_sighting_at": None}, "degraded", ["no_sighting"]),
        ({"last_sighting_at": NOON - timedelta(days=9)}, "degraded", ["no_sighting"]),
        ({"n_quarantined": 1, "status": reported(drift_deg=3.0)}, "degraded", ["drift", "quarantine"]),
    ],
)
def test_each_thing_that_is_wrong_is_named(changes: dict[str, Any], state: str, codes: list[str]) -> None:
    assert judged(**changes) == (state, codes)


@pytest.mark.parametrize(
    ("latitude", "now", "newest", "ready"),
    [
        (36.6, "2026-06-01T11:00", "2026-05-31T23:00", True),  # before sunrise: yesterday's
        (36.6, "2026-06-01T11:00", "2026-05-30T23:00", False),
        (36.6, "2026-06-01T19:00", "2026-05-31T23:00", False),  # at noon: today's
        (80.0, "2026-12-21T18:00", "2026-10-10T18:00", True),  # 10° was last reached before, in September
        (80.0, "2026-12-21T18:00", "2026-09-15T18:00", False),
        (-89.9, "2026-06-21T18:00", "2026-02-24T18:00", True),
    ],
)
def test_the_newest_sighting_is_of_the_last_day_with_sun(latitude: float, now: str, newest: str, ready: bool) -> None:  # noqa: FBT001
    at, seen = (datetime.fromisoformat(text).replace(tzinfo=UTC) for text in (now, newest))
    found = judged(at, latitude=latitude, received_at=at, last_sighting_at=seen)
    assert found == (("ready", []) if ready else ("degraded", ["no_sighting"]))
