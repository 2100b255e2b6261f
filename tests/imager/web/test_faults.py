"""A fault of the service is answered, and told once; an address that a proxy garbles is the proxy's fault."""

from __future__ import annotations

import logging
import re
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import pytest
from starlette.types import Receive, Scope, Send
from tests.imager.web.test_problems import check_shape
from uvicorn.middleware.proxy_headers import ProxyHeadersMiddleware

from sunarc.imager.web.middleware.boundary import Boundary
from sunarc.imager.web.middleware.shared_quota import client_network
from sunarc.imager.web.problems import FaultLog

if TYPE_CHECKING:
    from tests.fixtures.served import Made

GARBLED = [
    "foo:bar",
    "foo",
    "unknown",
    "[::1",
    "1.2.3.4.5",
    "[::ffff:999.0.0.1]:80",
    "fe80::1%",
    "1.2.3.4:x",
    "_hidden",
]


@pytest.mark.parametrize("forwarded", GARBLED)
def test_a_client_that_a_proxy_garbles_is_refused_and_no_fault(
    make: Any,  # noqa: ANN401 - a fixture that is a function
    forwarded: str,
) -> None:
    made: Made = make(history="filled")
    behind = type(made.client)(ProxyHeadersMiddleware(made.app, ["127.0.0.1", "::1"]))  # type: ignore[arg-type]
    headers = {"x-forwarded-for": forwarded}
    for method, path in (("GET", "/v1/sun"), ("POST", "/v1/back-project"), ("POST", "/healthz")):
        problem = check_shape(behind.request(method, path, headers=headers), 400, path)
        assert problem["errors"][0]["field"] == "x-forwarded-for"
    assert behind.get("/healthz", headers=headers).status_code == 200


@pytest.mark.parametrize(
    "forwarded", ["192.0.2.7", "192.0.2.7:4711", "[2001:db8::1]:80", "foo, 192.0.2.7", "127.0.0.1"]
)
def test_an_address_that_a_proxy_forwards_is_taken(made: Made, forwarded: str) -> None:
    behind = type(made.client)(ProxyHeadersMiddleware(made.app, ["127.0.0.1", "::1"]))  # type: ignore[arg-type]
    assert behind.get("/v1/sun", headers={"x-forwarded-for": forwarded}).status_code == 200


@pytest.mark.parametrize(
    ("host", "network"),
    [
        ("127.0.0.1", None),
        ("127.9.9.9", None),
        ("::1", None),
        ("::ffff:127.0.0.1", None),
        ("192.0.2.7", "192.0.2.7"),
        ("::ffff:192.0.2.7", "192.0.2.7"),
        ("2001:db8:0:1:ffff::9", "2001:db8:0:1::"),
        ("2001:DB8:0:1::", "2001:db8:0:1::"),
        ("fe80::1%eth0", "fe80::"),
    ],
)
def test_a_client_is_an_address_or_a_network_of_ipv6(host: str, network: str | None) -> None:
    assert client_network({"type": "http", "client": (host, 1)}) == network


def failing(error: BaseException) -> Callable[..., Any]:
    async def app(_scope: Scope, _receive: Receive, _send: Send) -> None:
        raise error

    return app


@pytest.mark.parametrize("error", [RecursionError("deep"), MemoryError(), ZeroDivisionError("x")])
def test_the_stack_of_a_fault_is_logged_once_and_its_repeats_are_counted(
    caplog: pytest.LogCaptureFixture, error: Exception
) -> None:
    def raise_it() -> None:
        raise error

    log = FaultLog()
    names = set()
    for at_s in (0.0, 1.0, 2.0, 299.0, 301.0, 302.0, 700.0):
        try:
            raise_it()
        except type(error) as raised:
            names.add(log.record(raised, request=f"GET /{at_s}", now_s=at_s))
            error.__traceback__ = None
    told = [(bool(record.exc_info), record.getMessage()) for record in caplog.records]
    assert [stack for stack, _ in told] == [True, False, False]
    assert "(3 more since" in told[1][1]
    assert "(1 more since" in told[2][1]
    (name,) = names
    assert all(name in text for _, text in told)


def test_faults_of_other_lines_have_stacks_of_their_own_and_the_memory_of_them_is_bounded(
    caplog: pytest.LogCaptureFixture,
) -> None:
    log = FaultLog()
    kinds = [type(f"Fault{number}Error", (Exception,), {}) for number in range(300)]
    with caplog.at_level(logging.ERROR):
        for kind in kinds:
            log.record(kind(), request="GET /", now_s=0.0)
    assert sum(bool(record.exc_info) for record in caplog.records) == 300
    assert len(log._kinds) == 256


def test_a_fault_is_one_answer_with_the_name_that_the_log_has(
    made: Made, caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(*_: object, **__: object) -> None:
        raise ZeroDivisionError("a bug")

    monkeypatch.setattr(type(made.archive.events), "find", fail)
    made.client._transport.raise_app_exceptions = True  # what reaches the server is written by it once more
    details = {made.client.get("/v1/events").json()["detail"] for _ in range(20)}
    (detail,) = details
    name = re.findall(r"fault (\w{8})$", detail)[0]
    assert [record.exc_info is not None for record in caplog.records if name in record.getMessage()] == [True]
    assert caplog.text.count("Traceback") == 1


@pytest.mark.parametrize("error", [RecursionError("deep"), MemoryError()])
def test_a_fault_of_what_stands_before_the_routes_is_answered_too(made: Made, error: Exception) -> None:
    guard = Boundary(failing(error), max_body_bytes=1, max_array_bytes=1, faults=FaultLog())
    guarded = type(made.client)(guard)  # type: ignore[arg-type]
    check_shape(guarded.get("/v1/sun"), 500, "/v1/sun")
