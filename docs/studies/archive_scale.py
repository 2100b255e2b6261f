"""A discrete-event model of `sunarc reanalyse`: scheduler, driver, network, storage and processors; docs/scale.md.

    python docs/studies/archive_scale.py [--chunks 16] [--skip-measured]

Measures what a chunk of 64 images (made ones, 240 px) costs a worker, the scheduler and the driver, runs a cluster of
this machine with 1, 2, 4 and 8 workers, and prints how long the model says that these runs take. Then it carries the
model to images of 2 MP and clusters of up to 512 workers, and prints the images a second, and how busy each part is.
"""

from __future__ import annotations

import argparse
import heapq
import os
import tempfile
from collections import deque
from collections.abc import Callable, Sequence
from pathlib import Path
from time import perf_counter, process_time
from typing import NamedTuple

from sunarc.archives.cluster import Workers, open_cluster
from sunarc.archives.ledger import ImageId, Known, Ledger
from sunarc.archives.passes import CHUNK, make_chunks
from sunarc.imager.runtime.clock import SystemClock
from sunarc.lab.simulation.made_archive import FOUR_CAMERAS, MadeArchive, write_archive
from sunarc.lab.simulation.truth import SGP
from sunarc.sources.index import CameraPlan, Selector, index_archive, read_cameras
from sunarc.sources.look import Chunk, Item, look_at

_AHEAD = 3
"""Chunks that wait at each worker, as in `archives/cluster`."""
_DRIVER = -1
"""User of the processors that is no worker."""
_MEASURED = (1, 2, 4, 8)
_LARGE = (1, 16, 64, 256, 512)
_EACH = 12
"""Chunks for each worker of a large cluster: the first and the last one are a small part of the run."""


class Costs(NamedTuple):
    """What a chunk costs: processor seconds of a worker, the scheduler and the driver; MB that are read.

    start_s: processor seconds of a worker before its first chunk: its interpreter, imports, compiled kernels.
    """

    worker_s: float
    scheduler_s: float
    driver_s: float
    read_mb: float
    start_s: float = 0.0


class Machine(NamedTuple):
    """What there is: processors for the workers, MB/s of the storage and to one worker, seconds of a message.

    together: whether scheduler and driver, which are one process of this machine, share the processors of the workers.
    """

    cores: float
    storage_mb_s: float
    link_mb_s: float = 100.0
    message_s: float = 0.0005
    together: bool = False


class Shared:
    """A resource that its users share evenly, none of them getting more than `each` of the `total` a second."""

    def __init__(self, total: float, each: float) -> None:
        self.total, self.each, self.given = total, each, 0.0
        self.left: dict[int, float] = {}

    def rate(self) -> float:
        """Return what each user gets now."""
        return min(self.each, self.total / max(len(self.left), 1))

    def next_end(self) -> float:
        """Return after how long the first user is done."""
        return min(self.left.values(), default=float("inf")) / self.rate()

    def pass_time(self, seconds: float) -> list[int]:
        """Return the users that are done after so long."""
        done = seconds * self.rate()
        self.given += done * len(self.left)
        self.left = {user: amount - done for user, amount in self.left.items()}
        ended = [user for user, amount in self.left.items() if amount <= 1e-9]
        for user in ended:
            del self.left[user]
        return ended


class Outcome(NamedTuple):
    """How long a run takes, and the share of it that each part is busy."""

    seconds: float
    cores: float
    storage: float
    scheduler: float
    driver: float


class Simulation:
    """A run of so many chunks: each is sent to a worker, read, looked at, and its answer stored."""

    def __init__(self, costs: Costs, machine: Machine, *, workers: int, chunks: int) -> None:
        self.costs, self.machine, self.chunks, self.unsent, self.stored = costs, machine, chunks, chunks, 0
        self.now, self.sent = 0.0, 0
        self.free, self.busy = dict.fromkeys(("scheduler", "driver"), 0.0), dict.fromkeys(("scheduler", "driver"), 0.0)
        self.storage = Shared(machine.storage_mb_s, machine.link_mb_s)
        self.cores = Shared(machine.cores, 1.0)
        self.events: list[tuple[float, int, str, int]] = []
        self.waiting, self.idle = [0] * workers, set[int]()
        self.serving, self.looking = deque[tuple[float, str, int]](), set[int]()
        self.cores.left = dict.fromkeys(range(workers), costs.start_s)
        for _ in range(_AHEAD):
            for worker in range(workers):
                self._send(worker)

    def run(self) -> Outcome:
        """Return how it goes."""
        while self.stored < self.chunks:
            coming = (self.events[0][0] - self.now) if self.events else float("inf")
            self._pass_time(min(self.storage.next_end(), self.cores.next_end(), coming))
        shares = (
            self.cores.given / self.machine.cores,
            self.storage.given / self.machine.storage_mb_s,
            self.busy["scheduler"],
            self.busy["driver"],
        )
        return Outcome(self.now, *(share / self.now for share in shares))

    def _pass_time(self, seconds: float) -> None:
        read, looked = self.storage.pass_time(seconds), self.cores.pass_time(seconds)
        self.now += seconds
        for worker in read:
            self.looking.add(worker)
            self.cores.left[worker] = self.costs.worker_s
        for worker in looked:
            if worker == _DRIVER:
                _, then, served = self.serving.popleft()
                self._push(self.now, then, served)
                self._next()
                continue
            self.idle.add(worker)
            if worker in self.looking:
                self._serve("driver", self.costs.driver_s, "stored", worker)
                self._send(worker)
            self._start(worker)
        while self.events and self.events[0][0] <= self.now + 1e-12:
            _, _, what, worker = heapq.heappop(self.events)
            if what == "stored":
                self.stored += 1
            else:
                self.waiting[worker] += 1
                self._start(worker)

    def _serve(self, who: str, seconds: float, then: str, worker: int) -> None:
        """Let the scheduler or the driver do something, in the order of asking, and send what follows."""
        self.busy[who] += seconds
        if self.machine.together:
            self.serving.append((seconds, then, worker))
            self._next()
            return
        self.free[who] = max(self.free[who], self.now) + seconds
        self._push(self.free[who], then, worker)

    def _next(self) -> None:
        """Let the one process of scheduler and driver do the next thing that waits for it."""
        if self.serving and _DRIVER not in self.cores.left:
            self.cores.left[_DRIVER] = self.serving[0][0]

    def _push(self, at: float, then: str, worker: int) -> None:
        self.sent += 1
        heapq.heappush(self.events, (at + self.machine.message_s, self.sent, then, worker))

    def _send(self, worker: int) -> None:
        if self.unsent:
            self.unsent -= 1
            self._serve("scheduler", self.costs.scheduler_s, "arrived", worker)

    def _start(self, worker: int) -> None:
        if worker in self.idle and self.waiting[worker]:
            self.idle.discard(worker)
            self.waiting[worker] -= 1
            self.storage.left[worker] = self.costs.read_mb


def main() -> None:
    """Measure, compare, and carry it to large archives."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--chunks", type=int, default=16)
    parser.add_argument("--skip-measured", action="store_true", help="print the large table alone")
    asked = parser.parse_args()
    if not asked.skip_measured:
        with tempfile.TemporaryDirectory(prefix="scale-") as folder:
            compare(made_chunks(Path(folder), asked.chunks), Path(folder))
    print("\n| workers | images/s | processors | storage | scheduler | driver |\n|---|---|---|---|---|---|")
    costs = Costs(worker_s=CHUNK * 0.07, scheduler_s=0.004, driver_s=0.009, read_mb=CHUNK * 0.5)
    for workers in _LARGE:
        machine = Machine(cores=workers, storage_mb_s=1000.0)
        found = Simulation(costs, machine, workers=workers, chunks=_EACH * workers).run()
        busy = " | ".join(f"{share:.0%}" for share in found[1:])
        print(f"| {workers} | {_EACH * workers * CHUNK / found.seconds:.0f} | {busy} |")


def made_chunks(folder: Path, n: int) -> list[Chunk]:
    """Return so many chunks of 64 images, which are made."""
    made = MadeArchive(cameras=FOUR_CAMERAS[3:], days=6, per_day=CHUNK, broken=0)
    common = CameraPlan(name="all", site=SGP, selector=Selector(()))
    (camera,) = index_archive(read_cameras(write_archive(made, folder), common=common)).cameras
    chunks = make_chunks(camera, [(one, Item(one.file, one.number, None)) for one in camera.images], None)
    return [chunks[number % len(chunks)] for number in range(n)]


def compare(chunks: Sequence[Chunk], folder: Path) -> None:
    """Print how long runs took, and how long they take by the model."""
    began = process_time()
    answers = [look_at(chunk) for chunk in chunks[:4]]
    worker_s = (process_time() - began) / 4
    read_mb = sum((Path(chunks[0].address) / item.file).stat().st_size for item in chunks[0].items) / 1e6
    with Ledger(f"sqlite:///{folder / 'ledger.sqlite'}") as ledger:
        began = process_time()
        for found in answers:
            rows = [
                (ImageId(chunks[0].address, one.file, one.number), Known("key", one.found, "stamp", one.content))
                for one in found
                if one.found is not None
            ]
            ledger.store("hut", 1, rows, version="study")
        driver_s = (process_time() - began) / 4
    print(f"a chunk: worker {worker_s:.2f} s, driver {1e3 * driver_s:.1f} ms, {read_mb:.2f} MB")
    print("| workers | processors left | a chunk, s | a start, s | scheduler, ms a chunk | measured, s | model, s |")
    print("|---|---|---|---|---|---|---|")
    for workers in _MEASURED:
        run = measured(chunks, workers)
        costs = Costs(worker_s, run.scheduler_s, driver_s, read_mb, run.start_s)
        machine = Machine(run.cores, 1000.0, together=True)
        model = Simulation(costs, machine, workers=workers, chunks=len(chunks)).run()
        print(
            f"| {workers} | {run.cores:.2f} | {run.worker_s:.2f} | {run.start_s:.1f} | {1e3 * run.scheduler_s:.0f} | "
            f"{run.seconds:.1f} | {model.seconds:.1f} |",
            flush=True,
        )


class Run(NamedTuple):
    """A run of a cluster of this machine.

    Attributes
    ----------
    seconds : from the start of its workers to the last answer.
    cores : processors that other processes left meanwhile.
    worker_s, scheduler_s : processor seconds of a chunk, of a worker and of scheduler and driver.
    start_s : processor seconds of a worker before its first chunk is looked at.
    """

    seconds: float
    cores: float
    worker_s: float
    scheduler_s: float
    start_s: float


def measured(chunks: Sequence[Chunk], workers: int) -> Run:
    """Return what a run costs; its workers are started first with a chunk without images, then with one each."""
    before, own, began = _processors(), process_time(), perf_counter()
    nothing = chunks[0]._replace(items=())
    with open_cluster(Workers(None, workers), clock=SystemClock()) as cluster:
        cluster.look([nothing] * workers, lambda *_: None)
        started, started_own = sum(map(_spent, _children())), process_time()
        cluster.look(chunks, lambda *_: None)
        seconds = perf_counter() - began
        children, scheduler = sum(map(_spent, _children())), process_time()
        others = max(_processors() - before - (scheduler - own) - children, 0.0)
    return Run(
        seconds,
        max((os.cpu_count() or 1) - others / seconds, 0.05),
        (children - started) / len(chunks),
        (scheduler - started_own) / len(chunks),
        (started + started_own - own) / workers,
    )


def _processors() -> float:
    """Return how long all processors were busy since the machine started, s."""
    numbers = [int(word) for word in Path("/proc/stat").read_text().split("\n", 1)[0].split()[1:9]]
    return (sum(numbers) - numbers[3] - numbers[4]) / os.sysconf("SC_CLK_TCK")


def _spent(pid: int) -> float:
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def _children() -> list[int]:
    waiting, found = deque([os.getpid()]), list[int]()
    read: Callable[[Path], str] = Path.read_text
    while waiting:
        tasks = Path(f"/proc/{waiting.popleft()}/task").glob("*/children")
        new = [int(pid) for task in tasks for pid in read(task).split()]
        found += new
        waiting += new
    return found


if __name__ == "__main__":
    main()
