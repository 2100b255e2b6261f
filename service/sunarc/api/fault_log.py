"""Faults of the service in its log: the stack once for each distinct fault, then a count."""

from __future__ import annotations

import hashlib
import logging
import threading
import traceback
from collections import OrderedDict
from dataclasses import dataclass

_log = logging.getLogger(__name__)
_WINDOW_S = 300.0  # as long as the log's own filter holds repeats back
_MAX_KINDS = 256


@dataclass(slots=True)
class _Kind:
    """When a fault was last logged, and how often it has come since."""

    logged_at_s: float
    unlogged: int = 0


class FaultLog:
    """Logs faults: the first of a kind with its stack, later ones at most once in five minutes, with their count.

    Faults are of one kind when the exception's type and the line that raised it are.
    """

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._kinds: OrderedDict[str, _Kind] = OrderedDict()

    def record(self, error: BaseException, *, request: str, now_s: float) -> str:
        """Log a fault, or count it; return its name, which the answer and the log share.

        Parameters
        ----------
        error : the fault.
        request : method and path.
        now_s : seconds that never jump.
        """
        name, location = _identify(error)
        with self._lock:
            kind = self._kinds.get(name)
            if kind is not None and now_s - kind.logged_at_s < _WINDOW_S:
                kind.unlogged += 1
                return name
            self._kinds[name] = _Kind(now_s)
            self._kinds.move_to_end(name)
            if len(self._kinds) > _MAX_KINDS:
                self._kinds.popitem(last=False)
        # Outside the lock: formatting a stack takes milliseconds.
        if kind is None:
            _log.error("fault %s: %s failed at %s", name, request, location, exc_info=error)
        else:
            again = "fault %s again: %s failed at %s: %s (%d more since it was last logged)"
            _log.error(again, name, request, location, type(error).__name__, kind.unlogged)
        return name


def _identify(error: BaseException) -> tuple[str, str]:
    """Return a fault's name, and the line that raised it."""
    frames = traceback.extract_tb(error.__traceback__)
    location = f"{frames[-1].filename}:{frames[-1].lineno}" if frames else "an unknown line"
    identity = f"{type(error).__module__}.{type(error).__qualname__} {location}"
    return hashlib.sha256(identity.encode()).hexdigest()[:8], location
