"""Clients that send or read slowly keep nobody else out, and are served where they are steady. Over real sockets."""

from __future__ import annotations

import io
import json
import socket
import threading
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import httpx
import numpy as np
import pytest
import uvicorn
from tests.fixtures.served import LENS, NOON, document

from sunarc.imager.web.middleware.connection_limit import bound_connections
from sunarc.imager.web.options import ApiOptions
from sunarc.optics.camera import Camera

if TYPE_CHECKING:
    from tests.fixtures.served import Made

SMALL = replace(LENS, width=240, height=232, focal_length_px=(82.0, 82.0), principal_point_px=(119.6, 116.2))
NPY = "application/x-npy"
WITHIN_S = 1.0
PATIENCE_S = 20.0


@contextmanager
def serving(
    make: Any,  # noqa: ANN401 - a fixture that is a function
    *,
    camera: Camera = SMALL,
    send_buffer: int | None = None,
    **options: Any,  # noqa: ANN401 - of ApiOptions
) -> Iterator[int]:
    made: Made = make(**options)
    made.archive.calibrations.add(document("small", camera=camera))
    made.archive.calibrations.activate("small")
    with socket.create_server(("127.0.0.1", 0)) as listening:
        if send_buffer is not None:  # connections inherit it
            listening.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, send_buffer)
        config = uvicorn.Config(made.app, lifespan="off", log_level="error", forwarded_allow_ips="127.0.0.1")
        server = uvicorn.Server(bound_connections(config, ApiOptions(request_within_s=options["request_within_s"])))
        thread = threading.Thread(target=server.run, kwargs={"sockets": [listening]})
        thread.start()
        try:
            yield listening.getsockname()[1]
        finally:
            server.should_exit = True
            thread.join()


def rows(count: int) -> bytes:
    stream = io.BytesIO()
    np.save(stream, np.full((count, 2), 119.0))
    return stream.getvalue()


def head(path: str, length: int, *, client: str | None = None, kind: str = NPY) -> bytes:
    forwarded = "" if client is None else f"x-forwarded-for: {client}\r\n"
    about = f"{forwarded}content-type: {kind}\r\ncontent-length: {length}\r\n"
    return f"POST {path} HTTP/1.1\r\nhost: localhost\r\n{about}\r\n".encode()


def connect(port: int, *, receive_buffer: int | None = None) -> socket.socket:
    connection = socket.socket()
    if receive_buffer is not None:
        connection.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, receive_buffer)
    connection.settimeout(PATIENCE_S)
    connection.connect(("127.0.0.1", port))
    return connection


def read_all(connection: socket.socket) -> bytes:
    told = b""
    try:
        while more := connection.recv(1_000_000):
            told += more
    except ConnectionResetError:
        pass
    return told


def others_are_answered(port: int, **headers: str) -> None:
    with httpx.Client(base_url=f"http://127.0.0.1:{port}", timeout=PATIENCE_S, headers=headers) as client:
        bulk = client.post("/v1/back-project", content=rows(1000), headers={"content-type": NPY})
        assert (bulk.status_code, len(np.load(io.BytesIO(bulk.content)))) == (200, 1000)
        long = client.post("/v1/back-project", json={"pixels": [[119.0, 100.0]] * 2000})
        assert (long.status_code, len(long.json()["inside"])) == (200, 2000)
        for query in ({}, {"sun_radius_deg": "10", "at": NOON.isoformat()}):
            assert client.get("/v1/back-projection-map", params={"format": "npz", **query}).status_code == 200


def test_heads_without_bodies_keep_nobody_out(make: Any) -> None:  # noqa: ANN401 - a fixture that is a function
    with serving(make, request_within_s=30.0, max_large_at_once=2) as port, ExitStack() as stack:
        for _ in range(8):
            stack.enter_context(connect(port)).sendall(head("/v1/back-project", 1_000_000))
            json_head = head("/v1/project", 1_000_000, kind="application/json")
            stack.enter_context(connect(port)).sendall(json_head + b'{"direction_enu": [')
        begun_s = time.monotonic()  # noqa: TID251 - real sockets
        others_are_answered(port)
        assert time.monotonic() - begun_s < 25.0  # noqa: TID251 - real sockets


def test_readers_that_do_not_read_keep_nobody_out(make: Any) -> None:  # noqa: ANN401 - a fixture that is a function
    body = rows(300_000)  # 17 MB of answer: more than all buffers between them
    with serving(make, request_within_s=30.0, max_large_at_once=2) as port, ExitStack() as stack:
        for number in range(6):
            reader = stack.enter_context(connect(port, receive_buffer=4096))
            if number % 2:
                reader.sendall(head("/v1/back-project", len(body)) + body)
            else:
                query = f"format=npz&sun_radius_deg={10 + number}&at=2013-05-13T18:3{number}:00Z"
                reader.sendall(f"GET /v1/back-projection-map?{query} HTTP/1.1\r\nhost: localhost\r\n\r\n".encode())
            assert reader.recv(12) == b"HTTP/1.1 200"
        begun_s = time.monotonic()  # noqa: TID251 - real sockets
        others_are_answered(port)
        assert time.monotonic() - begun_s < 25.0  # noqa: TID251 - real sockets


def test_an_address_that_fills_the_memory_gives_way_to_another(make: Any) -> None:  # noqa: ANN401 - a fixture that is a function
    length = 10_000_000
    with (
        serving(make, request_within_s=30.0, max_large_at_once=1, max_array_bytes=length) as port,
        ExitStack() as stack,
    ):
        greedy = []
        for _ in range(4):  # together nearly all that requests may hold
            connection = stack.enter_context(connect(port))
            connection.sendall(head("/v1/back-project", length, client="192.0.2.66") + bytes(length - 1000))
            greedy.append(connection)
        time.sleep(0.5)  # noqa: TID251 - until it is read
        with httpx.Client(base_url=f"http://127.0.0.1:{port}", timeout=PATIENCE_S) as client:
            headers = {"content-type": NPY, "x-forwarded-for": "192.0.2.7"}
            assert client.post("/v1/back-project", content=rows(200_000), headers=headers).status_code == 200
        refusal = read_all(greedy[0])
        assert refusal.startswith(b"HTTP/1.1 503")
        assert json.loads(refusal.partition(b"\r\n\r\n")[2])["errors"][0]["field"] == "request"
        greedy[3].sendall(bytes(1000))  # the youngest one is still read to its end
        assert greedy[3].recv(12) == b"HTTP/1.1 422"


def test_a_body_that_comes_slowly_but_steadily_is_read(make: Any) -> None:  # noqa: ANN401 - a fixture that is a function
    body = rows(2_000)
    with serving(make, request_within_s=WITHIN_S) as port, connect(port) as connection:
        connection.sendall(head("/v1/back-project", len(body)))
        step = 2_200  # three times the lowest rate, and three times as long as a body may stand still
        for begin in range(0, len(body), step):
            connection.sendall(body[begin : begin + step])
            time.sleep(0.2)  # noqa: TID251 - real sockets
        assert connection.recv(12) == b"HTTP/1.1 200"


@pytest.mark.parametrize("trickle", [0, 50], ids=["stalled", "trickling"])
def test_a_body_that_stalls_or_trickles_is_refused(make: Any, trickle: int) -> None:  # noqa: ANN401 - a fixture that is a function
    with serving(make, request_within_s=WITHIN_S) as port, connect(port) as connection:
        connection.sendall(head("/v1/back-project", 10**6) + bytes(100_000))  # fast at first: that buys no time
        begun_s = time.monotonic()  # noqa: TID251 - real sockets
        for _ in range(8 if trickle else 0):
            connection.sendall(bytes(trickle))
            time.sleep(0.15)  # noqa: TID251 - real sockets
        told = read_all(connection)
        assert told.startswith(b"HTTP/1.1 408")
        assert b"connection: close" in told
        assert 0.8 * WITHIN_S < time.monotonic() - begun_s < 6.0 * WITHIN_S  # noqa: TID251 - real sockets


def test_a_map_that_is_read_steadily_comes_whole(make: Any) -> None:  # noqa: ANN401 - a fixture that is a function
    with serving(make, request_within_s=0.5) as port, connect(port, receive_buffer=8192) as connection:
        connection.sendall(
            b"GET /v1/back-projection-map?format=npz HTTP/1.1\r\nhost: localhost\r\nconnection: close\r\n\r\n"
        )
        told = b""
        begun_s = time.monotonic()  # noqa: TID251 - real sockets
        while more := connection.recv(40_000):
            told += more
            time.sleep(0.02)  # noqa: TID251 - real sockets
        assert time.monotonic() - begun_s > 1.0  # noqa: TID251 - real sockets: twice as long as it may stand still
    headers, _, content = told.partition(b"\r\n\r\n")
    length = int(headers.lower().split(b"content-length: ")[1].split(b"\r\n")[0])
    assert len(content) == length > 500_000
