"""Imagers that catch up wait for one another, and those that send a row do not wait for them."""

from __future__ import annotations

import asyncio
import random
import threading
from pathlib import Path

import httpx
import pytest
from tests.fixtures.archive import make_empty
from tests.fixtures.fleet import NOW

from sunarc.hub.archive import open_hub_archive
from sunarc.hub.feed_routes import LARGE_AT_ONCE, LARGE_BYTES, FeedReceiver, SentBody
from sunarc.hub.serving import create_hub_app
from sunarc.imager.archive.database.schema import head_revision
from sunarc.imager.runtime.status import StatusSnapshot
from sunarc.imager.web.options import ApiOptions

CAMERAS = 60  # more than the pool has threads
SMALL = b"a row"


class Storing:
    """Takes bodies in place of the archive: large ones not before they may."""

    def __init__(self) -> None:
        self.go_on, self.full = threading.Event(), threading.Event()
        self.largest = self.now = 0
        self._lock = threading.Lock()

    def take(self, sent: SentBody, *, large: bool) -> int:
        after = sent.after
        if not large:
            return after
        with self._lock:
            self.now += 1
            self.largest = max(self.largest, self.now)
            if self.now == LARGE_AT_ONCE:
                self.full.set()
        self.go_on.wait(20.0)
        with self._lock:
            self.now -= 1
        return after


def test_small_bodies_are_stored_while_more_large_ones_wait_than_there_are_threads(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    storing = Storing()
    monkeypatch.setattr(FeedReceiver, "take", lambda _self, sent, **how: storing.take(sent, **how))
    monkeypatch.setattr(FeedReceiver, "require_token", lambda *_: None)
    make_empty(tmp_path / "hub.sqlite")
    large = random.Random(0).randbytes(LARGE_BYTES + 1)

    async def scenario() -> tuple[int, list[int]]:
        status = StatusSnapshot(version="1", started_at=NOW)
        options = ApiOptions(allowed_hosts=("imager",))
        app = create_hub_app(archive=archive, status=lambda: status, now=lambda: NOW, options=options)
        transport = httpx.ASGITransport(app=app)
        async with httpx.AsyncClient(transport=transport, base_url="http://imager", timeout=20.0) as client:

            async def put(number: int, body: bytes) -> int:
                headers = {"sunarc-installation": "here", "sunarc-revision": head_revision()}
                path = f"/v1/cameras/c{number}/feed?after=0"
                return (await client.put(path, content=body, headers=headers)).status_code

            waiting = [asyncio.create_task(put(number, large)) for number in range(CAMERAS)]
            await asyncio.to_thread(storing.full.wait, 20.0)
            small = await asyncio.wait_for(put(CAMERAS, SMALL), 10.0)
            assert not any(task.done() for task in waiting)
            storing.go_on.set()
            return small, [await task for task in waiting]

    with open_hub_archive(tmp_path / "hub.sqlite") as archive:
        small, others = asyncio.run(scenario())
    assert (small, set(others)) == (200, {200})
    assert storing.largest == LARGE_AT_ONCE
