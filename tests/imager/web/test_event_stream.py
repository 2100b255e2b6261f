"""What happens, told as it happens: over real sockets, with listeners that come, go, are cut off and never read."""

from __future__ import annotations

import asyncio
import json
import socket
import threading
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import replace
from datetime import timedelta
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any, cast

import httpx
import pytest
import uvicorn
from tests.fixtures.calibrations import SITE
from tests.fixtures.served import NOON, document

from sunarc.client import Imager, ImagerEvent
from sunarc.imager.archive.values import CameraRecord, Event
from sunarc.imager.runtime.status import Reason, WorkerStatus
from sunarc.imager.web import app
from sunarc.imager.web.middleware.connection_limit import bound_connections
from sunarc.imager.web.options import ApiOptions
from sunarc.imager.web.routes import record as event_stream
from sunarc.imager.web.routes.record import Follower

if TYPE_CHECKING:
    from tests.fixtures.served import Made, Make

    from sunarc.imager.web.context import ApiContext

PATH = "/v1/events/stream"
PATIENCE_S = 20.0
DUSTY = Reason(code="dusty", severity="degraded", text="the dome is dusty", remedy="wipe it")


@contextmanager
def serving(made: Made) -> Iterator[str]:
    with socket.create_server(("127.0.0.1", 0)) as listening:
        config = uvicorn.Config(made.app, log_level="critical", timeout_graceful_shutdown=1)
        server = uvicorn.Server(bound_connections(config, ApiOptions(request_within_s=1.0)))
        thread = threading.Thread(target=server.run, kwargs={"sockets": [listening]})
        thread.start()
        try:
            yield f"http://127.0.0.1:{listening.getsockname()[1]}"
        finally:
            server.should_exit = True
            thread.join()


@pytest.fixture(autouse=True)
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(event_stream, "_POLL_S", 0.05)
    monkeypatch.setattr(event_stream, "_HEARTBEAT_S", 0.2)


def store(made: Made, kind: str, **more: Any) -> Event:  # noqa: ANN401 - of Event
    return made.archive.events.add(Event(time=NOON, kind=kind, severity="info", text="it was", **more))


def next_of(events: Iterator[ImagerEvent], kind: str) -> ImagerEvent:
    return next(event for event in events if event.kind == kind)


def test_each_kind_is_told_as_it_happens(made: Made) -> None:
    with serving(made) as address:
        events = Imager(address).events()
        first = next(events)
        ready = {"health": "ready", "state": "ready", "state_text": "ready"}
        assert (first.kind, first.data) == ("state", ready | {"calibration": "second", "conditions": []})
        made.board.set_condition("dusty", DUSTY)
        dusty = next(events)
        assert (dusty.kind, dusty.data["remedy"], dusty.data["since"]) == (
            "condition_set",
            "wipe it",
            "2013-05-13T09:30:00Z",
        )
        made.board.set_condition("dusty", None)
        assert next(events).kind == "condition_cleared"
        for kind in ("bump", "day"):
            stored = store(made, kind, camera="roof")
            told = next(events)
            assert (told.kind, told.data["id"]) == (kind, stored.id)
        store(made, "clock_step")
        assert next(events).data["kind"] == "clock_step"
        made.archive.calibrations.reinstate("first", at=NOON, reason="a test")
        reinstated, changed = next(events), next(events)
        assert reinstated.data["kind"] == "calibration_reinstated"
        current = made.archive.calibrations.current("roof")
        assert current is not None
        assert (changed.kind, changed.data) == ("calibration", {"calibration": current.id, "previous": "second"})
        made.board.set_worker(WorkerStatus(name="capture", state="failed"))
        assert next(events).data == {"name": "capture", "state": "failed"}
        made.board.note(last_frame_at=NOON + timedelta(seconds=30))
        assert next(events).data == {"time": "2013-05-13T18:30:30Z"}
        made.board.set_condition("camera_moved", replace(DUSTY, code="camera_moved", severity="note"))
        noted = next(events)
        assert (noted.kind, noted.data["health"], noted.data["state"]) == ("state", "ready", "attention")


def test_who_was_cut_off_hears_what_was_missed_and_nothing_twice(made: Made) -> None:
    with serving(made) as address:
        before = next(Imager(address).events())
        made.archive.cameras.save(CameraRecord.at(SITE, name="another", width=4, height=4))
        missed = [store(made, "day", camera="roof"), store(made, "bump", camera="another"), store(made, "bump")]
        made.archive.calibrations.add(document("third", valid_from=NOON - timedelta(hours=2)))
        made.archive.calibrations.activate("third")
        events = Imager(address).events(after=before.id)
        state, day, bump, calibration = (next(events) for _ in range(4))
        assert (state.kind, state.id) == ("state", before.id)
        assert [day.data["id"], bump.data["id"]] == [missed[0].id, missed[2].id]
        assert (calibration.kind, calibration.data["calibration"]) == ("calibration", "third")
        again = Imager(address).events(after=bump.id)  # cut off between two messages
        assert [next(again).kind for _ in range(2)] == ["state", "calibration"]
        later = Imager(address).events(after=calibration.id)
        next(later)
        store(made, "day")
        assert next(later).kind == "day"


def test_of_very_many_the_newest_are_told(made: Made, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(event_stream, "_MOST_MISSED", 3)
    stored = [store(made, "day") for _ in range(9)]
    with serving(made) as address:
        events = Imager(address).events(after="0.second")
        next(events)
        assert [next(events).data["id"] for _ in range(3)] == [event.id for event in stored[-3:]]


def test_the_client_comes_back_after_the_service_was_away(made: Made) -> None:
    with serving(made) as address:
        events = Imager(address, retries=6).events()
        next(events)
        port = int(address.rpartition(":")[2])
    stored = store(made, "day")
    with socket.create_server(("127.0.0.1", port)) as listening:
        server = uvicorn.Server(uvicorn.Config(made.app, log_level="critical", timeout_graceful_shutdown=1))
        thread = threading.Thread(target=server.run, kwargs={"sockets": [listening]})
        thread.start()
        assert next_of(events, "day").data["id"] == stored.id
        server.should_exit = True
        thread.join()


def test_a_quiet_stream_gives_signs_of_life_and_hardly_any_bytes(made: Made) -> None:
    with serving(made) as address, httpx.stream("GET", address + PATH, timeout=60.0) as answer:
        assert answer.headers["content-type"].startswith("text/event-stream")
        assert answer.headers["cache-control"] == "no-cache"
        lines = answer.iter_lines()
        told = [next(lines) for _ in range(12)]
    assert told[0] == "retry: 3000"
    assert told.count(":") >= 3
    assert json.loads(told[3].removeprefix("data: "))["health"] == "ready"
    assert sum(len(line) + 1 for line in told[5:]) < 20


def test_head_has_the_headers_and_ends(made: Made) -> None:
    answer = made.client.request("HEAD", PATH)
    assert (answer.status_code, answer.content) == (200, b"")
    assert answer.headers["content-type"].startswith("text/event-stream")


@pytest.mark.parametrize("given", ["yesterday", "-1.second", "1", "9" * 40 + ".a"])
def test_an_id_that_is_none_is_refused(made: Made, given: str) -> None:
    answer = made.client.get(PATH, headers={"last-event-id": given})
    assert (answer.status_code, answer.json()["errors"][0]["field"]) == (422, "last-event-id")


def test_a_camera_that_is_unknown_has_no_stream(made: Made) -> None:
    assert made.client.get("/v1/cameras/cellar/events/stream").status_code == 404
    assert made.client.get(PATH, params={"only": "day"}).status_code == 422


def listening(address: str, *, client: str | None = None) -> socket.socket:
    host, _, port = address.removeprefix("http://").partition(":")
    connection = socket.create_connection((host, int(port)), timeout=60.0)
    forwarded = f"x-forwarded-for: {client}\r\n" if client else ""
    connection.sendall(f"GET {PATH} HTTP/1.1\r\nhost: localhost\r\n{forwarded}\r\n".encode())
    return connection


def status_of(connection: socket.socket) -> int:
    return int(connection.recv(20).split()[1])


def test_listeners_are_bounded_shared_among_addresses_and_forgotten_when_they_go(
    make: Make, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(app, "_MOST_STREAMS", 3)
    made = make(history="filled", max_at_once=2)
    with serving(made) as address, ExitStack() as stack:
        greedy = [stack.enter_context(listening(address, client="192.0.2.1")) for _ in range(3)]
        assert [status_of(one) for one in greedy] == [200, 200, 200]
        with listening(address, client="192.0.2.1") as fourth:
            assert status_of(fourth) == 503
        with listening(address, client="198.51.100.7") as other:
            assert status_of(other) == 200  # the oldest of the address with most of them made room
        assert httpx.get(address + "/v1/calibration").status_code == 200  # streams are not counted as requests
        for one in greedy:
            one.close()
        deadline = time.monotonic() + 60.0  # noqa: TID251 - a test's own patience
        while time.monotonic() < deadline:  # noqa: TID251
            with listening(address, client="192.0.2.1") as again:
                if status_of(again) == 200:
                    break
        else:
            pytest.fail("the places of listeners that went were not given back")


def test_a_listener_that_never_reads_is_cut_off_and_holds_little(made: Made, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(event_stream, "_MOST_MISSED", 10**6)
    for _ in range(60):
        store(made, "day", details={"long": "x" * 200_000})
    with serving(made) as address, socket.socket() as deaf:
        deaf.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        deaf.settimeout(20.0)
        deaf.connect(("127.0.0.1", int(address.rpartition(":")[2])))
        deaf.sendall(f"GET {PATH} HTTP/1.1\r\nhost: localhost\r\nlast-event-id: 0.second\r\n\r\n".encode())
        time.sleep(3.0)  # noqa: TID251 - three times what an unread answer may wait
        received = 0
        with suppress(ConnectionResetError):
            while part := deaf.recv(1_000_000):
                received += len(part)
        assert received < 8_000_000  # of 12 MB


def test_a_stream_ends_when_the_service_stops(made: Made) -> None:
    names = {"archive": made.archive, "camera": "roof", "status": made.board.snapshot}
    context = cast("ApiContext", SimpleNamespace(**names, record_or_none=lambda _: None))

    async def all_of_it() -> list[str]:
        return [text async for text in event_stream.stream_messages(Follower(context, None), lambda: True)]

    (told,) = asyncio.run(all_of_it())
    assert "event: state" in told
