"""An operator acknowledges an event once, with the token; what is wrong with a request has one answer."""

from __future__ import annotations

from datetime import timedelta
from typing import TYPE_CHECKING, Any

import pytest

from sunarc.imager.archive.values import TO_ACKNOWLEDGE, CameraRecord, Event

if TYPE_CHECKING:
    from tests.fixtures.served import Made


def add(made: Made, kind: str = "bump", camera: str = "roof", *, waits: bool = True, hours: float = 0.0) -> int:
    details: dict[str, Any] = {"size": 2.5, "sigma": 0.3} | ({TO_ACKNOWLEDGE: True} if waits else {})
    time = made.noon + timedelta(hours=hours)
    event = Event(time=time, kind=kind, severity="alarm", text="moved", camera=camera, details=details)
    stored = made.archive.events.add(event)
    assert stored.id is not None
    return stored.id


def acknowledge(made: Made, event: int | str, *, camera: str = "", **how: Any) -> Any:  # noqa: ANN401 - of httpx
    path = f"/v1{camera}/events/{event}/acknowledge"
    return made.client.post(path, **({"headers": made.bearer} | how))


def waiting(made: Made, **filters: str) -> list[int]:
    answer = made.client.get("/v1/events", params={"to_acknowledge": "true", **filters})
    assert answer.status_code == 200
    return [event["id"] for event in answer.json()["events"]]


def test_an_event_waits_until_it_is_acknowledged_with_a_reason(made: Made) -> None:
    event = add(made)
    assert waiting(made) == [event]
    answer = acknowledge(made, event, json={"reason": "the mast was painted"})
    assert answer.status_code == 200
    told = answer.json()
    assert (told["id"], told["to_acknowledge"]) == (event, False)
    assert told["details"]["acknowledged_at"] == "2013-05-13T18:30:00Z"
    assert told["details"]["acknowledged_because"] == "the mast was painted"
    assert told["details"]["size"] == 2.5
    assert waiting(made) == []
    assert made.archive.events.get("roof", event).details == told["details"]


def test_a_request_without_a_body_acknowledges_too(made: Made) -> None:
    assert acknowledge(made, add(made)).status_code == 200


def test_a_long_record_lists_those_that_wait(made: Made) -> None:
    old = add(made, hours=-2000.0)
    for n in range(150):
        add(made, "clock", waits=False, hours=-float(n))
    new = add(made, "lens", hours=-3.0)
    assert waiting(made) == [new, old]
    assert waiting(made, kind="bump") == [old]
    assert waiting(made, limit="1") == [new]


def test_twice_is_a_conflict_that_says_when_it_was(made: Made) -> None:
    event = add(made)
    acknowledge(made, event)
    answer = acknowledge(made, event)
    assert (answer.status_code, answer.json()["type"]) == (409, "urn:sunarc:problem:conflict")
    assert "2013-05-13T18:30:00Z" in answer.json()["errors"][0]["problem"]
    assert answer.json()["errors"][0]["field"] == "id"


def test_an_event_that_needs_none_is_a_conflict(made: Made) -> None:
    assert acknowledge(made, add(made, "clock", waits=False)).status_code == 409


def test_without_the_token_nothing_is_acknowledged(made: Made) -> None:
    event = add(made)
    for headers in ({}, {"authorization": "Bearer of another"}):
        assert acknowledge(made, event, headers=headers).status_code == 401
    assert waiting(made) == [event]


def test_without_a_configured_token_it_is_forbidden(make: Any) -> None:  # noqa: ANN401 - the fixture's
    made = make(token=False)
    event = add(made)
    assert acknowledge(made, event).status_code == 403
    assert waiting(made) == [event]


def test_an_event_of_another_camera_is_not_found(made: Made) -> None:
    made.archive.cameras.save(
        CameraRecord(name="mast", latitude=36.6, longitude=-97.5, altitude=318.0, width=8, height=6)
    )
    event = add(made, camera="mast")
    for answer in (acknowledge(made, event), acknowledge(made, 10**9)):
        assert (answer.status_code, answer.json()["type"]) == (404, "urn:sunarc:problem:not-found")
        assert len(answer.json()["errors"]) == 1
    assert made.archive.events.get("mast", event).to_acknowledge
    assert acknowledge(made, event, camera="/cameras/mast").status_code == 200


@pytest.mark.parametrize(
    ("event", "body"),
    [("x", {}), ("0", {}), ("99999999999999999999", {}), ("1", {"reason": ""}), ("1", {"why": "typo"}), ("1", [])],
)
def test_a_malformed_request_names_its_fault(made: Made, event: str, body: object) -> None:
    answer = acknowledge(made, event, json=body)
    assert (answer.status_code, answer.json()["type"]) == (422, "urn:sunarc:problem:invalid")
    assert answer.json()["errors"][0]["remedy"]
