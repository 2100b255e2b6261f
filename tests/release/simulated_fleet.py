"""Imagers that feed one hub over HTTP on loopback, through links that fail; the hub and PostgreSQL fail too.

The short form is a test. The long one:

    tests/long fleet [--imagers N] [--minutes M] [--rows R] [--rate-rows N]
"""

from __future__ import annotations

import argparse
import json
import os
import random
import shutil
import sys
import tempfile
import threading
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from pathlib import Path
from time import perf_counter, process_time

from sqlalchemy import URL
from tests.fixtures.fleet import new_imager, sighting
from tests.fixtures.hub_process import HubProcess, processor_s
from tests.fixtures.links import Link, Network, network
from tests.fixtures.postgresql import TEMPLATE, Server, running_server

from sunarc.hub.archive import HubArchive, open_hub_archive
from sunarc.hub.feed_routes import token_digest
from sunarc.imager.archive.archive import CameraArchive
from sunarc.imager.archive.values import Event
from sunarc.imager.runtime.clock import SystemClock
from sunarc.imager.runtime.status import StatusRegistry
from sunarc.imager.workers import feed
from sunarc.imager.workers.feed import FeedWorker
from sunarc.imager.workers.hub_connection import HubConnection
from sunarc.imager.workers.options import HubOptions
from sunarc.sky.site import Site

START = datetime(2026, 1, 1, 12, tzinfo=UTC)
CADENCE_S = 30.0


def _pause(seconds: float) -> None:
    threading.Event().wait(seconds)


class Imager:
    """An archive and the worker that sends it, in a thread."""

    def __init__(self, folder: Path, name: str, link: Link, token: Path) -> None:
        self.name, self.link = name, link
        self.archive = new_imager(folder, name)
        self.file = folder / f"{name}.sqlite"
        self.options = HubOptions(url=f"http://127.0.0.1:{link.port}", token_file=token)
        self._stop = threading.Event()
        worker = feed_worker(self.archive, name, self.options)
        self._thread = threading.Thread(target=worker.run, args=(self._stop, lambda: None), daemon=True)
        self.count = 0

    def begin(self) -> None:
        self._thread.start()

    def see(self, rows: int) -> None:
        """Store sightings of the next moments, and an event."""
        made = [
            sighting(0, camera=self.name, time=START + timedelta(seconds=CADENCE_S * n), x_px=1.0 + n / 7.0)
            for n in range(self.count, self.count + rows)
        ]
        self.archive.sightings.add(made)
        time = made[-1].time
        self.archive.events.add(Event(time=time, kind="test", severity="info", text=f"{self.count}", camera=self.name))
        self.count += rows

    def caught_up(self) -> bool:
        position = self.archive.outbox.position()
        return self.archive.outbox.waiting() == 0 and position.committed >= position.sent

    def end(self) -> None:
        self._stop.set()
        if self._thread.is_alive():
            self._thread.join(30.0)
        self.link.close()
        self.archive.close()


def feed_worker(archive: HubArchive, name: str, options: HubOptions) -> FeedWorker:
    """Return the worker that sends an imager's archive, without waiting between."""
    clock = SystemClock()
    hub = HubConnection(options, camera=name, clock=clock)
    return FeedWorker(
        camera=CameraArchive(archive, name=name, site=Site(latitude=36.6, longitude=-97.5)),
        send=hub.send,
        ask=hub.stored_days,
        asked_s=hub.wait_s,
        clock=clock,
        board=StatusRegistry(version="1", started_at=clock.now(), monotonic=clock.monotonic),
        every_s=0.05,
    )


@dataclass
class Fleet:
    server: Server
    store: URL
    hub: HubProcess
    imagers: Sequence[Imager]
    network: Network | None = None

    def wait_until_caught_up(self, within_s: float) -> float:
        """Return how long it took until every imager's outbox was empty."""
        begun_s = perf_counter()
        while not all(imager.caught_up() for imager in self.imagers):
            self.hub.start_again_if_ended()
            if perf_counter() - begun_s > within_s:
                waiting = {imager.name: imager.archive.outbox.waiting() for imager in self.imagers}
                raise TimeoutError(f"not caught up within {within_s:g} s: {waiting}")
            _pause(0.05)
        return perf_counter() - begun_s

    def differences(self) -> list[str]:
        """Return the imagers whose rows the hub does not have once each, in their order."""
        with open_hub_archive(self.store) as archive:
            return [imager.name for imager in self.imagers if not same(imager, archive)]


def same(imager: Imager, hub: HubArchive) -> bool:
    """Whether the hub has an imager's rows: each once, in the order in which they were made."""
    columns = hub.sightings.columns(imager.name)
    in_order = bool((columns.ids[1:] > columns.ids[:-1]).all())
    events = [event.text for event in hub.events.find(imager.name)]
    own = [event.text for event in imager.archive.events.find(imager.name)]
    return (
        in_order
        and hub.sightings.find(imager.name) == imager.archive.sightings.find(imager.name)
        and events == own
        and hub.epochs.find(imager.name) == imager.archive.epochs.find(imager.name)
    )


@contextmanager
def fleet_of(count: int, *, seed: int = 0, apart: bool = False) -> Iterator[Fleet]:
    """Yield so many imagers that do not send yet, and a hub that answers, `apart` in a network of its own."""
    folder = Path(tempfile.mkdtemp(prefix="fleet"))
    with ExitStack() as stack:
        stack.callback(shutil.rmtree, folder, ignore_errors=True)
        server = stack.enter_context(running_server())
        store = server.url(TEMPLATE)
        names = [f"imager-{n:02d}" for n in range(count)]
        with open_hub_archive(store) as archive:
            for name in names:
                (folder / f"{name}.token").write_text(f"a token of {name}")
                now = SystemClock().now()
                archive.feeds.add_token(name, token_digest(f"a token of {name}"), now=now, former_until=now)
        cable = stack.enter_context(network()) if apart else None
        hub = HubProcess(folder, store, within=cable)
        stack.callback(hub.kill)
        links = [Link(hub.address, seed=seed * 1000 + n) for n in range(count)]
        imagers = [
            Imager(folder, name, link, folder / f"{name}.token") for name, link in zip(names, links, strict=True)
        ]
        for imager in imagers:
            stack.callback(imager.end)
        hub.wait_until_it_answers()
        yield Fleet(server=server, store=store, hub=hub, imagers=imagers, network=cable)


@contextmanager
def quick_retries(longest_s: float = 0.5) -> Iterator[None]:
    """Let imagers try again soon: what takes minutes of waiting takes seconds."""
    former, feed.LONGEST_WAIT_S = feed.LONGEST_WAIT_S, longest_s
    try:
        yield
    finally:
        feed.LONGEST_WAIT_S = former


def run_with_faults(
    fleet: Fleet, *, steps: int, rows: int, pause_s: float, seed: int = 0, longest_cut: int = 3
) -> Counter[str]:
    """Let the fleet live while everything fails in turn; return how often links did what.

    Parameters
    ----------
    fleet : that does not send yet.
    steps, rows, pause_s : so often every imager stores so many sightings, and so long it lasts.
    seed : of the faults.
    longest_cut : steps for which the network's cable is pulled, at most, if there is one.
    """
    chance = random.Random(seed)
    for imager in fleet.imagers:
        imager.link.share = 0.3
        imager.begin()
    mended = 0
    for step in range(steps):
        begun_s = perf_counter()
        for imager in fleet.imagers:
            imager.see(rows)
            imager.link.down = chance.random() < 0.15
        if fleet.network is not None and step >= mended:
            fleet.network.mend()
            if chance.random() < 0.1:
                fleet.network.cut()
                mended = step + chance.randint(1, longest_cut)
        if step in {steps // 6, steps // 3, steps // 2}:
            fleet.hub.kill()
            fleet.hub.start()
        if step in {2 * steps // 3, 5 * steps // 6}:
            fleet.server.stop()  # immediate: as a crash
            _pause(pause_s)
            fleet.server.start()
        fleet.hub.start_again_if_ended()
        _pause(max(pause_s - (perf_counter() - begun_s), 0.0))
    for imager in fleet.imagers:
        imager.link.down, imager.link.share = False, 0.0
    counts = sum((Counter(imager.link.counts) for imager in fleet.imagers), Counter())
    if fleet.network is not None:
        fleet.network.mend()
        counts["cable"] = fleet.network.cuts
    return counts


def measure_ingest(fleet: Fleet, *, rows: int) -> dict[str, float]:
    """Return sightings a second from full outboxes, all imagers at the same time, and who took the processors."""
    for imager in fleet.imagers:
        for _ in range(0, rows, 1000):
            imager.see(1000)
    processes = {
        "hub": fleet.hub.processor_s,
        "postgresql": lambda: processor_s(fleet.server.pid),
        "senders": process_time,
    }
    before = {name: spent() for name, spent in processes.items()}
    begun_s = perf_counter()
    for imager in fleet.imagers:
        imager.begin()
    fleet.wait_until_caught_up(600.0)
    took_s = perf_counter() - begun_s
    number = sum(imager.count for imager in fleet.imagers)
    each = {
        f"{name}_ms_a_thousand": round(1e6 * (spent() - before[name]) / number, 1) for name, spent in processes.items()
    }
    return {"sightings": number, "sightings_per_s": round(number / took_s), **each}


def main() -> None:
    """Run the long form and print what was measured, as JSON."""
    parser = argparse.ArgumentParser(prog="tests/long fleet", description=__doc__)
    parser.add_argument("--imagers", type=int, default=50)
    parser.add_argument("--minutes", type=float, default=60.0, help="of failures")
    parser.add_argument("--rows", type=int, default=2, help="sightings that an imager makes a second")
    parser.add_argument("--rate-rows", type=int, default=10_000, help="sightings an imager, for the rate of ingest")
    asked = parser.parse_args()
    print(json.dumps({"load": os.getloadavg()[0], "imagers": asked.imagers}), flush=True)
    if asked.rate_rows:
        with fleet_of(asked.imagers) as fleet:
            measured = measure_ingest(fleet, rows=asked.rate_rows)
            print(json.dumps({**measured, "differences": fleet.differences()}), flush=True)
    if asked.minutes:
        print(json.dumps(_faults(asked.imagers, steps=round(60 * asked.minutes), rows=asked.rows)), flush=True)


def _faults(imagers: int, *, steps: int, rows: int) -> dict[str, object]:
    """Return what came of a fleet in which everything fails, of steps of 1 s; exit where a row is missing."""
    begun_s = perf_counter()
    with quick_retries(5.0), fleet_of(imagers, apart=os.geteuid() == 0) as fleet:
        counts = run_with_faults(fleet, steps=steps, rows=rows, pause_s=1.0, longest_cut=30)
        lasted_s = perf_counter() - begun_s
        took_s = fleet.wait_until_caught_up(600.0)
        found = {
            "minutes": round(lasted_s / 60.0, 1),
            "sightings": sum(imager.count for imager in fleet.imagers),
            "hours_of_cadence": round(fleet.imagers[0].count * CADENCE_S / 3600.0, 1),
            "requests": counts,
            "caught_up_s": round(took_s, 1),
            "hub_memory_mib": fleet.hub.memory_mib(),
            "load": os.getloadavg()[0],
            "differences": fleet.differences(),
        }
    if found["differences"]:
        sys.exit(json.dumps(found))
    return found


if __name__ == "__main__":
    main()
