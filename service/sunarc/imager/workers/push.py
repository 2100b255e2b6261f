"""Messages to receivers: written when a camera's state changes, sent in their order, by webhook."""

from __future__ import annotations

import base64
import hashlib
import hmac
import json
import logging
import ssl
import threading
import urllib.parse
from collections.abc import Callable, Collection, Mapping
from dataclasses import KW_ONLY, dataclass, replace
from functools import partial
from http import HTTPStatus
from pathlib import Path
from typing import Protocol

from sunarc.common.errors import ConfigurationError, InputError, OutsideError
from sunarc.common.utc import rfc3339
from sunarc.imager.archive.archive import Archive
from sunarc.imager.archive.notices import CameraState, Notice
from sunarc.imager.runtime import http_exchange
from sunarc.imager.runtime.clock import Clock
from sunarc.imager.runtime.loop import Attempts, Loop, Pauses
from sunarc.imager.runtime.status import Reason, StatusRegistry, condition, make_condition, worker_code
from sunarc.imager.workers.options import read_secret

_log = logging.getLogger(__name__)
_POLL_S = 1.0
_LONGEST_WAIT_S = 60.0
_MOST_AT_ONCE = 50
_FAILING_S = 60.0
"""A receiver that was not reached for so long is a condition; a restart of it is shorter."""
_FAILING, _REFUSED, _UNUSABLE = "push_failing", "push_refused", "push_unusable"


class NoticeRefusedError(Exception):
    """Error of a notice that a receiver refuses for good."""


class Sink(Protocol):
    """Receiver of notices; calls raise ConfigurationError or InputError where a file or an extra is missing."""

    name: str

    def probe(self) -> None:
        """Connect as for a notice, and send none; OutsideError where it cannot be reached."""

    def publish_states(self, heartbeat: Callable[[], None]) -> None:
        """Publish the states of the cameras, where the receiver keeps them; OutsideError where it cannot be reached.

        This and `deliver` end after seconds, whatever the receiver does, and call `heartbeat` while they wait.
        """

    def deliver(self, notice: Notice, heartbeat: Callable[[], None]) -> None:
        """Send a notice and wait until the receiver has it.

        Raises
        ------
        NoticeRefusedError : it does not want this one, now or later.
        OutsideError : it may take it later.
        """

    def close(self, *, graceful: bool) -> None:
        """End the connection, if there is one; the next call makes another.

        `graceful`: MQTT publishes `offline` and sends DISCONNECT; else the socket is closed.
        """


@dataclass(kw_only=True, eq=False)
class PushWorker:
    """Sends notices to a receiver.

    Parameters
    ----------
    archive : the store.
    sink : the receiver.
    clock : real time.
    board : where a receiver that is not reached, or refuses, is shown.
    """

    archive: Archive
    sink: Sink
    clock: Clock
    board: StatusRegistry

    def __post_init__(self) -> None:
        """Begin without a failure."""
        self._attempts = Attempts(
            self.clock,
            Pauses(_POLL_S, _LONGEST_WAIT_S),
            board=self.board,
            code=worker_code(_FAILING, self.sink.name),
            reason=lambda error, hours: make_condition(_FAILING, self.sink.name, hours=round(hours, 2), error=error),
            after_s=_FAILING_S,
        )

    def run(self, stop: threading.Event, heartbeat: Callable[[], None]) -> None:
        """Send until stopped."""
        try:
            Loop(self.clock, stop, heartbeat).repeat(partial(self.step, stop, heartbeat))
        finally:
            self.sink.close(graceful=stop.is_set())

    def step(self, stop: threading.Event, heartbeat: Callable[[], None]) -> float:
        """Send the waiting messages, and return the seconds until the next time."""
        try:
            return self._attempts.attempt(partial(self._send_or_report, stop, heartbeat))
        except (ConfigurationError, InputError) as error:
            self._set_condition(_UNUSABLE, make_condition(_UNUSABLE, self.sink.name, error=str(error)))
            return _LONGEST_WAIT_S

    def _send_or_report(self, stop: threading.Event, heartbeat: Callable[[], None]) -> float | None:
        try:
            self.sink.publish_states(heartbeat)
            notices = self.archive.notices.after(self.sink.name, limit=_MOST_AT_ONCE)
            for notice in notices:
                heartbeat()
                if stop.is_set():
                    break
                self._deliver_notice(notice, heartbeat)
        except (OutsideError, ConfigurationError, InputError):
            self.sink.close(graceful=False)
            raise
        self._set_condition(_UNUSABLE, None)
        return 0.0 if len(notices) == _MOST_AT_ONCE else None

    def _deliver_notice(self, notice: Notice, heartbeat: Callable[[], None]) -> None:
        try:
            self.sink.deliver(notice, heartbeat)
        except NoticeRefusedError as refusal:
            self.archive.notices.done(self.sink.name, notice.seq, refused=True)
            n = self.archive.notices.sink_states()[self.sink.name].refused
            reason = make_condition(_REFUSED, self.sink.name, n=n, kind=notice.kind, error=str(refusal))
            self._set_condition(_REFUSED, reason)
            _log.warning("%s refused message %s (%s): %s", self.sink.name, notice.id, notice.kind, refusal)
        else:
            self.archive.notices.done(self.sink.name, notice.seq)
            self._set_condition(_REFUSED, None)
        self._attempts.succeeded()

    def _set_condition(self, code: str, reason: Reason | None) -> None:
        self.board.set_condition(worker_code(code, self.sink.name), reason)


_SETTLED_S = 60.0
"""For so long after the start a condition that is not set is not taken for one that has ended: workers begin anew."""
_MOST_WAITING = 100_000
"""Notices that are kept for receivers that do not take them: about 50 MB, and years of an imager's."""
_DROP_EVERY_S = 60.0
_OWN = "push_"
"""Beginning of the codes of conditions that concern receivers: sent to them, they would cause the next."""
OVERFLOW = "push_overflow"


@dataclass(kw_only=True, eq=False)
class NoticeWorker:
    """Worker that writes notices of every camera's changes, and keeps their states for receivers.

    Parameters
    ----------
    archive : the store.
    states : returns how every camera is now, by name.
    sinks : names of the receivers.
    clock : real time.
    board : where notices that were lost are shown.
    every_s : seconds between two looks.
    """

    archive: Archive
    states: Callable[[], Mapping[str, CameraState]]
    sinks: Collection[str]
    clock: Clock
    board: StatusRegistry
    every_s: float

    def __post_init__(self) -> None:
        """Count from now on."""
        self._started_s = self._dropped_s = self.clock.monotonic()
        self._named = False
        self.latest: Mapping[str, CameraState] = {}

    def run(self, stop: threading.Event, heartbeat: Callable[[], None]) -> None:
        """Write notices of changes until stopped."""
        Loop(self.clock, stop, heartbeat).every(self.every_s, self.step)

    def step(self) -> None:
        """Write notices of the changes since the last step."""
        if not self._named:
            self.archive.notices.name_sinks(self.sinks)
            self._named = True
        clears = self.clock.monotonic() - self._started_s >= _SETTLED_S
        latest: dict[str, CameraState] = {}
        for camera, state in self.states().items():
            reported = {code: data for code, data in state.conditions.items() if not code.startswith(_OWN)}
            held = self.archive.notices.record(camera, reported, now=self.clock.now(), clears=clears)
            latest[camera] = replace(state, conditions=held)
        self.latest = latest
        if self.clock.monotonic() - self._dropped_s >= _DROP_EVERY_S:
            self._dropped_s = self.clock.monotonic()
            self._drop_oldest()

    def _drop_oldest(self) -> None:
        lost = self.archive.notices.drop(most=_MOST_WAITING)
        if lost:
            _log.error("removed %d messages that a receiver did not take for too long", lost)
            self.board.set_condition(OVERFLOW, condition(OVERFLOW, lost=lost, most=_MOST_WAITING))


_WITHIN_S = 15.0
"""From the beginning of the connection to the status line of the answer."""
_RETRIED = {HTTPStatus.REQUEST_TIMEOUT, HTTPStatus.TOO_EARLY, HTTPStatus.TOO_MANY_REQUESTS}


@dataclass(eq=False)
class Webhook:
    """A receiver of signed POSTs.

    Redirects are not followed and nothing of a row is in the address: only what is set is connected to.

    Parameters
    ----------
    url : checked address.
    secret_file : with the key of the signature; read when it is first needed.
    clock : real time.
    """

    url: str
    _: KW_ONLY
    secret_file: Path | None
    clock: Clock

    def __post_init__(self) -> None:
        """Read the address."""
        self.name = webhook_name(self.url)
        self._url = urllib.parse.urlsplit(self.url)
        self._key = b""
        self._trust = http_exchange.Trust() if self._url.scheme == "https" else None

    def publish_states(self, heartbeat: Callable[[], None]) -> None:
        """Read the key, if it is not there yet: a webhook keeps no state of the cameras."""
        del heartbeat
        self._read_key()

    def probe(self) -> None:
        """Read the key, connect, and end the connection."""
        self._read_key()
        request = http_exchange.HttpRequest(method="POST", url=self._url, headers={}, body=b"")
        try:
            with http_exchange.exchange_errors():
                http_exchange.connected(request, self._get_tls_context(), self._new_limit(lambda: None)).close()
        except (OSError, http_exchange.UnfinishedError) as error:
            raise OutsideError(f"{self._url.hostname}: {error}") from error

    def close(self, *, graceful: bool) -> None:
        """Do nothing: every notice has a connection of its own."""

    def deliver(self, notice: Notice, heartbeat: Callable[[], None]) -> None:
        """Post a notice, and wait for the status of the answer."""
        self._read_key()
        body = json.dumps(make_push_message(notice), separators=(",", ":")).encode()
        timestamp = str(int(self.clock.now().timestamp()))
        headers = {
            "content-type": "application/json",
            "user-agent": "sunarc",
            "webhook-id": notice.id,
            "webhook-timestamp": timestamp,
            "webhook-signature": signature(self._key, notice.id, timestamp, body),
        }
        request = http_exchange.HttpRequest(method="POST", url=self._url, headers=headers, body=body)
        try:
            status = http_exchange.fetch(
                request, context=self._get_tls_context(), limit=self._new_limit(heartbeat)
            ).status
        except (OSError, http_exchange.UnfinishedError) as error:
            raise OutsideError(f"{self._url.hostname}: {error}") from error
        if HTTPStatus.OK <= status < HTTPStatus.MULTIPLE_CHOICES:
            return
        if status >= HTTPStatus.INTERNAL_SERVER_ERROR or status in _RETRIED:
            raise OutsideError(f"{self._url.hostname} answers {status}")
        raise NoticeRefusedError(f"{self._url.hostname} answers {status}")

    def _get_tls_context(self) -> ssl.SSLContext | None:
        return None if self._trust is None else self._trust.context()

    def _read_key(self) -> None:
        self._key = self._key or read_secret(self.secret_file)

    def _new_limit(self, heartbeat: Callable[[], None]) -> http_exchange.Limit:
        return http_exchange.Limit(_WITHIN_S, monotonic=self.clock.monotonic, heartbeat=heartbeat)


def webhook_name(url: str) -> str:
    """Return the name of a receiver: its host, and a digest, since an address may hold a secret."""
    digest = hashlib.sha256(url.encode()).hexdigest()[:8]
    return f"webhook_{urllib.parse.urlsplit(url).hostname}_{digest}"


def make_push_message(notice: Notice) -> dict[str, object]:
    """Return a notice as the JSON object that receivers get."""
    return {
        "id": notice.id,
        "type": notice.kind,
        "timestamp": rfc3339(notice.time),
        "camera": notice.camera,
        "data": notice.data,
    }


def signature(key: bytes, identity: str, timestamp: str, body: bytes) -> str:
    """Return the value of `webhook-signature`: HMAC-SHA256 of id, time and body."""
    mac = hmac.new(key, f"{identity}.{timestamp}.".encode() + body, hashlib.sha256)
    return f"v1,{base64.b64encode(mac.digest()).decode()}"
