"""Webhooks, over real sockets: signed, tried again, given up where refused, and never in the way."""

from __future__ import annotations

import base64
import hashlib
import hmac
import json
import socket
import ssl
import subprocess
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import pytest
from tests.fixtures.ports import free_port
from tests.fixtures.pushing import DUSTY, Pushing, pushing, step

from sunarc.common.errors import ConfigurationError, InputError, OutsideError
from sunarc.imager.workers import push
from sunarc.imager.workers import push as webhook
from sunarc.imager.workers.options import PushOptions
from sunarc.imager.workers.push import Webhook, webhook_name

SECRET = "a secret of enough bytes"  # noqa: S105 - of the test alone


@dataclass
class Receiver:
    """Takes POSTs, with the answers that it is told to give, then 204."""

    url: str = ""
    answers: list[int] = field(default_factory=list)
    taken: list[tuple[dict[str, str], bytes]] = field(default_factory=list)
    refused: list[str] = field(default_factory=list)

    def texts(self) -> list[str]:
        return [json.loads(body)["data"].get("text", "") for _, body in self.taken]


@contextmanager
def receiving(*, port: int = 0, tls: Path | None = None, receiver: Receiver | None = None) -> Iterator[Receiver]:
    taker = receiver or Receiver()

    class Handler(BaseHTTPRequestHandler):
        def do_POST(self) -> None:
            body = self.rfile.read(int(self.headers["content-length"]))
            status = taker.answers.pop(0) if taker.answers else 204
            headers = {name.lower(): value for name, value in self.headers.items()}
            if status == 204:
                taker.taken.append((headers, body))
            else:
                taker.refused.append(headers["webhook-id"])
            self.send_response(status)
            self.send_header("location", "/elsewhere")
            self.end_headers()

        def log_message(self, *_: object) -> None:
            """Say nothing."""

    class Server(ThreadingHTTPServer):
        def handle_error(self, *_: object) -> None:
            """Say nothing: a handshake that is refused is no fault."""

    server = Server(("127.0.0.1", port), Handler)
    if tls is not None:
        context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
        context.load_cert_chain(tls / "cert.pem", tls / "key.pem")
        server.socket = context.wrap_socket(server.socket, server_side=True)
    taker.url = f"{'http' if tls is None else 'https'}://127.0.0.1:{server.server_port}/hook?key=1"
    thread = threading.Thread(target=server.serve_forever, args=(0.01,))
    thread.start()
    try:
        yield taker
    finally:
        server.shutdown()
        thread.join()
        server.server_close()


@pytest.fixture
def bench(tmp_path: Path) -> Iterator[Pushing]:
    (tmp_path / "secret").write_text(f"{SECRET}\n")
    with pushing(tmp_path) as one:
        yield one


def sink(bench: Pushing, url: str) -> Webhook:
    return Webhook(url, secret_file=bench.folder / "secret", clock=bench.clock)


def test_messages_arrive_in_their_order_and_are_signed(bench: Pushing) -> None:
    with receiving() as receiver:
        name = webhook_name(receiver.url)
        bench.look(name)
        bench.conditions["dusty"] = DUSTY
        bench.happen(3, name)
        assert step(bench.worker(sink(bench, receiver.url))) == 1.0
    assert [json.loads(body)["type"] for _, body in receiver.taken] == ["bump"] * 3 + ["condition_set"]
    headers, body = receiver.taken[-1]
    message = json.loads(body)
    assert (message["camera"], message["data"]) == ("roof", DUSTY)
    assert message["id"] == headers["webhook-id"]
    assert abs(int(headers["webhook-timestamp"]) - bench.clock.now().timestamp()) < 5.0
    # the definition of Standard Webhooks
    signed = b".".join([headers["webhook-id"].encode(), headers["webhook-timestamp"].encode(), body])
    mac = base64.b64encode(hmac.digest(SECRET.encode(), signed, hashlib.sha256)).decode()
    assert headers["webhook-signature"] == f"v1,{mac}"
    assert "key" not in name


def test_a_signature_is_that_of_the_standards_example() -> None:
    key = base64.b64decode("MfKQ9r8GKYqrTwjUPD8ILPZIo2LaLaSw")
    found = webhook.signature(key, "msg_p5jXN8AQM9LWM0D4loKWxJek", "1614265330", b'{"test": 2432232314}')
    assert found == "v1,g0hM9SsE+OTPJTGt/tmIKtSyZlE3uFJELVlNIOLJ1OE="


def test_what_fails_is_tried_again_with_the_same_id_and_longer_pauses(bench: Pushing) -> None:
    with receiving() as receiver:
        name = webhook_name(receiver.url)
        bench.look(name)
        bench.happen(2, name)
        receiver.answers = [500, 503, 429, 408]
        worker = bench.worker(sink(bench, receiver.url))
        assert [step(worker) for _ in range(5)] == [1.0, 2.0, 4.0, 8.0, 1.0]
    assert receiver.texts() == ["0", "1"]
    assert set(receiver.refused) == {receiver.taken[0][0]["webhook-id"]}
    assert bench.codes() == set()


@pytest.mark.parametrize("status", [400, 401, 404, 410, 301, 307])
def test_what_is_refused_is_given_up_and_shown_until_one_is_taken(bench: Pushing, status: int) -> None:
    with receiving() as receiver:
        name = webhook_name(receiver.url)
        bench.look(name)
        bench.happen(1, name)
        receiver.answers = [status]
        worker = bench.worker(sink(bench, receiver.url))
        assert step(worker) == 1.0
        assert bench.codes() == {f"push_refused_{name}"}
        (reason,) = bench.board.snapshot().reasons
        assert (reason.data["n"], reason.data["kind"]) == (1, "bump")
        assert str(status) in str(reason.data["error"])
        bench.happen(1, name)
        step(worker)
    assert len(receiver.taken) == 1  # neither the refused one again, nor where a redirect pointed
    assert bench.codes() == set()
    assert bench.archive.notices.sink_states()[name].refused == 1


def test_a_restart_loses_and_doubles_nothing(bench: Pushing) -> None:
    with receiving() as receiver:
        name, port = webhook_name(receiver.url), urlsplit(receiver.url).port or 0
        bench.look(name)
        bench.happen(3, name)
        receiver.answers = [204, 500]
        step(bench.worker(sink(bench, receiver.url)))
    step(bench.worker(sink(bench, receiver.url)))  # nobody listens
    bench.restart()
    bench.happen(2, name)
    step(bench.worker(sink(bench, receiver.url)))
    bench.restart()
    with receiving(port=port, receiver=receiver):
        step(bench.worker(sink(bench, receiver.url)))
    assert receiver.texts() == ["0", "1", "2", "0", "1"]


def test_a_receiver_that_is_not_reached_is_a_condition_after_a_minute(
    bench: Pushing, monkeypatch: pytest.MonkeyPatch
) -> None:
    url = f"http://127.0.0.1:{free_port()}/"
    name = webhook_name(url)
    bench.look(name)
    bench.happen(1, name)
    step(bench.worker(sink(bench, url)))
    assert bench.codes() == set()
    monkeypatch.setattr(push, "_FAILING_S", 0.0)
    step(bench.worker(sink(bench, url)))
    assert bench.codes() == {f"push_failing_{name}"}
    bench.look(name)
    assert bench.archive.notices.sink_states()[name].waiting == 1  # it is no notice itself


def certificate(folder: Path) -> None:
    """Write a certificate of 127.0.0.1 that nobody signed."""
    names = ("-subj", "/CN=127.0.0.1", "-addext", "subjectAltName=IP:127.0.0.1")
    files = ("-keyout", folder / "key.pem", "-out", folder / "cert.pem")
    kind = ("-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:P-256", "-nodes", "-days", "2")
    subprocess.run(["openssl", "req", "-x509", *kind, *files, *names], check=True, capture_output=True)


def test_a_certificate_is_checked(bench: Pushing, monkeypatch: pytest.MonkeyPatch) -> None:
    certificate(bench.folder)
    with receiving(tls=bench.folder) as receiver:
        name = webhook_name(receiver.url)
        bench.look(name)
        bench.happen(1, name)
        assert step(bench.worker(sink(bench, receiver.url))) == 1.0
        assert receiver.taken == []
        with pytest.raises(OutsideError, match="CERTIFICATE_VERIFY_FAILED"):
            sink(bench, receiver.url).deliver(bench.archive.notices.after(name, limit=1)[0], lambda: None)
        monkeypatch.setenv("SSL_CERT_FILE", str(bench.folder / "cert.pem"))
        step(bench.worker(sink(bench, receiver.url)))
        assert len(receiver.taken) == 1


@contextmanager
def dripping(text: bytes) -> Iterator[str]:
    """Yield the address of a server that sends a byte of a text every 20 ms, and then waits."""
    ended = threading.Event()

    def serve() -> None:
        channel, _ = listening.accept()
        with channel:
            for byte in text:
                if ended.wait(0.02):
                    return
                channel.send(bytes([byte]))
            ended.wait(5.0)

    with socket.create_server(("127.0.0.1", 0)) as listening:
        thread = threading.Thread(target=serve)
        thread.start()
        yield f"http://127.0.0.1:{listening.getsockname()[1]}/"
        ended.set()
        thread.join()


@pytest.mark.parametrize(
    "text", [b"HTTP/1.1 204 No Content\r\nx: " + b"y" * 1000, b"HTTP/1.1 100 Continue\r\n\r\n" * 50]
)
def test_a_slow_answer_takes_no_longer_than_it_may_and_the_worker_beats_meanwhile(
    bench: Pushing, monkeypatch: pytest.MonkeyPatch, text: bytes
) -> None:
    monkeypatch.setattr(webhook, "_WITHIN_S", 0.3)
    beats: list[float] = []
    with dripping(text) as url:
        bench.look(webhook_name(url))
        bench.happen(1, webhook_name(url))
        worker = bench.worker(sink(bench, url))
        begun_s = bench.clock.monotonic()
        assert worker.step(threading.Event(), lambda: beats.append(bench.clock.monotonic())) == 1.0
        assert 0.25 < bench.clock.monotonic() - begun_s < 1.0
    assert len(beats) > 5
    assert bench.archive.notices.sink_states()[webhook_name(url)].waiting == 1


@pytest.mark.parametrize("text", [b"SSH-2.0-OpenSSH\r\n\r\n", b"", b"HTTP/1.1 204 " + b"x" * 70_000])
def test_what_is_no_http_is_tried_again(bench: Pushing, text: bytes) -> None:
    with socket.create_server(("127.0.0.1", 0)) as listening:

        def serve() -> None:
            channel, _ = listening.accept()
            with channel:
                channel.recv(65_536)
                channel.sendall(text)

        url = f"http://127.0.0.1:{listening.getsockname()[1]}/"
        bench.look(webhook_name(url))
        bench.happen(1, webhook_name(url))
        thread = threading.Thread(target=serve)
        thread.start()
        notice = bench.archive.notices.after(webhook_name(url), limit=1)[0]
        with pytest.raises(OutsideError):
            sink(bench, url).deliver(notice, lambda: None)
        thread.join()


def test_a_worker_ends_while_its_receiver_hangs(bench: Pushing) -> None:
    with socket.create_server(("127.0.0.1", 0)) as listening:
        url = f"http://127.0.0.1:{listening.getsockname()[1]}/"
        bench.look(webhook_name(url))
        bench.happen(5, webhook_name(url))
        stop, beats = threading.Event(), []
        worker = bench.worker(sink(bench, url))
        thread = threading.Thread(target=worker.run, args=(stop, lambda: beats.append(1)), daemon=True)
        thread.start()
        channel, _ = listening.accept()
        bench.happen(1, webhook_name(url))  # nobody else waits for it
        stop.set()
        channel.close()
        thread.join(5.0)
        assert not thread.is_alive()
        assert beats


@pytest.mark.parametrize(
    "given",
    [
        {"webhooks": ("ftp://a.example/",)},
        {"webhooks": ("http://",)},
        {"webhooks": ("https://user:word@a.example/",)},
        {"webhooks": ("https://a.example/\r\nx: y",)},
        {"webhooks": ("https://a.example:99999/",)},
        {"webhooks": ("https://a.example/", "https://a.example/")},
        {"webhooks": tuple(f"https://a.example/{n}" for n in range(9))},
        {"webhooks": ("https://a.example/",), "webhook_secret_file": None},
        {"mqtt": "http://a.example"},
        {"mqtt": "mqtt://a.example/topic"},
        {"mqtt": "mqtt://user:word@a.example"},
    ],
)
def test_addresses_that_are_none_are_refused(given: dict[str, Any]) -> None:
    with pytest.raises(InputError):
        PushOptions(**{"webhook_secret_file": Path("secret"), **given})


@pytest.mark.parametrize("text", ["short", "", "whsec_!!!", "whsec_c2hvcnQ="])
def test_a_secret_that_is_none_is_a_condition_until_it_is_one(bench: Pushing, text: str) -> None:
    with receiving() as receiver:
        name = webhook_name(receiver.url)
        bench.look(name)
        bench.happen(2, name)
        worker = bench.worker(sink(bench, receiver.url))
        (bench.folder / "secret").write_text(text)
        assert (step(worker), bench.codes()) == (60.0, {f"push_unusable_{name}"})
        (bench.folder / "secret").unlink()
        with pytest.raises(ConfigurationError):
            worker.sink.probe()
        assert (step(worker), bench.codes()) == (60.0, {f"push_unusable_{name}"})
        (bench.folder / "secret").write_text(SECRET)
        assert (step(worker), bench.codes()) == (1.0, set())
        assert receiver.texts() == ["0", "1"]


def test_a_probe_connects_and_posts_nothing(bench: Pushing) -> None:
    with receiving() as receiver:
        sink(bench, receiver.url).probe()
        assert (receiver.taken, receiver.refused) == ([], [])
    with pytest.raises(OutsideError):
        sink(bench, f"http://127.0.0.1:{free_port()}/").probe()
