"""To which names the service answers: not to one that a page was rebound under."""

from __future__ import annotations

import socket
from typing import TYPE_CHECKING, Any

import pytest
from tests.imager.web.test_problems import check_shape

from sunarc.common.errors import InputError
from sunarc.imager.web.options import ApiOptions

if TYPE_CHECKING:
    from tests.fixtures.served import Made

OURS = [
    "localhost",
    "localhost:8080",
    "LocalHost.",
    "imager.localhost:8080",
    "127.0.0.1:8080",
    "127.0.0.1",
    "[::1]:8080",
    "[::1]",
    "192.168.1.20:8080",  # a port forwarding's: the host does not know it
    "[2001:db8::7]",
    "roof.example",
    "ROOF.example:443",
    socket.gethostname(),
    f"{socket.gethostname().partition('.')[0]}:8080",
]
OTHERS = [
    "evil.example",
    "evil.example:8080",
    "127.0.0.1.evil.example",
    "localhost.evil.example",
    "roof.example.evil.example",
    "evil-roof.example",
    "localhost@evil.example",
    "2130706433",
    "[::1",
    "localhost:8080:8080",
    "localhost:port",
    "[evil.example]",
    "x" * 5000,
]


@pytest.fixture
def named(make: Any) -> Made:  # noqa: ANN401 - a fixture that is a function
    made: Made = make(history="filled", allowed_hosts=("roof.example",), host="192.0.2.1")
    return made


def test_the_services_own_names_and_all_addresses_are_answered(named: Made) -> None:
    for host in OURS:
        assert named.client.get("/v1/calibration", headers={"host": host}).status_code == 200, host


def test_other_names_are_refused_wherever_they_ask(named: Made) -> None:
    for host in OTHERS:
        check_shape(named.client.get("/v1/calibration", headers={"host": host}), 421, "/v1/calibration")
    for path in ("/", "/v1/status", "/metrics", "/static/dashboard.js", "/openapi.json", "/readyz"):
        answer = named.client.get(path, headers={"host": OTHERS[0]})
        problem = check_shape(answer, 421, path)
        assert problem["type"] == "urn:sunarc:problem:misdirected"
        assert "api.allowed_hosts" in problem["errors"][0]["remedy"]
        assert answer.headers["x-content-type-options"] == "nosniff"


def test_the_probe_of_a_watchdog_is_answered_under_any_name(named: Made) -> None:
    assert named.client.get("/healthz", headers={"host": OTHERS[0]}).status_code == 200
    assert named.client.post("/healthz", headers={"host": OTHERS[0]}).status_code == 421


@pytest.mark.parametrize("names", [("http://roof.example",), ("roof.example:80",), ("",), ("a b",), ("x",) * 65])
def test_what_is_no_list_of_names_is_refused(names: tuple[str, ...]) -> None:
    with pytest.raises(InputError, match=r"api\.allowed_hosts"):
        ApiOptions(allowed_hosts=names)


def test_a_list_may_have_64_names() -> None:
    assert len(ApiOptions(allowed_hosts=("roof.example",) * 64).allowed_hosts) == 64
