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
_MAX_KNOWN = 256


@dataclass(slots=True)
class _Known:
    """When a fault was last logged, and how often it has come since."""

    logged_at_s: float
    unlogged: int = 0


class FaultLog:
    """Logs faults: the first of a kind with its stack, later ones at most once in five minutes, with their count.

    Faults are of one kind when the exception's type and the line that raised it are.
    """

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._known: OrderedDict[str, _Known] = OrderedDict()

    def record(self, error: BaseException, *, request: str, now_s: float) -> str:
        """Log a fault, or count it; return its name, which the answer and the log share.

        Parameters
        ----------
        error : the fault.
        request : method and path.
        now_s : seconds that never jump.
        """
        name, place = _identify(error)
        with self._lock:
            known = self._known.get(name)
            if known is not None and now_s - known.logged_at_s < _WINDOW_S:
                known.unlogged += 1
                return name
            self._known[name] = _Known(now_s)
            self._known.move_to_end(name)
            if len(self._known) > _MAX_KNOWN:
                self._known.popitem(last=False)
        if known is None:
            _log.error("fault %s: %s failed at %s", name, request, place, exc_info=error)
        else:
            again = "fault %s again: %s failed at %s: %s (%d more since it was last logged)"
            _log.error(again, name, request, place, type(error).__name__, known.unlogged)
        return name


def _identify(error: BaseException) -> tuple[str, str]:
    """Return a fault's name, and the line that raised it."""
    frames = traceback.extract_tb(error.__traceback__)
    place = f"{frames[-1].filename}:{frames[-1].lineno}" if frames else "an unknown line"
    kind = f"{type(error).__module__}.{type(error).__qualname__} {place}"
    return hashlib.sha256(kind.encode()).hexdigest()[:8], place
