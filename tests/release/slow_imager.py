"""Imagers that were offline for a month send all that waits, beside others that send as ever.

tests/long fleet-catch-up [--late N] [--others N] [--days D]
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
import os
import threading
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from time import perf_counter

from tests.release.simulated_fleet import Fleet, Imager, feed_worker, fleet_of

from sunarc.hub.archive import open_hub_archive
from sunarc.imager.workers.options import HubOptions

_ROWS_A_DAY = 2880
_AT_ONCE = 2000


def _pause(seconds: float) -> None:
    threading.Event().wait(seconds)


def send_all(imagers: list[tuple[Path, str, HubOptions]]) -> None:
    """Send for ever, a thread an imager: in a process of its own, as imagers share no interpreter with others."""
    with ExitStack() as stack:
        for file, name, options in imagers:
            archive = stack.enter_context(open_hub_archive(file))
            worker = feed_worker(archive, name, options)
            arguments = (threading.Event(), lambda: None)
            threading.Thread(target=worker.run, args=arguments, daemon=True).start()
        threading.Event().wait()


@contextmanager
def sending(imagers: list[Imager]) -> Iterator[None]:
    """Let imagers send in a process of their own, until the end."""
    named = [(one.file, one.name, one.options) for one in imagers]
    process = multiprocessing.get_context("spawn").Process(target=send_all, args=(named,), daemon=True)
    process.start()
    try:
        yield
    finally:
        process.kill()
        process.join(10.0)


def delays_of(imager: Imager, *, every_s: float, until: threading.Event) -> list[float]:
    """Return how long each of an imager's sightings took until the hub had it, s."""
    found = []
    while not until.is_set():
        begun_s = perf_counter()
        imager.see(1)
        while not imager.caught_up():
            _pause(0.01)
        found.append(perf_counter() - begun_s)
        _pause(max(every_s - found[-1], 0.0))
    return found


def delays_while(others: list[Imager], late: list[Imager], *, every_s: float) -> tuple[list[float], float]:
    """Return the delays of others until the late ones have sent all, and how long that took; without any 20 s."""
    until, delays = threading.Event(), list[float]()
    threads = [
        threading.Thread(
            target=lambda one=one: delays.extend(delays_of(one, every_s=every_s, until=until)), daemon=True
        )
        for one in others
    ]
    begun_s = perf_counter()
    for thread in threads:
        thread.start()
    if late:
        with sending(late):
            while not all(one.caught_up() for one in late) and perf_counter() - begun_s < 1800.0:
                _pause(0.2)
    else:
        _pause(20.0 * every_s)
    took_s = perf_counter() - begun_s
    until.set()
    for thread in threads:
        thread.join(60.0)
    return delays, took_s


def measure(fleet: Fleet, *, late: int, rows: int, every_s: float) -> dict[str, float]:
    """Return how long the first imagers took to catch up, and the delays of the others before and meanwhile, s."""
    behind, others = list(fleet.imagers[:late]), list(fleet.imagers[late:])
    for imager in behind:
        for _ in range(0, rows, _AT_ONCE):
            imager.see(min(_AT_ONCE, rows))
    for imager in others:
        imager.begin()
    before, _ = delays_while(others, [], every_s=every_s)
    meanwhile, took_s = delays_while(others, behind, every_s=every_s)
    found = {
        f"{name}_{what}": round(value, 2)
        for name, delays in (("before", before), ("meanwhile", meanwhile))
        for what, value in _marks(delays)
    }
    return {"caught_up_s": round(took_s, 1), "rows_per_s": round(late * rows / took_s), **found}


def _marks(delays: list[float]) -> list[tuple[str, float]]:
    ordered = sorted(delays)
    marks = (("median_s", 0.5), ("99_percent_s", 0.99), ("largest_s", 1.0))
    return [(name, ordered[min(int(share * len(ordered)), len(ordered) - 1)]) for name, share in marks]


def main() -> None:
    """Run and print what was measured, as JSON."""
    parser = argparse.ArgumentParser(prog="tests/long fleet-catch-up", description=__doc__)
    parser.add_argument("--late", type=int, default=1)
    parser.add_argument("--others", type=int, default=9)
    parser.add_argument("--days", type=float, default=30.0)
    parser.add_argument("--every", type=float, default=1.0, help="seconds between the sightings of the others")
    asked = parser.parse_args()
    with fleet_of(asked.late + asked.others) as fleet:
        load = os.getloadavg()[0]
        rows = round(asked.days * _ROWS_A_DAY)
        found = measure(fleet, late=asked.late, rows=rows, every_s=asked.every)
        about = {
            "late": asked.late,
            "others": asked.others,
            "load": [round(one, 1) for one in (load, os.getloadavg()[0])],
        }
        print(json.dumps({**about, **found, "differences": fleet.differences()}))


if __name__ == "__main__":
    main()
