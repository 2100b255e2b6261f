"""Chunks processed in processes of this machine, in their order; the caller alone keeps the results."""

from __future__ import annotations

import multiprocessing
import os
import signal
import threading
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from multiprocessing.connection import wait
from typing import TypeVar

import cv2

from sunarc.common.findings import Finding
from sunarc.imager.runtime.child_process import keep_freed_memory, one_thread_each
from sunarc.sources.look import Answer, Chunk, Done, look_at

Run = Callable[[Chunk], list[Answer]]
Given = TypeVar("Given")
Result = TypeVar("Result")
_AHEAD = 4
"""Chunks handed to each process before the first answer is read: bounds the memory of a long run."""


def usable_processors() -> int:
    """Return on how many processors this process may run."""
    return len(os.sched_getaffinity(0))


class ProcessRunner:
    """Processes chunks in so many processes; see `ChunkRunner`. Fewer chunks than they are worth are processed here."""

    def __init__(self, processes: int) -> None:
        self._processes = processes

    def each(self, run: Callable[[Given], Result], given: Sequence[Given]) -> list[Result | None]:
        """Return the result of a function for each of some values."""
        return [run(one) for one in given]

    def look(self, chunks: Sequence[Chunk], done: Done, *, run: Run = look_at) -> None:
        """Process all chunks in order; `done` is called with each and its answers.

        An image whose process dies (a fault of a decoder, too little memory) is left out, and the others go on.
        """
        if self._processes < 2 or len(chunks) <= 2 * self._processes:
            for chunk in chunks:
                done(chunk, run(chunk))
            return
        waiting = iter(chunks)
        lost: list[Chunk] | None = []
        while lost is not None:
            for chunk in lost:
                done(chunk, _run_alone(run, chunk))
            lost = self._run_until_death(run, waiting, done)

    def _run_until_death(self, run: Run, chunks: Iterator[Chunk], done: Done) -> list[Chunk] | None:
        """Look at chunks; return those that were under way when a process died, None when all are done."""
        under_way: deque[tuple[Chunk, Future[list[Answer]]]] = deque()
        pool = _new_pool(self._processes)
        try:
            for chunk in chunks:
                under_way.append((chunk, _submit_chunk(pool, run, chunk)))
                if len(under_way) >= _AHEAD * self._processes:
                    done(under_way[0][0], under_way[0][1].result())
                    under_way.popleft()
            while under_way:
                done(under_way[0][0], under_way[0][1].result())
                under_way.popleft()
        except BrokenProcessPool:
            return [chunk for chunk, _ in under_way]
        finally:
            pool.shutdown(wait=True, cancel_futures=True)
        return None


def _submit_chunk(pool: ProcessPoolExecutor, run: Run, chunk: Chunk) -> Future[list[Answer]]:
    """Return the future answers of a chunk; a pool that is broken already answers with its error."""
    # The process that this may start inherits the mask: Ctrl-C is for the run, which lets each image be finished.
    former = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        return pool.submit(run, chunk)
    except BrokenProcessPool as error:
        broken = Future[list[Answer]]()
        broken.set_exception(error)
        return broken
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, former)


def _run_alone(run: Run, chunk: Chunk) -> list[Answer]:
    """Return the answers of a chunk in a process of its own; the finding where that process dies."""
    with _new_pool(1) as pool:
        try:
            return _submit_chunk(pool, run, chunk).result()
        except BrokenProcessPool as error:
            died = Finding("worker_died", {"error": str(error)})
            return [Answer(item.file, item.number, died) for item in chunk.items]


def _new_pool(processes: int) -> ProcessPoolExecutor:
    one_thread_each()  # read by the processes that are started
    context = multiprocessing.get_context("spawn")
    return ProcessPoolExecutor(processes, mp_context=context, initializer=_prepare_process)


def _prepare_process() -> None:
    """Prepare a process: one thread for images, memory that is kept for the next one, an end when the run has died."""
    cv2.setNumThreads(1)
    keep_freed_memory()
    threading.Thread(target=_end_with_parent, daemon=True).start()


def _end_with_parent() -> None:
    parent = multiprocessing.parent_process()
    if parent is not None:
        wait([parent.sentinel])
        os._exit(1)  # the queue of chunks stays open in every process, and would be waited for without end
