from __future__ import annotations

from datetime import timedelta
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
from tests.fixtures.served import NOT_ACCEPTED, write_image

if TYPE_CHECKING:
    from tests.fixtures.served import Made


def test_days_tell_their_verdict_the_newest_first(made: Made) -> None:
    told = made.client.get("/v1/days").json()["days"]
    assert [(day["date"], day["verdict"]) for day in told] == [("2013-05-12", "clear"), ("2013-05-11", "cloudy")]
    assert told[0]["findings"] == [{"code": "day_share_on_arc", "data": {"share": 0.9, "n_observed": 800}}]
    assert len(told[0]["reasons"]) == 1
    chosen = made.client.get("/v1/days", params={"since": "2013-05-11", "until": "2013-05-12"}).json()["days"]
    assert [day["date"] for day in chosen] == ["2013-05-11"]


def test_events_tell_what_happened(made: Made) -> None:
    told = made.client.get("/v1/events").json()["events"]
    assert [(event["kind"], event["severity"]) for event in told] == [("refit_refused", "warning"), ("start", "info")]
    grave = made.client.get("/v1/events", params={"severity": "warning", "limit": 1}).json()["events"]
    assert [event["text"] for event in grave] == [NOT_ACCEPTED.text]


def test_the_latest_image_is_sent_once(made: Made) -> None:
    answer = made.client.get("/v1/image/latest")
    assert (answer.status_code, answer.headers["content-type"]) == (200, "image/jpeg")
    assert answer.content[:3] == b"\xff\xd8\xff"
    again = made.client.get("/v1/image/latest", headers={"if-none-match": answer.headers["etag"]})
    assert (again.status_code, again.content) == (304, b"")
    assert answer.headers["sunarc-time"] == again.headers["sunarc-time"] == "2013-05-13T18:30:00Z"  # of its name
    made.board.note(last_frame_at=made.noon + timedelta(hours=1))
    assert made.client.get("/v1/image/latest").headers["sunarc-time"] == "2013-05-13T18:30:00Z"


def test_a_picture_of_another_program_has_the_time_of_the_last_frame(make: Any, tmp_path: Path) -> None:  # noqa: ANN401 - a fixture that is a function
    made = make(image=write_image(tmp_path, "image-7.jpg"))
    assert "sunarc-time" not in made.client.get("/v1/image/latest").headers
    made.board.note(last_frame_at=made.noon)
    assert made.client.get("/v1/image/latest").headers["sunarc-time"] == "2013-05-13T18:30:00Z"


def test_without_an_image_there_is_none(empty: Made) -> None:
    answer = empty.client.get("/v1/image/latest")
    assert answer.status_code == 404
    assert answer.json()["errors"][0]["field"] == "image"


def test_an_image_that_vanished_is_a_problem_of_the_disk(make: Any, tmp_path: Path) -> None:  # noqa: ANN401 - a fixture that is a function
    made = make(image=tmp_path / "gone.jpg")
    answer = made.client.get("/v1/image/latest")
    assert answer.status_code == 503
    assert "gone.jpg cannot be read" in answer.json()["detail"]


def test_a_refit_is_asked_for_and_followed(made: Made) -> None:
    answer = made.client.post("/v1/refits", json={"reason": "cleaned the dome"}, headers=made.bearer)
    assert (answer.status_code, answer.json()["state"]) == (202, "requested")
    assert made.asked == ["cleaned the dome"]
    followed = made.client.get(answer.headers["location"])
    assert followed.json() == answer.json()


def test_a_refit_that_is_asked_for_while_one_waits_is_that_one(made: Made) -> None:
    answers = [made.client.post("/v1/refits", headers=made.bearer) for _ in range(5)]
    assert {answer.status_code for answer in answers} == {202}
    (location,) = {answer.headers["location"] for answer in answers}
    made.archive.refits.start(location.rpartition("/")[2], started_at=made.noon)
    assert made.client.post("/v1/refits", headers=made.bearer).headers["location"] != location
    assert len(made.client.get("/v1/refits").json()["refits"]) == 2


def test_a_refit_needs_no_reason(made: Made) -> None:
    assert made.client.post("/v1/refits", headers=made.bearer).status_code == 202
    assert made.asked == ["on request"]


@pytest.mark.parametrize(
    "headers",
    [
        {},
        {"authorization": ""},
        {"authorization": "Bearer"},
        {"authorization": "Bearer wrong"},
        {"authorization": "Basic YTpi"},
        {"authorization": "Bearer ünï".encode().decode("latin-1")},
    ],
)
def test_without_the_token_nothing_is_changed(made: Made, headers: dict[str, str]) -> None:
    answer = made.client.post("/v1/refits", headers={name: value.encode("latin-1") for name, value in headers.items()})
    assert (answer.status_code, answer.headers["www-authenticate"]) == (401, "Bearer")
    assert answer.json()["type"] == "urn:sunarc:problem:token"
    assert made.asked == []


def test_where_no_token_is_set_nothing_can_be_changed(make: Any) -> None:  # noqa: ANN401 - a fixture that is a function
    made = make(token=False)
    answer = made.client.post("/v1/refits", headers=made.bearer)
    assert answer.status_code == 403
    assert answer.json()["errors"][0]["remedy"] == "set api.token_file"
    assert made.asked == []


def test_an_unknown_refit_is_not_found(made: Made) -> None:
    assert made.client.get("/v1/refits/none").status_code == 404
