from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import pytest
from prometheus_client.parser import text_string_to_metric_families
from tests.fixtures.served import LENS

from sunarc.imager.runtime.status import Reason
from sunarc.optics.mounting import pose_text
from sunarc.optics.pose import pose_angles

if TYPE_CHECKING:
    from tests.fixtures.served import Made

DRIFT = Reason(
    code="drift",
    severity="degraded",
    text="the camera moved",
    remedy="wait for a clear day",
    data={"moved_deg": 0.5, "sigma_deg": math.nan},
)
LOST = Reason(code="camera_lost", severity="not_ready", text="the camera is gone", remedy="check its cable")


def test_alive_is_alive_whatever_is_the_matter(made: Made) -> None:
    made.board.set_condition(LOST.code, LOST)
    answer = made.client.get("/healthz")
    assert (answer.status_code, answer.json()) == (200, {"status": "alive"})


def test_ready_is_ready(made: Made) -> None:
    nothing: dict[str, list[object]] = {"reasons": [], "notes": [], "findings": []}
    assert made.client.get("/readyz").json() == {"status": "ready", "state": "ready", "state_text": "ready"} | nothing


def test_degraded_still_serves_and_says_why(made: Made) -> None:
    made.board.set_condition(DRIFT.code, DRIFT)
    answer = made.client.get("/readyz")
    assert answer.status_code == 200
    assert answer.json()["status"] == "degraded"
    assert (answer.json()["state"], answer.json()["state_text"]) == ("attention", "the camera moved")
    assert answer.json()["reasons"] == [
        {
            "code": "drift",
            "severity": "degraded",
            "text": "the camera moved",
            "remedy": "wait for a clear day",
            "since": "2013-05-13T09:30:00Z",  # the service started then, and its clock stands still
            "state": "attention",
        }
    ]
    assert answer.json()["findings"] == [{"code": "drift", "data": {"moved_deg": 0.5, "sigma_deg": None}}]


NOTE = Reason(code="camera_moved", severity="note", text="moved by 2.5°", remedy="acknowledge it")


def test_a_note_leaves_status_metric_and_reasons_as_they_are(made: Made) -> None:
    made.board.set_condition(NOTE.code, NOTE)
    answer = made.client.get("/readyz")
    assert answer.status_code == 200
    ready = answer.json()
    assert (ready["status"], ready["reasons"], ready["findings"]) == ("ready", [], [])
    assert (ready["state"], ready["state_text"]) == ("attention", NOTE.text)
    assert [(one["code"], one["severity"], one["state"]) for one in ready["notes"]] == [
        ("camera_moved", "note", "attention")
    ]
    status = made.client.get("/v1/status").json()
    assert {key: status[key] for key in ("health", "state", "state_text", "notes")} == {
        **{key: ready[key] for key in ("state", "state_text", "notes")},
        "health": "ready",
    }
    told = numbers(made)
    assert told["sunarc_health", ("ready",)] == 1.0
    assert not any(name == "sunarc_reason" for name, _ in told)


def test_not_ready_is_a_problem_with_every_remedy(made: Made) -> None:
    made.board.set_condition(DRIFT.code, DRIFT)
    made.board.set_condition(LOST.code, LOST)
    answer = made.client.get("/readyz")
    assert (answer.status_code, answer.headers["content-type"]) == (503, "application/problem+json")
    assert answer.json()["detail"] == f"{LOST.text}; {LOST.remedy}"
    assert (answer.json()["state"], answer.json()["state_text"]) == ("not_serving", LOST.text)
    assert [(error["field"], error["remedy"]) for error in answer.json()["errors"]] == [
        ("camera_lost", "check its cable"),
        ("drift", "wait for a clear day"),
    ]


def test_the_status_tells_everything_at_a_glance(made: Made) -> None:
    told = made.client.get("/v1/status").json()
    assert (told["health"], told["camera_name"], told["image_size"]) == ("ready", "roof", [1748, 1748])
    assert [(w["name"], w["state"], w["restarts"]) for w in told["workers"]] == [
        ("capture", "running", 0),
        ("detect", "running", 1),
    ]
    assert told["camera"]["connected"] is True
    assert told["clock"] == {
        "synchronised": True,
        "max_error_s": 0.01,
        "last_step_s": -2.5,
        "last_step_at": "2013-05-13T18:00:00Z",
    }
    assert (told["calibration"]["id"], told["last_day"]["date"]) == ("second", "2013-05-12")
    assert told["frame_time"] == told["last_frame_at"] == "2013-05-13T18:30:00Z"


def test_the_status_of_a_service_that_just_started_knows_nothing(empty: Made) -> None:
    told = empty.client.get("/v1/status").json()
    assert told["workers"] == []
    for name in ("camera", "clock", "disk_free_bytes", "disk", "last_frame_at", "calibration", "last_day"):
        assert told[name] is None


def numbers(made: Made) -> dict[tuple[str, tuple[str, ...]], float]:
    told: dict[tuple[str, tuple[str, ...]], float] = {}
    for family in text_string_to_metric_families(made.client.get("/metrics").text):
        told |= {(sample.name, tuple(sorted(sample.labels.values()))): sample.value for sample in family.samples}
    return told


def test_prometheus_reads_the_same_state(made: Made) -> None:
    made.board.set_condition(DRIFT.code, DRIFT)
    told = numbers(made)
    assert told["sunarc_health", ("degraded",)] == 1.0
    assert told["sunarc_health", ("ready",)] == 0.0
    assert told["sunarc_reason", ("degraded", "drift")] == 1.0
    assert told["sunarc_worker_restarts", ("detect",)] == 1.0
    assert told["sunarc_worker_state", ("capture", "running")] == 1.0
    assert told["sunarc_last_frame_seconds", ()] == made.noon.timestamp()
    assert told["sunarc_calibration_present", ()] == 1.0
    assert told["sunarc_calibration_rmse_px", ()] == 0.041


def test_what_is_not_known_has_no_number(empty: Made) -> None:
    told = numbers(empty)
    assert told["sunarc_calibration_present", ()] == 0.0
    assert ("sunarc_last_frame_seconds", ()) not in told


def test_two_applications_do_not_share_their_numbers(made: Made, empty: Made) -> None:
    assert numbers(made)["sunarc_calibration_present", ()] != numbers(empty)["sunarc_calibration_present", ()]


def test_the_status_has_the_pose_in_words_and_angles_and_the_sites_zone(make: Any) -> None:  # noqa: ANN401 - a fixture that is a function
    made: Made = make(history="filled", timezone="Pacific/Auckland")
    told = made.client.get("/v1/status").json()
    assert (told["timezone"], told["is_replay"]) == ("Pacific/Auckland", False)
    angles = pose_angles(LENS.rotation_cam_enu)
    assert told["pose"]["theta_zz_deg"] == pytest.approx(angles.theta_zz_deg)
    assert told["pose"]["text"] == pose_text(LENS)
    assert make(history="empty").client.get("/v1/status").json()["pose"] is None


def test_the_sky_now_is_the_sun_by_day_and_says_when_it_is_next(made: Made) -> None:
    by_day = made.client.get("/v1/status").json()["sky"]
    sun = made.client.get("/v1/sun").json()
    assert by_day["sun_elevation_deg"] == 90.0 - sun["apparent_zenith"]
    assert (by_day["observed"], by_day["sun_from"], by_day["stars_from"]) == ("sun", "2013-05-13T18:30:00Z", None)
