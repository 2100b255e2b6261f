"""Computing processes on the shared host: threads, memory, priority, and the child of a long computation.

A module of its own that imports nothing: the child imports the packages of what it is to do, and no others.
"""

from __future__ import annotations

import ctypes
import os
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from multiprocessing.connection import Connection

_NICENESS = 10
_OOM_SCORE = "500"
"""Of 1000, added to the child's own: short of memory, the kernel ends the child and not the service."""


def answer_call(connection: Connection[object, Callable[[], object]]) -> None:
    """Read a call from a connection, and send its result; or its error as text.

    Parameters
    ----------
    connection : this process's end of a pipe.
    """
    with suppress(PermissionError):  # the unit's filter permits no priorities: the child then has the service's own
        os.nice(_NICENESS)
    with suppress(OSError):
        Path("/proc/self/oom_score_adj").write_text(_OOM_SCORE, encoding="ascii")
    keep_freed_memory()
    call = connection.recv()
    try:
        answer = call()
    except Exception as error:  # noqa: BLE001 - the parent reports it; the process ends anyway
        answer = f"{type(error).__name__}: {error}"
    with suppress(BrokenPipeError):  # the service was killed meanwhile; its next start begins anew
        connection.send(answer)


_TRIM_THRESHOLD, _MMAP_THRESHOLD = -1, -3
"""Parameters of `mallopt` (glibc, malloc.h)."""
_KEPT_BYTES, _LARGEST_BYTES = 1 << 29, 1 << 25


def keep_freed_memory() -> None:
    """Have glibc keep blocks below 32 MB that this process frees, for its next allocations.

    A fit asks for some MB thousands of times. With the unit's setting, by which the service gives back what its frames
    needed, every MB would be mapped and cleared anew: a third of the time of a fit of ten days. Images of an archive
    cost 3,400 page faults each, and 50 with it.
    """
    with suppress(AttributeError):  # another C library
        ctypes.CDLL(None).mallopt(_TRIM_THRESHOLD, _KEPT_BYTES)
        ctypes.CDLL(None).mallopt(_MMAP_THRESHOLD, _LARGEST_BYTES)


_VARIABLES = ("OMP_NUM_THREADS", "OPENCV_FOR_THREADS_NUM")
"""Of OpenBLAS, unless OPENBLAS_NUM_THREADS is set, and of whatever else is built on OpenMP; of OpenCV."""


def one_thread_each() -> None:
    """Limit BLAS, OpenMP and OpenCV to one thread a process, unless the environment states another number.

    The matrices are small: further threads wait for one another longer than they compute, under other load ten times
    as long. Several images or fits at a time are several processes. The libraries read this when they are loaded, and
    processes that are started have it from this one.
    """
    for name in _VARIABLES:
        os.environ.setdefault(name, "1")
