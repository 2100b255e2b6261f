"""The child process of a long computation, which stands back behind the service that started it.

A module of its own that imports nothing: the child imports the packages of what it is to do, and no others.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from contextlib import suppress
from multiprocessing.connection import Connection
from pathlib import Path

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
