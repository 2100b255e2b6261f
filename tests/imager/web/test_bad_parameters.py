"""Every route refuses what is wrong in a problem document (RFC 9457) that names the field; limits from both sides."""

from __future__ import annotations

from typing import Any

import pytest
from tests.fixtures.served import Made, Make

WRONG = [
    ("/v1/sun?at=yesterday", "at"),
    ("/v1/sun?at=2013-05-13T18:30:00", "at"),
    ("/v1/sun/track?date=2013-13-01", "date"),
    ("/v1/sun-points?since=noon", "since"),
    ("/v1/sun-points?limit=0", "limit"),
    ("/v1/sun-points?accepted=perhaps", "accepted"),
    ("/v1/refits?limit=many", "limit"),
    ("/v1/refits?cursor=1", "cursor"),
    ("/v1/back-projection-map?format=gif", "format"),
    ("/v1/back-projection-map?sun_radius_deg=-1", "sun_radius_deg"),
    ("/v1/calibration?at=2013", "at"),
    ("/v1/calibration?format=matlab", "format"),
    ("/v1/calibrations?state=best", "state"),
    ("/v1/calibrations?limit=-3", "limit"),
    ("/v1/days?since=2013-02-30", "since"),
    ("/v1/days?limit=0", "limit"),
    ("/v1/events?until=never", "until"),
    ("/v1/overlay?at=1e99", "at"),
    ("/v1/days/2013-02-30/air", "date"),
]


def problem_of(answer: Any, status: int) -> dict[str, Any]:  # noqa: ANN401 - an answer of httpx
    assert answer.status_code == status
    assert answer.headers["content-type"].startswith("application/problem+json")
    found: dict[str, Any] = answer.json()
    assert found["status"] == status
    assert {"type", "title", "detail"} <= found.keys()
    return found


@pytest.mark.parametrize(("path", "field"), WRONG)
def test_a_wrong_parameter_is_named(made: Made, path: str, field: str) -> None:
    problem = problem_of(made.client.get(path), 422)
    assert [error["field"] for error in problem["errors"]] == [field]
    assert problem["errors"][0]["remedy"]


@pytest.mark.parametrize("path", sorted({path.partition("?")[0] for path, _ in WRONG if "?" in path}))
def test_the_same_route_answers_without_the_parameter(make: Make, path: str) -> None:
    assert make(history="small").client.get(path).status_code == 200


@pytest.mark.parametrize("path", ["/v1/sun-points", "/v1/refits", "/v1/calibrations", "/v1/days", "/v1/events"])
def test_a_list_is_at_most_as_long_as_its_documented_limit(made: Made, path: str) -> None:
    parameters = made.app.openapi()["paths"][path]["get"]["parameters"]
    (limit,) = [one["schema"] for one in parameters if one["name"] == "limit"]
    for allowed in (limit["minimum"], limit["maximum"]):
        assert made.client.get(f"{path}?limit={allowed}").status_code == 200
    for refused in (limit["minimum"] - 1, limit["maximum"] + 1):
        problem_of(made.client.get(f"{path}?limit={refused}"), 422)


@pytest.mark.parametrize(
    "path", ["/v1/calibrations/absent", "/v1/refits/absent", "/v1/nothing", "/v1/cameras/mast/sun"]
)
def test_what_is_not_there_is_a_404(made: Made, path: str) -> None:
    problem_of(made.client.get(path), 404)


@pytest.mark.parametrize(
    "path", ["/v1/refits", "/v1/calibrations/second/activate", "/v1/calibrations/second/pin", "/v1/epochs/roof-1/close"]
)
def test_a_change_needs_the_token(made: Made, path: str) -> None:
    problem_of(made.client.post(path), 401)
    problem_of(made.client.post(path, headers={"authorization": "Bearer another token of length"}), 401)
    assert made.asked == []


@pytest.mark.parametrize("path", ["/v1/back-project", "/v1/project", "/v1/geolocate"])
@pytest.mark.parametrize("body", ["{", "[]", '{"nothing": 1}', "null"])
def test_a_body_that_is_none_is_refused(made: Made, path: str, body: str) -> None:
    answer = made.client.post(path, content=body, headers={"content-type": "application/json"})
    problem_of(answer, 422)


@pytest.mark.parametrize("path", ["/v1/calibration", "/v1/calibrations/second", "/v1/back-projection-map?format=npz"])
def test_what_has_not_changed_is_not_sent_again(make: Make, path: str) -> None:
    made = make(history="small")
    first = made.client.get(path)
    again = made.client.get(path, headers={"if-none-match": first.headers["etag"]})
    assert (again.status_code, again.content) == (304, b"")
    assert again.headers["etag"] == first.headers["etag"]
    assert made.client.get(path, headers={"if-none-match": '"another"'}).status_code == 200
