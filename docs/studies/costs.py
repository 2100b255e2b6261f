"""How cost grows: processor time over points, pixels, days stored, clients, cameras and images, measured and drawn.

    PYTHONPATH=. python docs/studies/costs.py --out docs/studies [--only points]… [--draw]

A sweep ends after the size at which something took more than `--longest` seconds. `costs.json` keeps what was measured:
a sweep that is not asked for stays in it, and `--draw` draws it alone. The exponent is the slope of a straight line
through the logarithms of the larger half of the sizes. Cameras need PostgreSQL, as a hub does.
"""

from __future__ import annotations

import argparse
import asyncio
import json
import math
import multiprocessing
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from datetime import UTC, datetime, timedelta
from functools import partial
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any, NamedTuple

import five_years
import numpy as np
import population as pop
from fastapi import FastAPI
from map_speed import serve
from matplotlib import rc_context
from matplotlib.axes import Axes
from tests.fixtures.hub_process import processor_s
from tests.fixtures.postgresql import TEMPLATE, running_server
from tests.fixtures.served import calibration as chosen
from tests.release.scale import fill

from sunarc.archives.ledger import Known, Ledger
from sunarc.archives.passes import CHUNK, make_chunks, make_image_id
from sunarc.calibration.answers.direction_table import lookup
from sunarc.calibration.calibrate import calibrate
from sunarc.common.findings import Finding
from sunarc.hub.archive import open_hub_archive
from sunarc.hub.serving import create_hub_app
from sunarc.imager.archive.values import Refit
from sunarc.imager.runtime.clock import SystemClock
from sunarc.imager.runtime.status import StatusRegistry, StatusSnapshot
from sunarc.imager.web.app import create_app
from sunarc.imager.web.options import ApiOptions
from sunarc.lab.simulation.made_archive import encoded, photograph
from sunarc.lab.simulation.truth import SGP
from sunarc.public.plots import LETTERING_PT, TITLE_PT, new_sheet
from sunarc.sources.image_times import TimeRules
from sunarc.sources.index import CameraPlan, Selector, index_folder
from sunarc.sources.look import Item, look_at

Cost = Iterator[tuple[str, int, float]]
"""What is done, how many of them, and processor seconds."""

_QUESTION_S = 0.2
"""Of one measurement: what takes less is repeated."""
_CADENCE_S = 600.0
_IMAGE_PX = 240
_IMAGES_A_DAY = 600
_MOST_SEARCHED = 1000
_SETTLED_S = 0.01


class Sweep(NamedTuple):
    """What a size costs, and the sizes that are tried."""

    measure: Callable[[int], Cost]
    sizes: tuple[int, ...]


def processor_of(work: Callable[[], object], *, beside: Callable[[], float] = lambda: 0.0, once: bool = False) -> float:
    """Return the processor seconds of a call, here and in what is beside: the mean of repeated ones after a first.

    once : whether the first one counts where it takes long: nothing is kept for a second.
    """
    used = time.process_time() + beside()
    work()
    took = time.process_time() + beside() - used
    if once and took > _QUESTION_S:
        return took
    count, used = 0, time.process_time() + beside()
    while count < 3 or time.process_time() + beside() - used < _QUESTION_S:
        work()
        count += 1
    return (time.process_time() + beside() - used) / count


def points(size: int) -> Cost:
    """Fit a camera to sightings: of ten days, or of one where there are few."""
    rng = np.random.default_rng(5)
    camera, days = pop.random_camera(rng), np.arange(10.0 if size > 1000 else 1.0)
    times = pop.sun_track(days, cadence_s=50_000.0 * len(days) / size)
    times = times[np.linspace(0, len(times) - 1, min(size, len(times))).astype(int)]
    seen = pop.sightings(camera, times, pop.white_noise(rng, len(times), 0.3))
    fit = partial(calibrate, seen, site=SGP, image_size=(pop.SIZE, pop.SIZE))
    yield "one fit", len(times), processor_of(fit, once=True)


def pixels(size: int) -> Cost:
    """Return directions and 1-sigmas of pixels, by a calibration that is ready."""
    ready, asked = lookup(chosen()), np.random.default_rng(6).uniform(300.0, 1400.0, (size, 2))
    yield "directions and 1-sigma", size, processor_of(lambda: ready.back_project(asked))


def days(size: int) -> Cost:
    """Ask an archive of so many days, a sighting every ten minutes, for what the dashboard shows."""
    end = five_years.START + timedelta(days=size)
    with tempfile.TemporaryDirectory(prefix="costs-") as folder:
        path = Path(folder) / "sunarc.sqlite"
        five_years.make(path, days=size, cadence_s=_CADENCE_S)
        with open_hub_archive(path) as archive:
            board = StatusRegistry(version="study", started_at=end, monotonic=SystemClock().monotonic)
            app = create_app(
                archive=archive,
                camera="roof",
                site=SGP,
                status=board.snapshot,
                request_refit=lambda reason: Refit(id="x", camera="roof", requested_at=end, reason=reason),
                frame_clock=lambda: end,
                latest_image=lambda: None,
                options=ApiOptions(),
            )
            for page in ("/v1/status", "/v1/days", "/v1/sun-points"):
                yield page, size, processor_of(partial(answered, app, page))
            read = partial(archive.sightings.columns, "roof", since=five_years.START, until=end)
            yield "all sightings read", size, processor_of(read)


def answered(app: FastAPI, page: str) -> None:
    """Ask an application for a page."""
    asyncio.run(five_years.fetch(app, page))


def clients(size: int) -> Cost:
    """Let each of so many clients, with a connection of its own, ask a service for a pixel, 32 at once."""
    ours, theirs = multiprocessing.Pipe()
    with tempfile.TemporaryDirectory(prefix="costs-") as folder:
        server = multiprocessing.get_context("spawn").Process(target=serve, args=(Path(folder), theirs), daemon=True)
        server.start()
        port, _ = received(ours)
        try:
            yield "one question of each", size, asyncio.run(asked_of(port, size, server.pid or 0))
        finally:
            server.terminate()
            server.join()


def received(pipe: Connection) -> tuple[int, int]:
    """Return the ports of a server that has started."""
    port, bare = pipe.recv()
    return int(port), int(bare)


async def asked_of(port: int, count: int, pid: int) -> float:
    """Return the server's processor seconds of one question of each client: the mean of enough rounds."""
    body = b'{"pixels": [[871.96, 700.0]]}'
    head = b"POST /v1/back-project HTTP/1.1\r\nhost: localhost\r\ncontent-type: application/json\r\n"
    question = head + b"content-length: %d\r\n\r\n" % len(body) + body
    connections = [await asyncio.open_connection("127.0.0.1", port) for _ in range(count)]

    at_once = asyncio.Semaphore(32)  # the service answers 503 where more wait than it can answer in time

    async def ask(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        async with at_once:
            writer.write(question)
            answer = await reader.readuntil(b"\r\n\r\n")
            if not answer.startswith(b"HTTP/1.1 200"):
                raise RuntimeError(answer.decode())
            await reader.readexactly(int(answer.lower().split(b"content-length: ")[1].split(b"\r\n")[0]))

    await asyncio.gather(*(ask(*one) for one in connections))
    rounds, used = 0, processor_s(pid)
    while rounds < 3 or processor_s(pid) - used < _QUESTION_S:
        await asyncio.gather(*(ask(*one) for one in connections))
        rounds += 1
    took = (processor_s(pid) - used) / rounds
    for _, writer in connections:
        writer.close()
    await asyncio.sleep(_SETTLED_S)
    return took


def cameras(size: int) -> Cost:
    """Ask a hub for its fleet: the processor time of the hub and of PostgreSQL."""
    now = datetime(2026, 1, 1, 1, tzinfo=UTC)
    status = StatusSnapshot(version="study", started_at=now)
    with running_server() as server:
        fill(server, rows=2 * size, cameras=size, listed=size)
        with open_hub_archive(server.url(TEMPLATE)) as archive:
            app = create_hub_app(archive=archive, status=lambda: status, now=lambda: now, options=ApiOptions())
            for page in ("/v1/fleet", "/metrics"):
                yield page, size, processor_of(partial(answered, app, page), beside=lambda: processor_s(server.pid))


def images(size: int) -> Cost:
    """List a folder with the times of its images, keep and read their answers; look for the sun where they are few."""
    content = encoded(photograph(_IMAGE_PX, np.array([120.0, 90.0]), np.random.default_rng(1)))
    begin = datetime(2013, 5, 13, 14, tzinfo=UTC)
    with tempfile.TemporaryDirectory(prefix="costs-") as folder:
        for number in range(size):
            moment = begin + timedelta(days=number // _IMAGES_A_DAY, minutes=number % _IMAGES_A_DAY)
            (Path(folder) / f"{moment:%Y%m%d_%H%M%S}.jpg").write_bytes(content)
        rules = TimeRules(offset=timedelta(0))
        plan = CameraPlan(name="roof", site=SGP, selector=Selector((folder,)), rules=rules)
        yield "listed", size, processor_of(lambda: index_folder(plan), once=True)
        camera, _ = index_folder(plan)
        rows = [(make_image_id(one), Known("key", Finding("no_sun"), one.stamp, "content")) for one in camera.images]
        with Ledger(f"sqlite:///{folder}/ledger.sqlite") as ledger:
            yield "answers kept and read", size, processor_of(lambda: kept(ledger, rows), once=True)
        if size <= _MOST_SEARCHED:
            items = [(one, Item(one.file, one.number, None)) for one in camera.images]
            chunks = make_chunks(camera, items, None)
            yield "searched for the sun", size, processor_of(lambda: [look_at(chunk) for chunk in chunks], once=True)


def kept(ledger: Ledger, rows: list[Any]) -> None:
    """Store answers by chunks, and read them."""
    for first in range(0, len(rows), CHUNK):
        ledger.store("roof", 1, rows[first : first + CHUNK], version="study")
    if sum(1 for _ in ledger.answers("roof", pass_number=1)) != len(rows):
        raise RuntimeError("answers are missing")


SWEEPS = {
    "points": Sweep(points, (100, 300, 1000, 3000, 10_000, 30_000, 100_000, 300_000, 1_000_000)),
    "pixels": Sweep(pixels, (1000, 10_000, 100_000, 1_000_000, 10_000_000)),
    "days": Sweep(days, (1, 10, 100, 365, 1000, 3650)),
    "clients": Sweep(clients, (1, 4, 16, 64, 256)),
    "cameras": Sweep(cameras, (1, 10, 100, 300, 1000)),
    "images": Sweep(images, (100, 300, 1000, 10_000, 100_000)),
}


def measured(name: str, longest_s: float) -> Cost:
    """Measure a sweep, and print it."""
    for size in SWEEPS[name].sizes:
        longest = 0.0
        for what, count, seconds in SWEEPS[name].measure(size):
            print(f"{name:8s} {what:24s} {count:9d} {seconds:.3g} s", flush=True)
            yield what, count, seconds
            longest = max(longest, seconds)
        if longest > longest_s:
            break


def curves(rows: Sequence[Sequence[Any]]) -> dict[str, tuple[list[int], list[float]]]:
    """Return the sizes and costs of each thing that is done."""
    found: dict[str, tuple[list[int], list[float]]] = {}
    for what, size, seconds in rows:
        across, along = found.setdefault(what, ([], []))
        across.append(size)
        along.append(seconds)
    return found


def exponent(sizes: Sequence[int], seconds: Sequence[float]) -> float:
    """Return the slope of the logarithms over the larger half of the sizes."""
    half = len(sizes) // 2
    if len(sizes) - half < 2:
        return math.nan
    return float(np.polyfit(np.log(sizes[half:]), np.log(seconds[half:]), 1)[0])


_COLOURS = {"light": ("#0072B2", "#D55E00", "#009E73", "#8A8A8A"), "dark": ("#56B4E9", "#E69F00", "#2FC99A", "#B0B0B0")}
_THEMES: dict[str, dict[Any, str]] = {
    "light": {"figure.facecolor": "#FFFFFF", "axes.facecolor": "#FFFFFF", "text.color": "#222222"},
    "dark": {"figure.facecolor": "#0D1117", "axes.facecolor": "#0D1117", "text.color": "#E6EDF3"},
}


def drawn(rows: dict[str, list[Any]], folder: Path) -> None:
    """Draw the sweeps as PNG and SVG, for light and dark pages."""
    for theme, colours in _THEMES.items():
        ink = colours["text.color"]
        more: dict[Any, str] = {"axes.edgecolor": ink, "axes.labelcolor": ink, "xtick.color": ink, "ytick.color": ink}
        with rc_context({**colours, **more, "svg.hashsalt": "costs", "svg.fonttype": "none"}):
            sheet = new_sheet(width_px=1200, height_px=760)
            for panel, name in zip(sheet.subplots(2, 3).ravel(), SWEEPS, strict=True):
                if name in rows:
                    draw(panel, name, curves(rows[name]), theme)
            for kind, metadata in (("png", {"Software": "sunarc"}), ("svg", {"Date": None, "Creator": "sunarc"})):
                sheet.savefig(folder / f"costs-{theme}.{kind}", format=kind, metadata=metadata)


def draw(panel: Axes, name: str, found: dict[str, tuple[list[int], list[float]]], theme: str) -> None:
    """Draw a sweep, with a dotted line of cost in proportion."""
    for colour, (what, (sizes, seconds)) in zip(_COLOURS[theme], found.items(), strict=False):
        label = f"{what}: {exponent(sizes, seconds):.2f}"
        panel.loglog(sizes, seconds, "o-", color=colour, label=label, markersize=4.0, linewidth=1.4)
    sizes, seconds = max(found.values(), key=lambda curve: curve[1][-1])
    ends = np.array([sizes[0], sizes[-1]], dtype=float)
    panel.loglog(ends, seconds[-1] * ends / ends[-1], ":", color=_COLOURS[theme][-1], linewidth=1.0)
    panel.set_ylim(bottom=0.5 * min(min(curve[1]) for curve in found.values()))
    panel.set_title(name, fontsize=TITLE_PT, loc="left")
    panel.set_ylabel("processor time, s", fontsize=LETTERING_PT)
    panel.grid(visible=True, color=_COLOURS[theme][-1], alpha=0.25, linewidth=0.6)
    legend = panel.legend(fontsize=LETTERING_PT - 1.0, framealpha=0.6, facecolor=_THEMES[theme]["axes.facecolor"])
    legend.get_frame().set_linewidth(0.0)


def main() -> None:
    """Measure what is asked for, and draw all."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--only", action="append", default=[], choices=list(SWEEPS))
    parser.add_argument("--draw", action="store_true", help="draw what was measured")
    parser.add_argument("--longest", type=float, default=60.0, help="s; a sweep ends after what takes longer")
    chosen_options = parser.parse_args()
    path = chosen_options.out / "costs.json"
    rows = json.loads(path.read_text("utf-8")) if path.exists() else {}
    if not chosen_options.draw:
        for name in chosen_options.only or SWEEPS:
            rows[name] = []
            for what, size, seconds in measured(name, chosen_options.longest):
                rows[name].append([what, size, float(f"{seconds:.3g}")])
                path.write_text(json.dumps(rows) + "\n", encoding="utf-8")
    for name, found in rows.items():
        for what, (sizes, costs) in curves(found).items():
            print(f"{name}: {what}: exponent {exponent(sizes, costs):.2f}, {sizes[-1]}: {costs[-1]:.3g} s")
    drawn(rows, chosen_options.out)


if __name__ == "__main__":
    main()
