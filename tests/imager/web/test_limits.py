from __future__ import annotations

import asyncio
import socket
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import TYPE_CHECKING, Any, cast

import httpx
import pytest
import uvicorn
from starlette.types import ASGIApp, Receive, Scope, Send
from tests.imager.web.test_problems import check_shape

from sunarc.imager.web.middleware.admission import TokenBuckets
from sunarc.imager.web.middleware.connection_limit import bound_connections
from sunarc.imager.web.middleware.request_bodies import Occupancy
from sunarc.imager.web.middleware.shared_quota import SharedQuota
from sunarc.imager.web.options import ApiOptions

if TYPE_CHECKING:
    from tests.fixtures.served import Made

AWAY = "192.0.2.7"


def test_a_bucket_holds_a_burst_and_fills_steadily() -> None:
    allowances = TokenBuckets(per_s=2.0, burst=3)
    assert [allowances.take("a", 1.0, now_s=0.0) for _ in range(4)] == [0.0, 0.0, 0.0, 0.5]
    assert allowances.take("b", 1.0, now_s=0.0) == 0.0
    assert allowances.take("a", 1.0, now_s=0.49) > 0.0
    assert allowances.take("a", 1.0, now_s=0.51) == 0.0
    assert [allowances.take("a", 1.0, now_s=1e6) for _ in range(4)][:3] == [0.0, 0.0, 0.0]


def test_the_memory_of_clients_is_bounded() -> None:
    allowances = TokenBuckets(per_s=1.0, burst=1)
    for number in range(20_000):
        allowances.take(str(number), 1.0, now_s=0.0)
    assert len(allowances._buckets) == 4096
    assert allowances.take("19999", 1.0, now_s=0.0) > 0.0


def test_who_asks_too_much_is_told_when_to_come_back(make: Any) -> None:  # noqa: ANN401 - a fixture that is a function
    made: Made = make(requests_per_s=0.02, burst=3)  # so slow that a busy host adds nothing meanwhile
    statuses = [made.client_at(AWAY).get("/v1/days").status_code for _ in range(4)]
    assert statuses == [200, 200, 200, 429]
    answer = made.client_at(AWAY).get("/v1/days")
    check_shape(answer, 429, "/v1/days")
    assert 30 <= int(answer.headers["retry-after"]) <= 50
    assert made.client_at("192.0.2.8").get("/v1/days").status_code == 200
    assert made.client_at(AWAY).get("/healthz").status_code == 200


def test_a_network_of_ipv6_counts_as_one_client_and_the_host_itself_not_at_all(make: Any) -> None:  # noqa: ANN401 - a fixture that is a function
    made: Made = make(requests_per_s=0.001, burst=2)
    addresses = [f"2001:db8::{number:x}" for number in range(1, 4)]
    assert [made.client_at(one).get("/v1/days").status_code for one in addresses] == [200, 200, 429]
    for address in ("127.0.0.1", "::1"):
        assert {made.client_at(address).get("/v1/days").status_code for _ in range(5)} == {200}


WRONG = {"authorization": "Bearer wrong wrong wrong wrong"}


def test_guessing_tokens_uses_up_what_a_client_may_ask(make: Any) -> None:  # noqa: ANN401 - a fixture that is a function
    made: Made = make(requests_per_s=0.001, burst=100)
    statuses = [made.client_at(AWAY).post("/v1/refits", headers=WRONG).status_code for _ in range(6)]
    assert statuses == [401, 401, 401, 401, 401, 429]


def test_a_wrong_token_costs_twenty_requests_in_the_long_run(make: Any) -> None:  # noqa: ANN401 - a fixture that is a function
    made: Made = make(requests_per_s=100.0, burst=40)
    begun_s = time.monotonic()  # noqa: TID251 - the limit goes by real time
    statuses = [made.client_at(AWAY).post("/v1/refits", headers=WRONG).status_code for _ in range(200)]
    lasted_s = time.monotonic() - begun_s  # noqa: TID251 - the limit goes by real time
    assert statuses.count(401) + statuses.count(429) == 200
    assert 2 <= statuses.count(401) <= 3 + lasted_s * 100.0 / 20.0


def test_guesses_at_once_cost_as_much_as_one_after_the_other_and_a_network_of_ipv6_as_one_client(make: Any) -> None:  # noqa: ANN401 - a fixture that is a function
    made: Made = make(requests_per_s=0.001, burst=100)

    async def guess(number: int) -> int:
        transport = httpx.ASGITransport(made.app, client=(f"2001:db8::{number:x}", 1))
        async with httpx.AsyncClient(transport=transport, base_url="http://imager") as client:
            return (await client.post("/v1/refits", headers=WRONG)).status_code

    async def guessing() -> list[int]:
        return list(await asyncio.gather(*(guess(number) for number in range(50))))

    assert asyncio.run(guessing()).count(401) == 5


def test_after_a_wrong_token_the_right_one_waits_too(make: Any) -> None:  # noqa: ANN401 - a fixture that is a function
    made: Made = make(requests_per_s=0.01, burst=1)
    assert made.client_at(AWAY).post("/v1/refits", headers=WRONG).status_code == 401
    refused = made.client_at(AWAY).post("/v1/refits", headers=made.bearer)
    assert refused.status_code == 429
    assert 1900 <= int(refused.headers["retry-after"]) <= 2000


def test_a_token_that_is_not_asked_for_costs_nothing_more(make: Any) -> None:  # noqa: ANN401 - a fixture that is a function
    made: Made = make(requests_per_s=0.001, burst=30)
    statuses = [made.client_at(AWAY).get("/v1/days", headers=WRONG).status_code for _ in range(31)]
    assert statuses == [200] * 30 + [429]
    right: Made = make(requests_per_s=0.001, burst=3)
    statuses = [right.client_at(AWAY).get("/v1/days", headers=right.bearer).status_code for _ in range(4)]
    assert statuses == [200, 200, 200, 429]


def limit_at_once(app: ASGIApp, at_once: int) -> Occupancy:
    return Occupancy(app, max_body_bytes=1, max_array_bytes=1, within_s=1.0, quota=SharedQuota(1), at_once=at_once)


def test_more_at_once_than_can_be_answered_is_refused() -> None:
    gate, told = asyncio.Event(), []

    async def slow(_scope: Scope, _receive: Receive, send: Send) -> None:
        await gate.wait()
        await send({"type": "http.response.start", "status": 200, "headers": []})

    async def asking() -> None:
        limits = limit_at_once(slow, 2)

        async def send(message: Any) -> None:  # noqa: ANN401 - of ASGI
            if message["type"] == "http.response.start":
                told.append(message["status"])

        def ask(client: str) -> asyncio.Task[None]:
            scope = {"type": "http", "path": "/v1/sun", "method": "GET", "headers": [], "client": (client, 1)}
            return asyncio.create_task(limits(scope, cast("Receive", None), send))

        waiting = [ask(AWAY), ask("192.0.2.8")]
        await asyncio.sleep(0)
        await ask("192.0.2.9")
        assert told == [503]
        gate.set()
        await asyncio.gather(*waiting)
        await ask(AWAY)

    asyncio.run(asking())
    assert told == [503, 200, 200, 200]


def test_an_address_that_has_most_of_what_is_answered_at_once_gives_way() -> None:
    gate, told = asyncio.Event(), []

    async def slow(_scope: Scope, _receive: Receive, send: Send) -> None:
        await gate.wait()
        await send({"type": "http.response.start", "status": 200, "headers": []})

    async def asking() -> None:
        limits = limit_at_once(slow, 6)

        def ask(client: str) -> asyncio.Task[None]:
            async def send(message: Any) -> None:  # noqa: ANN401 - of ASGI
                if message["type"] == "http.response.start":
                    told.append((client, int(message["status"])))

            scope = {"type": "http", "path": "/v1/sun", "method": "GET", "headers": [], "client": (client, 1)}
            return asyncio.create_task(limits(scope, cast("Receive", None), send))

        waiting = []
        for client in [AWAY] * 7 + ["192.0.2.8"] * 3 + ["127.0.0.1"]:
            waiting.append(ask(client))
            for _ in range(10):
                await asyncio.sleep(0)
        # its seventh is refused; three of its six give way; then both have three, and the host takes one of the older's
        assert told == [(AWAY, 503)] * 4 + [(AWAY, 503)]
        gate.set()
        await asyncio.gather(*waiting)
        assert not limits._under_way._of_client

    asyncio.run(asking())
    assert [status for _, status in told].count(200) == 6


async def _large(scope: Scope, _receive: Receive, send: Send) -> None:
    """Answer at once, or with more than any buffer holds."""
    if scope["type"] != "http":
        return
    size = 50_000_000 if scope["path"] == "/large" else 2
    await send({"type": "http.response.start", "status": 200, "headers": [(b"content-length", str(size).encode())]})
    await send({"type": "http.response.body", "body": b"x" * size})


@contextmanager
def serving(**options: Any) -> Iterator[tuple[uvicorn.Server, int]]:  # noqa: ANN401 - of ApiOptions
    with socket.create_server(("127.0.0.1", 0)) as listening:
        config = uvicorn.Config(_large, lifespan="off", log_level="error", timeout_keep_alive=60)
        server = uvicorn.Server(bound_connections(config, ApiOptions(**options)))
        thread = threading.Thread(target=server.run, kwargs={"sockets": [listening]})
        thread.start()
        try:
            yield server, listening.getsockname()[1]
        finally:
            server.should_exit = True
            thread.join()


def connect(port: int, *, receive_buffer: int | None = None) -> socket.socket:
    connection = socket.socket()
    connection.settimeout(10.0)
    if receive_buffer is not None:
        connection.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, receive_buffer)
    connection.connect(("127.0.0.1", port))
    return connection


def ask(connection: socket.socket, path: str = "/") -> bytes:
    connection.sendall(f"GET {path} HTTP/1.1\r\nhost: x\r\n\r\n".encode())
    return connection.recv(12)


def ended(connection: socket.socket) -> bool:
    try:
        return connection.recv(1) == b""
    except ConnectionResetError:
        return True


@pytest.mark.parametrize("head", [b"", b"GET / HTTP/1.1\r\nhost:"])
def test_a_head_that_does_not_come_is_not_waited_for(head: bytes) -> None:
    with serving(request_within_s=0.3) as (_, port), connect(port) as connection:
        connection.sendall(head)
        assert ended(connection)


def test_a_connection_that_asks_in_time_stays_open() -> None:
    with serving(request_within_s=0.3) as (_, port), connect(port) as connection:
        assert ask(connection) == b"HTTP/1.1 200"
        threading.Event().wait(0.6)
        connection.recv(1000)
        assert ask(connection) == b"HTTP/1.1 200"


@pytest.mark.parametrize("begun", [b"G", b"GET / HTTP/1.1\r\nhost:"])
def test_the_next_head_on_a_connection_is_not_waited_for_either(begun: bytes) -> None:
    with serving(request_within_s=0.3) as (_, port), connect(port) as connection:
        for _ in range(2):
            assert ask(connection) == b"HTTP/1.1 200"
            threading.Event().wait(0.05)
            connection.recv(1000)
        connection.sendall(begun)
        begun_s = time.monotonic()  # noqa: TID251 - a real connection
        assert ended(connection)
        assert 0.2 < time.monotonic() - begun_s < 3.0  # noqa: TID251 - a real connection


def test_an_answer_that_is_read_steadily_is_not_cut_and_one_that_stands_still_is() -> None:
    with serving(request_within_s=0.4) as (_, port), connect(port, receive_buffer=65_536) as connection:
        connection.sendall(b"GET /large HTTP/1.1\r\nhost: x\r\n\r\n")
        answer = connection.makefile("rb")
        for _ in range(60):  # 12 MB, more than all buffers, in eight times as long as it may stand still
            assert len(answer.read(200_000)) == 200_000
            threading.Event().wait(0.05)
        threading.Event().wait(2.0)
        taken = 12_000_000
        with suppress(ConnectionResetError):
            while more := answer.read(100_000):
                taken += len(more)
        assert taken < 45_000_000


def test_an_answer_that_is_not_taken_is_given_up() -> None:
    with serving(request_within_s=0.3) as (server, port), connect(port) as connection:
        assert ask(connection, "/large") == b"HTTP/1.1 200"
        for _ in range(50):
            if not server.server_state.connections:
                break
            threading.Event().wait(0.1)
        assert not server.server_state.connections


def test_of_too_many_connections_the_longest_idle_one_makes_room() -> None:
    with serving(max_connections=5) as (server, port):
        idle = [connect(port) for _ in range(20)]
        with connect(port) as last:
            assert ask(last) == b"HTTP/1.1 200"
            assert len(server.server_state.connections) <= 5
            assert ended(idle[0])
            for connection in idle:
                connection.close()


def test_what_is_no_http_is_refused_in_the_shape_of_all_refusals() -> None:
    with serving() as (_, port), connect(port) as connection:
        connection.sendall(b"nonsense\r\n\r\n")
        told = b""
        while more := connection.recv(4096):
            told += more
    assert told.startswith(b"HTTP/1.1 400")
    assert b"application/problem+json" in told
    assert b"urn:sunarc:problem:malformed" in told
