"""Workers on Dask: a cluster of this machine's processes, or one that runs already at an address."""

from __future__ import annotations

import itertools
import logging
import os
import threading
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import AbstractContextManager, ExitStack, contextmanager
from dataclasses import dataclass, field
from typing import Any, NamedTuple, Self, TypeVar, cast

from sunarc.common.errors import OutsideError
from sunarc.common.extras import extra_module
from sunarc.common.findings import Finding
from sunarc.imager.runtime.child_process import keep_freed_memory
from sunarc.imager.runtime.clock import Clock
from sunarc.sources.look import Answer, Chunk, Done, look_at

DEATHS = 3
"""Workers that a chunk may kill before it is divided."""
WORKER_BYTES = 2 << 30
"""Memory at which a worker of this machine is ended and started anew: an image of 100 MP in colours takes 0.6 GB, and
its copies in the detector as much again."""
_AHEAD = 3
"""Chunks handed out for each thread: the next ones wait when one is done, and the scheduler's memory is bounded."""
_RECONNECT_S = 900.0
"""How long the driver waits for a scheduler that died and is started again."""
_RETRY_S = 1.0
_RESULT_S = 5.0
"""How long a finished result may take to arrive: some kB."""

Key = TypeVar("Key")
Given = TypeVar("Given")
Result = TypeVar("Result")


class Workers(NamedTuple):
    """Cluster that computes: a scheduler by its address, or processes of this machine where no address is given.

    deaths: workers of this machine that a chunk may kill before it is divided.
    """

    scheduler: str | None = None
    n: int = 1
    deaths: int = DEATHS


@dataclass(slots=True)
class Cluster:
    """A connection to a scheduler.

    Attributes
    ----------
    workers : how it was opened.
    clock : for waits.
    client : of `distributed`; replaced where the scheduler was started again.
    n_lost : connections that were lost.
    """

    workers: Workers
    clock: Clock
    client: Any
    n_lost: int = 0
    _ids: Iterator[int] = field(default_factory=itertools.count)

    @property
    def dashboard(self) -> str:
        """Address of Dask's dashboard."""
        return str(self.client.dashboard_link)

    def each(self, run: Callable[[Given], Result], given: Sequence[Given]) -> list[Result | None]:
        """Return the result of a function for each of some values; None where it killed three workers."""
        found: dict[int, Result] = {}
        self._run_tasks(run, list(enumerate(given)), found.__setitem__, divided=lambda _: [])
        return [found.get(number) for number in range(len(given))]

    def look(self, chunks: Sequence[Chunk], done: Done, *, run: Callable[[Chunk], list[Answer]] = look_at) -> None:
        """Process all chunks; `done` is called with each and its answers, in the order in which they are finished.

        `run` is what a worker does with a chunk.

        A chunk that kills three workers, and again when nothing else is under way, is divided, down to the image that
        does; that one is answered with `image_kills_workers`. Chunks that a scheduler lost are handed out again.
        """

        def divided(task: tuple[Chunk, Chunk]) -> list[tuple[Chunk, Chunk]]:
            return _halve_chunk(task[1], done)

        self._run_tasks(run, [(chunk, chunk) for chunk in chunks], done, divided=divided)

    def _run_tasks(
        self,
        run: Callable[[Given], Result],
        tasks: Iterable[tuple[Key, Given]],
        done: Callable[[Key, Result], None],
        *,
        divided: Callable[[tuple[Key, Given]], list[tuple[Key, Given]]],
    ) -> None:
        waiting, suspects, under_way = deque(tasks), deque[tuple[Key, Given]](), dict[Any, tuple[Key, Given]]()
        alone: tuple[Key, Given] | None = None
        while waiting or suspects or under_way:
            while waiting and len(under_way) < _AHEAD * max(self._count_threads(), 1):
                task = waiting.popleft()
                under_way[self._submit_task(run, task[1])] = task
            if not under_way:  # what was on a worker that died has killed it only if it does so alone
                alone = suspects.popleft()
                under_way[self._submit_task(run, alone[1])] = alone
            for future in self._wait_for_finished(under_way):
                outcome, result = _get_outcome(future)
                if outcome == "waiting":
                    continue
                task = under_way.pop(future)
                if outcome == "done":
                    done(task[0], cast("Result", result))
                elif outcome == "lost":
                    waiting.appendleft(task)
                elif task is alone:
                    suspects.extendleft(divided(task))
                else:
                    suspects.append(task)
            if self.client.status != "running" or any(future.cancelled() for future in under_way):
                waiting.extendleft(under_way.values())
                under_way.clear()
                self._reconnect_scheduler()

    def _submit_task(self, run: Callable[[Given], Result], given: Given) -> Any:  # noqa: ANN401 - a future
        # a key of its own: a chunk that is handed out again must not meet its former fate
        key = f"{getattr(run, '__name__', 'run')}-{os.getpid()}-{self.n_lost}-{next(self._ids)}"
        return self.client.submit(run, given, key=key, pure=False)

    def _count_threads(self) -> int:
        """Return how many chunks can be processed at once; 1 while no scheduler answers."""
        try:
            return sum((self.client.nthreads() or {}).values())
        except Exception as error:  # noqa: BLE001 - a lost scheduler raises one of many errors here
            logging.getLogger(__name__).debug("counting threads: %s", error)
            return 1

    def _wait_for_finished(self, under_way: dict[Any, Any]) -> list[Any]:
        """Return the futures that are done; waits for one of them, at most a second."""
        distributed = extra_module("distributed", extra="archives")
        try:
            with self.client.as_current():
                distributed.wait(list(under_way), timeout=_RETRY_S, return_when="FIRST_COMPLETED")
        except Exception as error:  # noqa: BLE001 - a lost scheduler raises one of many errors here
            logging.getLogger(__name__).debug("waiting for workers: %s", error)
        return [future for future in under_way if future.done()]

    def _reconnect_scheduler(self) -> None:
        self.n_lost += 1
        _close_quietly(self.client.close, timeout=0)
        if self.workers.scheduler is None:
            raise OutsideError("the scheduler of this machine's workers died; call the command again, it goes on")
        deadline = self.clock.monotonic() + _RECONNECT_S
        while True:
            try:
                self.client = _connect_client(self.workers.scheduler)
            except OSError as error:
                if self.clock.monotonic() > deadline:
                    problem = f"the scheduler at {self.workers.scheduler} did not come back within {_RECONNECT_S:.0f} s"
                    raise OutsideError(f"{problem}; call the command again, it goes on") from error
                self.clock.wait(threading.Event(), _RETRY_S)
            else:
                return


class ClusterWhenNeeded:
    """Cluster that is opened for the first work; see `Cluster`.

    Parameters
    ----------
    opening : gives the cluster, as `open_cluster` does.
    opened : called with it once it is there.
    """

    def __init__(
        self, opening: Callable[[], AbstractContextManager[Cluster]], opened: Callable[[Cluster], None]
    ) -> None:
        self._opening, self._opened = opening, opened
        self._stack = ExitStack()
        self._cluster: Cluster | None = None

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self._stack.close()

    def each(self, run: Callable[[Given], Result], given: Sequence[Given]) -> list[Result | None]:
        """Return the result of a function for each of some values."""
        return self._get_cluster().each(run, given) if given else []

    def look(self, chunks: Sequence[Chunk], done: Done, *, run: Callable[[Chunk], list[Answer]] = look_at) -> None:
        """Process all chunks; `done` is called with each and its answers."""
        if chunks:
            self._get_cluster().look(chunks, done, run=run)

    def _get_cluster(self) -> Cluster:
        if self._cluster is None:
            self._cluster = self._stack.enter_context(self._opening())
            self._opened(self._cluster)
        return self._cluster


@contextmanager
def open_cluster(workers: Workers, *, clock: Clock) -> Iterator[Cluster]:
    """Give a connection to a cluster; one of this machine's processes ends with it.

    Raises
    ------
    OutsideError : no scheduler answers at the address.
    InputError : the extra `archives` is not installed.
    """
    distributed = extra_module("distributed", extra="archives")
    dask = extra_module("dask", extra="archives")
    settings = {"distributed.scheduler.allowed-failures": workers.deaths - 1, "distributed.worker.daemon": True}
    logging.getLogger("distributed").setLevel(logging.ERROR)  # deaths and reconnections are reported here
    with dask.config.set(settings):
        if workers.scheduler is not None:
            try:
                cluster = Cluster(workers, clock, _connect_client(workers.scheduler))
            except OSError as error:
                raise OutsideError(f"no Dask scheduler answers at {workers.scheduler}: {error}") from error
            try:
                yield cluster
            finally:
                _close_quietly(cluster.client.close, timeout=5)
            return
        with (
            distributed.LocalCluster(
                n_workers=workers.n,
                threads_per_worker=1,
                memory_limit=WORKER_BYTES,
                dashboard_address="127.0.0.1:0",
                host="127.0.0.1",
            ) as local,
            distributed.Client(local, set_as_default=False) as client,
        ):
            client.register_worker_callbacks(setup=keep_freed_memory)  # also of workers that are started anew
            yield Cluster(workers, clock, client)


def _connect_client(address: str) -> Any:  # noqa: ANN401 - of `distributed`
    return extra_module("distributed", extra="archives").Client(address, timeout=5, set_as_default=False)


def _get_outcome(future: Any) -> tuple[str, object]:  # noqa: ANN401 - of `distributed`
    """Return the outcome of a future: "done" with its result, "killed" its workers, "lost", or "waiting" again."""
    try:
        return "done", future.result(timeout=_RESULT_S)
    except Exception as error:  # those of `distributed` are imported with it alone
        kind = type(error).__name__
        if kind == "KilledWorker":
            return "killed", None
        if isinstance(error, TimeoutError):  # the worker that held the result died, and it is computed again
            return "waiting", None
        if future.cancelled() or "Cancelled" in kind or isinstance(error, OSError):
            return "lost", None
        problem = f"a worker could not do its work ({kind}: {error})"
        raise OutsideError(f"{problem}; is the same version of sunarc installed there?") from error


def _halve_chunk(chunk: Chunk, done: Done) -> list[tuple[Chunk, Chunk]]:
    """Return the halves of a chunk; of one image none: it is answered."""
    if len(chunk.items) == 1:
        item = chunk.items[0]
        done(chunk, [Answer(item.file, item.number, Finding("image_kills_workers", {"deaths": DEATHS}))])
        return []
    half = len(chunk.items) // 2
    parts = (chunk._replace(items=chunk.items[:half]), chunk._replace(items=chunk.items[half:]))
    return [(part, part) for part in parts]


def _close_quietly(close: Callable[..., object], **arguments: object) -> None:
    """Close an object that may be broken already, without an error."""
    try:
        close(**arguments)
    except Exception as error:  # noqa: BLE001 - nothing depends on it any more
        logging.getLogger(__name__).debug("closing: %s", error)
