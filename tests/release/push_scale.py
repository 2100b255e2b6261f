"""Messages of a hub with many cameras, to a broker and to a webhook: tests/long fleet-push [--cameras N]."""

from __future__ import annotations

import argparse
import json
import os
import tempfile
import threading
from collections.abc import Callable
from contextlib import ExitStack
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from time import perf_counter

import psycopg
from tests.fixtures.fleet import NOON
from tests.fixtures.hub_process import HubProcess, processor_s
from tests.fixtures.mosquitto import Listener, Mosquitto
from tests.fixtures.postgresql import TEMPLATE, Server, running_server

from sunarc.imager.archive.archive import open_archive
from sunarc.imager.archive.values import CameraRecord

_QUIET_S = 60.0
_SPEAK = "UPDATE fleet SET received_at = extract(epoch FROM now()) * 1000000, status = %s"


class _Receiver(BaseHTTPRequestHandler):
    """Takes every message."""

    protocol_version = "HTTP/1.1"
    received = 0

    def do_POST(self) -> None:
        self.rfile.read(int(self.headers["content-length"]))
        _Receiver.received += 1
        self.send_response(204)
        self.end_headers()

    def log_message(self, *_: object) -> None:
        """Log nothing."""


def fill(server: Server, cameras: int) -> None:
    """Store cameras that have sent something."""
    with open_archive(server.url(TEMPLATE)) as archive:
        for n in range(cameras):
            record = CameraRecord(
                name=f"c{n:04d}", latitude=36.6, longitude=-97.5 + n / 100, altitude=0.0, width=8, height=6
            )
            archive.cameras.save(record)
            archive.epochs.open(record.name, at=NOON, reason="installed")
    with _connection(server) as connection:
        connection.execute("INSERT INTO fleet (camera, received_at, status) SELECT name, 0, '{}' FROM camera")
    speak(server)


def speak(server: Server, *conditions: str) -> None:
    """Have every camera report conditions, now."""
    with _connection(server) as connection:
        connection.execute(_SPEAK, [json.dumps({"health": "ready", "conditions": conditions})])


def _connection(server: Server) -> psycopg.Connection[tuple[object, ...]]:
    return psycopg.connect(host=str(server.folder), user="test", dbname=TEMPLATE, autocommit=True)


def seconds_until(done: Callable[[], bool], *, within_s: float = 600.0) -> float:
    """Return how long it took; TimeoutError after too long."""
    begun_s = perf_counter()
    while not done():
        if perf_counter() - begun_s > within_s:
            raise TimeoutError
        threading.Event().wait(0.1)
    return round(perf_counter() - begun_s, 1)


def measure(server: Server, folder: Path, cameras: int) -> dict[str, float]:
    """Return times and processor times, s, and the hub's memory."""
    with ExitStack() as stack:
        receiver = ThreadingHTTPServer(("127.0.0.1", 0), _Receiver)
        threading.Thread(target=receiver.serve_forever, daemon=True).start()
        stack.callback(receiver.shutdown)
        broker = Mosquitto(folder, "allow_anonymous true", "max_queued_messages 0")
        broker.start()
        stack.callback(broker.stop)
        listener = Listener(broker.port, "sunarc/+/state", "sunarc/+/events")
        push = f'[push]\nmqtt = "mqtt://127.0.0.1:{broker.port}"\n'
        push += f'webhooks = ["http://127.0.0.1:{receiver.server_port}/"]\n'
        (folder / "secret").write_text("a secret of the test alone")
        push += f'webhook_secret_file = "{folder / "secret"}"\n'
        hub = HubProcess(folder, server.url(TEMPLATE), settings=push)
        stack.callback(hub.kill)
        hub.wait_until_it_answers()

        def heard(kind: str, n: int) -> Callable[[], bool]:
            def enough() -> bool:
                listener.listen(0.05)
                return sum(topic.endswith(kind) for topic, _, _ in listener.heard) >= n

            return enough

        found = {"states_published_s": seconds_until(heard("/state", cameras))}
        before = hub.processor_s(), processor_s(server.pid)
        begun_s = perf_counter()
        while perf_counter() - begun_s < _QUIET_S:
            listener.listen(1.0)
        found["quiet_hub_processor_s_a_minute"] = round(hub.processor_s() - before[0], 1)
        found["quiet_postgresql_processor_s_a_minute"] = round(processor_s(server.pid) - before[1], 1)
        speak(server, "dusty")
        begun_s = perf_counter()
        found["conditions_at_the_broker_s"] = seconds_until(heard("/events", cameras))
        seconds_until(lambda: _Receiver.received >= cameras)
        found["conditions_at_the_webhook_s"] = round(perf_counter() - begun_s, 1)
        found["hub_memory_mib"] = hub.memory_mib()
    return found


def main() -> None:
    """Run and print what was measured, as JSON."""
    parser = argparse.ArgumentParser(prog="tests/long fleet-push", description=__doc__)
    parser.add_argument("--cameras", type=int, default=1000)
    asked = parser.parse_args()
    with tempfile.TemporaryDirectory(prefix="push") as folder, running_server() as server:
        fill(server, asked.cameras)
        load = os.getloadavg()[0]
        print(json.dumps({"load": load, "cameras": asked.cameras, **measure(server, Path(folder), asked.cameras)}))


if __name__ == "__main__":
    main()
