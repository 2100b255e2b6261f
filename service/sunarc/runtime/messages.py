"""The messages of conditions that the supervisor and the schedule set."""

from __future__ import annotations

from sunarc.findings import Finding, Message, Messages
from sunarc.runtime.status import Reason, Severity

MESSAGES = Messages(
    worker_stuck=Message(
        "worker {name}: no heartbeat for more than {limit_s:g} s",
        "A worker or loop (`web`: the HTTP server, `schedule`) does not answer; systemd's watchdog is not fed.",
        "systemd restarts the service by its watchdog; without systemd, restart it",
    ),
    optional_worker_stuck=Message(
        "worker {name}: no heartbeat for more than {limit_s:g} s; the measurement does not depend on it",
        "A worker that sends to a hub, a broker or a receiver does not answer; systemd's watchdog is fed all the same.",
        "check the receiver and the network; if it stays, restart the service",
    ),
    worker_hindered=Message(
        "worker {name} is blocked: {error}",
        "Something outside keeps a worker from its work.",
        "fix the cause; it is retried automatically",
    ),
    worker_restarting=Message(
        "worker {name} died {deaths} times in {within_s:g} s; last error: {error}",
        "Not ready for `capture` and `detect`, else degraded.",
        "it is restarted automatically; the log has the stack",
    ),
    worker_failed=Message(
        "worker {name} disabled after repeated failures; last error: {error}",
        "It died more than `supervisor.max_restarts` times; not ready for `capture` and `detect`, else degraded.",
        "fix the cause, the log has the stack; {retried}",
    ),
    schedule_failed=Message(
        "scheduled work failed: {error}",
        "Days are evaluated late; on a hub, the nightly work is done late.",
        "it is retried every {every_s:g} s; the log has the stack",
    ),
)


def worker_code(code: str, name: str) -> str:
    """Return the code of a condition of one worker: that of the table and the worker's name."""
    return f"{code}_{name}"


def of_worker(code: str, name: str, *, severity: Severity = "degraded", **data: float | str) -> Reason:
    """Return a condition of one worker; `code` is that of the table."""
    finding = Finding(code, {"name": name, **data})
    return Reason.of(finding, MESSAGES, severity=severity, code=worker_code(code, name))
