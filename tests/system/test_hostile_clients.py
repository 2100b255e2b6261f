"""The service among clients that mean ill: what they want is refused, its memory stays flat, others are answered."""

from __future__ import annotations

import gzip
import http.client
import itertools
import json
import os
import resource
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from statistics import median

import pytest
from tests.fixtures.archive import make_empty

from sunarc.hub.archive import open_hub_archive
from sunarc.hub.feed_routes import token_digest
from sunarc.imager.archive.database.schema import head_revision

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
UNIT = {"MALLOC_ARENA_MAX": "2", "MALLOC_MMAP_THRESHOLD_": "1048576"}
"""As the units have it."""
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

    def send(self, method: str, path: str, body: bytes, headers: dict[str, str]) -> int:
        connection = http.client.HTTPConnection("127.0.0.1", self.port, timeout=100.0)
        try:
            connection.request(method, path, body=body, headers=headers)
            with connection.getresponse() as answer:
                answer.read()
                return answer.status
        except ConnectionError:
            return 413  # refused unread: the reset may overtake the answer
        finally:
            connection.close()

    def memory_bytes(self, *, largest: bool = False) -> int:
        status = Path(f"/proc/{self.process.pid}/status").read_text()
        return int(status.split("VmHWM:" if largest else "VmRSS:")[1].split()[0]) * 1024

    def forget_largest(self) -> None:
        Path(f"/proc/{self.process.pid}/clear_refs").write_text("5")  # proc(5): the peak is the present from now on

    def open_files(self) -> int:
        return len(list(Path(f"/proc/{self.process.pid}/fd").iterdir()))


def serve(folder: Path, *role: str) -> Iterator[Running]:
    with socket.socket() as trial:
        trial.bind(("127.0.0.1", 0))
        port = int(trial.getsockname()[1])
    (folder / "token").write_text(TOKEN)
    (folder / "state").mkdir(exist_ok=True)
    (folder / "sunarc.toml").write_text(CONFIG.format(state=folder / "state", port=port, token=folder / "token"))
    log = folder / "log"
    with log.open("wb") as output:
        command = [sys.executable, "-m", "sunarc", "serve", *role, "--config", str(folder / "sunarc.toml")]
        process = subprocess.Popen(command, stdout=output, stderr=output, env=os.environ | UNIT)
    service = Running(port, process, log)
    try:
        for _ in range(550):
            try:
                service.get("/healthz")
                break
            except OSError:
                time.sleep(0.2)  # noqa: TID251 - a real process is waited for
        yield service
    finally:
        process.kill()
        process.wait()


@pytest.fixture(scope="module")
def running(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Running]:
    yield from serve(tmp_path_factory.mktemp("hostile"))


@pytest.fixture(scope="module")
def hub(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Running]:
    folder = tmp_path_factory.mktemp("hub")
    (folder / "state").mkdir()
    make_empty(folder / "state" / "sunarc.sqlite")
    with open_hub_archive(folder / "state" / "sunarc.sqlite") as archive:
        now = datetime.now(UTC)  # noqa: TID251 - of a real process
        archive.feeds.add_token("roof", token_digest(TOKEN), now=now, former_until=now)
    yield from serve(folder, "--role", "hub")


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


def repeated(part: bytes, *, before: bytes, after: bytes, size: int = 7_900_000) -> bytes:
    return before + b",".join([part] * (size // (len(part) + 1))) + after


BODIES: dict[str, Callable[[], bytes]] = {
    "names": lambda: b"{" + b",".join(b'"k%d":1' % number for number in range(600_000)) + b"}",
    "names of a list": lambda: repeated(b'"pixels":[[1,1]]', before=b"{", after=b"}"),
    "objects": lambda: repeated(b'{"a":1}', before=b'{"direction_enu":[', after=b"]}"),
    "unknown objects": lambda: repeated(b'{"a":1}', before=b'{"directions":[', after=b"]}"),
    "empty lists": lambda: repeated(b"[]", before=b'{"pixels":[', after=b"]}"),
    "numbers of one row": lambda: repeated(b"1", before=b'{"pixels":[[', after=b"]]}"),
    "wrong rows": lambda: repeated(b'["a","b"]', before=b'{"pixels":[', after=b"]}", size=990_000),
    "levels": lambda: b'{"pixels":' + b"[" * 7_900_000,
    "long text": lambda: b'{"pixels":"' + b"a" * 7_900_000 + b'"}',
    "long name": lambda: b'{"' + b"a" * 7_900_000 + b'":1}',
    "NaN": lambda: repeated(b"[NaN,NaN]", before=b'{"pixels":[', after=b"]}", size=990_000),
}
DOCUMENTED_BYTES = 4 * 132_000_000
"""Bound of what requests may hold, docs/operating/install.md."""


ANSWERED_S, OF_REST = 1.0, 20.0
"""The time in which /healthz answers meanwhile, and how many times that of a request at rest a busy host may add."""


def attack(service: Running, requests: list[tuple[str, str, bytes, dict[str, str]]]) -> tuple[set[int], int]:
    """Send requests at once; return their statuses and how far the memory rose. /healthz has to answer meanwhile."""
    rest_s = median(health_s(service) for _ in range(9))
    service.forget_largest()
    before = service.memory_bytes()
    taken_s: list[float] = []
    with ThreadPoolExecutor(len(requests)) as pool:
        sent = [pool.submit(service.send, *request) for request in requests]
        while not all(one.done() for one in sent):
            taken_s.append(health_s(service))
            time.sleep(0.05)  # noqa: TID251 - a real process is asked
    assert median(taken_s) <= ANSWERED_S + OF_REST * rest_s, f"{taken_s} meanwhile, {rest_s} at rest"
    return {one.result() for one in sent}, service.memory_bytes(largest=True) - before


def health_s(service: Running) -> float:
    """Return how long /healthz takes to answer."""
    began_s = time.perf_counter()
    assert service.get("/healthz") == 200
    return time.perf_counter() - began_s


@pytest.mark.parametrize("role", ["running", "hub"])
@pytest.mark.parametrize("kind", BODIES)
def test_forty_large_bodies_of_json_stay_within_the_documented_memory(
    request: pytest.FixtureRequest, role: str, kind: str
) -> None:
    service: Running = request.getfixturevalue(role)
    body, camera = BODIES[kind](), "" if role == "running" else "/cameras/roof"
    paths = [f"/v1{camera}/{route}" for route in ("back-project", "project", "geolocate")]
    paths.append("/v1/days/2013-05-13/air" if role == "running" else "/v1/pairs/roof/mast/height")
    methods = {"/v1/days/2013-05-13/air": "PUT"}
    headers = {"content-type": "application/json"}
    asked = [(methods.get(path, "POST"), path, body, headers) for path in itertools.islice(itertools.cycle(paths), 40)]
    statuses, rise = attack(service, asked)
    assert statuses <= {404, 413, 422, 429, 503}  # 404: no calibration yet
    assert rise < DOCUMENTED_BYTES


ROWS: dict[str, Callable[[], bytes]] = {
    "names": lambda: b'{"x":{' + b",".join(b'"k%d":1' % number for number in range(1_500_000)) + b"}}",
    "numbers": lambda: repeated(b"1.5", before=b'{"x":[', after=b"]}", size=15_000_000),
    "empty lists": lambda: repeated(b"[]", before=b'{"x":[', after=b"]}", size=15_000_000),
    "short texts": lambda: repeated(b'"\xc3\xa9"', before=b'{"x":[', after=b"]}", size=15_000_000),
}


@pytest.mark.parametrize("kind", ROWS)
def test_sixteen_large_feeds_stay_within_the_documented_memory(hub: Running, kind: str) -> None:
    body = gzip.compress(b'{"seq": 1, "kind": "status", "data": %s}\n' % ROWS[kind](), 1)
    headers = {"authorization": f"Bearer {TOKEN}", "sunarc-installation": "here", "sunarc-revision": head_revision()}
    statuses, rise = attack(hub, [("PUT", "/v1/cameras/roof/feed?after=0", body, headers)] * 16)
    assert statuses <= {200, 413, 422, 429, 503}
    assert rise < DOCUMENTED_BYTES
