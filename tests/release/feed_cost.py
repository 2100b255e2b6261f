"""What a hub pays for what arrives: its processor time of a small PUT, of a row, and of rows that are refused.

tests/long feed-cost [--puts N] [--bodies N]
"""

from __future__ import annotations

import argparse
import gzip
import http.client
import json
import os
import shutil
import tempfile
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from itertools import count
from pathlib import Path
from typing import Any

from tests.fixtures.fleet import new_imager, next_batch, sighting
from tests.fixtures.hub_process import HubProcess
from tests.fixtures.postgresql import TEMPLATE, running_server

from sunarc.hub.archive import open_hub_archive
from sunarc.hub.feed_routes import token_digest
from sunarc.imager.archive.database.schema import head_revision
from sunarc.imager.archive.feed_rows import FeedRow, feed_lines
from sunarc.imager.runtime.clock import SystemClock

Lines = Callable[[int, int], list[FeedRow]]
"""Makes so many rows that follow a number."""


class Sender:
    """A camera's connection to a hub."""

    def __init__(self, hub: HubProcess, camera: str, token: str) -> None:
        self._to = http.client.HTTPConnection(*hub.address, timeout=60.0)
        self._path = f"/v1/cameras/{camera}/feed?after="
        self._headers = {"authorization": f"Bearer {token}", "content-encoding": "gzip"}
        self._headers |= {"sunarc-installation": camera, "sunarc-revision": head_revision()}
        self.after = 0

    def put(self, rows: list[FeedRow]) -> int:
        return self.put_body(gzip.compress(feed_lines(rows), 4))

    def put_body(self, body: bytes) -> int:
        """Send, and return the status; wait where the hub asks for it."""
        self._to.request("PUT", f"{self._path}{self.after}", body, self._headers)
        answer = self._to.getresponse()
        text = answer.read()
        if answer.status == http.client.OK:
            self.after = int(json.loads(text)["committed"])
        return answer.status


def sightings_of(folder: Path, camera: str) -> tuple[list[FeedRow], dict[str, Any]]:
    """Return what comes before a camera's sightings, and the columns of one."""
    with new_imager(folder, camera) as imager:
        imager.sightings.add([sighting(0, camera=camera)])
        rows = next_batch(imager, camera).rows
    return list(rows), dict(rows[-1].data or {})


def rows_of(data: dict[str, Any], numbers: Iterator[int], **changes: Any) -> Lines:
    """Return what makes sightings; all but the last have the changes, or the sender would be asked to wait."""

    def made(after: int, n: int) -> list[FeedRow]:
        times = [int(data["time"]) + 30_000_000 * next(numbers) for _ in range(n)]
        return [
            FeedRow(seq=after + k, kind="sun_point", data=data | {"time": time} | (changes if k < n else {}))
            for k, time in enumerate(times, 1)
        ]

    return made


def cost_ms(hub: HubProcess, sender: Sender, lines: Lines, *, puts: int, rows: int) -> tuple[float, dict[int, int]]:
    """Return the hub's processor time of a PUT, ms, and how often it answered with which status."""
    made = [gzip.compress(feed_lines(lines(sender.after + k * rows, rows)), 4) for k in range(puts)]
    before_s, answers = hub.processor_s(), dict[int, int]()
    for body in made:
        status = sender.put_body(body)
        answers[status] = answers.get(status, 0) + 1
    return 1000.0 * (hub.processor_s() - before_s) / puts, answers


def main() -> None:
    """Measure and print, as JSON."""
    parser = argparse.ArgumentParser(prog="tests/long feed-cost", description=__doc__)
    parser.add_argument("--puts", type=int, default=1000, help="PUTs of one row")
    parser.add_argument("--bodies", type=int, default=20, help="PUTs of 1000 rows")
    asked = parser.parse_args()
    folder = Path(tempfile.mkdtemp(prefix="cost"))
    with ExitStack() as stack:
        stack.callback(shutil.rmtree, folder, ignore_errors=True)
        server = stack.enter_context(running_server())
        store = server.url(TEMPLATE)
        archive = stack.enter_context(open_hub_archive(store))
        now = SystemClock().now()
        for name in ("good", "bad"):
            archive.feeds.add_token(name, token_digest(f"a token of {name}"), now=now, former_until=now)
        hub = HubProcess(folder, store)
        stack.callback(hub.kill)
        hub.wait_until_it_answers()
        print(json.dumps({"load": os.getloadavg()[0]} | measured(hub, folder, asked.puts, asked.bodies)))


def measured(hub: HubProcess, folder: Path, puts: int, bodies: int) -> dict[str, object]:
    """Return the hub's processor time of a small PUT, of a good row and of contradicting ones, and its memory."""
    found: dict[str, object] = {}
    senders = {name: Sender(hub, name, f"a token of {name}") for name in ("good", "bad")}
    numbers = count(1)
    for name, sender in senders.items():
        first, data = sightings_of(folder, name)
        sender.put(first)
        for wrong in ({}, {"pose_epoch": "none"}, {"pose_epoch": "good-1"}, {"x_px": "1"}):
            if bool(wrong) == (name == "bad"):
                what = "_".join(f"{key}_{value}" for key, value in wrong.items()) or "good"
                lines = rows_of(data, numbers, **wrong)
                cost_ms(hub, sender, lines, puts=2, rows=1000)
                found[f"{what}_row_us"] = round(cost_ms(hub, sender, lines, puts=bodies, rows=1000)[0])
                if not wrong:
                    cost_ms(hub, sender, lines, puts=20, rows=1)
                    a_put, answers = cost_ms(hub, sender, lines, puts=puts, rows=1)
                    found |= {"put_ms": round(a_put, 2), "answers": answers}
    found["memory_mib"] = hub.memory_mib()
    for body in (
        b"\n" * 15_000_000,
        b'{"seq": 1, "kind": "status", "data": {"x": [' + b"[]," * 5_000_000 + b"[]]}}",
        b"x" * 70_000_000,
    ):
        senders["bad"].put_body(gzip.compress(body))
    found["memory_after_hostile_bodies_mib"] = hub.memory_mib()
    return found


if __name__ == "__main__":
    main()
