"""The first limits of a fleet, measured at two sizes each, and at a third beside what these two predict.

tests/long fleet-limits

`puts`: the hub's and PostgreSQL's processor time of a PUT of 1 and 1000 rows, and of 10 and 100. `disk`: bytes of a
sighting in the database, indexes in it. `fits`: processor time of a whole fit by days of a hundred sightings.
"""

from __future__ import annotations

import gzip
import json
import shutil
import tempfile
from collections.abc import Callable, Mapping
from contextlib import ExitStack
from itertools import count
from pathlib import Path
from time import process_time

import numpy as np
from tests.fixtures.hub_process import HubProcess, processor_s
from tests.fixtures.postgresql import TEMPLATE, Server, running_server
from tests.fixtures.rotated_cameras import Wrong, neighbours
from tests.release.feed_cost import Sender, rows_of, sightings_of
from tests.release.scale import fill

from sunarc.calibration.calibrate import calibrate
from sunarc.calibration.model.sightings import Sightings
from sunarc.hub.archive import open_hub_archive
from sunarc.hub.feed_routes import token_digest
from sunarc.imager.archive.feed_rows import feed_lines
from sunarc.imager.runtime.clock import SystemClock

PUTS = {1: 300, 10: 200, 100: 100, 1000: 20}
"""How often a PUT of so many rows is sent."""
SIGHTINGS, DAYS = (10_000, 40_000, 160_000), (5, 20, 40)
CAMERAS = 5
_SIZE = "SELECT sum(pg_total_relation_size(inhrelid)) FROM pg_inherits WHERE inhparent = 'sun_point'::regclass"


def line_through(first: tuple[float, float], second: tuple[float, float]) -> Callable[[float], float]:
    """Return what two measured sizes predict of another one: what a piece costs, and what each costs besides."""
    slope = (second[1] - first[1]) / (second[0] - first[0])
    return lambda size: first[1] + slope * (size - first[0])


def beside_model(what: str, measured: Mapping[int, float], *, by: tuple[int, int]) -> None:
    """Print what was measured, and what the model made of two sizes says of each."""
    predicted = line_through(*((size, measured[size]) for size in by))
    for size, value in measured.items():
        print(json.dumps({"what": what, "size": size, "measured": value, "model": float(f"{predicted(size):.4g}")}))


def puts(server: Server, folder: Path) -> None:
    """Print the processor time of PUTs, ms, of the hub and of PostgreSQL."""
    with ExitStack() as stack:
        store = server.url(TEMPLATE)
        archive = stack.enter_context(open_hub_archive(store))
        now = SystemClock().now()
        archive.feeds.add_token("roof", token_digest("a token"), now=now, former_until=now)
        hub = HubProcess(folder, store)
        stack.callback(hub.kill)
        hub.wait_until_it_answers()
        sender = Sender(hub, "roof", "a token")
        first, data = sightings_of(folder, "roof")
        sender.put(first)
        lines, of_hub, of_server = rows_of(data, count(1)), dict[int, float](), dict[int, float]()
        for rows, n in PUTS.items():
            bodies = [gzip.compress(feed_lines(lines(sender.after + k * rows, rows)), 4) for k in range(n + 2)]
            for body in bodies[:2]:
                sender.put_body(body)
            before = hub.processor_s(), processor_s(server.pid)
            for body in bodies[2:]:
                sender.put_body(body)
            of_hub[rows] = round(1e3 * (hub.processor_s() - before[0]) / n, 2)
            of_server[rows] = round(1e3 * (processor_s(server.pid) - before[1]) / n, 2)
    beside_model("hub's processor of a PUT by rows, ms", of_hub, by=(1, 1000))
    beside_model("PostgreSQL's processor of a PUT by rows, ms", of_server, by=(1, 1000))


def disk(server: Server) -> None:
    """Print the bytes of sightings."""
    found = {}
    for rows in SIGHTINGS:
        server.emptied_database()
        fill(server, rows=rows, cameras=CAMERAS, listed=CAMERAS)
        found[rows] = float(server.sql(TEMPLATE, _SIZE))
    beside_model("bytes of sightings", found, by=SIGHTINGS[:2])


def fits() -> None:
    """Print the processor time of fits, ms."""
    (camera,) = neighbours(Wrong())
    rng = np.random.default_rng(1)
    size = (camera.camera.width, camera.camera.height)
    found = {}
    for days in DAYS:
        seen = [camera.sightings(day, rng, n=100) for day in range(days)]
        points = Sightings.of(
            unix_s=np.concatenate([one.unix_s for one in seen]), pixels=np.concatenate([one.pixels for one in seen])
        )
        begun_s = process_time()
        calibrate(points, site=camera.site, image_size=size)
        found[days] = round(1e3 * (process_time() - begun_s), 1)
    beside_model("processor of a fit by days, ms", found, by=DAYS[:2])


def main() -> None:
    """Measure and print, as JSON lines."""
    folder = Path(tempfile.mkdtemp(prefix="limits"))
    try:
        fits()
        with running_server() as server:
            puts(server, folder)
            disk(server)
    finally:
        shutil.rmtree(folder)


if __name__ == "__main__":
    main()
