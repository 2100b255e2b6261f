"""Query parameters that do not exist, times whose + was lost, and HEAD."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

if TYPE_CHECKING:
    from tests.fixtures.served import Made


@pytest.mark.parametrize(
    ("path", "known"),
    [
        ("/v1/calibration", {"at", "format"}),
        ("/v1/sun", {"at"}),
        ("/v1/cameras/SGP/sun", {"at"}),
        ("/v1/calibrations", {"state", "limit", "cursor"}),
        ("/v1/status", set()),
    ],
)
def test_a_parameter_that_a_route_does_not_have_is_refused_with_those_it_has(
    made: Made, path: str, known: set[str]
) -> None:
    path = path.replace("SGP", made.archive.cameras.all()[0].name)
    answer = made.client.get(path, params={"att": "2013-05-13T18:30:00Z"})
    assert answer.status_code == 422
    (fault,) = answer.json()["errors"]
    assert fault["field"] == "att"
    assert all(name in fault["remedy"] for name in known)
    assert made.client.get(path).status_code == 200


def test_a_parameter_beside_known_ones_is_refused_before_anything_is_computed(made: Made) -> None:
    query = {"at": "2013-05-13T18:30:00Z", "calibratoin": "x"}
    answer = made.client.post("/v1/back-project", params=query, json={"pixels": "not read"})
    assert answer.status_code == 422
    assert [fault["field"] for fault in answer.json()["errors"]] == ["calibratoin"]
    good = made.client.post("/v1/back-project", params={"at": query["at"], "draws": 1, "seed": 2}, json={"pixels": []})
    assert good.status_code == 200


def test_a_plus_that_became_a_space_is_explained(made: Made) -> None:
    answer = made.client.get("/v1/sun?at=2013-05-13T18:30:00+00:00")
    assert answer.status_code == 422
    (fault,) = answer.json()["errors"]
    assert fault["field"] == "at"
    assert "%2B" in fault["remedy"]
    assert made.client.get("/v1/sun?at=2013-05-13T18:30:00%2B00:00").status_code == 200
    assert "%2B" not in str(made.client.get("/v1/sun?at=2013-05-13 18:30:00").json())


@pytest.mark.parametrize(
    "path", ["/", "/v1/status", "/v1/calibration", "/v1/sun", "/metrics", "/healthz", "/openapi.json"]
)
def test_head_answers_as_get_without_a_body(made: Made, path: str) -> None:
    get, head = made.client.get(path), made.client.request("HEAD", path)
    assert (head.status_code, head.content) == (get.status_code, b"")
    for name in ("content-type", "etag"):
        assert head.headers.get(name) == get.headers.get(name)
    assert "content-length" in head.headers or "transfer-encoding" in head.headers


def test_head_of_what_is_not_there_is_404_and_a_write_route_has_none(made: Made) -> None:
    assert made.client.request("HEAD", "/v1/nothing").status_code == 404
    assert made.client.request("HEAD", "/v1/back-project").status_code == 405
    allowed = made.client.request("DELETE", "/v1/sun").headers["allow"].split(", ")
    assert set(allowed) == {"GET", "HEAD"}
