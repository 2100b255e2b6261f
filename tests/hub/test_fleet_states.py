"""A camera is ready where nothing is wrong with it, and else every reason is named, with its value and its limit."""

from __future__ import annotations

from dataclasses import replace
from datetime import UTC, date, datetime, timedelta
from typing import Any

import pytest

from sunarc.hub.fleet_states import LARGEST_DRIFT_DEG, LARGEST_SIGMA_DEG, LEAST_DISK_BYTES, SILENT, members
from sunarc.hub.nightly_store import CrossCheck, CrossChecks
from sunarc.imager.archive.feed_rows import FleetCamera

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
    ("changes", "state", "text"),
    [
        ({}, "ready", "ready"),
        ({"received_at": None, "status": {}}, "not_serving", "has never sent anything"),
        ({"status": reported(health="not_ready", conditions=["camera_refused"])}, "not_serving", "camera refused"),
        ({"status": reported(health="degraded", conditions=["no_calibration"])}, "starting", "no calibration"),
        ({"status": reported(health="degraded", conditions=["clock_stepped"])}, "ready_with_note", "clock stepped"),
        ({"calibration": None, "sky_rms_deg": None}, "starting", "no calibration"),
        ({"n_quarantined": 2}, "attention", "2 in quarantine"),
        ({"status": reported(state="attention", state_text="moved by 2.5°")}, "attention", "moved by 2.5°"),
        (
            {"status": reported(health="degraded", conditions=["a"], state="starting", state_text="collecting")},
            "starting",
            "collecting",
        ),
        ({"status": reported(state="starting", state_text="collecting"), "n_quarantined": 1}, "attention", "1 in qu"),
        ({"status": reported(state="of a later version")}, "ready", "ready"),
        ({"status": reported(state=["no word"])}, "ready", "ready"),
    ],
)
def test_a_camera_has_the_state_of_its_imager_and_of_what_the_hub_finds(
    changes: dict[str, Any], state: str, text: str
) -> None:
    (member,) = members((replace(GOOD, **changes),), NOON)
    assert member.service_state == state
    assert member.state_text.startswith(text)


CHECK = CrossCheck(camera="roof", neighbours=("gate", "mast", "yard"), n_days=40, found=(), since=date(2026, 5, 20))
OF_CLOUDS: dict[str, Any] = {"found": ("clock_by_clouds",), "cloud_clock_s": 45.0, "cloud_clock_sigma_s": 8.0}


@pytest.mark.parametrize(
    ("shown", "days_ago", "codes", "words"),
    [
        ({"found": ()}, 0, [], ()),
        ({"found": ("slow_turn",)}, 0, [], ()),
        ({"found": ("unconfirmed",), "agreeing": 2}, 0, [], ()),
        ({"found": ("clock",), "clock_s": 2.1, "clock_sigma_s": 0.2}, 0, ["clock"], ("2.1 ± 0.2 s", "3", "0.98")),
        ({"found": ("longitude",), "longitude_deg": 0.01, "longitude_sigma_deg": 0.001}, 3, ["longitude"], ("0.01 ±",)),
        ({"found": ("north",), "north_deg": 0.1, "north_sigma_deg": 0.002}, 0, ["north"], ("0.1 ± 0.002°",)),
        ({"found": ("moved",), "rotation_deg": (0.03, 0.0, 0.04)}, 0, ["moved"], ("0.05°", "2026-05-20")),
        (OF_CLOUDS, 0, ["clock_by_clouds"], ("45 ± 8 s",)),
        ({"found": ("north",), "north_deg": 0.1, "north_sigma_deg": 0.002}, 4, [], ()),
        ({"found": ("north",), "north_deg": 0.1, "north_sigma_deg": 0.002, "camera": "gate"}, 0, [], ()),
    ],
)
def test_what_neighbours_agree_on_is_a_reason_with_its_size_and_probability(
    shown: dict[str, Any], days_ago: int, codes: list[str], words: tuple[str, ...]
) -> None:
    check = replace(CHECK, **{"agreeing": 3, "confidence": 0.98} | shown)
    crossed = CrossChecks(night=date(2026, 5, 30), time=NOON - timedelta(days=days_ago), checks=(check,))
    (member,) = members((GOOD,), NOON, crossed)
    assert [one.code for one in member.why] == [f"neighbours_{code}" for code in codes]
    assert member.state == ("degraded" if codes else "ready")
    assert all(word in member.why[0].text for word in words)


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
