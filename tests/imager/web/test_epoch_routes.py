"""Closing a pose epoch over HTTP: the one before continues, and its calibration answers again."""

from __future__ import annotations

from datetime import timedelta
from typing import TYPE_CHECKING, Any

import pytest
from tests.fixtures.served import NOON, document
from tests.imager.web.test_problems import check_shape

from sunarc.imager.archive.values import CameraRecord

if TYPE_CHECKING:
    from tests.fixtures.served import Made

CLOSE = "/v1/epochs/roof-2/close"


@pytest.fixture
def moved(made: Made) -> Made:
    """Make an application whose camera was thought to have moved an hour ago, with a calibration since."""
    at = NOON - timedelta(hours=1)
    made.archive.epochs.open("roof", at=at, reason="bump")
    made.archive.calibrations.add({**document("wrong", valid_from=at), "pose_epoch": "roof-2"})
    made.archive.calibrations.activate("wrong")
    return made


@pytest.mark.parametrize("path", [CLOSE, "/v1/cameras/roof/epochs/roof-2/close"])
def test_a_pose_epoch_is_closed_and_the_calibration_before_it_answers_again(moved: Made, path: str) -> None:
    assert moved.client.get("/v1/calibration").json()["id"] == "wrong"
    answer = moved.client.post(path, json={"reason": "a bird sat on it"}, headers=moved.bearer)
    assert answer.status_code == 200, answer.text
    assert answer.json() == {"id": "roof-2", "calibration": "second-r1"}
    assert moved.client.get("/v1/calibration").json()["id"] == "second-r1"
    past = moved.client.get("/v1/calibration", params={"at": (NOON - timedelta(minutes=30)).isoformat()}).json()
    assert past["id"] == "wrong"  # what was answered then stays
    assert [epoch.id for epoch in moved.archive.epochs.find("roof")] == ["roof-1"]
    (event,) = moved.client.get("/v1/events", params={"kind": "epoch_closed"}).json()["events"]
    assert event["text"].endswith("a bird sat on it")


@pytest.mark.parametrize(
    ("path", "body", "bears", "status"),
    [
        (CLOSE, {"reason": "x"}, False, 401),
        (CLOSE, {}, True, 422),
        (CLOSE, {"reason": ""}, True, 422),
        ("/v1/epochs/roof-1/close", {"reason": "x"}, True, 422),  # the camera's first
        ("/v1/epochs/roof-9/close", {"reason": "x"}, True, 404),
        ("/v1/cameras/other/epochs/roof-2/close", {"reason": "x"}, True, 404),  # is another camera's
    ],
)
def test_what_cannot_be_closed_is_refused_and_changes_nothing(
    moved: Made, path: str, body: dict[str, Any], *, bears: bool, status: int
) -> None:
    moved.archive.cameras.save(CameraRecord(name="other", latitude=0.0, longitude=0.0, altitude=0.0, width=8, height=6))
    answer = moved.client.post(path, json=body, headers=moved.bearer if bears else {})
    check_shape(answer, status, path)
    assert [epoch.id for epoch in moved.archive.epochs.find("roof")] == ["roof-1", "roof-2"]


def test_an_epoch_is_closed_once(moved: Made) -> None:
    asked = {"json": {"reason": "x"}, "headers": moved.bearer}
    assert [moved.client.post(CLOSE, **asked).status_code for _ in range(2)] == [200, 404]
    assert moved.client.get("/v1/calibration").json()["id"] == "second-r1"
