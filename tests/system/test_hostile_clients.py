"""The service among clients that mean ill: what they want is refused, its memory stays flat, others are answered."""

from __future__ import annotations

import http.client
import json
import resource
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest

pytestmark = [pytest.mark.system, pytest.mark.timeout(170)]

TOKEN = "the token of this test alone"  # noqa: S105 - of the test alone
CONFIG = """\
name = "roof"
state = "{state}"
[site]
latitude = 36.6
longitude = -97.5
altitude = 318.0
[camera]
address = "127.0.0.9"
[api]
port = {port}
token_file = "{token}"
"""
GIGABYTE = 1 << 30
MEGABYTE = 1 << 20


@dataclass(frozen=True)
class Running:
    port: int
    process: subprocess.Popen[bytes]
    log: Path

    def get(self, path: str) -> int:
        connection = http.client.HTTPConnection("127.0.0.1", self.port, timeout=20.0)
        try:
            connection.putrequest("GET", path, skip_accept_encoding=True)
            connection.endheaders()
            with connection.getresponse() as answer:
                return answer.status
        finally:
            connection.close()

    def memory_bytes(self) -> int:
        status = Path(f"/proc/{self.process.pid}/status").read_text()
        return int(status.split("VmRSS:")[1].split()[0]) * 1024

    def open_files(self) -> int:
        return len(list(Path(f"/proc/{self.process.pid}/fd").iterdir()))


@pytest.fixture(scope="module")
def running(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Running]:
    folder = tmp_path_factory.mktemp("hostile")
    with socket.socket() as trial:
        trial.bind(("127.0.0.1", 0))
        port = int(trial.getsockname()[1])
    (folder / "token").write_text(TOKEN)
    (folder / "sunarc.toml").write_text(CONFIG.format(state=folder / "state", port=port, token=folder / "token"))
    log = folder / "log"
    with log.open("wb") as output:
        command = [sys.executable, "-m", "sunarc", "serve", "--config", str(folder / "sunarc.toml")]
        process = subprocess.Popen(command, stdout=output, stderr=output)
    service = Running(port, process, log)
    try:
        for _ in range(550):
            try:
                service.get("/v1/status")
                break
            except OSError:
                time.sleep(0.2)  # noqa: TID251 - a real process is waited for
        yield service
    finally:
        process.kill()
        process.wait()


@pytest.fixture
def flat(running: Running) -> Iterator[Running]:
    """Check that the service is ready and hardly larger afterwards."""
    before = running.memory_bytes()
    yield running
    assert running.get("/healthz") == 200
    assert running.get("/readyz") == 200
    assert running.memory_bytes() - before < 40 * MEGABYTE


def send_endlessly(running: Running, head: str, *, chunked: bool) -> tuple[int, bytes]:
    """Send up to 2 GB of zeros; return how much was taken, and the answer's first line."""
    block = bytes(MEGABYTE)
    if chunked:
        block = f"{MEGABYTE:x}\r\n".encode() + block + b"\r\n"
    sent = 0
    with socket.create_connection(("127.0.0.1", running.port), timeout=20.0) as connection:
        connection.sendall(head.encode())
        try:
            while sent < 2 * GIGABYTE:
                connection.sendall(block)
                sent += MEGABYTE
        except (BrokenPipeError, ConnectionResetError):
            pass
        try:
            return sent, connection.recv(200).partition(b"\r\n")[0]
        except ConnectionResetError:
            return sent, b""


HEAD = "POST /v1/back-project HTTP/1.1\r\nhost: localhost\r\ncontent-type: application/json\r\n"


def test_two_gigabytes_are_refused_before_they_are_read(flat: Running) -> None:
    announced = send_endlessly(flat, f"{HEAD}content-length: {2 * GIGABYTE}\r\n\r\n", chunked=False)
    unannounced = send_endlessly(flat, f"{HEAD}transfer-encoding: chunked\r\n\r\n", chunked=True)
    for sent, answer in (announced, unannounced):
        assert sent < 64 * MEGABYTE  # what the two sockets' buffers hold
        assert answer in {b"HTTP/1.1 413 Content Too Large", b"HTTP/1.1 413 Request Entity Too Large", b""}


def test_a_refusal_of_too_much_is_read_by_who_waits_for_it(flat: Running) -> None:
    with socket.create_connection(("127.0.0.1", flat.port), timeout=20.0) as connection:
        connection.sendall(f"{HEAD}content-length: {2 * GIGABYTE}\r\n\r\n".encode())
        told = b""
        while more := connection.recv(100_000):
            told += more
    assert told.startswith(b"HTTP/1.1 413")
    assert json.loads(told.partition(b"\r\n\r\n")[2])["status"] == 413


def test_a_body_where_none_belongs_is_not_kept(flat: Running) -> None:
    sent, _ = send_endlessly(
        flat, "GET /healthz HTTP/1.1\r\nhost: x\r\ntransfer-encoding: chunked\r\n\r\n", chunked=True
    )
    assert sent < 64 * MEGABYTE


@pytest.mark.parametrize("path", ["/v1/back-project", "/healthz"])
def test_a_length_with_chunks_is_refused_and_ends_the_connection(flat: Running, path: str) -> None:
    hidden = b"GET /v1/status HTTP/1.1\r\nhost: localhost\r\n\r\n"
    head = f"POST {path} HTTP/1.1\r\nhost: localhost\r\ncontent-type: application/json\r\ncontent-length: 5\r\n"
    with socket.create_connection(("127.0.0.1", flat.port), timeout=20.0) as connection:
        connection.sendall(f"{head}transfer-encoding: chunked\r\n\r\n0\r\n\r\n".encode() + hidden)
        told = b""
        while more := connection.recv(100_000):
            told += more
    assert told.startswith(b"HTTP/1.1 400")
    assert told.count(b"HTTP/1.1 ") == 1  # what follows is no request
    problem = json.loads(told.partition(b"\r\n\r\n")[2])
    assert (problem["type"], problem["errors"][0]["field"]) == ("urn:sunarc:problem:malformed", "content-length")


def test_a_thousand_open_connections_keep_nobody_out(flat: Running) -> None:
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    resource.setrlimit(resource.RLIMIT_NOFILE, (max(soft, min(hard, 4096)), hard))
    held: list[socket.socket] = []
    try:
        for number in range(1000):
            connection = socket.create_connection(("127.0.0.1", flat.port), timeout=20.0)
            if number % 2:
                connection.sendall(b"GET /v1/status HTTP/1.1\r\nhost: ")  # and no more
            held.append(connection)
        assert flat.get("/healthz") == 200
        assert flat.get("/readyz") == 200
        assert flat.open_files() < 612  # api.max_connections is 512
    finally:
        for connection in held:
            connection.close()


@pytest.mark.parametrize(
    "path",
    [
        "/static/../../../../../../etc/passwd",
        "/static/%2e%2e/%2e%2e/%2e%2e/%2e%2e/etc/passwd",
        "/static/..%2f..%2f..%2fetc%2fpasswd",
        "/static//etc/passwd",
        "/static/....//....//etc/passwd",
        "/../etc/passwd",
        "/v1/calibrations/..%2f..%2fetc%2fpasswd",
        "/v1/cameras/..%2f/image/latest",
    ],
)
def test_no_path_leads_outside(flat: Running, path: str) -> None:
    assert flat.get(path) == 404


def test_a_forged_token_changes_nothing_and_no_token_is_written_down(flat: Running) -> None:
    for given, status in (
        ("forged-forged-forged", 401),
        (TOKEN[:-1], 401),
        (TOKEN, 404),
    ):
        connection = http.client.HTTPConnection("127.0.0.1", flat.port, timeout=20.0)
        headers = {"authorization": f"Bearer {given}", "content-type": "application/json"}
        connection.request("POST", "/v1/calibrations/none/activate", body='{"reason": "test"}', headers=headers)
        with connection.getresponse() as answer:
            assert (answer.status, given) == (status, given), answer.read()
        connection.close()
    log = flat.log.read_text()
    assert "forged" not in log
    assert TOKEN[:-1] not in log
