"""numba's `njit` with a cache on disk that may fail: the kernel is then compiled in memory, at each start anew."""

from __future__ import annotations

import logging
import shutil
import signal
from collections.abc import Callable, Iterator
from contextlib import suppress
from functools import cache
from hashlib import sha256
from pathlib import Path
from types import FunctionType
from typing import Any

import numba
from numba.core.caching import FunctionCache, IndexDataCacheFile
from numba.core.dispatcher import Dispatcher
from numba.core.runtime import rtsys

_log = logging.getLogger(__name__)

_FATAL = frozenset(
    {signal.SIGABRT, signal.SIGBUS, signal.SIGFPE, signal.SIGILL, signal.SIGSEGV, signal.SIGSYS, signal.SIGTRAP}
)
"""Signals that a process gets from what it executes; the units (ExecStopPost) know the same."""


class TolerantCache(FunctionCache):  # type: ignore[misc]
    """A function's cache on disk; what cannot be read is compiled again, what cannot be written is left out.

    numba lets an error of the cache folder (full, not writable, a file cut short by a power cut) end the call of the
    kernel, though the kernel itself is compiled by then. Nor does it compile a kernel again where one that it calls,
    a part of it, stands in another file that has changed, as after an upgrade: here the files of all count.
    """

    def load_overload(self, sig: object, target_context: object) -> object:
        """Return the stored kernel; None where there is none that can be read."""
        # numba's own begins with all that a compilation may need, which takes longer than to read most kernels. Where
        # there is nothing to read, the compilation does so; what is read needs the memory of arrays alone.
        rtsys.initialize(target_context)
        try:
            # not before the first call: what the kernel calls may be defined below it
            self._cache_file = IndexDataCacheFile(
                cache_path=self._cache_path,
                filename_base=self._impl.filename_base,
                source_stamp=tuple(sorted(set(_stamps(self._py_func, set())))),
            )
            return self._load_overload(sig, target_context)
        except Exception as error:  # noqa: BLE001 - of the disk, or whatever unpickling a damaged file raises
            _log.warning("compiled kernel in %s cannot be read (%s); compiling it again", self.cache_path, error)
            with suppress(OSError):
                self.flush()  # else the damaged index would be read again to store the kernel
            return None

    def save_overload(self, sig: object, data: object) -> None:
        """Store a compiled kernel; after a failure, store no more of this function."""
        try:
            self._impl.locator.ensure_cache_path()  # which may have been set aside since the kernel was defined
            super().save_overload(sig, data)
        except (OSError, RuntimeError) as error:  # RuntimeError: numba has no object code to store
            self.disable()
            _log.warning("%s: %s; kernels are compiled again at the next start", self.cache_path, error)


def set_aside_after_death() -> None:
    """Set the cache aside where the former life of this service ended by a signal that a damaged kernel causes.

    The service's unit then leaves a file beside the cache's folder (NUMBA_CACHE_DIR), with the signal's name in it.
    """
    if not numba.config.CACHE_DIR:
        return
    note = Path(f"{numba.config.CACHE_DIR}.died")
    try:
        name = note.read_text("ascii", errors="replace").strip()
        note.unlink()
    except OSError:
        return
    _set_aside(f"the service ended by SIG{name}")


def set_aside_after_exit(exit_code: int | None) -> None:
    """Set the cache aside where a child process ended by a signal that a damaged kernel causes.

    Parameters
    ----------
    exit_code : of the child, negative for a signal; None where it is not known.
    """
    if exit_code is not None and -exit_code in _FATAL:
        _set_aside(f"a process of the solver ended by {signal.Signals(-exit_code).name}")


def _set_aside(reason: str) -> None:
    """Move the cache's folder away, in place of the one that was set aside before; every kernel is compiled anew."""
    if not numba.config.CACHE_DIR:
        _log.warning("%s; if it ends so again, remove the compiled kernels beside the sources (*.nbi, *.nbc)", reason)
        return
    folder, aside = Path(numba.config.CACHE_DIR), Path(f"{numba.config.CACHE_DIR}.aside")
    try:
        shutil.rmtree(aside, ignore_errors=True)
        shutil.move(folder, aside)  # copies where an overlay (a root that is kept read-only) refuses to rename a folder
    except OSError as error:
        _log.warning(
            "%s; compiled kernels are not set aside (%s): if it ends so again, remove %s", reason, error, folder
        )
    else:
        _log.warning("%s; compiled kernels are set aside in %s and compiled anew", reason, aside)


def _stamps(function: FunctionType, visited: set[FunctionType]) -> Iterator[str]:
    """Yield what stands for the contents of the source file, of a function and of all kernels that it calls."""
    if function in visited:
        return
    visited.add(function)
    yield _stamp(function.__code__.co_filename)
    for name in function.__code__.co_names:
        called = function.__globals__.get(name)
        if isinstance(called, Dispatcher):
            yield from _stamps(called.py_func, visited)


@cache
def _stamp(file: str) -> str:
    """Return a digest of a source file: a package gives the files of all its versions one time."""
    return sha256(Path(file).read_bytes()).hexdigest()


def njit(**options: object) -> Callable[[Callable[..., Any]], Any]:
    """Return `numba.njit(cache=True, **options)`, for functions whose cache may fail."""

    def compiled(function: Callable[..., Any]) -> Any:  # noqa: ANN401 - numba's dispatcher
        dispatcher = numba.njit(**options)(function)
        try:
            dispatcher._cache = TolerantCache(dispatcher.py_func)  # noqa: SLF001 - as enable_caching() does
        except RuntimeError as error:  # numba's "no locator available": no folder can be written
            _log.warning("%s; kernels are compiled again at the next start", error)
        return dispatcher

    return compiled
