"""An imager that was offline for a month sends all that waits, beside others that send as ever.

tests/long fleet-catch-up [--others N] [--days D]
"""

from __future__ import annotations

import argparse
import json
import os
import threading
from time import perf_counter, process_time

from tests.fleet.simulated_fleet import Fleet, Imager, fleet_of

_ROWS_A_DAY = 2880
_AT_ONCE = 2000


def _pause(seconds: float) -> None:
    threading.Event().wait(seconds)


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


def measure(fleet: Fleet, *, rows: int, every_s: float) -> dict[str, float]:
    """Return how long the first imager took to catch up, and the delays of the others before and meanwhile, s."""
    late, *others = fleet.imagers
    for _ in range(0, rows, _AT_ONCE):
        late.see(min(_AT_ONCE, rows))
    for imager in others:
        imager.begin()
    delays: dict[str, list[float]] = {"before": [], "meanwhile": []}
    took_s = 0.0
    for name, wait in (("before", False), ("meanwhile", True)):
        until = threading.Event()

        def follow(imager: Imager, into: list[float], until: threading.Event = until) -> None:
            into.extend(delays_of(imager, every_s=every_s, until=until))

        threads = [threading.Thread(target=follow, args=(one, delays[name]), daemon=True) for one in others]
        for thread in threads:
            thread.start()
        begun_s = perf_counter()
        if wait:
            late.begin()
            while not late.caught_up() and perf_counter() - begun_s < 1800.0:
                _pause(0.05)
            took_s = perf_counter() - begun_s
        else:
            _pause(20.0 * every_s)
        until.set()
        for thread in threads:
            thread.join(60.0)
    found = {f"{name}_{what}": round(value, 2) for name, all_of in delays.items() for what, value in _marks(all_of)}
    return {"caught_up_s": round(took_s, 1), "rows_per_s": round(rows / took_s), **found}


def _marks(delays: list[float]) -> list[tuple[str, float]]:
    ordered = sorted(delays)
    return [("median_s", ordered[len(ordered) // 2]), ("largest_s", ordered[-1])]


def main() -> None:
    """Run and print what was measured, as JSON."""
    parser = argparse.ArgumentParser(prog="tests/long fleet-catch-up", description=__doc__)
    parser.add_argument("--others", type=int, default=9)
    parser.add_argument("--days", type=float, default=30.0)
    parser.add_argument("--every", type=float, default=1.0, help="seconds between the sightings of the others")
    asked = parser.parse_args()
    with fleet_of(1 + asked.others) as fleet:
        begun_s = process_time()
        found = measure(fleet, rows=round(asked.days * _ROWS_A_DAY), every_s=asked.every)
        fleet.wait_until_caught_up(600.0)
        about = {"load": os.getloadavg()[0], "sender_processor_s": round(process_time() - begun_s)}
        print(json.dumps({**about, **found, "differences": fleet.differences()}))


if __name__ == "__main__":
    main()
