from __future__ import annotations

import logging
import os
import socket
import tempfile
import uuid
from collections.abc import Iterator
from pathlib import Path

import pytest

from sunarc.imager.runtime.host import Notifier, notifier_from, watchdog_interval_s


@pytest.fixture(params=["path", "abstract"])
def manager(request: pytest.FixtureRequest) -> Iterator[tuple[socket.socket, str]]:
    """Stand in for systemd: a datagram socket, and its name as NOTIFY_SOCKET gives it."""
    with tempfile.TemporaryDirectory() as folder, socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as inlet:
        name = str(Path(folder) / "notify") if request.param == "path" else f"@sunarc-{uuid.uuid4().hex}"
        inlet.bind("\0" + name[1:] if request.param == "abstract" else name)
        inlet.settimeout(10.0)
        yield inlet, name


def test_systemd_hears_the_four_things(manager: tuple[socket.socket, str]) -> None:
    inlet, name = manager
    notifier = notifier_from({"NOTIFY_SOCKET": name})
    notifier.ready("serving at\nport 8080")
    notifier.watchdog()
    notifier.status("a clear day")
    notifier.stopping()
    assert [inlet.recv(1000).decode() for _ in range(4)] == [
        "READY=1\nSTATUS=serving at port 8080",
        "WATCHDOG=1",
        "STATUS=a clear day",
        "STOPPING=1",
    ]


def test_without_systemd_nothing_is_sent_and_nothing_is_logged(caplog: pytest.LogCaptureFixture) -> None:
    notifier_from({}).ready("up")
    assert caplog.text == ""


def test_a_manager_that_is_gone_is_logged_and_forgiven(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    with caplog.at_level(logging.WARNING):
        Notifier(str(tmp_path / "nobody")).watchdog()
    assert "sd_notify WATCHDOG=1 failed" in caplog.text


def test_a_manager_that_does_not_listen_does_not_block_us(caplog: pytest.LogCaptureFixture) -> None:
    with tempfile.TemporaryDirectory() as folder, socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as inlet:
        inlet.bind(f"{folder}/notify")
        notifier = Notifier(f"{folder}/notify")
        for _ in range(10_000):  # far more than any socket's queue holds
            notifier.watchdog()
            if caplog.records:
                break
    assert "sd_notify WATCHDOG=1 failed" in caplog.text


@pytest.mark.parametrize(
    ("environment", "interval_s"),
    [
        ({}, None),
        ({"WATCHDOG_USEC": "30000000"}, 30.0),
        ({"WATCHDOG_USEC": "500000", "WATCHDOG_PID": str(os.getpid())}, 0.5),
        ({"WATCHDOG_USEC": "30000000", "WATCHDOG_PID": "1"}, None),
        ({"WATCHDOG_USEC": "0"}, None),
        ({"WATCHDOG_USEC": "soon"}, None),
        ({"WATCHDOG_USEC": ""}, None),
    ],
)
def test_the_watchdog_interval_is_ours_or_none(environment: dict[str, str], interval_s: float | None) -> None:
    assert watchdog_interval_s(environment, pid=os.getpid()) == interval_s
