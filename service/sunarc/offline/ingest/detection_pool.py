"""Detection in many image files at once, in processes: they read and compute, the caller alone writes."""

from __future__ import annotations

import multiprocessing
import os
import signal
import threading
from collections import deque
from collections.abc import Generator, Iterable, Iterator
from concurrent.futures import Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from multiprocessing.connection import wait

import cv2

from sunarc.findings import Finding
from sunarc.offline.ingest.detect_image import Answer, Task
from sunarc.offline.ingest.detect_stack import detect_in_files
from sunarc.runtime.threads import one_thread_each

Answers = tuple[Answer, ...]
"""An answer for each file of a task."""

_AHEAD = 4
"""Tasks handed to each process before the first answer is read: bounds the memory of a long run."""


def detect_in_pool(tasks: Iterable[Task], *, n_tasks: int, processes: int) -> Iterator[Answers]:
    """Yield the answers of the tasks, in their order; fewer than a process is worth are computed here.

    An image whose process dies (a fault of a decoder, too little memory) is left out, and the others go on.
    """
    if processes < 2 or n_tasks <= 2 * processes:
        yield from map(detect_in_files, tasks)
        return
    waiting = iter(tasks)
    lost: list[Task] | None = []
    while lost is not None:
        for task in lost:
            yield _alone(task)
        lost = yield from _until_a_process_dies(waiting, processes)


def _until_a_process_dies(tasks: Iterator[Task], processes: int) -> Generator[Answers, None, list[Task] | None]:
    """Yield answers; return the tasks that were under way when a process died, None when all are done."""
    under_way: deque[tuple[Task, Future[Answers]]] = deque()
    pool = _pool(processes)
    try:
        for task in tasks:
            under_way.append((task, _submitted(pool, task)))
            if len(under_way) >= _AHEAD * processes:
                yield under_way[0][1].result()
                under_way.popleft()
        while under_way:
            yield under_way[0][1].result()
            under_way.popleft()
    except BrokenProcessPool:
        return [task for task, _ in under_way]
    finally:
        pool.shutdown(wait=True, cancel_futures=True)
    return None


def _submitted(pool: ProcessPoolExecutor, task: Task) -> Future[Answers]:
    """Return the future answer of a task; a pool that is broken already answers with its error."""
    # The process that this may start inherits the mask: Ctrl-C is for the run, which lets each image be finished.
    former = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        return pool.submit(detect_in_files, task)
    except BrokenProcessPool as error:
        broken = Future[Answers]()
        broken.set_exception(error)
        return broken
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, former)


def _alone(task: Task) -> Answers:
    """Return the answers of a task in a process of its own; that it died is an answer, too."""
    with _pool(1) as pool:
        try:
            return _submitted(pool, task).result()
        except BrokenProcessPool as error:
            return tuple(Finding("worker_died", {"error": str(error)}) for _ in task.files)


def _pool(processes: int) -> ProcessPoolExecutor:
    one_thread_each()  # read by the processes that are started
    context = multiprocessing.get_context("spawn")
    return ProcessPoolExecutor(processes, mp_context=context, initializer=_begin)


def _begin() -> None:
    """Prepare a process: one thread for images, and an end when the run has died."""
    cv2.setNumThreads(1)
    threading.Thread(target=_end_with_parent, daemon=True).start()


def _end_with_parent() -> None:
    parent = multiprocessing.parent_process()
    if parent is not None:
        wait([parent.sentinel])
        os._exit(1)  # the queue of tasks stays open in every process, and would be waited for without end
