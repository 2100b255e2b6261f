"""The worker that sends the outbox: whatever the hub and the network do, every row arrives once."""

from __future__ import annotations

import gzip
import json
import math
import random
import socket
import sqlite3
import ssl
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing, contextmanager, suppress
from dataclasses import dataclass, field
from datetime import date, datetime
from http import HTTPStatus
from itertools import pairwise
from pathlib import Path

import pytest
from tests.fixtures.archive import make_empty
from tests.fixtures.fleet import NOON, NOW, new_imager, sighting
from tests.imager.workers.test_webhook import certificate

from sunarc.common.errors import ConfigurationError, InputError, OutsideError
from sunarc.hub.archive import HubArchive, open_hub_archive
from sunarc.imager.archive.archive import CameraArchive
from sunarc.imager.archive.database.schema import head_revision
from sunarc.imager.archive.day_digests import StoredDays
from sunarc.imager.archive.feed_rows import FeedBatch, FeedRow, Refusal, feed_lines, read_feed_lines
from sunarc.imager.archive.outbox import OutboxPosition, outbox_triggers
from sunarc.imager.archive.values import Event
from sunarc.imager.runtime.clock import SystemClock, VirtualClock
from sunarc.imager.runtime.status import StatusRegistry
from sunarc.imager.runtime.supervisor import Supervised, Supervisor, SupervisorOptions
from sunarc.imager.workers import feed, hub_connection
from sunarc.imager.workers.feed import LONGEST_WAIT_S, SILENT_S, FeedWorker
from sunarc.imager.workers.hub_connection import HubConnection, HubRefusal
from sunarc.imager.workers.options import HubOptions
from sunarc.sky.site import Site

_TICK_S = 0.05


@dataclass
class Wire:
    """Carries rows to a hub's archive, with the faults that it is told to have."""

    hub: HubArchive
    now: Callable[[], datetime]
    faults: list[str] = field(default_factory=list)
    most_rows: int = 10**6
    late: list[FeedBatch] = field(default_factory=list)

    def __call__(self, position: OutboxPosition, rows: Sequence[FeedRow], heartbeat: Callable[[], None]) -> int:
        heartbeat()
        fault = self.faults.pop(0) if self.faults else ""
        if fault == "cut":
            raise OutsideError("the network is gone")
        if fault == "refused":
            raise HubRefusal(401, "forged_token: …")
        if len(rows) > max(self.most_rows, 1) or (self.most_rows == 0 and rows and rows[0].data):
            raise HubRefusal(HTTPStatus.REQUEST_ENTITY_TOO_LARGE, "too large")
        arrived = read_feed_lines(feed_lines(rows), after=position.committed)
        batch = FeedBatch(camera="roof", installation=position.installation, after=position.committed, rows=arrived)
        if fault == "late":
            self.late.append(batch)
            raise OutsideError("no answer; what was sent arrives later")
        committed = self.hub.feeds.take(batch, now=self.now())
        for late in self.late:
            self.hub.feeds.take(late, now=self.now())
        self.late.clear()
        if fault == "answer_lost":
            raise OutsideError("the answer did not come back")
        if isinstance(committed, Refusal):
            raise HubRefusal(409, committed.text)
        return committed

    def ask(self, installation: str, since: date, until: date, heartbeat: Callable[[], None]) -> StoredDays:
        heartbeat()
        found = self.hub.feeds.digests("roof", installation, since=since, until=until)
        if found is None:
            raise HubRefusal(409, "second_installation")
        return StoredDays(revision=head_revision(), until=found.until, days=found.days)


@dataclass
class Bench:
    imager: HubArchive
    hub: HubArchive
    wire: Wire
    clock: VirtualClock
    board: StatusRegistry

    def worker(self) -> FeedWorker:
        camera = CameraArchive(self.imager, name="roof", site=Site(latitude=36.6, longitude=-97.5))
        return FeedWorker(camera=camera, send=self.wire, ask=self.wire.ask, clock=self.clock, board=self.board)

    def codes(self) -> set[str]:
        return {reason.code for reason in self.board.snapshot().reasons}


@pytest.fixture
def bench(tmp_path: Path) -> Iterator[Bench]:
    make_empty(tmp_path / "hub.sqlite")
    clock = VirtualClock(NOW)
    board = StatusRegistry(version="1", started_at=NOW, monotonic=clock.monotonic)
    with new_imager(tmp_path) as imager, open_hub_archive(tmp_path / "hub.sqlite") as hub:
        yield Bench(imager, hub, Wire(hub, clock.now), clock, board)


def step(worker: FeedWorker) -> float:
    return worker.step(lambda: None)


def send_all(worker: FeedWorker) -> None:
    for _ in range(200):
        if step(worker) > 0.0:
            return
    pytest.fail("it does not end")


def test_rows_arrive_and_are_forgotten_and_the_fleet_learns_of_the_imager(bench: Bench) -> None:
    bench.imager.sightings.add(sighting(n) for n in range(5))
    send_all(bench.worker())
    assert bench.hub.sightings.find("roof") == bench.imager.sightings.find("roof")
    assert bench.imager.outbox.waiting() == 0
    (camera,) = bench.hub.feeds.fleet()
    assert camera.status is not None
    assert (camera.status["health"], camera.status["conditions"]) == ("ready", [])


def test_with_nothing_new_nothing_is_sent_but_a_status_each_minute(bench: Bench) -> None:
    worker = bench.worker()
    send_all(worker)
    bench.wire.faults = ["cut"]
    assert step(worker) == 5.0
    assert bench.wire.faults == ["cut"]  # nothing was sent
    bench.clock.advance(61.0)
    step(worker)
    assert bench.wire.faults == []


@pytest.mark.parametrize("seed", range(6))
def test_cuts_lost_answers_and_late_repetitions_lose_and_double_nothing(bench: Bench, seed: int) -> None:
    chance, worker = random.Random(seed), bench.worker()
    for n in range(60):
        bench.imager.sightings.add([sighting(n)])
        bench.wire.faults = chance.choices(["", "cut", "answer_lost", "late", "refused"], k=2)
        if chance.random() < 0.1:
            worker = bench.worker()  # the process was killed and began again
        step(worker)
    bench.wire.faults.clear()
    send_all(worker)
    send_all(worker)
    assert bench.hub.sightings.find("roof") == bench.imager.sightings.find("roof")
    assert len(bench.hub.sightings.find("roof")) == 60
    assert {found.reason for found in bench.hub.feeds.quarantine()} <= {"gap"}
    assert bench.imager.outbox.waiting() == 0


@pytest.mark.parametrize("most_rows", [1, 3, 0])
def test_batches_become_smaller_until_the_hub_takes_them_and_one_row_that_is_too_large_is_passed(
    bench: Bench, most_rows: int
) -> None:
    bench.imager.sightings.add(sighting(n) for n in range(7))
    bench.wire.most_rows = most_rows
    if most_rows == 0:  # not even one: they go as numbers
        worker = bench.worker()
        for _ in range(60):
            step(worker)
        assert {found.reason for found in bench.hub.feeds.quarantine()} == {"body_too_large"}
        return
    send_all(bench.worker())
    assert len(bench.hub.sightings.find("roof")) == 7


def test_a_hub_that_was_put_back_gets_all_again(bench: Bench) -> None:
    bench.imager.sightings.add(sighting(n) for n in range(7))
    worker = bench.worker()
    send_all(worker)
    bench.hub.feeds.ask_again("roof")
    bench.imager.sightings.add([sighting(8)])
    send_all(worker)
    assert len(bench.hub.sightings.find("roof")) == 8
    assert bench.imager.outbox.position().committed > 15


def test_an_imager_that_was_put_back_goes_on_as_another_installation(bench: Bench, tmp_path: Path) -> None:
    send_all(bench.worker())
    bench.imager.close()
    copy = (tmp_path / "roof.sqlite").read_bytes()
    bench.imager.sightings.add(sighting(n) for n in range(7))
    send_all(bench.worker())
    former = bench.imager.outbox.position().installation
    bench.imager.close()
    for ending in ("", "-wal", "-shm"):
        (tmp_path / f"roof.sqlite{ending}").unlink(missing_ok=True)
    (tmp_path / "roof.sqlite").write_bytes(copy)
    with open_hub_archive(tmp_path / "roof.sqlite") as again:
        bench.imager = again
        again.sightings.add([sighting(100)])
        worker = bench.worker()
        step(worker)
        own = again.outbox.position().installation
        assert own != former
        step(worker)
        assert [found.reason for found in bench.hub.feeds.quarantine()] == ["second_installation"]
        assert "hub_refuses" in bench.codes()
        bench.hub.feeds.accept_installation("roof", own, now=NOW)
        bench.clock.advance(100.0)
        send_all(worker)
        assert len(bench.hub.sightings.find("roof")) == 8
        assert bench.codes() == set()


def put_back(folder: Path, copy: bytes) -> None:
    for ending in ("", "-wal", "-shm"):
        (folder / f"roof.sqlite{ending}").unlink(missing_ok=True)
    (folder / "roof.sqlite").write_bytes(copy)


def test_an_imager_that_was_put_back_while_the_hub_was_away_loses_no_row(bench: Bench, tmp_path: Path) -> None:
    """Its new rows have the numbers of others that the hub has: they must not count as sent."""
    send_all(bench.worker())
    bench.imager.close()
    copy = (tmp_path / "roof.sqlite").read_bytes()
    with open_hub_archive(tmp_path / "roof.sqlite") as before:
        bench.imager = before
        before.sightings.add(sighting(n) for n in range(22))
        send_all(bench.worker())
    put_back(tmp_path, copy)
    with open_hub_archive(tmp_path / "roof.sqlite") as again:
        bench.imager = again
        worker = bench.worker()
        bench.wire.faults = ["cut"] * 30
        for n in range(100, 140):
            again.sightings.add([sighting(n)])
            step(worker)
        assert bench.wire.faults == []
        assert "hub_refuses" in bench.codes()
        bench.hub.feeds.accept_installation("roof", again.outbox.position().installation, now=NOW)
        bench.clock.advance(100.0)
        send_all(worker)
        assert len(bench.hub.sightings.find("roof")) == 62  # what the copy did not have, too
        assert again.outbox.waiting() == 0
        assert bench.codes() == set()


def test_a_database_that_is_put_back_while_the_worker_runs_is_noticed(bench: Bench, tmp_path: Path) -> None:
    send_all(bench.worker())
    bench.imager.close()
    copy = (tmp_path / "roof.sqlite").read_bytes()
    worker = None
    with open_hub_archive(tmp_path / "roof.sqlite") as before:
        bench.imager = before
        before.sightings.add(sighting(n) for n in range(5))
        worker = bench.worker()
        send_all(worker)
    put_back(tmp_path, copy)
    with open_hub_archive(tmp_path / "roof.sqlite") as again:
        bench.imager = again
        worker.camera = bench.worker().camera
        again.sightings.add(sighting(n) for n in range(100, 105))
        step(worker)
        assert "hub_refuses" in bench.codes()
        assert again.outbox.waiting() == 7  # nothing is forgotten


def test_a_database_that_was_put_together_without_its_triggers_is_sent_whole(bench: Bench, tmp_path: Path) -> None:
    worker = bench.worker()
    send_all(worker)
    former = bench.imager.outbox.position().installation
    with closing(sqlite3.connect(tmp_path / "roof.sqlite")) as hand, hand:
        for name, _ in outbox_triggers():
            hand.execute(f'DROP TRIGGER "{name}"')
    bench.imager.sightings.add([sighting(1)])
    assert bench.imager.outbox.waiting() == 0
    bench.clock.advance(61.0)
    step(worker)
    assert bench.imager.outbox.position().installation != former
    bench.hub.feeds.accept_installation("roof", bench.imager.outbox.position().installation, now=NOW)
    bench.clock.advance(61.0)
    send_all(worker)
    assert bench.hub.sightings.find("roof") == bench.imager.sightings.find("roof")


NO_NUMBERS = ["9e18", "1e2", "4.0", "-2", "NaN", "Infinity", '"4"', "true", "null", "[4]", "{}", f"{2**63}"]
NOT_SENT = ["3", "7", "9000000000000000000"]


@pytest.mark.parametrize("committed", [*NO_NUMBERS, *NOT_SENT])
@pytest.mark.parametrize("agreed", [False, True])
def test_an_answer_that_no_hub_can_give_is_said_and_queues_and_forgets_nothing(
    bench: Bench, tmp_path: Path, committed: str, *, agreed: bool
) -> None:
    send_all(bench.worker())
    bench.imager.sightings.add(sighting(n) for n in range(3))
    before = [row.seq for row in bench.imager.outbox.rows(most=100, most_bytes=10**6)]
    position = bench.imager.outbox.position()
    assert (position.committed, before) == (3, [4, 5, 6])
    first = [taken(3)] if agreed else []
    with answering(*first, *[taken(committed)] * 12) as url:
        worker = connected(bench, url, tmp_path)
        worker._status_s = math.inf  # no status of its own
        assert [step(worker) for _ in range(4)] == [5.0, 10.0, 20.0, 40.0]
        assert [row.seq for row in bench.imager.outbox.rows(most=100, most_bytes=10**6)] == before
        assert bench.imager.outbox.position().installation == position.installation
        assert bench.codes() == {"hub_answer_invalid"}
    worker.send = bench.wire
    send_all(worker)
    assert bench.codes() == set()
    assert bench.hub.sightings.find("roof") == bench.imager.sightings.find("roof")


@pytest.mark.parametrize("committed", [-1, 0, 2])
def test_one_number_for_every_question_queues_all_rows_once(bench: Bench, tmp_path: Path, committed: int) -> None:
    """It may be a hub's that was put back; that it takes nothing afterwards is no hub's."""
    send_all(bench.worker())
    with answering(*[taken(committed)] * 24) as url:
        worker = connected(bench, url, tmp_path)
        assert [step(worker) for _ in range(8)] == [5.0, 10.0, 20.0, 40.0, *[60.0] * 4]
        assert {row.seq for row in bench.imager.outbox.rows(most=100, most_bytes=10**6)} <= {*range(4, 9)}
        assert bench.codes() == {"hub_answer_invalid"}


@pytest.mark.parametrize("answer", ["200 OK\r\ncontent-length: 9\r\n\r\n<p>hi</p>", f"200 OK\r\n\r\n{'[' * 60_000}"])
def test_a_page_in_place_of_an_answer_is_said(bench: Bench, tmp_path: Path, answer: str) -> None:
    with answering(answer) as url:
        assert step(connected(bench, url, tmp_path)) == 5.0
    assert bench.codes() == {"hub_answer_invalid"}


def test_a_hub_that_is_silent_for_long_is_a_condition_and_is_asked_at_most_once_a_minute(bench: Bench) -> None:
    worker, bench.wire.faults = bench.worker(), ["cut"] * 100
    waits = [step(worker) for _ in range(12)]
    assert waits[:3] == [5.0, 10.0, 20.0]
    assert max(waits) == LONGEST_WAIT_S
    assert bench.codes() == set()
    bench.clock.advance(SILENT_S)
    step(worker)
    assert bench.codes() == {"hub_unreachable"}
    bench.wire.faults.clear()
    step(worker)
    assert bench.codes() == set()


def test_it_runs_until_it_is_stopped(bench: Bench) -> None:
    stop, beats = threading.Event(), []

    def beat() -> None:
        beats.append(1)
        if len(beats) > 20:
            stop.set()

    bench.worker().run(stop, beat)
    assert len(beats) >= 20
    assert bench.imager.outbox.waiting() == 0


@contextmanager
def slow_hub(hub: HubArchive, *, reads_bytes_per_s: float = 1e9, answers_bytes_per_s: float = 1e9) -> Iterator[str]:
    """Yield the address of a hub that reads requests, and writes answers, only so fast."""
    ended = threading.Event()

    def read(channel: socket.socket, count: int) -> bytes:
        content = b""
        while len(content) < count:
            part = channel.recv(min(max(int(reads_bytes_per_s * _TICK_S), 1), count - len(content)))
            if not part or ended.wait(_TICK_S if reads_bytes_per_s < 1e6 else 0.0):
                raise ConnectionResetError
            content += part
        return content

    def answer(channel: socket.socket) -> None:
        with suppress(OSError), channel:
            first, *lines = head_of(channel)
            headers = {name.lower(): value for name, value in (line.split(": ", 1) for line in lines)}
            after = int(first.split("after=")[1].split(" ")[0])
            rows = read_feed_lines(gzip.decompress(read(channel, int(headers["content-length"]))), after=after)
            batch = FeedBatch(camera="roof", installation=headers["sunarc-installation"], after=after, rows=rows)
            body = json.dumps({"committed": hub.feeds.take(batch, now=NOW)}).encode()
            for byte in b"HTTP/1.1 200 OK\r\ncontent-length: %d\r\n\r\n%s" % (len(body), body):
                channel.sendall(bytes([byte]))
                if answers_bytes_per_s < 1e6 and ended.wait(1.0 / answers_bytes_per_s):
                    return

    def accept() -> None:
        with suppress(OSError):
            while True:
                channel, _ = listening.accept()
                threading.Thread(target=answer, args=(channel,), daemon=True).start()

    with socket.socket() as listening:
        listening.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)  # else the kernel reads in its place
        listening.bind(("127.0.0.1", 0))
        listening.listen()
        threading.Thread(target=accept, daemon=True).start()
        yield f"http://127.0.0.1:{listening.getsockname()[1]}"
        ended.set()
        listening.shutdown(socket.SHUT_RDWR)


def head_of(channel: socket.socket) -> list[str]:
    head = b""
    while not head.endswith(b"\r\n\r\n"):
        head += channel.recv(1)
    return head.decode().strip().split("\r\n")


def connected(bench: Bench, url: str, folder: Path) -> FeedWorker:
    (folder / "token").write_text("a token\n")
    clock = SystemClock()
    hub = HubConnection(HubOptions(url=url, token_file=folder / "token"), camera="roof", clock=clock)
    camera = CameraArchive(bench.imager, name="roof", site=Site(latitude=36.6, longitude=-97.5))
    return FeedWorker(
        camera=camera, send=hub.send, ask=bench.wire.ask, clock=clock, board=bench.board, asked_s=hub.wait_s
    )


@pytest.mark.waits
def test_a_hub_that_answers_a_byte_a_second_holds_up_neither_the_worker_nor_the_watchdog(
    bench: Bench, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(hub_connection, "_WITHIN_S", 3.0)
    clock, stop, beats = SystemClock(), threading.Event(), [SystemClock().monotonic()]
    with slow_hub(bench.hub, answers_bytes_per_s=1.0) as url:
        worker = connected(bench, url, tmp_path)
        supervised = Supervised(
            name="feed", make_worker=lambda: worker, options=SupervisorOptions(stale_after_s=5.0), optional=True
        )
        supervisor = Supervisor([supervised], clock=clock, board=bench.board)
        begun_s = clock.monotonic()
        assert worker.step(lambda: beats.append(clock.monotonic())) == 5.0
        assert 2.9 < clock.monotonic() - begun_s < 4.5
        assert max(later - former for former, later in pairwise(beats)) < 2.0
        supervisor.start()
        for _ in range(12):
            clock.wait(stop, 0.5)
            assert supervisor.check()
            assert bench.codes() == set()  # it is stuck nowhere
        supervisor.stop()
    assert bench.imager.outbox.waiting() > 0


@pytest.mark.slow
@pytest.mark.waits
def test_five_hundred_rows_drain_through_two_kilobytes_a_second(
    bench: Bench, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """All of them take longer than one exchange may: some must go at once, however few."""
    monkeypatch.setattr(hub_connection, "_WITHIN_S", 4.0)
    monkeypatch.setattr(feed, "_QUICK_S", 1.0)
    chance = random.Random(1)
    bench.imager.sightings.add(sighting(n, x_px=chance.random(), y_px=chance.random()) for n in range(500))
    with slow_hub(bench.hub, reads_bytes_per_s=2000.0) as url:
        worker, unfinished = connected(bench, url, tmp_path), 0
        while bench.imager.outbox.waiting():
            unfinished += step(worker) > 0.0
            assert unfinished < 8
    assert unfinished >= 1
    assert len(bench.hub.sightings.find("roof")) == 500
    assert bench.hub.feeds.quarantine() == ()


def taken(committed: object) -> str:
    """Return a hub's answer, with whatever stands in the place of the number."""
    body = f'{{"committed": {committed}}}'
    return f"200 OK\r\ncontent-length: {len(body)}\r\n\r\n{body}"


@contextmanager
def answering(*answers: str) -> Iterator[str]:
    """Yield the address of a hub that gives these answers one after the other, whatever it is sent."""
    with socket.create_server(("127.0.0.1", 0)) as listening:

        def say() -> None:
            with suppress(OSError):
                for answer in answers:
                    channel, _ = listening.accept()
                    with channel:
                        channel.recv(65_536)
                        channel.sendall(f"HTTP/1.1 {answer}".encode())

        thread = threading.Thread(target=say)
        thread.start()
        yield f"http://127.0.0.1:{listening.getsockname()[1]}"
        listening.shutdown(socket.SHUT_RDWR)
        thread.join()


@pytest.mark.parametrize("status", [408, 504])
def test_an_answer_that_it_took_too_long_makes_batches_smaller(bench: Bench, tmp_path: Path, status: int) -> None:
    bench.imager.sightings.add(sighting(n) for n in range(7))
    with answering(taken(0), f"{status} No\r\ncontent-length: 0\r\n\r\n") as url:
        worker = connected(bench, url, tmp_path)
        assert step(worker) == 5.0
    waiting = bench.imager.outbox.waiting()
    worker.send = bench.wire
    step(worker)
    assert bench.imager.outbox.waiting() == waiting - waiting // 2


@pytest.mark.parametrize(
    ("status", "asked", "least_s", "most_s"),
    [
        ("429 No", "33", 32.0, 33.0),
        ("503 No", "40", 39.0, 40.0),
        ("503 No", "2", 5.0, 5.0),
        ("503 No", "86400", 599.0, 600.0),
        ("503 No", "Thu, 26 Nov 2026 09:00:00 GMT", 5.0, 5.0),
        ("200 OK", "21", 20.0, 21.0),
    ],
)
def test_a_worker_waits_as_long_as_the_hub_asks(  # noqa: PLR0917 - of an answer
    bench: Bench, tmp_path: Path, status: str, asked: str, least_s: float, most_s: float
) -> None:
    bench.imager.sightings.add([sighting(1)])
    body = json.dumps({"committed": 0})
    head = f"{status}\r\nretry-after: {asked}\r\ncontent-length: {len(body)}\r\n\r\n{body}"
    with answering(head) as url:
        worker = connected(bench, url, tmp_path)
        assert least_s <= step(worker) <= most_s
    worker.asked_s = lambda: 0.0  # the time has passed
    worker.send = bench.wire
    send_all(worker)
    assert bench.hub.sightings.find("roof") == bench.imager.sightings.find("roof")


def test_one_row_has_as_long_as_its_size_needs(bench: Bench, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """It cannot be sent in parts: with the limit of all others it would never arrive."""
    monkeypatch.setattr(hub_connection, "_WITHIN_S", 1.0)
    text = random.Random(1).randbytes(3000).hex()
    send_all(bench.worker())
    bench.imager.events.add(Event(time=NOON, kind="test", severity="info", text=text, camera="roof"))
    with slow_hub(bench.hub, reads_bytes_per_s=2000.0) as url:
        worker = connected(bench, url, tmp_path)
        for _ in range(3):
            step(worker)
            if not bench.imager.outbox.waiting():
                break
    assert [event.text for event in bench.hub.events.find("roof")] == [text]


def test_a_proxy_that_the_environment_names_is_used(
    bench: Bench, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("no_proxy", raising=False)
    with slow_hub(bench.hub) as proxy:
        monkeypatch.setenv("http_proxy", proxy)
        worker = connected(bench, "http://hub.invalid", tmp_path)
        while step(worker) == 0.0:
            pass
    assert bench.imager.outbox.waiting() == 0


@pytest.mark.parametrize("answer", [b"HTTP/1.1 200 OK\r\n\r\n", b"HTTP/1.1 403 Forbidden\r\n\r\n"])
def test_tls_goes_through_a_proxy_in_a_tunnel(
    bench: Bench, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, answer: bytes
) -> None:
    monkeypatch.delenv("no_proxy", raising=False)
    certificate(tmp_path)
    monkeypatch.setenv("SSL_CERT_FILE", str(tmp_path / "cert.pem"))
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    context.load_cert_chain(tmp_path / "cert.pem", tmp_path / "key.pem")
    asked: list[str] = []

    def tunnel() -> None:
        channel, _ = listening.accept()
        with suppress(OSError), channel:
            asked.append(head_of(channel)[0])
            channel.sendall(answer)
            with context.wrap_socket(channel, server_side=True) as inner:
                asked.append(head_of(inner)[0].split("?")[0])
                inner.sendall(b"HTTP/1.1 401 Unauthorized\r\ncontent-length: 0\r\n\r\n")

    with socket.create_server(("127.0.0.1", 0)) as listening:
        monkeypatch.setenv("https_proxy", f"127.0.0.1:{listening.getsockname()[1]}")
        thread = threading.Thread(target=tunnel)
        thread.start()
        assert step(connected(bench, "https://127.0.0.1:4444", tmp_path)) == 5.0
        thread.join()
    opened = b" 200 " in answer
    assert asked == ["CONNECT 127.0.0.1:4444 HTTP/1.1", *(["PUT /v1/cameras/roof/feed"] if opened else [])]
    assert bench.codes() == ({"hub_refuses"} if opened else set())


@pytest.mark.parametrize("url", ["", "fleet.example", "ftp://x", "http://", "https://a?b=c", "https://me@x"])
def test_an_address_that_is_none_is_refused(url: str) -> None:
    with pytest.raises(InputError) as error:
        HubOptions(url=url, token_file=Path("x"))
    assert error.value.field == "hub.url"


def test_a_hub_needs_a_token_that_can_be_read(tmp_path: Path) -> None:
    with pytest.raises(InputError):
        HubOptions(url="https://fleet.example")
    with pytest.raises(ConfigurationError):
        HubConnection(
            HubOptions(url="https://fleet.example", token_file=tmp_path / "none"), camera="roof", clock=SystemClock()
        )
