"""Imagers that feed one hub over HTTP on loopback, through links that fail; the hub and PostgreSQL fail too.

The short form is a test. The long one:

    tests/long fleet [--imagers N] [--minutes M] [--rate R]
"""

from __future__ import annotations

import argparse
import json
import os
import random
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
import threading
import urllib.request
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass, field
from datetime import UTC, datetime, timedelta
from pathlib import Path
from time import perf_counter

from sqlalchemy import URL
from tests.fixtures.fleet import new_imager, sighting
from tests.fixtures.ports import free_port
from tests.fixtures.postgresql import TEMPLATE, Server, running_server

from sunarc.api import token_digest
from sunarc.archive import Archive, CameraArchive, Event, open_archive
from sunarc.runtime.clock import SystemClock
from sunarc.runtime.status import StatusRegistry
from sunarc.sky import Site
from sunarc.workers import FeedWorker, HubConnection, HubOptions
from sunarc.workers.feeding import feed

START = datetime(2026, 1, 1, 12, tzinfo=UTC)
FAULTS = ("cut", "answer_lost", "late", "twice")
"""What a link does to a request: drop it, lose its answer, deliver it after the sender gave it up, deliver it twice."""
_LATE_S = 0.3


def _pause(seconds: float) -> None:
    threading.Event().wait(seconds)


@dataclass
class Link:
    """A link from an imager to the hub that fails as it is told: a proxy of one request a connection."""

    hub_port: int
    seed: int
    share: float = 0.0
    down: bool = False
    counts: dict[str, int] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self._random = random.Random(self.seed)
        self._listening = socket.create_server(("127.0.0.1", 0))
        self.port = self._listening.getsockname()[1]
        threading.Thread(target=self._accept, daemon=True).start()

    def close(self) -> None:
        self._listening.close()

    def _accept(self) -> None:
        with suppress(OSError):
            while True:
                connection, _ = self._listening.accept()
                threading.Thread(target=self._carry, args=(connection,), daemon=True).start()

    def _carry(self, connection: socket.socket) -> None:
        with suppress(OSError), connection:
            connection.settimeout(30.0)
            request = _whole(connection)
            fault = "cut" if self.down else self._fault()
            self.counts[fault] = self.counts.get(fault, 0) + 1
            if fault == "cut":
                return
            if fault == "late":
                connection.close()
                _pause(_LATE_S)
            if fault == "twice":
                self._ask(request)
            answer = self._ask(request)
            if fault in {"", "twice"}:
                connection.sendall(answer)

    def _fault(self) -> str:
        return self._random.choice(FAULTS) if self._random.random() < self.share else ""

    def _ask(self, request: bytes) -> bytes:
        with socket.create_connection(("127.0.0.1", self.hub_port), timeout=30.0) as hub:
            hub.sendall(request)
            return b"".join(iter(lambda: hub.recv(65_536), b""))


def _whole(connection: socket.socket) -> bytes:
    """Return a request with its body; a sender that closes early leaves what there is."""
    data = b""
    while b"\r\n\r\n" not in data:
        data += _some(connection)
    head, _, body = data.partition(b"\r\n\r\n")
    lengths = [line.split(b":")[1] for line in head.split(b"\r\n") if line.lower().startswith(b"content-length")]
    while len(body) < int(lengths[0]):
        body += _some(connection)
    return head + b"\r\n\r\n" + body


def _some(connection: socket.socket) -> bytes:
    part = connection.recv(65_536)
    if not part:
        raise ConnectionResetError
    return part


class HubProcess:
    """`sunarc serve --role hub` as a process of its own."""

    def __init__(self, folder: Path, store: URL) -> None:
        self.port = free_port()
        self.log = folder / "hub.log"
        self._config = folder / "hub.toml"
        address = store.render_as_string(hide_password=False)
        self._config.write_text(f'store = "{address}"\n[api]\nport = {self.port}\n')
        self.start()

    def start(self) -> None:
        command = [sys.executable, "-m", "sunarc", "serve", "--role", "hub", "--config", str(self._config)]
        with self.log.open("ab") as log:
            self._process = subprocess.Popen(command, stdout=log, stderr=log)

    def kill(self) -> None:
        self._process.send_signal(signal.SIGKILL)
        self._process.wait(10.0)

    def start_again_if_ended(self) -> None:
        """Start a hub that ended, as its unit does: one that starts while PostgreSQL is away gives up."""
        if self._process.poll() is not None:
            self.start()

    def stop(self) -> int:
        self._process.terminate()
        return self._process.wait(20.0)

    def require_running(self) -> None:
        code = self._process.poll()
        if code is not None:
            raise RuntimeError(f"the hub ended with {code}: {self.log.read_text()}")

    def ask(self, path: str) -> object:
        with urllib.request.urlopen(f"http://127.0.0.1:{self.port}{path}", timeout=20.0) as answer:
            return json.loads(answer.read())


class Imager:
    """An archive and the worker that sends it, in a thread."""

    def __init__(self, folder: Path, name: str, link: Link, token: Path) -> None:
        self.name, self.link = name, link
        self.archive = new_imager(folder, name)
        self._stop = threading.Event()
        clock = SystemClock()
        options = HubOptions(url=f"http://127.0.0.1:{link.port}", token_file=token)
        worker = FeedWorker(
            camera=CameraArchive(self.archive, name=name, site=Site(latitude=36.6, longitude=-97.5)),
            send=HubConnection(options, camera=name).send,
            clock=clock,
            board=StatusRegistry(version="1", started_at=clock.now(), monotonic=clock.monotonic),
            every_s=0.05,
        )
        self._thread = threading.Thread(target=worker.run, args=(self._stop, lambda: None), daemon=True)
        self.count = 0

    def begin(self) -> None:
        self._thread.start()

    def see(self, rows: int) -> None:
        """Store sightings of the next moments, and an event."""
        made = [
            sighting(0, camera=self.name, time=START + timedelta(seconds=30 * n), x_px=1.0 + n / 7.0)
            for n in range(self.count, self.count + rows)
        ]
        self.archive.add_sun_points(made)
        time = made[-1].time
        self.archive.add_event(Event(time=time, kind="test", severity="info", text=f"{self.count}", camera=self.name))
        self.count += rows

    def caught_up(self) -> bool:
        position = self.archive.outbox_position()
        return self.archive.outbox_waiting() == 0 and position.committed >= position.sent

    def end(self) -> None:
        self._stop.set()
        if self._thread.is_alive():
            self._thread.join(30.0)
        self.link.close()
        self.archive.close()


@dataclass
class Fleet:
    server: Server
    store: URL
    hub: HubProcess
    imagers: Sequence[Imager]

    def wait_until_caught_up(self, within_s: float) -> float:
        """Return how long it took until every imager's outbox was empty."""
        begun_s = perf_counter()
        while not all(imager.caught_up() for imager in self.imagers):
            self.hub.start_again_if_ended()
            if perf_counter() - begun_s > within_s:
                waiting = {imager.name: imager.archive.outbox_waiting() for imager in self.imagers}
                raise TimeoutError(f"not caught up within {within_s:g} s: {waiting}")
            _pause(0.05)
        return perf_counter() - begun_s

    def differences(self) -> list[str]:
        """Return the imagers whose rows the hub does not have once each, in their order."""
        with open_archive(self.store) as archive:
            return [imager.name for imager in self.imagers if not same(imager, archive)]


def same(imager: Imager, hub: Archive) -> bool:
    """Whether the hub has an imager's rows: each once, in the order in which they were made."""
    columns = hub.sun_point_columns(imager.name)
    in_order = bool((columns.ids[1:] > columns.ids[:-1]).all())
    events = [event.text for event in hub.events(imager.name)]
    own = [event.text for event in imager.archive.events(imager.name)]
    return (
        in_order
        and hub.sun_points(imager.name) == imager.archive.sun_points(imager.name)
        and events == own
        and hub.epochs(imager.name) == imager.archive.epochs(imager.name)
    )


@contextmanager
def fleet_of(count: int, *, seed: int = 0) -> Iterator[Fleet]:
    """Yield so many imagers that do not send yet, and a hub that answers."""
    folder = Path(tempfile.mkdtemp(prefix="fleet"))
    with ExitStack() as stack:
        stack.callback(shutil.rmtree, folder, ignore_errors=True)
        server = stack.enter_context(running_server())
        store = server.url(TEMPLATE)
        names = [f"imager-{n:02d}" for n in range(count)]
        with open_archive(store) as archive:
            for name in names:
                (folder / f"{name}.token").write_text(f"a token of {name}")
                now = SystemClock().now()
                archive.add_feed_token(name, token_digest(f"a token of {name}"), now=now, former_until=now)
        hub = HubProcess(folder, store)
        stack.callback(hub.kill)
        links = [Link(hub.port, seed=seed * 1000 + n) for n in range(count)]
        imagers = [
            Imager(folder, name, link, folder / f"{name}.token") for name, link in zip(names, links, strict=True)
        ]
        for imager in imagers:
            stack.callback(imager.end)
        wait_for(hub)
        yield Fleet(server=server, store=store, hub=hub, imagers=imagers)


def wait_for(hub: HubProcess) -> None:
    """Wait until a hub answers."""
    for _ in range(1200):
        with suppress(OSError):
            hub.ask("/healthz")
            return
        hub.require_running()
        _pause(0.1)
    raise TimeoutError("the hub does not answer")


@contextmanager
def quick_retries(longest_s: float = 0.5) -> Iterator[None]:
    """Let imagers try again soon: what takes minutes of waiting takes seconds."""
    former, feed._LONGEST_WAIT_S = feed._LONGEST_WAIT_S, longest_s
    try:
        yield
    finally:
        feed._LONGEST_WAIT_S = former


def run_with_faults(fleet: Fleet, *, steps: int, rows: int, pause_s: float, seed: int = 0) -> dict[str, int]:
    """Let the fleet live while everything fails in turn; return how often links did what."""
    chance = random.Random(seed)
    for imager in fleet.imagers:
        imager.link.share = 0.3
        imager.begin()
    for step in range(steps):
        for imager in fleet.imagers:
            imager.see(rows)
            imager.link.down = chance.random() < 0.15
        if step == steps // 3:
            fleet.hub.kill()
            fleet.hub.start()
        if step == 2 * steps // 3:
            fleet.server.stop()  # immediate: as a crash
            _pause(pause_s)
            fleet.server.start()
        _pause(pause_s)
    counts: dict[str, int] = {}
    for imager in fleet.imagers:
        imager.link.down = False
        imager.link.share = 0.0
        for fault, count in imager.link.counts.items():
            counts[fault] = counts.get(fault, 0) + count
    return counts


def measure_ingest(fleet: Fleet, *, rows: int) -> float:
    """Return sightings a second from full outboxes, all imagers at the same time."""
    for imager in fleet.imagers:
        for _ in range(0, rows, 1000):
            imager.see(1000)
    begun_s = perf_counter()
    for imager in fleet.imagers:
        imager.begin()
    fleet.wait_until_caught_up(600.0)
    return sum(imager.count for imager in fleet.imagers) / (perf_counter() - begun_s)


def main() -> None:
    """Run the long form and print what was measured, as JSON."""
    parser = argparse.ArgumentParser(prog="tests/long fleet", description=__doc__)
    parser.add_argument("--imagers", type=int, default=50)
    parser.add_argument("--minutes", type=float, default=60.0, help="of simulated failures")
    parser.add_argument("--rate-rows", type=int, default=10_000, help="sightings an imager, for the rate of ingest")
    asked = parser.parse_args()
    print(json.dumps({"load": os.getloadavg()[0], "imagers": asked.imagers}), flush=True)
    if asked.rate_rows:
        with fleet_of(asked.imagers) as fleet:
            rate = measure_ingest(fleet, rows=asked.rate_rows)
            print(json.dumps({"sightings_per_s": round(rate), "differences": fleet.differences()}), flush=True)
    if asked.minutes:
        with quick_retries(5.0), fleet_of(asked.imagers) as fleet:
            counts = run_with_faults(fleet, steps=round(60 * asked.minutes), rows=2, pause_s=1.0)
            took_s = fleet.wait_until_caught_up(600.0)
            found = {"requests": counts, "caught_up_s": round(took_s, 1), "differences": fleet.differences()}
            print(json.dumps(found), flush=True)
            sys.exit(1 if found["differences"] else 0)


if __name__ == "__main__":
    main()
