"""Many senders of the example's code beside hostile ones, while hubs and PostgreSQL are killed.

tests/long senders [--rows N] [--senders N] [--hostile N] [--hubs N] [--rate N]

Each honest sender is a process that makes sightings at a rate and sends what it has (`deploy/hub/sender.py`). Hostile
ones contradict, lie in their numbers, send newlines, name other cameras and their pose epochs, and remove their rows.
Printed are the rows that are not there once, how long a row waited until it was stored, and what the hubs and
PostgreSQL took of the processor for one.
"""

from __future__ import annotations

import argparse
import gzip
import importlib.util
import json
import multiprocessing
import os
import shutil
import sys
import tempfile
import threading
from contextlib import ExitStack, suppress
from itertools import cycle
from multiprocessing.synchronize import Event
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np
from tests.fixtures.hub_process import HubProcess, processor_s
from tests.fixtures.postgresql import TEMPLATE, Server, running_server
from tests.release.feed_cost import Sender, sightings_of

from sunarc.hub.archive import open_hub_archive
from sunarc.hub.feed_routes import token_digest
from sunarc.imager.archive.feed_rows import FeedRow
from sunarc.imager.runtime.clock import SystemClock

EXAMPLE = Path(__file__).parents[2] / "deploy" / "hub" / "sender.py"
MOST_AT_ONCE = 1000
PAUSE = threading.Event()
STEP_US = 1000
"""Between two sightings."""


def send(url: str, name: str, first: list[FeedRow], *, rows: int, rate: float, found: Path) -> None:
    """Make rows at a rate and send them as the example does; leave in a file how long each waited, s."""
    spec = importlib.util.spec_from_file_location("sender", EXAMPLE)
    assert spec is not None
    assert spec.loader is not None
    example = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(example)
    hub = example.Feed(url, name, f"a token of {name}", name)
    data, done, delays = dict(first[-1].data or {}), 0, []
    committed = hub.put([{"seq": one.seq, "kind": one.kind, "data": one.data} for one in first], 0)
    begun_s = perf_counter()
    while done < rows:
        PAUSE.wait(max(begun_s + (done + 1) / rate - perf_counter(), 0.0))
        made = min(int((perf_counter() - begun_s) * rate), rows, done + MOST_AT_ONCE)
        lines = [
            {"seq": committed + k - done, "kind": "sun_point", "data": data | {"time": data["time"] + STEP_US * k}}
            for k in range(done + 1, made + 1)
        ]
        while lines:
            reached = hub.put(lines, committed)
            lines, committed = [line for line in lines if line["seq"] > reached], reached
        stored_s = perf_counter() - begun_s
        delays += [stored_s - k / rate for k in range(done + 1, made + 1)]
        done = made
    np.save(found, np.array(delays))


def harm(hub: HubProcess, name: str, victim: str, first: list[FeedRow], ended: Event) -> None:
    """Send whatever is wrong until the others have ended, without ever waiting."""
    data = dict(first[-1].data or {})
    key = {column: data[column] for column in ("time", "body", "exposure_us", "method", "file")}
    wrong: list[tuple[str, dict[str, Any]]] = [
        ("sun_point", data | {"pose_epoch": "none"}),
        ("sun_point", data | {"pose_epoch": f"{victim}-1"}),
        ("sun_point", data | {"camera": victim}),
        ("sun_point.removed", key | {"camera": victim}),
        ("pose_epoch.removed", {"id": f"{victim}-1"}),
        ("camera.removed", {"name": victim}),
    ]
    sender, seq = Sender(hub, name, f"a token of {name}"), 0
    for kind, row in cycle(wrong):
        if ended.wait(0.05):
            return
        with suppress(OSError, ValueError, KeyError):
            seq += 200
            sender.put([FeedRow(seq=seq + k, kind=kind, data=row) for k in range(100)])
            sender.after = seq if seq % 400 else 10**9  # a lie
            sender.put_body(gzip.compress(b"\n" * 1_000_000))
            continue
        sender = Sender(hub, name, f"a token of {name}")


def wrong_counts(server: Server, names: list[str], rows: int) -> dict[str, str]:
    """Return the cameras whose rows are not there once each, with what is."""
    counted = server.sql(TEMPLATE, "SELECT camera, count(*), count(DISTINCT time) FROM sun_point GROUP BY camera")
    found = dict(line.split("|", 1) for line in counted.splitlines())
    return {name: found.get(name, "0") for name in names if found.get(name) != f"{rows + 1}|{rows + 1}"}


def allow(server: Server, names: list[str]) -> None:
    """Register a token of each sender."""
    with open_hub_archive(server.url(TEMPLATE)) as archive:
        now = SystemClock().now()
        for name in names:
            archive.feeds.add_token(name, token_digest(f"a token of {name}"), now=now, former_until=now)


def running_hubs(folder: Path, server: Server, count: int, stack: ExitStack) -> list[HubProcess]:
    """Return hubs that answer, beside each other on one database."""
    hubs = []
    for n in range(count):
        (folder / f"hub{n}").mkdir()
        hubs.append(HubProcess(folder / f"hub{n}", server.url(TEMPLATE)))
        stack.callback(hubs[-1].kill)
    for hub in hubs:
        hub.wait_until_it_answers()
    return hubs


def run(asked: argparse.Namespace, stack: ExitStack) -> dict[str, object]:
    folder = Path(tempfile.mkdtemp(prefix="senders"))
    stack.callback(shutil.rmtree, folder, ignore_errors=True)
    server = stack.enter_context(running_server())
    honest = [f"c{n:02d}" for n in range(asked.senders)]
    hostile = [f"x{n:02d}" for n in range(asked.hostile)]
    first = {name: sightings_of(folder, name)[0] for name in honest + hostile}
    allow(server, honest + hostile)
    hubs = running_hubs(folder, server, asked.hubs, stack)
    fork = multiprocessing.get_context("fork")
    ended, each = fork.Event(), asked.rows // asked.senders
    rate, options = asked.rate / asked.senders, {"rows": each, "rate": asked.rate / asked.senders}
    senders = [
        fork.Process(target=send, args=(hub.url, name, first[name]), kwargs=options | {"found": folder / f"{name}.npy"})
        for name, hub in zip(honest, cycle(hubs), strict=False)
    ]
    others = [
        fork.Process(target=harm, args=(hub, name, honest[0], first[name], ended), daemon=True)
        for name, hub in zip(hostile, cycle(hubs), strict=False)
    ]
    begun_s, taken = perf_counter(), {"hubs": 0.0, "postgresql": 0.0}
    for process in senders + others:
        process.start()
    lasts_s = each / rate
    faults = [(lasts_s * share, what) for share, what in ((0.25, "hub"), (0.5, "server"), (0.75, "hub"))]
    while any(process.is_alive() for process in senders):
        PAUSE.wait(0.2)
        if faults and perf_counter() - begun_s > faults[0][0]:
            if faults.pop(0)[1] == "hub":
                taken["hubs"] += hubs[0].processor_s()
                hubs[0].kill()
                hubs[0].start()
            else:
                taken["postgresql"] += processor_s(server.pid)
                server.stop()
                server.start()
        for hub in hubs:
            hub.start_again_if_ended()
    took_s = perf_counter() - begun_s
    ended.set()
    taken["hubs"] += sum(hub.processor_s() for hub in hubs)
    taken["postgresql"] += processor_s(server.pid)
    delays = np.concatenate([np.load(folder / f"{name}.npy") for name in honest])
    return {
        "hubs": asked.hubs,
        "rows": each * asked.senders,
        "lasted_s": round(took_s, 1),
        "exit": sorted({process.exitcode for process in senders}, key=str),
        "not_once": wrong_counts(server, honest, each),
        "of_hostile": server.sql(TEMPLATE, "SELECT count(*) FROM sun_point WHERE camera LIKE 'x%'").strip(),
        "delay_s": {f"{p}": round(float(np.percentile(delays, p)), 2) for p in (50, 95, 99, 100)},
        "ms_a_row": {name: round(1e3 * spent / (each * asked.senders), 3) for name, spent in taken.items()},
        "load": os.getloadavg()[0],
    }


def main() -> None:
    """Run, and print as JSON; exit 1 where a row is missing or there twice."""
    parser = argparse.ArgumentParser(
        prog="tests/long senders", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--rows", type=int, default=1_000_000, help="of all honest senders")
    parser.add_argument("--senders", type=int, default=50)
    parser.add_argument("--hostile", type=int, default=1)
    parser.add_argument("--hubs", type=int, default=1)
    parser.add_argument("--rate", type=float, default=1000.0, help="rows a second of all")
    with ExitStack() as stack:
        found = run(parser.parse_args(), stack)
    print(json.dumps(found))
    if found["not_once"]:
        sys.exit(1)


if __name__ == "__main__":
    main()
