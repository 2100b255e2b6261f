"""Requests of the client against a scripted server on loopback: what is sent, what is asked again, what is refused."""

from __future__ import annotations

import io
import json
import socket
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from datetime import UTC, datetime, timedelta, timezone
from http.server import BaseHTTPRequestHandler, HTTPServer

import numpy as np
import pytest

from sunarc.client import Imager, ImagerError, transport
from sunarc.client.transport import Transport, retry_wait_s
from sunarc.imager.runtime.clock import SystemClock

Answer = tuple[int, dict[str, str], bytes]
OK: Answer = (200, {}, b'{"azimuth": 1.0}')


def busy(status: int = 503, **headers: str) -> Answer:
    return (status, {name.replace("_", "-"): value for name, value in headers.items()}, b'{"detail": "busy"}')


class ScriptedServer(HTTPServer):
    """Answers one request after the other as listed, and keeps what was asked."""

    def __init__(self) -> None:
        super().__init__(("127.0.0.1", 0), _Handler)
        self.answers: list[Answer] = []
        self.asked: list[tuple[str, str, dict[str, str], bytes]] = []

    @property
    def address(self) -> str:
        return f"http://127.0.0.1:{self.server_port}"


@contextmanager
def dripping(*, first: bytes, drop: bytes, every_s: float, n_drops: int) -> Iterator[str]:
    """Serve one connection with a beginning of an answer, and drops of its rest."""
    with socket.create_server(("127.0.0.1", 0)) as listening:
        ended = threading.Event()

        def serve() -> None:
            channel, _ = listening.accept()
            with channel, suppress(OSError):
                channel.recv(65_536)
                channel.sendall(first)
                for _ in range(n_drops):
                    if ended.wait(every_s):
                        return
                    channel.sendall(drop)

        thread = threading.Thread(target=serve)
        thread.start()
        try:
            yield f"http://127.0.0.1:{listening.getsockname()[1]}"
        finally:
            ended.set()
            thread.join()


CLOCK = SystemClock()
HEAD = b"HTTP/1.1 200 OK\r\nContent-Type: application/json\r\n"


@pytest.mark.parametrize(
    ("first", "drop"),
    [(HEAD + b"X-Long: ", b"x"), (HEAD + b"Content-Length: 100000\r\n\r\n", b" "), (HEAD + b"\r\n", b" ")],
    ids=["head", "body", "body without end"],
)
def test_a_server_that_drips_is_cut_off_in_the_time_of_one_request(first: bytes, drop: bytes) -> None:
    with dripping(first=first, drop=drop, every_s=0.05, n_drops=400) as address:
        imager = Imager(address, timeout_s=0.5, retries=0)
        begun_s = CLOCK.monotonic()
        with pytest.raises(ImagerError) as caught:
            imager.sun()
        assert CLOCK.monotonic() - begun_s < 10.0  # dripping takes 20 s
    assert caught.value.status is None


def test_a_steady_answer_may_take_longer_than_the_time_of_one_request() -> None:
    first = HEAD + b"Content-Length: 40000\r\n\r\n"
    content = b'{"azimuth": 1.0}'.ljust(4000)
    with (
        dripping(first=first, drop=content, every_s=0.1, n_drops=10) as address,
        pytest.raises(ImagerError, match="cannot be read"),  # ten objects are no JSON: all of it came
    ):
        Imager(address, timeout_s=0.5, retries=0).sun()


def test_an_answer_that_is_too_long_or_cut_off_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(transport, "_MOST_BYTES", 1000)
    for first in (HEAD + b"\r\n" + b" " * 1001, HEAD + b"Content-Length: 10\r\n\r\n{}"):
        with dripping(first=first, drop=b"", every_s=0.0, n_drops=0) as address:
            with pytest.raises(ImagerError) as caught:
                Imager(address, timeout_s=5.0, retries=0).sun()
            assert caught.value.status is None


class _Handler(BaseHTTPRequestHandler):
    server: ScriptedServer

    def do_GET(self) -> None:
        body = self.rfile.read(int(self.headers.get("Content-Length", "0")))
        self.server.asked.append((self.command, self.path, dict(self.headers), body))
        status, headers, content = self.server.answers.pop(0)
        self.send_response(status)
        for name, value in ({"Content-Length": str(len(content))} | headers).items():
            self.send_header(name, value)
        self.end_headers()
        self.wfile.write(content)

    def do_POST(self) -> None:
        self.do_GET()

    def log_message(self, *_: object) -> None:
        pass


@contextmanager
def running_server() -> Iterator[ScriptedServer]:
    with ScriptedServer() as running:
        thread = threading.Thread(target=running.serve_forever, kwargs={"poll_interval": 0.01})
        thread.start()
        yield running
        running.shutdown()
        thread.join()


@pytest.fixture
def server() -> Iterator[ScriptedServer]:
    with running_server() as running:
        yield running


@pytest.fixture
def waits(monkeypatch: pytest.MonkeyPatch) -> list[float]:
    """Return the waits between attempts, which take no time."""
    found: list[float] = []
    monkeypatch.setattr("sunarc.client.transport.time.sleep", found.append)
    return found


def rows_answer(rows: object, **headers: str) -> Answer:
    stream = io.BytesIO()
    np.save(stream, np.asarray(rows, dtype=np.float64))
    return (200, {"Sunarc-Calibration": "second"} | headers, stream.getvalue())


@pytest.mark.parametrize("status", [429, 503])
def test_a_busy_service_is_asked_again(server: ScriptedServer, waits: list[float], status: int) -> None:
    server.answers = [busy(status), busy(status), OK]
    assert Imager(server.address).sun() == {"azimuth": 1.0}
    assert waits == [0.25, 0.5]


@pytest.mark.parametrize("status", [400, 401, 403, 404, 409, 422, 500, 502, 504])
def test_any_other_refusal_is_final(server: ScriptedServer, waits: list[float], status: int) -> None:
    server.answers = [busy(status), OK]
    with pytest.raises(ImagerError) as refused:
        Imager(server.address).sun()
    assert (refused.value.status, waits, len(server.asked)) == (status, [], 1)


def test_the_last_refusal_is_raised_when_the_retries_are_used_up(server: ScriptedServer, waits: list[float]) -> None:
    server.answers = [busy(503), busy(429), OK]
    with pytest.raises(ImagerError) as refused:
        Imager(server.address, retries=1).sun()
    assert (refused.value.status, len(waits)) == (429, 1)


def test_the_services_own_wait_is_kept(server: ScriptedServer, waits: list[float]) -> None:
    server.answers = [busy(429, Retry_After="3"), OK]
    Imager(server.address).sun()
    assert waits == [3.0]


@pytest.mark.parametrize(
    ("stated", "attempt", "wait_s"),
    [
        ("3", 0, 3.0),
        ("0", 3, 0.0),
        ("600", 0, 10.0),
        (None, 2, 1.0),
        (None, 9, 10.0),
        ("soon", 1, 0.5),
        ("-5", 0, 0.25),
    ],
)
def test_the_wait_doubles_up_to_ten_seconds_unless_one_is_stated(
    stated: str | None, attempt: int, wait_s: float
) -> None:
    error = ImagerError("busy", status=503, problem={"retry_after_s": stated})
    assert retry_wait_s(error, attempt) == wait_s


def test_a_request_carries_the_token_and_the_query(server: ScriptedServer) -> None:
    server.answers = [OK]
    at = datetime(2013, 5, 13, 20, 30, tzinfo=timezone(timedelta(hours=2)))
    Imager(server.address + "/", token="secret", camera="the roof/1").sun(at=at)  # noqa: S106 - a test's
    ((method, path, headers, _),) = server.asked
    assert (method, path) == ("GET", "/v1/cameras/the%20roof%2F1/sun?at=2013-05-13T20%3A30%3A00%2B02%3A00")
    assert headers["Authorization"] == "Bearer secret"


def test_without_a_token_none_is_sent(server: ScriptedServer) -> None:
    server.answers = [OK]
    Imager(server.address).sun()
    assert "Authorization" not in server.asked[0][2]


def test_arrays_are_sent_as_rows_of_doubles(server: ScriptedServer) -> None:
    server.answers = [rows_answer(np.zeros((4, 7)))]
    pixels = np.arange(8, dtype=np.float32).reshape(2, 2, 2)[:, ::-1]
    answer = Imager(server.address).back_project(pixels)
    ((method, _, headers, body),) = server.asked
    sent = np.load(io.BytesIO(body), allow_pickle=False)
    assert (method, headers["Content-Type"], sent.dtype) == ("POST", "application/x-npy", np.float64)
    np.testing.assert_array_equal(sent, pixels.reshape(4, 2))
    assert (answer.zenith_deg.shape, answer.calibration) == ((2, 2), "second")


def test_columns_of_a_projection_are_told_apart(server: ScriptedServer) -> None:
    server.answers = [rows_answer([[1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 1.0]])]
    found = Imager(server.address).project([0.0, 0.0, 1.0])
    assert found.pixels.tolist() == [1.0, 2.0]
    assert float(found.sigma_px) == 3.0
    assert found.covariance_px2.tolist() == [[4.0, 5.0], [5.0, 6.0]]
    assert bool(found.inside)


def test_columns_of_a_place_are_told_apart(server: ScriptedServer) -> None:
    server.answers = [rows_answer([np.arange(20.0)])]
    cloud, shadow = Imager(server.address).geolocate([[5.0, 6.0]], height_m=1000.0)
    np.testing.assert_array_equal(np.load(io.BytesIO(server.asked[0][3])), [[5.0, 6.0, 1000.0]])
    for first, place in ((0.0, cloud), (10.0, shadow)):
        assert place.position_m.tolist() == [[first, first + 1.0, first + 2.0]]
        scalars = [place.latitude, place.longitude, place.altitude, place.sigma_m]
        assert [float(value[0]) for value in scalars] == [first + 3.0 + k for k in range(4)]
        assert place.covariance_m2[0].tolist() == [[first + 7.0, first + 8.0], [first + 8.0, first + 9.0]]


def test_no_pixels_are_no_answer_of_any_kind(server: ScriptedServer) -> None:
    server.answers = [rows_answer(np.zeros((0, 7)))]
    assert Imager(server.address).back_project(np.zeros((0, 2))).direction.shape == (0, 3)


@pytest.mark.parametrize("body", [b"", b"<html>", b"[1, 2]", b'"busy"', b"\xff"])
def test_a_refusal_without_a_problem_document_is_still_a_refusal(server: ScriptedServer, body: bytes) -> None:
    server.answers = [(502, {}, body)]
    with pytest.raises(ImagerError) as refused:
        Imager(server.address).sun()
    assert refused.value.status == 502


def test_a_refusal_whose_body_is_cut_is_still_a_refusal(server: ScriptedServer) -> None:
    server.answers = [(502, {"Content-Length": "100", "Connection": "close"}, b'{"det')]
    with pytest.raises(ImagerError) as refused:
        Imager(server.address).sun()
    assert refused.value.status == 502


def test_an_answer_that_is_cut_is_asked_for_again(server: ScriptedServer, waits: list[float]) -> None:
    server.answers = [(200, {"Content-Length": "100", "Connection": "close"}, b'{"azi'), OK]
    assert Imager(server.address).sun() == {"azimuth": 1.0}
    assert len(waits) == 1


@pytest.mark.parametrize("body", [b"<html>", b"", b"\xff\xfe"])
def test_an_answer_of_something_else_is_an_error_of_the_client(server: ScriptedServer, body: bytes) -> None:
    imager = Imager(server.address)
    server.answers = [(200, {}, body)] * 3
    for ask in (imager.sun, imager.map, lambda: imager.back_project([1.0, 2.0])):
        with pytest.raises(ImagerError) as refused:
            ask()
        assert refused.value.status == 200


def test_rows_without_the_name_of_their_calibration_are_an_error(server: ScriptedServer) -> None:
    status, _, content = rows_answer(np.zeros((1, 7)))
    server.answers = [(status, {}, content)]
    with pytest.raises(ImagerError):
        Imager(server.address).back_project([1.0, 2.0])


def test_a_service_that_never_answers_is_an_error_after_the_time_out() -> None:
    with socket.create_server(("127.0.0.1", 0)) as silent:
        imager = Imager(f"http://127.0.0.1:{silent.getsockname()[1]}", timeout_s=0.05, retries=0)
        with pytest.raises(ImagerError) as refused:
            imager.sun()
    assert refused.value.status is None


@pytest.mark.parametrize("address", ["imager:8080", "ftp://imager", "", "file:///etc/passwd"])
def test_an_address_that_is_none_is_refused_at_once(address: str) -> None:
    with pytest.raises(ValueError, match="address"):
        Transport(address, token=None, timeout_s=1.0, retries=0)


def test_a_problem_document_is_handed_on(server: ScriptedServer) -> None:
    problem = {"detail": "no such calibration", "errors": [{"field": "at", "remedy": "name a time"}]}
    server.answers = [(404, {}, json.dumps(problem).encode())]
    with pytest.raises(ImagerError) as refused:
        Imager(server.address).calibration(at=datetime(2013, 5, 13, tzinfo=UTC))
    assert {name: refused.value.problem[name] for name in problem} == problem


@pytest.mark.parametrize("status", [301, 302, 303, 307, 308])
def test_the_token_is_not_sent_to_where_a_redirect_leads(server: ScriptedServer, status: int) -> None:
    with running_server() as other:
        other.answers = [OK]
        server.answers = [(status, {"Location": f"{other.address}/v1/sun"}, b"")]
        transport = Transport(server.address, token="secret", timeout_s=5.0, retries=2)  # noqa: S106 - of a test
        with pytest.raises(ImagerError) as refused:
            transport.ask("/v1/sun", {})
        assert refused.value.status == status
        assert other.address in str(refused.value)
        assert (len(server.asked), other.asked) == (1, [])
