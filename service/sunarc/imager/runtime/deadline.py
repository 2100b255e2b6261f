"""Call that is waited for until a deadline, in a thread of its own."""

from __future__ import annotations

import threading
from collections.abc import Callable
from concurrent.futures import Future
from typing import Generic, TypeVar

Result = TypeVar("Result")


class SingleCall(Generic[Result]):
    """A call in a thread of its own, one at a time: who asks while it runs waits for the same one.

    A call that never returns, as to a server that was stopped, holds one thread, however often it is asked for, and
    not the end of the process.

    Parameters
    ----------
    call : returns the result.
    name : of the thread.
    """

    def __init__(self, call: Callable[[], Result], *, name: str) -> None:
        self._call, self._name = call, name
        self._lock = threading.Lock()
        self._running: Future[Result] | None = None

    def start(self) -> Future[Result]:
        """Return the result to come, of the call that runs, or else of a new one."""
        with self._lock:
            if self._running is None or self._running.done():
                self._running = Future()
                threading.Thread(target=self._run_call, args=(self._running,), name=self._name, daemon=True).start()
            return self._running

    def _run_call(self, running: Future[Result]) -> None:
        try:
            running.set_result(self._call())
        except BaseException as error:  # noqa: BLE001 - it is raised where the result is waited for
            running.set_exception(error)
