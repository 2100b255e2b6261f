"""How computing processes share the host: threads, priority, and the child process of a long computation.

A module of its own that imports nothing: the child imports the packages of what it is to do, and no others.
"""

from __future__ import annotations

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
    """Read a call from a connection, and send what it returns; or its error as text.

    Parameters
    ----------
    connection : this process's end of a pipe.
    """
    with suppress(PermissionError):  # the unit's filter permits no priorities: the child then has the service's own
        os.nice(_NICENESS)
    with suppress(OSError):
        Path("/proc/self/oom_score_adj").write_text(_OOM_SCORE, encoding="ascii")
    call = connection.recv()
    try:
        answer = call()
    except Exception as error:  # noqa: BLE001 - the parent reports it; the process ends anyway
        answer = f"{type(error).__name__}: {error}"
    with suppress(BrokenPipeError):  # the service was killed meanwhile; its next start begins anew
        connection.send(answer)


_VARIABLES = ("OMP_NUM_THREADS", "OPENCV_FOR_THREADS_NUM")
"""Of OpenBLAS, unless OPENBLAS_NUM_THREADS is set, and of whatever else is built on OpenMP; of OpenCV."""


def one_thread_each() -> None:
    """Have BLAS, OpenMP and OpenCV compute with one thread a process, unless the environment says how many.

    The matrices are small: further threads wait for one another longer than they compute, beside other load ten times
    as long. Several images or fits at a time are several processes. The libraries read this when they are loaded, and
    processes that are started have it from this one.
    """
    for name in _VARIABLES:
        os.environ.setdefault(name, "1")
