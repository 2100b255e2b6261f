"""The line that `systemctl status` shows."""

from __future__ import annotations

import os
import socket
import tempfile
from collections.abc import Iterator
from datetime import datetime, timedelta
from pathlib import Path

import pytest
from tests.fixtures.board import START

from sunarc.imager.app.status_line import FirstFrame, StatusLine
from sunarc.imager.runtime.clock import VirtualClock
from sunarc.imager.runtime.host import Notifier
from sunarc.imager.runtime.status import Reason, StatusRegistry


@pytest.fixture
def manager() -> Iterator[socket.socket]:
    """Return the socket of a service manager that listens."""
    with tempfile.TemporaryDirectory() as folder, socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as listening:
        listening.bind(str(Path(folder) / "notify"))
        listening.setblocking(False)
        yield listening


@pytest.fixture
def line(manager: socket.socket, board: StatusRegistry, clock: VirtualClock) -> StatusLine:
    notifier = Notifier(os.fsdecode(manager.getsockname()))
    return StatusLine(notifier, snapshot=board.snapshot, address="http://127.0.0.1:8080/", monotonic=clock.monotonic)


def heard(manager: socket.socket) -> list[str]:
    messages = []
    while True:
        try:
            messages.append(manager.recv(4096).decode())
        except BlockingIOError:
            return messages


def reason(code: str) -> Reason:
    return Reason(code=code, severity="degraded", text="text", remedy="remedy")


def test_it_tells_address_health_last_sighting_and_conditions(
    line: StatusLine, board: StatusRegistry, clock: VirtualClock, manager: socket.socket
) -> None:
    line.ready()
    assert heard(manager) == ["READY=1\nSTATUS=serving at http://127.0.0.1:8080/; ready; no sighting yet"]
    board.note(last_sighting_at=START)
    board.set_condition("camera_lost", reason("camera_lost"))
    clock.advance(10.0)
    line.update()
    (told,) = heard(manager)
    assert told.removeprefix("STATUS=serving at http://127.0.0.1:8080/; ") == (
        "degraded; last sighting 2026-05-01 12:00:00 UTC; conditions: camera_lost"
    )


def test_it_is_sent_when_it_has_changed_and_at_most_every_ten_seconds(
    line: StatusLine, board: StatusRegistry, clock: VirtualClock, manager: socket.socket
) -> None:
    line.update()
    assert heard(manager) == []  # not ready yet
    line.ready()
    heard(manager)
    board.set_condition("camera_lost", reason("camera_lost"))
    clock.advance(9.9)
    line.update()
    assert heard(manager) == []
    clock.advance(0.1)
    line.update()
    assert len(heard(manager)) == 1
    for _ in range(5):
        clock.advance(60.0)
        line.update()
    assert heard(manager) == []


def test_more_than_four_conditions_are_counted(line: StatusLine, board: StatusRegistry) -> None:
    for code in "abcdef":
        board.set_condition(code, reason(code))
    assert line.text().endswith("conditions: a, b, c, d and 2 more")


@pytest.mark.parametrize("before", [None, START - timedelta(hours=1)])
def test_a_service_is_not_called_ready_before_its_first_frame(board: StatusRegistry, before: datetime | None) -> None:
    if before is not None:
        board.note(last_frame_at=before)  # of the store, from before a restart
    first = FirstFrame(board)
    first.check()
    assert [reason.code for reason in board.snapshot().reasons] == ["no_frame_yet"]
    assert board.snapshot().health == "degraded"
    board.note(last_frame_at=START)
    first.check()
    assert board.snapshot().health == "ready"
