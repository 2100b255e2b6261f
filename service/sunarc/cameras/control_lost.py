"""The library's signal that a camera no longer answers, and the end of the device that sends it."""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable
from typing import Any

from sunarc.runtime.clock import Clock

_log = logging.getLogger(__name__)
_POLL_S = 0.002
_POLLS = 250
"""0.5 s in all: a signal's emission takes less than a millisecond of a thread that runs."""


def setter(event: threading.Event) -> Callable[..., None]:
    """Return a signal handler that refers to nothing but the event: a reference to the camera would keep it open."""

    def set_event(*_: object) -> None:
        event.set()

    return set_event


def wait_for_last_reference(device: Any, clock: Clock) -> bool:  # noqa: ANN401 - a GObject has no types
    """Wait until the caller's reference to a device is the only one, at most 0.5 s; return whether it is.

    The signal is emitted in the device's own heartbeat thread, and the emission has a reference to the device until
    all handlers have returned. Were that the last one, the device would be finalized in that thread, which would then
    join itself: GLib ends the process ("Resource deadlock avoided"). An exception that is being handled may hold
    another reference, which is dropped later in the caller's thread: that wait ends in vain.
    """
    for _ in range(_POLLS):
        if getattr(device, "__grefcount__", 1) <= 1:
            return True
        clock.wait(threading.Event(), _POLL_S)
    _log.debug("the camera's device is still referred to %g s after it was closed", _POLLS * _POLL_S)
    return False
