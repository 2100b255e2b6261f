"""The example sender, made from docs/feed.md alone, beside a hub that is killed."""

from __future__ import annotations

import json
import socket
import subprocess
import sys
import threading
from pathlib import Path

import pytest
from tests.fixtures.feed_cases import STATUS_ROW, good_rows
from tests.fixtures.hub_process import HubProcess
from tests.fixtures.postgresql import TEMPLATE, running_server

from sunarc.hub.archive import open_hub_archive
from sunarc.hub.feed_routes import token_digest
from sunarc.imager.archive.feed_rows import REMOVED
from sunarc.imager.runtime.clock import SystemClock

pytestmark = [pytest.mark.system, pytest.mark.slow]
SENDER = Path(__file__).parents[2] / "deploy" / "hub" / "sender.py"
COUNT = 3000
WRONG = 100
"""Every so many sightings one names a pose epoch that there is not."""


def lines(folder: Path) -> str:
    """Return rows of every kind, as the sender's file has them."""
    rows = [row for row in good_rows(folder) if not row[0].endswith(REMOVED)]
    sighting = dict(rows)["sun_point"]
    many = [
        {**sighting, "time": sighting["time"] + 30_000_000 * n, "pose_epoch": "roof-1" if n % WRONG else "none"}
        for n in range(1, COUNT + 1)
    ]
    every = [*rows, *(("sun_point", one) for one in many)]
    return "".join(json.dumps({"kind": kind, "data": data}) + "\n" for kind, data in every)


def test_the_example_sends_every_row_once_while_the_hub_is_killed(tmp_path: Path) -> None:
    (tmp_path / "rows").write_text(lines(tmp_path))
    (tmp_path / "token").write_text("the token of the roof\n")
    (tmp_path / "stranger").write_text("the token of another\n")
    with running_server() as server, open_hub_archive(server.url(TEMPLATE)) as archive:
        now = SystemClock().now()
        archive.feeds.add_token("roof", token_digest("the token of the roof"), now=now, former_until=now)
        hub = HubProcess(tmp_path, server.url(TEMPLATE))
        try:
            hub.wait_until_it_answers()
            command = [sys.executable, str(SENDER), hub.url, "roof"]
            refused = subprocess.run(
                [*command, tmp_path / "stranger", tmp_path / "rows"], capture_output=True, text=True, check=False
            )
            assert (refused.returncode, "401" in refused.stderr) == (1, True)
            with subprocess.Popen([*command, tmp_path / "token", tmp_path / "rows"]) as sending:
                while not archive.sightings.find("roof", limit=1):
                    assert sending.poll() in {None, 0}
                    threading.Event().wait(0.01)
                hub.kill()
                hub.start()
                assert sending.wait(60.0) == 0
            found = archive.sightings.find("roof")
            assert len(found) == COUNT + 1 - COUNT // WRONG
            apart = archive.feeds.quarantine("roof")
            assert {one.reason for one in apart} == {"contradiction", "forged_token"}
            assert subprocess.run([*command, tmp_path / "token", tmp_path / "rows"], check=False).returncode == 0
            assert archive.sightings.find("roof") == found
            (listed,) = archive.feeds.fleet()
            assert listed.status == STATUS_ROW
        finally:
            hub.kill()


def test_an_answer_that_is_cut_off_is_asked_for_again(tmp_path: Path) -> None:
    """A hub that is killed may have sent the head of its answer."""
    whole = b'{"committed": 0}'
    head = b"HTTP/1.1 200 OK\r\ncontent-length: %d\r\nconnection: close\r\n\r\n" % len(whole)
    (tmp_path / "rows").write_text("")
    (tmp_path / "token").write_text("a token")
    with socket.create_server(("127.0.0.1", 0)) as listening:
        url = f"http://127.0.0.1:{listening.getsockname()[1]}"
        command = [sys.executable, str(SENDER), url, "roof", str(tmp_path / "token"), str(tmp_path / "rows")]
        with subprocess.Popen(command) as sending:
            for body in (b"", whole[:5], whole):
                channel, _ = listening.accept()
                with channel:
                    channel.recv(65_536)
                    channel.sendall(head + body)
            assert sending.wait(30.0) == 0
