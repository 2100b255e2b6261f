"""Sending of notices to one receiver: in their order, until it has them, and in nobody's way."""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable
from typing import Protocol

from sunarc.archive.archive import Archive
from sunarc.archive.notices import Notice
from sunarc.errors import ConfigurationError, InputError, OutsideError
from sunarc.runtime.clock import Clock
from sunarc.runtime.messages import worker_code
from sunarc.runtime.status import Reason, StatusRegistry
from sunarc.workers.messages import condition_of

_log = logging.getLogger(__name__)
_POLL_S = 1.0
_LONGEST_WAIT_S = 60.0
_MOST_AT_ONCE = 50
_FAILING_S = 60.0
"""A receiver that was not reached for so long is a condition; a restart of it is shorter."""
_FAILING, _REFUSED, _UNUSABLE = "push_failing", "push_refused", "push_unusable"


class NoticeRefusedError(Exception):
    """A receiver refuses a notice for good."""


class Sink(Protocol):
    """A receiver; a file or an extra that is missing here is a ConfigurationError or InputError of its calls."""

    name: str

    def probe(self) -> None:
        """Connect as for a message, and send none; OutsideError where it cannot be reached."""

    def refresh(self, heartbeat: Callable[[], None]) -> None:
        """Show how the cameras are, where the receiver keeps that; OutsideError where it cannot be reached.

        This and `deliver` end after seconds, whatever the receiver does, and call `heartbeat` while they wait.
        """

    def deliver(self, notice: Notice, heartbeat: Callable[[], None]) -> None:
        """Send a notice and wait until the receiver has it.

        Raises
        ------
        NoticeRefusedError : it does not want this one, now or later.
        OutsideError : it may take it later.
        """

    def close(self, *, orderly: bool) -> None:
        """End the connection, if there is one; the next call makes another."""


class PushWorker:
    """Sends notices to a receiver.

    Parameters
    ----------
    archive : the store.
    sink : the receiver.
    clock : real time.
    board : where a receiver that is not reached, or refuses, is shown.
    """

    def __init__(self, *, archive: Archive, sink: Sink, clock: Clock, board: StatusRegistry) -> None:
        self._archive, self._sink, self._clock, self._board = archive, sink, clock, board
        self._failures = 0
        self._reached_s = clock.monotonic()

    def run(self, stop: threading.Event, heartbeat: Callable[[], None]) -> None:
        """Send until stopped."""
        try:
            while not stop.is_set():
                until_s = self._clock.monotonic() + self.step(stop, heartbeat)
                while not stop.is_set() and self._clock.monotonic() < until_s:
                    heartbeat()
                    self._clock.wait(stop, min(_POLL_S, max(until_s - self._clock.monotonic(), 0.0)))
        finally:
            self._sink.close(orderly=stop.is_set())

    def step(self, stop: threading.Event, heartbeat: Callable[[], None]) -> float:
        """Send what there is, and return the seconds until the next time."""
        try:
            self._sink.refresh(heartbeat)
            notices = self._archive.notices_after(self._sink.name, limit=_MOST_AT_ONCE)
            for notice in notices:
                heartbeat()
                if stop.is_set():
                    break
                self._deliver(notice, heartbeat)
        except OutsideError as error:
            self._sink.close(orderly=False)
            return self._failed(str(error))
        except (ConfigurationError, InputError) as error:
            self._sink.close(orderly=False)
            self._show(_UNUSABLE, condition_of(_UNUSABLE, self._sink.name, error=str(error)))
            return _LONGEST_WAIT_S
        self._failures, self._reached_s = 0, self._clock.monotonic()
        self._show(_FAILING, None)
        self._show(_UNUSABLE, None)
        return 0.0 if len(notices) == _MOST_AT_ONCE else _POLL_S

    def _deliver(self, notice: Notice, heartbeat: Callable[[], None]) -> None:
        try:
            self._sink.deliver(notice, heartbeat)
        except NoticeRefusedError as refusal:
            self._archive.notice_done(self._sink.name, notice.seq, refused=True)
            n = self._archive.sink_states()[self._sink.name].refused
            reason = condition_of(_REFUSED, self._sink.name, n=n, kind=notice.kind, error=str(refusal))
            self._show(_REFUSED, reason)
            _log.warning("%s refused message %s (%s): %s", self._sink.name, notice.id, notice.kind, refusal)
        else:
            self._archive.notice_done(self._sink.name, notice.seq)
            self._show(_REFUSED, None)
        self._failures, self._reached_s = 0, self._clock.monotonic()

    def _failed(self, text: str) -> float:
        _log.debug("not sent to %s: %s", self._sink.name, text)
        self._failures += 1
        silent_s = self._clock.monotonic() - self._reached_s
        if silent_s >= _FAILING_S:
            self._show(_FAILING, condition_of(_FAILING, self._sink.name, hours=round(silent_s / 3600.0, 2), error=text))
        return float(min(2.0 ** min(self._failures - 1, 10), _LONGEST_WAIT_S))

    def _show(self, code: str, reason: Reason | None) -> None:
        self._board.set_condition(worker_code(code, self._sink.name), reason)
