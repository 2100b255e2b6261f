from __future__ import annotations

import logging
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
from tests.imager.web.test_problems import check_shape

from sunarc.imager.runtime.host import credential

if TYPE_CHECKING:
    from tests.fixtures.served import Made

READING = "reading token, long enough"
FORGED = [
    {},
    {"authorization": "Bearer "},
    {"authorization": "Bearer " + "x" * 26},
    {"authorization": "Bearer " + READING[:-1]},
    {"authorization": "Basic " + READING},
    {"authorization": READING},
    {"x-api-key": READING},
    {"cookie": f"token={READING}"},
]


@pytest.fixture
def private(make: Any, tmp_path: Path) -> Made:  # noqa: ANN401 - a fixture that is a function
    (tmp_path / "reading").write_text(READING + "\n")
    made: Made = make(history="filled", read_token_file=tmp_path / "reading")
    return made


@pytest.mark.parametrize("headers", FORGED)
def test_where_reading_needs_a_token_nothing_is_read_without_it(private: Made, headers: dict[str, str]) -> None:
    for path in ("/v1/calibration", "/v1/status", "/metrics", "/openapi.json", "/v1/cameras/roof/sun", "/nothing"):
        answer = private.client.get(path, headers=headers)
        check_shape(answer, 401, path)
        assert answer.headers["www-authenticate"] == "Bearer"


def test_both_tokens_read_and_one_changes(private: Made) -> None:
    reading = {"authorization": f"Bearer {READING}"}
    for headers in (reading, private.bearer):
        assert private.client.get("/v1/calibration", headers=headers).status_code == 200
    assert private.client.post("/v1/refits", headers=reading).status_code == 401
    assert private.client.post("/v1/refits", headers=private.bearer).status_code == 202


@pytest.mark.parametrize("path", ["/", "/healthz", "/readyz", "/static/dashboard.js"])
def test_the_probes_and_the_empty_page_stay_open(private: Made, path: str) -> None:
    assert private.client.get(path).status_code == 200


@pytest.mark.parametrize("path", ["/static/../v1/calibration", "/static/%2e%2e/v1/calibration", "//v1/calibration"])
def test_a_path_that_pretends_to_be_open_reads_nothing(private: Made, path: str) -> None:
    assert private.client.get(path).status_code in {401, 404}


def test_no_token_is_ever_written_down(private: Made, caplog: pytest.LogCaptureFixture) -> None:
    with caplog.at_level(logging.DEBUG):
        private.client.get("/v1/sun", headers={"authorization": "Bearer a forged one that is long"})
        private.client.get("/v1/sun", headers=private.bearer)
        private.archive.close()
    told = caplog.text + repr(private.app.__dict__) + str([route.__dict__ for route in private.app.routes])
    for secret in (READING, "a forged one", private.bearer["authorization"]):
        assert secret not in told


def test_a_credential_of_systemd_is_found_where_there_is_one(tmp_path: Path) -> None:
    (tmp_path / "api-token").write_text("x" * 20)
    where = {"CREDENTIALS_DIRECTORY": str(tmp_path)}
    assert credential(where, "api-token") == tmp_path / "api-token"
    assert credential(where, "api-read-token") is None
    assert credential({}, "api-token") is None


def test_other_sites_may_not_ask_unless_they_are_named(make: Any) -> None:  # noqa: ANN401 - a fixture that is a function
    named = "https://forecast.example"
    asked = {"origin": named, "access-control-request-method": "POST"}
    closed, opened = make(), make(cors_origins=(named,))
    refused = closed.client.request("OPTIONS", "/v1/sun", headers=asked)
    assert "access-control-allow-origin" not in refused.headers
    allowed = opened.client.request("OPTIONS", "/v1/sun", headers=asked)
    assert allowed.headers["access-control-allow-origin"] == named
    assert "access-control-allow-credentials" not in allowed.headers
    other = opened.client.get("/healthz", headers={"origin": "https://elsewhere.example"})
    assert "access-control-allow-origin" not in other.headers


def test_a_past_calibration_is_made_current_by_hand(made: Made) -> None:
    answer = made.client.post(
        "/v1/calibrations/first/activate", json={"reason": "the dome is off"}, headers=made.bearer
    )
    assert answer.status_code == 200, answer.text
    told = answer.json()
    assert (told["state"], told["parent"], told["valid_from"]) == ("current", "first", "2013-05-13T18:30:00Z")
    current = made.client.get("/v1/calibration").json()
    assert current["id"] == told["id"]
    before = made.client.get("/v1/calibration", params={"at": "2013-05-13T00:00:00Z"}).json()
    assert before["id"] == "second"
    assert made.client.get("/v1/events").json()["events"][0]["text"].endswith("the dome is off")


def test_the_current_calibration_is_pinned_and_let_go(made: Made) -> None:
    for action, pinned in (("pin", True), ("unpin", False)):
        answer = made.client.post(
            f"/v1/cameras/roof/calibrations/second/{action}", json={"reason": "campaign"}, headers=made.bearer
        )
        assert (answer.status_code, answer.json()["pinned"]) == (200, pinned)


@pytest.mark.parametrize(
    ("path", "body", "bears", "status"),
    [
        ("second/activate", {"reason": "x"}, 1, 409),  # is current already
        ("first/pin", {"reason": "x"}, 1, 409),  # is not current
        ("none/activate", {"reason": "x"}, 1, 404),
        ("first/activate", {}, 1, 422),
        ("first/activate", {"reason": ""}, 1, 422),
        ("first/activate", {"reason": "x"}, 0, 401),
    ],
)
def test_a_decision_that_cannot_be_is_refused(
    made: Made, path: str, body: dict[str, str], bears: int, status: int
) -> None:
    headers = made.bearer if bears else {}
    check_shape(
        made.client.post(f"/v1/calibrations/{path}", json=body, headers=headers), status, f"/v1/calibrations/{path}"
    )
    assert made.client.get("/v1/calibration").json()["id"] == "second"


def test_a_body_of_another_kind_is_told_so(made: Made) -> None:
    path = "/v1/calibrations/first/activate"
    answer = made.client.post(path, content=b"a=b", headers={"content-type": "text/csv", **made.bearer})
    assert check_shape(answer, 415, path)["errors"][0]["remedy"] == "send application/json"
